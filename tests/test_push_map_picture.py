"""The picture of a push map: drawn alike each time, from the photograph and the models that ship."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.push_map_picture import FILE, main


def test_the_picture_is_drawn_alike_each_time(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two runs write the same bytes, of a picture that is not blank, and say which push is most effective."""
    paths = [
        "--registry",
        str(project_root / "models"),
        "--picture",
        str(project_root / "docs" / "images" / "view.png"),
    ]
    for folder in ("first", "second"):
        main([*paths, "--out", str(tmp_path / folder)])
    assert "the most effective starts at" in capsys.readouterr().out
    assert (tmp_path / "first" / FILE).read_bytes() == (tmp_path / "second" / FILE).read_bytes()
    with Image.open(tmp_path / "first" / FILE) as picture:
        assert np.asarray(picture.convert("L")).std() > 10.0


def test_a_picture_that_is_not_there_is_told(tmp_path: Path) -> None:
    """The command ends with the path and without a traceback."""
    with pytest.raises(SystemExit, match="nowhere"):
        main(["--picture", str(tmp_path / "nowhere.png"), "--out", str(tmp_path)])
