"""Zero-shot and few-shot answers about objects that no model has seen: what some pushes of an object are worth.

    python -m benchmarks.few_shot [--objects 60] [--pushes 150] [--out docs/results/few-shot]

Objects are drawn from the sides and weights of Omnipush, and none of them is one of Omnipush's 250, turned or mirrored.
Their pushes are simulated as those that the models learnt from. The first 50 pushes of an object are its support, of
which the meta-learner is given 1, 5, 10 or 50, and all models are asked about the others.

Printed is a table of errors and coverage. With --out, a page with it and the figures are written.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

import service
from benchmarks.push_measures import Score, score
from benchmarks.real_pushes import make_folder
from benchmarks.shape_predictions import answering_version
from service.client import Client, ClientError, ContextBody, SupportBody
from service.errors import CazslError
from service.pushing.contexts import MAX_SUPPORT, SIDES, ObjectContext
from service.pushing.poses import DoubleArray
from service.pushing.sides import outline
from service.storage.disk import replace_whole
from training.omnipush.published import omnipush_descriptors
from training.omnipush.pushes import Pushes, read_folder
from training.simulation.dataset import Simulation, simulate_dataset

PAGE_FILE, FIGURES_FILE = "README.md", "figures.json"
COUNTS: Final = (1, 5, 10, 50)  # pushes in a support
MOST_WEIGHTS: Final = 2
SEED: Final = 25
NONE, INDICATOR, SHAPE, PROCESS = "push-none", "push-indicator", "push-shape", "push-anp"
PAGE: Final = """# What some pushes of an object are worth

`{command}`

asks every model about {pushes:,} pushes of {objects} new objects with the sides of Omnipush (digest {digest}..., cazsl
{code}), as one request each. Origin: {source}. None of the objects is one of Omnipush's 250, turned or mirrored, so no
model has seen them. Supports are other pushes of the same objects.

Position and yaw are mean errors (median in brackets). RMSE is in units of the published output deviations of Omnipush.

{table}

{sentences}
"""
Context = str | ContextBody | None


@dataclass(frozen=True)
class Findings:
    """Scores by model and what it knows, and the data that they were asked about."""

    command: str
    source: str
    digest: str
    pushes: int
    objects: int
    scores: Mapping[str, Score]


def new_objects(count: int, seed: int) -> tuple[str, ...]:
    """Draw descriptors of different objects with at most two weights, none of them one of Omnipush's."""
    rng = np.random.default_rng(seed)
    known = {form for name in omnipush_descriptors() for form in _forms(name)}
    found: list[str] = []
    while len(found) < count:
        weights = np.full(SIDES, "a")
        heavy = rng.choice(SIDES, rng.integers(0, MOST_WEIGHTS + 1), replace=False)
        weights[heavy] = rng.choice(["b", "c"], len(heavy))
        name = "".join(digit + weight for digit, weight in zip(rng.choice(list("1234"), SIDES), weights, strict=True))
        if name not in known:
            found.append(name)
            known |= set(_forms(name))
    return tuple(found)


def _forms(descriptor: str) -> Iterator[str]:
    """Yield an object's descriptors in all turned and mirrored frames."""
    first, second, third, fourth = ObjectContext.from_descriptor(descriptor).sides
    for sides in ((first, second, third, fourth), (first, fourth, third, second)):
        for quarters in range(SIDES):
            yield ObjectContext(sides).turned(quarters).descriptor()


def contexts_of(pushes: Pushes) -> dict[str, tuple[str, Sequence[Context]]]:
    """Return what each model is told of each object, by the name of the answer."""
    names = pushes.descriptors
    shapes = [ContextBody(outline=outline(ObjectContext.from_descriptor(name)).corners.tolist()) for name in names]
    found: dict[str, tuple[str, Sequence[Context]]] = {
        f"{NONE}: nothing": (NONE, [None] * len(names)),
        f"{INDICATOR}: its sides and weights": (INDICATOR, names),
        f"{SHAPE}: its outline": (SHAPE, shapes),
    }
    for count in COUNTS:
        supports = [
            ContextBody(support=SupportBody(pushers=pushers[:count].tolist(), outcomes=outcomes[:count].tolist()))
            for pushers, outcomes in zip(pushes.pushers, pushes.outcomes, strict=True)
        ]
        found[f"{PROCESS}: {count} push{'es' if count > 1 else ''} of it"] = (PROCESS, supports)
    return found


def ask(
    client: Client, model: str, contexts: Sequence[Context], pushers: DoubleArray
) -> tuple[DoubleArray, DoubleArray]:
    """Return means and deviations (objects * pushes, 3) of pushes (objects, pushes, 3), object by object."""
    parts = []
    for context, rows in zip(contexts, pushers, strict=True):
        parts.append(client.predict_batch(rows, context, model=model))
    return np.concatenate([part.mean for part in parts]), np.concatenate([part.std for part in parts])


def find(pushes: Pushes, models: str, command: str) -> Findings:
    """Ask every model and score the answers.

    Raises:
        CazslError, ClientError: a model cannot be asked.
    """
    asked, outcomes = (part[:, MAX_SUPPORT:].astype(np.float64) for part in (pushes.pushers, pushes.outcomes))
    scores = {}
    with Client.local(models) as client:
        for name, (model, contexts) in contexts_of(pushes).items():
            version = answering_version(client, model)
            mean, std = ask(client, version, contexts, asked)
            covariance = np.einsum("ni,ij->nij", std.astype(np.float64) ** 2, np.eye(3))
            scores[name.replace(model, version)] = score(outcomes.reshape(-1, 3), mean.astype(np.float64), covariance)
    count = outcomes.shape[0] * outcomes.shape[1]
    return Findings(command, pushes.source, pushes.digest, count, len(outcomes), scores)


def markdown(findings: Findings) -> str:
    """Return the table of all scores, in Markdown."""
    head = "| model: what it knows of the object | position (mm) | yaw (deg) | RMSE | 90 % intervals | 90 % regions |"
    lines = [head, "|" + "---|" * 6]
    for name, found in findings.scores.items():
        position, yaw, honest = found.position_mm, found.yaw_deg, found.calibration
        shares = "- | -" if honest is None else f"{100 * honest.intervals[1]:.1f} % | {100 * honest.regions[1]:.1f} %"
        lines.append(
            f"| {name} | {position.mean:.2f} ({position.median:.2f}) | {yaw.mean:.2f} ({yaw.median:.2f}) "
            f"| {found.rmse:.3f} | {shares} |"
        )
    return "\n".join(lines)


def sentences(findings: Findings) -> Iterator[str]:
    """Yield what the table says of the meta-learner, beside a model that knows nothing."""
    nothing = next(found for name, found in findings.scores.items() if name.startswith(NONE))
    for name, found in findings.scores.items():
        if not name.startswith(NONE):
            yield f"- {name}: {found.rmse / nothing.rmse:.2f} times the RMSE of knowing nothing."


def write_page(folder: Path, findings: Findings) -> None:
    """Write page and figures into a folder that exists."""
    document = {**asdict(findings), "code_version": service.__version__}
    rounded = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.6g}"))
    replace_whole(folder / FIGURES_FILE, (json.dumps(rounded, indent=1) + "\n").encode())
    page = PAGE.format(
        command=findings.command,
        pushes=findings.pushes,
        objects=findings.objects,
        digest=findings.digest[:8],
        code=service.__version__,
        source=findings.source.rstrip("."),
        table=markdown(findings),
        sentences="\n".join(sentences(findings)),
    )
    replace_whole(folder / PAGE_FILE, page.encode())


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate, ask, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.few_shot",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--objects", type=int, default=60, help="new objects (60)")
    parser.add_argument("--pushes", type=int, default=150, help="pushes of each, of which 50 are its support (150)")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--out", type=Path, help="write page and figures into this folder")
    options = parser.parse_args(arguments)
    if options.objects < 1 or options.pushes <= MAX_SUPPORT:
        parser.error(f"--objects is at least 1, and --pushes more than {MAX_SUPPORT}")
    command = f"python -m benchmarks.few_shot --objects {options.objects} --pushes {options.pushes}"
    try:
        make_folder(options.out)
        with TemporaryDirectory() as folder:
            wanted = Simulation(new_objects(options.objects, SEED), options.pushes, seed=SEED)
            simulate_dataset(wanted, Path(folder))
            findings = find(read_folder(Path(folder)), str(options.models_folder), command)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    print(markdown(findings))
    print("\n" + "\n".join(sentences(findings)))
    if options.out is None:
        print("\nnext: --out FOLDER writes this with the figures")
    else:
        write_page(options.out, findings)
        print(f"\nwrote {options.out}; next: read {options.out / PAGE_FILE}")


if __name__ == "__main__":
    main()
