"""Checks of an ONNX graph before onnxruntime loads it: no data outside the file, no huge tensors, no loops.

onnxruntime opens files that a tensor names, even when the model comes as bytes, and evaluates constants while it loads.
So a model is first parsed with the ONNX library and walked as a tree of messages. The walk finds a tensor in any field
(initialisers, sparse ones, attributes, sub-graphs, functions, fields that a later format adds). Operators and types
that are not listed here are refused. Shapes are then inferred without evaluating the graph, and bounded. Training and
serving both call ``inspect_graph``, so every published model can be served.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import onnx
from google.protobuf.message import DecodeError, Message
from google.protobuf.unknown_fields import UnknownFieldSet
from onnx import TensorProto, TypeProto, ValueInfoProto

from service.errors import BrokenModelError

# Arithmetic on tensors whose shapes follow from the shapes of their inputs. Left out on purpose: control flow,
# sub-graphs, random numbers, strings, sequences, image decoding, and operators that turn a value into a size
# (ConstantOfShape, Tile, Range, Pad, Resize, OneHot). Expand is listed, but its target must be known before it runs.
OPERATORS: Final = frozenset(
    """
    Abs Add And AveragePool BatchNormalization Cast Ceil Clip Concat Constant Conv Cos Div Dropout Elu Equal Erf Exp
    Expand Flatten Floor Gather GatherElements GatherND Gelu Gemm GlobalAveragePool Greater GreaterOrEqual Identity
    InstanceNormalization LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max MaxPool Mean Min Mul
    Neg Not Or Pow Reciprocal ReduceL2 ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum Relu Reshape Round Shape
    Sigmoid Sign Sin Slice Softmax Softplus Split Sqrt Squeeze Sub Sum Tanh Transpose Unsqueeze Where Xor
    """.split()  # noqa: SIM905 (one name a line would take three pages)
)
ITEM_BYTES: Final[Mapping[int, int]] = {
    TensorProto.FLOAT: 4,
    TensorProto.DOUBLE: 8,
    TensorProto.INT32: 4,
    TensorProto.INT64: 8,
    TensorProto.BOOL: 1,
    TensorProto.UINT8: 1,
}
_LARGEST_ITEM: Final = max(ITEM_BYTES.values())
_CONTEXTS: Final = "g"  # the free size of the contexts, see ``service.pushing.onnx_interface``
MAX_NODES: Final = 10_000
MAX_CONSTANT_ELEMENTS: Final = 1 << 22  # of one tensor in the file
MAX_ELEMENTS_PER_ROW: Final = 1 << 20  # of one intermediate tensor, for one row and one context
MAX_FREE_DIMENSIONS: Final = 1  # n or g, never both in one tensor


@dataclass(frozen=True)
class GraphSize:
    """Size of the intermediate tensors of a graph, in bytes: all those of one row, and all those of one context."""

    row_bytes: int = 0
    context_bytes: int = 0


def inspect_graph(model: bytes) -> GraphSize:
    """Check a graph against every rule of this module, and return its size.

    Raises:
        BrokenModelError: the bytes are not an ONNX model, or the graph breaks a rule. The message names the place.
    """
    try:
        parsed = onnx.ModelProto.FromString(model)
    except DecodeError as error:
        raise BrokenModelError("model.onnx: not an ONNX model") from error
    for where, message in _walk(parsed, "model"):
        if isinstance(message, TensorProto):
            _check_tensor(where, message)
            _clear_values(message)
        elif isinstance(message, onnx.NodeProto):
            _check_operator(where, message)
    _check_parts(parsed)
    return _check_shapes(parsed)


def _broken(where: str, reason: str) -> BrokenModelError:
    return BrokenModelError(f"model.onnx: {where[:200]}: {reason}")


def _walk(message: Message, where: str) -> Iterator[tuple[str, Message]]:
    """Yield a message and every message below it, in any field. A field that ONNX does not know is refused."""
    pending = [(where, message)]
    while pending:
        where, message = pending.pop()
        if len(UnknownFieldSet(message)):
            raise _broken(where, "a field that ONNX does not know")
        yield where, message
        if isinstance(message, ValueInfoProto):
            _check_value(where, message)
            continue
        for field, value in message.ListFields():
            if field.message_type is not None:
                parts = list(value) if field.is_repeated else [value]
                pending += [(f"{where}.{field.name}[{place}]", part) for place, part in enumerate(parts)]


def _check_value(where: str, value: ValueInfoProto) -> None:
    """Check the declared type of a tensor. Three of four messages of a graph are such, so its size is compared."""
    if value.type.WhichOneof("value") not in ("tensor_type", None):
        raise _broken(where, "not a tensor")
    size = value.ByteSize()
    value.DiscardUnknownFields()
    if value.ByteSize() != size:
        raise _broken(where, "a field that ONNX does not know")


def _check_tensor(where: str, tensor: TensorProto) -> None:
    if tensor.data_location != TensorProto.DEFAULT or tensor.external_data:
        raise _broken(where, "external data: a model is one file")
    if tensor.data_type not in ITEM_BYTES:
        raise _broken(where, f"data type {tensor.data_type} is not accepted")
    if any(size < 0 for size in tensor.dims):
        raise _broken(where, "a negative size")
    elements = math.prod(tensor.dims)
    if elements > MAX_CONSTANT_ELEMENTS:
        raise _broken(where, f"declares {elements:.3g} elements, more than {MAX_CONSTANT_ELEMENTS}")
    fields = (tensor.float_data, tensor.double_data, tensor.int32_data, tensor.int64_data, tensor.uint64_data)
    held = sum(map(len, fields)) + len(tensor.raw_data) / ITEM_BYTES[tensor.data_type]
    if held != elements:
        raise _broken(where, f"declares {elements} elements and holds {held:g}")


def _clear_values(tensor: TensorProto) -> None:
    """Drop the values of a tensor of fractions: no size depends on them, and shape inference would copy them."""
    if tensor.data_type in (TensorProto.FLOAT, TensorProto.DOUBLE):
        for field in ("raw_data", "float_data", "double_data"):
            tensor.ClearField(field)


def _check_operator(where: str, node: onnx.NodeProto) -> None:
    if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
        name = f"{node.domain[:40]}:{node.op_type[:40]}" if node.domain else node.op_type[:40]
        raise _broken(where, f"operator {name} is not in the list of accepted operators")


def _check_parts(model: onnx.ModelProto) -> None:
    """Refuse parts of a model that a network of this project does not need."""
    nodes = model.graph.node
    attributes = [attribute for node in nodes for attribute in node.attribute]
    sub_graphs = any(attribute.HasField("g") or attribute.graphs for attribute in attributes)
    sparse = any(attribute.HasField("sparse_tensor") or attribute.sparse_tensors for attribute in attributes)
    for present, parts in (
        (model.functions, "functions"),
        (model.training_info, "training information"),
        (model.graph.sparse_initializer or sparse, "sparse tensors"),
        (sub_graphs, "sub-graphs"),
        (len(nodes) > MAX_NODES, f"more than {MAX_NODES} nodes"),
        (any(opset.domain not in ("", "ai.onnx") for opset in model.opset_import), "operators of another domain"),
    ):
        if present:
            raise _broken("model", f"{parts} are not accepted")


def _check_shapes(model: onnx.ModelProto) -> GraphSize:
    """Check that every intermediate tensor has a bounded shape that is known before the graph runs. Return the sums."""
    del model.graph.value_info[:]  # shapes that the file declares are not trusted
    try:
        inferred = onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True)
    except Exception as error:  # the errors of the library and of its C++ part share no other base class
        raise _broken("model.graph", "its shapes do not fit together") from error
    shapes = {value.name: value.type for value in inferred.graph.value_info}
    shapes |= {value.name: value.type for value in (*inferred.graph.input, *inferred.graph.output)}
    for place, node in enumerate(inferred.graph.node):
        for output in filter(None, node.output):
            _check_shape(f"model.graph.node[{place}] {node.op_type}", node.op_type, shapes.get(output))
    for value in inferred.graph.input:
        _check_shape(f"model.graph.input {value.name}", "", value.type)
    return _size([shapes[output] for node in inferred.graph.node for output in filter(None, node.output)])


def _size(tensors: Sequence[TypeProto]) -> GraphSize:
    """Return the sums over tensors. A free size that is no number of contexts counts as one of rows."""
    rows = contexts = 0
    for kind in tensors:
        dimensions = kind.tensor_type.shape.dim
        fixed = math.prod(dimension.dim_value for dimension in dimensions if dimension.HasField("dim_value"))
        size = fixed * ITEM_BYTES.get(kind.tensor_type.elem_type, _LARGEST_ITEM)
        free = {dimension.dim_param for dimension in dimensions if not dimension.HasField("dim_value")}
        if free == {_CONTEXTS}:
            contexts += size
        elif free:
            rows += size
    return GraphSize(rows, contexts)


def _check_shape(where: str, operator: str, kind: TypeProto | None) -> None:
    if kind is None or not kind.tensor_type.HasField("shape"):
        raise _broken(where, "its shape is unknown before it runs")
    dimensions = kind.tensor_type.shape.dim
    free = [dimension for dimension in dimensions if not dimension.HasField("dim_value")]
    if len(free) > MAX_FREE_DIMENSIONS:
        raise _broken(where, f"{len(free)} free sizes in one tensor, more than {MAX_FREE_DIMENSIONS}")
    if operator == "Expand" and any(not part.dim_param or part.dim_param.startswith("unk__") for part in free):
        raise _broken(where, "expands to a size that is unknown before it runs")
    elements = math.prod(dimension.dim_value for dimension in dimensions if dimension.HasField("dim_value"))
    if elements > MAX_ELEMENTS_PER_ROW:
        raise _broken(where, f"{elements:.3g} elements per row, more than {MAX_ELEMENTS_PER_ROW}")
