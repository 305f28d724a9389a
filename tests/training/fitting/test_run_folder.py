"""The run folder: its records, its refusals, and loading or continuing a run from it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import service
from service.errors import DataError
from service.model.tensors import ContextKind
from tests.training.fitting.small_runs import interrupt_run, read_metrics, read_weights, train_run
from training.fitting.recipe import Recipe
from training.fitting.run_folder import (
    CHECKPOINT_FILE,
    CONFIG_FILE,
    COST_FILE,
    METRICS_FILE,
    WEIGHTS_FILE,
    TimeSpent,
    build_network,
    load_run,
    open_run,
    resume,
    save_checkpoint,
)
from training.fitting.samples import TrainingData
from training.fitting.training_loop import fit
from training.networks.push_network import PUSH_SHAPES
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes


def test_the_config_records_recipe_data_and_code(recipe: Recipe, pushes: Pushes, indicator_run: Path) -> None:
    """The config of a run records its recipe, the source and digest of its pushes, and the version of the code."""
    assert json.loads((indicator_run / CONFIG_FILE).read_text(encoding="utf-8")) == {
        "recipe": recipe.record(),
        "data": {"source": "synthetic pushes of a test", "sha256": pushes.digest},
        "code_version": service.__version__,
    }


def test_a_second_surface_is_recorded(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """A run that is tested on another surface records the source and digest of both surfaces."""
    plywood = replace(pushes, source="another surface of a test", digest="1" * 64)
    data = TrainingData.of(different_objects(), ContextKind.INDICATOR, pushes, plywood)

    fit(replace(recipe, epochs=1), data, tmp_path, quiet=True)

    assert load_run(tmp_path)[2] == {
        "source": pushes.source,
        "sha256": pushes.digest,
        "held_out_source": "another surface of a test",
        "held_out_sha256": "1" * 64,
    }


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"seed": 1}, id="another seed"),
        pytest.param({"learning_rate": 0.001}, id="another learning rate"),
        pytest.param({"epochs": 30}, id="more epochs"),
    ],
)
def test_another_recipe_in_the_same_folder_is_refused(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    """A folder that records another recipe is refused by the path of its config, and none of its files changes."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)

    with pytest.raises(DataError, match="records another run") as caught:
        train_run(replace(recipe, **change), pushes, run)

    assert str(run / CONFIG_FILE) in str(caught.value)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == {
        path.name: path.read_bytes() for path in indicator_run.iterdir()
    }


def test_other_data_in_the_same_folder_are_refused(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """A folder that records pushes with another digest is refused."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)

    with pytest.raises(DataError, match="records another run"):
        train_run(recipe, replace(pushes, digest="0" * 64), run)


def test_the_same_run_is_opened_again(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """Opening a folder that records the same run leaves its config as it is, and no other file beside it."""
    data = TrainingData.of(recipe.split(), recipe.context_kind, pushes)
    open_run(tmp_path / "run", recipe, data)
    before = (tmp_path / "run" / CONFIG_FILE).stat()
    open_run(tmp_path / "run", recipe, data)

    assert (tmp_path / "run" / CONFIG_FILE).stat() == before
    assert [path.name for path in (tmp_path / "run").iterdir()] == [CONFIG_FILE]


def test_a_checkpoint_is_resumed(recipe: Recipe, tmp_path: Path) -> None:
    """Resuming restores the weights, the optimiser, the next epoch and the time spent of the last checkpoint."""
    networks = [build_network(recipe, PUSH_SHAPES[recipe.context_kind]) for _ in range(2)]
    optimisers = [
        torch.optim.Adam(network.parameters(), lr=rate) for network, rate in zip(networks, (0.5, 0.1), strict=True)
    ]
    save_checkpoint(tmp_path, networks[0], optimisers[0], 7, TimeSpent(1.0, 2.0))
    save_checkpoint(tmp_path, networks[0], optimisers[0], 8, TimeSpent(5.0, 9.0))

    assert resume(tmp_path, networks[1], optimisers[1]) == (8, TimeSpent(5.0, 9.0))
    assert optimisers[1].param_groups[0]["lr"] == 0.5
    weights = [network.state_dict() for network in networks]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    assert [path.name for path in tmp_path.iterdir()] == [CHECKPOINT_FILE]


def test_a_checkpoint_without_processor_time_is_resumed(recipe: Recipe, tmp_path: Path) -> None:
    """The clock's seconds stand in for the processor time that older checkpoints do not record."""
    network = build_network(recipe, PUSH_SHAPES[recipe.context_kind])
    adam = torch.optim.Adam(network.parameters())
    save_checkpoint(tmp_path, network, adam, 3, TimeSpent(5.0, 9.0))
    state = torch.load(tmp_path / CHECKPOINT_FILE, weights_only=True)
    del state["processor_s"]
    torch.save(state, tmp_path / CHECKPOINT_FILE)

    assert resume(tmp_path, network, adam) == (3, TimeSpent(5.0, 5.0))


def test_metrics_after_the_checkpoint_are_dropped(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """A continued run keeps the metrics up to its checkpoint and replaces later lines, even a half-written one."""
    run = interrupt_run(tmp_path / "run", recipe, 2, pushes, tmp_path / "scratch")
    before = (run / METRICS_FILE).read_text(encoding="utf-8")
    (run / METRICS_FILE).write_text(before + '{"epoch": 2, "nll": -99.0}\n{"epoch": 3, "nl', encoding="utf-8")
    (run / (CHECKPOINT_FILE + ".part")).write_bytes(b"half a checkpoint")

    train_run(recipe, pushes, run)

    assert (run / METRICS_FILE).read_text(encoding="utf-8").startswith(before)
    assert [line["epoch"] for line in read_metrics(run)] == [0, 1, 2]
    assert read_metrics(run)[2]["nll"] != -99.0


def test_a_finished_run_is_loaded(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """Loading a finished run gives its recipe, the very weights that were fitted, and the record of its data."""
    network_fitted = train_run(recipe, pushes, tmp_path)
    found, network, data = load_run(tmp_path)

    assert found == recipe
    assert data == {"source": pushes.source, "sha256": pushes.digest}
    assert network.state_dict().keys() == network_fitted.state_dict().keys()
    for name, value in network_fitted.state_dict().items():
        assert torch.equal(network.state_dict()[name], value.cpu()), name


def never_started(run: Path) -> None:
    """Remove the folder: the run never started."""
    shutil.rmtree(run)


def killed_while_training(run: Path) -> None:
    """Remove the weights: they are written at the end of a run."""
    (run / WEIGHTS_FILE).unlink()


def damaged_weights(run: Path) -> None:
    """Keep only the beginning of the weights."""
    (run / WEIGHTS_FILE).write_bytes(read_weights(run)[:1000])


@pytest.mark.parametrize("happened", [never_started, killed_while_training, damaged_weights])
def test_an_unfinished_run_is_not_loaded(indicator_run: Path, tmp_path: Path, happened: Callable[[Path], None]) -> None:
    """Loading an unfinished run raises an error that names the run and the command that finishes it."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)
    happened(run)

    with pytest.raises(DataError, match=r"not a finished run.*cazsl-train fit") as caught:
        load_run(run)

    assert str(run) in str(caught.value)


def test_the_cost_of_a_run_is_recorded(indicator_run: Path) -> None:
    """The cost of a run records its seconds by the clock and of processors, its device and its precision."""
    cost = json.loads((indicator_run / COST_FILE).read_text(encoding="utf-8"))

    assert cost["seconds"] >= 0.0
    assert cost["processor_s"] >= 0.0
    assert (cost["device"], cost["precision"]) == ("cuda" if torch.cuda.is_available() else "cpu", "float32")


def test_time_spent_adds_up_over_interruptions() -> None:
    """The time spent is the sum over all sittings, wherever the clocks stand when a run is continued."""
    sittings = [(TimeSpent(100.0, 7.0), TimeSpent(130.0, 27.0)), (TimeSpent(5.0, 1.0), TimeSpent(15.0, 4.0))]
    spent = TimeSpent(0.0, 0.0)
    for started, ended in sittings:
        spent = ended.since(started, spent)

    assert spent == TimeSpent(40.0, 23.0)
