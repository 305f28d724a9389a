"""Omnipush's own objects through their outlines: a model of any shape beside a model that knows Omnipush's sides.

    cazsl-train simulate data/approach-new --seed 1 --pushes 50
    python -m benchmarks.omnipush_outlines data/approach-new/abs [--model push-shape] [--beside push-indicator]

FOLDER holds pushes in Omnipush's format. The model of any shape is asked with each object's outline, once with its
centre of mass and once without, and with the radius of the tip. The other one is asked with the descriptor. The objects
are those that it learnt from, so the pushes should be new: simulated with another seed than its data, as above.

Printed is a table over all objects and by the number of weights, with the ratio of the two RMSE. With --out, a page
with it and the figures are written.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

import service
from benchmarks.push_bands import Mask
from benchmarks.push_measures import Score, score
from benchmarks.real_pushes import make_folder
from benchmarks.shape_predictions import Knowledge, answering_version, ask_shapes
from service.client import Client, ClientError
from service.errors import CazslError
from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.pushing.sides import outline
from service.storage.disk import replace_whole
from training.omnipush.pushes import Pushes, read_folder
from training.simulation.solids import centre_of_mass_m
from training.tables.push_table import DEFAULT_PUSHER_RADIUS_M, UNSTATED, PushTable, TableObject

PAGE_FILE, FIGURES_FILE = "README.md", "figures.json"
ALL: Final = "all"
BATCH: Final = 10_000
PAGE: Final = """# Omnipush's objects through their outlines

`{command}`

asks both models about {pushes:,} pushes of {objects} objects of Omnipush (digest {digest}..., cazsl {code}).

Origin: {source}. The objects are those that the second model learnt from, on other pushes.

Position and yaw are mean errors (median in brackets). RMSE is in units of the published output deviations of Omnipush.

{table}

{sentences}
"""

Scores = Mapping[str, Mapping[str, Score]]
"""Scores by name of the model and its knowledge, and by group of objects."""


@dataclass(frozen=True)
class Findings:
    """Scores of the models, and the data that they were asked about."""

    command: str
    source: str
    digest: str
    pushes: int
    objects: int
    beside: str
    scores: Scores

    @property
    def summary(self) -> dict[str, float]:
        """Ratio of the RMSE of each answer of the model of any shape to that of the other model."""
        reference = self.scores[self.beside][ALL].rmse
        return {name: found[ALL].rmse / reference for name, found in self.scores.items() if name != self.beside}


def table_of(pushes: Pushes) -> PushTable:
    """Return a folder of Omnipush's format as a table of objects with outlines and centres of mass."""
    objects = []
    for descriptor in pushes.descriptors:
        context = ObjectContext.from_descriptor(descriptor)
        x_m, y_m = centre_of_mass_m(context).tolist()
        objects.append(TableObject(descriptor, outline(context), (x_m, y_m)))
    present = pushes.valid > 0
    pushers, outcomes = pushes.rows()
    count = len(pushers)
    return PushTable(
        objects=tuple(objects),
        object_index=np.nonzero(present)[0],
        pushers=np.column_stack([pushers, np.full(count, PUSH_LENGTH_M)]),
        outcomes=outcomes,
        pusher_radius_m=np.full(count, DEFAULT_PUSHER_RADIUS_M),
        surfaces=(UNSTATED,),
        surface_index=np.zeros(count, dtype=np.int64),
        source=pushes.source,
        digest=pushes.digest,
    )


def groups_of(table: PushTable) -> dict[str, Mask]:
    """Return the rows (n,) of all pushes, and of the objects with no, one and two weights."""
    weights = np.array([sum(side in "bcBC" for side in item.name) for item in table.objects])[table.object_index]
    groups = {ALL: np.ones(table.count, dtype=np.bool_)}
    for count, name in ((0, "no weight"), (1, "one weight"), (2, "two weights")):
        groups[name] = weights == count
    return {name: rows for name, rows in groups.items() if rows.any()}


def answers(
    client: Client, shape: str, beside: str, table: PushTable
) -> Iterator[tuple[str, tuple[DoubleArray, DoubleArray]]]:
    """Yield names, and means and deviations (n, 3), of the other model, and of the model of any shape twice."""
    yield beside, _by_descriptor(client, beside, table)
    rows = np.arange(table.count)
    yield f"{shape}, centre of mass known", ask_shapes(client, shape, table, rows, Knowledge.BODY)
    yield f"{shape}, outline alone", ask_shapes(client, shape, table, rows, Knowledge.OUTLINE)


def find(pushes: Pushes, options: argparse.Namespace) -> Findings:
    """Ask both models and score them.

    Raises:
        CazslError, ClientError: a model cannot be asked.
    """
    table = table_of(pushes)
    groups = groups_of(table)
    scores: dict[str, dict[str, Score]] = {}
    with Client.local(str(options.models_folder)) as client:
        shape, beside = (answering_version(client, name) for name in (options.model, options.beside))
        for name, (mean, std) in answers(client, shape, beside, table):
            covariance = np.einsum("ni,ij->nij", std**2, np.eye(3))
            scores[name] = {
                group: score(table.outcomes[rows], mean[rows], covariance[rows]) for group, rows in groups.items()
            }
    command = f"python -m benchmarks.omnipush_outlines FOLDER --model {shape} --beside {beside}"
    return Findings(command, table.source, table.digest, table.count, len(table.objects), beside, scores)


def markdown(findings: Findings) -> str:
    """Return the table of all scores, in Markdown."""
    head = "| model | objects | pushes | position (mm) | yaw (deg) | RMSE | ratio | 90 % intervals | 90 % regions |"
    lines = [head, "|" + "---|" * 9]
    for name, groups in findings.scores.items():
        for group, found in groups.items():
            ratio = found.rmse / findings.scores[findings.beside][group].rmse
            shares = "- | -"
            if found.calibration is not None:
                shares = f"{100 * found.calibration.intervals[1]:.1f} % | {100 * found.calibration.regions[1]:.1f} %"
            position, yaw = found.position_mm, found.yaw_deg
            lines.append(
                f"| {name} | {group} | {found.pushes:,} | {position.mean:.2f} ({position.median:.2f}) "
                f"| {yaw.mean:.2f} ({yaw.median:.2f}) | {found.rmse:.3f} | {ratio:.2f} | {shares} |"
            )
    return "\n".join(lines)


def write_page(folder: Path, findings: Findings) -> None:
    """Write page and figures into a folder that exists."""
    document = {**asdict(findings), "code_version": service.__version__, "summary": findings.summary}
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
        sentences="\n".join(_sentences(findings)),
    )
    replace_whole(folder / PAGE_FILE, page.encode())


def _sentences(findings: Findings) -> Iterator[str]:
    for name, ratio in findings.summary.items():
        yield f"- {name}: {ratio:.2f} times the RMSE of {findings.beside}."


def _by_descriptor(client: Client, name: str, table: PushTable) -> tuple[DoubleArray, DoubleArray]:
    """Return means and deviations (n, 3) of a model that takes descriptors."""
    mean, std = np.empty((table.count, 3)), np.empty((table.count, 3))
    for first in range(0, table.count, BATCH):
        part = slice(first, first + BATCH)
        used, index = np.unique(table.object_index[part], return_inverse=True)
        contexts = [table.objects[number].name for number in used.tolist()]
        found = client.predict_batch(table.pushers[part, :3], contexts, index.ravel(), model=name)
        mean[part], std[part] = found.mean, found.std
    return mean, std


def main(arguments: Sequence[str] | None = None) -> None:
    """Ask, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.omnipush_outlines",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="pushes in Omnipush's format, of one surface")
    parser.add_argument("--model", default="push-shape", metavar="NAME", help="model of any shape (push-shape)")
    parser.add_argument("--beside", default="push-indicator", metavar="NAME", help="the other one (push-indicator)")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--out", type=Path, help="write page and figures into this folder")
    options = parser.parse_args(arguments)
    try:
        make_folder(options.out)
        findings = find(read_folder(options.folder), options)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    print(markdown(findings))
    print("\n" + "\n".join(_sentences(findings)))
    if options.out is None:
        print("\nnext: --out FOLDER writes this with the figures")
    else:
        write_page(options.out, findings)
        print(f"\nwrote {options.out}; next: read {options.out / PAGE_FILE}")


if __name__ == "__main__":
    main()
