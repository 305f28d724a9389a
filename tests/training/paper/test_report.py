"""Reports: the paper's rows beside ours, its claims, the source of the data, a plot, and the raw figures."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from training.fitting.evaluation import Evaluation
from training.paper.experiments import Cell, experiments
from training.paper.figures import FIGURES_FILE
from training.paper.report import PLOT_FILE, REPORT_FILE, Reproduction, Spread, plot, render, write_report
from training.paper.reproduction import Result

COST: dict[str, str | float] = {"seconds": 1800.0, "device": "cpu", "precision": "bfloat16"}
ORIGIN = {"source": "made up by a test", "sha256": "0" * 64}


def evaluation(rmse: float) -> Evaluation:
    """Make figures that follow from the error."""
    coverage = {0.5: 0.4, 0.9: 0.75, 0.95: 0.8}
    return Evaluation(rmse, 0.5 * rmse, 21.92 * rmse, -2.0 + rmse, coverage, (0.001, 0.001, 0.01))


def made(name: str, errors: dict[Cell, float], seeds: int = 2, epochs: int | None = None) -> Reproduction:
    """Make a reproduction with these errors, a hundredth more with each seed."""
    experiment = experiments()[name]
    results = [
        Result(
            cell,
            seed,
            evaluation(errors[cell] + 0.01 * seed),
            evaluation(0.001) if cell.method == "ANP" else None,
            COST,
            ORIGIN,
        )
        for seed in range(seeds)
        for cell in experiment.cells
    ]
    command = f"cazsl-train reproduce {name} --epochs 7"
    return Reproduction(experiment, results, seeds, epochs or experiment.epochs, command)


def as_in_the_paper(name: str) -> dict[Cell, float]:
    """Return the paper's own errors."""
    tables = experiments()[name].tables
    return {table.cell(method): row.rmse for table in tables for method, row in table.paper.items()}


def test_a_row_has_the_paper_s_figures_and_ours() -> None:
    """A row has RMSE, STD and distance of both, then NLL and coverage, as mean and spread over seeds."""
    text = render(made("different-surfaces", as_in_the_paper("different-surfaces")))

    header, rule, *rows = [line for line in text.splitlines() if line.startswith("|")]
    assert header == (
        "|  | RMSE paper | RMSE ours | STD paper | STD ours | Dist. (mm) paper | Dist. (mm) ours "
        "| NLL | 90 % coverage |"
    )
    assert rule.count("---") == 9
    # 0.257 and 0.267: mean 0.262, deviation 0.01 / sqrt(2)
    assert rows[4] == (
        "| FCN + CM | 0.257 | 0.262 ± 0.007 | 0.036 | 0.131 ± 0.004 | 5.63 | 5.74 ± 0.15 "
        "| -1.74 ± 0.01 | 75.0 ± 0.0 % |"
    )
    assert [row.split(" | ")[0] for row in rows] == [
        "| ANP",
        "| ANP, shown the targets (leak)",
        "| FCN",
        "| FCN + CC",
        "| FCN + CM",
        "| FCN + CM + L2Reg",
        "| FCN + CM + NeuralReg",
    ]


def test_the_leak_has_a_row_without_figures_of_the_paper() -> None:
    """The leak has a labelled row without figures of the paper, and a note that it is not a valid result."""
    text = render(made("different-surfaces", as_in_the_paper("different-surfaces")))

    (row,) = [line for line in text.splitlines() if "(leak)" in line]
    assert row.split(" | ")[1:3] == ["", "0.001 ± 0.000"]
    assert "It is not a valid result" in text


def test_the_regression_has_no_distance() -> None:
    """The table of the regression has two columns of the paper, and no neural process."""
    text = render(made("gaussian-process", as_in_the_paper("gaussian-process")))

    assert "Dist. (mm) paper" not in text
    assert "leak" not in text
    assert "| FCN + CC | 0.146 | 0.151 ± 0.007 | 0.133 |" in text


def test_the_report_names_data_seeds_epochs_cost_and_command() -> None:
    """The report names the data, seeds, epochs, cost and command of its figures."""
    text = render(made("different-surfaces", as_in_the_paper("different-surfaces"), epochs=7))

    assert "**made up by a test**" in text
    assert "2 seeds per row, 7 epochs (the paper: 3000)" in text
    assert "6.0 hours of training on cpu (bfloat16)" in text
    assert "cazsl-train reproduce different-surfaces --epochs 7" in text


def test_one_seed_is_in_the_singular() -> None:
    """A report of one seed has "1 seed" and not "1 seeds"."""
    assert "1 seed per row" in render(made("different-surfaces", as_in_the_paper("different-surfaces"), seeds=1))


def test_processor_time_needs_every_run_s_record() -> None:
    """The report has the processor time only if every run records it."""
    reproduction = made("different-surfaces", as_in_the_paper("different-surfaces"))
    recorded = [replace(result, cost={**COST, "processor_s": 900.0}) for result in reproduction.results]

    assert "6.0 hours (3.0 of processor time) of training" in render(replace(reproduction, results=recorded))
    assert "6.0 hours of training" in render(replace(reproduction, results=[reproduction.results[0], *recorded[1:]]))


def test_both_surfaces_are_named() -> None:
    """A report of different surfaces names the data that it trains on and the data that it tests on."""
    reproduction = made("different-surfaces", as_in_the_paper("different-surfaces"))
    both = {**ORIGIN, "held_out_source": "plywood of a test", "held_out_sha256": "1" * 64}
    results = [
        Result(result.cell, result.seed, result.found, result.leaked, result.cost, both)
        for result in reproduction.results
    ]

    text = render(Reproduction(reproduction.experiment, results, 2, 3000, "a command"))
    assert "**made up by a test; plywood of a test**" in text


@pytest.mark.parametrize("name", list(experiments()))
def test_with_the_paper_s_errors_every_claim_holds(name: str) -> None:
    """With the paper's own errors every claim holds, and the report counts them."""
    reproduction = made(name, as_in_the_paper(name), seeds=1)
    claims = sum(len(table.claims) for table in reproduction.experiment.tables)

    text = render(reproduction)
    assert f"{claims} of the paper's {claims} claims hold" in text
    assert text.count("- **holds**: ") == claims
    assert "does not hold" not in text


def test_a_failed_claim_is_marked_with_its_errors() -> None:
    """A claim that fails is marked as such, with the errors that decide it."""
    errors = as_in_the_paper("different-surfaces")
    errors[Cell("different-surfaces", "FCN + CM", "indicator")] = 0.4
    text = render(made("different-surfaces", errors, seeds=1))

    assert (
        "- **does not hold**: Every model with a context mask beats FCN and FCN + CC. "
        "(0.400, 0.260, 0.263 against 0.328, 0.264)"
    ) in text
    assert "- **holds**: The best model with a context mask beats ANP." in text
    assert "2 of the paper's 3 claims hold" in text


def test_missing_runs_are_empty_rows_and_open_claims() -> None:
    """An unfinished report has empty rows without a run, open claims, and the number of finished runs."""
    reproduction = made("different-surfaces", as_in_the_paper("different-surfaces"))
    some = [result for result in reproduction.results if result.cell.method != "ANP" and result.seed == 0]
    text = render(replace(reproduction, results=some))

    assert "**Not finished: 5 of 12 runs.** 2 of the paper's 3 claims hold, 1 open. 0 to 1 of 2 seeds per row" in text
    (row,) = [line for line in text.splitlines() if line.startswith("| ANP |")]
    assert row == "| ANP | 0.271 |  | 0.064 |  | 5.94 |  |  |  |"
    assert "- **open**: The best model with a context mask beats ANP. (0.257, 0.260, 0.263 against ?)" in text
    assert len(plot(replace(reproduction, results=some)).axes) == 1


def test_incomplete_rows_show_their_number_of_seeds() -> None:
    """An unfinished report shows how many seeds its rows have."""
    reproduction = made("different-surfaces", as_in_the_paper("different-surfaces"))
    first = [result for result in reproduction.results if result.seed == 0]

    assert "hold. 1 of 2 seeds per row" in render(replace(reproduction, results=first))
    assert "hold. 1 to 2 of 2 seeds per row" in render(replace(reproduction, results=reproduction.results[:-1]))
    assert "hold. 2 seeds per row" in render(reproduction)


def test_the_report_is_written_with_plot_and_figures(tmp_path: Path) -> None:
    """A report is written with its plot and every run's figures as JSON."""
    reproduction = made("different-objects", as_in_the_paper("different-objects"))
    path = write_report(reproduction, tmp_path / "report")

    assert path == tmp_path / "report" / REPORT_FILE
    assert f"]({PLOT_FILE})" in path.read_text(encoding="utf-8")
    assert (tmp_path / "report" / PLOT_FILE).read_bytes().startswith(b"\x89PNG")
    raw = json.loads((tmp_path / "report" / FIGURES_FILE).read_text(encoding="utf-8"))
    assert raw["command"] == reproduction.command
    assert len(raw["runs"]) == 20
    assert raw["runs"][0]["cell"] == {"set_up": "different-objects", "method": "ANP", "context": "none"}
    assert raw["runs"][0]["found"]["rmse"] == 0.222
    assert raw["runs"][0]["leaked"]["rmse"] == 0.001
    assert raw["runs"][11]["leaked"] is None


def test_the_plot_has_a_panel_per_table_with_both_bars() -> None:
    """The plot has a panel per table, with the paper's errors and ours for each method."""
    figure = plot(made("different-objects", as_in_the_paper("different-objects"), seeds=1))

    assert [axes.get_title() for axes in figure.axes] == [
        "Different objects, context: indicator",
        "Different objects, context: visual",
    ]
    paper, ours = figure.axes[0].containers[0], figure.axes[0].containers[-1]
    assert [bar.get_width() for bar in paper] == [bar.get_width() for bar in ours]


def test_a_single_seed_has_no_spread() -> None:
    """The figure of a single seed has no spread, because a spread of 0 would read as certainty."""
    assert Spread.of([0.3]) == Spread(0.3)
    assert Spread.of([0.3]).text(3) == "0.300"
    assert Spread.of([0.3, 0.5]).text(2, 100.0) == "40.00 ± 14.14"
