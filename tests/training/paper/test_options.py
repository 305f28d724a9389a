"""Options of a reproduction: contradictions, defaults, and the command that repeats an experiment."""

from dataclasses import replace
from pathlib import Path

import pytest

from training.networks.methods import ANP
from training.omnipush.layout import DEFAULT_DATA
from training.paper.experiments import EXPERIMENTS, GAUSSIAN_PROCESS
from training.paper.options import ReproductionOptions

OPTIONS = ReproductionOptions(names=("different-objects",), out=Path("runs/out"), data=DEFAULT_DATA)


def test_the_command_names_defaults_of_the_paper() -> None:
    """The command of an experiment has the paper's epochs and seeds, and leaves out default data."""
    (experiment,) = OPTIONS.experiments()

    assert OPTIONS.command(experiment) == (
        "cazsl-train reproduce different-objects --epochs 3000 --seeds 3 --out runs/out"
    )


def test_the_command_has_every_option_that_changes_figures() -> None:
    """The command has cooling, skipped rows, known figures, data and views, in this order."""
    options = replace(
        OPTIONS,
        epochs=20,
        seeds=2,
        cooling=5,
        skip=("ANP", "FCN + CC"),
        known=Path("f.json"),
        data=Path("d"),
        views=Path("v"),
        jobs=4,
    )
    (experiment,) = options.experiments()

    assert options.command(experiment) == (
        "cazsl-train reproduce different-objects --epochs 20 --seeds 2 --out runs/out --cooling 5 --skip 'ANP' "
        "--skip 'FCN + CC' --known f.json --data d --views v"
    )


def test_the_regression_draws_its_own_data() -> None:
    """The command of the gaussian-process experiment has no options of data."""
    options = replace(OPTIONS, names=(GAUSSIAN_PROCESS,), data=Path("d"), views=Path("v"))
    (experiment,) = options.experiments()

    assert options.command(experiment) == (
        "cazsl-train reproduce gaussian-process --epochs 500 --seeds 10 --out runs/out"
    )


def test_all_experiments_are_in_the_paper_s_order() -> None:
    """With ``everything`` all experiments are returned, with their cooling and without the rows to skip."""
    found = replace(OPTIONS, names=(), everything=True, cooling=10, skip=(ANP,)).experiments()

    assert tuple(experiment.name for experiment in found) == EXPERIMENTS
    assert {experiment.cooling_epochs for experiment in found} == {10}
    assert not any(cell.method == ANP for experiment in found for cell in experiment.cells)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ()}, "give one or more of gaussian-process, different-objects"),
        ({"everything": True}, "or --all"),
        ({"jobs": 2, "ray_address": "auto"}, "give either that or --ray"),
        ({"names": ("different-objects", "different-weights"), "known": Path("f.json")}, "give its name alone"),
        ({"epochs": 4, "cooling": 5}, "--cooling: received 5; give at most 4, the epochs of different-objects"),
    ],
    ids=["neither names nor all", "names and all", "jobs on a cluster", "known runs of two", "too long a cooling"],
)
def test_options_that_contradict_each_other_are_refused(changes: dict[str, object], message: str) -> None:
    """The error about contradictory options names them and a way out."""
    with pytest.raises(ValueError, match=message):
        replace(OPTIONS, **changes)  # type: ignore[arg-type]
