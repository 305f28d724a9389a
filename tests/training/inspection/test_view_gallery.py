"""The gallery of views: reproducible, with every shape and weight."""

from pathlib import Path

import numpy as np
from PIL import Image

from training.inspection.view_gallery import GALLERY_OBJECTS, draw_gallery


def test_the_gallery_is_one_picture_and_the_same_each_time(tmp_path: Path) -> None:
    """The gallery has black and white parts, and the same seed gives the same file."""
    draw_gallery(tmp_path / "docs" / "a.png", GALLERY_OBJECTS[:3])
    draw_gallery(tmp_path / "b.png", GALLERY_OBJECTS[:3])
    draw_gallery(tmp_path / "c.png", GALLERY_OBJECTS[:3], seed=1)
    first = (tmp_path / "docs" / "a.png").read_bytes()
    assert first == (tmp_path / "b.png").read_bytes()
    assert first != (tmp_path / "c.png").read_bytes()
    grey = np.array(Image.open(tmp_path / "b.png").convert("L"))
    assert min((grey < 10).mean(), (grey > 250).mean()) > 0.1


def test_the_gallery_shows_every_shape_and_weight() -> None:
    """The twelve objects of the gallery cover every shape and every weight."""
    sides = {name[i : i + 2] for name in GALLERY_OBJECTS for i in range(0, 8, 2)}
    assert {side[0] for side in sides} == set("1234")
    assert {side[1] for side in sides} == set("abcBC")
    assert len(GALLERY_OBJECTS) == 12
