"""Hostile graphs are refused before onnxruntime sees them, each with a message of its own. Valid ones are served."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from service.errors import BrokenModelError
from service.inference.loaded_models import LoadedModels
from service.model.onnx_graph import inspect_graph
from service.model.predictor import OnnxPredictor, Predictor
from service.model.tensors import ContextKind, Tensor
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from service.registry.registry import Registry
from tests.attacks.hostile_graphs import ATTACKS, valid_graph
from tests.fakes import load_fake, publish_fake

TENSORS = expected_inputs(ContextKind.NONE), OUTPUTS


def test_the_valid_graph_is_accepted() -> None:
    """The valid graph is accepted, so a change of it is refused for the change alone."""
    OnnxPredictor(valid_graph().SerializeToString(), *TENSORS)


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_hostile_graph_is_refused(attack: str) -> None:
    """A hostile graph is refused with the name of the file and the reason."""
    build, refusal = ATTACKS[attack]
    with pytest.raises(BrokenModelError, match=rf"model\.onnx: .*({refusal})"):
        OnnxPredictor(build().SerializeToString(), *TENSORS)


def test_a_published_hostile_graph_is_not_served(tmp_path: Path) -> None:
    """A hostile graph with valid digests is refused. The previous version is served, and readiness names the reason."""
    registry = Registry(tmp_path / "models")

    def load(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> Predictor:

        return (load_fake if model == b"fine" else OnnxPredictor)(model, inputs, outputs)

    publish_fake(registry)
    models = LoadedModels(registry, load)
    models.refresh()
    publish_fake(registry, model=ATTACKS["sparse initialiser"][0]().SerializeToString())
    models.refresh()
    assert models.snapshot.versions("push-indicator") == [1]
    assert any("external data" in problem for problem in models.snapshot.problems)


PEAK_MEMORY_SCRIPT = """
import resource, sys
from service.errors import BrokenModelError
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from tests.attacks.hostile_graphs import ATTACKS
contents = {name: build().SerializeToString() for name, (build, _) in ATTACKS.items()}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for content in contents.values():
    try:
        OnnxPredictor(content, expected_inputs(ContextKind.NONE), OUTPUTS)
        print("accepted")
    except BrokenModelError:
        pass
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def test_refusing_hostile_graphs_takes_little_memory(project_root: Path) -> None:
    """All hostile graphs together raise the peak memory of a process by less than 150 MiB. They declare terabytes.

    The largest file has 17 MiB. It is sent to the process that tries it.
    """
    command = [sys.executable, "-c", PEAK_MEMORY_SCRIPT]
    done = subprocess.run(command, cwd=project_root, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 150


@pytest.mark.parametrize("place", range(0, 400, 7))
def test_a_truncated_graph_is_refused_or_accepted(place: int) -> None:
    """A graph that is cut at any byte is accepted or refused with BrokenModelError, and raises no other error."""
    content = valid_graph().SerializeToString()[:place]
    try:
        inspect_graph(content)
    except BrokenModelError:
        return
