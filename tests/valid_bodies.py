"""Make generated bodies valid in place, by the rules between fields that no JSON schema can express.

The fields of a body are valid one by one already. Drawn values are kept where possible, and no new number is drawn.
"""

import base64
import io
import json
import math
import zlib
from typing import Any

import numpy as np
from PIL import Image

from service.api.v1.object_contexts import MAX_IMAGES
from service.inference.snapshot import DEFAULT_MODELS
from service.planning.refine import MOST_PUSHES
from service.pushing.contexts import BITS_PER_SIDE, SHAPE_DIGITS, SIDES, TRIANGULAR
from service.pushing.poses import REACH_M, WORLD_M
from service.schemas.shapes import DETAILS, SCALE

Json = dict[str, Any]
KINDS = {
    "descriptor": "indicator",
    "indicator": "indicator",
    "visual": "visual",
    "image": "visual",
    "outline": "shape",
    "support": "support",
}
WITHOUT_OUTLINE = ("visual", "support")
RADIUS_M = 0.04  # of a drawn outline
FORMATS = ("PNG", "JPEG", "WEBP")
NEAR_M = 0.7 * REACH_M  # a pusher that is so near along both axes is in reach, in a frame of any angle


def picture(seed: object) -> bytes:
    """Create a small image file, a different one for each seed."""
    number = zlib.crc32(repr(seed).encode())
    levels = np.random.default_rng(number).integers(0, 256, (1 + number % 40, 1 + number // 40 % 40), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, FORMATS[number % len(FORMATS)])
    return buffer.getvalue()


def make_push_valid(body: Json) -> None:
    """Give a single push a possible object, a model of its context kind, and a pusher within reach."""
    kind = "none"
    if body.get("context") is not None:
        kind = make_context_valid(body["context"])
    _choose_model(kind, body)
    pusher, pose = body["pusher"], body.get("object_pose") or {"x": 0.0, "y": 0.0}
    for name in ("x", "y"):
        pusher[name] = _near(pusher[name], pose[name])
    if kind == "shape":
        pusher["x"], pusher["y"] = _outside([pusher["x"], pusher["y"]], [pose["x"], pose["y"]])
    else:
        pusher.pop("length", None)


def make_batch_valid(body: Json) -> None:
    """Give a batch contexts of one kind, valid indices, one pose or one per push, and pushers within reach."""
    count, contexts = len(body["pushers"]), body.get("contexts")
    kind = "none"
    if contexts is None:
        body.pop("context_index", None)
    else:
        contexts[:] = _of_one_kind(contexts)
        kind = [make_context_valid(context) for context in contexts].pop()
        if body.get("context_index") is not None:
            index = body["context_index"]
            body["context_index"] = [int(index[row % len(index)]) % len(contexts) for row in range(count)]
        elif len(contexts) not in (1, count):
            del contexts[1:]
    _choose_model(kind, body)
    poses = body.get("object_poses") or [[0.0, 0.0, 0.0]]
    if len(poses) not in (1, count):
        del poses[1:]
    for row, pusher in enumerate(body["pushers"]):
        pose = poses[row % len(poses)]
        pusher[:2] = [_near(pusher[axis], pose[axis]) for axis in range(2)]
        if kind == "shape":
            pusher[:2] = _outside(pusher[:2], pose[:2])
    lengths = body.get("lengths")
    if lengths is not None and (kind != "shape" or (isinstance(lengths, list) and len(lengths) not in (1, count))):
        del body["lengths"]


def make_context_valid(context: Json) -> str:
    """Give a context one shape and one weight per side, or an image that can be decoded. Return its context kind."""
    form = next(name for name, value in context.items() if name in KINDS and value is not None)
    if form == "indicator":
        context[form] = _one_hot(context[form])
    elif form == "outline":
        context[form] = _star(context[form])
        context.pop("centre_of_mass", None)
        if context.get("posterior") is not None:
            context["centre_of_mass"] = context[form][0]
            context["posterior"]["correlation"] = np.eye(len(context["posterior"]["std"])).tolist()
    elif form == "support":
        pushers, outcomes = context[form]["pushers"], context[form]["outcomes"]
        count = min(len(pushers), len(outcomes))
        del pushers[count:], outcomes[count:]
        for row in (*pushers, *outcomes):
            row[:2] = [_near(value, 0.0) for value in row[:2]]
    elif form == "image" and context.get(SCALE) is not None:
        context[form], context[SCALE] = base64.b64encode(silhouette()).decode(), 0.001
        context.pop("centre_of_mass", None)
        return "shape"
    elif form == "image":
        context[form] = base64.b64encode(picture(context[form])).decode()
    return KINDS[form]


def make_rollout_valid(body: Json) -> None:
    """Give a rollout a possible object, pushes or candidate sequences within reach, and few particles."""
    kind = "none"
    if body.get("context") is not None:
        kind = make_context_valid(body["context"])
    _choose_model(kind, body)
    if body.get("sequences") is not None or body.get("pushes") is None:
        body.pop("pushes", None)
        body["sequences"] = [_sequence(pushes, kind, body) for pushes in (body.get("sequences") or [[{}]])[:20]]
    else:
        body["pushes"] = _sequence(body["pushes"], kind, body)
    body["particles"] = 1 + int(body.get("particles") or 0) % 8
    body["seed"] = int(body.get("seed") or 0)  # a schema counts 1.0 among the integers, strict bodies do not


def make_map_valid(body: Json) -> None:
    """Give a push map an object of known outline, and few pushes."""
    kind = make_context_valid(body["context"])
    if kind in WITHOUT_OUTLINE:
        body["context"], kind = {"outline": _star(repr(body))}, "shape"
    _choose_model(kind, body)
    if body.get("spacing") is not None:
        body["spacing"] = min(max(body["spacing"], 0.005), 0.01)  # of few places none may have room for a tip
    body["context"].pop("pusher_radius", None)
    if kind != "shape":
        body.pop("length", None)


def make_plan_valid(body: Json) -> None:
    """Give a plan an object of known outline, simple polygons, and a short time."""
    kind = make_context_valid(body["context"])
    if kind in WITHOUT_OUTLINE:
        body["context"], kind = {"outline": _star(repr(body))}, "shape"
    _choose_model(kind, body)
    if kind != "shape":
        body.pop("lengths", None)
    pose = [min(max(body["object_pose"][name], 10.0 - WORLD_M), WORLD_M - 10.0) for name in ("x", "y")]
    if body.get("workspace") is not None:
        body["workspace"] = [[20.0 * x + pose[0], 20.0 * y + pose[1]] for x, y in _star(repr(body["workspace"]))]
    if body.get("obstacles"):
        stars = [_star(repr((number, obstacle))) for number, obstacle in enumerate(body["obstacles"][:5])]
        body["obstacles"] = [
            [[x + pose[0] + 0.2 * number, y + pose[1] + 0.2] for x, y in star] for number, star in enumerate(stars)
        ]
    body["time_s"] = 0.05
    body |= {name: int(body[name]) for name in ("seed", "max_pushes") if name in body}  # strict, unlike a schema


def make_refine_valid(body: Json) -> None:
    """Give a refinement an object of any shape, and as many outcomes as pushes."""
    if make_context_valid(body["context"]) != "shape":
        body["context"] = {"outline": _star(repr(body["context"]))}
    del body["pushers"][MOST_PUSHES:]
    names = "pushers", "lengths", "object_poses", "model"
    pushes: Json = {name: body.pop(name) for name in names if name in body}
    pushes["contexts"] = [{"outline": "star"}]
    make_batch_valid(pushes)
    del pushes["contexts"]
    body |= pushes
    outcomes = body["outcomes"]
    body["outcomes"] = [outcomes[row % len(outcomes)] for row in range(len(body["pushers"]))]
    body["seed"] = int(body.get("seed") or 0)


def _sequence(pushes: list[Json], kind: str, body: Json) -> list[Json]:
    """Return pushes near the object, with the length that its model knows."""
    pose, found = body["object_pose"], []
    for push in pushes:
        near = {name: _near(push.get(name, 0.0), pose[name]) for name in ("x", "y")}
        lengths = {"length": push["length"]} if kind == "shape" and "length" in push else {}
        found.append({**near, "angle": push.get("angle", 0.0), **lengths})
    return found


def make_image_valid(body: Json) -> None:
    """Replace the name of a file, which stands for an image in an example, by an image file.

    With a scale it is one of a single object, and without it there are no details of a shape.
    """
    if SCALE in body:
        body["image"], body[SCALE] = silhouette(), "0.001"
        for name in ("friction", "pusher_radius", "pressure"):
            if name in body:
                body[name] = json.dumps(body[name])
    elif type(body["image"]) is str:
        body["image"] = picture(body["image"])
    for name in ("centre_of_mass",) if SCALE in body else DETAILS:
        body.pop(name, None)


def make_upload_valid(body: Json) -> None:
    """Give a form one push or a batch within reach, and a visual model. Forms are drawn without regard to ``oneOf``."""
    make_image_valid(body)
    push: Json
    known = {"context": {"outline": "silhouette"}} if SCALE in body else {}
    if "pushers" in body:
        push = {name: _rows(body[name]) for name in ("pushers", "object_poses") if name in body}
        push |= {"contexts": [known["context"]]} if known else {}
        make_batch_valid(push)
        push = {name: json.dumps(rows) for name, rows in push.items() if name != "contexts"}
    else:
        push = {"pusher": {"x": 0.0, "y": 0.0, "angle": 0.0}} | known
        push |= {name: body[name] for name in ("pusher", "object_pose") if name in body}
        make_push_valid(push)
        push.pop("context", None)
    model = str(body.get("model"))
    for name in {"pusher", "pushers", "lengths", "object_pose", "object_poses"} & body.keys():
        del body[name]
    served = "push-shape" if known else "push-visual"
    body |= push | ({"model": served} if model.startswith("push-") else {})


def make_inference_valid(body: Json) -> None:
    """Give an inference request the tensors of ``push-indicator``, with as many rows as were drawn."""
    count = 1 + int(body["inputs"][0]["shape"][0]) % 5
    drawn = zlib.crc32(repr(body["inputs"]).encode())
    random = np.random.default_rng(drawn)
    objects = np.array([_one_hot(random.integers(0, 2, SIDES * BITS_PER_SIDE).tolist()) for _ in range(count)])
    tensors = {
        "pusher": ("FP32", random.uniform(-REACH_M, REACH_M, (count, 3))),
        "context": ("FP32", objects),
        "context_index": ("INT64", random.integers(0, count, count)),
    }
    if drawn % 2:  # one context per push needs no index
        del tensors["context_index"]
    body["inputs"] = [
        {"name": name, "datatype": kind, "shape": list(rows.shape), "data": _nested_or_flat(rows, flat=drawn % 3 == 0)}
        for name, (kind, rows) in tensors.items()
    ]
    if body.get("outputs"):
        known = {output["name"]: output for output in body["outputs"] if output["name"] != "unfamiliarity"}
        body["outputs"] = list(known.values())


def cannot_be_sent_as_form(body: object) -> bool:
    """Return whether a body has a null or an empty list. Neither makes a part of a form, so its fault is not sent."""
    return isinstance(body, dict) and any(value is None or value == [] for value in body.values())


def _rows(seed: object) -> list[list[float]]:
    """Return one to three poses, (n, 3), derived from a seed."""
    number = zlib.crc32(repr(seed).encode())
    rows: list[list[float]] = np.random.default_rng(number).uniform(-NEAR_M, NEAR_M, (1 + number % 3, 3)).tolist()
    return rows


def _nested_or_flat(rows: np.ndarray[Any, Any], *, flat: bool) -> list[Any]:
    return list(rows.reshape(-1).tolist() if flat else rows.tolist())


def silhouette() -> bytes:
    """Return an image of one square, 80 x 80 pixels in the middle of 160 x 160: a mask."""
    levels = np.zeros((160, 160), dtype=np.uint8)
    levels[40:120, 40:120] = 255
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, "PNG")
    return buffer.getvalue()


def _star(seed: object) -> list[list[float]]:
    """Return a star-shaped outline around the origin, derived from a seed: no farther from it than ``RADIUS_M``."""
    random = np.random.default_rng(zlib.crc32(repr(seed).encode()))
    count = int(random.integers(3, 40))
    angles = 2.0 * np.pi * (np.arange(count) + random.uniform(0.0, 0.5, count)) / count
    radii = RADIUS_M * random.uniform(0.5, 1.0, count)
    found: list[list[float]] = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1).tolist()
    return found


def _outside(position_m: list[float], centre_m: list[float]) -> list[float]:
    """Return a position that is farther from the centre of an object than its outline, in any frame."""
    if max(abs(position_m[axis] - centre_m[axis]) for axis in range(2)) > 2 * RADIUS_M:
        return position_m
    return [centre_m[0] + math.copysign(3 * RADIUS_M, -centre_m[0]), centre_m[1]]


def _choose_model(kind: str, body: Json) -> None:
    """Replace the model by one of this kind. Half of the unknown names remain, because a 404 is documented too."""
    if isinstance(body.get("model"), str):
        name, at, rest = body["model"].partition("@")
        body["model"] = (
            f"{DEFAULT_MODELS[kind]}{at}{rest}" if len(name) % 2 == 0 or name.startswith("push-") else body["model"]
        )


def _near(position_m: float, centre_m: float) -> float:
    """Move a coordinate of a pusher near the centre of an object, and within the bounds of the world."""
    if abs(position_m - centre_m) <= NEAR_M:
        return position_m
    return centre_m - math.copysign(math.fmod(abs(position_m), NEAR_M), centre_m if abs(centre_m) > WORLD_M / 2 else 1)


def _kind_of(context: Json) -> str:
    """Return the kind of a drawn context."""
    form = next(name for name, value in context.items() if name in KINDS and value is not None)
    return "shape" if form == "image" and context.get(SCALE) is not None else KINDS[form]


def _of_one_kind(contexts: list[Json]) -> list[Json]:
    """Return the contexts of the first one's kind, at most as many as one request may have images."""
    kinds = [_kind_of(context) for context in contexts]
    found = [context for context, kind in zip(contexts, kinds, strict=True) if kind == kinds[0]]
    return found[:MAX_IMAGES]


def _one_hot(bits: list[float]) -> list[int]:
    """Return an indicator with the first drawn shape and weight of each side. B and C exist on triangles only."""
    found: list[int] = []
    for side in range(SIDES):
        drawn = bits[side * BITS_PER_SIDE : (side + 1) * BITS_PER_SIDE]
        shape = ([*drawn[: len(SHAPE_DIGITS)], 1]).index(1) % len(SHAPE_DIGITS)
        weight = ([*drawn[len(SHAPE_DIGITS) :], 1]).index(1) % (BITS_PER_SIDE - len(SHAPE_DIGITS))
        if SHAPE_DIGITS[shape] != TRIANGULAR and weight > 2:  # replaces B and C by b and c
            weight -= 2
        found += [int(place in (shape, len(SHAPE_DIGITS) + weight)) for place in range(BITS_PER_SIDE)]
    return found
