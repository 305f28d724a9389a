"""Goals of predictions for any object, with the figures that were reached and the command of each.

    python -m benchmarks.goals [--out docs/results/any-object]

Figures are read from the ``figures.json`` that each benchmark writes beside its page in docs/results. Figures of
commands that only print are copied by hand into ``measured.json`` of the same folder: a number by the key of its goal.
A goal without either is listed as not measured. The page is ``goals.md``.
"""

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from service.errors import DataError
from service.storage.disk import replace_whole

RESULTS: Final = Path("docs/results")
PAGE_FILE, MEASURED_FILE = "goals.md", "measured.json"
_SHAPE: Final = re.compile(r"push-shape@(\d+)")
PAGE: Final = """# Goals and figures

`python -m benchmarks.goals` reads these from the results of the commands. {reached} of {count} are reached,
{missed} are missed, {open} are not measured.

| | goal | reached | | command |
|---|---|---|---|---|
{rows}
"""
BANDS: Final = "python -m benchmarks.shape_bands data/shapes-new --out docs/results/shape-bands"
FAMILIES: Final = "the same with --held-out FAMILY ... and a version that did not learn them"
RECORDED: Final = "python -m benchmarks.real_pushes FOLDER --out docs/results/real-pushes"
OMNIPUSH: Final = "python -m benchmarks.omnipush_outlines data/approach-new/abs --out docs/results/omnipush-outlines"
SERVING: Final = "python -m benchmarks.serving"
PHOTOGRAPHS: Final = "python -m benchmarks.silhouettes --out docs/results/silhouettes"
WARNINGS: Final = "python -m benchmarks.warnings --out docs/results/warnings"
RINGS: Final = "python -m benchmarks.bands runs/push-indicator runs/push-none runs/push-visual"


@dataclass(frozen=True)
class Goal:
    """Goal: limits that a figure shall lie within.

    Attributes:
        key: in ``measured.json``.
        text: of the table.
        command: measures it.
        figure: finds the figure in a document of results. Raises LookupError or TypeError if it is not there.
        file: of that document, in docs/results.
        low, high: limits.
        unit: behind the figure.
    """

    key: str
    text: str
    command: str
    file: str = ""
    figure: Callable[[Any], float] = float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""


def recorded(figure: Callable[[Mapping[str, Any]], float]) -> tuple[str, str, Callable[[Any], float]]:
    """Return the command, the file, and a finder of a figure of the last version of push-shape on recorded pushes."""

    def find(document: Any) -> float:
        """Return the figure of its scores."""
        versions = {
            int(match[1]): model["scores"]
            for model in document["models"]
            if (match := _SHAPE.fullmatch(model["name"])) is not None
        }
        return figure(versions[max(versions, default=0)])

    return RECORDED, "real-pushes/figures.json", find


def summarised(key: str, times: float = 1.0) -> Callable[[Any], float]:
    """Return a finder of a figure of a summary, times a number."""
    return lambda document: times * float(document["summary"][key])


def worst_region(scores: Mapping[str, Any]) -> float:
    """Return the least share of outcomes that 90 % regions hold on one object and surface, in percent."""
    return 100.0 * float(min(found["calibration"]["regions"][1] for name, found in scores.items() if name != "all"))


def ratio_of(words: str) -> Callable[[Any], float]:
    """Return a finder of the ratio of an answer whose name ends with some words."""
    return lambda document: float(next(value for name, value in document["summary"].items() if name.endswith(words)))


def ring(key: str, text: str, low: float = -math.inf, high: float = math.inf, unit: str = "") -> Goal:
    """Return a goal of the models of Omnipush's objects."""
    return Goal(key, text, RINGS, "bands/figures.json", summarised(key), low, high, unit)


def goals() -> dict[str, tuple[Goal, ...]]:
    """Return the goals by section."""
    bands_file, outlines_file = "shape-bands/figures.json", "omnipush-outlines/figures.json"
    model = (
        Goal(
            "recorded_mm",
            "recorded pushes, zero-shot: mean position error at most 3.6 mm",
            *recorded(lambda scores: scores["all"]["position_mm"]["mean"]),
            high=3.6,
            unit=" mm",
        ),
        Goal(
            "recorded_deg",
            "... mean yaw error at most 4.4 degrees",
            *recorded(lambda scores: scores["all"]["yaw_deg"]["mean"]),
            high=4.4,
            unit=" degrees",
        ),
        Goal(
            "recorded_regions",
            "... 90 % regions hold 86 to 93 %",
            *recorded(lambda scores: 100.0 * scores["all"]["calibration"]["regions"][1]),
            86.0,
            93.0,
            " %",
        ),
        Goal(
            "recorded_worst",
            "... at least 80 % on the worst shape and surface",
            *recorded(worst_region),
            low=80.0,
            unit=" %",
        ),
        Goal(
            "families",
            "families held out: at most 1.3 times the RMSE on families seen",
            f"{BANDS}; {FAMILIES}",
            "shape-families/figures.json",
            summarised("body_known.held_out_over_seen"),
            high=1.3,
        ),
        *(
            Goal(
                f"{kind}_{end}",
                f"new shapes, body known: 90 % {kind} hold at {words} % in every band of start, aim, length, size",
                BANDS,
                bands_file,
                summarised(f"body_known.{end}est_{kind}_90", 100.0),
                low,
                high,
                " %",
            )
            for kind in ("regions", "intervals")
            for end, words, low, high in (("low", "least 87", 87.0, math.inf), ("high", "most 93", -math.inf, 93.0))
        ),
        Goal(
            "outline_alone",
            "... asked with the outline alone, where half of the objects carry a load: 90 % regions hold (no goal)",
            BANDS,
            bands_file,
            summarised("outline_alone.regions_90", 100.0),
            unit=" %",
        ),
        Goal(
            "omnipush",
            "Omnipush's objects by outline and centre of mass: RMSE at most 1.5 times push-indicator's",
            OMNIPUSH,
            outlines_file,
            ratio_of("centre of mass known"),
            high=1.5,
        ),
        Goal(
            "omnipush_alone",
            "... by outline alone (no goal of its own)",
            OMNIPUSH,
            outlines_file,
            ratio_of("outline alone"),
        ),
    )
    names = ("push-indicator", "push-none", "push-visual")
    bands = "90 % intervals hold at {} % in every ring of starts and band of aims"
    older = (
        *(ring(f"{name}_low", f"{name}: {bands.format('least 87')}", low=87.0, unit=" %") for name in names),
        *(ring(f"{name}_high", f"{name}: {bands.format('most 93')}", high=93.0, unit=" %") for name in names),
        ring("camera", "push-visual: RMSE on camera views at most 1.10 times that on clean ones", high=1.10),
    )
    service = (
        Goal(
            "silhouettes",
            "photographs: intersection over union of 0.9 on at least 95 %",
            PHOTOGRAPHS,
            file="silhouettes/figures.json",
            figure=lambda document: float(document["good"]),
            low=95.0,
            unit=" %",
        ),
        Goal(
            "warned",
            "queries outside of the domain that are warned of: at least 95 % for every code and champion",
            WARNINGS,
            "warnings/figures.json",
            lambda document: float(document["least_caught"]),
            low=95.0,
            unit=" %",
        ),
        Goal(
            "alarms",
            "queries inside that are warned of: at most 2 % for every code and champion",
            WARNINGS,
            "warnings/figures.json",
            lambda document: float(document["most_false_alarms"]),
            high=2.0,
            unit=" %",
        ),
        Goal("single", "a single push by descriptor: at least 2.0 times the empty endpoint", SERVING, low=2.0),
        Goal("single_outline", "a single push of an outline of 64 corners: at least 0.25 times", SERVING, low=0.25),
        Goal(
            "thousand",
            "1,000 pushes of one outline: at most 15 times the time of 1,000 by descriptor",
            SERVING,
            high=15.0,
        ),
    )
    return {"push-shape": model, "the older models": older, "the service": service}


def measured(goal: Goal, results: Path, by_hand: Mapping[str, float]) -> float | None:
    """Return the figure of a goal, or None if it was not measured.

    Raises:
        DataError: a file of results is no JSON.
    """
    if goal.file and (results / goal.file).is_file():
        try:
            return float(goal.figure(_read(results / goal.file)))
        except (LookupError, TypeError, StopIteration):
            pass  # that run did not measure it
    return by_hand.get(goal.key)


def page(results: Path, by_hand: Mapping[str, float]) -> str:
    """Return the page of all goals, in Markdown."""
    rows, verdicts = [], []
    for section, listed in goals().items():
        for goal in listed:
            figure = measured(goal, results, by_hand)
            verdict = _verdict(goal, figure)
            verdicts.append(verdict)
            shown = "" if figure is None else f"{figure:.4g}{goal.unit}"
            rows.append(f"| {section} | {goal.text} | {shown} | {verdict} | `{goal.command}` |")
    return PAGE.format(
        rows="\n".join(rows),
        count=len(verdicts) - verdicts.count("-"),
        reached=verdicts.count("reached"),
        missed=verdicts.count("**missed**"),
        open=verdicts.count("not measured"),
    )


def _verdict(goal: Goal, figure: float | None) -> str:
    if math.isinf(goal.low) and math.isinf(goal.high):
        return "-"
    if figure is None:
        return "not measured"
    return "reached" if goal.low <= figure <= goal.high else "**missed**"


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DataError(f"{path} is no JSON ({error}); run its command again") from error


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the figures, print the table, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.goals",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of results (docs/results)")
    parser.add_argument("--out", type=Path, default=RESULTS / "any-object", help="folder of the page and measured.json")
    options = parser.parse_args(arguments)
    try:
        by_hand = options.out / MEASURED_FILE
        text = page(options.results, _read(by_hand) if by_hand.is_file() else {})
    except DataError as error:
        sys.exit(f"error: {error}")
    options.out.mkdir(parents=True, exist_ok=True)
    replace_whole(options.out / PAGE_FILE, text.encode())
    print(f"{text}\nwrote {options.out / PAGE_FILE}")


if __name__ == "__main__":
    main()
