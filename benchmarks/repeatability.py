"""Scatter of a repeated push in the simulator, beside the measurements on real plates.

    python -m benchmarks.repeatability [--repeats 400]

Yu et al., "More than a million ways to be pushed", IROS 2016, section VII: a square steel block of 90 mm, pushed 150 mm
at 20 mm/s along the normal of a side, half way between its middle and its corner, 2,000 times on each plate (table IV).
Here the block rests on 16 feet and lies anywhere on the plate at any yaw. The pusher moves at the dataset's 36 mm/s.
"""

import argparse

import numpy as np
from mujoco import rollout

from service.processors import processors
from training.simulation.plans import RING
from training.simulation.scene import PUSHER_RADIUS_M, push_object, relative
from training.simulation.solids import Solid
from training.simulation.surfaces import SURFACES, FrictionField, draw_conditions

HALF_WIDTH_M = 0.045
PUBLISHED = {"abs": (5.5, 3.2), "plywood": (8.1, 4.2)}  # std of position (mm) and of rotation (deg)


def main() -> None:
    """Simulate the pushes and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=400, help="pushes on each plate")
    repeats = parser.parse_args().repeats
    half = HALF_WIDTH_M
    feet = np.linspace(-0.9 * half, 0.9 * half, 4)
    block = Solid(
        (np.array([(-half, -half), (half, -half), (half, half), (-half, half)]),),
        (),
        tuple((float(x_m), float(y_m)) for x_m in feet for y_m in feet),
    )
    start = np.tile((-half - PUSHER_RADIUS_M - 0.001, half / 2, 0.0), (repeats, 1))
    threads = processors()
    print(
        "| plate | mean x, y (mm), yaw (deg) | std of position (mm) | published | std of rotation (deg) | published |"
    )
    print("|---|---|---|---|---|---|")
    for name, surface in SURFACES.items():
        rng = np.random.default_rng(0)
        conditions = draw_conditions(surface, FrictionField(surface, rng), repeats, rng)
        pushers = relative(start, rng.normal(0.0, RING.tracker_std, start.shape))  # the robot trusts the tracker
        with rollout.Rollout(nthread=threads) as pool:
            outcomes = push_object(block, pushers, conditions, pool, threads, push_length_m=0.150)
        x_m, y_m, yaw_rad = outcomes.mean(axis=0)
        seen = outcomes + rng.normal(0.0, RING.tracker_std, outcomes.shape)
        position_mm = 1e3 * np.sqrt(seen[:, :2].var(axis=0).sum())
        rotation_deg = np.degrees(seen[:, 2].std())
        mean = f"{1e3 * x_m:.1f}, {1e3 * y_m:.1f}, {np.degrees(yaw_rad):.1f}"
        print(f"| {name} | {mean} | {position_mm:.1f} | {PUBLISHED[name][0]} | ", end="")
        print(f"{rotation_deg:.1f} | {PUBLISHED[name][1]} |")


if __name__ == "__main__":
    main()
