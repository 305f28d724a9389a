"""Figures of a table of pushes: distributions, and a gallery of single pushes."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from training.inspection.tables.geometry import PushGeometry, directions, rows_by_object
from training.tables.push_table import PushTable

GALLERY_ROWS: Final = 4
GALLERY_COLUMNS: Final = 6
MM: Final = 1e3
_START, _END, _PUSHER, _OTHER = "#b8bcc4", "#2563a8", "#c2410c", "#d97706"
_MAX_TITLE: Final = 60
Measured = tuple[str, PushTable, PushGeometry]


def distributions(here: Measured, other: Measured | None = None) -> Figure:
    """Draw starts around the outlines, aims, clearances, lengths, distances and turns, beside those of another table.

    Starts and aims are relative to the centroid, in sizes of the object: root mean square radii of its outline.
    """
    figure = Figure(figsize=(13.5, 6.6), layout="constrained")
    axes = figure.subplots(2, 4)
    beside = f", blue; {plain(other[0])}, orange" if other else ""
    figure.suptitle(f"{plain(here[0])}{beside}")
    tables = [here] if other is None else [here, other]
    starts = [_starts_in_sizes(table) for _, table, _ in tables]
    reach = 1.05 * max(float(np.quantile(np.abs(each), 0.995)) for each in starts)
    _density(axes[0, 0], starts[0], reach, "starts about the centroid")
    if other is None:
        ends = here[1].outcomes[:, :2] * MM
        _density(axes[0, 1], ends, max(1.0, 1.05 * float(np.abs(ends).max())), "object after the push", unit="mm")
    else:
        _density(axes[0, 1], starts[1], reach, f"starts, {plain(other[0])}", "Oranges")
    for place, title, values in (
        (axes[0, 2], "aim: offset from the centroid (sizes)", [_aims_in_sizes(table) for _, table, _ in tables]),
        (axes[0, 3], "clearance at the start (mm)", [MM * each.start_m for _, _, each in tables]),
        (axes[1, 0], "length of the push (mm)", [MM * table.pushers[:, 3] for _, table, _ in tables]),
        (axes[1, 1], "distance of those that moved (mm)", [_moved(table, each, 0) for _, table, each in tables]),
        (axes[1, 2], "turn of those that moved (degrees)", [_moved(table, each, 1) for _, table, each in tables]),
    ):
        _histogram(place, title, values)
    both: Axes = axes[1, 3]
    both.hexbin(_moved(*here[1:], 0), _moved(*here[1:], 1), gridsize=40, cmap="Blues", mincnt=1, bins="log")
    both.set_title("distance and turn", fontsize=10)
    both.set(xlabel="mm", ylabel="degrees")
    return figure


def gallery(table: PushTable, seed: int = 0) -> Figure:
    """Draw some pushes: outline at the start and at the end, the pusher's path with its length and radius.

    Pushes are chosen at random, from as many objects as possible. Each frame has its own scale.
    """
    rng = np.random.default_rng(seed)
    count = min(GALLERY_ROWS * GALLERY_COLUMNS, table.count)
    groups = rows_by_object(table)
    turns = np.resize(rng.permutation(len(groups)), count).tolist()
    rows = -(-count // GALLERY_COLUMNS)
    figure = Figure(figsize=(2.3 * GALLERY_COLUMNS, 2.5 * rows + 0.4), layout="constrained")
    figure.suptitle(f"{plain(table.source)}: start grey, end blue, pusher orange")
    axes: list[Axes] = np.atleast_1d(figure.subplots(rows, GALLERY_COLUMNS)).ravel().tolist()
    for place in axes:
        place.set_axis_off()
    taken: set[int] = set()
    for place, turn in zip(axes, turns, strict=False):
        number, own = groups[turn]
        row = next((row for row in rng.permutation(own).tolist() if row not in taken), None)
        if row is not None:
            taken.add(row)
            _draw_push(place, table, number, row)
    return figure


def plain(text: str) -> str:
    """Return a text for a figure: one line, printable, not too long, and without signs that start a formula."""
    shown = "".join(each if each.isprintable() else " " for each in text[: _MAX_TITLE + 1])
    shown = shown if len(text) <= _MAX_TITLE else f"{shown[:_MAX_TITLE]}..."
    return shown.replace("$", r"\$")


def _draw_push(place: Axes, table: PushTable, number: int, row: int) -> None:
    item, pusher, outcome = table.objects[number], table.pushers[row], table.outcomes[row]
    radius_mm = MM * table.pusher_radius_m[row]
    end = _placed(item.outline, outcome)
    place.add_patch(Polygon(item.outline.corners * MM, facecolor=_START, edgecolor="none"))
    place.add_patch(Polygon(end * MM, facecolor=_END, edgecolor="none", alpha=0.45))
    path = np.array([pusher[:2], pusher[:2] + pusher[3] * directions(pusher[None])[0]]) * MM
    place.add_patch(Circle(tuple(path[0]), radius_mm, fill=False, color=_PUSHER))
    place.add_patch(Circle(tuple(path[1]), radius_mm, color=_PUSHER))
    place.plot(*path.T, color=_PUSHER, linewidth=1.0)
    drawn = np.concatenate([item.outline.corners * MM, end * MM, path - radius_mm, path + radius_mm])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    middle, half = (low + high) / 2.0, 0.53 * float((high - low).max())
    distance = float(np.hypot(outcome[0], outcome[1])) * MM
    place.set_title(
        f"{plain(item.name)[:24]}: {distance:.0f} mm, {round(float(np.degrees(outcome[2]))):+d}°\n"
        f"push {MM * pusher[3]:.0f} mm, tip {radius_mm:.3g} mm",
        fontsize=8,
    )
    place.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")


def _placed(outline: Outline, pose: DoubleArray) -> DoubleArray:
    """Return the corners of an outline at a pose."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(outline.corners @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])


def _starts_in_sizes(table: PushTable) -> DoubleArray:
    centroid, size = _centroids(table)
    return np.asarray((table.pushers[:, :2] - centroid) / size[:, None])


def _aims_in_sizes(table: PushTable) -> DoubleArray:
    """Return the offset (n,) at which the path passes the centroid on its left side, in sizes."""
    centroid, size = _centroids(table)
    offset, heading = centroid - table.pushers[:, :2], directions(table.pushers)
    return np.asarray((heading[:, 0] * offset[:, 1] - heading[:, 1] * offset[:, 0]) / size)


def _centroids(table: PushTable) -> tuple[DoubleArray, DoubleArray]:
    centroids = np.array([item.outline.centroid_m for item in table.objects])
    sizes = np.array([item.outline.size_m for item in table.objects])
    return centroids[table.object_index], sizes[table.object_index]


def _moved(table: PushTable, geometry: PushGeometry, turn: int) -> DoubleArray:
    """Return distances in mm, or turns in degrees, of the pushes that moved the object."""
    outcomes = table.outcomes[geometry.moved]
    return np.degrees(outcomes[:, 2]) if turn else MM * np.hypot(outcomes[:, 0], outcomes[:, 1])


def _density(
    place: Axes, points: DoubleArray, reach: float, title: str, colours: str = "Blues", unit: str = "sizes"
) -> None:
    extent = (-reach, reach, -reach, reach)
    place.hexbin(*points.T, gridsize=50, extent=extent, cmap=colours, mincnt=1, norm=LogNorm(vmin=0.3))
    place.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})", aspect="equal", xlim=extent[:2], ylim=extent[2:])
    place.set_title(title, fontsize=10)


def _histogram(place: Axes, title: str, values: list[DoubleArray]) -> None:
    """Draw shares of one table as bars and of another one as a line, over the middle 99 % of each."""
    spans = [np.quantile(each, (0.005, 0.995)) for each in values if len(each)]
    low, high = (min(span[0] for span in spans), max(span[1] for span in spans)) if spans else (0.0, 1.0)
    if high - low < 1e-9 + 1e-3 * abs(high):
        low, high = low - 0.5, high + 0.5
    bins = int(np.clip(2.0 * np.sqrt(min(map(len, values))), 10, 60))
    options: dict[str, Any] = {"bins": bins, "range": (low, high)}
    for number, each in enumerate(values):
        weights = np.full(len(each), 100.0 / max(1, len(each)))
        style = {"color": _OTHER, "histtype": "step", "linewidth": 1.6} if number else {"color": _END}
        place.hist(each, weights=weights, **options, **style)
    place.set_title(title, fontsize=10)
    place.set_ylabel("% of the pushes")
