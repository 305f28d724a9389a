"""Each hostile graph is refused by its own refusal, before onnxruntime sees it; honest ones are served."""

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
from tests.attacks.hostile_graphs import ATTACKS, honest
from tests.fakes import load_fake, publish_fake

TENSORS = expected_inputs(ContextKind.NONE), OUTPUTS


def test_the_honest_graph_that_the_attacks_begin_with_is_accepted() -> None:
    """What is refused below is refused for the attack and for nothing else."""
    OnnxPredictor(honest().SerializeToString(), *TENSORS)


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_hostile_graph_is_refused(attack: str) -> None:
    """The error names the file and the reason."""
    build, refusal = ATTACKS[attack]
    with pytest.raises(BrokenModelError, match=rf"model\.onnx: .*({refusal})"):
        OnnxPredictor(build().SerializeToString(), *TENSORS)


def test_a_published_attack_is_a_problem_and_what_is_served_goes_on(tmp_path: Path) -> None:
    """Through the whole path: digests fit, the graph is refused, the old version serves, readiness says why."""
    registry = Registry(tmp_path / "models")

    def load(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> Predictor:
        """The fake for the fake, the real one for the attack."""
        return (load_fake if model == b"fine" else OnnxPredictor)(model, inputs, outputs)

    publish_fake(registry)
    models = LoadedModels(registry, load)
    models.refresh()
    publish_fake(registry, model=ATTACKS["sparse initialiser"][0]().SerializeToString())
    models.refresh()
    assert models.snapshot.versions("push-indicator") == [1]
    assert any("external data" in problem for problem in models.snapshot.problems)


SMALL = """
import resource, sys
from service.errors import BrokenModelError
from service.model.onnx_graph import inspect_graph
from tests.attacks.hostile_graphs import ATTACKS
contents = {name: build().SerializeToString() for name, (build, _) in ATTACKS.items()}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for content in contents.values():
    try:
        inspect_graph(content)
    except BrokenModelError:
        pass
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def test_refusing_costs_no_more_than_the_files_are_large(project_root: Path) -> None:
    """All attacks together raise the peak of a fresh process by less than 100 MiB, though they claim terabytes."""
    done = subprocess.run([sys.executable, "-c", SMALL], cwd=project_root, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 100


@pytest.mark.parametrize("place", range(0, 400, 7))
def test_a_torn_graph_is_our_error_or_none(place: int) -> None:
    """Cut anywhere, the walk ends in a refusal or in acceptance, never in anything else."""
    content = honest().SerializeToString()[:place]
    try:
        inspect_graph(content)
    except BrokenModelError:
        return
