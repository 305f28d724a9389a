"""A run folder as bytes: all of it goes, what changed comes back, and a torn arrival is begun again."""

from pathlib import Path

from training.fitting.run_folder import CHECKPOINT_FILE
from training.paper.run_transfer import changed, pack, unpack


def test_a_folder_survives_the_journey(tmp_path: Path) -> None:
    """Every file but those that were half written."""
    parcel = {CHECKPOINT_FILE: b"2", "metrics.jsonl": b"{}\n"}
    unpack(parcel, tmp_path / "run")
    (tmp_path / "run" / "weights.part").write_bytes(b"ha")

    assert pack(tmp_path / "run") == parcel


def test_a_run_that_has_not_begun_is_nothing(tmp_path: Path) -> None:
    """No folder yet."""
    assert pack(tmp_path / "run") == {}


def test_only_what_changed_comes_home(tmp_path: Path) -> None:
    """A finished run is not sent twice."""
    before = {"config.json": b"{}", "metrics.jsonl": b"1\n"}
    unpack(before, tmp_path)
    (tmp_path / "metrics.jsonl").write_bytes(b"1\n2\n")

    assert changed(before, tmp_path) == {"metrics.jsonl": b"1\n2\n"}


def test_the_checkpoint_is_written_last(tmp_path: Path) -> None:
    """Where something is in the way of another file, the run does not look further than it is."""
    (tmp_path / "cost.json").mkdir()
    try:
        unpack({CHECKPOINT_FILE: b"2", "cost.json": b"{}"}, tmp_path)
    except OSError:
        assert not (tmp_path / CHECKPOINT_FILE).exists()
    else:
        raise AssertionError("it was written over a folder")
