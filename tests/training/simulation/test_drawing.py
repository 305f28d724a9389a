"""Drawing of top-down views: geometry, grey levels, and the files written."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service.errors import DataError
from service.pushing.contexts import ObjectContext
from service.pushing.image_quality import quality_flags
from service.pushing.images import FIELD_OF_VIEW_M, GreyImage, decode, visual_context
from service.pushing.sides import RECTANGLE_DEPTH_M
from training.omnipush.published import omnipush_descriptors
from training.omnipush.views import camera_views_file_name, read_camera_views, read_views
from training.simulation.drawing import PIXEL_M, photograph, top_down_view, write_camera_views, write_views
from training.simulation.solids import WEIGHT_RADIUS_M, solid

BACKGROUND, BODY, LIGHT_WEIGHT, HEAVY_WEIGHT = 0, 128, 179, 255  # of 255: 0, 0.5, 0.7, 1
OBJECTS = ("1a2a3a4a", "2C3b1a4a", "4a4c1a3b")


def view_of(descriptor: str) -> npt.NDArray[np.uint8]:
    """Draw the view of an object."""
    return top_down_view(ObjectContext.from_descriptor(descriptor))


def level_at(view: npt.NDArray[np.uint8], x_m: float, y_m: float) -> int:
    """Return the level at a point of the object frame: x right, y up, the origin in the middle."""
    return int(view[round(240 - y_m / PIXEL_M), round(240 + x_m / PIXEL_M)])


@pytest.mark.parametrize(("side", "place"), [(1, (1, 0)), (2, (0, 1)), (3, (-1, 0)), (4, (0, -1))])
def test_each_side_is_where_the_convention_says(side: int, place: tuple[int, int]) -> None:
    """Side 1 is right, 2 up, 3 left and 4 down: the weight and the tip are there and at no other side."""
    sides = ["4a"] * 4
    sides[side - 1] = "2c"
    view = view_of("".join(sides))
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        marked = (x, y) == place
        assert level_at(view, 0.037 * x, 0.037 * y) == (HEAVY_WEIGHT if marked else BODY)
        beyond_rectangle = level_at(view, 0.066 * x, 0.066 * y)
        assert beyond_rectangle == (BODY if marked else BACKGROUND)


def test_shapes_differ_at_their_outer_edge() -> None:
    """A concave side is hollow in the middle, a circular one at its corners, and a rectangular one is full."""
    view = view_of("1a2a3a4a")
    assert level_at(view, 0.060, 0.0) == BACKGROUND
    assert level_at(view, 0.060, 0.0275) == level_at(view, 0.060, -0.0275) == BODY
    assert level_at(view, -0.055, 0.0) == BODY
    assert level_at(view, -0.055, 0.025) == BACKGROUND
    assert level_at(view, 0.025, -0.060) == level_at(view, 0.0, -0.060) == BODY
    assert level_at(view, 0.0, 0.066) == BODY
    assert level_at(view, 0.020, 0.060) == BACKGROUND


def test_weights_are_discs_as_bright_as_they_are_heavy() -> None:
    """Weights of 60 g and 150 g have different levels, at both positions in a triangle."""
    view = view_of("2b4c3a2B")
    assert level_at(view, 0.037, 0.0) == LIGHT_WEIGHT
    assert level_at(view, 0.0, 0.037) == HEAVY_WEIGHT
    assert level_at(view, 0.0, -0.051) == LIGHT_WEIGHT
    assert level_at(view, 0.0, -0.037) == BODY
    assert level_at(view, 0.0, 0.037 + WEIGHT_RADIUS_M + PIXEL_M) == BODY
    light = (view == LIGHT_WEIGHT).sum() * PIXEL_M**2
    assert light == pytest.approx(2 * np.pi * WEIGHT_RADIUS_M**2, rel=0.05)


@pytest.mark.parametrize("descriptor", OBJECTS)
def test_the_area_is_that_of_the_pieces(descriptor: str) -> None:
    """The drawn area is that of the pieces: no part is drawn twice, left out at a seam, or a pixel too large."""
    bare = "".join(digit + "a" for digit in descriptor[::2])
    area = 0.0
    for piece in solid(ObjectContext.from_descriptor(bare)).pieces:
        x, y = piece.T
        area += 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert view_of(bare).sum() / 255 * 2 * PIXEL_M**2 == pytest.approx(area, rel=0.006)  # 0.5 is 128 of 255


def test_an_edge_within_a_pixel_gives_the_share_that_is_covered() -> None:
    """The outer face of a rectangular side falls into column 429, whose level is the covered share."""
    edge = (0.029 + RECTANGLE_DEPTH_M) / PIXEL_M
    share = edge - round(edge) + 0.5
    assert 0.1 < share < 0.95
    assert view_of("4a4a4a4a")[240, 240 + round(edge)] == pytest.approx(share * BODY, abs=1)


@pytest.mark.parametrize("descriptor", OBJECTS)
def test_turning_the_object_turns_its_view(descriptor: str) -> None:
    """A quarter turn of the object is a quarter turn of the view, counter-clockwise."""
    context = ObjectContext.from_descriptor(descriptor)
    turned = top_down_view(context.turned(1)).astype(int)
    assert np.abs(turned - np.rot90(top_down_view(context))).max() <= 1


def test_every_object_of_the_benchmark_keeps_clear_of_the_border() -> None:
    """Every object leaves 10 mm of room, as the convention promises, and no view is flagged."""
    for descriptor in omnipush_descriptors():
        corners = np.concatenate(solid(ObjectContext.from_descriptor(descriptor)).pieces)
        assert np.linalg.norm(corners, axis=1).max() < FIELD_OF_VIEW_M / 2 - 0.010
    assert [quality_flags(visual_context(GreyImage(view_of(descriptor)))) for descriptor in OBJECTS] == [()] * 3


@pytest.mark.parametrize("camera", [False, True])
def test_views_are_written_as_published_and_read_as_the_service_reads_uploads(tmp_path: Path, camera: bool) -> None:
    """A written view is 481 x 481, and the same picture uploaded as PNG gives the same context to the byte."""
    write_views(tmp_path, OBJECTS, camera, seed=3, quiet=True)
    seen = read_views(tmp_path, OBJECTS)
    assert (seen.shape, seen.dtype) == ((3, 1, 32, 32), np.dtype(np.uint8))
    for descriptor, context in zip(OBJECTS, seen, strict=True):
        view = np.load(tmp_path / f"shape_{descriptor}.npy")
        assert (view.shape, view.dtype) == ((481, 481), np.dtype(np.uint8))
        buffer = io.BytesIO()
        Image.fromarray(view).save(buffer, "PNG")
        assert visual_context(decode(buffer.getvalue())).levels == context.tobytes()


def test_camera_views_are_the_photographs_of_consecutive_seeds(tmp_path: Path) -> None:
    """The n-th camera view of an object is the context of its photograph with the seed plus n. Existing files stay."""
    write_camera_views(tmp_path, OBJECTS[:2], 2, seed=5, quiet=True)
    kept = tmp_path / camera_views_file_name(OBJECTS[0])
    before = kept.stat().st_mtime_ns
    write_camera_views(tmp_path, OBJECTS[:2], 2, seed=5, quiet=True)
    found = read_camera_views(tmp_path, OBJECTS[:2], 2)

    assert kept.stat().st_mtime_ns == before
    assert (found.shape, found.dtype) == ((2, 2, 1, 32, 32), np.dtype(np.uint8))
    for row, descriptor in enumerate(OBJECTS[:2]):
        for number in range(2):
            view = GreyImage.from_array(photograph(descriptor, 5 + number), "a test")
            assert visual_context(view).levels == found[row, number].tobytes()
    with pytest.raises(DataError, match="declares another dataset"):
        write_camera_views(tmp_path, OBJECTS, 3, seed=5, quiet=True)


def test_files_depend_on_object_and_seed_alone(tmp_path: Path) -> None:
    """Views do not depend on order, interruption or repetition, and the seed changes every camera view."""
    write_views(tmp_path / "a", OBJECTS, camera=True, seed=1, quiet=True)
    write_views(tmp_path / "b", OBJECTS[2:], camera=True, seed=1, quiet=True)
    write_views(tmp_path / "b", OBJECTS[::-1], camera=True, seed=1, quiet=True)
    write_views(tmp_path / "c", OBJECTS, camera=True, seed=2, quiet=True)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
        assert path.read_bytes() != (tmp_path / "c" / path.name).read_bytes()


def test_several_processes_may_draw_into_one_folder(tmp_path: Path, project_root: Path) -> None:
    """Two processes leave the files that one alone would have written."""
    write_views(tmp_path / "together", (), quiet=True)
    code = (
        "from pathlib import Path; from training.simulation.drawing import write_views; "
        f"write_views(Path('together'), {OBJECTS})"
    )
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(project_root)!r}); {code}"]
    running = [subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL) for _ in range(2)]
    assert [process.wait() for process in running] == [0, 0]
    write_views(tmp_path / "alone", OBJECTS, quiet=True)
    written = {path.name: path.read_bytes() for path in (tmp_path / "together").iterdir()}
    assert written == {path.name: path.read_bytes() for path in (tmp_path / "alone").iterdir()}


def test_existing_views_are_kept(tmp_path: Path) -> None:
    """Drawing again adds missing views and leaves the others untouched."""
    write_views(tmp_path, OBJECTS, quiet=True)
    kept, lost = (tmp_path / f"shape_{descriptor}.npy" for descriptor in OBJECTS[:2])
    before, content = kept.stat().st_mtime_ns, lost.read_bytes()
    lost.unlink()
    write_views(tmp_path, OBJECTS, quiet=True)
    assert kept.stat().st_mtime_ns == before
    assert lost.read_bytes() == content


def test_a_folder_holds_views_of_one_kind(tmp_path: Path) -> None:
    """Clean and camera views, or camera views of two seeds, are not mixed in one folder."""
    write_views(tmp_path, OBJECTS[:1], camera=True, seed=1, quiet=True)
    for camera, seed in ((False, 0), (True, 2)):
        with pytest.raises(DataError, match="declares another dataset"):
            write_views(tmp_path, OBJECTS, camera, seed, quiet=True)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """The error about a folder of views that cannot be written names it and the system's reason."""
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match=r"file/views cannot be written \(Not a directory\)"):
        write_views(tmp_path / "file" / "views", OBJECTS, quiet=True)
