"""Picture of a plan in the documentation: a T is pushed around an obstacle in MuJoCo, with a new plan after each push.

    python -m benchmarks.plan_picture [--registry models] [--out docs/images]

Each panel has one push: the object before and after it, the way of the tip, where the plan expected the object, and
the pushes that the plan had for later. The file is ``plan.png``.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from benchmarks.real_pushes import make_folder
from service.client import Client, ClientError, ContextBody, Plan
from service.errors import CazslError
from service.planning.particles import Region, moved
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import PUSHER_RADIUS_M
from training.environments.tabletop import Tabletop

FILE: Final = "plan.png"
_BAR: Final = [[-0.06, 0.02], [-0.06, -0.01], [-0.015, -0.01]]  # the left half of a T, and its stem
_STEM: Final = [[-0.015, -0.08], [0.015, -0.08], [0.015, -0.01]]
T_SHAPE: Final = Outline.of([*_BAR, *_STEM, [0.06, -0.01], [0.06, 0.02]])
START: Final = np.array([0.11, 0.22, 0.3])
GOAL: Final = Region((0.42, 0.22, -0.9), 0.01, 0.17)
WORKSPACE: Final = [[0.0, 0.0], [0.52, 0.0], [0.52, 0.34], [0.0, 0.34]]
OBSTACLE: Final = [[0.24, 0.2], [0.29, 0.2], [0.29, 0.34], [0.24, 0.34]]
MOST_PUSHES: Final = 12
SEED: Final = 4
_COLUMNS: Final = 4


@dataclass(frozen=True, eq=False)
class Pushed:
    """One push in the simulator: the plan whose first push it was, and the poses (3,) before and after it."""

    plan: Plan
    before: DoubleArray
    after: DoubleArray


def execute(registry: Path) -> list[Pushed]:
    """Plan, push and look, until the object is at the goal.

    Raises:
        CazslError: there is no plan, or the goal is not reached.
    """
    table = Tabletop(T_SHAPE, START, SEED)
    done: list[Pushed] = []
    with Client.local(str(registry)) as client:
        while GOAL.probability(table.pose[None]) < 1.0:
            found = client.plan(
                ContextBody(outline=T_SHAPE.corners.tolist()),
                table.pose,
                GOAL.pose,
                position_tolerance=GOAL.position_tolerance_m,
                angle_tolerance=GOAL.angle_tolerance_rad,
                workspace=WORKSPACE,
                obstacles=[OBSTACLE],
                time_s=2.0,
            )
            if found.reason is not None or len(done) == MOST_PUSHES:
                raise CazslError(f"the goal was not reached: {found.reason}")
            before = table.pose
            done.append(Pushed(found, before, table.push(found.pushes[0])))
    return done


def draw(done: Sequence[Pushed], path: Path) -> None:
    """Draw one panel for each push."""
    rows = -(-len(done) // _COLUMNS)
    figure = Figure(figsize=(3.3 * _COLUMNS, 2.55 * rows), dpi=90, layout="constrained")
    panels = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for number, (axes, pushed) in enumerate(zip(panels, done, strict=False)):
        _draw_push(axes, pushed, number + 1)
    for axes in panels[len(done) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9)
    figure.savefig(path, metadata={"Software": None})


def _draw_push(axes: Any, pushed: Pushed, number: int) -> None:
    plan = pushed.plan
    axes.add_patch(Polygon(WORKSPACE, closed=True, facecolor="white", edgecolor="black", linewidth=1.0))
    axes.add_patch(Polygon(OBSTACLE, closed=True, facecolor="0.55", edgecolor="0.3", label="obstacle"))
    _outline(axes, np.array(GOAL.pose), edgecolor="tab:green", linestyle="--", linewidth=1.6, fill=False, label="goal")
    _outline(axes, pushed.before, facecolor="tab:blue", alpha=0.2, edgecolor="none", label="before")
    _outline(axes, pushed.after, facecolor="tab:blue", alpha=0.65, edgecolor="navy", label="after, in MuJoCo")
    expected = plan.steps.mean[0]
    _outline(axes, expected, edgecolor="tab:orange", linestyle=":", linewidth=1.6, fill=False, label="expected")
    for later, (x, y, angle, length) in enumerate(plan.pushes):
        colour = "tab:red" if later == 0 else "0.65"
        ahead = length * np.array([np.cos(angle), np.sin(angle)])
        width = 2.0 if later == 0 else 0.8
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate("", (x + ahead[0], y + ahead[1]), (x, y), arrowprops=arrow)
        label = "tip of this push" if later == 0 else None
        axes.add_patch(Circle((x, y), PUSHER_RADIUS_M, color=colour, alpha=0.8, label=label))
    left = f"{len(plan.pushes)} push{'es' if len(plan.pushes) > 1 else ''} planned"
    axes.set_title(f"{number}: {left}, last reaches goal {plan.replanned_probability:.0%}", fontsize=9)
    axes.set(xlim=(-0.01, 0.53), ylim=(-0.01, 0.35), aspect="equal")
    axes.tick_params(labelsize=7)


def _outline(axes: Any, pose: DoubleArray, **style: Any) -> None:
    """Draw the object at a pose (3,)."""
    corners = np.column_stack([T_SHAPE.corners, np.zeros(len(T_SHAPE.corners))])
    axes.add_patch(Polygon(moved(pose, corners)[:, :2], closed=True, **style))


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.plan_picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--registry", type=Path, default=Path("models"), help="folder of models (models)")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the picture (docs/images)")
    given = parser.parse_args(arguments)
    try:
        make_folder(given.out)
        done = execute(given.registry)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    draw(done, given.out / FILE)
    off = done[-1].after - np.array(GOAL.pose)
    print(
        f"{len(done)} pushes bring the object within {1e3 * np.hypot(off[0], off[1]):.1f} mm and "
        f"{np.degrees(abs(off[2])):.1f} degrees of its goal; wrote {given.out / FILE}"
    )


if __name__ == "__main__":
    main()
