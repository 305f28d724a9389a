"""Graphs of every kind of context for tests: the versions that ship, and a small graph of shapes.

The shape graph keeps the laws of pushing in a few nodes: a disc of the object's size stands for its outline. What is
left of a push after it meets the disc moves the object along, an offset turns it, and a push that misses leaves it
exactly where it is. Twice the size and twice the push are twice the answer.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from onnx import NodeProto, TensorProto, helper, numpy_helper

from service.inference.snapshot import DEFAULT_MODELS
from service.model.manifest import SelfCheck
from service.model.predictor import OnnxPredictor
from service.model.self_check import flattened
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import INDICATOR_LENGTH, MAX_SUPPORT, VISUAL_SIZE, SupportContext
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from service.pushing.outlines import Outline
from service.pushing.shape_context import ShapeContext
from service.registry.registry import Registry
from tests.fakes import draft_manifest

BOX: Final = Outline.of([(0.06, 0.04), (-0.06, 0.04), (-0.06, -0.04), (0.06, -0.04)])
L_SHAPE: Final = Outline.of([(0.05, -0.02), (0.05, 0.01), (0.01, 0.01), (0.01, 0.05), (-0.02, 0.05), (-0.02, -0.02)])
_FAR: Final = 3.0  # of a push or an outline, in sizes: as far as the graph vouches for


@cache
def shape_graph() -> bytes:
    """Return a small graph of shapes, see above."""
    nodes: list[NodeProto] = []
    constants: dict[str, np.ndarray] = {}

    def constant(value: float | list[int]) -> str:
        """Store a constant and return its name."""
        name = f"constant_{value}"
        constants[name] = np.array(value, dtype=np.int64 if isinstance(value, list) else np.float32)
        return name

    def add(operator: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Add a node and return the name of its output."""
        output = name or f"{operator}_{len(nodes)}"
        nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def column(tensor: str, place: int) -> str:
        """Return a column (n, 1)."""
        return add("Slice", tensor, constant([place]), constant([place + 1]), constant([1]))

    body = add("Gather", "body", "context_index", axis=0)
    size, radius = column(body, 2), add("Div", column(body, 9), column(body, 2))
    cos, sin = (add(operator, column("pusher", 2)) for operator in ("Cos", "Sin"))
    x, y = (add("Div", add("Sub", column("pusher", place), column(body, place)), size) for place in (0, 1))
    ahead = add("Neg", add("Add", add("Mul", x, cos), add("Mul", y, sin)))
    aside = add("Sub", add("Mul", y, cos), add("Mul", x, sin))
    length = add("Div", column("pusher", 3), size)
    reach = add("Add", constant(1.0), radius)
    room = add("Max", add("Sub", add("Mul", reach, reach), add("Mul", aside, aside)), constant(0.0))
    left = add("Sub", length, add("Sub", ahead, add("Sqrt", room)))
    hits = add("And", add("Greater", room, constant(0.0)), add("Greater", ahead, constant(0.0)))
    left = add("Where", hits, add("Max", left, constant(0.0)), constant(0.0))
    left = add("Min", left, length)
    filled = add("ReduceMean", "silhouette", constant([1, 2, 3]), keepdims=0)  # (g,)
    filled = add("Unsqueeze", add("Gather", filled, "context_index"), constant([1]))
    along = add("Mul", add("Mul", left, size), add("Add", constant(0.9), add("Mul", constant(0.1), filled)))
    turn = add("Neg", add("Mul", constant(0.5), add("Mul", left, aside)))
    add("Concat", add("Mul", along, cos), add("Mul", along, sin), turn, name="mean", axis=1)
    spread = add("Add", add("Mul", constant(0.1), left), constant(0.01))
    metres = add("Mul", spread, size)
    add("Concat", metres, metres, spread, name="std", axis=1)
    centre = add("Slice", "body", constant([0]), constant([2]), constant([1]))
    offset = add("Sub", "outline", add("Unsqueeze", centre, constant([1])))
    far = add("ReduceMax", add("ReduceL2", offset, constant([2]), keepdims=0), constant([1]), keepdims=1)  # (g, 1)
    far = add("Div", add("Gather", far, "context_index", axis=0), size)
    add("Concat", *(add("Div", each, constant(_FAR)) for each in (length, far)), name="unfamiliarity", axis=1)

    types = {"float32": TensorProto.FLOAT, "int64": TensorProto.INT64}
    given, found = (
        [helper.make_tensor_value_info(tensor.name, types[tensor.dtype], list(tensor.shape)) for tensor in tensors]
        for tensors in (expected_inputs(ContextKind.SHAPE), OUTPUTS_WITH_UNFAMILIARITY)
    )
    stored = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    graph = helper.make_graph(nodes, "shapes", given, found, initializer=stored)
    opsets = [helper.make_opsetid("", 18)]
    model: bytes = helper.make_model(graph, opset_imports=opsets, ir_version=10).SerializeToString()
    return model


def shape_tensors(*contexts: ShapeContext) -> tuple[FloatArray, ...]:
    """Return the tensors of objects, (g, ...) each."""
    return tuple(map(np.stack, zip(*(context.tensors() for context in contexts), strict=True)))


def publish_shapes(registry: Registry, name: str = "push-shape") -> int:
    """Publish the small graph of shapes as the champion of a model, and return its version."""
    pusher = np.array([[-0.1, 0.01, 0.1, 0.05], [0.0, 0.2, 0.0, 0.05]], dtype=np.float32)  # the second misses
    contexts, index = shape_tensors(ShapeContext(BOX), ShapeContext(L_SHAPE)), np.array([0, 1])
    predictor = OnnxPredictor(shape_graph(), expected_inputs(ContextKind.SHAPE), OUTPUTS_WITH_UNFAMILIARITY)
    mean, std, _ = predictor.predict(pusher, contexts, index)
    check = SelfCheck(pusher.tolist(), flattened(contexts), index.tolist(), mean.tolist(), std.tolist(), 1e-4)
    manifest = replace(draft_manifest(name, ContextKind.SHAPE), self_check=check)
    version = registry.publish(manifest, shape_graph(), f"# {name}\n").version
    registry.point_alias(name, "champion", version)
    return version


def served_predictor(project_root: Path, kind: ContextKind) -> OnnxPredictor:
    """Return the predictor of the last version that ships of a kind."""
    registry, name = Registry(project_root / "models"), DEFAULT_MODELS[kind]
    verified = registry.read(name, registry.versions(name)[-1])
    return OnnxPredictor(verified.model, verified.manifest.inputs, verified.manifest.outputs)


def random_question(
    kind: ContextKind, pushes: int, contexts: int
) -> tuple[FloatArray, tuple[FloatArray, ...], IndexArray | None]:
    """Return random pushes, contexts, and an index that refers to some of the contexts in any order."""
    rng = np.random.default_rng(pushes + contexts)
    pushers = rng.uniform([-0.1, -0.1, -3.1], [0.1, 0.1, 3.1], (pushes, 3)).astype(np.float32)
    if kind is ContextKind.NONE:
        return pushers, (), None
    index = rng.integers(contexts, size=pushes)
    if kind is ContextKind.SHAPE:
        lengths = rng.uniform(0.01, 0.1, (pushes, 1)).astype(np.float32)
        scales = rng.uniform(0.5, 1.5, contexts)
        few = [ShapeContext(Outline.of(BOX.corners * scale)).tensors() for scale in scales[:7]]
        tensors = tuple(np.stack(part)[np.arange(contexts) % len(few)] for part in zip(*few, strict=True))
        return np.hstack([pushers, lengths]), tensors, index
    if kind is ContextKind.SUPPORT:
        return pushers, support_tensors(rng, contexts), index
    shape = (INDICATOR_LENGTH,) if kind is ContextKind.INDICATOR else (1, VISUAL_SIZE, VISUAL_SIZE)
    return pushers, (rng.random((contexts, *shape), dtype=np.float32),), index


def support_tensors(rng: np.random.Generator, contexts: int) -> tuple[FloatArray, ...]:
    """Return the tensors of random supports of 1 to 50 pushes, (g, ...) each."""
    supports = []
    for count in rng.integers(1, MAX_SUPPORT + 1, contexts).tolist():
        pushers = rng.uniform([-0.1, -0.1, -3.1], [0.1, 0.1, 3.1], (count, 3))
        supports.append(SupportContext.of(pushers, rng.uniform(-0.03, 0.03, (count, 3))).tensors())
    return tuple(map(np.stack, zip(*supports, strict=True)))


def same_numbers(kind: ContextKind, found: FloatArray, expected: FloatArray) -> bool:
    """Compare predictions of the same rows in two batches, to the bit, and of shapes to rounding."""
    if kind is ContextKind.SHAPE:
        return bool(np.allclose(found, expected, rtol=1e-4, atol=1e-6))
    return found.tobytes() == expected.tobytes()
