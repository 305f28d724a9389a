"""Page of the measuring stick: tables over all and per object and surface, a plot, and the figures as JSON."""

import json
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

import service
from benchmarks.push_measures import LEVELS, Mean, Repeats, Score
from service.storage.disk import replace_whole
from training.tables.push_table import UNSTATED, PushTable

PAGE_FILE: Final = "README.md"
FIGURES_FILE: Final = "figures.json"
PLOT_FILE: Final = "errors.png"
FEW_PUSHES: Final = 200
FEWEST_PAIRS: Final = 20  # from which on a floor under any model's error is told
OVERALL: Final = "all"
PAGE: Final = """# Models beside a table of pushes

`{command}` scores models on {pushes:,} pushes of {objects}
on {surfaces} (digest {digest}..., cazsl {version}).

{source}\
The position error is the distance of the predicted from the recorded pose of the object, in the frame of the table. Two
numbers are mean and median. Brackets hold the 95 % interval of the mean, if other pushes of the same kind had been
made. RMSE and NLL (per push, summed over x, y and yaw) are in units of the published output deviations of Omnipush.
Coverage is the share of outcomes inside the predicted 50, 90 and 95 % intervals of each coordinate, and inside the
regions of the same probability of all three at once. An honest model has 50, 90 and 95.

{few}## All pushes

{overall}

{notes}{repeats}{worst}![Mean errors per object, and coverage]({plot})

## Per object and surface

{groups}
"""


@dataclass(frozen=True)
class ModelScores:
    """Scores of one model: over all pushes that it answers, and per object and surface, by name."""

    name: str
    knows: str
    scores: Mapping[str, Score]


@dataclass(frozen=True)
class Findings:
    """Scores of all models on a table, with notes on the pushes that were left out, and the scatter of repeats."""

    table: PushTable
    source: str
    command: str
    models: Sequence[ModelScores]
    notes: Sequence[str]
    repeats: tuple[Repeats | None, Repeats | None]


def overall_table(models: Sequence[ModelScores]) -> str:
    """Return the table over all pushes, in Markdown."""
    head = "| model | knows | pushes | position (mm) | yaw (deg) | RMSE | NLL | intervals (%) | regions (%) |"
    rows = [
        f"| {model.name} | {model.knows} | {found.pushes:,} "
        f"| {_mean(found.position_mm)} {_interval(found.position_mm)} "
        f"| {_mean(found.yaw_deg)} {_interval(found.yaw_deg)} | {_rest(found)} |"
        for model in models
        for found in [model.scores[OVERALL]]
    ]
    return "\n".join([head, "|" + "---|" * 9, *rows])


def worth(models: Sequence[ModelScores]) -> str:
    """Return a sentence about the worth of few pushes, or an empty text for many."""
    fewest = min(models, key=lambda model: model.scores[OVERALL].pushes, default=None)
    if fewest is None or fewest.scores[OVERALL].pushes >= FEW_PUSHES:
        return ""
    best = min(models, key=lambda model: model.scores[OVERALL].position_mm.mean).scores[OVERALL]
    found = best.position_mm
    return (
        f"**{best.pushes} push{'es are' if best.pushes > 1 else ' is'} few.** "
        f"The best model's mean error is {found.mean:.2f} mm here, and could be "
        f"{found.low:.2f} to {found.high:.2f} mm on other pushes of the same kind. Two models whose brackets overlap "
        f"are not told apart, and a coverage is known within {100 / math.sqrt(best.pushes):.0f} points. {FEW_PUSHES} "
        "pushes and more, of several objects, say more."
    )


def repeats_text(found: tuple[Repeats | None, Repeats | None]) -> str:
    """Return sentences about pairs of pushes from the same start: the floor under any model's error."""
    on_one, on_two = found
    texts = []
    if on_one is not None:
        texts.append(f"{_pairs(on_one)} on one surface end {_apart(on_one)} apart.")
        if on_one.pairs >= FEWEST_PAIRS:
            floor_mm, floor_deg = (value.mean / math.sqrt(2.0) for value in (on_one.position_mm, on_one.yaw_deg))
            texts.append(
                "If both scatter alike, a model that knew the mean of every push would still err by about 1 / sqrt 2 "
                f"of it: {floor_mm:.1f} mm, {floor_deg:.1f} degrees."
            )
    if on_two is not None:
        texts.append(f"{_pairs(on_two)} on two surfaces end {_apart(on_two)} apart.")
    return " ".join(texts)


def worst_text(models: Sequence[ModelScores]) -> str:
    """Return a list of the worst object and surface of every model: by its error, and by its 90 % regions."""
    lines = []
    for model in models:
        groups = {name: found for name, found in model.scores.items() if name != OVERALL}
        if len(groups) < 2:
            continue
        name, found = max(groups.items(), key=lambda item: item[1].position_mm.mean)
        text = f"- {model.name} is worst on {name}: {found.position_mm.mean:.2f} mm, {found.yaw_deg.mean:.2f} degrees."
        shares = {name: found.calibration.regions[1] for name, found in groups.items() if found.calibration is not None}
        if shares:
            least = min(shares, key=lambda name: shares[name])
            text += f" Its 90 % regions hold least on {least}: {100 * shares[least]:.0f} %."
        lines.append(text)
    return "\n".join(lines)


def write_page(folder: Path, findings: Findings) -> None:
    """Write page, plot and figures into a folder that exists."""
    _draw(folder / PLOT_FILE, findings.models)
    replace_whole(folder / FIGURES_FILE, (json.dumps(_figures(findings), indent=1) + "\n").encode())
    replace_whole(folder / PAGE_FILE, _page(findings).encode())


def _page(findings: Findings) -> str:
    table = findings.table
    notes = "".join(f"- {note}\n" for note in findings.notes)
    return PAGE.format(
        command=findings.command,
        pushes=table.count,
        objects=f"{len(table.objects)} object{'s' if len(table.objects) > 1 else ''}",
        surfaces="an unstated surface" if table.surfaces == (UNSTATED,) else _listed(table.surfaces),
        digest=table.digest[:8],
        version=service.__version__,
        source=_paragraph(f"Origin: {findings.source.rstrip('.')}."),
        few=_paragraph(worth(findings.models)),
        overall=overall_table(findings.models),
        notes=f"{notes}\n" if notes else "",
        repeats=_paragraph(repeats_text(findings.repeats)),
        worst=f"{worst_text(findings.models)}\n\n",
        plot=PLOT_FILE,
        groups="\n\n".join(_group_table(model) for model in findings.models),
    )


def _paragraph(text: str) -> str:
    return f"{textwrap.fill(text, 120)}\n\n" if text else ""


def _group_table(model: ModelScores) -> str:
    """Return the table of one model per object and surface, in Markdown."""
    rows = [
        f"| {name} | {found.pushes:,} | {_mean(found.position_mm)} | {_mean(found.yaw_deg)} | {_rest(found)} |"
        for name, found in model.scores.items()
        if name != OVERALL
    ]
    head = "| object, surface | pushes | position (mm) | yaw (deg) | RMSE | NLL | intervals (%) | regions (%) |"
    return "\n".join([f"**{model.name}** (knows: {model.knows})", "", head, "|" + "---|" * 8, *rows])


def _rest(found: Score) -> str:
    calibration = found.calibration
    if calibration is None:
        return f"{found.rmse:.3f} | - | - | -"
    shares = (" ".join(f"{100 * share:.0f}" for share in row) for row in (calibration.intervals, calibration.regions))
    return f"{found.rmse:.3f} | {calibration.nll:.2f} | {' | '.join(shares)}"


def _mean(found: Mean) -> str:
    return f"{found.mean:.2f} ({found.median:.2f})"


def _interval(found: Mean) -> str:
    return f"[{found.low:.2f}, {found.high:.2f}]"


def _pairs(found: Repeats) -> str:
    count = f"{found.pairs:,} pair{'s' if found.pairs > 1 else ''}"
    return f"{count} of pushes of one object from the same start (within 1 mm, 1 degree)"


def _apart(found: Repeats) -> str:
    return f"{_mean(found.position_mm)} mm and {_mean(found.yaw_deg)} degrees"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more surfaces" if len(names) > 8 else "")


def _figures(findings: Findings) -> dict[str, Any]:
    """Return all figures, rounded to 6 digits."""
    names = ("one_surface", "two_surfaces")
    document = {
        "command": findings.command,
        "source": findings.source,
        "digest": findings.table.digest,
        "pushes": findings.table.count,
        "code_version": service.__version__,
        "levels": LEVELS,
        "models": [asdict(model) for model in findings.models],
        "notes": list(findings.notes),
        "repeats": {
            name: None if found is None else asdict(found) for name, found in zip(names, findings.repeats, strict=True)
        },
    }
    rounded: dict[str, Any] = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.6g}"))
    return rounded


def _draw(path: Path, models: Sequence[ModelScores]) -> None:
    """Draw the mean errors of every model per object and surface, and the coverage of those with spreads."""
    figure = Figure(figsize=(12, 10), layout="constrained")
    position, yaw, coverage = figure.subplots(3)
    names = list(max(models, key=lambda model: len(model.scores)).scores)
    _bars(position, models, names, lambda found: found.position_mm.mean)
    position.set(ylabel="mean position error (mm)")
    figure.legend(*position.get_legend_handles_labels(), fontsize="small", ncols=8, loc="outside upper center")
    _bars(yaw, models, names, lambda found: found.yaw_deg.mean)
    yaw.set(ylabel="mean yaw error (degrees)")
    _draw_coverage(coverage, models)
    figure.savefig(path, dpi=90)


def _bars(axes: Any, models: Sequence[ModelScores], names: Sequence[str], value: Callable[[Score], float]) -> None:
    width = 0.8 / len(models)
    for place, model in enumerate(models):
        heights = [value(model.scores[name]) if name in model.scores else math.nan for name in names]
        axes.bar(np.arange(len(names)) + (place - (len(models) - 1) / 2) * width, heights, width, label=model.name)
    axes.set_xticks(range(len(names)), names, rotation=30 if len(names) < 20 else 90, ha="right", fontsize="small")


def _draw_coverage(axes: Any, models: Iterable[ModelScores]) -> None:
    axes.plot([0.4, 1.0], [0.4, 1.0], color="grey", linestyle=":", label="honest")
    for number, model in enumerate(models):
        calibration = model.scores[OVERALL].calibration
        if calibration is not None:
            colour = f"C{number % 10}"  # that of its bars
            axes.plot(LEVELS, calibration.intervals, "o-", color=colour, label=f"{model.name}, intervals")
            axes.plot(LEVELS, calibration.regions, "s--", color=colour, label=f"{model.name}, regions")
    axes.set(xlabel="probability", ylabel="share of outcomes inside", ylim=(0.0, 1.0))
    axes.legend(fontsize="small")
