"""Processors are counted within the quota of a container."""

from pathlib import Path

import pytest

from service.processors import processors


@pytest.mark.parametrize(
    ("content", "expected"), [("100000 100000", 1), ("10000 100000", 1), ("max 100000", None), ("?", None)]
)
def test_processors_follow_the_quota_of_the_container(tmp_path: Path, content: str, expected: int | None) -> None:
    """A fraction of a processor counts as one, and without a quota the processors of the process count."""
    path = tmp_path / "cpu.max"
    path.write_text(content)
    assert processors(path) == (expected or processors(tmp_path / "absent"))
