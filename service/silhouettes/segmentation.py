"""Segmentation: the one object in a photograph of a table.

First the picture is searched small. Pixels that differ from the table, on several scales, form candidates. The
strongest is cut out and segmented at a higher resolution, where mixtures of Gaussians tell object, table and shadow
apart, and a boundary of least variation divides them (as GrabCut does, Rother 2004, with a convex solver). In the end
the boundary is placed where a pixel is half object, half table.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.silhouettes.mixtures import Colours, fitted, sampled, squares
from service.silhouettes.planes import Mask, Plane, blurred, filled, grown, least_variation, reduced, resized
from service.silhouettes.tables import DARK, light_ratios
from service.silhouettes.tracing import Region, regions
from service.turns import pause

SEARCH_SIDE: Final = 256  # pixels of the longer side, where candidates are searched
CUT_SIDE: Final = 288  # ... and where the object is segmented
LEAST_SIDE: Final = 16  # pixels of the shorter side in which an object can be told from a table
_SCALES: Final = ((0.7, 1.0), (1.5, 1.0), (3.5, 0.7))  # blur in pixels, and weight
RIVAL: Final = 0.25  # of the strongest candidate's strength: another object
_CANDIDATE: Final = 14.0  # squared Mahalanobis distance from the table where a candidate begins
_EDGE: Final = 10  # pixels: the sharpest of a candidate are its edge
_SHARP: Final = 1.5  # of the sharpest percent of the table: a blunter candidate is a stain
_DISTINCT: Final = 40.0  # ... where a pixel is surely no table
_PIECE: Final = 0.1  # of the largest area: another piece of the same candidate
_ROOM: Final = 0.3  # of the object's extent: table around it in the cut
_SHADOW_DEPTH: Final = 0.58  # loss of light in the deepest shadow
_SHADOW_STEP: Final = 0.2  # of brightness, between a grey object and its shadow
_BLUR: Final = 2.0  # pixels of the picture, on either side of a boundary
_SHADE: Final = 0.7  # of a difference in brightness that may be a shadow
_SHADOW_PRIOR: Final = np.float32(-1.4)  # logarithm


@dataclass(frozen=True, eq=False)
class _Candidate:
    region: Region
    strength: float
    """sum of the squared distances from the table inside, each at most 150, times the sharpness of its edge"""


def segment(levels: npt.NDArray[np.uint8]) -> list[Region]:
    """Return the object in a photograph [h, w, 3], in its pixels, then other candidates, the largest first."""
    small = reduced(levels, SEARCH_SIDE)
    if min(small.shape[:2]) < LEAST_SIDE:
        return []
    scale = levels.shape[1] / small.shape[1]
    found = _candidates(small)
    if not found:
        return []
    pause()
    first = found[0].region.boundary * scale
    low, high = first.min(axis=0), first.max(axis=0)
    room = max(6.0 * scale, _ROOM * float((high - low).max()))
    left, top = np.maximum(0, np.floor(low - room)).astype(int)
    right, bottom = np.minimum(levels.shape[1::-1], np.ceil(high + room)).astype(int)
    cut = resized(levels[top:bottom, left:right], CUT_SIDE)
    cut_scale = (right - left) / cut.shape[1]
    seed = filled((first - (left, top)) / cut_scale, cut.shape[:2])
    refined = regions(_refined(cut, seed, 1.0 / cut_scale), 4)
    if len(refined) > 1 and refined[1].area > _PIECE * refined[0].area:  # a dark part was taken for a shadow
        refined = regions(_refined(cut, seed, 1.0 / cut_scale, shadows=False), 4)
    found_here = [Region(one.boundary * cut_scale + (left, top), one.area * cut_scale**2) for one in refined]
    others = [one for one in found[1:] if one.strength > RIVAL * found[0].strength]
    return found_here + [Region(one.region.boundary * scale, one.region.area * scale**2) for one in others]


def _candidates(small: npt.NDArray[np.uint8]) -> list[_Candidate]:
    """Return the regions that differ from the table, the strongest first."""
    height, width = small.shape[:2]
    weights = np.full((height, width), 0.25, dtype=np.float32)
    frame = max(2, round(min(height, width) * 0.1))
    weights[:frame] = weights[-frame:] = weights[:, :frame] = weights[:, -frame:] = 1.0
    ratios, alike = light_ratios(small, weights, 4)
    distance = np.zeros((height, width), dtype=np.float32)
    for sigma, weight in _SCALES:
        offsets = blurred(ratios, sigma) - np.float32(1.0)
        covariance = (np.cov(offsets[alike].T) * 1.3 + np.eye(3) * 0.01**2).astype(np.float32)
        distance = np.maximum(distance, np.float32(weight) * squares(offsets, covariance))
    cost = np.clip((np.float32(_CANDIDATE) - distance) / 6, -3, 2).astype(np.float32)
    plane = least_variation(cost, np.ones_like(cost), 80)
    strengths, change = np.minimum(distance, 150.0), np.sqrt(_change(ratios))
    texture = float(np.quantile(change[alike], 0.99)) + 1e-3
    found = []
    for one in regions(plane, 12):
        mask = filled(one.boundary, (height, width))
        sharpness = float(np.sort(change[grown(mask, 1)])[-_EDGE:].mean()) / texture
        if sharpness > _SHARP:
            found.append(_Candidate(one, float(strengths[mask].sum()) * sharpness))
    return sorted(found, key=lambda one: -one.strength)


def _refined(cut: npt.NDArray[np.uint8], seed: Mask, zoom: float, shadows: bool = True) -> Plane:
    """Return the coverage [h, w] of the object in a cut, given roughly by a seed."""
    shape = (cut.shape[0], cut.shape[1])
    size = max(2, round(0.08 * float(seed.sum()) ** 0.5))
    outside = ~grown(seed, size)
    ratios, _ = light_ratios(cut, outside.astype(np.float32) + np.float32(1e-3), 2)
    colours = ratios.reshape(-1, 3)
    table = sampled(colours[outside.ravel()])
    sure = seed & _distinct(ratios, table, seed)
    inner = grown(sure, -max(1, size // 3))
    if inner.sum() < 40:
        inner = sure
    dimmed = np.float32(1.0) - DARK / (cut[outside].mean(axis=0).astype(np.float32) / np.float32(255.0) + DARK)
    shadow, chosen = _shadow(colours, table, dimmed, sure, inner.ravel())
    if not shadows:
        shadow, chosen = np.full_like(shadow, -60.0), inner.ravel()
    near = grown(seed, 2 * size)
    edge = _boundary_cost(ratios)
    coverage = seed.astype(np.float32)
    for _ in range(3):
        contrast = float(np.sqrt(((colours[chosen] - 1.0) ** 2).sum(axis=1)).mean())
        blur = 0.03 + 0.12 * contrast
        of_table = np.logaddexp(fitted(table, 2, blur).log_density(colours), shadow)
        of_object = fitted(colours[chosen], 3, blur).log_density(colours)
        cost = np.clip(of_table - of_object, -4.0, 4.0).reshape(shape).astype(np.float32)
        cost[~near] = 2.0
        coverage = least_variation(cost, edge, 100)
        pause()
        inside = grown(coverage > 0.5, -1)
        if inside.sum() < 20:
            inside = coverage > 0.5
        if inside.sum() < 8:
            break
        chosen = inside.ravel()
    return _halved(ratios, coverage, zoom)


def _distinct(ratios: Plane, table: Colours, seed: Mask) -> Mask:
    """Return the pixels [h, w] that differ from the table about as much as most of a seed does."""
    covariance = (np.cov(table.T) * 1.3 + np.eye(3) * 0.01**2).astype(np.float32)
    distance = squares(blurred(ratios, 1.0) - np.float32(1.0), covariance)
    return np.asarray(distance > min(float(np.quantile(distance[seed], 0.9)) / 8.0, _DISTINCT))


def _shadow(
    colours: Colours, table: Colours, dimmed: Colours, seed: Mask, inner: npt.NDArray[np.bool_]
) -> tuple[Colours, npt.NDArray[np.bool_]]:
    """Return the logarithm of the density of a shadow (n,), and the pixels of the seed that are no shadow.

    In a shadow, all channels lose the same share of their light: the ratios of a shadow lie on a line from the table
    towards that of no light, ``dimmed`` (3,) away. Where nearly all of the seed is so, the object itself is
    grey: then a lighter part of it that is clearly apart is its shadow, if there is one.
    """
    one = dimmed / np.linalg.norm(dimmed)
    along: Colours = np.asarray((colours - np.float32(1.0)) @ one, dtype=np.float32)
    across: Plane = colours - np.float32(1.0) - along[:, None] * one
    table_along: Colours = np.asarray((table - np.float32(1.0)) @ one, dtype=np.float32)
    table_across: Colours = table - np.float32(1.0) - table_along[:, None] * one
    covariance = (np.cov(table_across.T) * 1.5 + np.eye(3) * 0.025**2).astype(np.float32)
    hue = squares(across, covariance)
    depth = np.float32(-_SHADOW_DEPTH * np.linalg.norm(dimmed))
    dark = (along < 0.0) & (along > depth)
    width = float(np.log(np.linalg.det(covariance.astype(np.float64))))
    density: Colours = np.where(dark, -0.5 * hue - 0.5 * width + 0.92 - np.log(-depth), -60.0) + _SHADOW_PRIOR
    shadowy = (hue < 9.0) & dark
    chosen = inner & ~shadowy
    if chosen.sum() >= 0.3 * inner.sum():
        return density.astype(np.float32), chosen
    levels: Colours = along[seed.ravel()]
    limit = _divide(levels)
    lighter = seed & (along > limit).reshape(seed.shape)
    darker = seed & ~lighter
    thick = grown(lighter, -2).sum() > 0.15 * lighter.sum()  # unlike the blurred edge of an object
    apart = (
        thick
        and lighter.sum() > 0.04 * len(levels)
        and darker.sum() > 0.3 * len(levels)
        and np.median(levels[levels > limit]) - np.median(levels[levels <= limit]) > _SHADOW_STEP
    )
    if not apart:
        return np.full(len(colours), -60.0, dtype=np.float32), inner
    chosen = grown(darker, -2) if grown(darker, -2).sum() > 40 else darker
    return np.where(along > limit, density, -60.0).astype(np.float32), chosen.ravel()


def _divide(values: Colours) -> float:
    """Return the value that divides small from large ones with the least spread within both (Otsu 1979)."""
    counts, edges = np.histogram(values, 64)
    below, sums = counts.cumsum(), (counts * (edges[1:] + edges[:-1]) / 2.0).cumsum()
    above = below[-1] - below
    spread = (sums[-1] * below - below[-1] * sums) ** 2 / np.maximum(below * above, 1)
    return float(edges[1 + int(spread.argmax())])


def _boundary_cost(ratios: Plane) -> Plane:
    """Return the cost of a boundary, [h, w]: low where colours change."""
    change = _change(ratios)
    typical = 2.0 * float(np.median(change)) + 1e-4
    return np.asarray(1.6 * np.exp(-change / np.float32(4.0 * typical)) + 0.4, dtype=np.float32)


def _change(ratios: Plane) -> Plane:
    """Return the squared difference of colours between neighbours, [h, w]."""
    smooth = blurred(ratios, 0.7)
    change = np.zeros(smooth.shape[:2], dtype=np.float32)
    change[:, :-1] += ((smooth[:, 1:] - smooth[:, :-1]) ** 2).sum(axis=2)
    change[:-1] += ((smooth[1:] - smooth[:-1]) ** 2).sum(axis=2)
    return change


def _halved(ratios: Plane, coverage: Plane, zoom: float) -> Plane:
    """Place the boundary where a pixel is half object and half table, by the colours on both sides of it.

    Args:
        ratios: (h, w, 3) colours over those of the table.
        coverage: (h, w) of the object, to within the blur of the picture.
        zoom: pixels here for a pixel of the picture, by which its blur has grown.
    """
    reach = max(2, round(_BLUR * zoom))
    for _ in range(3):
        mask = coverage > 0.5
        here = _nearby(ratios, _core(mask, reach), 1.5 * reach)
        there = _nearby(ratios, ~grown(mask, reach), 1.5 * reach)
        along = here - there
        axis = along - np.float32(_SHADE) * along.mean(axis=2, keepdims=True)
        share = ((ratios - there) * axis).sum(axis=2) / np.maximum((along * axis).sum(axis=2), 1e-4)
        band = grown(mask, reach) & ~grown(mask, -reach)
        coverage = np.where(band, np.clip(share, 0.0, 1.0), mask).astype(np.float32)
    return coverage


def _core(mask: Mask, depth: int) -> Mask:
    """Return the pixels of a mask that are that deep inside, or the deepest."""
    for less in range(depth, 0, -1):
        core = grown(mask, -less)
        if core.sum() >= 20:
            return core
    return mask


def _nearby(ratios: Plane, mask: Mask, sigma: float) -> Plane:
    """Return the mean colour of the pixels of a mask around each pixel, [h, w, 3]."""
    weights = mask[..., None].astype(np.float32)
    total = blurred(np.concatenate([ratios * weights, weights], axis=2), sigma)
    mean = (ratios * weights).sum(axis=(0, 1)) / max(float(weights.sum()), 1.0)
    return np.asarray((total[..., :3] + np.float32(1e-4) * mean) / (total[..., 3:] + np.float32(1e-4)))
