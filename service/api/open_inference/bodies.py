"""Bodies of the Open Inference Protocol. These classes read requests, and document requests and answers.

A request may have fields and parameters of the protocol that this service does not use. They are ignored, unless the
answer would be in another form or place than the client expects: see ``UNSUPPORTED``.
"""

from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, FailFast, Field, SkipValidation

from service.schemas.body import Body
from service.schemas.contexts import INDICATOR_EXAMPLE
from service.schemas.rows import MAX_PUSHES

LARGEST_RANK: Final = 4
UNSUPPORTED: Final = {
    "shared_memory_region": "tensors in the body of the request and of the answer",
    "classification": "outputs as they are, without classes",
}
"""Parameters of tensors that are refused, and the accepted form instead."""
Parameters = dict[str, Any]  # of any type: those of other servers are ignored
_OPEN: Final = ConfigDict(extra="ignore")
_PUSHER_EXAMPLE: Final = {"name": "pusher", "datatype": "FP32", "shape": [1, 3], "data": [-0.075, 0.0, 0.0]}
_OUTPUT_EXAMPLE: Final = {"name": "mean", "datatype": "FP32", "shape": [1, 3], "data": [0.021, 0.001, 0.03]}
_METADATA_EXAMPLE: Final = {"name": "pusher", "datatype": "FP32", "shape": [-1, 3]}


class ErrorBody(Body):
    """An error in the form of the protocol."""

    error: Annotated[
        str,
        Field(
            description="the field, the received value and the accepted values",
            examples=["inputs pusher.shape: received another shape; accepted is [n (1 to 10000), 3]"],
        ),
    ]


class ServerLiveBody(Body):
    """Liveness of the server."""

    live: Annotated[Literal[True], Field(description="always true", examples=[True])] = True


class ServerReadyBody(Body):
    """Readiness of the server."""

    live: Annotated[bool, Field(description="readiness, under the name of the protocol", examples=[True])]
    ready: Annotated[bool, Field(description="readiness, under the name that some clients read", examples=[True])]


class ServerBody(Body):
    """Name, version and extensions of the server."""

    name: Annotated[str, Field(description="always cazsl", examples=["cazsl"])] = "cazsl"
    version: Annotated[str, Field(description="version of the service", examples=["0.1.0"])]
    extensions: Annotated[
        list[str], Field(description="supported extensions of the protocol", examples=[["binary_tensor_data"]])
    ]


class ModelReadyBody(Body):
    """Readiness of a model."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    ready: Annotated[
        Literal[True],
        Field(description="always true: a model that is not ready is a 503, an unknown one a 404", examples=[True]),
    ] = True


class TensorBody(Body):
    """Tensor of a model."""

    name: Annotated[str, Field(description="name of the tensor", examples=["pusher"])]
    datatype: Annotated[str, Field(description="FP32 or INT64", examples=["FP32"])]
    shape: Annotated[
        list[int],
        Field(description="size of each dimension; -1 for any number of pushes or contexts", examples=[[-1, 3]]),
    ]


class ModelMetadataBody(Body):
    """Metadata of a model."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    versions: Annotated[list[str], Field(description="served versions, oldest first", examples=[["1"]])]
    platform: Annotated[str, Field(description="always onnx_onnxv1", examples=["onnx_onnxv1"])] = "onnx_onnxv1"
    inputs: Annotated[
        list[TensorBody],
        Field(
            description="pusher in m, m, rad, and m for a length; the tensors of contexts and context_index for models "
            "that take a context",
            examples=[[_METADATA_EXAMPLE]],
        ),
    ]
    outputs: Annotated[
        list[TensorBody],
        Field(
            description="mean and std in m, m, rad, and the unfamiliarity of newer versions",
            examples=[[_METADATA_EXAMPLE]],
        ),
    ]


class InferTensorBody(Body):
    """Output with its numbers. As raw bytes after the JSON it has parameters.binary_data_size instead of data."""

    name: Annotated[str, Field(description="name of the tensor", examples=["pusher"])]
    datatype: Annotated[str, Field(description="FP32 or INT64", examples=["FP32"])]
    shape: Annotated[list[int], Field(description="size of each dimension", examples=[[1, 3]])]
    parameters: Annotated[
        dict[str, bool | int | float | str] | None,
        Field(description="binary_data_size: number of its bytes after the JSON", examples=[{"binary_data_size": 12}]),
    ] = None
    data: Annotated[list[Any] | None, Field(description="row-major, flat", examples=[[-0.075, 0.0, 0.0]])] = None


class InferInputBody(Body):
    """Input with its numbers. As raw bytes after the JSON it has parameters.binary_data_size instead of data."""

    model_config = _OPEN

    name: Annotated[
        str,
        Field(
            description="name of the tensor",
            examples=["pusher"],
            json_schema_extra={
                "enum": ["pusher", "context", "silhouette", "outline", "support", "body", "context_index"]
            },
        ),
    ]
    datatype: Annotated[Literal["FP32", "INT64"], Field(description="INT64 for context_index", examples=["FP32"])]
    shape: Annotated[
        list[Annotated[int, Field(ge=1, le=MAX_PUSHES)]],
        FailFast(),
        Field(
            min_length=1,
            max_length=LARGEST_RANK,
            description="size of each dimension, that of pushes or contexts first",
            examples=[[1, 3]],
        ),
    ]
    parameters: Annotated[
        Parameters | None,
        Field(description="binary_data_size: number of its bytes after the JSON", examples=[{"binary_data_size": 12}]),
    ] = None
    data: Annotated[
        list[SkipValidation[float | list[Any]]] | None,  # the array is checked as a whole
        Field(description="row-major, nested or flat", examples=[[-0.075, 0.0, 0.0]]),
    ] = None


class OutputBody(Body):
    """Requested output."""

    model_config = _OPEN

    name: Annotated[
        str,
        Field(
            description="an output of the model, each once",
            examples=["mean"],
            json_schema_extra={"enum": ["mean", "std", "unfamiliarity"]},
        ),
    ]
    parameters: Annotated[
        Parameters | None, Field(description="binary_data: send it as raw bytes", examples=[{"binary_data": False}])
    ] = None


class InferRequestBody(Body):
    """Inference request. Other fields and parameters of the protocol are ignored."""

    model_config = _OPEN

    id: Annotated[
        str | None, Field(max_length=256, description="any text, which the answer repeats", examples=["42"])
    ] = None
    parameters: Annotated[
        Parameters | None,
        Field(
            description="binary_data_output: send all outputs as raw bytes", examples=[{"binary_data_output": False}]
        ),
    ] = None
    inputs: Annotated[
        list[InferInputBody],
        FailFast(),
        Field(
            min_length=1,
            max_length=6,
            description="pusher, and for models that take a context also context, or silhouette, outline, support and "
            "body of shapes, and context_index; context_index may be left out if there is one context, or one per push",
            examples=[[_PUSHER_EXAMPLE]],
        ),
    ]
    outputs: Annotated[
        list[OutputBody] | None,
        FailFast(),
        Field(max_length=3, description="outputs to return; left out: all of the model", examples=[[{"name": "mean"}]]),
    ] = None


class AnswerParameters(Body):
    """Parameters of an answer."""

    warnings: Annotated[
        str,
        Field(
            description="JSON text of the warnings of /v1/predict/batch: a list of objects with code, detail and rows. "
            "Parameters of the protocol are texts, numbers or booleans.",
            examples=["[]"],
        ),
    ]


class InferResponseBody(Body):
    """Answer to an inference request."""

    model_name: Annotated[str, Field(description="model that answered", examples=["push-indicator"])]
    model_version: Annotated[str, Field(description="version that answered", examples=["1"])]
    id: Annotated[str | None, Field(description="id of the request", examples=["42"])] = None
    parameters: Annotated[AnswerParameters, Field(examples=[{"warnings": "[]"}])]
    outputs: Annotated[list[InferTensorBody], Field(description="in the requested order", examples=[[_OUTPUT_EXAMPLE]])]


INFERENCE: Final[dict[str, dict[str, Any]]] = {
    "one push": {
        "value": {
            "id": "42",
            "inputs": [
                {"name": "pusher", "datatype": "FP32", "shape": [1, 3], "data": [-0.075, 0.0, 0.0]},
                {"name": "context", "datatype": "FP32", "shape": [1, 36], "data": INDICATOR_EXAMPLE},
            ],
        }
    },
    "two pushes of two objects, only the mean": {
        "value": {
            "inputs": [
                {"name": "pusher", "datatype": "FP32", "shape": [2, 3], "data": [[-0.075, 0, 0], [0, -0.075, 1.5708]]},
                {"name": "context", "datatype": "FP32", "shape": [2, 36], "data": [INDICATOR_EXAMPLE] * 2},
                {"name": "context_index", "datatype": "INT64", "shape": [2], "data": [1, 0]},
            ],
            "outputs": [{"name": "mean"}],
        }
    },
}
