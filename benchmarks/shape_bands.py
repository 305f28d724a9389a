"""Bands: error and honesty of a model of any shape, by start, aim, length, size, tip and family.

    cazsl-train simulate shapes --seed 1 --objects 960 --pushes 50 data/shapes-new
    python -m benchmarks.shape_bands data/shapes-new [--model push-shape] [--held-out FAMILY ...] [--out FOLDER]

The table is one of objects that the version never saw: simulated with another seed than its data, as above. The version
is asked twice, through the client in this process: with all that the table has of an object's body (centre of mass,
contact friction, radius of the tip), and with the outline alone. Quasi-static mechanics stands beside it. The families
that the version did not learn from are named with --held-out, and compared with the others.

Printed are the overall table and the worst bands. With --out, a page with every band, a plot and the figures is
written.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.push_bands import FAMILY, SPREAD, Features, Mask, bands, features
from benchmarks.push_measures import difference, score
from benchmarks.push_predictions import choose, quasi_static
from benchmarks.real_pushes import make_folder
from benchmarks.shape_bands_page import GROUPS, HELD_OUT, SEEN, BandScore, Findings, overall_table, summary, write_page
from benchmarks.shape_predictions import Knowledge, answering_version, ask_shapes, starts_outside
from service.client import Client, ClientError
from service.errors import CazslError, DataError
from service.pushing.poses import DoubleArray
from training.tables.push_table import PushTable
from training.tables.reading import read_table

MECHANICS: Final = "mechanics"

NAMES: Final = {Knowledge.BODY: "body known", Knowledge.OUTLINE: "outline alone"}


def predictions(
    client: Client, version: str, table: PushTable
) -> Iterator[tuple[str, DoubleArray, DoubleArray | None]]:
    """Yield names, means (n, 3) and deviations (n, 3) of the version, asked with each knowledge, and of mechanics."""
    rows = np.arange(table.count)
    for knowledge, name in NAMES.items():
        yield name, *ask_shapes(client, version, table, rows, knowledge)
    yield MECHANICS, quasi_static(table), None


def scored(table: PushTable, found: Features, rows: Mask, mean: DoubleArray, std: DoubleArray | None) -> BandScore:
    """Score some pushes, in mm and degrees, and in shares of the objects' sizes."""
    covariance = None if std is None else np.einsum("ni,ij->nij", std[rows] ** 2, np.eye(3))
    error = difference(table.outcomes[rows], mean[rows])
    shares = np.hypot(error[:, 0], error[:, 1]) / found.size_m[rows]
    return BandScore(score(table.outcomes[rows], mean[rows], covariance), float(100.0 * shares.mean()))


def find(table: PushTable, options: argparse.Namespace) -> Findings:
    """Score a version on every band of a table.

    Raises:
        CazslError, ClientError: the version cannot be asked.
        DataError: a held-out family is not in the table.
    """
    table = table.select(starts_outside(table))
    found = features(table)
    kinds = bands(table, found)
    held = _held_out(table, options.held_out)
    if held is not None:
        kinds[GROUPS] = {SEEN: found.touches & ~held, HELD_OUT: found.touches & held}
    scores: dict[str, dict[str, dict[str, BandScore]]] = {kind: {name: {} for name in kinds[kind]} for kind in kinds}
    with Client.local(str(options.models_folder)) as client:
        version = answering_version(client, options.model)
        for name, mean, std in predictions(client, version, table):
            for kind, groups in kinds.items():
                for band, rows in groups.items():
                    scores[kind][band][name] = scored(table, found, rows, mean, std)
    command = "python -m benchmarks.shape_bands TABLE" + "".join(
        [f" --model {options.model}", *([f" --held-out {' '.join(options.held_out)}"] if options.held_out else [])]
    )
    return Findings(version, command, table.source, table.digest, table.count, len(table.objects), scores)


def _held_out(table: PushTable, names: Sequence[str]) -> Mask | None:
    """Return (n,) true for the pushes of held-out families, or None without any."""
    if not names:
        return None
    family = table.labels.get(FAMILY)
    known = () if family is None else family.values
    if family is None or not set(names) <= set(known) or set(names) >= set(known):
        raise DataError(f"--held-out: name some of the table's families, not all of them: {', '.join(known)}")
    return np.isin(family.index, [known.index(name) for name in names])


def main(arguments: Sequence[str] | None = None) -> None:
    """Score, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shape_bands",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="TABLE", help="a table of pushes of objects with outlines")
    parser.add_argument("--model", default="push-shape", metavar="NAME", help="name or name@version (push-shape)")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="FAMILY", help="families that it did not learn")
    parser.add_argument("--limit", type=int, metavar="N", help="score on N pushes, drawn with a fixed seed")
    parser.add_argument("--out", type=Path, help="write page, plot and figures into this folder")
    options = parser.parse_args(arguments)
    if options.limit is not None and options.limit < 1:
        parser.error("--limit: a positive number of pushes")
    try:
        make_folder(options.out)
        findings = find(choose(read_table(options.folder), (), options.limit), options)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    print(overall_table(findings, SPREAD))
    print("\n" + "\n".join(f"{name}: {value:.3g}" for name, value in summary(findings).items()))
    if options.out is None:
        print("\nnext: --out FOLDER writes this with every band, a plot and the figures")
    else:
        write_page(options.out, findings)
        print(f"\nwrote {options.out}; next: read {options.out / 'README.md'}")


if __name__ == "__main__":
    main()
