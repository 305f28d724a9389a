"""Page of the rollouts: a table of coverage and errors, a plot, and the figures as JSON."""

import json
import math
import textwrap
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

import service
from benchmarks.push_measures import Score
from service.storage.disk import replace_whole

PAGE_FILE, FIGURES_FILE, PLOT_FILE = "README.md", "figures.json", "coverage.png"
GOAL: Final = (0.85, 0.95)
JUDGED: Final = (1, 3, 5)  # pushes after which the goal is asked
PAGE: Final = """# Rollouts

`{command}`

Sequences of five pushes that are fixed in the world before the first is made, {particles} particles each (cazsl
{code}). `python -m benchmarks.rollouts --help` says how they are drawn, and `benchmarks/rollout_sequences.py` how
recorded pushes chain. *Regions* is the share of the true poses inside of the 90 % region of x, y and yaw. The goal is
85 to 95 % after 1, 3 and 5 pushes. *Particles* is the share of the true poses that are nearer to the mean than 90 % of
the particles are. Errors are means (medians in brackets). Beside them stand the means of the predicted standard
deviations. A share of 90 % of {sequences} sequences is known within {margin:.0f} points.

{origins}{table}

![Coverage and errors after each push]({plot})

{sentences}
"""
RECORDED: Final = "Origin of the recorded pushes: {source} (digest {digest}...). The rows are not in this project."
UNSEEN: Final = """The version *without the four families* is the run of the recipe that holds them out, published by
`cazsl-train publish runs/push-shape --registry build/unseen`.
"""


@dataclass(frozen=True)
class StepScore:
    """Scores after one push."""

    score: Score
    nearer: float
    """Share of the true poses that are nearer to the mean than 90 % of the particles."""
    spread_mm: float
    """Mean predicted standard deviation of the position."""
    spread_deg: float

    @property
    def regions(self) -> float:
        """Share of the true poses inside of the 90 % regions."""
        return math.nan if self.score.calibration is None else self.score.calibration.regions[1]


@dataclass(frozen=True)
class Row:
    """Scores of a version on one kind of sequences, after each push."""

    where: str
    knows: str
    version: str
    sequences: int
    steps: tuple[StepScore, ...]

    @property
    def name(self) -> str:
        """Name of the row."""
        return f"{self.where}, {self.knows}, {self.version}"


@dataclass(frozen=True)
class Findings:
    """Scores of all versions on all kinds of sequences."""

    command: str
    source: str
    digest: str
    particles: int
    rows: tuple[Row, ...]


def coverage_table(findings: Findings) -> str:
    """Return the table of all rows after 1, 3 and 5 pushes, in Markdown."""
    lines = [
        "| pushes | the model knows | version | sequences | after | regions | particles | mm, spread | deg, spread |",
        "|" + "---|" * 9,
    ]
    for row in findings.rows:
        for pushes in JUDGED:
            found = row.steps[pushes - 1]
            position, yaw = found.score.position_mm, found.score.yaw_deg
            lines.append(
                f"| {row.where} | {row.knows} | {row.version} | {row.sequences} | {pushes} "
                f"| {100 * found.regions:.1f} % | {100 * found.nearer:.1f} % "
                f"| {position.mean:.1f} ({position.median:.1f}), {found.spread_mm:.1f} "
                f"| {yaw.mean:.1f} ({yaw.median:.1f}), {found.spread_deg:.1f} |"
            )
    return "\n".join(lines)


def write_page(folder: Path, findings: Findings) -> None:
    """Write page, plot and figures into a folder that exists."""
    _draw(folder / PLOT_FILE, findings)
    document = {**asdict(findings), "code_version": service.__version__}
    rounded = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.6g}"))
    replace_whole(folder / FIGURES_FILE, (json.dumps(rounded, indent=1) + "\n").encode())
    fewest = min(row.sequences for row in findings.rows)
    origins = [UNSEEN] if len({row.version for row in findings.rows}) > 1 else []
    if findings.digest:
        source = RECORDED.format(source=findings.source.rstrip("."), digest=findings.digest[:8])
        origins.append(textwrap.fill(source, 120) + "\n")
    page = PAGE.format(
        command=findings.command,
        particles=findings.particles,
        code=service.__version__,
        sequences=fewest,
        margin=100 * 1.96 * math.sqrt(0.9 * 0.1 / fewest),
        origins="".join(f"{text}\n" for text in origins),
        table=coverage_table(findings),
        plot=PLOT_FILE,
        sentences="\n".join(_sentences(findings)),
    )
    replace_whole(folder / PAGE_FILE, page.encode())


def _sentences(findings: Findings) -> Iterator[str]:
    """Yield for each row the pushes after which its regions miss the goal, or that none do."""
    for row in findings.rows:
        missed = [
            f"{100 * row.steps[pushes - 1].regions:.1f} % after {pushes}"
            for pushes in JUDGED
            if not GOAL[0] <= row.steps[pushes - 1].regions <= GOAL[1]
        ]
        yield f"- {row.name}: " + (f"outside of the goal: {', '.join(missed)}." if missed else "goal met.")


def _draw(path: Path, findings: Findings) -> None:
    """Draw coverage and mean position error of every row after each push."""
    figure = Figure(figsize=(10, 4.2), dpi=80, layout="constrained")
    left, right = figure.subplots(1, 2)
    left.axhspan(100 * GOAL[0], 100 * GOAL[1], color="tab:green", alpha=0.2, linewidth=0.0)
    after = range(1, max(JUDGED) + 1)
    for number, row in enumerate(findings.rows):
        style = {"marker": "o", "color": f"C{number % 10}"}
        left.plot(after, [100 * step.regions for step in row.steps], label=row.name, **style)
        right.plot(after, [step.score.position_mm.mean for step in row.steps], **style)
        right.plot(after, [step.spread_mm for step in row.steps], linestyle=":", color=style["color"])
    left.set(xlabel="pushes", ylabel="90 % regions hold (%)", ylim=(70.0, 100.0), xticks=after)
    right.set(xlabel="pushes", ylabel="position: mean error, dotted: spread (mm)", ylim=(0.0, None), xticks=after)
    figure.legend(loc="outside lower center", ncols=2, fontsize="x-small")
    figure.savefig(path, metadata={"Software": None})
