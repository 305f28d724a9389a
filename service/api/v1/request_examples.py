"""Request bodies in the OpenAPI document: examples of JSON, and the forms that FastAPI cannot derive.

A test sends every example, and it is answered.
"""

from typing import Any, Final

from service.api.v1.uploads import FORM_TYPE, IMAGE_TYPES
from service.schemas.contexts import IMAGE_EXAMPLE, INDICATOR_EXAMPLE
from service.schemas.shapes import DETAILS, L_EXAMPLE, OUTLINE_EXAMPLE, SCALE
from service.schemas.supports import SUPPORT_EXAMPLE

_PUSHER: Final = {"x": -0.075, "y": 0.0, "angle": 0.0}
_DESCRIPTOR: Final = {"descriptor": "1a2b3c4a"}
_BOX: Final = {"outline": OUTLINE_EXAMPLE}
_L: Final = {"outline": L_EXAMPLE, "friction": 0.3}
_FILES: Final = {
    "image/png": IMAGE_EXAMPLE,
    "image/jpeg": "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABsSFBcUERsXFhceHBsgKEIrKCUlKFE6PTBCYFVlZF9VXVtqeJmBanGQc1tdhbWGkJ6j"
    "q62rZ4C8ybqmx5moq6T/wAALCAAgACABAREA/8QAFQABAQAAAAAAAAAAAAAAAAAAAAb/xAAUEAEAAAAAAAAAAAAAAAAAAAAA/9oA"
    "CAEBAAA/AJkAUwmRTCZAH//Z",
    "image/webp": "UklGRioAAABXRUJQVlA4TB0AAAAvH8AHAA8wgAM4gPMfeBDTEPqXdpsCEf2fAHq95QA=",
}


def json_examples(examples: dict[str, Any]) -> dict[str, Any]:
    """Return named bodies in JSON as the part of an operation that shows them."""
    named = {name: {"summary": name, "value": value} for name, value in examples.items()}
    return {"requestBody": {"content": {"application/json": {"examples": named}}}}


ONE_PUSH: Final = json_examples(
    {
        "an object by its descriptor": {"pusher": _PUSHER, "context": _DESCRIPTOR},
        "an object by its indicator, one version of a model": {
            "pusher": _PUSHER,
            "context": {"indicator": INDICATOR_EXAMPLE},
            "model": "push-indicator@1",
        },
        "an object in an image": {"pusher": _PUSHER, "context": {"image": IMAGE_EXAMPLE}},
        "an object of any shape by its outline, a push of 20 mm": {
            "pusher": {"x": -0.1, "y": 0.0, "angle": 0.0, "length": 0.02},
            "context": _BOX,
        },
        "an object of any shape in an image with its scale": {
            "pusher": {"x": -0.01, "y": 0.0, "angle": 0.0, "length": 0.02},
            "context": {"image": IMAGE_EXAMPLE, "metres_per_pixel": 0.0005},
        },
        "an unknown object": {"pusher": _PUSHER},
        "an object by pushes that were observed": {"pusher": _PUSHER, "context": {"support": SUPPORT_EXAMPLE}},
        "in the world": {
            "pusher": {"x": 0.4, "y": 0.025, "angle": 1.5708},
            "context": _DESCRIPTOR,
            "object_pose": {"x": 0.4, "y": 0.1, "angle": 1.5708},
        },
    }
)
MANY_PUSHES: Final = json_examples(
    {
        "of one object": {"pushers": [[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]], "contexts": [_DESCRIPTOR]},
        "of several objects": {
            "pushers": [[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708], [0.0, 0.075, -1.5708]],
            "contexts": [_DESCRIPTOR, {"descriptor": "4a4a4a4a"}],
            "context_index": [0, 1, 0],
        },
        "of objects of any shape, pushes of several lengths": {
            "pushers": [[-0.1, 0.0, 0.0], [-0.1, 0.01, 0.0], [0.0, -0.1, 1.5708]],
            "lengths": [0.02, 0.05, 0.1],
            "contexts": [_BOX, _L],
            "context_index": [0, 0, 1],
        },
        "in the world": {
            "pushers": [[0.325, 0.1, 0.0], [0.4, 0.025, 1.5708]],
            "contexts": [_DESCRIPTOR],
            "object_poses": [[0.4, 0.1, 0.0]],
        },
    }
)


def _form(fields: dict[str, Any], rules: dict[str, Any], examples: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a form with an image. In its examples the image is the name of a file."""
    image = {"type": "string", "format": "binary", "description": "PNG, JPEG or WebP of the object from above"}
    schema = {
        "type": "object",
        "properties": {"image": image} | fields,
        "required": ["image"],
        "additionalProperties": False,
        **rules,
    }
    return {
        "schema": schema,
        "encoding": {"image": {"contentType": ", ".join(IMAGE_TYPES)}},
        "examples": {
            name: {"summary": f"{name} (view.png stands for the file)", "value": {"image": "view.png"} | value}
            for name, value in examples.items()
        },
    }


def _rows(name: str) -> dict[str, Any]:
    """Return the schema of rows as one part of a form. A list would be one part per row."""
    return {
        "type": "string",
        "contentMediaType": "application/json",
        "contentSchema": {"$ref": f"#/components/schemas/BatchRequest/properties/{name}"},
        "description": f"JSON of {name} as in /v1/predict/batch",
    }


_DETAILS: Final = {name: {"$ref": f"#/components/schemas/ContextBody/properties/{name}"} for name in DETAILS}
_SCALED: Final = {name: [SCALE] for name in DETAILS if name != SCALE}
_PUSH_FORM: Final = _form(
    {
        "pusher": {"$ref": "#/components/schemas/PusherBody"},
        "object_pose": {"$ref": "#/components/schemas/ObjectPoseBody"},
        "pushers": _rows("pushers"),
        "lengths": _rows("lengths"),
        "object_poses": _rows("object_poses"),
        **_DETAILS,
        "model": {"$ref": "#/components/schemas/PredictRequest/properties/model"},
    },
    {
        "oneOf": [{"required": ["pusher"]}, {"required": ["pushers"]}],
        "dependentRequired": {
            "object_pose": ["pusher"],
            "object_poses": ["pushers"],
            "lengths": ["pushers"],
            **_SCALED,
        },
    },
    {
        "one push": {"pusher": _PUSHER},
        "one push of an object of any shape": {
            "pusher": {"x": -0.01, "y": 0.0, "angle": 0.0, "length": 0.02},
            "metres_per_pixel": 0.0005,
        },
        "many pushes, in the world": {
            "pushers": "[[0.325, 0.1, 0.0], [0.4, 0.025, 1.5708]]",
            "object_poses": "[[0.4, 0.1, 0.0]]",
            "model": "push-visual",
        },
    },
)
PUSH_UPLOAD: Final = {"requestBody": {"required": True, "content": {FORM_TYPE: _PUSH_FORM}}}
IMAGE_UPLOAD: Final = {
    "requestBody": {
        "required": True,
        "content": {
            FORM_TYPE: _form(
                _DETAILS, {"dependentRequired": _SCALED}, {"a file": {}, "a file with its scale": {SCALE: 0.0005}}
            ),
            **{
                kind: {
                    "schema": {"type": "string", "format": "binary"},
                    "examples": {"a file": {"externalValue": f"data:{kind};base64,{_FILES[kind]}"}},
                }
                for kind in IMAGE_TYPES
            },
        },
    }
}
