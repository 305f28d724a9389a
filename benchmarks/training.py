"""Training epochs: time and held-out figures, beside a literal implementation of the published loop.

    python -m benchmarks.training [--epochs 100] [--data data/simulated/abs]

The method is FCN + CM with the indicator context, at the paper's configuration: 200 objects x 250 pushes, 64 objects a
batch, Adam at 0.002. The literal loop (``literal_loop``) has its data loaders in its own process or, as published, 32
processes for each. Our loop has all cores for one run, or one core for each of several runs, as in ``cazsl-train
reproduce``; then an epoch of all of them counts as one epoch of each. Every run has its own process. Loops take turns,
epoch by epoch, so other load on the machine affects all of them. Each is measured on the test objects after the same
epochs: the mean over the last ten, because single epochs scatter.

    python -m benchmarks.training --methods [--epochs 20]

Prints the time of an epoch of every method and context, by turns, on random pushes. The time does not depend on them.
"""

import argparse
import multiprocessing
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, Protocol

import torch

from benchmarks.literal_loop import PUBLISHED_WORKERS, LiteralEpochs
from service.model.tensors import ContextKind
from training.fitting.evaluation import Evaluation, evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import Network, build_network
from training.fitting.samples import Samples, TrainingData
from training.fitting.training_loop import keep_freed_memory, product_dtype, train_epoch
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES
from training.omnipush.published import different_objects
from training.omnipush.pushes import read_folder

OBJECTS, PUSHES, BATCH = 200, 250, 64
MEASURED_EPOCHS: Final = 10
PRECISIONS: Final = ("float32", "bfloat16")
LITERAL: Final = "literal"
RECIPE: Final = Recipe("push", "FCN + CM", "indicator", "different-objects", 1, BATCH, 0.002, 0, 0.01, 10.0, "auto", 0)


class Epochs(Protocol):
    """A training loop that runs one epoch at a time."""

    def step(self) -> None:
        """Train an epoch."""
        ...

    def figures(self) -> Evaluation:
        """Return the held-out figures."""
        ...


LoopFactory = Callable[[TrainingData], Epochs]


class OurEpochs:
    """A training loop with the trainer's own epochs of one recipe, on this number of threads."""

    def __init__(self, recipe: Recipe, threads: int, data: TrainingData) -> None:
        torch.set_num_threads(threads)
        keep_freed_memory()
        torch.manual_seed(recipe.seed)
        self.recipe, self.data, self.done = recipe, data, 0
        self.network: Network = build_network(recipe, data.train.shape)
        self.adam = torch.optim.Adam(self.network.parameters(), lr=recipe.learning_rate, fused=True)
        self.dtype = product_dtype(recipe.precision, torch.device("cpu"))

    def step(self) -> None:
        """Train an epoch."""
        train_epoch(self.network, self.adam, self.data.train, self.recipe, self.done, self.dtype)
        self.done += 1

    def figures(self) -> Evaluation:
        """Return the figures of the test objects."""
        return evaluate(self.network, self.data.held_out)


class LoopProcesses:
    """Training loops in separate processes, which run an epoch of each at once."""

    def __init__(self, folder: Path, loops: Sequence[LoopFactory]) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.connections: list[Connection] = []
        self.processes = []
        for loop in loops:
            ours, theirs = spawn.Pipe()
            # not a daemon: daemons may not start the processes of data loaders
            process = spawn.Process(target=serve, args=(loop, folder, theirs))
            process.start()
            self.connections.append(ours)
            self.processes.append(process)
        for connection in self.connections:
            connection.recv()  # the data are read

    def step(self) -> None:
        """Train an epoch of each."""
        self._ask("step")

    def figures(self) -> list[Evaluation]:
        """Return the held-out figures of each."""
        return self._ask("figures")

    def close(self) -> None:
        """End the processes."""
        for connection in self.connections:
            connection.send("end")
        for process in self.processes:
            process.join()

    def _ask(self, call: str) -> list[Any]:
        for connection in self.connections:
            connection.send(call)
        return [connection.recv() for connection in self.connections]


def serve(make: LoopFactory, folder: Path, connection: Connection) -> None:
    """Run the calls that the connection names, until it sends ``end``."""
    loop = make(TrainingData.of(different_objects(), ContextKind.INDICATOR, read_folder(folder)))
    answers: dict[str, Callable[[], Evaluation | None]] = {"step": loop.step, "figures": loop.figures}
    connection.send(None)
    for call in iter(connection.recv, "end"):
        connection.send(answers[call]())


def time_by_turns(
    loops: Mapping[str, Callable[[], object]], epochs: int, after: Callable[[int], None] = lambda epoch: None
) -> dict[str, list[float]]:
    """Return the seconds of every epoch but the first, which warms up. ``after`` runs after each round, untimed."""
    seconds: dict[str, list[float]] = {name: [] for name in loops}
    for epoch in range(epochs):
        for name, step in loops.items():
            started = time.perf_counter()
            step()
            seconds[name].append(time.perf_counter() - started)
        after(epoch)
    return {name: times[1:] for name, times in seconds.items()}


def compare(folder: Path, epochs: int) -> None:
    """Compare our loop with the literal one: time and held-out figures."""
    cores = torch.get_num_threads()
    alone = {precision: partial(OurEpochs, replace(RECIPE, precision=precision), cores) for precision in PRECISIONS}
    each = [partial(OurEpochs, replace(RECIPE, seed=seed), 1) for seed in range(cores)]
    loops: dict[str, Sequence[LoopFactory]] = {
        LITERAL: [partial(LiteralEpochs, RECIPE, 0)],
        f"{LITERAL}, {PUBLISHED_WORKERS} processes load": [partial(LiteralEpochs, RECIPE, PUBLISHED_WORKERS)],
        **{f"ours, one run, {precision}": [loop] for precision, loop in alone.items()},
        f"ours, {cores} runs at once, {_default()}": each,
    }
    processes = {name: LoopProcesses(folder, made) for name, made in loops.items()}
    figures: dict[str, list[Evaluation]] = {name: [] for name in processes}

    def measure_last(epoch: int) -> None:
        """Measure the last epochs. Of several runs, take the one with the seed of the others."""
        if epoch >= epochs - MEASURED_EPOCHS:
            for name, process in processes.items():
                figures[name].append(process.figures()[0])

    seconds = time_by_turns({name: process.step for name, process in processes.items()}, epochs, measure_last)
    for process in processes.values():
        process.close()
    of_one = {name: [time / len(loops[name]) for time in times] for name, times in seconds.items()}
    slow = statistics.median(of_one[LITERAL])
    print(f"FCN + CM, indicator, {epochs} epochs of each, by turns; this machine's default: {_default()}")
    print("| loop | median s/epoch | fastest | times faster | held-out RMSE | NLL |")
    print("|---|---|---|---|---|---|")
    for name, times in of_one.items():
        median = statistics.median(times)
        rmse = statistics.fmean(found.rmse for found in figures[name])
        nll = statistics.fmean(found.nll for found in figures[name])
        print(f"| {name} | {median:.3f} | {min(times):.3f} | {slow / median:.1f} | {rmse:.3f} | {nll:.2f} |")


def compare_methods(epochs: int) -> None:
    """Print the time of an epoch of every method with every context."""
    cores = torch.get_num_threads()
    torch.manual_seed(0)
    inputs, targets = torch.randn(2, OBJECTS, PUSHES, 3)
    loops: dict[str, Callable[[], object]] = {}
    for method in METHODS.values():
        for kind in filter(method.takes, ContextKind):
            context = (torch.rand(OBJECTS, *PUSH_SHAPES[kind].context) < 0.25).float()
            train = Samples(inputs, targets, torch.ones(OBJECTS, PUSHES), context, (1.0, 1.0, 1.0))
            recipe = replace(RECIPE, method=method.name, context=str(kind))
            loops[f"{method.name} | {kind}"] = OurEpochs(recipe, cores, TrainingData(train, train, {})).step
    seconds = time_by_turns(loops, epochs)
    print(f"{epochs} epochs of each, by turns, in {_default()}")
    print("| method | context | median s/epoch | fastest | 3000 epochs (min) |")
    print("|---|---|---|---|---|")
    for name, times in seconds.items():
        median = statistics.median(times)
        print(f"| {name} | {median:.3f} | {min(times):.3f} | {median * 50:.1f} |")


def _default() -> str:
    return str(product_dtype("auto", torch.device("cpu"))).removeprefix("torch.")


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=20, help="epochs of each loop")
    parser.add_argument("--data", type=Path, default=Path("data/simulated/abs"), help="a folder of pushes")
    parser.add_argument("--methods", action="store_true", help="compare the methods instead of the loops")
    options = parser.parse_args()
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads, {OBJECTS} objects x {PUSHES} pushes")
    if options.methods:
        compare_methods(options.epochs)
        return
    print(read_folder(options.data).source)
    compare(options.data, options.epochs)


if __name__ == "__main__":
    main()
