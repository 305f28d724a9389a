"""Images: the rules by which pixels become grey levels, and a picture becomes a visual context of 32 x 32."""

import io
import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from skimage.transform import resize

from service.errors import InvalidImageError
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.images import (
    BACKGROUND_LEVEL,
    BODY_LEVEL,
    FIELD_OF_VIEW_M,
    FULL_LEVEL_MASS_KG,
    IMAGE_CONVENTION,
    GreyImage,
    decode,
    visual_context,
)
from tests.attacks.hostile_images import png, png_chunk
from tests.service.pushing.pictures import cells, noise

# Corners of a stored picture by its EXIF orientation. Those of the scene are 0 1 above and 2 3 below.
CORNERS_BY_ORIENTATION = {1: "0123", 2: "1032", 3: "3210", 4: "2301", 5: "0213", 6: "1302", 7: "3120", 8: "2031"}


def encode(image: Image.Image, file_format: str = "PNG", **options: Any) -> bytes:
    """Return a picture as a file."""
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def test_the_convention_states_the_constants() -> None:
    """The convention in manifests states the numbers with which views are drawn."""
    middle = BODY_LEVEL + (1.0 - BODY_LEVEL) * 0.060 / FULL_LEVEL_MASS_KG
    for words in (
        f"{FIELD_OF_VIEW_M:.3f} m x {FIELD_OF_VIEW_M:.3f} m",
        f"Background {BACKGROUND_LEVEL:.1f}",
        f"object {BODY_LEVEL:.1f}",
        f"{middle:.1f} for 60 g, 1.0 for {1000 * FULL_LEVEL_MASS_KG:.0f} g",
        f"{VISUAL_SIZE} x {VISUAL_SIZE}",
    ):
        assert words in IMAGE_CONVENTION


@pytest.mark.parametrize("file_format", ["PNG", "WEBP"])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (33, 20), (481, 481)])
def test_a_lossless_grey_file_gives_its_own_levels(file_format: str, size: tuple[int, int]) -> None:
    """The levels of a lossless grey file are neither scaled, stretched nor gamma-corrected."""
    levels = noise(*size)
    content = encode(Image.fromarray(levels), file_format, **({"lossless": True} if file_format == "WEBP" else {}))
    assert np.array_equal(decode(content).levels, levels)


def test_a_jpeg_gives_its_levels_within_its_own_loss() -> None:
    """A smooth JPEG of quality 95 is read within 3 of 255 levels."""
    levels = np.add.outer(np.arange(100), np.arange(100)).astype(np.uint8)
    found = decode(encode(Image.fromarray(levels), "JPEG", quality=95)).levels
    assert np.abs(found.astype(int) - levels).max() <= 3


@pytest.mark.parametrize("file_format", ["PNG", "WEBP"])
def test_colour_becomes_luma(file_format: str) -> None:
    """A colour becomes 0.299 R + 0.587 G + 0.114 B, rounded."""
    colours = np.random.default_rng(1).integers(0, 256, (20, 20, 3), dtype=np.uint8)
    content = encode(Image.fromarray(colours), file_format, **({"lossless": True} if file_format == "WEBP" else {}))
    luma = colours @ np.array([0.299, 0.587, 0.114])
    assert np.abs(decode(content).levels - luma).max() <= 0.5 + 1e-3


def test_a_palette_is_looked_up_before_it_is_grey() -> None:
    """The colour of a palette becomes grey, not its index."""
    image = Image.new("P", (2, 1))
    image.putpalette([0, 0, 0, 255, 0, 0])
    image.putpixel((1, 0), 1)
    assert decode(encode(image)).levels.tolist() == [[0, 76]]


def test_a_cmyk_jpeg_is_read_as_its_colours() -> None:
    """A CMYK picture becomes RGB first: half black ink is middle grey."""
    image = Image.new("CMYK", (16, 16), (0, 0, 0, 128))
    assert np.abs(decode(encode(image, "JPEG", quality=100)).levels.astype(int) - 127).max() <= 1


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
@pytest.mark.parametrize("file_format", ["PNG", "WEBP"])
def test_alpha_is_composited_onto_the_background(mode: str, file_format: str) -> None:
    """A transparent pixel is black, and a half transparent one is half as bright."""
    image = Image.new("RGBA", (3, 1))
    for column, alpha in enumerate((0, 128, 255)):
        image.putpixel((column, 0), (200, 200, 200, alpha))
    options = {"lossless": True, "exact": True} if file_format == "WEBP" else {}
    assert decode(encode(image.convert(mode), file_format, **options)).levels.tolist() == [[0, 100, 200]]


@pytest.mark.parametrize(
    ("image", "key"),
    [
        (Image.new("1", (2, 2), 1), 1),
        (Image.new("L", (2, 2), 128), 128),
        (Image.new("RGB", (2, 2), (9, 8, 7)), (9, 8, 7)),
        (Image.new("L", (2, 2), 5).convert("P"), 5),
        (Image.new("I;16", (2, 2), 30_000), 30_000),
    ],
    ids=lambda value: getattr(value, "mode", ""),
)
def test_a_colour_declared_transparent_is_background(image: Image.Image, key: Any) -> None:
    """The declared colour becomes black in every kind of PNG that is accepted with such a declaration."""
    assert decode(encode(image)).levels.max() > 0
    assert decode(encode(image, transparency=key)).levels.max() == 0


def test_sixteen_bits_of_grey_are_kept() -> None:
    """A grey PNG of 16 bits keeps every level."""
    levels = np.random.default_rng(2).integers(0, 65536, (9, 5), dtype=np.uint16)
    found = decode(encode(Image.fromarray(levels))).levels
    assert found.dtype == np.uint16
    assert np.array_equal(found, levels)


@pytest.mark.parametrize(("colour", "values"), [(2, (0x80FF, 0x80FF, 0x80FF)), (4, (0x80FF, 0xFFFF))])
def test_sixteen_bits_with_colour_or_alpha_are_read_by_their_upper_eight(colour: int, values: tuple[int, ...]) -> None:
    """A level of 0x80FF is read as 0x80 in a picture of 16 bits with colour or alpha."""
    row = b"\0" + struct.pack(f">{len(values)}H", *values)
    content = png(1, 1, png_chunk(b"IDAT", zlib.compress(row)), depth=16, colour=colour)
    assert decode(content).levels.tolist() == [[0x80]]


@pytest.mark.parametrize(
    ("depth", "byte", "levels"),
    [(1, 0b01100000, [0, 255, 255, 0]), (2, 0b00011011, [0, 85, 170, 255]), (4, 0x5F, [85, 255])],
)
def test_few_bits_are_spread_over_the_whole_range(depth: int, byte: int, levels: list[int]) -> None:
    """The brightest value is white at every depth."""
    row = b"\0" + bytes([byte])
    content = png(len(levels), 1, png_chunk(b"IDAT", zlib.compress(row)), depth=depth, colour=0)
    assert decode(content).levels.tolist() == [levels]


@pytest.mark.parametrize("orientation", CORNERS_BY_ORIENTATION)
@pytest.mark.parametrize("file_format", ["PNG", "JPEG", "WEBP"])
def test_exif_orientation_is_undone(orientation: int, file_format: str) -> None:
    """A picture of any orientation is turned so that its corners are those of the scene."""
    corner_levels = {"0": 0, "1": 80, "2": 160, "3": 240}
    stored = [corner_levels[corner] for corner in CORNERS_BY_ORIENTATION[orientation]]
    blocks = np.kron(np.array(stored, dtype=np.uint8).reshape(2, 2), np.ones((16, 16), dtype=np.uint8))
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"lossless": True} if file_format == "WEBP" else {}
    found = decode(encode(Image.fromarray(blocks), file_format, exif=exif, **options)).levels
    seen = [found[8, 8], found[8, 24], found[24, 8], found[24, 24]]
    assert np.abs(np.array(seen, dtype=int) - list(corner_levels.values())).max() <= 2


@pytest.mark.parametrize("side", [1, 2, 3, 16, 31, 32, 33, 47, 64, 100, 480, 481, 512, 1000])
def test_the_reduction_is_that_of_scikit_image(side: int) -> None:
    """The reduction equals scikit-image's default resize, within rounding to 8 bits and a thousandth of a level."""
    levels = noise(side, side)
    found = cells(visual_context(GreyImage(levels)))
    expected = 255 * resize(levels, (VISUAL_SIZE, VISUAL_SIZE))  # type: ignore[no-untyped-call]
    assert np.abs(found - expected).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("side", [1, 20, 32, 481, 600])
@pytest.mark.parametrize("level", [0, 1, 127, 254, 255])
def test_an_even_picture_keeps_its_level(side: int, level: int) -> None:
    """An even picture of any size keeps its level, because the weights sum to exactly one."""
    assert set(visual_context(GreyImage(np.full((side, side), level, dtype=np.uint8))).levels) == {level}


def test_halves_are_rounded_up() -> None:
    """A level exactly between black and white is rounded up to 128."""
    levels = np.zeros((64, 64), dtype=np.uint8)
    levels[:, ::2] = 255  # the kernel of 64 to 32 pixels is symmetric about every pair
    assert set(cells(visual_context(GreyImage(levels)))[:, 5]) == {128}


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 90), st.integers(1, 90), st.integers(0, 1000))
def test_the_same_picture_in_memory_and_as_a_file_gives_the_same_bytes(height: int, width: int, seed: int) -> None:
    """An array (8 bits, 16 bits, fractions) and a file (PNG, WebP) of one picture have the same visual context."""
    levels = noise(height, width, seed)
    expected = visual_context(GreyImage.from_array(levels))
    for same in (
        GreyImage.from_array(levels / 255.0),
        GreyImage.from_array((levels / 255.0).astype(np.float32)),
        GreyImage.from_array(levels.astype(np.uint16) * 257),
        GreyImage.from_array(levels.astype(">u2") * 257),
        decode(encode(Image.fromarray(levels))),
        decode(encode(Image.fromarray(levels.astype(np.uint16) * 257))),
        decode(encode(Image.fromarray(levels), "WEBP", lossless=True)),
    ):
        assert visual_context(same) == expected


@pytest.mark.parametrize("side", [97, 481, 1500])
def test_the_order_of_summing_does_not_matter(side: int) -> None:
    """Every sum is exact, so the order in which a processor adds does not change a byte."""
    levels = np.random.default_rng(side).integers(0, 65536, (side, side), dtype=np.uint16)
    found = visual_context(GreyImage(levels))
    assert visual_context(GreyImage(np.asfortranarray(levels))) == found
    turned = np.ascontiguousarray(np.rot90(levels, 2))
    assert cells(visual_context(GreyImage(turned)))[::-1, ::-1].tobytes() == found.levels


def test_a_longer_side_is_cropped_to_its_middle() -> None:
    """A longer side is cropped evenly. An odd pixel goes from the right or the bottom."""
    square = noise(40, 40)
    for before, after in ((0, 0), (3, 3), (3, 4), (100, 101)):
        wide = np.pad(square, ((0, 0), (before, after)), constant_values=255)
        for levels in (wide, np.pad(square, ((before, after), (0, 0)), constant_values=255)):
            assert visual_context(GreyImage(levels)) == visual_context(GreyImage(square))


def test_turning_a_picture_turns_its_context() -> None:
    """Turning a picture by a quarter turns its visual context by a quarter."""
    levels = noise(481, 481)
    turned = cells(visual_context(GreyImage(np.ascontiguousarray(np.rot90(levels)))))
    assert np.array_equal(turned, np.rot90(cells(visual_context(GreyImage(levels)))))


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((2, 2, 3), dtype=np.uint8), r"shape \[2, 2, 3\]"),
        (np.zeros((0, 4), dtype=np.uint8), r"shape \[0, 4\]"),
        (np.zeros((2, 2), dtype=np.int64), "int64"),
        (np.array([[0.0, np.nan]]), "not in"),
        (np.array([[0.0, 1.5]]), "not in"),
        (np.array([[-0.1, 0.5]]), "not in"),
        (np.array([["a"]]), "<U1"),
    ],
)
def test_an_array_that_is_no_picture_is_refused(array: npt.NDArray[Any], words: str) -> None:
    """An array that is no picture is refused, and the error names its shape, type or range."""
    with pytest.raises(InvalidImageError, match=words):
        GreyImage.from_array(array, "here")
