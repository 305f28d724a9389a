"""Image files as containers: PNG, JPEG and WebP, walked in bounded time and stripped to their pixels before decoding.

Only parts that make pixels are passed on. Text, colour profiles, thumbnails and all other parts never reach a decoder.
Sizes are read from the header and bounded first. Refused are: other formats, several frames, data behind the end of the
picture (a polyglot, or the second picture that some phones append), files that stop early, and headers that ask for
more work than a picture needs. Orientation (EXIF tag 0x0112) is the only metadata that is read. The container does not
show a picture that was cut and then closed properly: the decoder fills its missing rows.
Standard library only.
"""

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from service.errors import ImageTooLargeError, InvalidImageError, UnsupportedImageError

PNG_START: Final = b"\x89PNG\r\n\x1a\n"
JPEG_START: Final = b"\xff\xd8\xff"
FORMATS: Final = "PNG, JPEG or WebP"
MAX_PARTS: Final = 10_000  # chunks or segments. A picture of the largest size needs a tenth of that.
MAX_JPEG_SCANS: Final = 32  # every scan of a progressive JPEG costs a pass over the picture. Encoders write about 10.
_PNG_PIXELS = frozenset((b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"))
_PNG_MISSED_COLOURS = frozenset(((2, 0), (4, 0), (16, 2)))  # depth and type whose transparent colour Pillow misses
_PNG_ANIMATION = frozenset((b"acTL", b"fcTL", b"fdAT"))
_WEBP_PIXELS = frozenset((b"VP8X", b"VP8 ", b"VP8L", b"ALPH"))
_WEBP_ANIMATION = frozenset((b"ANIM", b"ANMF"))
_WEBP_ALPHA, _WEBP_ANIMATED = 0x10, 0x02  # flags of a VP8X chunk
_JPEG_TABLES = frozenset((0xC4, 0xDB, 0xDD))  # Huffman and quantisation tables, restart interval
_JPEG_FRAMES = frozenset((0xC0, 0xC1, 0xC2))  # baseline, extended and progressive, Huffman coded
_JPEG_OTHER_FRAMES = frozenset((0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF))
_JPEG_SCAN, _JPEG_END, _JPEG_EXIF, _JPEG_JFIF, _JPEG_ADOBE = 0xDA, 0xD9, 0xE1, 0xE0, 0xEE
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)  # in coded data, other than stuffing and restart
_PIECE_BYTES: Final = 1 << 16  # of coded data, which are searched in 20 us
_ORIENTATION_TAG, _SHORT = 0x0112, 3


@dataclass(frozen=True)
class ImageLimits:
    """Limits of an image. They are checked before any pixel is decoded.

    Decoding takes up to 12 bytes of memory per pixel for PNG and JPEG, 21 for WebP: 260 MB at these limits.
    """

    max_bytes: int = 8 << 20
    max_pixels: int = 4096 * 3072  # a 12-megapixel camera
    max_side: int = 8192


@dataclass(frozen=True)
class ImageFile:
    """Image file reduced to the parts that make its pixels."""

    format: str  # Pillow's name
    width: int
    height: int
    orientation: int  # EXIF, 1..8. 1 is as stored.
    content: bytes


def read_image_file(content: bytes, limits: ImageLimits, where: str) -> ImageFile:
    """Read a file of any of the three formats without decoding it.

    Raises:
        ImageTooLargeError: bytes, pixels or a side are over the limits.
        UnsupportedImageError: the file has another format, or a rare variety of these.
        InvalidImageError: the file is broken, truncated or animated, or has more than one picture.
    """
    if len(content) > limits.max_bytes:
        raise ImageTooLargeError(where, f"{len(content)} bytes", f"up to {limits.max_bytes} bytes")
    try:
        file = _walker(content, where)(content, where)
    except (struct.error, IndexError) as error:
        raise _truncated(where) from error
    if file.width < 1 or file.height < 1:
        raise InvalidImageError.at(where, f"a picture of {file.width} x {file.height} pixels", "at least 1 x 1 pixel")
    if max(file.width, file.height) > limits.max_side or file.width * file.height > limits.max_pixels:
        accepted = f"up to {limits.max_pixels} pixels and {limits.max_side} on a side"
        raise ImageTooLargeError(where, f"{file.width} x {file.height} pixels", accepted)
    return file


def exif_orientation(block: bytes) -> int:
    """Return the orientation in an EXIF block, 1..8. A block without one, or an unreadable block, gives 1 (as stored).

    Only this tag is read: a general parser copies the data that the other tags point to.
    """
    block = block.removeprefix(b"Exif\0\0")
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(block[:4])
    if order is None:
        return 1
    try:
        (start,) = struct.unpack_from(order + "I", block, 4)
        (count,) = struct.unpack_from(order + "H", block, start)
        for at in range(start + 2, start + 2 + 12 * count, 12):
            tag, kind, _, value = struct.unpack_from(order + "HHIH", block, at)
            if tag == _ORIENTATION_TAG:
                return value if kind == _SHORT and 1 <= value <= 8 else 1
    except struct.error:
        return 1
    return 1


def _walker(content: bytes, where: str) -> Callable[[bytes, str], ImageFile]:
    if content.startswith(PNG_START):
        return _walk_png
    if content.startswith(JPEG_START):
        return _walk_jpeg
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return _walk_webp
    received = f"{len(content)} bytes of another format" if content else "an empty file"
    raise UnsupportedImageError(f"{where}: received {received}; accepted is {FORMATS}")


def _walk_png(content: bytes, where: str) -> ImageFile:
    """Walk chunks of length, name, data and checksum (PNG 3rd edition, section 5). The decoder verifies checksums."""
    width, height, depth, colour = struct.unpack_from(">IIBB", content, 16)
    kept, orientation, at = [PNG_START], 1, len(PNG_START)
    for _ in range(MAX_PARTS):
        length, name = struct.unpack_from(">I4s", content, at)
        end = at + 12 + length
        if end > len(content):
            raise _truncated(where)
        if (at == len(PNG_START)) != (name == b"IHDR"):
            raise InvalidImageError.at(where, "a PNG whose header is not its first chunk", "a whole PNG")
        if name in _PNG_ANIMATION:
            raise _animated(where)
        if name == b"tRNS" and (depth, colour) in _PNG_MISSED_COLOURS:
            received = f"a PNG of {depth} bits with a transparent colour"
            raise UnsupportedImageError(f"{where}: received {received}; accepted is an alpha channel, or 8 bits")
        if name in _PNG_PIXELS:
            kept.append(content[at:end])
        elif name == b"eXIf":
            orientation = exif_orientation(content[at + 8 : end - 4])
        elif name[:1].isupper():
            raise UnsupportedImageError(f"{where}: received a PNG with private parts; accepted is {FORMATS}")
        at = end
        if name == b"IEND":
            _check_end(content, at, where)
            return ImageFile("PNG", width, height, orientation, b"".join(kept))
    raise _endless(where)


def _walk_jpeg(content: bytes, where: str) -> ImageFile:
    """Walk segments of marker and length, with coded data behind each start of scan (ITU-T T.81, annex B)."""
    size: tuple[int, int] | None = None
    kept, orientation, scans, at = [content[:2]], 1, 0, 2
    for _ in range(MAX_PARTS):
        marker, end = _jpeg_segment(content, at, where)
        segment = content[at:end]
        if marker == _JPEG_END:
            if size is None or not scans:
                raise _truncated(where)
            _check_end(content, end, where)
            return ImageFile("JPEG", *size, orientation, b"".join([*kept, segment]))
        if marker in _JPEG_OTHER_FRAMES:
            raise UnsupportedImageError(f"{where}: received a rare kind of JPEG; accepted is baseline or progressive")
        if marker in _JPEG_FRAMES:
            if size is not None:
                raise InvalidImageError.at(where, "a JPEG with two frames", "one picture")
            height, width = struct.unpack_from(">HH", segment, 5)
            size = width, height
            kept.append(segment)
        elif marker == _JPEG_SCAN:
            scans += 1
            if scans > MAX_JPEG_SCANS:
                raise InvalidImageError.at(
                    where, f"a JPEG of more than {MAX_JPEG_SCANS} scans", "fewer scans: save it again"
                )
            coded = _coded_data(content, end, where)
            kept += [segment, *coded]
            end += sum(map(len, coded))
        elif marker in _JPEG_TABLES or _declares_colours(marker, segment):
            kept.append(segment)
        elif marker == _JPEG_EXIF and segment[4:10] == b"Exif\0\0":
            orientation = exif_orientation(segment[4:])
        elif not (0xE0 <= marker <= 0xEF or marker == 0xFE):  # application data and comments are left out
            raise InvalidImageError.at(where, f"a JPEG with a marker {marker:02X} in the wrong place", "a whole JPEG")
        at = end
    raise _endless(where)


def _jpeg_segment(content: bytes, at: int, where: str) -> tuple[int, int]:
    """Return the marker of the segment at this place, and the end of the segment."""
    if content[at] != 0xFF:
        raise InvalidImageError.at(where, "a JPEG with bytes between its segments", "a whole JPEG")
    marker = content[at + 1]
    if marker == _JPEG_END:
        return marker, at + 2
    (length,) = struct.unpack_from(">H", content, at + 2)
    end = at + 2 + length
    if length < 2 or end > len(content):
        raise _truncated(where)
    return marker, end


def _coded_data(content: bytes, at: int, where: str) -> list[bytes]:
    """Return the bytes up to the next marker, in pieces, because a search holds Python's lock until it ends."""
    pieces: list[bytes] = []
    for start in range(at, len(content), _PIECE_BYTES):
        end = start + _PIECE_BYTES
        found = _JPEG_MARKER.search(content, start, end + 1)  # a marker of two bytes may lie across the end
        if found is not None:
            return [*pieces, content[start : found.start()]]
        pieces.append(content[start:end])
    raise _truncated(where)


def _declares_colours(marker: int, segment: bytes) -> bool:
    """Return whether an application segment declares the coding of colours, which the decoder needs."""
    return (marker == _JPEG_JFIF and segment[4:9] == b"JFIF\0") or (marker == _JPEG_ADOBE and segment[4:9] == b"Adobe")


def _walk_webp(content: bytes, where: str) -> ImageFile:
    """Walk RIFF chunks of name, length and data, padded to even length (RFC 9649, section 2)."""
    (riff_length,) = struct.unpack_from("<I", content, 4)
    if len(content) < 8 + riff_length:
        raise _truncated(where)
    _check_end(content, 8 + riff_length + riff_length % 2, where)
    size: tuple[int, int] | None = None
    canvas: tuple[int, int] | None = None
    kept, orientation = [b""], 1
    for name, data in _webp_chunks(content, where):
        if name in _WEBP_ANIMATION or (name == b"VP8X" and data[0] & _WEBP_ANIMATED):
            raise _animated(where)
        if name == b"VP8X":
            canvas = 1 + int.from_bytes(data[4:7], "little"), 1 + int.from_bytes(data[7:10], "little")
            data = bytes([data[0] & _WEBP_ALPHA]) + data[1:]
        elif name in (b"VP8 ", b"VP8L"):
            if size is not None:
                raise InvalidImageError.at(where, "a WebP with two frames", "one picture")
            size = _vp8_size(data) if name == b"VP8 " else _vp8l_size(data)
        elif name == b"EXIF":
            orientation = exif_orientation(data)
        if name in _WEBP_PIXELS:
            kept.append(struct.pack("<4sI", name, len(data)) + data + b"\0" * (len(data) % 2))
    if size is None:
        raise _truncated(where)
    if canvas not in (None, size):
        raise InvalidImageError.at(where, "a WebP whose canvas is not the size of its picture", "a whole WebP")
    body = b"WEBP" + b"".join(kept)
    return ImageFile("WEBP", *size, orientation, b"RIFF" + struct.pack("<I", len(body)) + body)


def _webp_chunks(content: bytes, where: str) -> Iterator[tuple[bytes, bytes]]:
    at = 12
    for _ in range(MAX_PARTS):
        if at >= len(content):
            return
        name, length = struct.unpack_from("<4sI", content, at)
        end = at + 8 + length
        if end > len(content):
            raise _truncated(where)
        yield name, content[at + 8 : end]
        at = end + length % 2
    raise _endless(where)


def _vp8_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a lossy key frame (RFC 6386, section 9.1)."""
    width, height = struct.unpack_from("<HH", data, 6)
    return width & 0x3FFF, height & 0x3FFF


def _vp8l_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a lossless frame (RFC 9649, section 3.4)."""
    (bits,) = struct.unpack_from("<I", data, 1)
    return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1


def _check_end(content: bytes, end: int, where: str) -> None:
    if end != len(content):
        received = f"{len(content) - end} bytes behind the end of the picture"
        raise InvalidImageError.at(where, received, "one picture without trailing data: save it again as a plain PNG")


def _truncated(where: str) -> InvalidImageError:
    return InvalidImageError.at(where, "a file that stops before the picture does", f"a whole {FORMATS}")


def _animated(where: str) -> InvalidImageError:
    return InvalidImageError.at(where, "an animation", "a still picture")


def _endless(where: str) -> InvalidImageError:
    return InvalidImageError.at(where, f"a file of more than {MAX_PARTS} parts", "fewer parts: save it again")
