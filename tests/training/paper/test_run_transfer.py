"""Run transfer: all files of a run folder are sent, and changed files return."""

from pathlib import Path

from training.fitting.run_folder import CHECKPOINT_FILE
from training.paper.run_transfer import changed, pack, unpack


def test_a_folder_is_transferred_whole(tmp_path: Path) -> None:
    """Unpacked files pack to the same content, and partly written files are left out."""
    files = {CHECKPOINT_FILE: b"2", "metrics.jsonl": b"{}\n"}
    unpack(files, tmp_path / "run")
    (tmp_path / "run" / "weights.part").write_bytes(b"ha")

    assert pack(tmp_path / "run") == files


def test_a_run_that_has_not_begun_has_no_files(tmp_path: Path) -> None:
    """A run without a folder packs to no files."""
    assert pack(tmp_path / "run") == {}


def test_only_changed_files_return(tmp_path: Path) -> None:
    """Files that a worker has not changed are not returned."""
    before = {"config.json": b"{}", "metrics.jsonl": b"1\n"}
    unpack(before, tmp_path)
    (tmp_path / "metrics.jsonl").write_bytes(b"1\n2\n")

    assert changed(before, tmp_path) == {"metrics.jsonl": b"1\n2\n"}


def test_the_checkpoint_is_written_last(tmp_path: Path) -> None:
    """If another file cannot be written, neither is the checkpoint, so the run does not look further than it is."""
    (tmp_path / "cost.json").mkdir()
    try:
        unpack({CHECKPOINT_FILE: b"2", "cost.json": b"{}"}, tmp_path)
    except OSError:
        assert not (tmp_path / CHECKPOINT_FILE).exists()
    else:
        raise AssertionError("a file was written over a folder")
