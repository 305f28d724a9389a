"""Datasets of simulated pushes, recorded as Omnipush records them, in Omnipush's file format.

The pusher moves in a straight line at constant speed for 50 mm, and the object does not deflect it. Pushes differ in
start and aim of the pusher and in conditions that are not recorded, as their plan says (``plans``). A noisy tracker
then measures the poses (``record``).

Every object has random streams of its own, so the files depend on the seed. They do not depend on the order of objects,
the number of threads, interruptions or the processor. Only the plan ``ring`` depends on the processor, in last digits.
``docs/data.md`` lists assumptions beyond the paper.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from service.processors import processors
from service.pushing.contexts import ObjectContext
from training.omnipush.declaration import declare_dataset
from training.omnipush.pushes import has_object, write_object
from training.simulation.plans import DEFAULT_PLAN, Plan
from training.simulation.scene import relative
from training.simulation.surfaces import ABS, Array, Surface

# Yu et al. 2016, section IV: the robot is accurate to 0.1 mm, taken as three standard deviations
PUSHER_STD_M: Final = 0.00003


@dataclass(frozen=True)
class Simulation:
    """Dataset to simulate: objects on a surface, pushes per object, seed, and the plan of the pushes."""

    descriptors: tuple[str, ...]
    pushes_per_object: int = 250
    seed: int = 0
    surface: Surface = ABS
    plan: Plan = DEFAULT_PLAN

    def declaration(self) -> dict[str, object]:
        """Return the content of the folder's ``dataset.json``."""
        name, plan = self.surface.name, self.plan
        return {
            "source": f"simulated pushes ({plan.simulator}, {name.upper()}, seed {self.seed})",
            "simulated": True,
            "surface": name,
            "tracker_std": list(plan.tracker_std),
            "seed": self.seed,
            "pushes_per_object": self.pushes_per_object,
            **plan.declared(self.surface),
        }


def simulate_dataset(wanted: Simulation, folder: Path, threads: int | None = None, quiet: bool = False) -> int:
    """Simulate every object that the folder does not hold yet.

    Returns:
        The number of pushes simulated.

    Raises:
        DataError: The folder holds another dataset, or cannot be written.
    """
    declare_dataset(folder, wanted.declaration())
    missing = [descriptor for descriptor in wanted.descriptors if not has_object(folder, descriptor)]
    surface, plan = wanted.surface, wanted.plan
    with plan.laboratory(surface, wanted.seed, threads or processors()) as pushes:
        for descriptor in tqdm(missing, desc=f"pushing on {surface.name}", unit="object", disable=quiet):
            # seeded with the names' bytes, so that no other object or surface shares the stream
            rng = np.random.default_rng([wanted.seed, *f"{surface.name} {descriptor}".encode()])
            pushers, outcomes = pushes(ObjectContext.from_descriptor(descriptor), wanted.pushes_per_object, rng)
            write_object(folder, descriptor, *record(pushers, outcomes, rng, plan))
    return len(missing) * wanted.pushes_per_object


def record(pushers: Array, outcomes: Array, rng: np.random.Generator, plan: Plan) -> tuple[Array, Array]:
    """Add tracker noise to pushes and outcomes, (n, 3) each, and express them in the measured object frame.

    The object's pose is measured before and after the push, so the recorded frame itself has an error.
    """
    before, after = (rng.normal(0.0, plan.tracker_std, (len(pushers), 3)) for _ in range(2))
    measured = pushers + rng.normal(0.0, 1.0, pushers.shape) * (PUSHER_STD_M, PUSHER_STD_M, 0.0)
    return relative(measured, before, plan.arctan2), relative(outcomes + after, before, plan.arctan2)
