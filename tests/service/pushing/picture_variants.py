"""Variants of one picture as files: every way to write an orientation, and the quirks of containers in the wild."""

import io
import struct
import zlib
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from PIL import Image, ImageOps

from tests.attacks.hostile_images import PNG_START, animation, png_chunk

FIRST_IN_ORIENTATION: Final = {  # the transposition that stores an upright picture in each orientation
    1: None,
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}
SHORT, LONG = 3, 4
XMP_KEY: Final = b"http://ns.adobe.com/xap/1.0/\0"
Build = Callable[[], bytes]


def scene(mode: str = "RGB") -> Image.Image:
    """Draw an upright picture of 48 x 32 pixels without any symmetry."""
    down, right = np.mgrid[0:32, 0:48]
    colours = np.stack([5 * right, 7 * down, (3 * right + 5 * down) % 256], axis=-1).astype(np.uint8)
    image = Image.fromarray(colours)
    if mode in ("LA", "RGBA"):
        image.putalpha(Image.fromarray((255 - 5 * right).astype(np.uint8)))
    return image.convert(mode)


def saved(image: Image.Image, file_format: str, **options: Any) -> bytes:
    """Return a picture as a file."""
    buffer = io.BytesIO()
    image.save(buffer, file_format, **options)
    return buffer.getvalue()


def stored(orientation: int, file_format: str) -> bytes:
    """Return the scene as a file that needs this orientation to be upright, and does not declare it."""
    transposition = FIRST_IN_ORIENTATION[orientation]
    image = scene() if transposition is None else scene().transpose(transposition)
    return saved(image, file_format, **({"lossless": True} if file_format == "WEBP" else {"quality": 95}))


def exif_block(orientation: int, order: str = "<", kind: int = SHORT) -> bytes:
    """Build a TIFF header with the orientation between two other tags."""
    value = struct.pack(order + ("HH" if kind == SHORT else "I"), *((orientation, 0)[: 2 if kind == SHORT else 1]))
    make = struct.pack(order + "HHII", 0x010F, 2, 10, 50)
    entry = struct.pack(order + "HHI", 0x0112, kind, 1) + value
    unit = struct.pack(order + "HHIHH", 0x0128, SHORT, 1, 2, 0)
    start = b"II*\0" if order == "<" else b"MM\0*"
    return start + struct.pack(order + "IH", 8, 3) + make + entry + unit + bytes(4) + b"a maker  \0"


def xmp(orientation: int, element: bool = False) -> bytes:
    """Build an XMP document with the orientation as an attribute or as an element."""
    inside = (
        f"><tiff:Orientation>{orientation}</tiff:Orientation></rdf:Description>"
        if element
        else f' tiff:Orientation="{orientation}"/>'
    )
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description{inside}</rdf:RDF></x:xmpmeta>'.encode()


def imagemagick(block: bytes) -> bytes:
    """Write an EXIF block as ImageMagick does in a text of a PNG: a name, a length, and lines of digits."""
    digits = (b"Exif\0\0" + block).hex()
    lines = "\n".join(digits[at : at + 72] for at in range(0, len(digits), 72))
    return f"\nexif\n{len(digits) // 2:8d}\n{lines}\n".encode()


def segment(marker: int, data: bytes) -> bytes:
    """Build a JPEG segment: marker, length, data."""
    return struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data


def in_jpeg(*parts: bytes, into: bytes | None = None) -> bytes:
    """Put bytes behind the start of a JPEG."""
    content = saved(scene(), "JPEG") if into is None else into
    return content[:2] + b"".join(parts) + content[2:]


def in_png(*chunks: bytes, into: bytes | None = None, behind: bool = False) -> bytes:
    """Put chunks behind the header of a PNG, or behind its pixels."""
    content = saved(scene(), "PNG") if into is None else into
    at = len(content) - 12 if behind else 33
    return content[:at] + b"".join(chunks) + content[at:]


def in_webp(name: bytes, data: bytes, into: bytes | None = None) -> bytes:
    """Put a chunk into a WebP behind its frame, and write the extended header that the chunk needs."""
    content = saved(scene(), "WEBP", lossless=True) if into is None else into
    bits = int.from_bytes(content[21:25], "little")
    flag = {b"EXIF": 0x08, b"XMP ": 0x04, b"ICCP": 0x20}.get(name, 0)
    sides = (bits & 0x3FFF).to_bytes(3, "little") + (bits >> 14 & 0x3FFF).to_bytes(3, "little")
    extended = struct.pack("<4sIB3x", b"VP8X", 10, flag) + sides
    body = b"WEBP" + extended + content[12:] + struct.pack("<4sI", name, len(data)) + data + bytes(len(data) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


def with_exif(file_format: str, order: str, kind: int, number: int) -> bytes:
    """Return the scene in an orientation that its EXIF declares."""
    block, content = exif_block(number, order, kind), stored(number, file_format)
    if file_format == "JPEG":
        return in_jpeg(segment(0xE1, b"Exif\0\0" + block), into=content)
    return in_png(png_chunk(b"eXIf", block), into=content) if file_format == "PNG" else in_webp(b"EXIF", block, content)


def with_xmp(file_format: str, element: bool, number: int) -> bytes:
    """Return the scene in an orientation that its XMP declares."""
    document, content = xmp(number, element), stored(number, file_format)
    if file_format == "JPEG":
        return in_jpeg(segment(0xE1, XMP_KEY + document), into=content)
    if file_format == "PNG":
        return in_png(png_chunk(b"iTXt", b"XML:com.adobe.xmp\0\0\0\0\0" + document), into=content)
    return in_webp(b"XMP ", document, content)


def deep_png(mode: int, *chunks: bytes, interlaced: bool = False) -> bytes:
    """Build a PNG of 16 bits: 0 grey, 2 colour, 4 grey and alpha, 6 colour and alpha."""
    channels = {0: 1, 2: 3, 4: 2, 6: 4}[mode]
    levels = np.random.default_rng(mode).integers(0, 65536, (8, 8, channels), dtype=np.uint16).astype(">u2")
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    parts = [levels[top::down, left::right] for top, left, down, right in passes] if interlaced else [levels]
    rows = b"".join(b"\0" + row.tobytes() for part in parts for row in part)
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 8, 8, 16, mode, 0, 0, interlaced))
    return PNG_START + header + b"".join(chunks) + png_chunk(b"IDAT", zlib.compress(rows)) + png_chunk(b"IEND", b"")


def animated_png(frames: int, default: bool = False) -> bytes:
    """Build a PNG that declares this number of frames and has one, which is also its default picture or is not."""
    control = png_chunk(b"acTL", struct.pack(">II", frames, 0))
    frame = png_chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 48, 32, 0, 0, 1, 10, 0, 0))
    if not default:
        return in_png(control, frame)
    content = saved(scene(), "PNG")
    start = content.index(b"IDAT") - 4
    (length,) = struct.unpack_from(">I", content, start)
    again = png_chunk(b"fdAT", struct.pack(">I", 1) + content[start + 8 : start + 8 + length])
    return in_png(frame, again, into=in_png(control), behind=True)


def animated_webp() -> bytes:
    """Build an animation of one frame, which is smaller than its canvas."""
    frame = saved(scene(), "WEBP", lossless=True)[12:]
    animation_header = struct.pack("<4sIIH", b"ANIM", 6, 0, 0)
    sides = (47).to_bytes(3, "little") + (31).to_bytes(3, "little")
    moved = (4).to_bytes(3, "little") + (2).to_bytes(3, "little") + sides + (100).to_bytes(3, "little") + b"\0"
    canvas = struct.pack("<4sIB3x", b"VP8X", 10, 0x02) + (63).to_bytes(3, "little") + (39).to_bytes(3, "little")
    body = b"WEBP" + canvas + animation_header + struct.pack("<4sI", b"ANMF", len(moved + frame)) + moved + frame
    return b"RIFF" + struct.pack("<I", len(body)) + body


def _stereo() -> bytes:
    """Return a JPEG of two pictures, as stereo and phone cameras write it."""
    return saved(scene(), "MPO", save_all=True, append_images=[Image.new("RGB", (48, 32), "red")])


def _baseline(frame_marker: int) -> bytes:
    """Return a baseline JPEG whose header declares another coding."""
    return saved(scene(), "JPEG").replace(b"\xff\xc0", bytes((0xFF, frame_marker)), 1)


ORIENTED: Final[dict[str, Callable[[int], bytes]]] = {
    **{
        f"{file_format}, EXIF {order}{kind}": partial(with_exif, file_format, order, kind)
        for file_format in ("JPEG", "PNG", "WEBP")
        for order in "<>"
        for kind in (SHORT, LONG)
    },
    **{
        f"{file_format}, XMP {'element' if element else 'attribute'}": partial(with_xmp, file_format, element)
        for file_format in ("JPEG", "PNG", "WEBP")
        for element in (False, True)
    },
    "JPEG, EXIF with its name twice": lambda number: in_jpeg(
        segment(0xE1, b"Exif\0\0" * 2 + exif_block(number)), into=stored(number, "JPEG")
    ),
    "JPEG, EXIF in two segments": lambda number: in_jpeg(
        segment(0xE1, b"Exif\0\0" + exif_block(number)[:20]),
        segment(0xE1, b"Exif\0\0" + exif_block(number)[20:]),
        into=stored(number, "JPEG"),
    ),
    "JPEG, EXIF before JFIF and against XMP": lambda number: in_jpeg(
        segment(0xE1, b"Exif\0\0" + exif_block(number)),
        segment(0xE1, XMP_KEY + xmp(3)),
        into=stored(number, "JPEG"),
    ),
    "JPEG, EXIF behind fill bytes and junk": lambda number: in_jpeg(
        b"\xff\xff\xff" + segment(0xFE, b"a comment") + b"junk\0\xff\0",
        segment(0xE1, b"Exif\0\0" + exif_block(number)),
        into=stored(number, "JPEG"),
    ),
    "PNG, EXIF behind its pixels": lambda number: in_png(
        png_chunk(b"eXIf", exif_block(number)), into=stored(number, "PNG"), behind=True
    ),
    "PNG, compressed XMP": lambda number: in_png(
        png_chunk(b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + zlib.compress(xmp(number))), into=stored(number, "PNG")
    ),
    "PNG, ImageMagick's text": lambda number: in_png(
        png_chunk(b"tEXt", b"Raw profile type exif\0" + imagemagick(exif_block(number))),
        into=stored(number, "PNG"),
    ),
    "PNG, ImageMagick's compressed text": lambda number: in_png(
        png_chunk(b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(imagemagick(exif_block(number)))),
        into=stored(number, "PNG"),
    ),
    "WebP, EXIF with its name": lambda number: in_webp(
        b"EXIF", b"Exif\0\0" + exif_block(number), into=stored(number, "WEBP")
    ),
}
PROFILE: Final = bytes(500)
PLAIN: Final[dict[str, Build]] = {
    "JPEG": lambda: saved(scene(), "JPEG"),
    "JPEG, grey": lambda: saved(scene("L"), "JPEG"),
    "JPEG, CMYK as Adobe inverts it": lambda: saved(scene("CMYK"), "JPEG"),
    "JPEG, CMYK without Adobe's segment": lambda: saved(scene("CMYK"), "JPEG").replace(b"\xff\xeeE\0", b"\xff\xeeX\0"),
    "JPEG, YCCK": lambda: _ycck(),
    "JPEG, RGB as Adobe keeps it": lambda: saved(scene(), "JPEG", keep_rgb=True),
    "JPEG, progressive": lambda: saved(scene(), "JPEG", progressive=True),
    "JPEG, 4:4:4": lambda: saved(scene(), "JPEG", subsampling=0),
    "JPEG, 4:1:1 with restarts": lambda: saved(scene(), "JPEG", subsampling="4:1:1", restart_marker_blocks=1),
    "JPEG, profile": lambda: saved(scene(), "JPEG", icc_profile=PROFILE),
    "JPEG, broken profile": lambda: in_jpeg(segment(0xE2, b"ICC_PROFILE\0\7\3" + PROFILE)),
    "JPEG, comment, and all other segments": lambda: in_jpeg(
        *[segment(marker, b"anything") for marker in (*range(0xE2, 0xF0), 0xFE)]
    ),
    "JPEG, thumbnail in its EXIF": lambda: in_jpeg(
        segment(0xE1, b"Exif\0\0" + exif_block(1) + saved(scene("L"), "JPEG"))
    ),
    "JPEG, unreadable EXIF": lambda: in_jpeg(segment(0xE1, b"Exif\0\0II*\0\xff\xff\xff\xff")),
    "JPEG, half a JFIF": lambda: in_jpeg(segment(0xE0, b"JFIF")),
    "JPEG, half an Adobe": lambda: in_jpeg(segment(0xEE, b"Adobe\0")),
    "JPEG, fill bytes before every marker": lambda: in_jpeg(b"\xff" * 9, into=_filled()),
    "JPEG, fill bytes and a zero": lambda: in_jpeg(b"\xff\xff\0"),
    "JPEG, junk before a segment": lambda: in_jpeg(segment(0xFE, b""), b"any bytes"),
    "JPEG, junk of zeros": lambda: in_jpeg(segment(0xFE, b""), bytes(40)),
    "JPEG, restart marker in its head": lambda: in_jpeg(b"\xff\xd0"),
    "JPEG, a marker of arithmetic coding": lambda: _baseline(0xC9),
    "JPEG, a marker of lossless coding": lambda: _baseline(0xC3),
    "JPEG, a marker of extended coding": lambda: _baseline(0xC1),
    "JPEG, two starts": lambda: b"\xff\xd8" + saved(scene(), "JPEG"),
    "JPEG, tables in a stream of their own": lambda: _tables() + b"\xff\xd9" + saved(scene(), "JPEG"),
    "JPEG, an end before its tables": lambda: b"\xff\xd8\xff\xd9" + saved(scene(), "JPEG"),
    "JPEG, an end before its scan": lambda: _before(0xDA, b"\xff\xd9"),
    "JPEG, an end and a start behind its frame": lambda: _before(0xC4, b"\xff\xd9\xff\xd8"),
    "JPEG, two frames": lambda: _before(0xC4, segment(0xC0, b"\x08\0\x20\0\x30\1\1\x11\0")),
    "JPEG, a hierarchy of frames": lambda: _before(0xC0, segment(0xDE, b"\x08\0\x20\0\x30\1\1\x11\0")),
    "JPEG, a frame of more channels than it says": lambda: _before(0xC0, segment(0xC0, b"\x08\0\x20\0\x30" + bytes(7))),
    "JPEG, a frame of no bytes": lambda: _before(0xC0, segment(0xC0, b"")),
    "JPEG, a first scan of one channel": lambda: first_scan_of_one_channel(scene()),
    "JPEG, padding behind its end": lambda: saved(scene(), "JPEG") + bytes(4096),
    "JPEG, a camera's raw data behind its end": lambda: saved(scene(), "JPEG") + b"BRCM" + bytes(range(256)) * 9,
    "JPEG, another JPEG behind it": lambda: saved(scene(), "JPEG") + saved(scene("L"), "JPEG"),
    "JPEG, HTML behind it": lambda: saved(scene(), "JPEG") + b"<script>alert(1)</script>",
    "JPEG, two pictures": _stereo,
    "JPEG, a broken index of pictures": lambda: in_jpeg(segment(0xE2, b"MPF\0" + b"II*\0" + bytes(60))),
    "JPEG, cut": lambda: saved(scene(), "JPEG")[:-200],
    "JPEG, without its end": lambda: saved(scene(), "JPEG")[:-2],
    "PNG": lambda: saved(scene(), "PNG"),
    "PNG, 1 bit": lambda: saved(scene("1"), "PNG"),
    "PNG, grey": lambda: saved(scene("L"), "PNG"),
    "PNG, grey and alpha": lambda: saved(scene("LA"), "PNG"),
    "PNG, colour and alpha": lambda: saved(scene("RGBA"), "PNG"),
    "PNG, palette": lambda: saved(scene().quantize(200), "PNG"),
    "PNG, palette of 2 bits": lambda: saved(scene().quantize(4), "PNG"),
    "PNG, palette with a transparent colour": lambda: saved(scene().quantize(16), "PNG", transparency=3),
    "PNG, palette with alpha": lambda: saved(scene().quantize(16), "PNG", transparency=bytes(range(0, 160, 10))),
    "PNG, grey with a transparent level": lambda: saved(scene("L"), "PNG", transparency=100),
    "PNG, 1 bit with a transparent level": lambda: saved(scene("1"), "PNG", transparency=1),
    "PNG, colour with a transparent colour": lambda: saved(scene(), "PNG", transparency=(5, 7, 8)),
    **{f"PNG, 16 bits, type {mode}": partial(deep_png, mode) for mode in (0, 2, 4, 6)},
    **{f"PNG, 16 bits, type {mode}, interlaced": partial(deep_png, mode, interlaced=True) for mode in (0, 2, 4, 6)},
    "PNG, 16 bits with a transparent level": lambda: deep_png(0, png_chunk(b"tRNS", b"\x12\x34")),
    "PNG, profile": lambda: saved(scene(), "PNG", icc_profile=PROFILE),
    "PNG, gamma, texts and private chunks": lambda: in_png(
        png_chunk(b"gAMA", struct.pack(">I", 100_000)),
        png_chunk(b"tEXt", b"Title\0a scene"),
        png_chunk(b"zTXt", b"Title\0\0" + zlib.compress(b"a scene")),
        png_chunk(b"prVt", b"anything"),
    ),
    "PNG, an unknown critical chunk": lambda: in_png(png_chunk(b"ABCD", b"anything")),
    "PNG, a text with a wrong checksum": lambda: in_png(png_chunk(b"tEXt", b"Title\0a scene")[:-1] + b"!"),
    "PNG, one frame": lambda: animated_png(1),
    "PNG, one frame that is declared behind its pixels": lambda: in_png(
        png_chunk(b"acTL", struct.pack(">II", 2, 0)), behind=True
    ),
    "PNG, no frame": lambda: animated_png(0),
    "PNG, many frames declared": lambda: animated_png((1 << 31) + 1),
    "PNG, padding behind its end": lambda: saved(scene(), "PNG") + bytes(4096),
    "PNG, a ZIP behind it": lambda: saved(scene(), "PNG") + b"PK\3\4" + bytes(64),
    "PNG, without its end": lambda: saved(scene(), "PNG")[:-12],
    "PNG, cut": lambda: saved(scene(), "PNG")[:-60],
    "WebP, lossy": lambda: saved(scene(), "WEBP"),
    "WebP, lossy with alpha": lambda: saved(scene("RGBA"), "WEBP"),
    "WebP, lossless": lambda: saved(scene(), "WEBP", lossless=True),
    "WebP, lossless with alpha": lambda: saved(scene("RGBA"), "WEBP", lossless=True, exact=True),
    "WebP, profile": lambda: saved(scene(), "WEBP", icc_profile=PROFILE),
    "WebP, an unknown chunk": lambda: in_webp(b"abcd", b"odd"),
    "WebP, an animation of one frame": animated_webp,
    "WebP, padding behind its end": lambda: saved(scene(), "WEBP") + bytes(4096),
    "WebP, cut": lambda: saved(scene(), "WEBP")[:-40],
}
ANIMATIONS: Final[dict[str, Build]] = {
    "PNG": lambda: animation("PNG"),
    "PNG, a frame beside the default picture": lambda: animated_png(1, default=True),
    "WebP": lambda: animation("WEBP"),
}


def _tables() -> bytes:
    """Return a JPEG up to its frame: its start and tables."""
    content = saved(scene(), "JPEG")
    return content[: content.index(b"\xff\xc0")]


def _before(marker: int, data: bytes) -> bytes:
    """Return a JPEG with bytes in front of the first segment of a kind."""
    content = saved(scene(), "JPEG")
    at = content.index(bytes((0xFF, marker)))
    return content[:at] + data + content[at:]


def first_scan_of_one_channel(image: Image.Image) -> bytes:
    """Return a baseline JPEG whose only scan has one of several channels, so that a decoder waits for the others."""
    content = saved(image, "JPEG", subsampling=0)
    at = content.index(b"\xff\xda")
    return content[:at] + segment(0xDA, b"\1" + content[at + 5 : at + 7] + b"\0\x3f\0") + content[at + 14 :]


def _filled() -> bytes:
    """Return a JPEG with fill bytes in front of the markers of its tables and of its frame."""
    content = saved(scene(), "JPEG")
    for marker in (b"\xff\xdb", b"\xff\xc0", b"\xff\xc4", b"\xff\xda"):
        content = content.replace(marker, b"\xff\xff\xff" + marker)
    return content


def _ycck() -> bytes:
    """Return a CMYK JPEG whose header declares that it is coded as luma, two colours and black."""
    content = saved(scene("CMYK"), "JPEG")
    at = content.index(b"Adobe") + 11
    return content[:at] + b"\2" + content[at + 1 :]


def grey(image: Image.Image) -> np.ndarray[Any, Any]:
    """Turn a picture, as Pillow opens it, to grey by the rules of ``images``: upright, on black, luma."""
    image = ImageOps.exif_transpose(image)
    if image.mode.startswith("I;16"):
        levels = np.array(image).astype(np.uint16)
        levels[levels == image.info.get("transparency", -1)] = 0
        return levels
    if image.has_transparency_data:
        image = image.convert("RGBA")
        below = Image.new("L", image.size, 0)
        below.paste(image.convert("L"), mask=image.getchannel("A"))
        return np.array(below)
    return np.array((image.convert("RGB") if image.mode not in ("1", "L") else image).convert("L"))
