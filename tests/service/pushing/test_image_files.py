"""Image files as containers: refusals before decoding, the parts that are passed on, and the memory that it takes."""

import io
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from service.errors import ImageTooLargeError, InvalidImageError, RequestError
from service.pushing.image_files import ImageLimits, exif_orientation, read_image_file
from service.pushing.images import decode
from tests.attacks.hostile_images import COSTLY_METADATA, HOSTILE, jpeg_with, picture, png_with, webp_canvas

FORMATS = ("PNG", "JPEG", "WEBP")
PIECE = 1 << 16  # bytes of coded data in one search


def coded_jpeg(data: bytes) -> bytes:
    """Return the header of a JPEG, these bytes as its coded data, and its end. It is not a picture."""
    start = picture("JPEG")
    scan = start.index(b"\xff\xda") + 2
    return start[: scan + int.from_bytes(start[scan : scan + 2])] + data + b"\xff\xd9"


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_with_its_status_and_a_message(name: str) -> None:
    """A hostile file is refused with a 4xx status, and its message names the received and the accepted value."""
    make, status = HOSTILE[name]
    with pytest.raises(RequestError, match=r"^upload: received .+; accepted is .+") as raised:
        decode(make(), where="upload")
    assert raised.value.status == status


@pytest.mark.parametrize("name", COSTLY_METADATA)
def test_metadata_never_reaches_the_decoder(name: str) -> None:
    """Text, profiles and EXIF never reach the decoder, and the pixels are those of the plain file."""
    content = COSTLY_METADATA[name]()
    file = read_image_file(content, ImageLimits(), "image")
    assert len(file.content) < 1000
    assert decode(content).levels.shape == (64, 64)


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


@pytest.mark.parametrize("file_format", FORMATS)
def test_a_file_cut_anywhere_is_refused(file_format: str) -> None:
    """A file that is cut after any byte is refused as a fault of the request."""
    content = picture(file_format, 16)
    for length in range(len(content)):
        with pytest.raises(RequestError):
            decode(content[:length])


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(FORMATS), st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=8)
)
def test_a_damaged_file_is_a_picture_or_a_fault_of_the_request(
    file_format: str, changes: list[tuple[float, int]]
) -> None:
    """A file with random changes is read as a picture or refused with an error of the tree."""
    content = bytearray(picture(file_format, 32))
    for place, value in changes:
        content[int(place * len(content))] = value
    try:
        found = decode(bytes(content), ImageLimits(max_pixels=1 << 16))
    except RequestError:
        return
    assert found.levels.size <= 1 << 16


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from((b"", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"\xff\xd8\xff", b"RIFF\x40\0\0\0WEBP")),
    st.binary(max_size=80),
)
def test_noise_behind_a_known_start_is_refused(start: bytes, noise: bytes) -> None:
    """Noise behind a known start is refused with an error of the tree."""
    with pytest.raises(RequestError):
        decode(start + noise)


@given(st.binary(max_size=200), st.sampled_from((b"II*\0", b"MM\0*", b"Exif\0\0II*\0", b"")))
def test_any_exif_block_gives_an_orientation(noise: bytes, start: bytes) -> None:
    """An EXIF block of any bytes gives an orientation from 1 to 8, and no error."""
    assert 1 <= exif_orientation(start + noise) <= 8


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(("kind", "value", "found"), [(3, 6, 6), (3, 8, 8), (3, 0, 1), (3, 9, 1), (4, 6, 1)])
def test_orientation_is_read_in_both_byte_orders(order: str, kind: int, value: int, found: int) -> None:
    """An orientation of type SHORT from 1 to 8 is read in both byte orders. Any other counts as absent."""
    start = {"<": b"II*\0", ">": b"MM\0*"}[order]
    entries = struct.pack(order + "HHIHHHHIHH", 0x010F, 2, 1, 0, 0, 0x0112, kind, 1, value, 0)
    assert exif_orientation(start + struct.pack(order + "IH", 8, 2) + entries) == found


def test_a_rare_but_whole_file_is_read() -> None:
    """Files with comments or text, a progressive JPEG and a lossless WebP are read."""
    for content in (
        jpeg_with(0xFE, b"a comment"),
        png_with(b"tEXt", b"Title\0a cat"),
        picture("JPEG", progressive=True),
        picture("WEBP", exact=True, lossless=True),
    ):
        assert decode(content).levels.shape == (64, 64)


@pytest.mark.parametrize("length", [PIECE - 1, PIECE, PIECE + 1, 2 * PIECE - 1])
def test_the_end_of_a_jpeg_is_found_wherever_its_data_is_cut_into_pieces(length: int) -> None:
    """The end of a JPEG is found across two pieces. Half an end and trailing data are refused."""
    whole = coded_jpeg(bytes(length))
    assert read_image_file(whole, ImageLimits(), "image").content == whole
    for other, fault in ((whole[:-1], "stops before"), (whole + b"\0", "behind the end")):
        with pytest.raises(InvalidImageError, match=fault):
            read_image_file(other, ImageLimits(), "image")


@pytest.mark.parametrize("inside", [b"\xff\0", b"\xff\xd0"], ids=["stuffing", "restart"])
def test_stuffing_and_restarts_across_two_pieces_are_no_end(inside: bytes) -> None:
    """A stuffed byte of 255 and a restart marker belong to the picture, also across two pieces."""
    whole = coded_jpeg(bytes(PIECE - 1) + inside + bytes(9))
    assert read_image_file(whole, ImageLimits(), "image").content == whole


def test_a_webp_of_odd_length_is_read() -> None:
    """A WebP of odd length is read with its padding byte, and refused with one byte more."""
    buffer = io.BytesIO()
    Image.new("L", (3, 3), 200).save(buffer, "WEBP", lossless=True)
    content = buffer.getvalue()
    decode(content)
    with pytest.raises(InvalidImageError):
        decode(content + b"\0")


def test_an_extended_webp_is_checked_by_its_header_and_loses_its_flags() -> None:
    """A WebP with another canvas or an animation flag is refused undecoded, and flags of dropped chunks are cleared."""
    content = webp_canvas(64, 64)
    flags = content.index(b"VP8X") + 8
    with pytest.raises(InvalidImageError, match="canvas"):
        read_image_file(webp_canvas(64, 65), ImageLimits(), "image")
    with pytest.raises(InvalidImageError, match="animation"):
        read_image_file(content[:flags] + b"\x02" + content[flags + 1 :], ImageLimits(), "image")
    described = content[:flags] + b"\x3c" + content[flags + 1 :]  # profile, alpha, EXIF, XMP
    assert read_image_file(described, ImageLimits(), "image").content[flags] == 0x10
