"""Rendered photographs of objects on tables, with their true masks.

An outline of ``training.shapes`` lies on a table of wood, cloth, stone or plain paint. Lamp, shadow, highlight, prints
on the object, optics, sensor noise and JPEG are drawn at random, within ranges that are our assumption. A generator
decides every pixel. numpy and Pillow only, because a renderer of scenes would need a graphics driver.
"""

import io
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFilter

from training.shapes.families import FAMILIES
from training.shapes.outlines import draw_outline

Plane = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Range = tuple[float, float]

TABLES: Final = ("plain", "wood", "cloth", "stone")
SHADOWS: Final = ("none", "soft", "hard")
LIGHTS: Final = ("even", "uneven", "spot")
LONGER_SIDE: Final = (960, 1600)  # pixels
ASPECTS: Final = (1.0, 4.0 / 3.0, 3.0 / 2.0, 16.0 / 9.0)
SHARES: Final[Range] = (0.05, 0.70)  # extent of the object over the shorter side of the picture
MARGIN: Final = 0.02  # of the shorter side: kept free between object and border
LEAST_CONTRAST: Final = 0.18  # difference of object and table, in a channel of 0 to 1
LEAST_OVER_PATTERN: Final = 4.0  # ... and in standard deviations of the table's own pattern
DARKER: Final = 0.08  # difference of luma from which an object counts as darker or lighter
SHADOW_DEPTH: Final[Range] = (0.15, 0.55)  # loss of light
BLUR_PIXELS: Final[Range] = (0.4, 1.5)
NOISE: Final[Range] = (0.003, 0.025)
JPEG_QUALITY: Final = (55, 96)
LUMA: Final = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_SUPERSAMPLING: Final = 4
_WOODS: Final = ((0.72, 0.52, 0.33), (0.55, 0.36, 0.22), (0.85, 0.72, 0.54), (0.36, 0.23, 0.15), (0.62, 0.45, 0.36))


@dataclass(frozen=True)
class Conditions:
    """Conditions that a photograph was drawn with, by which results are counted."""

    family: str
    table: str
    shadow: str
    light: str
    contrast: str  # darker, lighter, or of another hue than the table
    share: float  # extent of the object over the shorter side of the picture
    surface: str  # of the object: plain, shaded or printed


@dataclass(frozen=True, eq=False)
class Photograph:
    """Photograph with its true mask.

    Attributes:
        levels: [height, width, 3], 8 bits.
        mask: [height, width] true on the object, or on all objects.
        conditions: that it was drawn with, None for an empty table.
    """

    levels: npt.NDArray[np.uint8]
    mask: Mask
    conditions: Conditions | None

    def jpeg(self, quality: int = 85) -> bytes:
        """Return the photograph as a JPEG file."""
        buffer = io.BytesIO()
        Image.fromarray(self.levels).save(buffer, "JPEG", quality=quality)
        return buffer.getvalue()


def photograph(rng: np.random.Generator) -> Photograph:
    """Draw a photograph of one object that lies wholly in the picture."""
    return _drawn(rng, _placed(rng, _size(rng), 1))


def two_objects(rng: np.random.Generator) -> Photograph:
    """Draw a photograph of two separate objects of similar size."""
    return _drawn(rng, _placed(rng, _size(rng), 2))


def clipped(rng: np.random.Generator) -> Photograph:
    """Draw a photograph of an object of which 15 to 60 % of the extent lies beyond the border."""
    return _drawn(rng, _placed(rng, _size(rng), 1, beyond=float(rng.uniform(0.15, 0.6))))


def empty_table(rng: np.random.Generator) -> Photograph:
    """Draw a photograph of a table with nothing on it."""
    width, height = _size(rng)
    return _drawn(rng, _Layout(width, height, (), "", 0.0))


def photograph_of(
    polygon: npt.NDArray[np.float64], size: tuple[int, int], table: str, rng: np.random.Generator
) -> Photograph:
    """Draw a photograph of an outline in pixels from the upper left corner, on a table of a kind of ``TABLES``."""
    share = float(np.ptp(polygon, axis=0).max()) / min(size)
    return _drawn(rng, _Layout(*size, (polygon,), "", share), table)


@dataclass(frozen=True, eq=False)
class _Layout:
    """Objects in a picture, as polygons in pixels from the upper left corner."""

    width: int
    height: int
    polygons: tuple[npt.NDArray[np.float64], ...]
    family: str
    share: float


def _size(rng: np.random.Generator) -> tuple[int, int]:
    longer = int(rng.integers(*LONGER_SIDE))
    shorter = round(longer / float(rng.choice(ASPECTS)))
    return (longer, shorter) if rng.random() < 0.7 else (shorter, longer)


def _placed(rng: np.random.Generator, size: tuple[int, int], count: int, beyond: float = 0.0) -> _Layout:
    """Place objects at random: inside with a margin and apart, or with a share of one beyond a side."""
    width, height = size
    shorter = min(size)
    low, high = (0.12, 0.38) if count > 1 else (0.2, 0.6) if beyond else SHARES
    share = math.exp(rng.uniform(math.log(low), math.log(high)))
    while True:
        family = str(rng.choice(list(FAMILIES)))
        polygons: list[npt.NDArray[np.float64]] = []
        for _ in range(count):
            outline = draw_outline(family, rng)
            scale = share * shorter * (rng.uniform(0.75, 1.3) if count > 1 else 1.0) / outline.extent_m
            corners = (outline.corners - outline.corners.min(axis=0)) * (scale, -scale)
            corners -= corners.min(axis=0)
            extent = corners.max(axis=0)
            margin = MARGIN * shorter
            room = np.array(size) - extent - 2 * margin
            if room.min() <= 0.0:
                break
            corners += margin + rng.uniform(size=2) * room
            if beyond:
                corners[:, 0] -= corners[:, 0].min() + beyond * extent[0]
                if rng.random() < 0.5:
                    corners[:, 0] = width - corners[:, 0]
            polygons.append(corners)
        if len(polygons) == count and (count == 1 or _apart(polygons, 0.03 * shorter)):
            return _Layout(width, height, tuple(polygons), family, share)


def _apart(polygons: list[npt.NDArray[np.float64]], gap: float) -> bool:
    """Return whether the boxes of two polygons are apart by a gap along an axis."""
    first, second = polygons
    clear = np.maximum(first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0))
    return bool(clear.max() > gap)


def _drawn(rng: np.random.Generator, layout: _Layout, on: str = "") -> Photograph:
    """Draw table (of a kind, or any), objects, light and optics."""
    size = (layout.width, layout.height)
    table_kind = on or str(rng.choice(TABLES))
    table = draw_table(table_kind, size, rng)
    coverage = np.zeros(size[::-1], dtype=np.float32)
    for polygon in layout.polygons:
        coverage = np.maximum(coverage, rendered_mask(polygon, size))
    shadow, light = str(rng.choice(SHADOWS, p=(0.25, 0.55, 0.2))), str(rng.choice(LIGHTS, p=(0.3, 0.5, 0.2)))
    lamp_rad = rng.uniform(-math.pi, math.pi)
    mean = table.reshape(-1, 3).mean(axis=0)
    scene, surface, contrast, grey = table, "plain", "", False
    if layout.polygons:
        grey = rng.random() < 0.1
        colour = _object_colour(mean, float(table.std(axis=(0, 1)).max()), grey, rng)
        surface = str(rng.choice(("plain", "shaded", "printed"), p=(0.4, 0.4, 0.2)))
        body = _body(colour, surface, coverage, lamp_rad, rng)
        lost = _shadow(shadow, coverage, lamp_rad, layout.share * min(size), rng)
        covered = coverage[..., None]
        scene = np.asarray(table * (1.0 - lost[..., None]) * (1.0 - covered) + body * covered, dtype=np.float32)
        difference = float((colour - mean) @ LUMA)
        contrast = "darker" if difference < -DARKER else "lighter" if difference > DARKER else "another hue"
    lit = scene * _light(light, size, lamp_rad, rng)[..., None]
    levels = _sensed(lit, grey, rng)
    conditions = Conditions(layout.family, table_kind, shadow, light, contrast, layout.share, surface)
    return Photograph(levels, coverage >= 0.5, conditions if layout.polygons else None)


def rendered_mask(polygon: npt.NDArray[np.float64], size: tuple[int, int]) -> Plane:
    """Return the share of each pixel [height, width] that a polygon in pixels covers."""
    many = _SUPERSAMPLING
    image = Image.new("L", (size[0] * many, size[1] * many))
    whole = np.rint(polygon * many - 0.5).astype(int)  # Pillow would cut off fractions
    ImageDraw.Draw(image).polygon([(x, y) for x, y in whole.tolist()], fill=255)
    return np.asarray(image.reduce(many), dtype=np.float32) / np.float32(255.0)


def draw_table(kind: str, size: tuple[int, int], rng: np.random.Generator) -> Plane:
    """Draw a table of a kind, [height, width, 3] of 0 to 1."""
    if kind == "wood":
        return _wood(size, rng)
    base = rng.uniform(0.08, 0.9) + rng.normal(0.0, 0.10, 3)
    pattern: Plane
    if kind == "plain":
        pattern = np.float32(0.01) * noise(size, 200.0, rng)
    elif kind == "cloth":
        pattern = np.float32(rng.uniform(0.02, 0.08)) * _weave(size, rng) + np.float32(0.03) * noise(size, 60.0, rng)
    else:
        grains = [np.float32(rng.uniform(0.01, 0.05)) * noise(size, cell, rng) for cell in (2.0, 6.0, 40.0)]
        pattern = np.asarray(np.sum(grains, axis=0))
    tint = rng.uniform(0.85, 1.15, 3)
    return np.clip(base + pattern[..., None] * tint, 0.02, 0.98).astype(np.float32)


def _wood(size: tuple[int, int], rng: np.random.Generator) -> Plane:
    """Draw planks: growth rings that wander along x, fine fibres, and seams."""
    base = np.array(_WOODS[int(rng.integers(len(_WOODS)))]) * rng.uniform(0.8, 1.15)
    turned = rng.random() < 0.5
    width, height = size[::-1] if turned else size
    y = np.arange(height, dtype=np.float32)[:, None]
    wander = noise((width, height), 160.0, rng, stretch=4.0)
    rings = np.sin(2.0 * math.pi * (y / rng.uniform(12.0, 50.0) + rng.uniform(0.5, 2.0) * wander))
    fibres = noise((width, height), 1.5, rng, stretch=30.0)
    grain = rng.uniform(0.01, 0.06) * rings + rng.uniform(0.01, 0.05) * fibres + 0.03 * wander
    if rng.random() < 0.5:
        plank = rng.uniform(0.25, 0.6) * height
        number = (y // plank).astype(np.int64)
        grain = grain + rng.uniform(-0.05, 0.05, int(number.max()) + 1)[number]
        grain = grain - rng.uniform(0.1, 0.35) * (y % plank < rng.uniform(1.0, 3.0))
    colour = base * (1.0 + 1.6 * grain[..., None] * np.array((0.9, 1.0, 1.1)))
    return np.asarray(np.clip(colour.transpose(1, 0, 2) if turned else colour, 0.02, 0.98), dtype=np.float32)


def _weave(size: tuple[int, int], rng: np.random.Generator) -> Plane:
    """Draw threads that cross, around 0."""
    x, y = np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32)[:, None]
    pitch = rng.uniform(3.0, 9.0)
    threads = np.sin(2.0 * math.pi * x / pitch) * np.sin(2.0 * math.pi * y / (pitch * rng.uniform(0.8, 1.2)))
    return np.asarray(threads + 0.5 * noise(size, 1.5, rng), dtype=np.float32)


def noise(size: tuple[int, int], cell: float, rng: np.random.Generator, stretch: float = 1.0) -> Plane:
    """Draw smooth noise [height, width] of mean 0 and deviation 1, its grains of some pixels, longer along x."""
    width, height = size
    cells = max(2, round(width / (cell * stretch)) + 1), max(2, round(height / cell) + 1)
    coarse = Image.fromarray(rng.normal(size=cells[::-1]).astype(np.float32))
    plane = np.asarray(coarse.resize(size, Image.Resampling.BICUBIC))
    return np.asarray((plane - plane.mean()) / max(float(plane.std()), 1e-6), dtype=np.float32)


def _object_colour(table: Plane, pattern: float, grey: bool, rng: np.random.Generator) -> Plane:
    """Draw a colour, neutral in a third of the draws, that differs from the table's mean, or in luma if it is grey."""
    least = max(LEAST_CONTRAST, LEAST_OVER_PATTERN * pattern)
    for _ in range(1000):
        colour = np.full(3, rng.uniform(0.03, 0.95)) if rng.random() < 0.35 else rng.uniform(0.03, 0.95, 3)
        difference = colour - table
        if (abs(float(difference @ LUMA)) if grey else float(np.abs(difference).max())) >= least:
            return np.asarray(colour, dtype=np.float32)
    return np.full(3, 0.03 if table.mean() > 0.5 else 0.95, dtype=np.float32)


def _body(colour: Plane, surface: str, coverage: Plane, lamp_rad: float, rng: np.random.Generator) -> Plane:
    """Draw the object's surface over the whole picture: fine grain, and shading with a highlight, or a print."""
    size = coverage.shape[::-1]
    rows, columns = np.nonzero(coverage > 0.5)
    body = colour * (1.0 + 0.02 * noise(size, 2.0, rng)[..., None])
    if surface == "plain" or not len(rows):
        return np.clip(body, 0.0, 1.0)
    middle_x, middle_y = columns.mean(), rows.mean()
    reach = max(float(np.ptp(columns)), float(np.ptp(rows)), 4.0) / 2.0
    x, y = np.arange(size[0], dtype=np.float32) - middle_x, np.arange(size[1], dtype=np.float32)[:, None] - middle_y
    if surface == "shaded":
        towards = (x * math.cos(lamp_rad) - y * math.sin(lamp_rad)) / reach
        body = body * (1.0 + rng.uniform(0.0, 0.25) * np.clip(towards, -1.0, 1.0))[..., None]
        glint = rng.uniform(-0.4, 0.4, 2) * reach
        spot = np.exp(-((x - glint[0]) ** 2 + (y - glint[1]) ** 2) / (2.0 * (rng.uniform(0.05, 0.25) * reach) ** 2))
        body = body + (rng.uniform(0.0, 0.6) * spot)[..., None]
    else:
        turn = rng.uniform(-math.pi, math.pi)
        across = (x * math.cos(turn) + y * math.sin(turn)) / reach
        printed = (np.sin(across * rng.uniform(3.0, 12.0)) > rng.uniform(0.0, 0.8))[..., None]
        body = np.where(printed, body * 0.6 + 0.4 * rng.uniform(0.05, 0.95, 3), body)
    return np.clip(body, 0.0, 1.0).astype(np.float32)


def _shadow(kind: str, coverage: Plane, lamp_rad: float, extent: float, rng: np.random.Generator) -> Plane:
    """Return the share of light that the table loses, on the side of the object away from the lamp."""
    if kind == "none":
        return np.zeros_like(coverage)
    length = rng.uniform(0.02, 0.12) * extent
    blur = max(1.0, length * (rng.uniform(0.4, 1.0) if kind == "soft" else 0.1))
    moved = Image.fromarray(np.round(coverage * 255).astype(np.uint8))
    offset = -length * math.cos(lamp_rad), length * math.sin(lamp_rad)
    moved = moved.transform(moved.size, Image.Transform.AFFINE, (1, 0, -offset[0], 0, 1, -offset[1]))
    thrown = np.asarray(moved.filter(ImageFilter.GaussianBlur(blur)), dtype=np.float32) / 255.0
    return np.asarray(thrown * rng.uniform(*SHADOW_DEPTH), dtype=np.float32)


def _light(kind: str, size: tuple[int, int], lamp_rad: float, rng: np.random.Generator) -> Plane:
    """Return the light on each pixel, around 1."""
    x, y = np.linspace(-1.0, 1.0, size[0])[None, :], np.linspace(1.0, -1.0, size[1])[:, None]
    if kind == "even":
        return np.ones(size[::-1], dtype=np.float32)
    if kind == "spot":
        at = rng.uniform(-0.7, 0.7, 2)
        spot = np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2.0 * rng.uniform(0.6, 1.2) ** 2))
        return np.asarray(0.55 + 0.55 * spot, dtype=np.float32)
    away = 0.5 - 0.5 * (x * math.cos(lamp_rad) + y * math.sin(lamp_rad)) / math.sqrt(2.0)
    fall = (1.1 - rng.uniform(0.1, 0.55) * away) * (1.0 - rng.uniform(0.0, 0.3) * (x**2 + y**2) / 2.0)
    return np.asarray(fall, dtype=np.float32)


def _sensed(scene: Plane, grey: bool, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Add blur, sensor noise and JPEG, in colour or in grey."""
    eight = np.clip(scene * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8)
    blurred = Image.fromarray(eight).filter(ImageFilter.GaussianBlur(float(rng.uniform(*BLUR_PIXELS))))
    noisy = np.asarray(blurred, dtype=np.float32) + 255.0 * rng.uniform(*NOISE) * rng.normal(size=scene.shape)
    image = Image.fromarray(np.clip(noisy + 0.5, 0.0, 255.0).astype(np.uint8))
    if grey:
        image = image.convert("L").convert("RGB")
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=int(rng.integers(*JPEG_QUALITY)))
    return np.asarray(Image.open(buffer).convert("RGB"))
