"""Top-down views: where things are in them, how bright, and how they are written and read."""

import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from service.errors import DataError
from service.pushing.contexts import ObjectContext
from service.pushing.image_quality import quality_flags
from service.pushing.images import FIELD_OF_VIEW_M, IMAGE_CONVENTION, GreyImage, decode, visual_context
from training.omnipush.published import omnipush_descriptors
from training.omnipush.views import UNKNOWN_CONVENTION, convention_of, read_views, source_of
from training.simulation.drawing import PIXEL_M, top_down_view, write_views
from training.simulation.solids import RECTANGLE_DEPTH_M, WEIGHT_RADIUS_M, solid

BACKGROUND, BODY, LIGHT_WEIGHT, HEAVY_WEIGHT = 0, 128, 179, 255  # of 255: 0, 0.5, 0.7, 1
OBJECTS = ("1a2a3a4a", "2C3b1a4a", "4a4c1a3b")


def view_of(descriptor: str) -> npt.NDArray[np.uint8]:
    """The view of an object."""
    return top_down_view(ObjectContext.from_descriptor(descriptor))


def level_at(view: npt.NDArray[np.uint8], x_m: float, y_m: float) -> int:
    """The level at a point of the object frame, by the convention: x right, y up, the origin in the middle."""
    return int(view[round(240 - y_m / PIXEL_M), round(240 + x_m / PIXEL_M)])


def write_view(folder: Path, array: npt.NDArray[Any], name: str = "shape_1a2a3a4a.npy") -> Path:
    """A file as somebody else may have written it."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / name, array, allow_pickle=True)
    return folder / name


@pytest.mark.parametrize(("side", "place"), [(1, (1, 0)), (2, (0, 1)), (3, (-1, 0)), (4, (0, -1))])
def test_each_side_is_where_the_convention_says(side: int, place: tuple[int, int]) -> None:
    """Side 1 right, side 2 up, side 3 left, side 4 down: there are the weight and the tip, and nowhere else."""
    sides = ["4a"] * 4
    sides[side - 1] = "2c"
    view = view_of("".join(sides))
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        marked = (x, y) == place
        assert level_at(view, 0.037 * x, 0.037 * y) == (HEAVY_WEIGHT if marked else BODY)
        beyond_rectangle = level_at(view, 0.066 * x, 0.066 * y)
        assert beyond_rectangle == (BODY if marked else BACKGROUND)


def test_shapes_are_told_apart_at_their_outer_edge() -> None:
    """Concave is hollow in the middle and full at its corners, circular the other way round, rectangular full."""
    view = view_of("1a2a3a4a")
    assert level_at(view, 0.060, 0.0) == BACKGROUND
    assert level_at(view, 0.060, 0.0275) == level_at(view, 0.060, -0.0275) == BODY
    assert level_at(view, -0.055, 0.0) == BODY
    assert level_at(view, -0.055, 0.025) == BACKGROUND
    assert level_at(view, 0.025, -0.060) == level_at(view, 0.0, -0.060) == BODY
    assert level_at(view, 0.0, 0.066) == BODY
    assert level_at(view, 0.020, 0.060) == BACKGROUND


def test_weights_are_discs_as_bright_as_they_are_heavy() -> None:
    """60 g and 150 g differ, and both places of a triangle do."""
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
    """Nothing is drawn twice, left out at a seam, or swollen by a pixel."""
    bare = "".join(digit + "a" for digit in descriptor[::2])
    area = 0.0
    for piece in solid(ObjectContext.from_descriptor(bare)).pieces:
        x, y = piece.T
        area += 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert view_of(bare).sum() / 255 * 2 * PIXEL_M**2 == pytest.approx(area, rel=0.006)  # 0.5 is 128 of 255


def test_an_edge_within_a_pixel_gives_the_share_that_is_covered() -> None:
    """Anti-aliased: the outer face of a rectangular side falls into column 429 and covers nine tenths of it."""
    edge = (0.029 + RECTANGLE_DEPTH_M) / PIXEL_M
    share = edge - round(edge) + 0.5
    assert 0.1 < share < 0.95
    assert view_of("4a4a4a4a")[240, 240 + round(edge)] == pytest.approx(share * BODY, abs=1)


@pytest.mark.parametrize("descriptor", OBJECTS)
def test_turning_the_object_turns_its_view(descriptor: str) -> None:
    """A quarter turn of the object is a quarter turn of the picture, counter-clockwise."""
    context = ObjectContext.from_descriptor(descriptor)
    turned = top_down_view(context.turned(1)).astype(int)
    assert np.abs(turned - np.rot90(top_down_view(context))).max() <= 1


def test_every_object_of_the_benchmark_keeps_clear_of_the_border() -> None:
    """10 mm of room, as the convention promises, and nothing is flagged."""
    for descriptor in omnipush_descriptors():
        corners = np.concatenate(solid(ObjectContext.from_descriptor(descriptor)).pieces)
        assert np.linalg.norm(corners, axis=1).max() < FIELD_OF_VIEW_M / 2 - 0.010
    assert [quality_flags(visual_context(GreyImage(view_of(descriptor)))) for descriptor in OBJECTS] == [()] * 3


@pytest.mark.parametrize("camera", [False, True])
def test_views_are_written_as_published_and_read_as_the_service_reads_uploads(tmp_path: Path, camera: bool) -> None:
    """``shape_<descriptor>.npy``, 481 x 481; the same picture as a PNG upload gives the same context to the byte."""
    write_views(tmp_path, OBJECTS, camera, seed=3, quiet=True)
    seen = read_views(tmp_path, OBJECTS)
    assert (seen.shape, seen.dtype) == ((3, 1, 32, 32), np.dtype(np.uint8))
    for descriptor, context in zip(OBJECTS, seen, strict=True):
        view = np.load(tmp_path / f"shape_{descriptor}.npy")
        assert (view.shape, view.dtype) == ((481, 481), np.dtype(np.uint8))
        buffer = io.BytesIO()
        Image.fromarray(view).save(buffer, "PNG")
        assert visual_context(decode(buffer.getvalue())).levels == context.tobytes()


def test_the_order_of_objects_is_the_callers(tmp_path: Path) -> None:
    """Row i is object i, whatever order they were drawn in."""
    write_views(tmp_path, OBJECTS, quiet=True)
    assert np.array_equal(read_views(tmp_path, OBJECTS[::-1]), read_views(tmp_path, OBJECTS)[::-1])
    assert read_views(tmp_path, ()).shape == (0, 1, 32, 32)


def test_files_depend_on_object_and_seed_alone(tmp_path: Path) -> None:
    """Not on order, interruption or repetition; the seed changes every one of them."""
    write_views(tmp_path / "a", OBJECTS, camera=True, seed=1, quiet=True)
    write_views(tmp_path / "b", OBJECTS[2:], camera=True, seed=1, quiet=True)
    write_views(tmp_path / "b", OBJECTS[::-1], camera=True, seed=1, quiet=True)
    write_views(tmp_path / "c", OBJECTS, camera=True, seed=2, quiet=True)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
        assert path.read_bytes() != (tmp_path / "c" / path.name).read_bytes()


def test_several_processes_may_draw_into_one_folder(tmp_path: Path, project_root: Path) -> None:
    """They do the work twice at worst; what is there afterwards is what one alone would have written."""
    write_views(tmp_path / "together", (), quiet=True)
    code = f"from pathlib import Path; from training.simulation.drawing import write_views; write_views(Path('together'), {OBJECTS})"
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(project_root)!r}); {code}"]
    running = [subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL) for _ in range(2)]
    assert [process.wait() for process in running] == [0, 0]
    write_views(tmp_path / "alone", OBJECTS, quiet=True)
    written = {path.name: path.read_bytes() for path in (tmp_path / "together").iterdir()}
    assert written == {path.name: path.read_bytes() for path in (tmp_path / "alone").iterdir()}


def test_a_view_that_is_there_stays(tmp_path: Path) -> None:
    """Drawing again mends what is missing and touches nothing else."""
    write_views(tmp_path, OBJECTS, quiet=True)
    kept, lost = (tmp_path / f"shape_{descriptor}.npy" for descriptor in OBJECTS[:2])
    before, content = kept.stat().st_mtime_ns, lost.read_bytes()
    lost.unlink()
    write_views(tmp_path, OBJECTS, quiet=True)
    assert kept.stat().st_mtime_ns == before
    assert lost.read_bytes() == content


def test_a_folder_holds_views_of_one_kind(tmp_path: Path) -> None:
    """Camera views among clean ones, or of another seed, would go unnoticed."""
    write_views(tmp_path, OBJECTS[:1], camera=True, seed=1, quiet=True)
    for camera, seed in ((False, 0), (True, 2)):
        with pytest.raises(DataError, match="declares another dataset"):
            write_views(tmp_path, OBJECTS, camera, seed, quiet=True)


def test_a_folder_says_how_its_pictures_were_taken(tmp_path: Path) -> None:
    """Ours by our convention and as simulated, anybody else's are not claimed to be; the camera's seed is named."""
    write_views(tmp_path / "ours", (), quiet=True)
    (tmp_path / "theirs").mkdir()
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "dataset.json").write_text('{"source": "pushes"}', encoding="utf-8")
    assert convention_of(tmp_path / "ours") == IMAGE_CONVENTION
    assert convention_of(tmp_path / "theirs") == UNKNOWN_CONVENTION
    assert source_of(tmp_path / "theirs") == "top-down views of undeclared origin"
    write_views(tmp_path / "camera", (), camera=True, seed=7, quiet=True)
    assert source_of(tmp_path / "ours") == "simulated top-down views"
    assert source_of(tmp_path / "camera") == "simulated top-down views (camera, seed 7)"
    with pytest.raises(DataError, match=r"dataset\.json says nothing of pictures \(key 'image_convention'\)"):
        convention_of(tmp_path / "pushes")


def test_the_folders_of_the_release_are_looked_into(tmp_path: Path) -> None:
    """0_weight, 1_weight and 2_weight below the folder."""
    write_views(tmp_path / "flat", OBJECTS, quiet=True)
    for weights, descriptor in zip("021", OBJECTS, strict=True):
        name = f"shape_{descriptor}.npy"
        write_view(tmp_path / "sorted" / f"{weights}_weight", np.load(tmp_path / "flat" / name), name)
    assert np.array_equal(read_views(tmp_path / "sorted", OBJECTS), read_views(tmp_path / "flat", OBJECTS))


@pytest.mark.parametrize(
    "convert",
    [
        lambda view: view / 255.0,
        lambda view: (view / 255.0).astype(np.float32),
        lambda view: view.astype(np.float64),
        lambda view: view.astype(np.int64),
        lambda view: view.astype(">i4"),
        lambda view: view.astype(np.uint16) * 257,
        lambda view: np.asfortranarray(view),
    ],
    ids=["fractions", "fractions of 32 bits", "0 to 255", "int64", "big-endian", "16 bits", "column by column"],
)
def test_any_numeric_type_is_read(tmp_path: Path, convert: Callable[[Any], npt.NDArray[Any]]) -> None:
    """The type of the published files is not known: whatever says the same gives the same context."""
    view = view_of("1a2a3a4a")
    write_view(tmp_path, convert(view))
    assert read_views(tmp_path, ["1a2a3a4a"]).tobytes() == visual_context(GreyImage(view)).levels


def test_a_black_and_white_mask_is_read(tmp_path: Path) -> None:
    """True is white, and so is 1 in an array of whole numbers."""
    mask = view_of("1a2a3a4a") > 0
    expected = visual_context(GreyImage(mask.astype(np.uint8) * 255)).levels
    for array in (mask, mask.astype(np.int32), mask.astype(np.float64)):
        write_view(tmp_path, array)
        assert read_views(tmp_path, ["1a2a3a4a"]).tobytes() == expected


class Trap:
    """What a pickle can do: make a folder in the place where it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda path: path.unlink(), "is missing; fetch it, or draw"),
        (lambda path: path.write_bytes(b""), "not a whole .npy"),
        (lambda path: path.write_bytes(path.read_bytes()[:5000]), "not a whole .npy"),
        (lambda path: path.write_bytes(b"PK\3\4" + bytes(100)), "not a whole .npy"),
        (lambda path: path.write_bytes(bytes(3_000_000)), "more than"),
        (lambda path: np.save(path, np.zeros((480, 480))), r"shape \(480, 480\); expected \(481, 481\)"),
        (lambda path: np.save(path, np.zeros((481, 481, 3), np.uint8)), r"shape \(481, 481, 3\)"),
        (lambda path: np.save(path, np.full((481, 481), np.nan)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), -1)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), 300.0)), "not in"),
        (lambda path: np.save(path, np.full((481, 481), 1j, np.complex64)), "complex64"),
        (lambda path: np.save(path, np.array([Trap(path.parent / "sprung")]), allow_pickle=True), "not a whole .npy"),
        (lambda path: write_view(path.parent / "1_weight", np.load(path)), "the same object; keep one"),
    ],
    ids=[
        "missing", "empty", "truncated", "an archive", "too long", "another size", "colour", "NaN", "negative",
        "beyond 255", "complex", "a pickle", "two files",
    ],
)  # fmt: skip
def test_a_file_that_is_no_view_ends_in_one_line_that_names_it(
    tmp_path: Path, spoil: Callable[[Path], object], words: str
) -> None:
    """What is wrong, and what to do; a pickle is never loaded."""
    path = write_view(tmp_path, view_of("1a2a3a4a"))
    spoil(path)
    with pytest.raises(DataError, match=words) as raised:
        read_views(tmp_path, ["1a2a3a4a"])
    assert str(path.name) in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "sprung").exists()


def test_the_trap_of_these_tests_is_a_trap(tmp_path: Path) -> None:
    """Loaded by numpy with pickles allowed, it springs: so the test above can fail."""
    np.save(tmp_path / "trap.npy", np.array([Trap(tmp_path / "sprung")]), allow_pickle=True)
    np.load(tmp_path / "trap.npy", allow_pickle=True)
    assert (tmp_path / "sprung").exists()


def test_a_folder_that_is_not_there_or_cannot_be_written_is_named(tmp_path: Path) -> None:
    """Reading names the command that would fill it; writing says what stands in the way."""
    with pytest.raises(DataError, match="nowhere is not a folder of top-down views; run 'cazsl-train images"):
        read_views(tmp_path / "nowhere", OBJECTS)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match=r"file/views cannot be written \(Not a directory\)"):
        write_views(tmp_path / "file" / "views", OBJECTS, quiet=True)
