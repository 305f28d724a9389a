"""How fast a training epoch is, beside a literal implementation of the published loop, and whether it learns as well.

    python -m benchmarks.training [--epochs 200] [--data data/simulated/abs]

FCN + CM with the indicator context, at the paper's configuration: 200 objects x 250 pushes, 64 objects a batch, Adam at
0.002. The literal loop repeats each context for each of its 250 pushes and masks every push, takes its batches from a
data loader, and passes over the 50 test objects after each epoch; it runs in a process of its own, since the trainer's
allocator settings are a process's. Loops take turns, epoch by epoch, so that they share whatever else the machine does,
and each is measured on the test objects after the same epochs: the mean over the last ten, since single ones scatter.

    python -m benchmarks.training --methods [--epochs 20]

The time of an epoch of every method and context, by turns, on pushes that are random: the time does not depend on them.
"""

import argparse
import math
import multiprocessing
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, TensorDataset

from service.contract import ContextKind
from training.data import read_folder
from training.evaluate import evaluate, measure
from training.fit import Network, build_network, keep_freed_memory, product_dtype, train_epoch
from training.losses import gaussian_nll
from training.methods import METHODS
from training.networks import PUSH_SHAPES
from training.published import different_objects
from training.recipes import Recipe
from training.samples import Samples, TrainingData

OBJECTS, PUSHES, BATCH = 200, 250, 64
MEASURED_EPOCHS = 10
RECIPE = Recipe("push", "FCN + CM", "indicator", "different-objects", 1, BATCH, 0.002, 0, 0.01, 10.0, "auto", 0)


class LiteralNetwork(nn.Module):
    """FCN + CM with one row of context per push, as the equations are written."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.mask = nn.Linear(3, 256), nn.Linear(36, 256)
        self.second, self.third, self.last = nn.Linear(256, 256), nn.Linear(256, 256), nn.Linear(256, 6)

    def forward(self, pusher: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log std (n, 3) of pushes (n, 3) with contexts (n, 36)."""
        hidden = torch.relu(self.first(pusher)) * torch.relu(self.mask(context))
        hidden = torch.relu(self.third(torch.relu(self.second(hidden))))
        mean, log_std = self.last(hidden).chunk(2, dim=-1)
        return mean, log_std


def literal_epochs(data: TrainingData) -> Iterator[tuple[float, float]]:
    """Train an epoch with each step, test pass included; held-out RMSE and NLL."""
    torch.manual_seed(0)
    network = LiteralNetwork()
    adam = torch.optim.Adam(network.parameters(), lr=RECIPE.learning_rate)
    loaders = [
        DataLoader(
            TensorDataset(samples.inputs, samples.targets, samples.valid, samples.context), BATCH, shuffle=shuffle
        )
        for samples, shuffle in ((data.train, True), (data.held_out, False))
    ]
    while True:
        for pusher, target, valid, context in loaders[0]:
            mean, log_std = network(pusher.reshape(-1, 3), _repeated(context, pusher.shape[1]))
            adam.zero_grad()
            shape = pusher.shape
            torch.autograd.backward(gaussian_nll(mean.reshape(shape), log_std.reshape(shape), target, valid))
            adam.step()
        found: list[list[Tensor]] = [[], [], []]
        with torch.no_grad():
            for pusher, target, valid, context in loaders[1]:
                mean, log_std = network(pusher.reshape(-1, 3), _repeated(context, pusher.shape[1]))
                for kept, values in zip(found, (mean, log_std, target.reshape(-1, 3)), strict=True):
                    kept.append(values[valid.reshape(-1) > 0])
        mean_array, log_std_array, target_array = (torch.cat(kept).numpy() for kept in found)
        figures = measure(mean_array, log_std_array, target_array, data.held_out.target_std)
        yield figures.rmse, figures.nll


def _repeated(context: Tensor, pushes: int) -> Tensor:
    return context[:, None, :].repeat(1, pushes, 1).reshape(-1, context.shape[-1])


class OurEpochs:
    """The trainer's own epochs of one recipe."""

    def __init__(self, recipe: Recipe, train: Samples) -> None:
        torch.manual_seed(0)
        self.recipe, self.train, self.done = recipe, train, 0
        self.network: Network = build_network(recipe, train.shape)
        self.adam = torch.optim.Adam(self.network.parameters(), lr=recipe.learning_rate, fused=True)
        self.dtype = product_dtype(recipe.precision, torch.device("cpu"))

    def step(self) -> None:
        """Train an epoch."""
        train_epoch(self.network, self.adam, self.train, self.recipe, self.done, self.dtype)
        self.done += 1


def take_turns(
    loops: Mapping[str, Callable[[], object]], epochs: int, after: Callable[[int], None] = lambda epoch: None
) -> dict[str, list[float]]:
    """Seconds of every epoch but the first, which warms up; ``after`` each round, untimed."""
    seconds: dict[str, list[float]] = {name: [] for name in loops}
    for epoch in range(epochs):
        for name, step in loops.items():
            started = time.perf_counter()
            step()
            seconds[name].append(time.perf_counter() - started)
        after(epoch)
    return {name: times[1:] for name, times in seconds.items()}


class LiteralEpochs:
    """The literal loop in a process of its own, which trains an epoch whenever it is asked to."""

    def __init__(self, folder: Path) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.line, theirs = spawn.Pipe()
        self.process = spawn.Process(target=serve_literal, args=(folder, theirs), daemon=True)
        self.process.start()
        self.figures: tuple[float, float] = self.line.recv()

    def step(self) -> None:
        """Train an epoch."""
        self.line.send(True)
        self.figures = self.line.recv()

    def close(self) -> None:
        """Let it end."""
        self.line.send(False)
        self.process.join()


def serve_literal(folder: Path, line: Connection) -> None:
    """Train an epoch of the literal loop for each true word on the line; answer with its held-out figures."""
    epochs = literal_epochs(TrainingData.of(different_objects(), ContextKind.INDICATOR, read_folder(folder)))
    line.send((math.nan, math.nan))  # the data are read
    while line.recv():
        line.send(next(epochs))


def compare(folder: Path, data: TrainingData, epochs: int) -> None:
    """Ours against the literal loop: time and held-out figures."""
    keep_freed_memory()
    literal = LiteralEpochs(folder)
    ours = {
        f"ours, {precision}": OurEpochs(replace(RECIPE, precision=precision), data.train)
        for precision in ("float32", "bfloat16")
    }
    figures: dict[str, list[tuple[float, float]]] = {name: [] for name in ("literal", *ours)}

    def look(epoch: int) -> None:
        """Measure the last epochs."""
        if epoch >= epochs - MEASURED_EPOCHS:
            figures["literal"].append(literal.figures)
            for name, loop in ours.items():
                found = evaluate(loop.network, data.held_out)
                figures[name].append((found.rmse, found.nll))

    steps = {"literal": literal.step, **{name: loop.step for name, loop in ours.items()}}
    seconds = take_turns(steps, epochs, look)
    literal.close()
    slow = statistics.median(seconds["literal"])
    print(f"FCN + CM, indicator, {epochs} epochs of each, by turns; this machine's default: {_default()}")
    print("| loop | median s/epoch | fastest | times faster | held-out RMSE | NLL |")
    print("|---|---|---|---|---|---|")
    for name, times in seconds.items():
        median = statistics.median(times)
        rmse, nll = (statistics.fmean(values) for values in zip(*figures[name], strict=True))
        print(f"| {name} | {median:.3f} | {min(times):.3f} | {slow / median:.1f} | {rmse:.3f} | {nll:.2f} |")


def compare_methods(epochs: int) -> None:
    """The time of an epoch of every method with every context."""
    keep_freed_memory()
    torch.manual_seed(0)
    inputs, targets = torch.randn(2, OBJECTS, PUSHES, 3)
    loops: dict[str, Callable[[], object]] = {}
    for method in METHODS.values():
        for kind in filter(method.takes, ContextKind):
            context = (torch.rand(OBJECTS, *PUSH_SHAPES[kind].context) < 0.25).float()
            train = Samples(inputs, targets, torch.ones(OBJECTS, PUSHES), context, (1.0, 1.0, 1.0))
            recipe = replace(RECIPE, method=method.name, context=str(kind))
            loops[f"{method.name} | {kind}"] = OurEpochs(recipe, train).step
    seconds = take_turns(loops, epochs)
    print(f"{epochs} epochs of each, by turns, in {_default()}")
    print("| method | context | median s/epoch | fastest | 3000 epochs (min) |")
    print("|---|---|---|---|---|")
    for name, times in seconds.items():
        median = statistics.median(times)
        print(f"| {name} | {median:.3f} | {min(times):.3f} | {median * 50:.1f} |")


def _default() -> str:
    return str(product_dtype("auto", torch.device("cpu"))).removeprefix("torch.")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=20, help="epochs of each loop")
    parser.add_argument("--data", type=Path, default=Path("data/simulated/abs"), help="a folder of pushes")
    parser.add_argument("--methods", action="store_true", help="compare the methods instead of the loops")
    options = parser.parse_args()
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads, {OBJECTS} objects x {PUSHES} pushes")
    if options.methods:
        compare_methods(options.epochs)
        return
    pushes = read_folder(options.data)
    data = TrainingData.of(different_objects(), ContextKind.INDICATOR, pushes)
    print(pushes.source)
    compare(options.data, data, options.epochs)


if __name__ == "__main__":
    main()
