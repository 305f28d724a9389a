"""Report page of a dataset: histograms, a gallery of pushes, statistics beside the published ones.

The page can be written for any folder of pushes. Its title is the source that the folder declares, simulated or not.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path as DrawnPath

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from service.storage.disk import replace_whole
from training.inspection.statistics import QUANTILES as MOTION_QUANTILES
from training.inspection.statistics import compare_statistics, missed, motion_quantiles, recorded_motion
from training.omnipush.published import published_normalisation, weight_count
from training.omnipush.pushes import Pushes
from training.simulation.scene import PUSHER_RADIUS_M
from training.simulation.solids import WEIGHT_RADIUS_M, solid

Array = npt.NDArray[np.floating[Any]]

GALLERY_FILE: Final = "pushes.png"
HISTOGRAMS_FILE: Final = "histograms.png"
REPORT_FILE: Final = "report.md"
GALLERY_ROWS: Final = 4
GALLERY_COLUMNS: Final = 6
MM: Final = 1e3
QUANTILES: Final = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
_START, _END, _PUSHER = "#b8bcc4", "#2563a8", "#c2410c"


def write_report(pushes: Pushes, out: Path, seed: int = 0) -> tuple[Path, ...]:
    """Write ``report.md`` with its two images into a folder.

    Returns:
        The paths of the files written: page, histograms, gallery.

    Raises:
        OSError: The folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    files = tuple(out / name for name in (REPORT_FILE, HISTOGRAMS_FILE, GALLERY_FILE))
    replace_whole(files[0], report(pushes).encode())
    # without dates and versions in the images, so that equal data give equal files
    histograms(pushes).savefig(files[1], dpi=110, metadata={"Software": None})
    gallery(pushes, seed).savefig(files[2], dpi=110, metadata={"Software": None})
    return files


def report(pushes: Pushes) -> str:
    """Return the Markdown page."""
    pushers, outcomes = pushes.rows()
    distance_mm, turn_deg = _displacement_mm(outcomes), np.degrees(outcomes[:, 2])
    lines = [
        f"# {pushes.source}",
        "",
        f"{len(pushes.descriptors)} objects, {pushes.count} pushes, {100 * missed(outcomes).mean():.2f} % missed the "
        f"object; sha256 of the files `{pushes.digest}`. Written by `cazsl-train data report`.",
        "",
        "| quantity | mean | published | std | published | ratio of std |",
        "|---|---|---|---|---|---|",
        *(
            f"| {row.quantity} | {row.mean:.5f} | {row.published_mean:.5f} | {row.std:.5f} | {row.published_std:.5f} | "
            f"{row.ratio:.3f} |"
            for row in compare_statistics(pushers, outcomes, published_normalisation())
        ),
        "",
        "| quantile | " + " | ".join(f"{100 * q:.0f} %" for q in QUANTILES) + " |",
        "|---|" + "---|" * len(QUANTILES),
        _quantile_row("displacement (mm)", distance_mm),
        _quantile_row("rotation (deg)", turn_deg),
        "",
        *_motion_beside_recorded(pushes),
        f"![Histograms of pushes and outcomes]({HISTOGRAMS_FILE})",
        "",
        f"![Start in grey, end in blue, path of the pusher in orange]({GALLERY_FILE})",
        "",
    ]
    return "\n".join(lines)


def histograms(pushes: Pushes) -> Figure:
    """Draw histograms of start and direction of the pushes, and of displacement and rotation of the objects."""
    pushers, outcomes = pushes.rows()
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    figure.suptitle(pushes.source)
    axes = figure.subplots(2, 3)
    start: Axes = axes[0, 0]
    start.hexbin(pushers[:, 0] * MM, pushers[:, 1] * MM, gridsize=60, cmap="Blues", mincnt=1)
    start.set(title="start of the pusher", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    _histogram(axes[0, 1], np.degrees(pushers[:, 2]), "direction of the push (deg)")
    end: Axes = axes[0, 2]
    end.hexbin(outcomes[:, 0] * MM, outcomes[:, 1] * MM, gridsize=60, cmap="Blues", mincnt=1)
    end.set(title="object after the push", xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    _histogram(axes[1, 0], _displacement_mm(outcomes), "displacement (mm)")
    _histogram(axes[1, 1], np.degrees(outcomes[:, 2]), "rotation (deg)")
    both: Axes = axes[1, 2]
    both.hexbin(_displacement_mm(outcomes), np.degrees(outcomes[:, 2]), gridsize=50, cmap="Blues", mincnt=1, bins="log")
    both.set(title="displacement and rotation", xlabel="mm", ylabel="deg")
    return figure


def gallery(pushes: Pushes, seed: int = 0) -> Figure:
    """Draw some pushes: start and end outline, the pusher's path of 50 mm, weights as dark discs.

    Pushes are chosen at random, from as many objects as possible. Outlines are those of ``training.simulation.solids``.
    """
    rng = np.random.default_rng(seed)
    count = GALLERY_ROWS * GALLERY_COLUMNS
    objects = np.resize(rng.permutation(len(pushes.descriptors)), count)
    figure = Figure(figsize=(2.2 * GALLERY_COLUMNS, 2.45 * GALLERY_ROWS), layout="constrained")
    figure.suptitle(f"{pushes.source}: start grey, end blue, pusher orange; each frame is 240 mm wide")
    axes: list[Axes] = figure.subplots(GALLERY_ROWS, GALLERY_COLUMNS).ravel().tolist()
    for place, number in zip(axes, objects.tolist(), strict=True):
        row = int(rng.choice(np.flatnonzero(pushes.valid[number])))
        place.set_axis_off()
        _draw_push(place, pushes.descriptors[number], pushes.pushers[number, row], pushes.outcomes[number, row])
    return figure


def _draw_push(place: Axes, descriptor: str, pusher: Array, outcome: Array) -> None:
    context = ObjectContext.from_descriptor(descriptor)
    _draw_object(place, context, np.zeros(3), _START, 1.0)
    _draw_object(place, context, outcome.astype(np.float64), _END, 0.45)
    start = pusher[:2].astype(np.float64) * MM
    path = PUSH_LENGTH_M * MM * np.array([np.cos(pusher[2]), np.sin(pusher[2])])
    place.add_patch(Circle((start[0], start[1]), PUSHER_RADIUS_M * MM, fill=False, color=_PUSHER))
    place.add_patch(Circle((start[0] + path[0], start[1] + path[1]), PUSHER_RADIUS_M * MM, color=_PUSHER))
    place.plot([start[0], start[0] + path[0]], [start[1], start[1] + path[1]], color=_PUSHER, linewidth=1.0)
    moved = float(np.hypot(outcome[0], outcome[1])) * MM
    place.set_title(f"{descriptor}: {moved:.0f} mm, {np.degrees(outcome[2]):+.0f} deg", fontsize=8)
    place.set(xlim=(-120, 120), ylim=(-120, 120), aspect="equal")


def _draw_object(place: Axes, context: ObjectContext, pose: Array, colour: str, alpha: float) -> None:
    body = solid(context)
    turn = np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]])
    # a single path, so that pieces that touch or overlap show no seams
    outlines = [DrawnPath([*corners, corners[0]], closed=True) for corners in _moved(body.pieces, turn, pose)]
    outline = DrawnPath.make_compound_path(*outlines)
    place.add_patch(PathPatch(outline, facecolor=colour, edgecolor="none", alpha=alpha))
    for weight in body.weights:
        x_mm, y_mm = (turn @ (weight.x_m, weight.y_m) + pose[:2]) * MM
        radius_mm = WEIGHT_RADIUS_M * MM * (1.0 if weight.mass_kg > 0.1 else 0.6)
        place.add_patch(Circle((x_mm, y_mm), radius_mm, color="black", alpha=0.5 * alpha))


def _moved(pieces: tuple[Array, ...], turn: Array, pose: Array) -> list[Array]:
    return [(piece @ turn.T + pose[:2]) * MM for piece in pieces]


def _histogram(place: Axes, values: Array, title: str) -> None:
    place.hist(values, bins=80, color=_END)
    place.set(title=title, yticks=[])


def _displacement_mm(outcomes: Array) -> Array:
    return np.hypot(outcomes[:, 0], outcomes[:, 1]) * MM


def _quantile_row(name: str, values: Array) -> str:
    return f"| {name} | " + " | ".join(f"{value:.1f}" for value in np.quantile(values, QUANTILES)) + " |"


def _motion_beside_recorded(pushes: Pushes) -> list[str]:
    """Return a table of the motion of objects without weights beside Omnipush's recordings on ABS, if there are any."""
    bare = [
        outcomes[valid > 0]
        for name, outcomes, valid in zip(pushes.descriptors, pushes.outcomes, pushes.valid, strict=True)
        if weight_count(name) == 0
    ]
    if not bare:
        return []
    found, recorded = motion_quantiles(np.concatenate(bare)), recorded_motion()
    return [
        "Objects without weights, pushes that moved them by over 1 mm, beside Omnipush's recordings on ABS (CC-BY-4.0, "
        f"Bauza et al., IROS 2019). {100 * found.still_share:.1f} % of the pushes did not move them, "
        f"{100 * recorded.still_share:.1f} % of the recorded ones.",
        "",
        "| quantile | " + " | ".join(f"{100 * q:.0f} %" for q in MOTION_QUANTILES) + " |",
        "|---|" + "---|" * len(MOTION_QUANTILES),
        *(
            f"| {name} | " + " | ".join(f"{value:.1f}" for value in values) + " |"
            for name, values in (
                ("distance (mm)", found.distance_mm),
                ("recorded", recorded.distance_mm),
                ("turn (deg)", found.turn_deg),
                ("recorded", recorded.turn_deg),
            )
        ),
        "",
    ]
