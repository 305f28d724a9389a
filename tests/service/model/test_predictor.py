"""Predictor on onnxruntime, with the models that ship."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from service.errors import BrokenModelError, DeadlineError, PredictionError
from service.model.predictor import OnnxPredictor, Predictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, Gaussians
from service.pushing.contexts import ObjectContext
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from service.pushing.shape_context import ShapeContext
from service.registry.registry import Registry
from service.transport.threads import ThreadPool
from tests.served_graphs import BOX, random_question, same_numbers, served_predictor, shape_tensors

NONE, INDICATOR = ((expected_inputs(kind), OUTPUTS) for kind in (ContextKind.NONE, ContextKind.INDICATOR))
CHAMPION = expected_inputs(ContextKind.INDICATOR), OUTPUTS_WITH_UNFAMILIARITY


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> bytes:
    """Return the graph of the champion."""
    registry = Registry(project_root / "models")
    return registry.read("push-indicator", registry.resolve(ModelReference.parse("push-indicator"))).model


@pytest.fixture(scope="module")
def predictor(shipped: bytes) -> Predictor:
    """Return the predictor of the champion."""
    return OnnxPredictor(shipped, *CHAMPION)


def pushes(count: int) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """Return random pushes of three objects: pusher poses, indicators and indices."""
    rng = np.random.default_rng(0)
    pusher = rng.uniform(-0.08, 0.08, (count, 3)).astype(np.float32)
    context = np.stack(
        [ObjectContext.from_descriptor(name).indicator() for name in ("1a2b3c4a", "4a4a4a4a", "3c3a2B1a")]
    )
    return pusher, (context,), rng.integers(3, size=count)


def test_a_batch_gives_a_mean_and_a_positive_std_per_push(predictor: Predictor) -> None:
    """A prediction has a mean, a positive std and two distances from the domain, in float32, for every push."""
    mean, std, unfamiliarity = predictor.predict(*pushes(7))
    assert unfamiliarity is not None
    assert unfamiliarity.shape == (7, 2)
    assert mean.shape == std.shape == (7, 3)
    assert mean.dtype == std.dtype == unfamiliarity.dtype == np.float32
    assert (std > 0).all()


def test_onnxruntime_sends_no_telemetry(project_root: Path, tmp_path: Path) -> None:
    """A predictor writes no file: telemetry of onnxruntime would create a device name and a queue in the home."""
    code = (
        "import sys; from service.pushing.onnx_interface import OUTPUTS, expected_inputs;"
        "from service.model.predictor import OnnxPredictor; from service.model.tensors import ContextKind;"
        "OnnxPredictor(sys.stdin.buffer.read(), expected_inputs(ContextKind.NONE), OUTPUTS)"
    )
    quiet = {name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))}
    done = subprocess.run(
        [sys.executable, "-B", "-c", code],
        cwd=project_root,
        env=quiet | {"HOME": str(tmp_path)},
        input=Registry(project_root / "models").read("push-none", 1).model,
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert list(tmp_path.rglob("*")) == []


@pytest.mark.parametrize("kind", list(ContextKind))
def test_a_row_does_not_depend_on_the_rows_beside_it(project_root: Path, kind: ContextKind) -> None:
    """A row gets the same bits in a batch of any size and at any place, and of a shape the same to rounding."""
    predictor, rng = served_predictor(project_root, kind), np.random.default_rng(2)
    pusher, contexts, index = random_question(kind, 600, 30)
    together = joined(predictor.predict(pusher, contexts, index))

    for count in [*range(1, 34), 63, 250, 255]:
        rows = rng.choice(600, count, replace=False)
        if index is None:
            found = predictor.predict(pusher[rows], (), None)
        else:
            objects, places = np.unique(index[rows], return_inverse=True)
            found = predictor.predict(pusher[rows], tuple(tensor[objects] for tensor in contexts), places)
        assert same_numbers(kind, joined(found), together[rows]), count


def joined(found: Gaussians) -> np.ndarray:
    """Return all numbers of predictions (n, 6 or 8)."""
    return np.hstack([part for part in found if part is not None])


def test_an_object_that_stays_is_at_zero(project_root: Path) -> None:
    """The mean of a push that misses is 0 and not -0, which people would read as a small number that was cut."""
    pusher = np.array([[0.2, 0.0, 0.1, 0.05], [-0.2, 0.1, 3.0, 0.05]], dtype=np.float32)
    contexts, index = shape_tensors(ShapeContext(BOX)), np.zeros(2, dtype=np.int64)
    mean = served_predictor(project_root, ContextKind.SHAPE).predict(pusher, contexts, index).mean
    assert (mean == 0.0).all()
    assert not np.signbit(mean).any()


@pytest.mark.parametrize("model", [b"", b"not a model", b"\x08\x0a" * 50], ids=["empty", "text", "noise"])
def test_bytes_that_are_no_graph_are_a_broken_model(model: bytes) -> None:
    """Bytes that are not an ONNX graph raise an error of the tree, never one of onnxruntime."""
    with pytest.raises(BrokenModelError, match=r"model\.onnx: (not an ONNX model|onnxruntime refuses)"):
        OnnxPredictor(model, *INDICATOR)


def test_a_graph_with_other_tensors_is_a_broken_model(shipped: bytes) -> None:
    """A graph that takes a context is refused where a graph without context is expected."""
    with pytest.raises(BrokenModelError, match="the inputs are not the expected ones: pusher float32"):
        OnnxPredictor(shipped, *NONE)


def test_a_loaded_model_does_not_keep_its_file(project_root: Path) -> None:
    """A predictor drops the bytes of its file, which would otherwise stay in memory beside the session."""
    model = Registry(project_root / "models").read("push-indicator", 1).model
    before = sys.getrefcount(model)
    predictor = OnnxPredictor(model, *INDICATOR)
    assert sys.getrefcount(model) == before
    del predictor


def test_an_index_beyond_the_contexts_is_a_prediction_error(predictor: Predictor) -> None:
    """An index that onnxruntime refuses raises a prediction error of the tree."""
    pusher, context, index = pushes(2)
    with pytest.raises(PredictionError, match="could not evaluate"):
        predictor.predict(pusher, context, index + 3)


def test_an_output_that_is_no_gaussian_is_a_prediction_error(predictor: Predictor) -> None:
    """A mean that overflows raises a prediction error, and is never returned."""
    pusher, context, index = pushes(1)
    with pytest.raises(PredictionError, match="not finite"):
        predictor.predict(np.full_like(pusher, np.float32(3e38)), context, index)


def slow_graph(steps: int) -> bytes:
    """Build a graph without context that multiplies by a matrix this many times."""
    width = 512
    numbers = np.random.default_rng(3).uniform(-0.0765, 0.0765, (width, width)).astype(np.float32)
    constants = {"in": numbers[:3], "step": numbers, "out": numbers[:, :3], "one": np.ones(1, dtype=np.float32)}
    nodes = [helper.make_node("MatMul", ["pusher", "in"], ["0"])]
    nodes += [helper.make_node("MatMul", [str(step), "step"], [str(step + 1)]) for step in range(steps)]
    nodes += [
        helper.make_node("MatMul", [str(steps), "out"], ["mean"]),
        helper.make_node("Abs", ["mean"], ["distance"]),
        helper.make_node("Add", ["distance", "one"], ["std"]),
    ]
    pose = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("pusher", "mean", "std")]
    stored = [numpy_helper.from_array(array, name) for name, array in constants.items()]
    graph = helper.make_graph(nodes, "graph", pose[:1], pose[1:], initializer=stored)
    opsets = [helper.make_opsetid("", 18)]
    model: bytes = helper.make_model(graph, opset_imports=opsets, ir_version=10).SerializeToString()
    return model


def test_a_run_whose_answer_is_late_ends_at_the_next_node() -> None:
    """A slow graph that runs in a thread does not occupy it beyond the deadline."""
    predictor = OnnxPredictor(slow_graph(500), *NONE)
    assert predictor.size.row_bytes > 500 * 512 * 4
    pool, outcomes = ThreadPool(1, 0, 0.2), list[str]()

    def work() -> None:
        """Predict for several seconds."""
        try:
            predictor.predict(np.ones((2000, 3), dtype=np.float32), (), None)
        except PredictionError:
            outcomes.append("ended early")
        else:
            outcomes.append("ended")

    async def scenario() -> None:
        """Wait for the deadline, and then for the thread."""
        with pytest.raises(DeadlineError):
            await pool.run(work)
        while pool.jobs:
            await asyncio.sleep(0.01)

    asyncio.run(scenario())
    pool.close()
    assert outcomes == ["ended early"]


def test_all_sessions_share_one_arena(shipped: bytes) -> None:
    """The memory of a large call serves the calls of other versions, so eight of them keep no more than one."""
    predictors = [OnnxPredictor(shipped, *CHAMPION) for _ in range(9)]
    asked = pushes(4000)
    predictors[0].predict(*asked)
    before = resident_bytes()
    for predictor in predictors[1:]:
        predictor.predict(*asked)
    assert resident_bytes() - before < 24 << 20


def resident_bytes() -> int:
    """Return the memory of this process."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
