"""Hostile and broken image files, built in memory, each with the HTTP status that it must get."""

import io
import struct
import zlib
from collections.abc import Callable
from http import HTTPStatus
from typing import Final

import numpy as np
from PIL import Image

TOO_LARGE, UNSUPPORTED, INVALID = (
    HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
    HTTPStatus.UNPROCESSABLE_ENTITY,
)
PNG_START: Final = b"\x89PNG\r\n\x1a\n"
FRAME_OF_MANY: Final = b"\x08\0\x40\0\x40\1" + b"\1\x11\0" * 21_000  # a JPEG's frame. Pillow lists its channels.
NOISE: Final = np.random.default_rng(0).integers(0, 5, 64 * 65, dtype=np.uint8).tobytes()  # 64 rows with filters 0 to 4


def picture(file_format: str, side: int = 64, **options: object) -> bytes:
    """Create a harmless image of a grey square on black."""
    levels = np.zeros((side, side), dtype=np.uint8)
    levels[side // 4 : 3 * side // 4, side // 4 : 3 * side // 4] = 128
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, file_format, **options)
    return buffer.getvalue()


def animation(file_format: str) -> bytes:
    """Create an animation of two frames."""
    frames = [Image.new("RGB", (16, 16), colour) for colour in ("red", "blue")]
    buffer = io.BytesIO()
    frames[0].save(buffer, file_format, save_all=True, append_images=frames[1:], duration=100)
    return buffer.getvalue()


def png_chunk(name: bytes, data: bytes) -> bytes:
    """Build a PNG chunk: length, name, data, checksum."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(width: int, height: int, *chunks: bytes, depth: int = 8, colour: int = 0) -> bytes:
    """Build a PNG with these chunks between header and end."""
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return PNG_START + header + b"".join(chunks) + png_chunk(b"IEND", b"")


def png_rows(width: int, height: int) -> bytes:
    """Build the chunk of black pixels, one byte each."""
    return png_chunk(b"IDAT", zlib.compress(bytes((width + 1) * height), 9))


def png_bomb() -> bytes:
    """Build a PNG of 169 million pixels in 160 KiB."""
    return png(13_000, 13_000, png_rows(13_000, 13_000))


def png_with(name: bytes, data: bytes) -> bytes:
    """Build a small PNG with one more chunk in front of the pixels."""
    return png(64, 64, png_chunk(name, data), png_rows(64, 64))


def png_key(depth: int, colour: int) -> bytes:
    """Build a PNG that declares one colour as transparent."""
    key = png_chunk(b"tRNS", b"\0\1" * (3 if colour == 2 else 1))
    return png(4, 1, key, png_chunk(b"IDAT", zlib.compress(bytes(1 + 4 * 6))), depth=depth, colour=colour)


def exif_bomb() -> bytes:
    """Build EXIF data of 5,000 tags that point to the same 60,000 bytes: 300 MB for a reader that copies each."""
    entries = 4_990
    block = b"II*\0" + struct.pack("<IH", 8, entries)
    block += b"".join(struct.pack("<HHII", 0x8000 + tag, 7, 59_000, 0) for tag in range(entries))
    return block + bytes(64_000 - len(block))


def jpeg_with(marker: int, data: bytes) -> bytes:
    """Build a small JPEG with one more segment after its start."""
    content = picture("JPEG")
    return content[:2] + struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data + content[2:]


def jpeg_behind_an_end(data: bytes) -> bytes:
    """Build a small JPEG with bytes between an end behind its frame and its tables. Pillow's parser goes on there."""
    content = picture("JPEG")
    at = content.index(b"\xff\xc4")
    return content[:at] + b"\xff\xd9" + data + content[at:]


def jpeg_scans() -> bytes:
    """Build a JPEG whose scan is repeated a thousand times."""
    content = picture("JPEG", progressive=True)
    start = content.rindex(b"\xff\xda")
    return content[:start] + content[start:-2] * 1000 + content[-2:]


def jpeg_claiming(width: int, height: int) -> bytes:
    """Build a small JPEG whose header declares another size."""
    content = bytearray(picture("JPEG"))
    at = content.index(b"\xff\xc0") + 5
    content[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(content)


def webp_claiming(width: int, height: int) -> bytes:
    """Build a lossless WebP whose header declares another size."""
    content = bytearray(picture("WEBP", lossless=True))
    at = content.index(b"VP8L") + 9
    content[at : at + 4] = struct.pack("<I", (width - 1) | (height - 1) << 14)
    return bytes(content)


def webp_canvas(width: int, height: int) -> bytes:
    """Build a WebP whose extended header declares a larger canvas than its image."""
    frame = picture("WEBP", lossless=True)[12:]
    sizes = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    body = b"WEBP" + struct.pack("<4sI", b"VP8X", 10) + bytes(4) + sizes + frame
    return b"RIFF" + struct.pack("<I", len(body)) + body


def webp_tables(side: int) -> bytes:
    """Build a lossless WebP of this many blocks of 4 x 4 pixels a side, each with prefix codes of its own."""
    fields = [(0x2F, 8), (4 * side - 1, 14), (4 * side - 1, 14), (0, 4), (0, 1), (0, 1), (1, 1), (0, 3), (0, 1)]
    one_symbol = [(1, 1), (0, 3)]
    for alphabet in (280, 256):  # 256 symbols of 8 bits
        lengths = [(int(symbol in (8, 18)), 3) for symbol in (17, 18, 0, 1, 2, 3, 4, 5, 16, 6, 7, 8)]
        fields += [(0, 1), (8, 4), *lengths, (0, 1), *[(0, 1)] * 256]
        fields += [(1, 1), (alphabet - 256 - 11, 7)] if alphabet > 256 else []
    fields += one_symbol * 3
    for number in range(side * side):
        fields += [(int(f"{byte:08b}"[::-1], 2), 8) for byte in (number & 255, number >> 8)]
    fields += one_symbol * 5 * side * side
    bits = "".join(f"{value:0{width}b}"[::-1] for value, width in fields)
    length = -(-len(bits) // 16) * 2 + 16
    data = int(bits[::-1], 2).to_bytes(length, "little")
    body = b"WEBP" + struct.pack("<4sI", b"VP8L", length) + data
    return b"RIFF" + struct.pack("<I", len(body)) + body


def webp_riff(length: int) -> bytes:
    """Build a WebP whose container declares this length."""
    content = picture("WEBP")
    return content[:4] + struct.pack("<I", length) + content[8:]


def _half(content: bytes) -> bytes:
    return content[: len(content) // 2]


def _noisy(file_format: str, **options: object) -> bytes:
    """Create an image that does not compress, so that half its file is half its pixels."""
    levels = np.random.default_rng(0).integers(0, 256, (64, 64), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, file_format, **options)
    return buffer.getvalue()


def _empty_chunks() -> bytes:
    return png(64, 64, png_chunk(b"IDAT", b"") * 20_000, png_rows(64, 64))


HOSTILE: Final[dict[str, tuple[Callable[[], bytes], HTTPStatus]]] = {
    "nothing": (lambda: b"", UNSUPPORTED),
    "text": (lambda: b"hello", UNSUPPORTED),
    "a script in SVG": (lambda: b"<svg xmlns='http://www.w3.org/2000/svg'><script/></svg>", UNSUPPORTED),
    "GIF": (lambda: picture("GIF"), UNSUPPORTED),
    "BMP": (lambda: picture("BMP"), UNSUPPORTED),
    "TIFF": (lambda: picture("TIFF"), UNSUPPORTED),
    "PostScript": (lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", UNSUPPORTED),
    "a PNG of 2 bits with a transparent colour": (lambda: png_key(2, 0), UNSUPPORTED),
    "a PNG of 3 x 16 bits with a transparent colour": (lambda: png_key(16, 2), UNSUPPORTED),
    "bytes over the limit": (lambda: picture("PNG") + bytes(9 << 20), TOO_LARGE),
    "a PNG bomb": (png_bomb, TOO_LARGE),
    "a PNG of one row": (lambda: png(100_000, 1, png_rows(100_000, 1)), TOO_LARGE),
    "a PNG of 2**31 pixels a side": (lambda: png(2**31 - 1, 2**31 - 1, png_rows(64, 64)), TOO_LARGE),
    "a JPEG that claims 65,500 a side": (lambda: jpeg_claiming(65_500, 65_500), TOO_LARGE),
    "a WebP that claims 16,384 a side": (lambda: webp_claiming(16_384, 16_384), TOO_LARGE),
    "a WebP of 65,536 groups of prefix codes": (lambda: webp_tables(256), TOO_LARGE),
    "a PNG of no pixels": (lambda: png(0, 64, png_rows(0, 64)), INVALID),
    "a JPEG of no rows": (lambda: jpeg_claiming(64, 0), INVALID),
    "an animated PNG": (lambda: animation("PNG"), INVALID),
    "an animated WebP": (lambda: animation("WEBP"), INVALID),
    "half a PNG": (lambda: _half(_noisy("PNG")), INVALID),
    "half a JPEG": (lambda: _half(_noisy("JPEG")), INVALID),
    "half a WebP": (lambda: _half(_noisy("WEBP")), INVALID),
    "a PNG whose rows stop halfway": (lambda: png(64, 64, png_chunk(b"IDAT", zlib.compress(NOISE)[:600])), INVALID),
    "a PNG without pixels": (lambda: png(64, 64), INVALID),
    "a PNG header alone": (lambda: PNG_START + b"\0\0\0\rIHDR", INVALID),
    "a PNG whose rows are noise": (lambda: png(64, 64, png_chunk(b"IDAT", bytes(range(256)))), INVALID),
    "a PNG with a wrong checksum": (lambda: picture("PNG").replace(b"IHDR\0\0\0\x40", b"IHDR\0\0\0\x41", 1), INVALID),
    "a PNG of depth 3": (lambda: png(64, 64, png_rows(64, 64), depth=3), INVALID),
    "a PNG whose header comes second": (lambda: PNG_START + png_chunk(b"tEXt", b"a\0b") + png(9, 9)[8:], INVALID),
    "a PNG of 20,000 empty chunks": (_empty_chunks, INVALID),
    "a JPEG without a scan": (lambda: picture("JPEG")[: picture("JPEG").index(b"\xff\xda")] + b"\xff\xd9", INVALID),
    "a JPEG of a thousand scans": (jpeg_scans, INVALID),
    "a JPEG with a table of no length": (lambda: b"\xff\xd8\xff\xdb\0\0" + picture("JPEG")[2:], INVALID),
    "a JPEG start alone": (lambda: b"\xff\xd8\xff", INVALID),
    "a WebP whose canvas is larger than its picture": (lambda: webp_canvas(2048, 2048), INVALID),
    "a WebP without a frame": (lambda: b"RIFF\x04\0\0\0WEBP", INVALID),
    "a WebP header alone": (lambda: b"RIFF\xff\xff\xff\xffWEBP", INVALID),
    "a WebP whose container is too short": (lambda: webp_riff(4), INVALID),
    "a WebP that claims another size": (lambda: webp_claiming(2048, 2048), INVALID),
    "a PNG with 60 texts of 1 MB each": (
        lambda: png(64, 64, png_chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(1 << 20))) * 60, png_rows(64, 64)),
        INVALID,
    ),
    "a PNG with a colour profile bomb": (
        lambda: png_with(b"iCCP", b"a\0\0" + zlib.compress(bytes(256 << 20))),
        INVALID,
    ),
    "a JPEG with a mebibyte of fill bytes": (
        lambda: b"\xff\xd8" + b"\xff" * (1 << 20) + picture("JPEG")[2:],
        INVALID,
    ),
    "a JPEG with a mebibyte of junk": (
        lambda: jpeg_with(0xFE, b"").replace(b"\xff\xfe\0\2", b"\xff\xfe\0\2" + bytes(1 << 20)),
        INVALID,
    ),
    "a JPEG of a million segments behind an end before its scan": (
        lambda: jpeg_behind_an_end(b"\xff\xe3\0\2" * 1_000_000),
        INVALID,
    ),
    "a JPEG of 100,000 parts of EXIF behind an end before its scan": (
        lambda: jpeg_behind_an_end(b"\xff\xe1\0\x08Exif\0\0" * 100_000),
        INVALID,
    ),
    "a JPEG of a frame of 21,000 channels": (lambda: jpeg_with(0xC0, FRAME_OF_MANY), INVALID),
    "a JPEG of a hierarchy of 100 frames": (
        lambda: jpeg_with(0xFE, b"").replace(
            b"\xff\xfe\0\2", (b"\xff\xde" + struct.pack(">H", 2 + len(FRAME_OF_MANY)) + FRAME_OF_MANY) * 100
        ),
        INVALID,
    ),
    "a PNG with an XMP of 5 MiB": (lambda: png_with(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + bytes(5 << 20)), INVALID),
}

# Files whose metadata is expensive for a careless reader. They are read like the plain file.
COSTLY_METADATA: Final[dict[str, Callable[[], bytes]]] = {
    "a PNG with an EXIF bomb": lambda: png_with(b"eXIf", exif_bomb()),
    "a JPEG with an EXIF bomb": lambda: jpeg_with(0xE1, b"Exif\0\0" + exif_bomb()),
    "a JPEG that says it is several pictures": lambda: jpeg_with(0xE2, b"MPF\0" + bytes(60)),
}
