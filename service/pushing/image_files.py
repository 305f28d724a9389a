"""Image files: PNG, JPEG and WebP, bounded before Pillow decodes them.

Pillow decides the meaning of a file: its size, its colours, its orientation, and the picture that viewers show of
several. The walk through the container bounds its cost in advance: bytes, pixels, a side, the decoder's memory, parts,
scans, bytes between parts, and compressed texts. A walk that cannot continue stops, and Pillow refuses the file.
Files are opened by their plug-in: ``Image.open`` would also parse the index of a JPEG with several pictures, and would
warn about sizes that are refused here.
"""

import io
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from PIL import Image, JpegImagePlugin, PngImagePlugin, WebPImagePlugin

from service.errors import ImageTooLargeError, InvalidImageError, UnsupportedImageError

PNG_START: Final = b"\x89PNG\r\n\x1a\n"
JPEG_START: Final = b"\xff\xd8\xff"
FORMATS: Final = "PNG, JPEG or WebP"
MAX_PARTS: Final = 10_000  # chunks or segments. A picture of the largest size needs a tenth of that.
MAX_JPEG_SCANS: Final = 32  # every scan of a progressive JPEG costs a pass over the picture. Encoders write about 10.
MAX_JPEG_EXIF_PARTS: Final = 16  # Pillow joins them one by one. Cameras write one or two.
MAX_STRAY_BYTES: Final = 1 << 16  # between the segments of a JPEG. Pillow skips them one by one.
MAX_PNG_COMPRESSED: Final = 10  # texts and colour profiles, each of which takes Pillow up to 4 MiB
MAX_METADATA_BYTES: Final = 1 << 20  # EXIF or XMP, which are searched for the orientation
_PIECE_BYTES: Final = 1 << 16  # of a JPEG, which are searched in 20 us, because a search holds Python's lock
_PNG_MISSED_COLOURS = frozenset((b"\2\0", b"\4\0", b"\20\2"))  # bits and type whose transparent colour Pillow misses
_PNG_PIXEL_BYTES, _WEBP_PIXEL_BYTES = 4, 16  # WebP: two canvases of an animation, the frame, and Pillow's picture
_WEBP_LOSSLESS = frozenset((b"VP8L", b"ALPH", b"ANMF"))  # chunks that hold lossless data, or may
_JPEG_SCAN, _JPEG_END, _JPEG_EXIF = 0xDA, 0xD9, 0xE1
_JPEG_FRAMES = frozenset((*range(0xC0, 0xD0), 0xDE)) - {0xC4, 0xC8, 0xCC}
_JPEG_PROGRESSIVE = frozenset((0xC2, 0xC6, 0xCA, 0xCE))
_JPEG_LENGTHS = frozenset((*range(0xC0, 0xD0), *range(0xDA, 0xF0), 0xFE)) - {0xC8}  # markers with a length behind them
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]", re.DOTALL)  # other than stuffing, fill bytes and restarts
_IGNORED = ("icc_profile", "photoshop")  # of which Pillow keeps second copies, as long as the file
_SEARCHED = ("exif", "Raw profile type exif", "xmp", "XML:com.adobe.xmp")  # metadata in which Pillow seeks orientation


@dataclass(frozen=True)
class ImageLimits:
    """Limits of an image. They are checked before any pixel is decoded.

    Attributes:
        max_bytes: bytes of the file.
        max_pixels: pixels of the picture.
        max_side: pixels of its longer side.
        max_decoder_bytes: memory of the decoder. A progressive JPEG takes up to 12 bytes per pixel, a WebP 16, and a
            lossless WebP as much as its prefix tables may take.
    """

    max_bytes: int = 8 << 20
    max_pixels: int = 4096 * 3072  # a 12-megapixel camera
    max_side: int = 8192
    max_decoder_bytes: int = 120 << 20


@dataclass(frozen=True)
class ImageFile:
    """Image file within its bounds, before it is opened.

    Attributes:
        kind: name of the format.
        width, height: size that the file declares, in pixels.
        pixel_bytes: memory of the decoder, per pixel.
    """

    kind: str
    width: int
    height: int
    pixel_bytes: float

    @property
    def needed_bytes(self) -> int:
        """Return the memory to decode the picture and to turn it to grey of 16 bits, or to colour with alpha."""
        return round(self.width * self.height * (self.pixel_bytes + 4))


def bound_image_file(content: bytes, limits: ImageLimits, where: str) -> ImageFile:
    """Return the size and cost of a file of any of the three formats. Nothing is decoded.

    Raises:
        ImageTooLargeError: bytes, pixels, a side or the decoder's memory are over the limits.
        UnsupportedImageError: the file has another format.
        InvalidImageError: the file is broken, or has more parts than a picture needs.
    """
    if len(content) > limits.max_bytes:
        raise ImageTooLargeError(where, f"{len(content)} bytes", f"up to {limits.max_bytes} bytes")
    kind = _kind(content, where)
    try:
        file = _WALKS[kind](content, where)
    except struct.error as error:  # the file ends before its size
        raise _broken(kind, where) from error
    _check_size(file, limits, where)
    return file


def open_image_file(content: bytes, file: ImageFile, where: str) -> Image.Image:
    """Open a file within its bounds. ``load`` decodes it.

    Raises:
        InvalidImageError: the file is broken or animated.
    """
    try:
        image = _PLUGINS[file.kind](io.BytesIO(content))
    except MemoryError:
        raise
    except Exception as error:  # Pillow's plug-ins raise errors of any class, so no list of them is complete
        raise _broken(file.kind, where) from error
    if image.size != (file.width, file.height):
        raise InvalidImageError.at(where, "a picture of another size than its header says", "a whole picture")
    if getattr(image, "is_animated", False):
        raise InvalidImageError.at(where, "an animation", "a still picture")
    for name in _IGNORED:
        image.info.pop(name, None)
    return image


def check_metadata(image: Image.Image, where: str) -> None:
    """Accept a loaded picture whose metadata can be searched for its orientation in bounded time.

    Raises:
        InvalidImageError: there is more of it.
    """
    longest = max(len(image.info.get(name) or "") for name in _SEARCHED)
    if longest > MAX_METADATA_BYTES:
        accepted = f"up to {MAX_METADATA_BYTES} bytes: save it again without metadata"
        raise InvalidImageError.at(where, f"EXIF or XMP of {longest} bytes", accepted)


def _kind(content: bytes, where: str) -> str:
    if content.startswith(PNG_START):
        return "PNG"
    if content.startswith(JPEG_START):
        return "JPEG"
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "WebP"
    received = f"{len(content)} bytes of another format" if content else "an empty file"
    raise UnsupportedImageError(f"{where}: received {received}; accepted is {FORMATS}")


def _check_size(file: ImageFile, limits: ImageLimits, where: str) -> None:
    width, height = file.width, file.height
    if width < 1 or height < 1:
        raise InvalidImageError.at(where, f"a picture of {width} x {height} pixels", "at least 1 x 1 pixel")
    if max(width, height) > limits.max_side or width * height > limits.max_pixels:
        accepted = f"up to {limits.max_pixels} pixels and {limits.max_side} on a side"
        raise ImageTooLargeError(where, f"{width} x {height} pixels", accepted)
    decoder_bytes = width * height * file.pixel_bytes
    if decoder_bytes > limits.max_decoder_bytes:
        received = f"a {file.kind} of {width} x {height} pixels that may take {decoder_bytes / (1 << 20):.0f} MiB"
        accepted = f"up to {limits.max_decoder_bytes / (1 << 20):.0f} MiB: scale it down, or save it as a plain PNG"
        raise ImageTooLargeError(where, received, accepted)


def _walk_png(content: bytes, where: str) -> ImageFile:
    """Count the chunks of length, name, data and checksum (PNG 3rd edition, section 5)."""
    if content[12:16] != b"IHDR":
        raise InvalidImageError.at(where, "a PNG whose header is not its first chunk", "a whole PNG")
    at, compressed = len(PNG_START), 0
    for _ in range(MAX_PARTS):
        if at + 8 > len(content) or content[at + 4 : at + 8] == b"IEND":
            return _png_size(content)
        length, name = struct.unpack_from(">I4s", content, at)
        end = at + 12 + length
        compressed += _is_compressed(name, content[at + 8 : end - 4])
        if compressed > MAX_PNG_COMPRESSED:
            received = f"a PNG of more than {MAX_PNG_COMPRESSED} compressed texts or profiles"
            raise InvalidImageError.at(where, received, "fewer: save it again without metadata")
        if name == b"tRNS" and content[24:26] in _PNG_MISSED_COLOURS:
            received = f"a PNG of {content[24]} bits with a transparent colour"
            raise UnsupportedImageError(f"{where}: received {received}; accepted is an alpha channel, or 8 bits")
        at = end
    raise _endless(where)


def _is_compressed(name: bytes, data: bytes) -> bool:
    """Return whether a chunk is a compressed text or profile. An international text has a flag behind its keyword."""
    return name in (b"zTXt", b"iCCP") or (name == b"iTXt" and data.partition(b"\0")[2][:1] != b"\0")


def _png_size(content: bytes) -> ImageFile:
    width, height = struct.unpack_from(">II", content, 16)
    return ImageFile("PNG", width, height, _PNG_PIXEL_BYTES)


def _walk_jpeg(content: bytes, where: str) -> ImageFile:
    """Count scans and parts, and estimate the memory of libjpeg: with several scans it keeps all coefficients."""
    frame, several_scans, scans, exif_parts = b"", False, 0, 0
    for marker, segment in _jpeg_segments(content, where):
        if marker in _JPEG_FRAMES and not scans:
            if frame or len(segment) < 6 or len(segment) != 6 + 3 * segment[5]:
                raise _broken("JPEG", where)  # by libjpeg too, but Pillow would list all channels of all frames before
            frame, several_scans = segment, marker in _JPEG_PROGRESSIVE
        if marker == _JPEG_SCAN:
            scans += 1
            several_scans |= scans > 1 or segment[:1] < frame[5:6]  # a first scan of some channels announces others
        exif_parts += marker == _JPEG_EXIF and segment.startswith(b"Exif\0\0")
        if scans > MAX_JPEG_SCANS:
            received, accepted = f"a JPEG of more than {MAX_JPEG_SCANS} scans", "fewer scans: save it again"
            raise InvalidImageError.at(where, received, accepted)
        if exif_parts > MAX_JPEG_EXIF_PARTS:
            received = f"a JPEG of more than {MAX_JPEG_EXIF_PARTS} parts of EXIF"
            raise InvalidImageError.at(where, received, "fewer: save it again without metadata")
    height, width = struct.unpack_from(">HH", frame, 1)
    factors = [(part >> 4) * (part & 15) for part in frame[7::3]]  # of sampling, for each channel
    kept = 2 * sum(factors) / max([1, *factors]) if several_scans else 0.0
    return ImageFile("JPEG", width, height, (4 if len(factors) > 1 else 1) + kept)


def _jpeg_segments(content: bytes, where: str) -> Iterator[tuple[int, bytes]]:
    """Yield marker and data of every segment up to the end of the picture, as libjpeg finds them (T.81, annex B).

    Bytes that belong to no segment are skipped, and so is the coded data behind the start of a scan. An end in front of
    the first scan is that of a stream of tables alone, behind which the picture follows.

    Raises:
        InvalidImageError: there are too many segments, or bytes between them.
    """
    at, stray, in_scan = 2, 0, False
    for _ in range(MAX_PARTS):
        found = _next_marker(content, at)
        stray += 0 if in_scan else found - at
        if stray > MAX_STRAY_BYTES:
            received = f"a JPEG with {stray} bytes between its parts"
            raise InvalidImageError.at(where, received, f"up to {MAX_STRAY_BYTES}: save it again")
        if found + 4 > len(content) or (in_scan and content[found + 1] == _JPEG_END):
            return
        marker, at = content[found + 1], found + 2
        if marker in _JPEG_LENGTHS:
            (length,) = struct.unpack_from(">H", content, at)
            yield marker, content[at + 2 : at + length]
            at += length
        in_scan |= marker == _JPEG_SCAN
    raise _endless(where)


def _next_marker(content: bytes, at: int) -> int:
    """Return the place of the next marker, or the end of the file."""
    for start in range(at, len(content), _PIECE_BYTES):
        found = _JPEG_MARKER.search(content, start, start + _PIECE_BYTES + 1)  # a marker may lie across the end
        if found is not None:
            return found.start()
    return len(content)


def _walk_webp(content: bytes, where: str) -> ImageFile:
    """Count the RIFF chunks of name, length and data, padded to even length (RFC 9649, section 2)."""
    at, lossless = 12, 0
    for _ in range(MAX_PARTS):
        if at + 8 > len(content):
            file = _webp_size(content)
            tables = _webp_tables(file, min(lossless, len(content)))
            return replace(file, pixel_bytes=file.pixel_bytes + tables / max(1, file.width * file.height))
        name, length = struct.unpack_from("<4sI", content, at)
        lossless += length * (name in _WEBP_LOSSLESS)
        at += 8 + length + length % 2
    raise _endless(where)


def _webp_tables(file: ImageFile, coded_bytes: int) -> int:
    """Return the memory that prefix tables of lossless data may take. A few of its bits can ask for kilobytes.

    Blocks of 4 x 4 pixels may have a group of five codes each. A group is 20 bits long at least, and takes 5.6 KB and
    up to 6.2 KB for long codes, which take 1 byte of data for 60 bytes of tables.
    """
    groups = min(1 << 16, -(-file.width // 4) * -(-file.height // 4), coded_bytes * 8 // 20)
    return groups * 5600 + min(groups * 6200, coded_bytes * 60)


def _webp_size(content: bytes) -> ImageFile:
    """Return the size in the first chunk: the canvas, or the frame of a simple file (RFC 9649 and 6386)."""
    if content[12:16] == b"VP8X":
        width, height = (1 + int.from_bytes(side, "little") for side in struct.unpack_from("3s3s", content, 24))
    elif content[12:16] == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    else:
        width, height = (side & 0x3FFF for side in struct.unpack_from("<HH", content, 26))
    return ImageFile("WebP", width, height, _WEBP_PIXEL_BYTES)


_WALKS: Final[dict[str, Callable[[bytes, str], ImageFile]]] = {"PNG": _walk_png, "JPEG": _walk_jpeg, "WebP": _walk_webp}
_PLUGINS: Final[dict[str, Callable[[io.BytesIO], Image.Image]]] = {
    "PNG": PngImagePlugin.PngImageFile,
    "JPEG": JpegImagePlugin.JpegImageFile,
    "WebP": WebPImagePlugin.WebPImageFile,
}


def _broken(name: str, where: str) -> InvalidImageError:
    return InvalidImageError.at(where, f"a {name} file that stops early or is broken", f"a whole {FORMATS}")


def _endless(where: str) -> InvalidImageError:
    return InvalidImageError.at(where, f"a file of more than {MAX_PARTS} parts", "fewer parts: save it again")
