"""Promotion: the comparison of a candidate with the champion by their held-out figures."""

from dataclasses import replace

import pytest

from service.model.loaded_model import LoadedModel
from service.pushing.domain import PUSHING
from service.registry.promotion import judge
from tests.fakes import draft_manifest
from tests.service.pushing.test_gates import model, refused


def with_figures(nll: float = 1.0, coverage_90: float = 0.9, sha256: str = "0" * 64) -> LoadedModel:
    """A model with other held-out figures."""
    found = draft_manifest()
    return model(
        manifest=replace(
            found,
            metrics={name: replace(each, nll=nll) for name, each in found.metrics.items()},
            calibration={name: replace(each, coverage_90=coverage_90) for name, each in found.calibration.items()},
            data=replace(found.data, sha256=sha256, held_out_pushes=10_000),
        )
    )


@pytest.mark.parametrize(
    ("candidate", "expected"),
    [
        (with_figures(), []),
        (with_figures(nll=0.5), []),
        (with_figures(nll=1.001), ["nll"]),
        (with_figures(coverage_90=0.904), []),
        (with_figures(coverage_90=0.85), ["coverage"]),
        (with_figures(coverage_90=0.95), ["coverage"]),
        (with_figures(sha256="1" * 64), ["held-out"]),
    ],
    ids=["the same", "better", "worse NLL", "within chance", "too sure", "too unsure", "other data"],
)
def test_a_candidate_is_not_worse_than_the_champion(candidate: LoadedModel, expected: list[str]) -> None:
    """On the same data and set-up; what was measured elsewhere cannot be compared and is refused."""
    assert refused(judge(candidate, with_figures(), PUSHING)) == expected
