"""Page of closed-loop planning: a table of the planners, the share of goals reached after each push, and figures."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

import service
from service.model.manifest import Manifest
from service.storage.disk import replace_whole
from training.fitting.shape_samples import HELD_OUT_FAMILIES

PAGE_FILE, FIGURES_FILE, PLOT_FILE = "README.md", "figures.json", "reached.png"
ALL_FAMILIES: Final = "all-families"
_KEPT: Final = ("planner", "reached", "pushes", "touched", "distance_mm", "turn_deg", "reason")  # of each task
_HEAD: Final = (
    "| planner | goals reached | pushes: mean, median | missed goals end | a push errs by | a plan takes "
    "| processor time | touched |\n|---|---|---|---|---|---|---|---|"
)
_WHY: Final = """On a free table push-shape needs {shape_pushes:.2f} pushes and mechanics {mechanics_pushes:.2f}.
A push ends {shape_mm:.1f} mm and {shape_deg:.1f} degrees from where push-shape expects it, and {mechanics_mm:.1f} mm
and {mechanics_deg:.1f} degrees from where mechanics does. The outline alone does not tell where the centre of mass is,
how much friction there is, or on which points the object rests, and that is most of the error of both. A new plan after
each push makes up for errors, whatever their cause. Knowing a shape at all is another matter, as push-none shows."""
_TOUCHES: Final = """

Among obstacles first pushes keep away by the deviations of the model, of which mechanics has none. Of the pushes of
push-shape {shape:.1%} touch something, and of those of mechanics {mechanics:.1%}. Both are few pushes, so that the
difference may be chance."""
_PAGE: Final = """# Plans in closed loop

`python -m benchmarks.plan --tasks {tasks}`, after `cazsl-train publish runs/push-shape --registry build/unseen`

Objects of the families {families}, which {held_out}, are pushed in MuJoCo, on {tasks}
tasks: 50 to 200 mm across, to a goal 50 to 200 mm away that is turned by up to 180 degrees. It is reached within 10 mm
and 10 degrees. There are at most 10 pushes, of 20, 50 or 100 mm, with a new plan after each. No planner knows centre of
mass (off the centroid in half of the objects), friction of pusher and object (0.1 to 0.6), the spread of the weight, or
the table's friction, which is drawn for each push. All know outline, tip and pose (cazsl {code}).

{table}

- **push-shape**: the plan of `POST /v1/plan`.
  {model}
- **mechanics**: the same planner over quasi-static mechanics of an object that presses evenly, with nothing fitted and
  no deviations.
- **push-none**: the same planner over a model that knows no shape, and pushes of 50 mm only.
- **greedy push**: the one push of 960 whose end push-shape expects nearest to the goal, after each push.
- **among obstacles**: in a workspace with up to two squares of 50 mm between start and goal. *Touched* counts pushes
  in which the object, between its true poses before and after, or the tip came into contact with one, or left the
  workspace. An object that touches something has no further plan, so its goal is missed.

The pushes of goals that were reached count. *A push errs by* is the mean distance of the object from where its planner
expected it after the push. Times are wall and processor time of one plan with the work of a budget of 0.3 s: mean, and
in brackets the 95 % quantile. The wall time holds for the machine and its load.

## Why mechanics does as well

{why}

![Share of goals reached after each push]({plot})
"""


@dataclass(frozen=True)
class Measured:
    """Result of one planner on one task.

    Attributes:
        planner: its name.
        reached: whether the goal was reached.
        pushes: number of pushes that were made.
        touched: number of pushes in which something was touched.
        distance_mm: of the last pose from the goal.
        turn_deg: likewise.
        wall_ms: time of each plan.
        processor_ms: likewise, of the processor.
        error_mm: distance of the object after each push from where its planner expected it.
        error_deg: likewise its turn.
        reason: why there was no plan for another push, or an empty text.
    """

    planner: str
    reached: bool
    pushes: int
    touched: int
    distance_mm: float
    turn_deg: float
    wall_ms: list[float]
    processor_ms: list[float]
    error_mm: list[float]
    error_deg: list[float]
    reason: str


def figures(results: Sequence[Measured]) -> dict[str, dict[str, float]]:
    """Return the figures of each planner."""
    found = {}
    for planner in dict.fromkeys(each.planner for each in results):
        of_it = [each for each in results if each.planner == planner]
        reached = [each for each in of_it if each.reached]
        missed = [each for each in of_it if not each.reached]
        pushes = np.array([each.pushes for each in reached] or [0])
        wall = np.concatenate([each.wall_ms for each in of_it] or [[]])
        processor = np.concatenate([each.processor_ms for each in of_it] or [[]])
        found[planner] = {
            "tasks": len(of_it),
            "reached": len(reached),
            "pushes_mean": float(np.mean(pushes)),
            "pushes_median": float(np.median(pushes)),
            "missed_mm": float(np.median([each.distance_mm for each in missed])) if missed else 0.0,
            "missed_deg": float(np.median([each.turn_deg for each in missed])) if missed else 0.0,
            "plan_ms": float(wall.mean()) if len(wall) else 0.0,
            "plan_ms_95": float(np.quantile(wall, 0.95)) if len(wall) else 0.0,
            "processor_ms": float(processor.mean()) if len(processor) else 0.0,
            "processor_ms_95": float(np.quantile(processor, 0.95)) if len(processor) else 0.0,
            "error_mm": mean_of(of_it, "error_mm"),
            "error_deg": mean_of(of_it, "error_deg"),
            "touched": sum(each.touched for each in of_it),
            "pushes": sum(each.pushes for each in of_it),
        }
    return found


def mean_of(results: Sequence[Measured], name: str) -> float:
    """Return the mean of a list of figures over all results, or 0 if there are none."""
    values = np.concatenate([getattr(each, name) for each in results])
    return float(values.mean()) if len(values) else 0.0


def table(found: dict[str, dict[str, float]]) -> str:
    """Return the table of the planners, in Markdown."""
    lines = [_HEAD]
    for planner, row in found.items():
        missed = (
            f"{row['missed_mm']:.0f} mm, {row['missed_deg']:.0f} degrees off" if row["reached"] < row["tasks"] else "-"
        )
        pushes = f"{row['pushes_mean']:.2f}, {row['pushes_median']:.0f}" if row["reached"] else "-, -"
        error = f"{row['error_mm']:.1f} mm, {row['error_deg']:.1f} degrees" if row["pushes"] else "-"
        lines.append(
            f"| {planner} | {row['reached']:.0f} of {row['tasks']:.0f} "
            f"| {pushes} | {missed} "
            f"| {error} "
            f"| {row['plan_ms']:.0f} ms ({row['plan_ms_95']:.0f}) "
            f"| {row['processor_ms']:.0f} ms ({row['processor_ms_95']:.0f}) "
            f"| {row['touched']:.0f} of {row['pushes']:.0f} pushes |"
        )
    return "\n".join(lines)


def write_page(folder: Path, manifest: Manifest, tasks: int, results: Sequence[Measured]) -> str:
    """Write page, plot and figures into a folder that exists, and return the table."""
    found = figures(results)
    split = manifest.data.split
    trained_on_all = split == ALL_FAMILIES
    document = {
        "code_version": service.__version__,
        "model": f"{manifest.name}@{manifest.version}",
        "split": split,
        "planners": found,
        "tasks": [{name: value for name, value in asdict(each).items() if name in _KEPT} for each in results],
    }
    rounded = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.5g}"))
    replace_whole(folder / FIGURES_FILE, (json.dumps(rounded, indent=1) + "\n").encode())
    _draw(folder / PLOT_FILE, results)
    written = table(found)
    page = _PAGE.format(
        tasks=tasks,
        families=", ".join(HELD_OUT_FAMILIES),
        held_out="push-shape was trained on too" if trained_on_all else "no planner has seen",
        code=service.__version__,
        table=written,
        model=f"Its model was trained on {manifest.data.train_objects:,} drawn objects (split `{split}`).",
        why=_why(found),
        plot=PLOT_FILE,
    )
    replace_whole(folder / PAGE_FILE, page.encode())
    return written


def _why(found: dict[str, dict[str, float]]) -> str:
    """Return the comparison of push-shape with mechanics, if both were measured."""
    shape, mechanics = found.get("push-shape"), found.get("mechanics")
    if shape is None or mechanics is None:
        return "Both have to be measured."
    names = {"pushes": "pushes_mean", "mm": "error_mm", "deg": "error_deg"}
    why = _WHY.format(
        **{f"shape_{name}": shape[field] for name, field in names.items()},
        **{f"mechanics_{name}": mechanics[field] for name, field in names.items()},
    )
    among = [found.get(f"{name} among obstacles") for name in ("push-shape", "mechanics")]
    touches = [row["touched"] / row["pushes"] for row in among if row is not None and row["pushes"]]
    return why + _TOUCHES.format(shape=touches[0], mechanics=touches[1]) if len(touches) == 2 else why


def _draw(path: Path, results: Sequence[Measured]) -> None:
    """Draw the share of goals that each planner has reached after each number of pushes."""
    figure = Figure(figsize=(7.0, 4.0), dpi=100, layout="constrained")
    axes = figure.subplots()
    steps = np.arange(max((each.pushes for each in results), default=0) + 1)
    for planner in dict.fromkeys(each.planner for each in results):
        of_it = [each for each in results if each.planner == planner]
        shares = [100.0 * np.mean([each.reached and each.pushes <= step for each in of_it]) for step in steps]
        axes.plot(steps, shares, "o-", label=planner, markersize=4)
    axes.set_xlabel("pushes")
    axes.set_ylabel("goals reached (%)")
    axes.set_ylim(0.0, 102.0)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, metadata={"Software": None})
