"""Pictures of the frames: they are drawn, and the lengths in the documentation are those of the geometry."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.frame_pictures import CROSS, OBJECT_FILE, PICTURE_FILE, main
from service.pushing import sides


def test_both_pictures_are_drawn_alike_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two runs write the same bytes, of pictures that are not blank."""
    for folder in ("first", "second"):
        main(["--out", str(tmp_path / folder)])
    assert "look at them" in capsys.readouterr().out
    for name in (OBJECT_FILE, PICTURE_FILE):
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()
        with Image.open(tmp_path / "first" / name) as picture:
            assert np.asarray(picture.convert("L")).std() > 10.0


def test_the_cross_of_the_documentation_has_its_width(project_root: Path) -> None:
    """The page says how wide 4a4a4a4a is, which is the width of its outline, and that it is no box."""
    corners = sides.outline(CROSS).corners
    width_mm = 1e3 * (corners.max(axis=0) - corners.min(axis=0))
    page = (project_root / "docs" / "api.md").read_text(encoding="utf-8")
    assert width_mm == pytest.approx([126.0, 126.0])
    assert f"`4a4a4a4a` is a cross of {width_mm[0]:.0f} mm, not a box" in page
    assert sides.outline(CROSS).area_m2 < 0.8 * 0.126**2
