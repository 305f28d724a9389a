"""Distances and turns of simulated pushes beside those of Omnipush's recordings, and the search for starts and aims.

    python -m benchmarks.omnipush_quantiles [--pushes 250] [--seed 0] [--search]

Objects without weights on ABS, as recorded. With 250 pushes and seed 0 they are those of the default data. Printed are
quantiles of the pushes that moved the object by over 1 mm, the ratio to the recorded ones that is furthest from 1, and
deviations of starts and directions over the published ones. With --search the same for other settings of the plan
``approach``: the share of lines near the centroid, and how near.
"""

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from service.processors import processors
from service.pushing.contexts import ObjectContext
from training.inspection.statistics import QUANTILES, motion_quantiles
from training.omnipush.published import (
    omnipush_descriptors,
    published_normalisation,
    recorded_outcomes,
    weight_count,
)
from training.simulation.approach import Approach
from training.simulation.dataset import record
from training.simulation.plans import APPROACH, OMNIPUSH_APPROACH, PLANS, Plan, push_over_the_approach
from training.simulation.surfaces import ABS, Array

CENTRAL_SHARES = (0.6, 0.7, 0.8, 0.9)
CENTRAL_HALF_WIDTHS = (0.45, 0.6, 0.75, 0.9)
Pushed = tuple[Array, Array]
Push = Callable[[ObjectContext, np.random.Generator], Pushed]


def simulated(push: Push, plan: Plan, seed: int) -> Pushed:
    """Return recorded pushes (n, 3) and outcomes (n, 3) of all objects without weights."""
    found = []
    for descriptor in tqdm([name for name in omnipush_descriptors() if weight_count(name) == 0], leave=False):
        rng = np.random.default_rng([seed, *f"{ABS.name} {descriptor}".encode()])  # as in simulate_dataset
        pushers, outcomes = push(ObjectContext.from_descriptor(descriptor), rng)
        found.append(record(pushers, outcomes, rng, plan))
    pushers, outcomes = (np.concatenate(rows) for rows in zip(*found, strict=True))
    return pushers, outcomes


def row(name: str, pushers: Array, outcomes: Array) -> str:
    """Return a row of the table: quantiles, the worst ratio to the recorded ones, and the spread of the inputs."""
    found, recorded = motion_quantiles(outcomes), recorded_outcomes()
    ratios = np.array([*found.distance_mm, *found.turn_deg]) / [*recorded.distance_mm, *recorded.turn_deg]
    worst = float(ratios[np.abs(ratios - 1.0).argmax()])
    spread = pushers.std(axis=0) / published_normalisation().input_std
    cells = [
        " ".join(f"{value:.1f}" for value in found.distance_mm),
        " ".join(f"{value:.1f}" for value in found.turn_deg),
        f"{worst:.2f}",
        f"{100 * found.still_share:.1f} %",
        " ".join(f"{value:.2f}" for value in spread),
    ]
    return f"| {name} | " + " | ".join(cells) + " |"


def main() -> None:
    """Simulate and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pushes", type=int, default=250, help="of each of the 70 objects")
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers")
    parser.add_argument("--search", action="store_true", help="try other settings of the plan approach")
    options = parser.parse_args()
    levels = " ".join(f"{100 * level:.0f}" for level in QUANTILES)
    print(f"| plan | distance (mm) at {levels} % | turn (deg) | worst ratio | did not move | x, y, angle std ratio |")
    print("|---|---|---|---|---|---|")
    recorded = recorded_outcomes()
    distance, turn = (" ".join(map(str, values)) for values in (recorded.distance_mm, recorded.turn_deg))
    print(f"| recorded | {distance} | {turn} | | {100 * recorded.did_not_move_share:.1f} % | |")
    for plan in PLANS.values():
        with plan.laboratory(ABS, options.seed, processors()) as pushes:
            pushed = simulated(lambda context, rng: pushes(context, options.pushes, rng), plan, options.seed)
            print(row(plan.name, *pushed))
    for share, half_width in itertools.product(CENTRAL_SHARES, CENTRAL_HALF_WIDTHS) if options.search else ():
        settings = replace(OMNIPUSH_APPROACH, central_share=share, central_half_width=half_width)

        def push(context: ObjectContext, rng: np.random.Generator, settings: Approach = settings) -> Pushed:
            """Push with these settings."""
            return push_over_the_approach(context, ABS, options.pushes, rng, settings)

        print(row(f"{100 * share:.0f} % within {half_width} sizes", *simulated(push, APPROACH, options.seed)))


if __name__ == "__main__":
    main()
