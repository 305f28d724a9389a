"""Difference between two simulations of the same pushes, for example on two processors.

    python -m benchmarks.same_pushes FOLDER OTHER

Also counts the arctangents that numpy and the C library round differently here, the cause of such differences
(docs/data.md).
"""

import argparse
import math
from pathlib import Path

import numpy as np

from training.omnipush.files import list_folder
from training.omnipush.pushes import read_object

ARCTANGENTS = 1_000_000


def outcomes(folder: Path) -> dict[str, np.ndarray]:
    """Return the object's pose after each push (pushes, 3) in m, m, rad, by object."""
    return {name: read_object(pair)[1] for name, pair in list_folder(folder).pairs.items()}


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of pushes, as cazsl-train simulate writes them")
    parser.add_argument("other", type=Path, help="of the same pushes")
    options = parser.parse_args()
    first, second = outcomes(options.folder), outcomes(options.other)
    if first.keys() != second.keys():
        parser.error(f"{options.folder} holds {len(first)} objects, {options.other} {len(second)}: not the same ones")
    apart = np.abs(np.concatenate([first[name] - second[name] for name in first]))
    (x_m, y_m, yaw_rad), worst = apart.max(axis=0), apart.max(axis=1)
    print(f"{len(apart)} pushes, {np.mean(worst == 0.0):.1%} the same to the last bit;")
    print(f"99.9 % are within {np.quantile(worst, 0.999):.1e} (m, rad),", end=" ")
    print(f"all within {1e9 * max(x_m, y_m):.0f} nm and {1e6 * yaw_rad:.1f} microrad")
    y, x = np.random.default_rng(0).normal(size=(2, ARCTANGENTS))
    exact = np.fromiter(map(math.atan2, y, x), dtype=np.float64, count=ARCTANGENTS)
    print(f"{np.mean(np.arctan2(y, x) != exact):.1%} of numpy's arctangents are not those of the C library here")


if __name__ == "__main__":
    main()
