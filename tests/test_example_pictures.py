"""Pictures of the examples: drawn alike each time, and their outlines are found."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.example_pictures import METRES_PER_PIXEL, MUG_FILE, MUG_M, SIZE, VIEW_FILE, WRENCH_M, main, wrench
from benchmarks.photographs import rendered_mask
from benchmarks.silhouettes import overlap
from service.pushing.images import decode_colour
from service.silhouettes.search import find_outline

EXTENTS_M = {VIEW_FILE: WRENCH_M, MUG_FILE: MUG_M}


def test_the_pictures_of_the_documentation_are_those_of_the_command(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both show what is shipped, up to a few pixels' rounding on another processor, and are small."""
    main(["--out", str(tmp_path)])
    assert "next: python -m benchmarks.any_object" in capsys.readouterr().out
    for name in EXTENTS_M:
        shipped = (project_root / "docs" / "images" / name).read_bytes()
        assert len(shipped) < 200_000
        drawn, kept = (
            decode_colour(content).levels.astype(int) for content in ((tmp_path / name).read_bytes(), shipped)
        )
        assert np.abs(drawn - kept).mean() < 1.0


@pytest.mark.parametrize("name", EXTENTS_M)
def test_the_outlines_in_them_have_their_sizes(project_root: Path, name: str) -> None:
    """A wrench of 180 mm and a mug of 110 mm are found to within 2 mm, without a flag."""
    found = find_outline(decode_colour((project_root / "docs" / "images" / name).read_bytes()), METRES_PER_PIXEL)
    assert found.outline.extent_m == pytest.approx(EXTENTS_M[name], abs=0.002)
    assert found.flags == ()


def test_the_outline_of_the_wrench_is_the_one_that_was_drawn(project_root: Path) -> None:
    """On its wooden table the wrench is found to 0.95 of the union with the truth."""
    content = (project_root / "docs" / "images" / VIEW_FILE).read_bytes()
    found = find_outline(decode_colour(content), METRES_PER_PIXEL).outline.corners
    pixels = found / (METRES_PER_PIXEL, -METRES_PER_PIXEL) + np.array(SIZE) / 2.0
    assert overlap(pixels, rendered_mask(wrench(), SIZE) >= 0.5) > 0.95
