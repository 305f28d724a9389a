"""The training loop: weights that depend on recipe, seed and data alone, interrupted or not, and metrics per epoch."""

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from service.errors import DataError
from service.model.tensors import ContextKind
from tests.training.fitting.small_runs import interrupt_run, read_metrics, read_weights, train_run
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import (
    CONFIG_FILE,
    COST_FILE,
    load_run,
)
from training.fitting.samples import Samples
from training.fitting.training_loop import cooling, learning_rate, product_dtype, train_epoch
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes


def samples_of(pushes: Pushes, descriptors: tuple[str, ...]) -> Samples:
    """Return normalised pushes of some objects, with their indicators."""
    return Samples.of(pushes.select(descriptors), ContextKind.INDICATOR)


def masked_network() -> PushNetwork:
    """Build a fresh network with a context mask."""
    return PushNetwork(METHODS["FCN + CM + L2Reg"], PUSH_SHAPES[ContextKind.INDICATOR])


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
    """A run killed after two of four epochs and continued has the same weights and metrics as an uninterrupted run."""
    whole = replace(recipe, method=method, context=context, precision=precision, warm_up_steps=9, epochs=4)
    train_run(whole, viewed_pushes, tmp_path / "whole")
    run = interrupt_run(tmp_path / "interrupted", whole, 2, viewed_pushes, tmp_path / "scratch")

    train_run(whole, viewed_pushes, run)

    assert read_weights(run) == read_weights(tmp_path / "whole")
    assert read_weights(run) != read_weights(tmp_path / "scratch")
    assert read_metrics(run)[2:] == read_metrics(tmp_path / "whole")[2:]
    assert (run / CONFIG_FILE).read_bytes() == (tmp_path / "whole" / CONFIG_FILE).read_bytes()


@pytest.mark.parametrize("context", ["none", "indicator", "visual"])
def test_an_interrupted_run_with_augmentation_ends_in_the_same_weights(
    recipe: Recipe, viewed_pushes: Pushes, tmp_path: Path, context: str
) -> None:
    """A killed and continued run draws the same augmentations and has the same weights as an uninterrupted run."""
    method = "FCN" if context == "none" else recipe.method
    better = replace(recipe, method=method, context=context, epochs=4, angle="circular", symmetries=True)
    better = replace(better, no_contact=0.2, least_std=0.02)
    train_run(better, viewed_pushes, tmp_path / "whole")
    run = interrupt_run(tmp_path / "interrupted", better, 2, viewed_pushes, tmp_path / "scratch")

    train_run(better, viewed_pushes, run)

    assert read_weights(run) == read_weights(tmp_path / "whole")
    assert read_weights(run) != read_weights(tmp_path / "scratch")


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
    """Each recipe field beyond the paper changes the likelihood that training ends with."""
    network = train_run(replace(recipe, **change), pushes, tmp_path)
    plain = load_run(indicator_run)[1]
    figures = [evaluate(each, samples_of(pushes, different_objects().test)).nll for each in (network, plain)]

    assert np.isfinite(figures).all()
    assert figures[0] != figures[1]


def test_the_learning_rate_cools_over_the_last_epochs(recipe: Recipe) -> None:
    """The cooling factor is 1 before the cooling epochs, 0.5 in their middle, and small but positive at the end."""
    cooled = replace(recipe, epochs=100, cooling_epochs=49)
    factors = [cooling(cooled, epoch) for epoch in range(100)]

    assert factors[:51] == [1.0] * 51
    assert factors[75] == pytest.approx(0.5)
    assert 0.0 < factors[-1] < 0.01
    assert all(later < earlier for earlier, later in pairwise(factors[50:]))
    assert cooling(recipe, recipe.epochs - 1) == 1.0


def test_a_run_on_all_objects_records_no_held_out_error(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """The metrics of a run that holds no object out have no held-out error."""
    train_run(replace(recipe, set_up="all-objects", epochs=1), pushes, tmp_path)

    assert set(read_metrics(tmp_path)[-1]) == {"epoch", "nll", "regulariser"}


def test_a_finished_run_started_again_stays_as_it_is(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """Fitting a finished run again changes neither its weights nor its metrics."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)

    train_run(recipe, pushes, run)

    assert read_weights(run) == read_weights(indicator_run)
    assert read_metrics(run) == read_metrics(indicator_run)


def test_the_same_seed_gives_the_same_weights(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """The weights depend on the recipe's seed, and not on earlier use of torch's generator."""
    torch.manual_seed(99)
    train_run(recipe, pushes, tmp_path / "same")
    train_run(replace(recipe, seed=1), pushes, tmp_path / "other")

    assert read_weights(tmp_path / "same") == read_weights(indicator_run)
    assert read_weights(tmp_path / "other") != read_weights(indicator_run)


def test_a_missing_object_of_the_split_is_named(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """Data without an object of the split are refused by its descriptor before any file is written."""
    held_out = different_objects().test[7]
    without = pushes.select([name for name in pushes.descriptors if name != held_out])

    with pytest.raises(DataError, match=held_out):
        train_run(recipe, without, tmp_path / "run")

    assert not (tmp_path / "run").exists()


def test_every_epoch_has_a_metrics_line(indicator_run: Path) -> None:
    """Every epoch logs likelihood and regulariser. The first, every 25th and the last log the held-out error too."""
    lines = read_metrics(indicator_run)

    assert [line["epoch"] for line in lines] == [0, 1, 2]
    assert all(np.isfinite([line["nll"], line["regulariser"]]).all() for line in lines)
    assert [("held_out_rmse" in line) for line in lines] == [True, False, True]


def test_the_recorded_error_is_that_of_the_final_weights(pushes: Pushes, indicator_run: Path) -> None:
    """The last held-out error in the metrics is the one that evaluation finds for the saved weights."""
    recipe, network, _ = load_run(indicator_run)
    held_out = samples_of(pushes, recipe.split().test)

    assert read_metrics(indicator_run)[-1]["held_out_rmse"] == pytest.approx(evaluate(network, held_out).rmse, rel=1e-5)


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
def test_only_regularised_methods_have_a_regulariser(
    recipe: Recipe, viewed_pushes: Pushes, tmp_path: Path, method: str, context: str, regularised: bool
) -> None:
    """The regulariser is positive for L2Reg and NeuralReg, and zero for all other methods."""
    train_run(replace(recipe, method=method, context=context, epochs=1), viewed_pushes, tmp_path)

    assert (read_metrics(tmp_path)[0]["regulariser"] > 0.0) is regularised


def test_training_learns_a_simple_rule(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """On pushes that follow a simple rule, training lowers the likelihood loss and the error on held-out objects."""
    train_run(replace(recipe, epochs=20), pushes, tmp_path)
    lines = read_metrics(tmp_path)

    assert lines[-1]["nll"] < lines[0]["nll"] - 1.0
    assert lines[-1]["held_out_rmse"] < 0.5 * lines[0]["held_out_rmse"]


def test_batches_depend_on_seed_and_epoch_alone(recipe: Recipe, pushes: Pushes) -> None:
    """The same seed and epoch train the same weights. Another epoch or seed orders the objects differently."""
    train = samples_of(pushes, different_objects().train)

    def trained(seed: int, epoch: int) -> bytes:
        torch.manual_seed(0)
        network = masked_network()
        adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate)
        train_epoch(network, adam, train, replace(recipe, seed=seed), epoch)
        return network.last.weight.detach().numpy().tobytes()

    assert trained(seed=0, epoch=5) == trained(seed=0, epoch=5)
    assert len({trained(seed=0, epoch=5), trained(seed=0, epoch=6), trained(seed=1, epoch=5)}) == 3


@pytest.mark.parametrize(
    ("batch_objects", "steps"),
    [
        pytest.param(64, 4, id="64 objects a batch: three and a rest of 8"),
        pytest.param(200, 1, id="all at once"),
        pytest.param(1000, 1, id="more than there are"),
        pytest.param(67, 3, id="an odd number of objects"),
    ],
)
def test_an_epoch_takes_every_object_in_batches(recipe: Recipe, pushes: Pushes, batch_objects: int, steps: int) -> None:
    """An epoch takes one optimiser step per batch of objects, the last of which holds the remaining objects."""
    train = samples_of(pushes, different_objects().train)
    network = masked_network()
    adam = torch.optim.Adam(network.parameters(), lr=recipe.learning_rate)

    figures = train_epoch(network, adam, train, replace(recipe, batch_objects=batch_objects), 0)

    assert [int(state["step"]) for state in adam.state.values()] == [steps] * len(list(network.parameters()))
    assert np.isfinite(figures).all()


def test_padding_does_not_change_the_weights(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """Values in padded rows, where an object has no push, do not change the fitted weights."""
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


def test_a_finished_run_started_again_keeps_its_cost(
    recipe: Recipe, pushes: Pushes, indicator_run: Path, tmp_path: Path
) -> None:
    """Fitting a finished run again leaves the recorded cost of its training as it is."""
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
def test_the_learning_rate_rises_then_falls_with_the_root(
    recipe: Recipe, warm_up_steps: int, step: int, expected: float
) -> None:
    """The rate is 0.001 sqrt(w) min(step w^-1.5, step^-0.5), as the paper trains its neural process."""
    schedule = replace(recipe, learning_rate=0.001, warm_up_steps=warm_up_steps)

    assert learning_rate(schedule, step) == pytest.approx(expected)


def test_steps_are_counted_over_epochs(recipe: Recipe, pushes: Pushes) -> None:
    """With four batches an epoch, the last step of the third epoch has the learning rate of step 12."""
    network, schedule = masked_network(), replace(recipe, warm_up_steps=1000)
    adam = torch.optim.Adam(network.parameters())

    train_epoch(network, adam, samples_of(pushes, different_objects().train), schedule, 2)

    assert adam.param_groups[0]["lr"] == learning_rate(schedule, 12)


def test_automatic_precision_is_native() -> None:
    """Precision ``auto`` is bfloat16 only where the processor multiplies it natively. Other precisions are fixed."""
    cpu = torch.device("cpu")
    able = any(torch.cpu.get_capabilities().get(name) for name in ("avx512_bf16", "amx_bf16"))

    assert product_dtype("float32", cpu) is torch.float32
    assert product_dtype("bfloat16", cpu) is torch.bfloat16
    assert product_dtype("auto", cpu) is (torch.bfloat16 if able else torch.float32)


def test_bfloat16_products_learn_as_float32_ones_do(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """With bfloat16 products the likelihood of each epoch is that of float32 within 1 %. Weights stay float32."""
    likelihoods = []
    for precision in ("float32", "bfloat16"):
        train_run(replace(recipe, epochs=4, precision=precision), pushes, tmp_path / precision)
        likelihoods.append([line["nll"] for line in read_metrics(tmp_path / precision)])
    weights = load_run(tmp_path / "bfloat16")[1].state_dict().values()

    assert likelihoods[1] == pytest.approx(likelihoods[0], rel=0.01)
    assert likelihoods[0] != likelihoods[1]
    assert {value.dtype for value in weights} == {torch.float32}
