"""Omnipush-format folders: what is read, what is refused by name, what the digest vouches for."""

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
from training.omnipush.declaration import DATASET_FILE, UNKNOWN_SOURCE, declare_dataset
from training.omnipush.files import Variant
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, has_object, read_folder, write_object

Array = npt.NDArray[np.float64]

FIRST, SECOND = "1a2b3c4a", "2B3a3a4a"
FIRST_X, FIRST_Y = FIRST + PUSHER_SUFFIX, FIRST + OUTCOME_SUFFIX


def some_rows(count: int, seed: int) -> Array:
    """Random numbers of the size of poses, (count, 3)."""
    return np.random.default_rng(seed).normal(0.0, 0.05, (count, 3))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four pushes of one object and two of another."""
    found = tmp_path / "omnipush"
    found.mkdir()
    write_object(found, SECOND, some_rows(2, 1), some_rows(2, 2))
    write_object(found, FIRST, some_rows(4, 3), some_rows(4, 4))
    return found


def test_what_was_written_is_read(folder: Path) -> None:
    """Pushes come back object by object, sorted by descriptor, as float32."""
    found = read_folder(folder)

    assert found.descriptors == (FIRST, SECOND)
    assert found.pushers.dtype == found.outcomes.dtype == found.valid.dtype == np.float32
    assert (found.pushers[0] == some_rows(4, 3).astype(np.float32)).all()
    assert (found.outcomes[0] == some_rows(4, 4).astype(np.float32)).all()
    assert (found.pushers[1, :2] == some_rows(2, 1).astype(np.float32)).all()
    assert (found.outcomes[1, :2] == some_rows(2, 2).astype(np.float32)).all()


def test_objects_with_fewer_pushes_are_padded(folder: Path) -> None:
    """Every object has as many rows as the longest; valid says which are pushes, and count counts those."""
    found = read_folder(folder)

    assert found.valid.tolist() == [[1, 1, 1, 1], [1, 1, 0, 0]]
    assert not found.pushers[1, 2:].any()
    assert not found.outcomes[1, 2:].any()
    assert found.count == 6


def test_the_release_s_names_and_precisions_are_read(tmp_path: Path) -> None:
    """Names may go on after the descriptor, files may be float32, and the normalised twins are left alone."""
    stem = FIRST + "_all_250"
    np.save(tmp_path / (stem + PUSHER_SUFFIX), some_rows(3, 1).astype(np.float32))
    np.save(tmp_path / (stem + OUTCOME_SUFFIX), some_rows(3, 2).astype(np.float32))
    np.save(tmp_path / (stem + "_X_3_norm.npy"), np.full((3, 3), np.nan))
    np.save(tmp_path / f"shape_{FIRST}.npy", np.zeros((481, 481)))

    found = read_folder(tmp_path)
    assert found.descriptors == (FIRST,)
    assert (found.pushers[0] == some_rows(3, 1).astype(np.float32)).all()


def test_indicators_are_those_of_the_descriptors(folder: Path) -> None:
    """Each object's context has its four shapes and four weights, side by side."""
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
    """The pushes of the chosen objects, with the source and digest of the whole folder."""
    found = read_folder(folder)
    chosen = found.select([SECOND, FIRST])

    assert chosen.descriptors == (SECOND, FIRST)
    assert (chosen.pushers == found.pushers[::-1]).all()
    assert (chosen.outcomes == found.outcomes[::-1]).all()
    assert (chosen.valid == found.valid[::-1]).all()
    assert (chosen.source, chosen.digest) == (found.source, found.digest)


def test_select_finds_objects_up_to_rotation(folder: Path) -> None:
    """A published name selects the file of a turned one, with the context and the frame of that file."""
    turned = FIRST[2:] + FIRST[:2]
    found, chosen = read_folder(folder), read_folder(folder).select([SECOND, turned])

    assert turned not in found.descriptors
    assert chosen.descriptors == (SECOND, FIRST)
    assert (chosen.pushers == found.pushers[::-1]).all()
    assert (chosen.indicators == found.indicators[::-1]).all()


def test_select_refuses_two_files_of_one_kind(folder: Path) -> None:
    """Neither can be told to be the published object; asked for others, they do no harm."""
    turned = FIRST[2:] + FIRST[:2]
    write_object(folder, turned, some_rows(4, 7), some_rows(4, 8))

    with pytest.raises(DataError, match=f"{FIRST} and {turned} are the same kind"):
        read_folder(folder).select([FIRST])
    assert read_folder(folder).select([SECOND]).descriptors == (SECOND,)


def test_objects_in_the_normalised_variant_alone_are_read_in_si(folder: Path) -> None:
    """Beside raw ones, with the published statistics; the digest is of the files read."""
    before = read_folder(folder)
    for path in folder.glob(SECOND + "*"):
        path.unlink()
    write_object(folder, SECOND, some_rows(2, 1), some_rows(2, 2), (Variant.NORMALISED,))

    after = read_folder(folder)
    assert after.descriptors == before.descriptors
    assert after.pushers == pytest.approx(before.pushers, rel=1e-6)
    assert after.outcomes == pytest.approx(before.outcomes, rel=1e-6)
    assert after.digest != before.digest


def test_raw_files_are_read_where_both_variants_are_there(folder: Path) -> None:
    """The twins change nothing, not even the digest."""
    before = read_folder(folder)
    write_object(folder, FIRST, some_rows(4, 30), some_rows(4, 40), (Variant.NORMALISED,))

    assert read_folder(folder).digest == before.digest
    assert (read_folder(folder).pushers == before.pushers).all()


def test_a_folder_above_the_pushes_names_those_below(folder: Path) -> None:
    """Whoever names a whole copy of Omnipush is told which folder to name."""
    with pytest.raises(DataError, match=f"name {re.escape(str(folder))} with --data"):
        read_folder(folder.parent)


def test_selecting_objects_that_are_not_there_names_them(folder: Path) -> None:
    """The message counts what is missing, names the first few and says what to do."""
    missing = ["4a4a4a4a", "4a4a4a3a", "4a4a4a2a", "4a4a4a1a", "3a4a4a4a", "3a3a4a4a"]

    with pytest.raises(DataError) as caught:
        read_folder(folder).select([FIRST, *missing])

    message = str(caught.value)
    assert "6 of the 7 objects" in message
    assert ", ".join(missing[:5]) + " ..." in message
    assert missing[5] not in message
    assert "make data" in message


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    """The message names the folder and the ways out."""
    with pytest.raises(DataError, match=r"is not a folder of pushes.*make data.*--data") as caught:
        read_folder(tmp_path / "nowhere")

    assert str(tmp_path / "nowhere") in str(caught.value)


def test_an_empty_folder_is_named(tmp_path: Path) -> None:
    """A folder without a single pusher file is no dataset."""
    with pytest.raises(DataError, match="holds no") as caught:
        read_folder(tmp_path)

    assert str(tmp_path) in str(caught.value)


def replaced(name: str, content: bytes | Array) -> Callable[[Path], None]:
    """Damage: a file holds these bytes or this array instead."""

    def damage(folder: Path) -> None:
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            np.save(folder / name, content)

    return damage


def edited(name: str, edit: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Damage: a file's bytes are edited."""

    def damage(folder: Path) -> None:
        (folder / name).write_bytes(edit((folder / name).read_bytes()))

    return damage


def renamed(name: str, other: str) -> Callable[[Path], None]:
    """Damage: a file has another name."""

    def damage(folder: Path) -> None:
        (folder / name).rename(folder / other)

    return damage


def removed(name: str) -> Callable[[Path], None]:
    """Damage: a file is gone."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()

    return damage


def copied_as(other: str) -> Callable[[Path], None]:
    """Damage: the first object is there twice, under two names."""

    def damage(folder: Path) -> None:
        for name in (FIRST_X, FIRST_Y):
            shutil.copy(folder / name, folder / name.replace(FIRST, other))

    return damage


def with_value(row: int, value: float) -> Array:
    """Four rows, one of which holds this value."""
    rows = some_rows(4, 5)
    rows[row, 1] = value
    return rows


def zipped() -> bytes:
    """An archive of arrays, which numpy reads too."""
    buffer = io.BytesIO()
    np.savez(buffer, some_rows(4, 1))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("damage", "file", "says"),
    [
        pytest.param(removed(FIRST_Y), FIRST_Y, "is missing beside", id="missing outcome file"),
        pytest.param(edited(FIRST_X, lambda c: c[:-1]), FIRST_X, "not a whole .npy file", id="a byte short"),
        pytest.param(edited(FIRST_Y, lambda c: c[:60]), FIRST_Y, "not a whole .npy file", id="cut in its header"),
        pytest.param(replaced(FIRST_X, b""), FIRST_X, "not a whole .npy file", id="no bytes"),
        pytest.param(replaced(FIRST_X, b"x,y\n1,2\n"), FIRST_X, "not a whole .npy file", id="text"),
        pytest.param(
            edited(FIRST_X, lambda c: c.replace(b"}", b" ")), FIRST_X, "not a whole .npy file", id="header not closed"
        ),
        pytest.param(
            edited(FIRST_X, lambda c: c.replace(b"(4, 3), }" + 16 * b" ", b"(4" + 16 * b"0" + b", 3), }")),
            FIRST_X,
            "not a whole .npy file",
            id="header of more rows than any memory",
        ),
        pytest.param(replaced(FIRST_X, zipped()), FIRST_X, "expected [pushes, 3]", id="archive"),
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
    folder: Path, damage: Callable[[Path], None], file: str, says: str
) -> None:
    """The message names the file at fault and what is wrong with it."""
    damage(folder)

    with pytest.raises(DataError) as caught:
        read_folder(folder)

    assert file in str(caught.value)
    assert says in str(caught.value)


class Trap:
    """An object whose unpickling makes a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("wrapped", [True, False], ids=["inside an npy", "bare"])
def test_a_pickle_is_never_loaded(folder: Path, tmp_path: Path, wrapped: bool) -> None:
    """A file that carries code is refused like any broken one, and the code does not run."""
    sprung = tmp_path / "sprung"
    if wrapped:
        np.save(folder / FIRST_X, np.array([[Trap(sprung)] * 3], dtype=object), allow_pickle=True)
    else:
        (folder / FIRST_X).write_bytes(pickle.dumps(Trap(sprung)))

    with pytest.raises(DataError, match=r"not a whole \.npy file of numbers") as caught:
        read_folder(folder)

    assert FIRST_X in str(caught.value)
    assert not sprung.exists()


@pytest.mark.parametrize("name", [FIRST_X, FIRST_Y, SECOND + PUSHER_SUFFIX, SECOND + OUTCOME_SUFFIX])
def test_the_digest_changes_with_every_byte_read(folder: Path, name: str) -> None:
    """The lowest bit of one number of one file makes another digest."""
    before = read_folder(folder).digest
    content = bytearray((folder / name).read_bytes())
    content[-8] ^= 1
    (folder / name).write_bytes(content)

    assert read_folder(folder).digest != before


def test_the_digest_changes_with_the_names_of_the_objects(folder: Path) -> None:
    """The same numbers under another object's name are other data."""
    before = read_folder(folder).digest
    for suffix in (PUSHER_SUFFIX, OUTCOME_SUFFIX):
        (folder / (SECOND + suffix)).rename(folder / ("2C3a3a4a" + suffix))

    assert read_folder(folder).digest != before


def test_the_digest_changes_with_nothing_else(folder: Path, tmp_path: Path) -> None:
    """Neither place, times, order of writing nor files that are not read matter."""
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
    """What nobody declared is called neither simulated nor real."""
    assert read_folder(folder).source == UNKNOWN_SOURCE
    assert "undeclared" in UNKNOWN_SOURCE


def test_a_declared_folder_names_its_source(tmp_path: Path) -> None:
    """The declaration's source is what everything made from the folder carries."""
    declare_dataset(tmp_path, {"source": "simulated pushes (a test)", "simulated": True})
    write_object(tmp_path, FIRST, some_rows(1, 1), some_rows(1, 2))

    assert read_folder(tmp_path).source == "simulated pushes (a test)"


@pytest.mark.parametrize(
    "declaration",
    [b"{}", b"[]", b"{", b"\xff", b"[" * 100_000],
    ids=["no source", "a list", "not JSON", "not UTF-8", "nested without end"],
)
def test_a_declaration_without_a_source_is_refused(folder: Path, declaration: bytes) -> None:
    """A folder that says something of itself must say where its pushes come from."""
    (folder / DATASET_FILE).write_bytes(declaration)

    with pytest.raises(DataError, match="key 'source'") as caught:
        read_folder(folder)

    assert str(folder / DATASET_FILE) in str(caught.value)


def test_declaring_twice_is_declaring_once(tmp_path: Path) -> None:
    """The same declaration is accepted again, pushes in between or not; another is refused."""
    declare_dataset(tmp_path / "new", {"source": "a", "seed": 1})
    write_object(tmp_path / "new", FIRST, some_rows(1, 1), some_rows(1, 2))
    declare_dataset(tmp_path / "new", {"seed": 1, "source": "a"})

    with pytest.raises(DataError, match="declares another dataset"):
        declare_dataset(tmp_path / "new", {"source": "a", "seed": 2})


def test_an_object_is_there_when_both_its_files_are(folder: Path) -> None:
    """Half an object is none."""
    assert has_object(folder, FIRST)
    (folder / FIRST_Y).unlink()
    assert not has_object(folder, FIRST)
    assert not has_object(folder, "3a3a3a3a")


def test_writing_leaves_nothing_but_the_two_files(tmp_path: Path) -> None:
    """No part file stays behind."""
    write_object(tmp_path, FIRST, some_rows(1, 1), some_rows(1, 2))

    assert sorted(path.name for path in tmp_path.iterdir()) == [FIRST_X, FIRST_Y]
