"""Promotion compares held-out figures with the champion, moves the alias, and a rollback moves it back."""

from dataclasses import replace
from pathlib import Path

import pytest

from service.errors import ConflictError, UnknownModelError
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.pushing.gates import PUSHING
from service.registry.promotion import is_forced, judge, promote, roll_back
from service.registry.registry import NOWHERE, Registry
from tests.fakes import draft_manifest, load_fake, publish_fake
from tests.service.pushing.test_gates import model, refused


def with_figures(nll: float = 1.0, coverage_90: float = 0.9, sha256: str = "0" * 64) -> LoadedModel:
    """Create a model with these held-out figures."""
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
    ids=["the same", "better", "worse NLL", "within chance", "too confident", "too uncertain", "other data"],
)
def test_a_candidate_must_not_be_worse_than_the_champion(candidate: LoadedModel, expected: list[str]) -> None:
    """Figures on the same data and set-up must not be worse, and figures of other data are refused."""
    assert refused(judge(candidate, with_figures(), PUSHING)) == expected


NAME = "push-none"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Return a registry with a champion, and a second version that is worse by its held-out figures."""
    found = Registry(tmp_path)
    publish_fake(found, NAME, ContextKind.NONE)
    draft = draft_manifest(NAME, ContextKind.NONE)
    metrics = {name: replace(figures, nll=figures.nll + 1.0) for name, figures in draft.metrics.items()}
    found.publish(replace(draft, metrics=metrics), b"fine", f"# {NAME}\n")
    return found


def test_a_refused_version_is_not_promoted(registry: Registry) -> None:
    """A gate that refuses leaves the alias, and its verdict is given."""
    outcome = promote(registry, load_fake, NAME, 2, "champion")
    assert outcome.event is None
    assert [verdict.gate for verdict in outcome.refused] == ["nll"]
    assert registry.aliases(NAME) == {"champion": 1}


@pytest.mark.parametrize(
    ("reason", "kept"), [("a trial", "a trial (forced past "), (None, "no reason given (forced past ")]
)
def test_a_forced_promotion_keeps_its_figures_in_the_history(registry: Registry, reason: str | None, kept: str) -> None:
    """A forced move has the reason and the figures of the gates that refused."""
    outcome = promote(registry, load_fake, NAME, 2, "champion", reason=reason, force=True)
    assert outcome.event is not None
    assert (outcome.event.before, outcome.event.to) == (1, 2)
    assert str(outcome.event.reason).startswith(kept)
    assert registry.aliases(NAME) == {"champion": 2}


def test_a_promotion_expects_the_version_of_its_comparison(registry: Registry) -> None:
    """If the alias names another version than expected, it stays."""
    with pytest.raises(ConflictError):
        promote(registry, load_fake, NAME, 2, "champion", expect=NOWHERE, force=True)
    with pytest.raises(UnknownModelError):
        promote(registry, load_fake, NAME, 3, "champion")
    assert registry.aliases(NAME) == {"champion": 1}


def test_a_rollback_returns_to_the_version_before(registry: Registry) -> None:
    """An alias goes back to the last other version that it named and that still exists."""
    promote(registry, load_fake, NAME, 2, "champion", force=True)
    with pytest.raises(ConflictError, match="names 2, but 1 was expected"):
        roll_back(registry, load_fake, NAME, "champion", expect=1)
    event = roll_back(registry, load_fake, NAME, "champion", reason="worse in the field").event
    assert event is not None
    assert (event.before, event.to, event.reason) == (2, 1, "rollback: worse in the field")
    registry.remove(NAME, 2)
    with pytest.raises(UnknownModelError, match="named no other version"):
        roll_back(registry, load_fake, NAME, "champion")


def test_a_rollback_does_not_compare_figures(registry: Registry) -> None:
    """The version that is left may have the better figures. It may fail in the field all the same."""
    registry.point_alias(NAME, "canary", 2)
    registry.point_alias(NAME, "canary", 1)
    assert promote(registry, load_fake, NAME, 2, "canary").event is None
    outcome = roll_back(registry, load_fake, NAME, "canary")
    assert outcome.event is not None
    assert registry.aliases(NAME)["canary"] == 2


def test_a_rollback_to_a_version_that_gates_refuse_needs_force(tmp_path: Path) -> None:
    """A rollback runs the gates. A refused one leaves the alias, and a forced one keeps the figures."""
    found, name = Registry(tmp_path), "push-indicator"  # the fake turns an object that no pusher touches
    publish_fake(found, name)
    publish_fake(found, name)
    outcome = roll_back(found, load_fake, name, "champion")
    assert (outcome.event, outcome.version, outcome.seen) == (None, 1, 2)
    assert [verdict.gate for verdict in outcome.refused] == ["no-contact"]
    assert found.aliases(name) == {"champion": 2}
    assert not is_forced(found.history(name), "champion", 2)
    event = roll_back(found, load_fake, name, "champion", expect=outcome.seen, force=True).event
    assert event is not None
    assert event.reason == "rollback (forced past no-contact 0.991 > 0.5)"
    assert is_forced(found.history(name), "champion", 1)
    found.point_alias(name, "champion", 2)
    assert not is_forced(found.history(name), "champion", 2)
