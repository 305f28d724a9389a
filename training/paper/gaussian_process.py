"""Data of the paper's regression (section IV-A): one-step prediction of Gaussian processes, with the kernel as context.

A parameter set is a scale xi and a bandwidth l, both uniform on (0.1, 10), of the kernel
``K(a, b) = xi^2 exp(-(a - b)^2 / (2 l))``. Each gives one path z of 23 points, that is 20 samples of three past values
and the next. Choices that the paper leaves open:

- The time step is 0.3. Three past values then leave a standard deviation of 0.002 xi (l = 10), 0.006 xi (l = 5) or
  0.7 xi (l = 0.1). They predict the next value of nearly all processes, and the error depends on the context.
- Values and errors are in units of the training set's standard deviation, about 5.8, as pushes are normalised. With raw
  values no method trains at the paper's learning rate. Contexts are raw xi and l.
- A batch is 32 of the 4000 samples. Batches of 32 parameter sets with all their samples would be 18 times fewer steps,
  and the errors of the last epochs scatter by more than methods differ (``docs/log.md``).
"""

import hashlib
from typing import Final

import numpy as np
import numpy.typing as npt

from training.fitting.samples import Samples, TrainingData

TIME_STEP: Final = 0.3
LOWEST, HIGHEST = 0.1, 10.0
TRAIN_SETS: Final = 200
TEST_SETS: Final = 20
SAMPLES_PER_SET: Final = 20
HISTORY: Final = 3
POINTS: Final = SAMPLES_PER_SET + HISTORY
SOURCE: Final = f"Gaussian processes drawn by this project, time step {TIME_STEP}"

Array = npt.NDArray[np.float64]


def draw_training_data(repeat: int) -> TrainingData:
    """Draw one simulation: 4000 training samples of 200 parameter sets, 400 test samples of 20 others."""
    rng = np.random.default_rng(repeat)
    drawn = [draw_sets(rng, count) for count in (TRAIN_SETS, TEST_SETS)]
    digest = hashlib.sha256(b"".join(array.tobytes() for arrays in drawn for array in arrays)).hexdigest()
    mean, std = float(drawn[0][1].mean()), float(drawn[0][1].std())
    train, held_out = (samples_of(parameters, (paths - mean) / std, std) for parameters, paths in drawn)
    return TrainingData(train.singly(), held_out, {"source": SOURCE, "sha256": digest, "batches": "of samples"})


def draw_sets(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Draw parameter sets (count, 2) of xi and l, and a path of each, (count, 23)."""
    parameters = rng.uniform(LOWEST, HIGHEST, (count, 2))
    return parameters, draw_paths(rng, parameters)


def covariance(parameters: Array, times: Array) -> Array:
    """Compute the covariance K of each parameter set at these times, (sets, times, times)."""
    scale, bandwidth = parameters[:, 0, None, None], parameters[:, 1, None, None]
    squared = (times[:, None] - times[None, :]) ** 2
    result: Array = scale**2 * np.exp(-squared / (2.0 * bandwidth))
    return result


def draw_paths(rng: np.random.Generator, parameters: Array) -> Array:
    """Draw a path of each parameter set, (sets, 23).

    For a large bandwidth K is singular up to rounding. Its eigenvectors give a root where Cholesky fails.
    """
    times = TIME_STEP * np.arange(POINTS, dtype=np.float64)
    values, vectors = np.linalg.eigh(covariance(parameters, times))
    noise = np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(values.shape)
    paths: Array = np.einsum("stk,sk->st", vectors, noise)
    return paths


def samples_of(parameters: Array, paths: Array, unit: float = 1.0) -> Samples:
    """Cut paths into windows: inputs z[t-2], z[t-1], z[t], target z[t+1], context xi and l. ``unit`` is that of z."""
    windows = np.lib.stride_tricks.sliding_window_view(paths, HISTORY + 1, axis=1)  # (sets, 20, 4)
    valid = np.ones(windows.shape[:2])
    return Samples.of_arrays(windows[..., :HISTORY], windows[..., HISTORY:], valid, parameters, (unit,))
