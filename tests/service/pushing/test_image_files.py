"""Image files: read as Pillow reads them or refused for a bound, and the memory and time that it takes."""

import io
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from service.errors import ImageTooLargeError, InvalidImageError, RequestError
from service.pushing import image_files
from service.pushing.image_files import ImageLimits, bound_image_file, open_image_file
from service.pushing.images import decode
from tests.attacks.hostile_images import COSTLY_METADATA, HOSTILE, picture, png_chunk, png_with, webp_tables
from tests.service.pushing.picture_variants import (
    ANIMATIONS,
    ORIENTED,
    PLAIN,
    exif_block,
    first_scan_of_one_channel,
    grey,
    in_jpeg,
    in_webp,
    saved,
    scene,
    segment,
)

FORMATS = ("PNG", "JPEG", "WEBP")
BOUNDS = r"animation|transparent colour|up to|fewer|first chunk|another size than its header"


def read_by_pillow(content: bytes) -> npt.NDArray[Any] | None:
    """Return the grey levels of a file as Pillow opens and turns it, or None if it refuses."""
    try:
        with Image.open(io.BytesIO(content), formats=FORMATS) as image:
            image.load()
            return grey(image)
    except Exception:  # any class
        return None


def check_reading(content: bytes) -> None:
    """Check that a file is read as Pillow reads it, or refused where Pillow refuses."""
    expected = read_by_pillow(content)
    if expected is None:
        with pytest.raises(RequestError, match=r"^image: received .+; accepted is .+"):
            decode(content)
        return
    found = decode(content).levels
    assert found.dtype == expected.dtype
    assert np.array_equal(found, expected)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", PLAIN)
def test_a_file_is_read_as_pillow_reads_it(name: str) -> None:
    """Every variety of a picture is read to the level as Pillow reads it, or refused where Pillow refuses."""
    check_reading(PLAIN[name]())


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ORIENTED)
def test_an_orientation_is_applied_however_it_is_written(name: str, orientation: int) -> None:
    """Every way to declare an orientation turns the picture upright, as ``ImageOps.exif_transpose`` does."""
    content = ORIENTED[name](orientation)
    check_reading(content)
    difference = decode(content).levels.astype(int) - grey(scene())
    assert np.abs(difference).mean() < 3  # upright, within the loss of a JPEG


@pytest.mark.parametrize("name", ANIMATIONS)
def test_an_animation_is_refused(name: str) -> None:
    """A file of several frames is refused and called an animation. One of a single frame is a picture."""
    with pytest.raises(InvalidImageError, match="received an animation; accepted is a still picture"):
        decode(ANIMATIONS[name]())


@pytest.mark.filterwarnings("ignore")
@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(sorted(PLAIN)),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=1, max_size=4)), max_size=4),
)
def test_a_damaged_file_is_read_as_pillow_reads_it(name: str, changes: list[tuple[float, bytes]]) -> None:
    """A file with random changes is read as Pillow reads it, or refused where Pillow refuses, or for a bound."""
    content = bytearray(PLAIN[name]())
    for place, noise in changes:
        at = int(place * len(content))
        content[at : at + len(noise)] = noise
    found: npt.NDArray[Any] | None = None
    refusal = ""
    try:
        found = decode(bytes(content), ImageLimits(max_pixels=1 << 16)).levels
    except RequestError as error:
        refusal = str(error)
    if re.search(BOUNDS, refusal):
        return
    expected = read_by_pillow(bytes(content))
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        assert np.array_equal(found, expected)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_with_its_status_and_a_message(name: str) -> None:
    """A hostile file is refused with a 4xx status, and its message names the received and the accepted value."""
    make, status = HOSTILE[name]
    with pytest.raises(RequestError, match=r"^upload: received .+; accepted is .+") as raised:
        decode(make(), where="upload")
    assert raised.value.status == status


def test_refusing_the_worst_files_takes_little_memory(project_root: Path) -> None:
    """A fresh process refuses the worst files within 40 MiB of additional memory, because it decodes none of them."""
    code = """
import resource
from service.errors import RequestError
from service.pushing.images import decode
from tests.attacks.hostile_images import COSTLY_METADATA, HOSTILE, picture
decode(picture("PNG")), decode(picture("JPEG")), decode(picture("WEBP"))
files = [make() for make, _ in HOSTILE.values()] + [make() for make in COSTLY_METADATA.values()]
before = int(open("/proc/self/statm").read().split()[1])
open("/proc/self/clear_refs", "w").write("5")
for file in files:
    try:
        decode(file)
    except RequestError:
        pass
peak = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(peak - before * resource.getpagesize() // 1024)
"""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("reads the peak of memory from Linux's /proc")
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 40 * 1024


@pytest.mark.parametrize("file_format", FORMATS)
def test_limits_hold_to_the_byte_and_to_the_pixel(file_format: str) -> None:
    """A file at a limit is accepted, and one byte, pixel or column more is refused."""
    content = picture(file_format, 64)
    decode(content, ImageLimits(len(content), 64 * 64, 64))
    for limits in (
        ImageLimits(len(content) - 1, 64 * 64, 64),
        ImageLimits(len(content), 64 * 64 - 1, 64),
        ImageLimits(len(content), 64 * 64, 63),
    ):
        with pytest.raises(ImageTooLargeError):
            decode(content, limits)


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from((b"", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"\xff\xd8\xff", b"RIFF\x40\0\0\0WEBP")),
    st.binary(max_size=80),
)
def test_noise_behind_a_known_start_is_refused(start: bytes, noise: bytes) -> None:
    """Noise behind a known start is refused with an error of the tree."""
    with pytest.raises(RequestError):
        decode(start + noise)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", COSTLY_METADATA)
def test_costly_metadata_does_not_change_the_picture(name: str) -> None:
    """A file whose tags claim more than it has is read as Pillow reads it."""
    check_reading(COSTLY_METADATA[name]())


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_file_cut_anywhere_is_read_as_pillow_reads_it(file_format: str) -> None:
    """A file that is cut after any byte is refused, unless Pillow finds all its pixels."""
    content = picture(file_format, 16)
    for length in range(len(content)):
        if read_by_pillow(content[:length]) is None:
            with pytest.raises(RequestError):
                decode(content[:length])
        else:
            assert decode(content[:length]).levels.shape == (16, 16)


def _scans(count: int) -> bytes:
    content = saved(scene(), "JPEG", progressive=True)
    start = content.rindex(b"\xff\xda")
    return content[:start] + content[start:-2] * (count + 1 - content.count(b"\xff\xda")) + content[-2:]


# Each bound: the builder of a file of this many, the largest number that is read, and the words of the refusal.
BOUNDED: dict[str, tuple[Callable[[int], bytes], int, str]] = {
    "scans of a JPEG": (_scans, image_files.MAX_JPEG_SCANS, "scans"),
    "junk in a JPEG": (
        lambda count: in_jpeg(segment(0xFE, b""), b"j" * count),
        image_files.MAX_STRAY_BYTES,
        "bytes between its parts",
    ),
    "fill bytes in a JPEG": (lambda count: in_jpeg(b"\xff" * count), image_files.MAX_STRAY_BYTES, "between its parts"),
    "EXIF segments of a JPEG": (
        lambda count: in_jpeg(segment(0xE1, b"Exif\0\0" + exif_block(6)), segment(0xE1, b"Exif\0\0") * (count - 1)),
        image_files.MAX_JPEG_EXIF_PARTS,
        "parts of EXIF",
    ),
    "segments of a JPEG": (
        lambda count: in_jpeg(segment(0xFE, b"") * (count - _segments())),
        image_files.MAX_PARTS - 1,
        "parts",
    ),
    "chunks of a PNG": (
        lambda count: png_with(b"IDAT", b"").replace(png_chunk(b"IDAT", b""), png_chunk(b"prVt", b"") * (count - 3)),
        image_files.MAX_PARTS,
        "parts",
    ),
    "compressed texts of a PNG": (
        lambda count: png_with(b"zTXt", b"").replace(
            png_chunk(b"zTXt", b""), png_chunk(b"zTXt", b"k\0\0" + zlib.compress(b"text")) * count
        ),
        image_files.MAX_PNG_COMPRESSED,
        "compressed texts",
    ),
    "compressed international texts of a PNG": (
        lambda count: png_with(b"zTXt", b"").replace(
            png_chunk(b"zTXt", b""), png_chunk(b"iTXt", b"k\0\1\0\0\0" + zlib.compress(b"text")) * count
        ),
        image_files.MAX_PNG_COMPRESSED,
        "compressed texts",
    ),
    "EXIF of a PNG": (
        lambda count: png_with(b"eXIf", exif_block(1).ljust(count - 6, b"\0")),
        image_files.MAX_METADATA_BYTES,
        "EXIF or XMP",
    ),
    "XMP of a WebP": (lambda count: in_webp(b"XMP ", bytes(count)), image_files.MAX_METADATA_BYTES, "EXIF or XMP"),
}


def _segments() -> int:
    """Return the number of segments of the plain JPEG, which have a marker and a length."""
    return sum(saved(scene(), "JPEG").count(bytes((0xFF, marker))) for marker in (0xE0, 0xDB, 0xC0, 0xC4, 0xDA))


@pytest.mark.parametrize("name", BOUNDED)
def test_a_bound_holds_to_the_one(name: str) -> None:
    """A file at a bound is read, and one more of the same is refused with the bound's name."""
    build, limit, words = BOUNDED[name]
    decode(build(limit))
    with pytest.raises(InvalidImageError, match=words):
        decode(build(limit + 1))


@pytest.mark.parametrize(
    ("content", "pixel_bytes"),
    [
        (picture("PNG"), 4),
        (picture("JPEG"), 1),
        (saved(scene(), "JPEG"), 4),
        (saved(scene("L"), "JPEG", progressive=True), 3),
        (saved(scene(), "JPEG", progressive=True, subsampling="4:2:0"), 7),
        (saved(scene(), "JPEG", progressive=True, subsampling="4:4:4"), 10),
        (saved(scene("CMYK"), "JPEG", progressive=True, subsampling="4:4:4"), 12),
        (first_scan_of_one_channel(scene()), 10),
        (first_scan_of_one_channel(scene("CMYK")), 12),
        (saved(scene(), "WEBP"), 16),
    ],
)
def test_the_memory_of_the_decoder_is_bounded_before_it_starts(content: bytes, pixel_bytes: int) -> None:
    """A picture is refused by the memory that its decoder would take: libjpeg keeps the coefficients of all scans."""
    file = bound_image_file(content, ImageLimits(), "image")
    pixels = file.width * file.height
    assert file.needed_bytes == (pixel_bytes + 4) * pixels
    decode(content, ImageLimits(max_decoder_bytes=pixel_bytes * pixels))
    with pytest.raises(ImageTooLargeError, match="that may take"):
        decode(content, ImageLimits(max_decoder_bytes=pixel_bytes * (pixels - 1)))


def test_ignored_metadata_is_not_kept_while_the_picture_is_decoded() -> None:
    """Pillow's copies of a colour profile and of Photoshop's data are let go, because they are as long as the file."""
    content = in_jpeg(
        segment(0xE2, b"ICC_PROFILE\0\1\1" + bytes(500)),
        segment(0xED, b"Photoshop 3.0\0" + b"8BIM\0\1\0\0\0\0\1\0" + bytes(256)),
    )
    with Image.open(io.BytesIO(content)) as image:
        assert {"icc_profile", "photoshop"} <= image.info.keys()
    with open_image_file(content, bound_image_file(content, ImageLimits(), "image"), "image") as image:
        assert not {"icc_profile", "photoshop"} & image.info.keys()


def test_the_tables_of_a_lossless_webp_are_estimated_by_its_blocks_and_bits() -> None:
    """A lossless WebP counts the prefix tables that it may ask for: few for a small file or a small picture."""
    empty = saved(Image.new("L", (1024, 1024)), "WEBP", lossless=True)
    noisy = saved(Image.effect_noise((256, 256), 100), "WEBP", lossless=True)
    for content in (empty, noisy, webp_tables(16)):
        decode(content)
    with pytest.raises(
        ImageTooLargeError, match=r"a WebP of 640 x 640 pixels that may take [0-9]+ MiB; accepted is up to 120 MiB"
    ):
        decode(webp_tables(160))
    lossy = bound_image_file(saved(scene(), "WEBP"), ImageLimits(), "image")
    assert lossy.pixel_bytes == 16
