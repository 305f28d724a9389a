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


def two_free_sizes() -> ModelProto:
    """Multiply a column by a row of as many numbers: the product grows with the square of the rows."""
    return with_nodes(
        helper.make_node("ReduceSum", ["pusher", "axes"], ["column"], keepdims=1),
        helper.make_node("Transpose", ["column"], ["row"], perm=[1, 0]),
        helper.make_node("Mul", ["column", "row"], ["square"]),
        constants={"axes": np.array([1], dtype=np.int64)},
    )


def nameless_size() -> ModelProto:
    """Leave the name of the number of rows out."""
    model = valid_graph()
    model.graph.input[0].type.tensor_type.shape.dim[0].ClearField("dim_param")
    return model


def doubled_numbers() -> ModelProto:
    """Join integers with themselves, 40 times. Shape inference follows the values of integers."""
    chain = [
        helper.make_node("Concat", [f"c{place}"] * 2, [f"c{place + 1}"], axis=0, name="n" * 250) for place in range(40)
    ]
    sized = helper.make_node("Reshape", ["tenth", "c40"], ["huge"])
    return with_nodes(*chain, sized, constants={"c0": np.array([1, 1], dtype=np.int64)})


def doubled_rows() -> ModelProto:
    """Join the rows with themselves, 30 times, so that one row becomes 2**30."""
    chain = [helper.make_node("Concat", [f"r{place}"] * 2, [f"r{place + 1}"], axis=0) for place in range(30)]
    return with_nodes(helper.make_node("Neg", ["pusher"], ["r0"]), *chain)


def many_expansions() -> ModelProto:
    """Expand one number to 4 MiB, 600 times. onnxruntime evaluates constants while it loads."""
    nodes = [helper.make_node("Expand", ["tenth", "to"], [f"e{place}"]) for place in range(600)]
    return with_nodes(*nodes, constants={"to": np.array([1 << 20], dtype=np.int64)})


def many_live_tensors() -> ModelProto:
    """Widen each row to 4 MiB, 200 times, and use all of them at the end."""
    nodes = [helper.make_node("MatMul", ["pusher", "wide"], [f"w{place}"]) for place in range(200)]
    total = helper.make_node("Sum", [f"w{place}" for place in range(200)], ["total"])
    return with_nodes(*nodes, total, constants={"wide": np.ones((3, 1 << 20), dtype=np.float32)})


def used(model: ModelProto, result: str) -> ModelProto:
    """Add a result with one number per row to the std, so that onnxruntime does not drop the nodes that compute it."""
    model.graph.node[1].output[0] = "std0"
    model.graph.node.append(helper.make_node("Add", ["std0", result], ["std"]))
    return model


def slow_push() -> ModelProto:
    """Widen each row to a matrix of 4 MiB, and multiply it by a square matrix: 2e9 multiplications."""
    return used(
        with_nodes(
            helper.make_node("MatMul", ["pusher", "wide"], ["row"]),
            helper.make_node("Reshape", ["row", "to"], ["matrix"]),
            helper.make_node("MatMul", ["matrix", "square"], ["product"]),
            helper.make_node("ReduceSum", ["product", "axes"], ["sum"], keepdims=0),
            helper.make_node("Unsqueeze", ["sum", "last"], ["result"]),
            constants={
                "wide": np.ones((3, 1 << 20), dtype=np.float32),
                "to": np.array([-1, 512, 2048], dtype=np.int64),
                "square": np.ones((2048, 2048), dtype=np.float32),
                "axes": np.array([1, 2], dtype=np.int64),
                "last": np.array([1], dtype=np.int64),
            },
        ),
        "result",
    )


def slow_piece() -> ModelProto:
    """Convolve all rows with themselves: a push is fast, and the time grows with the square of the rows."""
    return used(
        with_nodes(
            helper.make_node("MatMul", ["pusher", "wide"], ["widened"]),
            helper.make_node("Reshape", ["widened", "flat"], ["signal"]),
            helper.make_node("MatMul", ["pusher", "half"], ["halved"]),
            helper.make_node("Reshape", ["halved", "flat"], ["weight"]),
            helper.make_node("Conv", ["signal", "weight"], ["all"]),
            helper.make_node("ReduceMax", ["all"], ["result"], keepdims=0),
            constants={
                "wide": np.ones((3, 128), dtype=np.float32),
                "half": np.full((3, 64), 1e-6, dtype=np.float32),
                "flat": np.array([1, 1, -1], dtype=np.int64),
            },
        ),
        "result",
    )


def sizes_from_a_table() -> ModelProto:
    """Expand a number to a size that a table gives for the number of rows: small for few, and huge for a piece."""
    table = np.arange(2000, dtype=np.int64)
    table[1000:] = 1 << 29
    return used(
        with_nodes(
            helper.make_node("Shape", ["pusher"], ["shape"]),
            helper.make_node("Gather", ["shape", "first"], ["rows"]),
            helper.make_node("Gather", ["table", "rows"], ["size"]),
            helper.make_node("Expand", ["tenth", "size"], ["huge"]),
            helper.make_node("ReduceMax", ["huge"], ["result"], keepdims=0),
            constants={"first": np.array([0], dtype=np.int64), "table": table},
        ),
        "result",
    )


def slow_load() -> ModelProto:
    """Multiply each row by one matrix, 1,200 times. onnxruntime arranges it anew for each while it loads."""
    chain = [helper.make_node("MatMul", [f"s{place}", "square"], [f"s{place + 1}"]) for place in range(1200)]
    return used(
        with_nodes(
            helper.make_node("MatMul", ["pusher", "in"], ["s0"]),
            *chain,
            helper.make_node("ReduceSum", ["s1200", "axes"], ["result"]),
            constants={
                "in": np.ones((3, 1024), dtype=np.float32),
                "square": np.ones((1024, 1024), dtype=np.float32),
                "axes": np.array([1], dtype=np.int64),
            },
        ),
        "result",
    )


def long_names() -> ModelProto:
    """Give a thousand tensors names of five thousand letters."""
    return with_nodes(*(helper.make_node("Neg", ["pusher"], [f"{place:05000}"]) for place in range(1000)))


def gathered_rows() -> ModelProto:
    """Take a million copies of the first row."""
    index = np.zeros(1 << 20, dtype=np.int64)
    return with_nodes(helper.make_node("Gather", ["pusher", "index"], ["rows"]), constants={"index": index})


def wide_padding() -> ModelProto:
    """Pad a row with two billion numbers."""
    return with_nodes(
        helper.make_node("Unsqueeze", ["pusher", "axis"], ["signal"]),
        helper.make_node("Conv", ["signal", "weight"], ["wide"], pads=[1 << 30, 1 << 30]),
        constants={"axis": np.array([1]), "weight": np.ones((1, 1, 3), dtype=np.float32)},
    )


def many_parts() -> ModelProto:
    """Give one node a quarter of a million empty attributes."""
    model = valid_graph()
    model.graph.node[0].attribute.extend(AttributeProto() for _ in range(250_000))
    return model


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
    "secret sizes": (reshape_secretly, "unknown before it runs"),
    "two free sizes": (two_free_sizes, "its size does not grow evenly"),
    "a nameless free size": (nameless_size, "free sizes have at most 2 names"),
    "chain of doubled numbers": (
        doubled_numbers,
        "more memory than is allowed|in the memory that is allowed|unknown before it runs",
    ),
    "chain of doubled rows": (doubled_rows, "elements per row, more than 1048576"),
    "many expansions": (many_expansions, "bytes of computed constants, more than"),
    "many live tensors": (many_live_tensors, "bytes of tensors per row, more than"),
    "slow push": (slow_push, "a push takes .* s of processor time; at most"),
    "slow piece": (slow_piece, "a call of 1024 pushes takes .* s of processor time; at most|more processor time than"),
    "sizes from a table": (sizes_from_a_table, "not in the memory that is allowed"),
    "slow load": (slow_load, "loading it takes .* s of processor time; at most|memory that is allowed"),
    "long names": (long_names, "bytes beside its tensors, more than 4194304"),
    "gathered rows": (gathered_rows, "elements per row, more than 1048576"),
    "wide padding": (wide_padding, "elements per row, more than 1048576"),
    "too many parts": (many_parts, "more than 200000 parts"),
    "too many nodes": (many_nodes, "more than 10000 nodes"),
    "shapes that do not fit": (
        lambda: with_nodes(helper.make_node("MatMul", ["pusher", "odd"], ["x"]), constants={"odd": np.ones((7, 1))}),
        "shapes do not fit",
    ),
}
