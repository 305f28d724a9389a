"""Posteriors of refined contexts: standard deviations and correlations, and where they belong."""

from typing import Any

import numpy as np
import pytest

from service.errors import InvalidRequestError
from service.pushing.shape_context import ShapeContext
from service.schemas.body import validate_body
from service.schemas.contexts import ContextBody
from service.schemas.posteriors import CORRELATION_EXAMPLE, STD_EXAMPLE
from service.schemas.shapes import OUTLINE_EXAMPLE

POSTERIOR = {"std": STD_EXAMPLE, "correlation": CORRELATION_EXAMPLE}
REFINED = {
    "outline": OUTLINE_EXAMPLE,
    "centre_of_mass": [0.01, 0.0],
    "friction": 0.2,
    "pressure": [0.5, 0.0, 0.5],
    "posterior": POSTERIOR,
}


def read(document: dict[str, Any]) -> ContextBody:
    """Return a context that was read and described."""
    found = validate_body(ContextBody, document)
    found.to_domain()
    return found


def test_moments_are_positive_definite_in_spite_of_dropped_digits() -> None:
    """Two values that are one and the same, to the digits of an answer, still have a Cholesky factor."""
    correlation = np.eye(6)
    correlation[0, 1] = correlation[1, 0] = 1.0
    posterior = read(REFINED | {"posterior": POSTERIOR | {"correlation": correlation.tolist()}}).posterior
    assert posterior is not None
    std, found = posterior.moments()
    assert std.tolist() == STD_EXAMPLE
    assert np.isfinite(np.linalg.cholesky(found)).all()


def test_a_centre_of_mass_that_is_not_sure_counts_as_unknown() -> None:
    """Over a tenth of the object's size, the model is told that the centre of mass is not known, and keys differ."""
    surest = read(REFINED | {"posterior": None})
    sure, unsure = (
        read(REFINED | {"posterior": POSTERIOR | {"std": [std, std, *STD_EXAMPLE[2:]]}}) for std in (0.002, 0.02)
    )
    shapes = [body.to_domain() for body in (surest, sure, unsure)]
    assert [isinstance(shape, ShapeContext) and shape.centre_is_sure for shape in shapes] == [True, True, False]
    assert len({body.key for body in (surest, sure, unsure)}) == 3


def asymmetric() -> list[list[float]]:
    """Return a matrix that is not symmetric."""
    found = np.eye(6)
    found[0, 1] = 0.5
    return found.tolist()


def impossible() -> list[list[float]]:
    """Return a symmetric matrix of three values that cannot all oppose each other."""
    found = np.eye(6)
    for one, other in ((0, 1), (1, 2), (0, 2)):
        found[one, other] = found[other, one] = -0.9
    return found.tolist()


@pytest.mark.parametrize(
    "wrong",
    [
        {"std": STD_EXAMPLE[:5]},
        {"std": [0.0, *STD_EXAMPLE[1:]]},
        {"std": [-0.1, *STD_EXAMPLE[1:]]},
        {"std": [1e9, *STD_EXAMPLE[1:]]},
        {"correlation": CORRELATION_EXAMPLE[:5]},
        {"correlation": (2.0 * np.eye(6)).tolist()},
        {"correlation": asymmetric()},
        {"correlation": impossible()},
        {"correlation": [[1e300] * 6] * 6},
        {"mean": [0.0] * 6},
    ],
)
def test_other_numbers_are_refused(wrong: dict[str, Any]) -> None:
    """A posterior that no refinement can have answered is refused."""
    with pytest.raises(InvalidRequestError, match="posterior"):
        read(REFINED | {"posterior": POSTERIOR | wrong})


@pytest.mark.parametrize("missing", ["centre_of_mass", "friction", "pressure"])
def test_a_posterior_needs_its_mean(missing: str) -> None:
    """Without one of the three fields that it is about, a posterior is refused."""
    with pytest.raises(InvalidRequestError, match="its mean"):
        read({name: value for name, value in REFINED.items() if name != missing})


def test_a_posterior_belongs_to_an_outline() -> None:
    """A descriptor has no posterior."""
    with pytest.raises(InvalidRequestError, match="posterior"):
        read({"descriptor": "1a2b3c4a", "posterior": POSTERIOR})
