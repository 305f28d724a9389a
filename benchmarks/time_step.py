"""Error of the simulator's time step: the same pushes at the dataset's step and at a quarter of it.

python -m benchmarks.time_step [--objects 10] [--pushes 40]
"""

import argparse

import numpy as np
from mujoco import rollout

from service.processors import processors
from service.pushing.contexts import ObjectContext
from training.omnipush.published import omnipush_descriptors
from training.simulation.plans import sample_pushers
from training.simulation.scene import TIME_STEP_S, push_object
from training.simulation.solids import solid
from training.simulation.surfaces import even_conditions


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=int, default=10, help="objects, spread over the benchmark's list")
    parser.add_argument("--pushes", type=int, default=40, help="pushes of each")
    options = parser.parse_args()
    threads = processors()
    names = omnipush_descriptors()
    difference = []
    with rollout.Rollout(nthread=threads) as pool:
        for number, name in enumerate(names[:: len(names) // options.objects][: options.objects]):
            body = solid(ObjectContext.from_descriptor(name))
            pushers = sample_pushers(body, options.pushes, np.random.default_rng(number))
            even = even_conditions(len(pushers))
            coarse, fine = (push_object(body, pushers, even, pool, threads, TIME_STEP_S / part) for part in (1, 4))
            difference.append(coarse - fine)
    errors = np.concatenate(difference)
    x_m, y_m, yaw_rad = np.sqrt(np.mean(errors**2, axis=0))
    print(
        f"{len(errors)} pushes of {options.objects} objects, step {TIME_STEP_S * 1e3:.0f} ms against a quarter of it:"
    )
    print(f"rms difference x {x_m * 1e3:.2f} mm, y {y_m * 1e3:.2f} mm, yaw {yaw_rad * 1e3:.1f} mrad")


if __name__ == "__main__":
    main()
