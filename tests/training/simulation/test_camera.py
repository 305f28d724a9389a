"""Camera views: seeded, different from the drawing, and still a picture of the same object."""

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from service.pushing.contexts import ObjectContext
from service.pushing.image_quality import quality_flags
from service.pushing.images import FIELD_OF_VIEW_M, GreyImage, visual_context
from training.simulation import camera
from training.simulation.camera import camera_view
from training.simulation.drawing import photograph, top_down_view

OBJECTS = ("1a2a3a4a", "2C3b1a4a", "4a4a4a4a", "3c4b2a1a")
SEEDS = range(4)


@cache
def drawn(descriptor: str) -> npt.NDArray[np.uint8]:
    """Draw the clean view of an object."""
    return top_down_view(ObjectContext.from_descriptor(descriptor))


def context_of(view: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Return the visual context of a view, flat."""
    return np.frombuffer(visual_context(GreyImage(view)).levels, dtype=np.uint8).astype(np.float64)


def middle_m(view: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Return the centre of the bright pixels relative to the centre of the picture, right and down, in metres."""
    size = len(view)
    object_level, table_level = np.median(view[size // 2 - 30 : size // 2 + 30]), np.median(view[:20])
    rows, columns = np.nonzero(view > (object_level + table_level) / 2)
    offset_m: npt.NDArray[np.float64] = np.array([columns.mean(), rows.mean()]) - (size - 1) / 2
    return offset_m * FIELD_OF_VIEW_M / size


def test_the_seed_decides_every_pixel() -> None:
    """The same generator gives the same picture, another one a different picture."""
    view = drawn("1a2a3a4a")
    first, again, other = (camera_view(view, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert (first.shape, first.dtype) == (view.shape, view.dtype)


def test_every_object_has_its_own_noise() -> None:
    """Objects that look alike have different camera views, as the stream belongs to object and seed."""
    assert not np.array_equal(photograph("1a2a3a4a", 0), photograph("1a2a3a4a", 1))
    alike = photograph("4a4a4a4b", 0)[:60, :60], photograph("4a4a4a4c", 0)[:60, :60]
    assert not np.array_equal(*alike)


@pytest.mark.parametrize("descriptor", OBJECTS)
def test_a_photograph_differs_from_the_drawing_but_shows_the_same_object(descriptor: str) -> None:
    """A camera view differs in its levels, correlates best with its own object, and is not flagged."""
    clean = {other: context_of(drawn(other)) for other in OBJECTS}
    for seed in SEEDS:
        photo = photograph(descriptor, seed)
        assert quality_flags(visual_context(GreyImage(photo))) == ()
        assert np.abs(context_of(photo) - clean[descriptor]).mean() > 5
        correlation = {other: np.corrcoef(context_of(photo), levels)[0, 1] for other, levels in clean.items()}
        assert correlation[descriptor] > 0.85
        assert max(correlation, key=correlation.__getitem__) == descriptor


def test_the_object_stays_within_its_misplacement() -> None:
    """The middle of a symmetric object moves, by at most 3 mm along each axis."""
    offsets = np.array([middle_m(photograph("4a4a4a4a", seed)) for seed in SEEDS])
    assert np.abs(offsets).max() < camera.MISPLACEMENT_M + 0.001
    assert offsets.std(axis=0).min() > 0.0005


def test_a_weight_stays_brighter_than_its_side() -> None:
    """A weight of 150 g at 51 mm to the right is brighter than the empty side at the left."""
    for seed in SEEDS:
        levels = context_of(photograph("2C4a2a4a", seed)).reshape(32, 32)
        assert levels[15:17, 25:27].mean() > levels[15:17, 5:7].mean() + 25


class Extreme:
    """Generator that always draws the top of its range and no noise."""

    def uniform(self, low: float, high: float, size: int | None = None) -> float | npt.NDArray[np.float64]:
        """Return the upper end."""
        return high if size is None else np.full(size, high)

    def normal(self, size: tuple[int, int]) -> npt.NDArray[np.float64]:
        """Return a chequerboard, so that grain has a spread."""
        rows, columns = np.indices(size)
        return np.where((rows + columns) % 2, 1.0, -1.0)

    def integers(self, low: int, high: int, endpoint: bool) -> int:
        """Return the upper end."""
        return high


def test_the_ends_of_all_ranges_still_give_a_picture() -> None:
    """A view that is turned, moved, shadowed, blurred and overexposed at once does not overflow and is not flagged."""
    for descriptor in OBJECTS:
        photo = camera_view(drawn(descriptor), Extreme())  # type: ignore[arg-type]
        assert quality_flags(visual_context(GreyImage(photo))) == ()
    right, down = middle_m(camera_view(drawn("4a4a4a4a"), Extreme()))  # type: ignore[arg-type]
    assert right == pytest.approx(camera.MISPLACEMENT_M, abs=0.0015)
    assert down == pytest.approx(camera.MISPLACEMENT_M, abs=0.0015)
