"""Report of a reproduction: the paper's figures beside ours, the paper's claims, a plot, and the raw figures.

Each of our figures is a mean over seeds, followed by ± and their standard deviation. A report names its data, states
whether they are simulated, and gives the command that repeats it. It is written after every run, so that days of
training can be followed: rows without a run are empty, and claims that need them are open.
"""

import statistics
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from service.storage.disk import replace_whole
from training.fitting.evaluation import Evaluation
from training.networks.methods import METHODS
from training.paper.experiments import Cell, Claim, Experiment, PaperFigures, Table
from training.paper.figures import FIGURES_FILE, raw_figures
from training.paper.reproduction import Result

REPORT_FILE: Final = "README.md"
PLOT_FILE: Final = "rmse.png"
HOLDS: Final = "holds"
FAILS: Final = "does not hold"
OPEN: Final = "open"


@dataclass(frozen=True)
class Spread:
    """Spread over seeds: mean and standard deviation. A single seed has no deviation, which differs from one of 0."""

    mean: float
    std: float | None = None

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """Compute the spread of one value per seed."""
        return cls(statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else None)

    def text(self, digits: int, scale: float = 1.0) -> str:
        """Render the spread for a table."""
        spread = "" if self.std is None else f" ± {scale * self.std:.{digits}f}"
        return f"{scale * self.mean:.{digits}f}{spread}"


@dataclass(frozen=True)
class Reproduction:
    """Reproduction of an experiment: its results, and the command that made them."""

    experiment: Experiment
    results: Sequence[Result]
    seeds: int
    epochs: int
    command: str

    @property
    def runs(self) -> int:
        """Return the number of runs of the finished reproduction."""
        return self.seeds * len(self.experiment.cells)

    def spread(self, cell: Cell, figure: Callable[[Evaluation], float], leaked: bool = False) -> Spread | None:
        """Return the spread of a cell's figure over its finished seeds, None if there is none."""
        found = [result.leaked if leaked else result.found for result in self.results if result.cell == cell]
        values = [figure(evaluation) for evaluation in found if evaluation is not None]
        return Spread.of(values) if values else None


def writer(
    experiment: Experiment, seeds: int, epochs: int, command: str, folder: Path
) -> Callable[[Sequence[Result]], Path]:
    """Return a function that writes the report of the results so far, and returns its path."""
    return lambda results: write_report(Reproduction(experiment, results, seeds, epochs, command), folder)


def write_report(made: Reproduction, folder: Path) -> Path:
    """Write the Markdown report, the plot and the raw figures. Return the path of the report."""
    folder.mkdir(parents=True, exist_ok=True)
    raw = raw_figures(made.experiment, made.command, made.seeds, made.epochs, made.results)
    replace_whole(folder / FIGURES_FILE, raw.encode())
    plot(made).savefig(folder / PLOT_FILE, metadata={"Software": None})
    path = folder / REPORT_FILE
    replace_whole(path, render(made).encode())
    return path


def render(made: Reproduction) -> str:
    """Render the report as Markdown."""
    tables = [
        f"## {table.title}\n\n{_table(made, table)}\n\n{_claims(made, table)}\n" for table in made.experiment.tables
    ]
    return "\n".join([_heading(made), *tables, _footnotes(made)])


def _heading(made: Reproduction) -> str:
    hours = _hours(made.results)
    devices = ", ".join(sorted({f"{result.cost['device']} ({result.cost['precision']})" for result in made.results}))
    origins = {tuple(result.origin.items()): result.origin for result in made.results}
    sources = sorted({source for origin in origins.values() for key, source in origin.items() if "source" in key})
    verdicts = [_verdict(claim, _errors(made)) for table in made.experiment.tables for claim in table.claims]
    held, still_open = verdicts.count(HOLDS), verdicts.count(OPEN)
    left = f", {still_open} open" if still_open else ""
    done = "" if len(made.results) == made.runs else f"**Not finished: {len(made.results)} of {made.runs} runs.** "
    cooled = made.experiment.cooling_epochs
    cooling = f" The learning rate falls to 0 over the last {cooled} epochs; the paper's is constant." if cooled else ""
    shorter = "" if made.epochs == made.experiment.epochs else f" (the paper: {made.experiment.epochs})"
    return f"""# {made.experiment.name}

Data of every figure marked *ours*: **{"; ".join(sources)}**.
The paper's figures are from other data: compare the order of the methods, not the digits.

{done}{held} of the paper's {len(verdicts)} claims hold{left}. {_seeds(made)} per row, {made.epochs} epochs{shorter},
{hours} of training on {devices}.{cooling} To repeat it:

```sh
{made.command}
```

![RMSE of the paper and ours]({PLOT_FILE})
"""


def _seeds(made: Reproduction) -> str:
    """Render the number of seeds per row. While runs are missing, render the least and the greatest number so far."""
    wanted = "1 seed" if made.seeds == 1 else f"{made.seeds} seeds"
    done = Counter(result.cell for result in made.results)
    least, most = (pick(done[cell] for cell in made.experiment.cells) for pick in (min, max))
    if least == made.seeds:
        return wanted
    return f"{least} of {wanted}" if least == most else f"{least} to {most} of {wanted}"


def _hours(results: Sequence[Result]) -> str:
    """Render the time of the runs by the clock, and their processor time if all of them record it."""
    hours = sum(float(result.cost["seconds"]) for result in results) / 3600.0
    recorded = [float(result.cost["processor_s"]) for result in results if "processor_s" in result.cost]
    processor = f" ({sum(recorded) / 3600.0:.1f} of processor time)" if len(recorded) == len(results) else ""
    return f"{hours:.1f} hours{processor}"


def _table(made: Reproduction, table: Table) -> str:
    """Render the paper's rows and columns, each with our figures beside it."""
    has_distance = any(figures.distance_mm is not None for figures in table.paper.values())
    names = ["RMSE", "STD", *(["Dist. (mm)"] if has_distance else [])]
    columns = [f"{name} {source}" for name in names for source in ("paper", "ours")] + ["NLL", "90 % coverage"]
    lines = [_row(["", *columns]), _row(["---"] * (1 + len(columns)))]
    for method, paper in table.paper.items():
        cell = table.cell(method)
        lines.append(_row([method, *_figures(made, cell, paper)]))
        if METHODS[method].neural_process:
            none = PaperFigures(float("nan"), float("nan"), float("nan") if has_distance else None)
            lines.append(_row([f"{method}, shown the targets (leak)", *_figures(made, cell, none, leaked=True)]))
    return "\n".join(lines)


def _figures(made: Reproduction, cell: Cell, paper: PaperFigures, leaked: bool = False) -> list[str]:
    def ours(figure: Callable[[Evaluation], float], digits: int, scale: float = 1.0, unit: str = "") -> str:
        found = made.spread(cell, figure, leaked)
        return "" if found is None else f"{found.text(digits, scale)}{unit}"

    def theirs(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if value == value else ""

    texts = [theirs(paper.rmse, 3), ours(lambda found: found.rmse, 3)]
    texts += [theirs(paper.std, 3), ours(lambda found: found.std, 3)]
    if paper.distance_mm is not None:
        texts += [theirs(paper.distance_mm, 2), ours(lambda found: found.distance_mm, 2)]
    return [*texts, ours(lambda found: found.nll, 2), ours(lambda found: found.coverage[0.90], 1, 100.0, " %")]


def _row(texts: Sequence[str]) -> str:
    return f"| {' | '.join(texts)} |"


def _errors(made: Reproduction) -> dict[Cell, float]:
    """Return the mean error of each cell that has a run."""
    found = {cell: made.spread(cell, lambda found: found.rmse) for cell in made.experiment.cells}
    return {cell: spread.mean for cell, spread in found.items() if spread is not None}


def _verdict(claim: Claim, errors: Mapping[Cell, float]) -> str:
    if not errors.keys() >= {*claim.lower, *claim.higher}:
        return OPEN
    return HOLDS if claim.holds(errors) else FAILS


def _claims(made: Reproduction, table: Table) -> str:
    """Render the paper's claims about a table, each with our verdict and errors."""
    errors = _errors(made)

    def listed(cells: Sequence[Cell]) -> str:
        return ", ".join(f"{errors[cell]:.3f}" if cell in errors else "?" for cell in cells)

    return "\n".join(
        f"- **{_verdict(claim, errors)}**: {claim.text} ({listed(claim.lower)} against {listed(claim.higher)})"
        for claim in table.claims
    )


def _footnotes(made: Reproduction) -> str:
    notes = """## Notes

RMSE, STD (exp of the mean predicted log standard deviation) and NLL (per sample, summed over its outputs) are in the
units of the networks: for pushes, published standard deviations. Dist. is RMSE x 21.92 mm. Coverage is the share of
true values inside the central 90 % interval. ± is the standard deviation over seeds. Claims compare means over seeds:
compare a small difference with the spread before you rely on it.
"""
    if any(METHODS[cell.method].neural_process for cell in made.experiment.cells):
        notes += """
ANP is given 50 pushes of each test object with their outcomes, and predicts the others from its prior. The row with the
leak encodes the very targets that it predicts, as the published evaluation does. It is not a valid result.
"""
    return notes


def plot(made: Reproduction) -> Figure:
    """Plot the RMSE of each method, the paper's and ours, in a panel per table. Whiskers are the spread over seeds."""
    tables = made.experiment.tables
    columns = min(3, len(tables))
    rows = -(-len(tables) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained", dpi=110)
    for place, table in enumerate(tables, start=1):
        axes = figure.add_subplot(rows, columns, place)
        found = [made.spread(table.cell(method), lambda found: found.rmse) for method in table.paper]
        ours = [spread or Spread(float("nan")) for spread in found]
        places = list(range(len(ours)))
        paper = [figures.rmse for figures in table.paper.values()]
        axes.barh([at - 0.2 for at in places], paper, 0.4, label="paper", color="0.75")
        means, spreads = [found.mean for found in ours], [found.std or 0.0 for found in ours]
        axes.barh([at + 0.2 for at in places], means, 0.4, xerr=spreads, label="ours", color="C0")
        axes.set_yticks(places, list(table.paper), fontsize=7)
        axes.invert_yaxis()
        axes.set_title(table.title, fontsize=8)
        axes.set_xlabel("RMSE", fontsize=8)
        axes.tick_params(axis="x", labelsize=7)
    figure.axes[0].legend(fontsize=7)
    return figure
