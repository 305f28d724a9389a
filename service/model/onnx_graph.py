"""Checks of an ONNX graph before onnxruntime loads it: no data outside the file, no huge tensors, no loops.

onnxruntime opens files that a tensor names, even when the model comes as bytes, and evaluates constants while it loads.
So a model is first parsed with the ONNX library and walked as a tree of messages. The walk finds a tensor in any field
(initialisers, sparse ones, attributes, sub-graphs, functions, fields that a later format adds). Operators and types
that are not listed here are refused. Shapes are then inferred without evaluating the graph, once for each of a few
numbers of rows and contexts. The differences tell how a tensor grows, so its size is bounded for any number, and so is
the sum of all.

Parsing and inference may take any time and memory for a hostile file, so they run in a process of their own, which
``service.model.trial`` starts and limits.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import onnx
from google.protobuf.message import DecodeError, Message
from google.protobuf.unknown_fields import UnknownFieldSet
from onnx import TensorProto, TypeProto, ValueInfoProto

from service.errors import BrokenModelError
from service.model.tensors import GraphSize

# Arithmetic on tensors whose shapes follow from the shapes of their inputs. Left out on purpose: control flow,
# sub-graphs, random numbers, strings, sequences, image decoding, and operators that turn a value into a size
# (ConstantOfShape, Tile, Range, Pad, Resize, OneHot). Expand is listed, but its target must be known before it runs.
OPERATORS: Final = frozenset(
    """
    Abs Add And ArgMin AveragePool BatchNormalization Cast Ceil Clip Concat Constant Conv Cos Div Dropout Elu Equal
    Erf Exp Expand Flatten Floor Gather GatherElements GatherND Gelu Gemm GlobalAveragePool Greater GreaterOrEqual
    Identity InstanceNormalization LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max MaxPool
    Mean Min Mul Neg Not Or Pow Reciprocal ReduceL2 ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum Relu Reshape
    Round Shape Sigmoid Sign Sin Slice Softmax Softplus Split Sqrt Squeeze Sub Sum Tanh Transpose Unsqueeze Where
    Xor
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
MAX_CONSTANT_ELEMENTS: Final = 1 << 22  # of one tensor in the file
MAX_ELEMENTS_PER_ROW: Final = 1 << 20  # of one intermediate tensor, for one row and one context
MAX_BYTES_PER_ROW: Final = 16 << 20  # of all intermediate tensors, for one row and one context
MAX_FIXED_BYTES: Final = 16 << 20  # of all computed constants, beside twice the size of the file
MAX_MESSAGES: Final = 200_000  # of all kinds: nodes, attributes, tensors, declared types
MAX_STRUCTURE_BYTES: Final = 4 << 20  # of the file without its tensors: nodes, names, descriptions
MAX_FREE_SIZES: Final = 2  # numbers of rows and of contexts
_COUNTS: Final = (64, 48)  # of rows and contexts, for which shapes are inferred. Then each is doubled


def inspect_graph(model: bytes) -> GraphSize:
    """Check a graph against every rule of this module, and return its size.

    Raises:
        BrokenModelError: the bytes are not an ONNX model, or the graph breaks a rule. The message names the place.
    """
    try:
        parsed = onnx.ModelProto.FromString(model)
    except DecodeError as error:
        raise BrokenModelError("model.onnx: not an ONNX model") from error
    structure = len(model)
    for count, (where, message) in enumerate(_walk(parsed, "model")):
        if count == MAX_MESSAGES:
            raise _broken("model", f"more than {MAX_MESSAGES} parts")
        if isinstance(message, TensorProto):
            structure -= message.ByteSize()
            _check_tensor(where, message)
            _clear_values(message)
        elif isinstance(message, onnx.NodeProto):
            _check_operator(where, message)
    if structure > MAX_STRUCTURE_BYTES:
        raise _broken("model", f"{structure} bytes beside its tensors, more than {MAX_STRUCTURE_BYTES}")
    _check_parts(parsed)
    return _check_sizes(parsed, MAX_FIXED_BYTES + 2 * len(model))


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


def _check_sizes(model: onnx.ModelProto, fixed_limit: int) -> GraphSize:
    """Check that every intermediate tensor has a bounded shape that is known before the graph runs, and the sums."""
    del model.graph.value_info[:]  # shapes that the file declares are not trusted
    for value in model.graph.output:
        value.type.tensor_type.ClearField("shape")
    free = _free_sizes(model)
    counts = dict(zip(free, _COUNTS, strict=False))
    cases = [counts, *({**counts, name: 2 * counts[name]} for name in free)]
    inferred = [_infer_shapes(model, case) for case in cases]
    fixed_bytes, free_bytes = 0, dict.fromkeys(free, 0)
    for place, node in enumerate(model.graph.node):
        where = f"model.graph.node[{place}] {node.op_type}"
        for output in filter(None, node.output):
            kinds = [shapes.get(output) for shapes in inferred]
            size = _Growth.of(where, kinds, counts)
            fixed_bytes += size.fixed * _item_bytes(kinds[0])
            for name in free:
                free_bytes[name] += size.each[name] * _item_bytes(kinds[0])
    if sum(free_bytes.values()) > MAX_BYTES_PER_ROW:
        total = sum(free_bytes.values())
        raise _broken("model.graph", f"{total:.3g} bytes of tensors per row, more than {MAX_BYTES_PER_ROW}")
    if fixed_bytes > fixed_limit:
        raise _broken("model.graph", f"{fixed_bytes:.3g} bytes of computed constants, more than {fixed_limit}")
    rows, contexts, *_ = (*free_bytes.values(), 0, 0)
    return GraphSize(rows, contexts)


def _free_sizes(model: onnx.ModelProto) -> list[str]:
    """Return the names of the free sizes of the inputs in order: that of rows, then that of contexts."""
    found: dict[str, None] = {}
    for value in model.graph.input:
        if not value.type.tensor_type.HasField("shape"):
            raise _broken(f"model.graph.input {value.name}", "its shape is unknown before it runs")
        for dimension in value.type.tensor_type.shape.dim:
            if not dimension.HasField("dim_value"):
                found[dimension.dim_param] = None
    if len(found) > MAX_FREE_SIZES or "" in found:
        raise _broken("model.graph.input", f"free sizes have at most {MAX_FREE_SIZES} names, and none is without one")
    return list(found)


def _infer_shapes(model: onnx.ModelProto, counts: Mapping[str, int]) -> dict[str, TypeProto]:
    """Return the type of every tensor for these numbers of rows and contexts."""
    sized = onnx.ModelProto()
    sized.CopyFrom(model)
    for value in sized.graph.input:
        for dimension in value.type.tensor_type.shape.dim:
            if dimension.dim_param:
                dimension.dim_value = counts[dimension.dim_param]
    try:
        inferred = onnx.shape_inference.infer_shapes(sized, strict_mode=True, data_prop=True)
    except MemoryError:
        raise
    except Exception as error:  # the errors of the library and of its C++ part share no other base class
        raise _broken("model.graph", "its shapes do not fit together") from error
    return {value.name: value.type for value in (*inferred.graph.value_info, *inferred.graph.output)}


@dataclass(frozen=True)
class _Growth:
    """Elements of a tensor: those that are always there, and those of each row or context."""

    fixed: int
    each: Mapping[str, int]

    @classmethod
    def of(cls, where: str, kinds: list[TypeProto | None], counts: Mapping[str, int]) -> "_Growth":
        """Compare the sizes of a tensor for some counts, and for each count doubled in turn.

        Raises:
            BrokenModelError: a size is unknown, too large, or grows in another way than with one count.
        """
        least, *doubled = (_elements(where, kind) for kind in kinds)
        each = {name: (more - least) // counts[name] for name, more in zip(counts, doubled, strict=True)}
        fixed = least - sum(counts[name] * share for name, share in each.items())
        if sum(share != 0 for share in each.values()) > 1:
            raise _broken(where, "2 free sizes in one tensor, more than 1")
        if fixed < 0 or any(share < 0 for share in each.values()):
            raise _broken(where, "its size does not grow evenly with the number of rows")
        elements = fixed + sum(each.values())
        if elements > MAX_ELEMENTS_PER_ROW:
            raise _broken(where, f"{elements:.3g} elements per row, more than {MAX_ELEMENTS_PER_ROW}")
        return cls(fixed, each)


def _elements(where: str, kind: TypeProto | None) -> int:
    if kind is None or not kind.tensor_type.HasField("shape"):
        raise _broken(where, "its shape is unknown before it runs")
    dimensions = kind.tensor_type.shape.dim
    if not all(dimension.HasField("dim_value") and dimension.dim_value >= 0 for dimension in dimensions):
        raise _broken(where, "a size that is unknown before it runs")
    return math.prod(dimension.dim_value for dimension in dimensions)


def _item_bytes(kind: TypeProto | None) -> int:
    return ITEM_BYTES.get(kind.tensor_type.elem_type if kind else 0, max(ITEM_BYTES.values()))
