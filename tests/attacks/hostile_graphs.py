"""Hostile ONNX graphs, each with the refusal that it must get. All are changes of one small valid graph."""

from collections.abc import Callable

import numpy as np
import onnx
from onnx import AttributeProto, ModelProto, TensorProto, helper, numpy_helper

EXTERNAL = "external data: a model is one file"


def valid_graph() -> ModelProto:
    """Build a valid graph with the tensors of a model without context: mean is 0.1 times the pusher pose."""
    tenth = numpy_helper.from_array(np.array([0.1], dtype=np.float32), "tenth")
    nodes = [helper.make_node("Mul", ["pusher", "tenth"], ["mean"]), helper.make_node("Exp", ["mean"], ["std"])]
    pose = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("pusher", "mean", "std")]
    graph = helper.make_graph(nodes, "graph", pose[:1], pose[1:], initializer=[tenth])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)


def external(name: str = "outside", location: str = "/etc/passwd") -> TensorProto:
    """Build a tensor whose bytes are in another file."""
    tensor = TensorProto(name=name, dims=[1], data_type=TensorProto.FLOAT, data_location=TensorProto.EXTERNAL)
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", location
    return tensor


def undeclared() -> TensorProto:
    """Build a tensor that names another file and declares its data as its own."""
    tensor = external()
    tensor.data_location = TensorProto.DEFAULT
    tensor.raw_data = bytes(4)
    return tensor


def sparse(values: TensorProto) -> onnx.SparseTensorProto:
    """Build a sparse tensor of these values."""
    indices = numpy_helper.from_array(np.zeros(1, dtype=np.int64), "indices")
    return onnx.SparseTensorProto(values=values, indices=indices, dims=[1])


def with_initializer(tensor: TensorProto) -> ModelProto:
    """Add a constant to the valid graph."""
    model = valid_graph()
    model.graph.initializer.append(tensor)
    return model


def with_attribute(**values: object) -> ModelProto:
    """Add an attribute to the first node of the valid graph."""
    model = valid_graph()
    attribute = AttributeProto(name="value")
    for field, value in values.items():
        if isinstance(value, list):
            getattr(attribute, field).extend(value)
        else:
            getattr(attribute, field).CopyFrom(value)
    attribute.type = AttributeProto.TENSOR
    model.graph.node[0].attribute.append(attribute)
    return model


def with_graph_attribute(deep: int) -> ModelProto:
    """Nest sub-graphs this deep, with external data in the innermost."""
    graph = onnx.GraphProto(name="bottom", initializer=[external()])
    for _ in range(deep - 1):
        node = onnx.NodeProto(op_type="If", attribute=[AttributeProto(name="then_branch", g=graph)])
        graph = onnx.GraphProto(name="above", node=[node])
    return with_attribute(g=graph)


def with_function(tensor: TensorProto) -> ModelProto:
    """Add a function that holds a constant."""
    model = valid_graph()
    function = model.functions.add()
    function.name, function.domain = "f", "local"
    constant = helper.make_node("Constant", [], ["c"])
    constant.attribute.append(AttributeProto(name="value", t=tensor, type=AttributeProto.TENSOR))
    function.node.append(constant)
    return model


def with_nodes(*nodes: onnx.NodeProto, constants: dict[str, np.ndarray] | None = None) -> ModelProto:
    """Add nodes whose outputs are not used. onnxruntime evaluates constants regardless."""
    model = valid_graph()
    model.graph.node.extend(nodes)
    for name, value in (constants or {}).items():
        model.graph.initializer.append(numpy_helper.from_array(value, name))
    return model


def in_domain(domain: str) -> ModelProto:
    """Add an operator of another domain, as of a third-party library."""
    model = with_nodes(helper.make_node("Mul", ["pusher", "tenth"], ["other"], domain=domain))
    model.opset_import.append(helper.make_opsetid(domain, 1))
    return model


def training() -> ModelProto:
    """Add training information, which can hold a whole graph."""
    model = valid_graph()
    model.training_info.add().algorithm.CopyFrom(onnx.GraphProto(name="a", initializer=[external()]))
    return model


def sparse_initializer(tensor: TensorProto) -> ModelProto:
    """Add a sparse constant."""
    model = valid_graph()
    model.graph.sparse_initializer.append(sparse(tensor))
    return model


def unknown_field() -> ModelProto:
    """Add a field that no version of ONNX has. A later reader might take it for a file name."""
    model = ModelProto()
    model.ParseFromString(valid_graph().SerializeToString() + b"\xfa\x3f\x04evil")
    return model


def with_unknown_field_in_a_type() -> ModelProto:
    """Add a field that no version of ONNX has to the first dimension of an input."""
    model = valid_graph()
    model.graph.input[0].type.tensor_type.shape.dim[0].MergeFromString(b"\xfa\x3f\x04evil")
    return model


def with_sequence() -> ModelProto:
    """Add a value that is a list of tensors."""
    model = valid_graph()
    model.graph.value_info.append(helper.make_tensor_sequence_value_info("list", TensorProto.FLOAT, ["n", 3]))
    return model


def declares(*dims: int) -> ModelProto:
    """Add a constant that declares more elements than it holds."""
    return with_initializer(TensorProto(name="big", dims=dims, data_type=TensorProto.FLOAT, raw_data=bytes(4)))


def outer_product() -> ModelProto:
    """Multiply two constants of 4 MiB into a product of 2**40 elements."""
    long = np.ones((1 << 20, 1), dtype=np.float32)
    return with_nodes(helper.make_node("MatMul", ["a", "b"], ["c"]), constants={"a": long, "b": long.reshape(1, -1)})


def expand(to: list[int]) -> ModelProto:
    """Expand one number to this shape."""
    return with_nodes(
        helper.make_node("Expand", ["tenth", "to"], ["huge"]), constants={"to": np.array(to, dtype=np.int64)}
    )


def expand_secretly() -> ModelProto:
    """Expand one number to a size that other nodes compute."""
    return with_nodes(
        helper.make_node("Exp", ["power"], ["size"]),
        helper.make_node("Cast", ["size"], ["to"], to=TensorProto.INT64),
        helper.make_node("Expand", ["tenth", "to"], ["huge"]),
        constants={"power": np.array([28.0], dtype=np.float32)},
    )


def reshape_secretly() -> ModelProto:
    """Add a column and a row of 2**20 elements whose sizes are computed."""
    data = np.ones(1 << 20, dtype=np.float32)
    column, row = np.array([-1.0, 1.0], dtype=np.float32), np.array([1.0, -1.0], dtype=np.float32)
    return with_nodes(
        *(helper.make_node("Cast", [name], [f"{name}-size"], to=TensorProto.INT64) for name in ("column", "row")),
        helper.make_node("Reshape", ["data", "column-size"], ["a"]),
        helper.make_node("Reshape", ["data", "row-size"], ["b"]),
        helper.make_node("Add", ["a", "b"], ["huge"]),
        constants={"data": data, "column": column, "row": row},
    )


def many_nodes() -> ModelProto:
    """Add more nodes than any network of this project has."""
    return with_nodes(*(helper.make_node("Neg", ["pusher"], [f"out{place}"]) for place in range(10_001)))


def loop() -> ModelProto:
    """Add a loop of 10**12 iterations."""
    body = helper.make_graph([], "body", [], [])
    return with_nodes(helper.make_node("Loop", ["m", ""], [], body=body), constants={"m": np.array(10**12)})


ATTACKS: dict[str, tuple[Callable[[], ModelProto], str]] = {
    "initialiser": (lambda: with_initializer(external()), EXTERNAL),
    "initialiser with a relative path": (lambda: with_initializer(external(location="../card.md")), EXTERNAL),
    "initialiser that hides it": (lambda: with_initializer(undeclared()), EXTERNAL),
    "sparse initialiser": (lambda: sparse_initializer(external()), EXTERNAL),
    "attribute": (lambda: with_attribute(t=external()), EXTERNAL),
    "attribute list": (lambda: with_attribute(tensors=[external()]), EXTERNAL),
    "sparse attribute": (lambda: with_attribute(sparse_tensor=sparse(external())), EXTERNAL),
    "sparse attribute list": (lambda: with_attribute(sparse_tensors=[sparse(external())]), EXTERNAL),
    "sub-graph": (lambda: with_graph_attribute(1), EXTERNAL),
    "sub-graph of a sub-graph": (lambda: with_graph_attribute(5), "external data|is not in the list"),
    "sub-graph list": (lambda: with_attribute(graphs=[onnx.GraphProto(initializer=[external()])]), EXTERNAL),
    "function": (lambda: with_function(external()), EXTERNAL),
    "training information": (training, EXTERNAL),
    "harmless function": (lambda: with_function(numpy_helper.from_array(np.ones(1, np.float32))), "functions"),
    "harmless sparse tensor": (
        lambda: sparse_initializer(numpy_helper.from_array(np.ones(1, np.float32), "s")),
        "sparse tensors",
    ),
    "harmless sub-graph": (lambda: with_attribute(g=onnx.GraphProto(name="g")), "sub-graphs"),
    "unknown field": (unknown_field, "a field that ONNX does not know"),
    "unknown field in a type": (with_unknown_field_in_a_type, "a field that ONNX does not know"),
    "sequence": (with_sequence, "not a tensor"),
    "operator of another domain": (lambda: in_domain("com.microsoft"), "operator com.microsoft:Mul is not in the list"),
    "loop": (loop, "operator Loop is not in the list"),
    "random numbers": (lambda: with_nodes(helper.make_node("RandomNormal", [], ["r"], shape=[3])), "RandomNormal"),
    "constant of a shape": (
        lambda: with_nodes(helper.make_node("ConstantOfShape", ["s"], ["c"]), constants={"s": np.array([1 << 40])}),
        "operator ConstantOfShape is not in the list",
    ),
    "texts": (
        lambda: with_initializer(TensorProto(name="t", dims=[1], data_type=TensorProto.STRING, string_data=[b"x"])),
        "data type 8 is not accepted",
    ),
    "claims more than it holds": (lambda: declares(1000), "declares 1000 elements and holds 1"),
    "claims 512 MiB": (lambda: declares(1 << 27), "more than 4194304"),
    "sizes that overflow": (lambda: declares(1 << 32, 1 << 32), "more than 4194304"),
    "negative size": (lambda: declares(-1, -1), "a negative size"),
    "outer product": (outer_product, "elements per row, more than 1048576"),
    "expansion": (lambda: expand([1 << 20, 1 << 20]), "elements per row, more than 1048576"),
    "secret expansion": (expand_secretly, "is unknown before it runs"),
    "secret sizes": (reshape_secretly, "free sizes in one tensor|elements per row"),
    "too many nodes": (many_nodes, "more than 10000 nodes"),
    "shapes that do not fit": (
        lambda: with_nodes(helper.make_node("MatMul", ["pusher", "odd"], ["x"]), constants={"odd": np.ones((7, 1))}),
        "shapes do not fit",
    ),
}
