"""The training loop: the same weights from the same seed, interrupted or not, and a record of what was done."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import service
from service.errors import DataError
from service.model.tensors import ContextKind
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import (
    CHECKPOINT_FILE,
    CONFIG_FILE,
    COST_FILE,
    METRICS_FILE,
    WEIGHTS_FILE,
    Network,
    Spent,
    load_run,
)
from training.fitting.samples import Samples, TrainingData
from training.fitting.training_loop import cooling, fit, learning_rate, product_dtype, train_epoch
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes, read_folder


@pytest.fixture(scope="module")
def pushes(data_folder: Path) -> Pushes:
    """The synthetic pushes of all 250 objects."""
    return read_folder(data_folder)


def train_run(recipe: Recipe, pushes: Pushes, run: Path) -> Network:
    """Fit a recipe to these pushes."""
    return fit(recipe, TrainingData.of(recipe.split(), recipe.context_kind, pushes), run, quiet=True)


def samples_of(pushes: Pushes, descriptors: tuple[str, ...]) -> Samples:
    """Normalised pushes of some objects, with their indicators."""
    return Samples.of(pushes.select(descriptors), ContextKind.INDICATOR)


def masked_network() -> PushNetwork:
    """A fresh network with a context mask."""
    return PushNetwork(METHODS["FCN + CM + L2Reg"], PUSH_SHAPES[ContextKind.INDICATOR])


def metrics_of(run: Path) -> list[dict[str, Any]]:
    """Every line of a run's metrics."""
    return [json.loads(line) for line in (run / METRICS_FILE).read_text(encoding="utf-8").splitlines()]


def weights_of(run: Path) -> bytes:
    """A run's weights, to the bit."""
    return (run / WEIGHTS_FILE).read_bytes()


def interrupted(run: Path, recipe: Recipe, epochs: int, pushes: Pushes, scratch: Path) -> Path:
    """The folder of a run of ``recipe`` that was killed right after its checkpoint at this epoch.

    A run's first epochs do not know how many follow: a finished shorter run holds the very checkpoint.
    """
    train_run(replace(recipe, epochs=epochs), pushes, scratch)
    run.mkdir()
    for name in (CHECKPOINT_FILE, METRICS_FILE):
        shutil.copy(scratch / name, run / name)
    config = json.loads((scratch / CONFIG_FILE).read_text(encoding="utf-8"))
    config["recipe"] = recipe.record()
    (run / CONFIG_FILE).write_text(json.dumps(config, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return run


@pytest.mark.parametrize(
    ("method", "context"),
    [
        ("FCN", "none"),
        ("FCN + CM + L2Reg", "indicator"),
        ("FCN + CM + NeuralReg", "visual"),
        ("ANP", "none"),
    ],
)
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_an_interrupted_run_ends_in_the_same_weights(
    recipe: Recipe, viewed_pushes: Pushes, tmp_path: Path, method: str, context: str, precision: str
) -> None:
    """Two epochs, a kill and two more give bit for bit what four epochs in one go give, metrics included."""
    whole = replace(recipe, method=method, context=context, precision=precision, warm_up_steps=9, epochs=4)
    train_run(whole, viewed_pushes, tmp_path / "whole")
    run = interrupted(tmp_path / "interrupted", whole, 2, viewed_pushes, tmp_path / "scratch")

    train_run(whole, viewed_pushes, run)

    assert weights_of(run) == weights_of(tmp_path / "whole")
    assert weights_of(run) != weights_of(tmp_path / "scratch")
    assert metrics_of(run)[2:] == metrics_of(tmp_path / "whole")[2:]
    assert (run / CONFIG_FILE).read_bytes() == (tmp_path / "whole" / CONFIG_FILE).read_bytes()


@pytest.mark.parametrize("context", ["none", "indicator", "visual"])
def test_an_interrupted_run_beyond_the_paper_ends_in_the_same_weights(
    recipe: Recipe, viewed_pushes: Pushes, tmp_path: Path, context: str
) -> None:
    """What is drawn for augmentation survives a kill as well."""
    method = "FCN" if context == "none" else recipe.method
    better = replace(recipe, method=method, context=context, epochs=4, angle="circular", symmetries=True)
    better = replace(better, no_contact=0.2, least_std=0.02)
    train_run(better, viewed_pushes, tmp_path / "whole")
    run = interrupted(tmp_path / "interrupted", better, 2, viewed_pushes, tmp_path / "scratch")

    train_run(better, viewed_pushes, run)

    assert weights_of(run) == weights_of(tmp_path / "whole")
    assert weights_of(run) != weights_of(tmp_path / "scratch")


@pytest.mark.parametrize(
    "change",
    [
        {"angle": "circular"},
        {"symmetries": True},
        {"no_contact": 0.2},
        {"least_std": 0.02},
        {"cooling_epochs": 2},
    ],
    ids=lambda change: next(iter(change)),
)
def test_each_field_beyond_the_paper_changes_the_training(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    """None is read and forgotten."""
    network = train_run(replace(recipe, **change), pushes, tmp_path)
    plain = load_run(indicator_run)[1]
    figures = [evaluate(each, samples_of(pushes, different_objects().test)).nll for each in (network, plain)]

    assert np.isfinite(figures).all()
    assert figures[0] != figures[1]


def test_the_learning_rate_cools_to_nothing_over_the_last_epochs(recipe: Recipe) -> None:
    """Whole before them, half in their middle, small and still positive in the last."""
    cooled = replace(recipe, epochs=100, cooling_epochs=49)
    factors = [cooling(cooled, epoch) for epoch in range(100)]

    assert factors[:51] == [1.0] * 51
    assert factors[75] == pytest.approx(0.5)
    assert 0.0 < factors[-1] < 0.01
    assert all(later < earlier for earlier, later in pairwise(factors[50:]))
    assert cooling(recipe, recipe.epochs - 1) == 1.0


def test_a_run_on_all_objects_records_no_held_out_error(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """There is nothing to hold it to, and nothing is made up."""
    train_run(replace(recipe, set_up="all-objects", epochs=1), pushes, tmp_path)

    assert set(metrics_of(tmp_path)[-1]) == {"epoch", "nll", "regulariser"}


def test_a_run_goes_on_from_its_checkpoint_and_drops_what_was_logged_after_it(
    recipe: Recipe, pushes: Pushes, tmp_path: Path
) -> None:
    """Lines up to the checkpoint stay as they are, later ones, a half written one too, make place for new ones."""
    run = interrupted(tmp_path / "run", recipe, 2, pushes, tmp_path / "scratch")
    before = (run / METRICS_FILE).read_text(encoding="utf-8")
    (run / METRICS_FILE).write_text(before + '{"epoch": 2, "nll": -99.0}\n{"epoch": 3, "nl', encoding="utf-8")
    (run / (CHECKPOINT_FILE + ".part")).write_bytes(b"half a checkpoint")

    train_run(recipe, pushes, run)

    assert (run / METRICS_FILE).read_text(encoding="utf-8").startswith(before)
    assert [line["epoch"] for line in metrics_of(run)] == [0, 1, 2]
    assert metrics_of(run)[2]["nll"] != -99.0


def test_a_finished_run_started_again_stays_as_it_is(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """Neither weights nor metrics change."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)

    train_run(recipe, pushes, run)

    assert weights_of(run) == weights_of(indicator_run)
    assert metrics_of(run) == metrics_of(indicator_run)


def test_the_same_seed_gives_the_same_weights(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """Nothing else is random, whatever torch's own generator was used for before."""
    torch.manual_seed(99)
    train_run(recipe, pushes, tmp_path / "same")
    train_run(replace(recipe, seed=1), pushes, tmp_path / "other")

    assert weights_of(tmp_path / "same") == weights_of(indicator_run)
    assert weights_of(tmp_path / "other") != weights_of(indicator_run)


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
    """A run folder holds one run; the message names its config, and nothing in it changes."""
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
    """A run does not go on with pushes that it did not begin with."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)

    with pytest.raises(DataError, match="records another run"):
        train_run(recipe, replace(pushes, digest="0" * 64), run)


def test_objects_of_the_split_must_all_be_there(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """A missing object is named before anything is written."""
    held_out = different_objects().test[7]
    without = pushes.select([name for name in pushes.descriptors if name != held_out])

    with pytest.raises(DataError, match=held_out):
        train_run(recipe, without, tmp_path / "run")

    assert not (tmp_path / "run").exists()


def test_every_epoch_leaves_a_line(indicator_run: Path) -> None:
    """Likelihood and regulariser of each epoch, the error on held-out objects of some, the last among them."""
    lines = metrics_of(indicator_run)

    assert [line["epoch"] for line in lines] == [0, 1, 2]
    assert all(np.isfinite([line["nll"], line["regulariser"]]).all() for line in lines)
    assert [("held_out_rmse" in line) for line in lines] == [True, False, True]


def test_the_recorded_error_is_that_of_the_final_weights(pushes: Pushes, indicator_run: Path) -> None:
    """The last held-out figure is what evaluation finds for the weights that were saved."""
    recipe, network, _ = load_run(indicator_run)
    held_out = samples_of(pushes, recipe.split().test)

    assert metrics_of(indicator_run)[-1]["held_out_rmse"] == pytest.approx(evaluate(network, held_out).rmse, rel=1e-5)


def test_the_config_records_recipe_data_and_code(recipe: Recipe, pushes: Pushes, indicator_run: Path) -> None:
    """Whoever finds the run knows what made it, the source of the pushes included."""
    assert json.loads((indicator_run / CONFIG_FILE).read_text(encoding="utf-8")) == {
        "recipe": recipe.record(),
        "data": {"source": "synthetic pushes of a test", "sha256": pushes.digest},
        "code_version": service.__version__,
    }


@pytest.mark.parametrize(
    ("method", "context", "regularised"),
    [
        ("FCN", "none", False),
        ("FCN + CC", "indicator", False),
        ("FCN + CM", "indicator", False),
        ("FCN + CM + L2Reg", "indicator", True),
        ("FCN + CM + NeuralReg", "indicator", True),
        ("FCN + CM + L2Reg", "visual", True),
        ("FCN + CM + NeuralReg", "visual", True),
    ],
)
def test_only_the_regularised_methods_pay_for_their_masks(
    recipe: Recipe, viewed_pushes: Pushes, tmp_path: Path, method: str, context: str, regularised: bool
) -> None:
    """The regulariser is a cost of L2Reg and NeuralReg and nothing elsewhere."""
    train_run(replace(recipe, method=method, context=context, epochs=1), viewed_pushes, tmp_path)

    assert (metrics_of(tmp_path)[0]["regulariser"] > 0.0) is regularised


def test_training_learns_what_can_be_learnt(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """On pushes that follow a simple rule the likelihood falls, and so does the error on objects never seen."""
    train_run(replace(recipe, epochs=20), pushes, tmp_path)
    lines = metrics_of(tmp_path)

    assert lines[-1]["nll"] < lines[0]["nll"] - 1.0
    assert lines[-1]["held_out_rmse"] < 0.5 * lines[0]["held_out_rmse"]


def test_an_epoch_s_batches_depend_on_seed_and_number_alone(recipe: Recipe, pushes: Pushes) -> None:
    """The same epoch again teaches the same, another epoch or seed has the objects in another order."""
    train = samples_of(pushes, different_objects().train)

    def taught(seed: int, epoch: int) -> bytes:
        torch.manual_seed(0)
        network = masked_network()
        adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate)
        train_epoch(network, adam, train, replace(recipe, seed=seed), epoch)
        return network.last.weight.detach().numpy().tobytes()

    assert taught(seed=0, epoch=5) == taught(seed=0, epoch=5)
    assert len({taught(seed=0, epoch=5), taught(seed=0, epoch=6), taught(seed=1, epoch=5)}) == 3


@pytest.mark.parametrize(
    ("batch_objects", "steps"),
    [
        pytest.param(64, 4, id="64 objects a batch: three and a rest of 8"),
        pytest.param(200, 1, id="all at once"),
        pytest.param(1000, 1, id="more than there are"),
        pytest.param(67, 3, id="an odd number of objects"),
    ],
)
def test_an_epoch_meets_every_object_in_batches(recipe: Recipe, pushes: Pushes, batch_objects: int, steps: int) -> None:
    """A mini-batch is that many objects with all their pushes, and the last one is what is left."""
    train = samples_of(pushes, different_objects().train)
    network = masked_network()
    adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate)

    figures = train_epoch(network, adam, train, replace(recipe, batch_objects=batch_objects), 0)

    assert [int(state["step"]) for state in adam.state.values()] == [steps] * len(list(network.parameters()))
    assert np.isfinite(figures).all()


def test_padded_rows_teach_nothing(recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path) -> None:
    """Whatever stands where an object has no push, the weights are the same."""
    padding = pushes.valid[..., None] == 0.0
    junk = replace(
        pushes,
        pushers=np.where(padding, np.float32(0.07), pushes.pushers),
        outcomes=np.where(padding, np.float32(-0.05), pushes.outcomes),
    )
    assert padding.any()

    train_run(recipe, junk, tmp_path)

    found, expected = load_run(tmp_path)[1].state_dict(), load_run(indicator_run)[1].state_dict()
    assert all(torch.allclose(found[name], expected[name], atol=1e-6) for name in expected)


def test_a_finished_run_is_loaded_whole(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """Its recipe, the very network that was fitted, and the record of its data."""
    network_fitted = train_run(recipe, pushes, tmp_path)
    found, network, data = load_run(tmp_path)

    assert found == recipe
    assert data == {"source": pushes.source, "sha256": pushes.digest}
    assert network.state_dict().keys() == network_fitted.state_dict().keys()
    for name, value in network_fitted.state_dict().items():
        assert torch.equal(network.state_dict()[name], value.cpu()), name


def never_started(run: Path) -> None:
    """There is no such folder."""
    shutil.rmtree(run)


def killed_while_training(run: Path) -> None:
    """Weights are written at the end only."""
    (run / WEIGHTS_FILE).unlink()


def killed_while_saving(run: Path) -> None:
    """The weights were being written."""
    (run / WEIGHTS_FILE).write_bytes(weights_of(run)[:1000])


@pytest.mark.parametrize("happened", [never_started, killed_while_training, killed_while_saving])
def test_an_unfinished_run_is_not_loaded(indicator_run: Path, tmp_path: Path, happened: Callable[[Path], None]) -> None:
    """The message names the run and how to finish it."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)
    happened(run)

    with pytest.raises(DataError, match=r"not a finished run.*cazsl-train fit") as caught:
        load_run(run)

    assert str(run) in str(caught.value)


def test_a_run_leaves_what_it_cost(indicator_run: Path) -> None:
    """Seconds of training, by the clock and of processors, device and precision stand beside the weights."""
    cost = json.loads((indicator_run / COST_FILE).read_text(encoding="utf-8"))

    assert cost["seconds"] >= 0.0
    assert cost["processor_s"] >= 0.0
    assert (cost["device"], cost["precision"]) == ("cuda" if torch.cuda.is_available() else "cpu", "float32")


def test_what_a_run_took_adds_up_over_its_sittings() -> None:
    """Clocks are read again after a break, from wherever they stand."""
    sittings = [(Spent(100.0, 7.0), Spent(130.0, 27.0)), (Spent(5.0, 1.0), Spent(15.0, 4.0))]
    spent = Spent(0.0, 0.0)
    for started, ended in sittings:
        spent = ended.since(started, spent)

    assert spent == Spent(40.0, 23.0)


def test_a_finished_run_started_again_costs_nothing_more(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """The record is of the training, not of looking at it."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)
    (run / COST_FILE).write_text('{"seconds": 99.5}', encoding="utf-8")

    train_run(recipe, pushes, run)

    assert (run / COST_FILE).read_text(encoding="utf-8") == '{"seconds": 99.5}'


@pytest.mark.parametrize(
    ("warm_up_steps", "step", "expected"),
    [
        pytest.param(0, 1, 0.001, id="without warm-up constant from the first step"),
        pytest.param(0, 12_000, 0.001, id="to the last"),
        pytest.param(2000, 1, 0.001 / 2000, id="the first step of a warm-up"),
        pytest.param(2000, 1000, 0.0005, id="half way up"),
        pytest.param(2000, 2000, 0.001, id="at the top"),
        pytest.param(2000, 8000, 0.0005, id="half after four times the warm-up"),
    ],
)
def test_the_learning_rate_rises_for_the_warm_up_and_then_falls_with_the_root(
    recipe: Recipe, warm_up_steps: int, step: int, expected: float
) -> None:
    """0.001 sqrt(w) min(step w^-1.5, step^-0.5), as the paper's neural process is trained."""
    schedule = replace(recipe, learning_rate=0.001, warm_up_steps=warm_up_steps)

    assert learning_rate(schedule, step) == pytest.approx(expected)


def test_steps_are_counted_over_epochs(recipe: Recipe, pushes: Pushes) -> None:
    """Four batches an epoch: the last step of the third epoch is the twelfth."""
    network, schedule = masked_network(), replace(recipe, warm_up_steps=1000)
    adam = torch.optim.Adam(network.parameters())

    train_epoch(network, adam, samples_of(pushes, different_objects().train), schedule, 2)

    assert adam.param_groups[0]["lr"] == learning_rate(schedule, 12)


def test_precision_is_what_the_recipe_says_or_what_the_processor_can() -> None:
    """Auto never asks for products that the processor only emulates."""
    cpu = torch.device("cpu")
    able = any(torch.cpu.get_capabilities().get(name) for name in ("avx512_bf16", "amx_bf16"))

    assert product_dtype("float32", cpu) is torch.float32
    assert product_dtype("bfloat16", cpu) is torch.bfloat16
    assert product_dtype("auto", cpu) is (torch.bfloat16 if able else torch.float32)


def test_bfloat16_products_learn_as_float32_ones_do(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """Epoch by epoch the likelihood is the same to a percent, and what is kept and saved stays float32."""
    likelihoods = []
    for precision in ("float32", "bfloat16"):
        train_run(replace(recipe, epochs=4, precision=precision), pushes, tmp_path / precision)
        likelihoods.append([line["nll"] for line in metrics_of(tmp_path / precision)])
    weights = load_run(tmp_path / "bfloat16")[1].state_dict().values()

    assert likelihoods[1] == pytest.approx(likelihoods[0], rel=0.01)
    assert likelihoods[0] != likelihoods[1]
    assert {value.dtype for value in weights} == {torch.float32}


def test_another_surface_is_recorded(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """A run that is held to another surface says whose pushes these are."""
    plywood = replace(pushes, source="another surface of a test", digest="1" * 64)
    data = TrainingData.of(different_objects(), ContextKind.INDICATOR, pushes, plywood)

    fit(replace(recipe, epochs=1), data, tmp_path, quiet=True)

    assert load_run(tmp_path)[2] == {
        "source": pushes.source,
        "sha256": pushes.digest,
        "held_out_source": "another surface of a test",
        "held_out_sha256": "1" * 64,
    }
