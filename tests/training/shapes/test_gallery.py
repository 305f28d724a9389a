"""Gallery of shapes: a picture of the families that are asked for, the same for the same seed."""

from pathlib import Path

from PIL import Image

from training.shapes.gallery import draw_gallery


def test_the_gallery_shows_the_families_and_is_repeatable(tmp_path: Path) -> None:
    """Equal seeds give equal files, others differ, and more families give a higher picture."""
    first, again, other, larger = (tmp_path / f"{name}.png" for name in ("first", "again", "other", "larger"))
    draw_gallery(first, ["mug"])
    draw_gallery(again, ["mug"])
    draw_gallery(other, ["mug"], seed=1)
    draw_gallery(larger, ["mug", "L", "box"])

    assert first.read_bytes() == again.read_bytes() != other.read_bytes()
    with Image.open(first) as one, Image.open(larger) as three:
        assert three.width == one.width
        assert abs(three.height - 2 * one.height) <= 1
