"""What a graph may hold, checked before onnxruntime sees it: nothing outside the file, nothing huge, no loops.

onnxruntime opens files that a tensor names, also when the model comes as bytes, and evaluates constants while it loads.
So a model is first parsed with the ONNX library and walked as a tree of messages: a tensor is found wherever it hangs
(initialisers, sparse ones, attributes, sub-graphs, functions, whatever a later format adds), and what is not on a list
is refused. Shapes are then inferred, without evaluating anything, and bounded. Training and serving both come through
here, so that no model is trained that cannot be served.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final

import onnx
from google.protobuf.message import DecodeError, Message
from google.protobuf.unknown_fields import UnknownFieldSet
from onnx import TensorProto, TypeProto, ValueInfoProto

from service.errors import BrokenModelError

# Arithmetic on tensors whose shapes follow from their inputs' shapes. Left out on purpose: control flow and sub-graphs,
# random numbers, strings, sequences, image decoding, and what makes a size out of a value (ConstantOfShape, Tile,
# Range, Pad, Resize, OneHot), except Expand, whose target must be known before anything runs.
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
MAX_NODES: Final = 10_000
MAX_CONSTANT_ELEMENTS: Final = 1 << 22  # of one tensor that the file holds
MAX_ELEMENTS_PER_PUSH: Final = 1 << 20  # of one tensor on the way, for one push of one object
MAX_FREE_DIMENSIONS: Final = 1  # n or g, never both in one tensor


def inspect_graph(model: bytes) -> None:
    """Accept a graph, or say where it breaks which rule.

    Raises:
        BrokenModelError: it is no ONNX model, or holds what no model may hold.
    """
    try:
        parsed = onnx.ModelProto.FromString(model)
    except DecodeError as error:
        raise BrokenModelError("model.onnx: not an ONNX model") from error
    for where, message in _walk(parsed, "model"):
        if isinstance(message, TensorProto):
            _check_tensor(where, message)
            _forget_numbers(message)
        elif isinstance(message, onnx.NodeProto):
            _check_operator(where, message)
    _check_parts(parsed)
    _check_shapes(parsed)


def _refuse(where: str, what: str) -> BrokenModelError:
    return BrokenModelError(f"model.onnx: {where[:200]}: {what}")


def _walk(message: Message, where: str) -> Iterator[tuple[str, Message]]:
    """Every message below a message, whatever field it hangs on; a field that ONNX does not know is refused."""
    pending = [(where, message)]
    while pending:
        where, message = pending.pop()
        if len(UnknownFieldSet(message)):
            raise _refuse(where, "a field that ONNX does not know")
        yield where, message
        if isinstance(message, ValueInfoProto):
            _check_value(where, message)
            continue
        for field, value in message.ListFields():
            if field.message_type is not None:
                parts = list(value) if field.is_repeated else [value]
                pending += [(f"{where}.{field.name}[{place}]", part) for place, part in enumerate(parts)]


def _check_value(where: str, value: ValueInfoProto) -> None:
    """What a file says of a tensor's type: three of four messages of a graph, so that it is not walked but compared."""
    if value.type.WhichOneof("value") not in ("tensor_type", None):
        raise _refuse(where, "not a tensor")
    size = value.ByteSize()
    value.DiscardUnknownFields()
    if value.ByteSize() != size:
        raise _refuse(where, "a field that ONNX does not know")


def _check_tensor(where: str, tensor: TensorProto) -> None:
    if tensor.data_location != TensorProto.DEFAULT or tensor.external_data:
        raise _refuse(where, "external data: a model is one file")
    if tensor.data_type not in ITEM_BYTES:
        raise _refuse(where, f"data type {tensor.data_type} is not taken")
    if any(size < 0 for size in tensor.dims):
        raise _refuse(where, "a negative size")
    elements = math.prod(tensor.dims)
    if elements > MAX_CONSTANT_ELEMENTS:
        raise _refuse(where, f"declares {elements:.3g} elements, more than {MAX_CONSTANT_ELEMENTS}")
    fields = (tensor.float_data, tensor.double_data, tensor.int32_data, tensor.int64_data, tensor.uint64_data)
    held = sum(map(len, fields)) + len(tensor.raw_data) / ITEM_BYTES[tensor.data_type]
    if held != elements:
        raise _refuse(where, f"declares {elements} elements and holds {held:g}")


def _forget_numbers(tensor: TensorProto) -> None:
    """No size is made of numbers with a fraction, and copying them at every step takes longest of all."""
    if tensor.data_type in (TensorProto.FLOAT, TensorProto.DOUBLE):
        for field in ("raw_data", "float_data", "double_data"):
            tensor.ClearField(field)


def _check_operator(where: str, node: onnx.NodeProto) -> None:
    if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
        name = f"{node.domain[:40]}:{node.op_type[:40]}" if node.domain else node.op_type[:40]
        raise _refuse(where, f"operator {name} is not on the list")


def _check_parts(model: onnx.ModelProto) -> None:
    """No part that a network of ours has no use for."""
    nodes = model.graph.node
    attributes = [attribute for node in nodes for attribute in node.attribute]
    sub_graphs = any(attribute.HasField("g") or attribute.graphs for attribute in attributes)
    sparse = any(attribute.HasField("sparse_tensor") or attribute.sparse_tensors for attribute in attributes)
    for present, what in (
        (model.functions, "functions"),
        (model.training_info, "training information"),
        (model.graph.sparse_initializer or sparse, "sparse tensors"),
        (sub_graphs, "sub-graphs"),
        (len(nodes) > MAX_NODES, f"more than {MAX_NODES} nodes"),
        (any(opset.domain not in ("", "ai.onnx") for opset in model.opset_import), "operators of another domain"),
    ):
        if present:
            raise _refuse("model", f"{what} are not taken")


def _check_shapes(model: onnx.ModelProto) -> None:
    """Every tensor on the way has a shape that can be told before anything runs, and is not huge."""
    del model.graph.value_info[:]  # what the file says of itself does not count
    try:
        inferred = onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True)
    except Exception as error:  # the library's own errors, and those of its C++ side, share no root below this
        raise _refuse("model.graph", "its shapes do not fit together") from error
    shapes = {value.name: value.type for value in inferred.graph.value_info}
    shapes |= {value.name: value.type for value in (*inferred.graph.input, *inferred.graph.output)}
    for place, node in enumerate(inferred.graph.node):
        for output in filter(None, node.output):
            _check_shape(f"model.graph.node[{place}] {node.op_type}", node.op_type, shapes.get(output))
    for value in inferred.graph.input:
        _check_shape(f"model.graph.input {value.name}", "", value.type)


def _check_shape(where: str, operator: str, kind: TypeProto | None) -> None:
    if kind is None or not kind.tensor_type.HasField("shape"):
        raise _refuse(where, "no shape can be told before it runs")
    dimensions = kind.tensor_type.shape.dim
    free = [dimension for dimension in dimensions if not dimension.HasField("dim_value")]
    if len(free) > MAX_FREE_DIMENSIONS:
        raise _refuse(where, f"{len(free)} free sizes in one tensor, more than {MAX_FREE_DIMENSIONS}")
    if operator == "Expand" and any(not part.dim_param or part.dim_param.startswith("unk__") for part in free):
        raise _refuse(where, "expands to a size that cannot be told before it runs")
    elements = math.prod(dimension.dim_value for dimension in dimensions if dimension.HasField("dim_value"))
    if elements > MAX_ELEMENTS_PER_PUSH:
        raise _refuse(where, f"{elements:.3g} elements per push, more than {MAX_ELEMENTS_PER_PUSH}")
