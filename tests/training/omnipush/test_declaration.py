"""The declaration of a folder: written once, checked, copied and read."""

from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from training.omnipush.declaration import DATASET_FILE, copy_declaration, declare_dataset, read_declared, read_source


@pytest.mark.parametrize(
    "declaration",
    [b"{}", b"[]", b"{", b"\xff", b"[" * 100_000],
    ids=["no source", "a list", "not JSON", "not UTF-8", "nested without end"],
)
def test_a_declaration_without_a_source_is_refused(tmp_path: Path, declaration: bytes) -> None:
    """A declaration must say where the pushes come from, or the folder is refused by name."""
    (tmp_path / DATASET_FILE).write_bytes(declaration)

    with pytest.raises(DataError, match="key 'source'") as caught:
        read_source(tmp_path)

    assert str(tmp_path / DATASET_FILE) in str(caught.value)


def test_a_folder_may_be_declared_again(tmp_path: Path) -> None:
    """The same declaration is accepted again, even after pushes were written, and another one is refused."""
    declare_dataset(tmp_path / "new", {"source": "a", "seed": 1})
    np.save(tmp_path / "new" / "1a2b3c4a_X_3_not_norm.npy", np.zeros((1, 3)))
    declare_dataset(tmp_path / "new", {"seed": 1, "source": "a"})

    with pytest.raises(DataError, match="declares another dataset"):
        declare_dataset(tmp_path / "new", {"source": "a", "seed": 2})


def test_undeclared_files_are_not_declared_later(tmp_path: Path) -> None:
    """A folder that already holds files, perhaps the real ones, cannot be declared as simulated."""
    np.save(tmp_path / "1a2b3c4a_X_3_not_norm.npy", np.zeros((1, 3)))

    with pytest.raises(DataError, match="not declared as simulated; give an empty folder"):
        declare_dataset(tmp_path, {"source": "a"})
    assert not (tmp_path / DATASET_FILE).exists()


def test_a_declaration_is_copied_to_the_byte(tmp_path: Path) -> None:
    """The target of an export has the very declaration of its folder, or an empty folder without one."""
    declare_dataset(tmp_path / "declared", {"source": "a", "seed": 1})
    (tmp_path / "bare").mkdir()
    copy_declaration(tmp_path / "declared", tmp_path / "first")
    copy_declaration(tmp_path / "bare", tmp_path / "second")

    assert (tmp_path / "first" / DATASET_FILE).read_bytes() == (tmp_path / "declared" / DATASET_FILE).read_bytes()
    assert list((tmp_path / "second").iterdir()) == []


def test_a_default_stands_for_a_missing_declaration(tmp_path: Path) -> None:
    """A key of a declaration is read as text, and a folder without a declaration gives the default."""
    declare_dataset(tmp_path / "declared", {"seed": 1})

    assert read_declared(tmp_path / "declared", "seed", "none") == "1"
    assert read_declared(tmp_path, "seed", "none") == "none"
