"""Folders of pushes: read, refused by file, covered by a digest, and exported in other variants."""

import io
import math
import os
import pickle
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from service.errors import DataError
from tests.training.pickle_trap import PickleTrap
from tests.training.synthetic_omnipush import SOURCE, plausible_pushes, write_surface
from training.omnipush.declaration import DATASET_FILE, UNKNOWN_SOURCE, declare_dataset
from training.omnipush.files import Variant, list_folder
from training.omnipush.published import omnipush_descriptors
from training.omnipush.pushes import (
    OUTCOME_SUFFIX,
    PUSHER_SUFFIX,
    export_variants,
    has_object,
    read_folder,
    write_object,
)
from training.simulation.dataset import Simulation, simulate_dataset

Array = npt.NDArray[np.float64]

FIRST, SECOND = "1a2b3c4a", "2B3a3a4a"
FIRST_X, FIRST_Y = FIRST + PUSHER_SUFFIX, FIRST + OUTCOME_SUFFIX
FLOAT32_STEP = 2.0**-23  # relative distance of neighbouring float32 numbers


def some_rows(count: int, seed: int) -> Array:
    """Return random numbers of the size of poses, (count, 3)."""
    return np.random.default_rng(seed).normal(0.0, 0.05, (count, 3))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder with four pushes of one object and two of another."""
    found = tmp_path / "omnipush"
    found.mkdir()
    write_object(found, SECOND, some_rows(2, 1), some_rows(2, 2))
    write_object(found, FIRST, some_rows(4, 3), some_rows(4, 4))
    return found


def test_written_pushes_are_read_back(folder: Path) -> None:
    """Pushes come back object by object, sorted by descriptor, as float32."""
    found = read_folder(folder)

    assert found.descriptors == (FIRST, SECOND)
    assert found.pushers.dtype == found.outcomes.dtype == found.valid.dtype == np.float32
    assert (found.pushers[0] == some_rows(4, 3).astype(np.float32)).all()
    assert (found.outcomes[0] == some_rows(4, 4).astype(np.float32)).all()
    assert (found.pushers[1, :2] == some_rows(2, 1).astype(np.float32)).all()
    assert (found.outcomes[1, :2] == some_rows(2, 2).astype(np.float32)).all()


def test_objects_with_fewer_pushes_are_padded(folder: Path) -> None:
    """Every object has as many rows as the longest, ``valid`` marks the pushes, and ``count`` counts them."""
    found = read_folder(folder)

    assert found.valid.tolist() == [[1, 1, 1, 1], [1, 1, 0, 0]]
    assert not found.pushers[1, 2:].any()
    assert not found.outcomes[1, 2:].any()
    assert found.count == 6


def test_the_release_s_names_and_precisions_are_read(tmp_path: Path) -> None:
    """A name may go on after the descriptor, files may be float32, and normalised twins are ignored."""
    stem = FIRST + "_all_250"
    np.save(tmp_path / (stem + PUSHER_SUFFIX), some_rows(3, 1).astype(np.float32))
    np.save(tmp_path / (stem + OUTCOME_SUFFIX), some_rows(3, 2).astype(np.float32))
    np.save(tmp_path / (stem + "_X_3_norm.npy"), np.full((3, 3), np.nan))
    np.save(tmp_path / f"shape_{FIRST}.npy", np.zeros((481, 481)))

    found = read_folder(tmp_path)
    assert found.descriptors == (FIRST,)
    assert (found.pushers[0] == some_rows(3, 1).astype(np.float32)).all()


def test_indicators_are_those_of_the_descriptors(folder: Path) -> None:
    """The indicator of an object holds its four shapes and four weights, side by side."""
    found = read_folder(folder).indicators

    assert found.shape == (2, 36)
    assert found[0].reshape(4, 9).tolist() == [
        [1, 0, 0, 0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 1, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 1, 0, 0],
        [0, 0, 0, 1, 1, 0, 0, 0, 0],
    ]
    assert found[1, :9].tolist() == [0, 1, 0, 0, 0, 0, 0, 1, 0]


def test_select_takes_objects_in_the_order_asked_for(folder: Path) -> None:
    """A selection has the pushes of the chosen objects, and the source and digest of the whole folder."""
    found = read_folder(folder)
    chosen = found.select([SECOND, FIRST])

    assert chosen.descriptors == (SECOND, FIRST)
    assert (chosen.pushers == found.pushers[::-1]).all()
    assert (chosen.outcomes == found.outcomes[::-1]).all()
    assert (chosen.valid == found.valid[::-1]).all()
    assert (chosen.source, chosen.digest) == (found.source, found.digest)


def test_select_finds_objects_up_to_rotation(folder: Path) -> None:
    """A published descriptor selects the file of a turned one, with the context and the frame of that file."""
    turned = FIRST[2:] + FIRST[:2]
    found, chosen = read_folder(folder), read_folder(folder).select([SECOND, turned])

    assert turned not in found.descriptors
    assert chosen.descriptors == (SECOND, FIRST)
    assert (chosen.pushers == found.pushers[::-1]).all()
    assert (chosen.indicators == found.indicators[::-1]).all()


def test_select_refuses_two_files_of_one_object(folder: Path) -> None:
    """An object with files under two descriptors is refused if it is selected, and ignored otherwise."""
    turned = FIRST[2:] + FIRST[:2]
    write_object(folder, turned, some_rows(4, 7), some_rows(4, 8))

    with pytest.raises(DataError, match=f"{FIRST} and {turned} are the same object, turned"):
        read_folder(folder).select([FIRST])
    assert read_folder(folder).select([SECOND]).descriptors == (SECOND,)


def test_normalised_files_without_raw_ones_are_read_in_si_units(folder: Path) -> None:
    """The published statistics convert normalised files, and the digest is that of the files read."""
    before = read_folder(folder)
    for path in folder.glob(SECOND + "*"):
        path.unlink()
    write_object(folder, SECOND, some_rows(2, 1), some_rows(2, 2), (Variant.NORMALISED,))

    after = read_folder(folder)
    assert after.descriptors == before.descriptors
    assert after.pushers == pytest.approx(before.pushers, rel=1e-6)
    assert after.outcomes == pytest.approx(before.outcomes, rel=1e-6)
    assert after.digest != before.digest


def test_raw_files_are_read_if_both_variants_exist(folder: Path) -> None:
    """Normalised twins change neither the pushes nor the digest."""
    before = read_folder(folder)
    write_object(folder, FIRST, some_rows(4, 30), some_rows(4, 40), (Variant.NORMALISED,))

    assert read_folder(folder).digest == before.digest
    assert (read_folder(folder).pushers == before.pushers).all()


def test_a_folder_above_the_pushes_names_those_below(folder: Path) -> None:
    """The error about a folder above those of pushes lists the folders to name instead."""
    with pytest.raises(DataError, match=f"name {re.escape(str(folder))} instead"):
        read_folder(folder.parent)


def test_selecting_missing_objects_names_them(folder: Path) -> None:
    """The error about missing objects counts them, names the first few and gives the remedy."""
    missing = ["4a4a4a4a", "4a4a4a3a", "4a4a4a2a", "4a4a4a1a", "3a4a4a4a", "3a3a4a4a"]

    with pytest.raises(DataError) as caught:
        read_folder(folder).select([FIRST, *missing])

    message = str(caught.value)
    assert "6 of the 7 objects" in message
    assert ", ".join(missing[:5]) + " ..." in message
    assert missing[5] not in message
    assert "make data" in message


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    """The error about a missing folder names it and the ways to get pushes."""
    with pytest.raises(DataError, match=r"is not a folder of pushes.*make data.*another folder") as caught:
        read_folder(tmp_path / "nowhere")

    assert str(tmp_path / "nowhere") in str(caught.value)


def test_an_empty_folder_is_named(tmp_path: Path) -> None:
    """The error about a folder without a pusher file names it."""
    with pytest.raises(DataError, match="holds no") as caught:
        read_folder(tmp_path)

    assert str(tmp_path) in str(caught.value)


def replaced(name: str, content: bytes | Array) -> Callable[[Path], None]:
    """Return damage: a file holds these bytes or this array instead."""

    def damage(folder: Path) -> None:
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            np.save(folder / name, content)

    return damage


def edited(name: str, edit: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Return damage: the bytes of a file are edited."""

    def damage(folder: Path) -> None:
        (folder / name).write_bytes(edit((folder / name).read_bytes()))

    return damage


def renamed(name: str, other: str) -> Callable[[Path], None]:
    """Return damage: a file has another name."""

    def damage(folder: Path) -> None:
        (folder / name).rename(folder / other)

    return damage


def removed(name: str) -> Callable[[Path], None]:
    """Return damage: a file is gone."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()

    return damage


def copied_as(other: str) -> Callable[[Path], None]:
    """Return damage: the first object is present under two names."""

    def damage(folder: Path) -> None:
        for name in (FIRST_X, FIRST_Y):
            shutil.copy(folder / name, folder / name.replace(FIRST, other))

    return damage


def with_value(row: int, value: float) -> Array:
    """Return four rows, one of which holds this value."""
    rows = some_rows(4, 5)
    rows[row, 1] = value
    return rows


def zipped() -> bytes:
    """Return an archive of arrays, which numpy reads too."""
    buffer = io.BytesIO()
    np.savez(buffer, some_rows(4, 1))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("damage", "file", "fault"),
    [
        pytest.param(removed(FIRST_Y), FIRST_Y, "is missing beside", id="missing outcome file"),
        pytest.param(edited(FIRST_X, lambda c: c[:-1]), FIRST_X, "not a complete .npy file", id="a byte short"),
        pytest.param(edited(FIRST_Y, lambda c: c[:60]), FIRST_Y, "not a complete .npy file", id="cut in its header"),
        pytest.param(replaced(FIRST_X, b""), FIRST_X, "not a complete .npy file", id="no bytes"),
        pytest.param(replaced(FIRST_X, b"x,y\n1,2\n"), FIRST_X, "not a complete .npy file", id="text"),
        pytest.param(
            edited(FIRST_X, lambda c: c.replace(b"}", b" ")),
            FIRST_X,
            "not a complete .npy file",
            id="header not closed",
        ),
        pytest.param(
            edited(FIRST_X, lambda c: c.replace(b"(4, 3), }" + 16 * b" ", b"(4" + 16 * b"0" + b", 3), }")),
            FIRST_X,
            "not a complete .npy file",
            id="header of more rows than any memory",
        ),
        pytest.param(replaced(FIRST_X, zipped()), FIRST_X, "an archive of arrays", id="archive"),
        pytest.param(replaced(FIRST_X, np.zeros((4, 2))), FIRST_X, "(4, 2)", id="two columns"),
        pytest.param(replaced(FIRST_Y, np.zeros(12)), FIRST_Y, "(12,)", id="one dimension"),
        pytest.param(replaced(FIRST_Y, np.zeros((0, 3))), FIRST_Y, "(0, 3)", id="no rows"),
        pytest.param(
            edited(FIRST_X, lambda c: c.replace(b"<f8", b"<i8")), FIRST_X, "expected float32 or float64", id="integers"
        ),
        pytest.param(replaced(FIRST_X, with_value(2, math.nan)), FIRST_X, "row 2 is not finite", id="NaN"),
        pytest.param(replaced(FIRST_Y, with_value(3, -math.inf)), FIRST_Y, "row 3 is not finite", id="infinity"),
        pytest.param(replaced(FIRST_Y, some_rows(3, 6)), FIRST_Y, "has 3 rows", id="outcomes of fewer pushes"),
        pytest.param(renamed(FIRST_X, "9z" + FIRST_X[2:]), "9z" + FIRST_X[2:], "8-character descriptor", id="no digit"),
        pytest.param(renamed(FIRST_X, "1B" + FIRST_X[2:]), "1B" + FIRST_X[2:], "on shape 1", id="impossible object"),
        pytest.param(copied_as(FIRST + "_again"), FIRST_X, "the same object", id="one object twice"),
    ],
)
def test_a_damaged_folder_is_refused_by_file(
    folder: Path, damage: Callable[[Path], None], file: str, fault: str
) -> None:
    """The error about a damaged file names it and the damage."""
    damage(folder)

    with pytest.raises(DataError) as caught:
        read_folder(folder)

    assert file in str(caught.value)
    assert fault in str(caught.value)


@pytest.mark.parametrize("wrapped", [True, False], ids=["inside an npy", "bare"])
def test_a_pickle_is_never_loaded(folder: Path, tmp_path: Path, wrapped: bool) -> None:
    """A file that carries code is refused like any broken file, and the code does not run."""
    sprung = tmp_path / "sprung"
    if wrapped:
        np.save(folder / FIRST_X, np.array([[PickleTrap(sprung)] * 3], dtype=object), allow_pickle=True)
    else:
        (folder / FIRST_X).write_bytes(pickle.dumps(PickleTrap(sprung)))

    with pytest.raises(DataError, match=r"not a complete \.npy file of numbers") as caught:
        read_folder(folder)

    assert FIRST_X in str(caught.value)
    assert not sprung.exists()


@pytest.mark.parametrize("name", [FIRST_X, FIRST_Y, SECOND + PUSHER_SUFFIX, SECOND + OUTCOME_SUFFIX])
def test_the_digest_changes_with_every_byte_read(folder: Path, name: str) -> None:
    """A change of the lowest bit of one number of one file changes the digest."""
    before = read_folder(folder).digest
    content = bytearray((folder / name).read_bytes())
    content[-8] ^= 1
    (folder / name).write_bytes(content)

    assert read_folder(folder).digest != before


def test_the_digest_changes_with_the_names_of_the_objects(folder: Path) -> None:
    """A change of an object's descriptor changes the digest."""
    before = read_folder(folder).digest
    for suffix in (PUSHER_SUFFIX, OUTCOME_SUFFIX):
        (folder / (SECOND + suffix)).rename(folder / ("2C3a3a4a" + suffix))

    assert read_folder(folder).digest != before


def test_the_digest_depends_on_the_files_of_pushes_alone(folder: Path, tmp_path: Path) -> None:
    """The digest does not change with the folder, times, order of writing, or other files."""
    before = read_folder(folder).digest
    other = tmp_path / "elsewhere"
    declare_dataset(other, {"source": "declared this time"})
    write_object(other, FIRST, some_rows(4, 3), some_rows(4, 4))
    write_object(other, SECOND, some_rows(2, 1), some_rows(2, 2))
    np.save(other / f"shape_{FIRST}.npy", np.zeros((2, 2)))
    np.save(other / (FIRST + "_X_3_norm.npy"), np.zeros((4, 3)))
    (other / f".{FIRST_X}.part").write_bytes(b"half")
    os.utime(other / FIRST_X, (0, 0))

    assert read_folder(other).digest == before


def test_undeclared_files_have_an_unknown_source(folder: Path) -> None:
    """A folder without a declaration is called neither simulated nor real."""
    assert read_folder(folder).source == UNKNOWN_SOURCE
    assert "undeclared" in UNKNOWN_SOURCE


def test_a_declared_folder_names_its_source(tmp_path: Path) -> None:
    """The pushes of a folder carry the source that the folder declares."""
    declare_dataset(tmp_path, {"source": "simulated pushes (a test)", "simulated": True})
    write_object(tmp_path, FIRST, some_rows(1, 1), some_rows(1, 2))

    assert read_folder(tmp_path).source == "simulated pushes (a test)"


def test_an_object_exists_if_both_its_files_do(folder: Path) -> None:
    """An object with only one of its two files does not exist."""
    assert has_object(folder, FIRST)
    (folder / FIRST_Y).unlink()
    assert not has_object(folder, FIRST)
    assert not has_object(folder, "3a3a3a3a")


def test_writing_leaves_only_the_two_files(tmp_path: Path) -> None:
    """No part file stays behind after an object is written."""
    write_object(tmp_path, FIRST, some_rows(1, 1), some_rows(1, 2))

    assert sorted(path.name for path in tmp_path.iterdir()) == [FIRST_X, FIRST_Y]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a few simulated pushes of three objects."""
    folder = tmp_path_factory.mktemp("simulated") / "abs"
    simulate_dataset(Simulation(omnipush_descriptors()[:3], pushes_per_object=5), folder, threads=1, quiet=True)
    return folder


def only(folder: Path, variant: Variant) -> Path:
    """Remove the files of the other variant from a folder."""
    other = next(each for each in Variant if each is not variant)
    for suffix in (other.pusher_suffix, other.outcome_suffix):
        for path in folder.glob("*" + suffix):
            path.unlink()
    return folder


@pytest.mark.parametrize("kept", [tuple(Variant), (Variant.RAW,)], ids=["both variants", "raw files alone"])
def test_raw_files_give_the_same_tensors_to_the_bit(simulated: Path, tmp_path: Path, kept: tuple[Variant, ...]) -> None:
    """An export with raw files has equal arrays and, because the bytes are the same, an equal digest."""
    assert export_variants(simulated, tmp_path / "out", tuple(Variant), quiet=True) == 3
    before, after = (
        read_folder(simulated),
        read_folder(tmp_path / "out" if len(kept) == 2 else only(tmp_path / "out", *kept)),
    )

    assert after.descriptors == before.descriptors
    for name in ("pushers", "outcomes", "valid"):
        assert getattr(after, name).tobytes() == getattr(before, name).tobytes(), name
    assert (after.digest, after.source) == (before.digest, before.source)


def test_normalised_files_give_the_same_tensors_within_rounding(simulated: Path, tmp_path: Path) -> None:
    """An export of normalised files alone differs by at most one step of float32: it is converted in float64."""
    export_variants(simulated, tmp_path / "out", tuple(Variant), quiet=True)
    before, after = read_folder(simulated), read_folder(only(tmp_path / "out", Variant.NORMALISED))

    assert after.descriptors == before.descriptors
    assert (after.valid == before.valid).all()
    for name in ("pushers", "outcomes"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=FLOAT32_STEP, atol=1e-15)
    assert after.source == before.source
    assert after.digest != before.digest  # other files were read


def test_raw_files_can_be_made_from_normalised_ones(simulated: Path, tmp_path: Path) -> None:
    """Raw files exported from normalised ones agree with the original ones within rounding."""
    export_variants(simulated, tmp_path / "normalised", (Variant.NORMALISED,), quiet=True)
    export_variants(tmp_path / "normalised", tmp_path / "raw", (Variant.RAW,), quiet=True)

    assert {path.name for path in (tmp_path / "raw").iterdir()} == {path.name for path in simulated.iterdir()}
    np.testing.assert_allclose(
        read_folder(tmp_path / "raw").outcomes, read_folder(simulated).outcomes, rtol=FLOAT32_STEP, atol=1e-15
    )


def test_normalised_files_hold_the_published_transformation(tmp_path: Path) -> None:
    """Normalised numbers are minus the published mean, divided by the published deviation, both written out here."""
    pushers, outcomes = plausible_pushes(4, 1)
    write_object(tmp_path, "1a2b3c4a", pushers, outcomes, (Variant.NORMALISED,))

    found = np.load(tmp_path / "1a2b3c4a_X_3_norm.npy"), np.load(tmp_path / "1a2b3c4a_y_3_norm.npy")
    assert found[0][2, 0] == pytest.approx((pushers[2, 0] + 0.0016330612124875188) / 0.05546203628182411)
    assert found[1][3, 2] == pytest.approx((outcomes[3, 2] + 0.002690065884962678) / 0.21515865623950958)
    assert not list(tmp_path.glob("*not_norm*"))


def test_an_export_keeps_the_declared_source(tmp_path: Path) -> None:
    """An export carries the declared source of its folder, or the unknown one if the folder declares none."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    export_variants(tmp_path / "abs", tmp_path / "declared", tuple(Variant), quiet=True)
    (tmp_path / "abs" / DATASET_FILE).unlink()
    export_variants(tmp_path / "abs", tmp_path / "undeclared", tuple(Variant), quiet=True)

    assert read_folder(tmp_path / "declared").source == SOURCE
    assert read_folder(tmp_path / "undeclared").source == UNKNOWN_SOURCE


def test_pushes_of_another_origin_are_not_mixed_in(tmp_path: Path) -> None:
    """An export is refused into a folder with another declaration, with undeclared pushes, or into itself."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    for name in ("bare", "other"):
        (tmp_path / name).mkdir()
        write_object(tmp_path / name, "1a1a1a1a", *plausible_pushes(2, 1))

    with pytest.raises(DataError, match="not declared as simulated"):
        export_variants(tmp_path / "abs", tmp_path / "bare", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="already holds pushes"):
        export_variants(tmp_path / "other", tmp_path / "bare", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="is the folder to export"):
        export_variants(tmp_path / "abs", tmp_path / "abs" / ".." / "abs", tuple(Variant), quiet=True)
    assert len(list_folder(tmp_path / "bare").pairs) == 1


def test_a_broken_folder_is_not_exported(tmp_path: Path) -> None:
    """The error about a broken folder names the fault, and no file is written."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    (tmp_path / "abs" / "1a2b3c4a_y_3_not_norm.npy").unlink()

    with pytest.raises(DataError, match="is missing beside"):
        export_variants(tmp_path / "abs", tmp_path / "out", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="name the folder of one surface"):
        export_variants(tmp_path, tmp_path / "out", tuple(Variant), quiet=True)
    assert not (tmp_path / "out").exists()
