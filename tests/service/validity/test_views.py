"""Views of Omnipush's objects are told from those of other objects."""

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.omnipush_views import FILE, OTHERS, drawn, levels, side_views
from benchmarks.push_predictions import view
from service.model.tensors import FloatArray
from service.pushing.outlines import Outline
from service.validity.views import LARGEST_DIFFERENCE, likenesses

DESCRIPTORS = ("1a2b3c4a", "4a4a4a4a", "2B1c3a2a", "3c3a3a3b")


def shares(view: npt.NDArray[np.uint8]) -> FloatArray:
    """Return grey levels as shares of white, with a dimension of one."""
    return np.asarray(view[None], dtype=np.float32) / np.float32(255.0)


def test_the_file_has_the_views_that_are_drawn() -> None:
    """The kept views are those that the image convention draws."""
    assert np.array_equal(np.load(FILE, allow_pickle=False), side_views())


@pytest.mark.parametrize("descriptor", DESCRIPTORS)
def test_a_drawing_of_an_object_is_like_that_object(descriptor: str) -> None:
    """The nearest object of a drawing is the one that was drawn."""
    (found,) = likenesses(shares(drawn(descriptor)))
    assert found.descriptor == descriptor
    assert found.difference < 0.001


@pytest.mark.parametrize("name", OTHERS)
def test_other_shapes_differ(name: str) -> None:
    """Boxes and an L are far from every object."""
    (found,) = likenesses(shares(levels(view(Outline.of(OTHERS[name])))))
    assert found.difference > 2.0 * LARGEST_DIFFERENCE


def test_a_view_does_not_depend_on_the_others() -> None:
    """Many views are compared in parts, each as if it were alone."""
    rng = np.random.default_rng(1)
    several = rng.random((600, 1, 32, 32), dtype=np.float32)
    together = likenesses(several)
    for number in (0, 511, 512, 599):
        (alone,) = likenesses(several[number : number + 1])
        assert alone.descriptor == together[number].descriptor
        assert alone.difference == pytest.approx(together[number].difference, rel=1e-5)
