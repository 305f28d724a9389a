"""How long a training epoch takes at the paper's configuration: 200 objects x 250 pushes, 64 objects a batch.

    python benchmarks/epoch.py [--epochs 20]

Random pushes: the time does not depend on the values. The methods take turns, epoch by epoch.
"""

import argparse
import statistics
import time

import torch

from training.evaluate import NormalisedPushes
from training.fit import keep_freed_memory, train_epoch
from training.networks import METHODS, PushNetwork
from training.recipes import Recipe

OBJECTS, PUSHES = 200, 250


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--epochs", type=int, default=20, help="epochs of each method")
    options = parser.parse_args()
    keep_freed_memory()
    torch.manual_seed(0)
    context = (torch.rand(OBJECTS, 36) < 0.25).float()
    pushes = torch.randn(2, OBJECTS, PUSHES, 3)
    train = NormalisedPushes(pushes[0], pushes[1], torch.ones(OBJECTS, PUSHES), context)
    recipes = {
        name: Recipe("push", name, "different-objects", options.epochs, 64, 0.002, 0.01, 10.0, 0) for name in METHODS
    }
    networks = {name: PushNetwork(METHODS[name].masked) for name in METHODS}
    adams = {name: torch.optim.Adam(network.parameters(), fused=True) for name, network in networks.items()}
    seconds: dict[str, list[float]] = {name: [] for name in METHODS}
    for epoch in range(options.epochs + 1):
        for name in METHODS:
            started = time.perf_counter()
            train_epoch(networks[name], adams[name], train, recipes[name], epoch)
            if epoch:  # the first one warms up
                seconds[name].append(time.perf_counter() - started)
    print(f"torch {torch.__version__}, {torch.get_num_threads()} threads")
    print("| method | median s/epoch | fastest | 3000 epochs (min) |")
    print("|---|---|---|---|")
    for name, times in seconds.items():
        median = statistics.median(times)
        print(f"| {name} | {median:.3f} | {min(times):.3f} | {median * 50:.1f} |")


if __name__ == "__main__":
    main()
