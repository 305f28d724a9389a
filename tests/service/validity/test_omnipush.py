"""Objects of Omnipush are told from others, by their weights and by their views."""

import numpy as np
import pytest

from benchmarks.omnipush_views import OTHERS, drawn, levels
from benchmarks.push_predictions import view
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import ObjectContext
from service.pushing.outlines import Outline
from service.validity.omnipush import is_omnipush, unlike_omnipush


def indicators(*descriptors: str) -> FloatArray:
    """Return the indicators (g, 36) of objects."""
    return np.stack([ObjectContext.from_descriptor(each).tensor() for each in descriptors])


def test_objects_have_at_most_two_weights() -> None:
    """Three and four weights are no object of Omnipush, and the reason counts them."""
    unlike, reason = unlike_omnipush(ContextKind.INDICATOR, indicators("4a4a4a4a", "1b2C3a4a", "1b2b3c4a", "1c2B3c4b"))
    assert unlike.tolist() == [False, False, True, True]
    assert reason(2).startswith("3 sides have a weight")
    assert reason(3).startswith("4 sides have a weight")


@pytest.mark.parametrize("name", OTHERS)
def test_a_view_of_another_shape_is_none_of_them(name: str) -> None:
    """Beside a drawing of an object, a box or an L differs, and the reason names the nearest object and by how much."""
    views = np.stack([drawn("1a2b3c4a"), levels(view(Outline.of(OTHERS[name])))]) / np.float32(255.0)
    unlike, reason = unlike_omnipush(ContextKind.VISUAL, views.astype(np.float32))
    assert unlike.tolist() == [False, True]
    assert "differs from the drawing of the nearest object" in reason(1)
    assert "(known: up to 0.04)" in reason(1)


def test_a_view_with_three_weights_is_none_of_them() -> None:
    """The sides of a view are recognised, so that their weights count as in a descriptor."""
    unlike, reason = unlike_omnipush(ContextKind.VISUAL, (drawn("1b2b3c4a")[None] / np.float32(255.0)).astype("f4"))
    assert unlike.tolist() == [True]
    assert reason(0).startswith("3 sides have a weight")


@pytest.mark.parametrize(("descriptor", "expected"), [("1a2b3c4a", True), ("1b2b3c4a", False)])
def test_one_context_is_judged_by_its_bytes(descriptor: str, expected: bool) -> None:
    """The short way of a single push agrees, for a descriptor and for its view, and asks nothing of other kinds."""
    assert is_omnipush(ContextKind.INDICATOR, indicators(descriptor).tobytes()) is expected
    picture = (drawn(descriptor) / np.float32(255.0)).astype(np.float32)
    assert is_omnipush(ContextKind.VISUAL, picture.tobytes()) is expected
    assert is_omnipush(ContextKind.NONE, b"")
    assert is_omnipush(ContextKind.SHAPE, b"anything")
