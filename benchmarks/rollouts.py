"""Honesty of rollouts: how often the true pose lies in the predicted 90 % region after each of several pushes.

    python -m benchmarks.rollouts [--recorded FOLDER] [--unseen MODELS] [--sequences 400]
        [--out docs/results/rollouts]

Rollouts are those of ``service.planning.rollout``, as POST /v1/rollout makes them, with a served model of any shape.
They are held against sequences of pushes fixed in advance (``benchmarks.rollout_sequences``):

    MuJoCo      drawn objects of the families irregular-polygon, T, wrench and bean, 50 to 200 mm across, with drawn
                friction and pressure, pushed on a table in MuJoCo. The model is told the body (outline, tip, centre of
                mass, friction), or outline and tip alone. Half of the objects carry a load that the outline does not
                show
    recorded    chains of the pushes of a table of recorded pushes (docs/data.md), with --recorded

The version that is served has learnt from objects of all families. One that never saw these four is the run of the
recipe that holds them out:

    cazsl-train publish runs/push-shape --registry build/unseen
    python -m benchmarks.rollouts --unseen build/unseen

A region is the ellipsoid of x, y and yaw from the mean and the covariance of the particles (chi-square, 3 degrees of
freedom). Beside it stands the share of the true poses that are nearer to the mean, by that measure, than 90 % of the
particles. With --out, a page, a plot and the figures are written.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from benchmarks.push_measures import difference, score
from benchmarks.real_pushes import make_folder
from benchmarks.rollout_sequences import Sequences, chained, simulated
from benchmarks.rollouts_page import Findings, Row, StepScore, coverage_table, write_page
from service.errors import CazslError, DataError
from service.inference.object_model import ObjectModel
from service.inference.query import ContextBatch
from service.model.loaded_model import LoadedModel
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.planning.rollout import rollout
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import ShapeContext
from service.registry.loading import load_version
from service.registry.registry import Registry
from training.environments.tasks import Task, draw_tasks
from training.fitting.shape_samples import HELD_OUT_FAMILIES
from training.tables.push_table import PushTable
from training.tables.reading import read_table

STEPS: Final = 5
SEED: Final = 25
MODEL: Final = "push-shape"
BODY, OUTLINE = "the body", "outline and tip"
TABLE: Final = "the body as the table has it"
KNOWS: Final = (BODY, OUTLINE)
UNSEEN: Final = "without the four families"
_LEVEL: Final = 0.9


def load_model(folder: Path) -> LoadedModel:
    """Load the champion of ``push-shape`` in a registry.

    Raises:
        CazslError: there is none, or it fails verification.
    """
    registry = Registry(folder)
    return load_version(registry, OnnxPredictor, MODEL, registry.resolve(ModelReference.parse(MODEL)))


def object_model(model: LoadedModel, context: ShapeContext) -> ObjectModel:
    """Return a model as that of one object."""
    tensors = tuple(tensor[None] for tensor in context.tensors())
    return ObjectModel(model, ContextBatch(ContextKind.SHAPE, tensors, np.zeros(1, dtype=np.int64), "context"))


def simulated_sequences(model: LoadedModel, knows: str, tasks: Sequence[Task]) -> Iterator[Sequences]:
    """Yield a sequence for each task, without those that begin a push inside of the object."""
    for task in tqdm(tasks, desc=f"MuJoCo, {knows}", unit="sequence", disable=None):
        drawn = task.drawn
        outline, radius_m = drawn.outline, drawn.pusher_radius_m
        context = ShapeContext(outline, pusher_radius_m=radius_m)
        if knows == BODY:
            context = ShapeContext(outline, drawn.centre_of_mass_m, drawn.friction, radius_m)
        found = simulated(task, context, object_model(model, context), STEPS)
        if found is not None:
            yield found


def score_row(where: str, knows: str, name: str, model: LoadedModel, found: Iterator[Sequences], particles: int) -> Row:
    """Roll out sequences and score each step.

    Raises:
        DataError: there is no sequence.
    """
    poses, means, covariances, ranks = [], [], [], []
    for one in found:
        clouds = rollout(object_model(model, one.context), one.start, one.pushes, particles, SEED)
        mean, covariance = clouds.moments()
        poses.append(one.poses)
        means.append(mean)
        covariances.append(covariance)
        ranks.append(nearer(one.poses, clouds.particles, mean, covariance))
    if not poses:
        raise DataError(f"{where}: there is no sequence of {STEPS} pushes; give more pushes or sequences")
    truth, mean, covariance, rank = (np.concatenate(each) for each in (poses, means, covariances, ranks))
    steps = tuple(
        StepScore(
            score(truth[:, step], mean[:, step], covariance[:, step]),
            float((rank[:, step] <= _LEVEL).mean()),
            float(1e3 * np.sqrt(np.trace(covariance[:, step, :2, :2], axis1=1, axis2=2)).mean()),
            float(np.degrees(np.sqrt(covariance[:, step, 2, 2])).mean()),
        )
        for step in range(STEPS)
    )
    return Row(where, knows, name, len(truth), steps)


def nearer(poses: DoubleArray, particles: DoubleArray, mean: DoubleArray, covariance: DoubleArray) -> DoubleArray:
    """Return the share (s, k) of particles (s, k, p, 3) that are nearer to the mean than poses (s, k, 3) are.

    Distances are those of Mahalanobis.
    """
    inverse = np.linalg.inv(covariance)
    apart = difference(poses.reshape(-1, 3), mean.reshape(-1, 3)).reshape(poses.shape)
    middle = np.broadcast_to(mean[..., None, :], particles.shape)
    away = difference(particles.reshape(-1, 3), middle.reshape(-1, 3)).reshape(particles.shape)
    square = np.einsum("...i,...ij,...j->...", apart, inverse, apart)
    squares = np.einsum("...pi,...ij,...pj->...p", away, inverse, away)
    share: DoubleArray = (squares < square[..., None]).mean(axis=-1)
    return share


def rows(options: argparse.Namespace, table: PushTable | None) -> Iterator[Row]:
    """Yield the rows of the table: every kind of sequences, for every version.

    Raises:
        CazslError: a version cannot be loaded.
    """
    served = load_model(options.models_folder)
    versions = {f"{MODEL}@{served.manifest.version}": served}
    if options.unseen is not None:
        versions[UNSEEN] = load_model(options.unseen)
    tasks = draw_tasks(HELD_OUT_FAMILIES, options.sequences, SEED)
    for name, model in versions.items():
        for knows in KNOWS:
            found = simulated_sequences(model, knows, tasks)
            yield score_row("MuJoCo", knows, name, model, found, options.particles)
        if table is not None:
            bare = all(item.centre_of_mass_m is None and item.friction is None for item in table.objects)
            knows = OUTLINE if bare else TABLE
            found = chained(table, options.chains, STEPS, SEED)
            yield score_row("recorded", knows, name, model, found, options.particles)


def main(arguments: Sequence[str] | None = None) -> None:
    """Score, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.rollouts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--recorded", type=Path, metavar="FOLDER", help="a table of recorded pushes, to be chained")
    parser.add_argument("--source", default="", help="credit of the recorded pushes (by default the table's)")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--unseen", type=Path, metavar="MODELS", help="registry of the version without the families")
    parser.add_argument("--sequences", type=int, default=400, metavar="N", help="of each kind in MuJoCo (400)")
    parser.add_argument("--chains", type=int, default=1400, metavar="N", help="of recorded pushes (1400)")
    parser.add_argument("--particles", type=int, default=256, metavar="N", help="of a rollout (256)")
    parser.add_argument("--out", type=Path, help="write page, plot and figures into this folder")
    options = parser.parse_args(arguments)
    if min(options.sequences, options.chains) < 1 or options.particles < 10:
        parser.error("--sequences and --chains are positive, and --particles 10 or more")
    try:
        make_folder(options.out)
        table = None if options.recorded is None else read_table(options.recorded)
        source = "" if table is None else options.source or table.source
        digest = "" if table is None else table.digest
        findings = Findings(_command(options), source, digest, options.particles, tuple(rows(options, table)))
    except CazslError as error:
        sys.exit(f"error: {error}")
    print(coverage_table(findings))
    if options.out is None:
        print("\nnext: --out FOLDER writes this with a plot and the figures")
    else:
        write_page(options.out, findings)
        print(f"\nwrote {options.out}; next: read {options.out / 'README.md'}")


def _command(options: argparse.Namespace) -> str:
    """Return the command that made the findings, without the places of files."""
    recorded = " --recorded FOLDER" if options.recorded else ""
    unseen = " --unseen build/unseen" if options.unseen else ""
    return f"python -m benchmarks.rollouts{recorded}{unseen} --sequences {options.sequences}"


if __name__ == "__main__":
    main()
