"""The paper's experiments: their cells, their recipes, their figures, and claims that these figures support."""

import pytest

from training.fitting.evaluation import DISTANCE_MM_PER_RMSE
from training.fitting.recipe import SET_UPS, parse_recipe_record
from training.paper.experiments import EXPERIMENTS, Cell, Claim, Rule, Table, cell, experiments

TABLES = [table for experiment in experiments().values() for table in experiment.tables]
# Rows that the paper prints with figures that do not agree with each other. They are kept as printed.
MISPRINTS = {("different-weights-0", "visual"): ("FCN + CC", "FCN + CM", "FCN + CM + L2Reg", "FCN + CM + NeuralReg")}


def test_there_are_the_paper_s_four() -> None:
    """The paper has four experiments, in a fixed order."""
    assert tuple(experiments()) == EXPERIMENTS
    assert EXPERIMENTS == ("gaussian-process", "different-objects", "different-surfaces", "different-weights")


@pytest.mark.parametrize(
    ("name", "tables", "cells", "seeds", "epochs"),
    [
        ("gaussian-process", 1, 5, 10, 500),
        # ANP and FCN once, four methods with two contexts
        ("different-objects", 2, 10, 3, 3000),
        ("different-surfaces", 1, 6, 3, 3000),
        ("different-weights", 6, 30, 3, 3000),
    ],
)
def test_an_experiment_trains_each_cell_once(name: str, tables: int, cells: int, seeds: int, epochs: int) -> None:
    """An experiment has each cell once: methods without context are shared by the tables of a set-up."""
    found = experiments()[name]

    assert (found.name, len(found.tables), len(found.cells)) == (name, tables, cells)
    assert len(set(found.cells)) == cells
    assert (found.seeds, found.epochs) == (seeds, epochs)


def test_a_skipped_row_loses_its_claims() -> None:
    """Without ANP every table loses that row and the claims about it, and keeps the other claims."""
    whole, left = experiments()["different-objects"], experiments()["different-objects"].without(["ANP"])

    assert len(left.cells) == len(whole.cells) - 1
    for table, before in zip(left.tables, whole.tables, strict=True):
        assert "ANP" not in table.paper
        assert table.claims == tuple(claim for claim in before.claims if "ANP" not in claim.text)
        assert 0 < len(table.claims) < len(before.claims)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.title)
def test_the_paper_s_claims_hold_for_the_paper_s_figures(table: Table) -> None:
    """Every claim holds for the paper's own figures, so neither the claim nor a figure is copied wrong."""
    errors = {other.cell(method): row.rmse for other in TABLES for method, row in other.paper.items()}

    assert len(table.claims) >= 2
    for claim in table.claims:
        assert claim.holds(errors), claim.text


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.title)
def test_the_paper_s_distances_are_its_errors_in_millimetres(table: Table) -> None:
    """The paper's distances are RMSE x 21.92 mm within rounding, except for its known misprints."""
    odd = [
        method
        for method, row in table.paper.items()
        if row.distance_mm is not None
        and abs(row.rmse * DISTANCE_MM_PER_RMSE - row.distance_mm) > 0.011 + 0.0005 * 21.92
    ]

    assert set(odd) <= set(MISPRINTS.get((table.set_up, table.context), ()))


def test_the_best_rows_are_the_paper_s_bold_ones() -> None:
    """The lowest errors of the tables are those that the paper prints in bold."""
    best = {(table.set_up, table.context): min(table.paper.values(), key=lambda row: row.rmse).rmse for table in TABLES}

    assert best == {
        ("gaussian-process", "kernel parameters"): 0.098,
        ("different-objects", "indicator"): 0.205,
        ("different-objects", "visual"): 0.193,
        ("different-surfaces", "indicator"): 0.257,
        ("different-weights-0", "indicator"): 0.227,
        ("different-weights-1", "indicator"): 0.250,
        ("different-weights-2", "indicator"): 0.242,
        ("different-weights-0", "visual"): 0.209,
        ("different-weights-1", "visual"): 0.220,
        ("different-weights-2", "visual"): 0.218,
    }


@pytest.mark.parametrize(
    ("name", "wanted", "expected"),
    [
        # batch, rate, warm-up, lambdas
        ("gaussian-process", ("gaussian-process", "FCN", "none"), (32, 0.002, 0, 0.0, 0.0)),
        (
            "gaussian-process",
            ("gaussian-process", "FCN + CM + L2Reg", "kernel parameters"),
            (32, 0.002, 0, 0.0001, 10.0),
        ),
        (
            "gaussian-process",
            ("gaussian-process", "FCN + CM + NeuralReg", "kernel parameters"),
            (32, 0.002, 0, 0.0001, 1.0),
        ),
        ("different-objects", ("different-objects", "ANP", "none"), (64, 0.001, 2000, 0.0, 0.0)),
        ("different-objects", ("different-objects", "FCN + CM", "indicator"), (64, 0.002, 0, 0.0, 0.0)),
        ("different-objects", ("different-objects", "FCN + CM + L2Reg", "indicator"), (64, 0.002, 0, 0.01, 10.0)),
        ("different-objects", ("different-objects", "FCN + CM + L2Reg", "visual"), (64, 0.002, 0, 0.01, 0.01)),
        ("different-objects", ("different-objects", "FCN + CM + NeuralReg", "visual"), (64, 0.002, 0, 0.01, 1.0)),
    ],
)
def test_cells_have_the_paper_s_recipe(name: str, wanted: tuple[str, str, str], expected: tuple[float, ...]) -> None:
    """The recipe of a cell has the paper's batch, learning rate, warm-up and lambdas."""
    experiment = experiments()[name]
    found = experiment.recipe(Cell(*wanted), seed=2)

    trained = (found.batch_objects, found.learning_rate, found.warm_up_steps, found.lambda_1, found.lambda_2)
    assert trained == pytest.approx(expected, rel=1e-12)
    assert (found.seed, found.epochs, found.set_up) == (2, experiment.epochs, wanted[0])
    assert experiment.recipe(Cell(*wanted), seed=2, epochs=7).epochs == 7


@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if name != "gaussian-process"])
def test_every_cell_of_pushes_has_a_valid_recipe(name: str) -> None:
    """The recipe of a cell of pushes parses, has a known set-up, and a name that is unique as a folder."""
    experiment = experiments()[name]
    for wanted in experiment.cells:
        recipe = experiment.recipe(wanted, seed=0)
        assert parse_recipe_record(dict(recipe.record()), wanted.slug) == recipe
        assert recipe.set_up in SET_UPS
    assert len({(wanted.set_up, wanted.slug) for wanted in experiment.cells}) == len(experiment.cells)


def test_a_slug_is_a_folder_name() -> None:
    """The slug of a cell has method and context in lower case."""
    assert Cell("different-objects", "FCN + CM + L2Reg", "visual").slug == "fcn-cm-l2reg-visual"
    assert Cell("different-objects", "ANP", "none").slug == "anp"


@pytest.mark.parametrize(
    ("rule", "lower", "higher", "holds"),
    [
        (Rule.ALL, (1.0, 2.0), (3.0, 4.0), True),
        (Rule.ALL, (1.0, 3.5), (3.0, 4.0), False),
        (Rule.BEST, (1.0, 3.5), (3.0, 4.0), True),
        (Rule.BEST, (3.2, 3.5), (3.0, 4.0), False),
        (Rule.EACH, (1.0, 3.5), (3.0, 4.0), True),
        (Rule.EACH, (1.0, 4.5), (3.0, 4.0), False),
        (Rule.ALL, (3.0,), (3.0,), False),
    ],
)
def test_a_claim_compares_errors_by_its_rule(
    rule: Rule, lower: tuple[float, ...], higher: tuple[float, ...], holds: bool
) -> None:
    """A claim requires all below all, the best below the best, or each below its own. Equal is not below."""
    low = tuple(cell("a", method, "visual") for method in ("FCN + CM", "FCN + CC")[: len(lower)])
    high = tuple(cell("b", method, "visual") for method in ("FCN + CM", "FCN + CC")[: len(higher)])
    errors = dict(zip((*low, *high), (*lower, *higher), strict=True))

    assert Claim("a test", low, high, rule).holds(errors) is holds
