"""Measuring stick: every model's error and honesty on a table of pushes, recorded or simulated, of any objects.

    python -m benchmarks.real_pushes FOLDER [--out docs/results/real-pushes] [--models NAME ...] [--shapes NAME ...]

FOLDER holds pushes.csv and objects.csv, or both as Parquet (docs/data.md describes the columns). Scored are:

    nothing moves    the object stays where it is
    mechanics        quasi-static mechanics of the outline, nothing fitted (service/pushing/mechanics.py)
    simulation       ours, of the same pushes: mean and scatter of several draws (training/simulation/replay.py)
    NAME@VERSION     every published version of ours that can take the objects, through the client in this process:
                     models of any shape by outline, length and body, Omnipush's models by a view or none
    a peer           predictions that the table holds beside its outcomes: NAME_x_m, NAME_y_m, NAME_yaw_rad

Printed are mean and median errors with the interval of the mean, RMSE and NLL in published deviations, coverage of
intervals and joint regions, the worst object and surface, and how far pushes from the same start end apart. With
--out, a page with all of it per object and surface is written, with a plot and the figures. The rows of the table are
not copied.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from benchmarks.push_measures import repeats, score
from benchmarks.push_predictions import Predicted, choose, doubts, predicted_by_models, predicted_without_model
from benchmarks.real_pushes_page import (
    OVERALL,
    Findings,
    ModelScores,
    overall_table,
    repeats_text,
    worst_text,
    worth,
    write_page,
)
from service.client import ClientError
from service.errors import CazslError, DataError
from training.tables.push_table import PushTable
from training.tables.reading import read_table

DRAWS: Final = 8  # of the simulation
MOST_GROUPS: Final = 40  # pairs of an object and a surface that are scored by themselves


def groups_of(table: PushTable, notes: list[str]) -> dict[str, npt.NDArray[np.bool_]]:
    """Return the rows (n,) of all pushes, and of the objects on surfaces with the most pushes, by name.

    A sentence about those that are not listed is added to the notes.
    """
    found, group, counts = np.unique(
        np.stack([table.object_index, table.surface_index], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    if len(found) > MOST_GROUPS:
        notes.append(
            f"Of {len(found):,} pairs of object and surface, the {MOST_GROUPS} with the most pushes are listed."
        )
    largest = np.sort(np.argsort(-counts, kind="stable")[:MOST_GROUPS])
    names = {
        place: f"{table.objects[item].name}, {table.surfaces[surface]}"
        for place, (item, surface) in enumerate(found.tolist())
    }
    return {
        OVERALL: np.ones(table.count, dtype=np.bool_),
        **{names[place]: group.ravel() == place for place in largest.tolist()},
    }


def measured(table: PushTable, predicted: Predicted, groups: Mapping[str, npt.NDArray[np.bool_]]) -> ModelScores | None:
    """Return the scores of a model over the pushes of each group that it answers, or None without any."""
    scores = {}
    for name, group in groups.items():
        rows = group & predicted.rows
        if rows.any():
            covariance = None if predicted.covariance is None else predicted.covariance[rows]
            scores[name] = score(table.outcomes[rows], predicted.mean[rows], covariance)
    return ModelScores(predicted.name, predicted.knows, scores) if scores else None


def find(table: PushTable, options: argparse.Namespace) -> Findings:
    """Score the chosen models on a table.

    Raises:
        CazslError: the models cannot be read, or none of the chosen ones can be scored.
    """
    notes = doubts(table)
    models: list[ModelScores] = []
    named = set()

    def wanted(name: str) -> bool:
        """Return true for a chosen model, by its name with or without a version."""
        hits = {name, name.partition("@")[0]} & set(options.models)
        named.update(hits)
        return bool(hits) or not options.models

    found = list(predicted_without_model(table, wanted, options.draws))
    if not options.models or set(options.models) - named:
        found += predicted_by_models(table, options.models_folder, wanted, notes)
    if unknown := set(options.models) - named:
        raise DataError(f"--models: there is no {', '.join(sorted(unknown))}; leave the option out to see all")
    groups = groups_of(table, notes)
    for one in found:
        scores = measured(table, one, groups)
        notes += one.notes
        if scores is not None:
            models.append(scores)
    if not models:
        raise DataError(f"no model can be scored on this table: {' '.join(notes)}")
    source = options.source or table.source
    return Findings(table, source, command(options), models, notes, repeats(table))


def command(options: argparse.Namespace) -> str:
    """Return the command that made the findings, without the places of files."""
    parts = ["python -m benchmarks.real_pushes FOLDER"]
    for name, values in (("models", options.models), ("shapes", options.shapes)):
        parts += [f"--{name} {' '.join(values)}"] if values else []
    if options.draws != DRAWS:
        parts.append(f"--draws {options.draws}")
    if options.limit is not None:
        parts.append(f"--limit {options.limit}")
    return " ".join(parts)


def make_folder(folder: Path | None) -> None:
    """Make the folder of the page, if one is named, before the work begins.

    Raises:
        DataError: it cannot be made.
    """
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"--out: {folder} cannot be made ({error.strerror}); name a folder to write into") from error


def main(arguments: Sequence[str] | None = None) -> None:
    """Score, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.real_pushes",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="a table of pushes: a folder, or a file of pushes")
    parser.add_argument("--objects", type=Path, help="the file of outlines; by default beside the pushes")
    parser.add_argument("--out", type=Path, help="write page, plot and figures into this folder")
    parser.add_argument("--models", nargs="+", default=[], metavar="NAME", help="score these only, such as mechanics")
    parser.add_argument("--draws", type=int, default=DRAWS, metavar="N", help=f"simulations of every push ({DRAWS})")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--shapes", nargs="+", default=[], metavar="NAME", help="objects to score on; all by default")
    parser.add_argument("--limit", type=int, metavar="N", help="score on N pushes, drawn with a fixed seed")
    parser.add_argument("--source", default="", help="origin and credit of the pushes, as the page shall name them")
    options = parser.parse_args(arguments)
    if options.limit is not None and options.limit < 1:
        parser.error("--limit: a positive number of pushes")
    if options.draws < 2:
        parser.error("--draws: two or more, for a spread")
    try:
        make_folder(options.out)
        table = choose(read_table(options.folder, options.objects), options.shapes, options.limit)
        findings = find(table, options)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    print(overall_table(findings.models))
    for text in (
        *findings.notes,
        repeats_text(findings.repeats),
        worst_text(findings.models),
        worth(findings.models).replace("**", ""),
    ):
        if text:
            print(f"\n{text}")
    if options.out is None:
        print("\nnext: --out FOLDER writes this with every object and surface, a plot and the figures")
    else:
        write_page(options.out, findings)
        print(f"\nwrote {options.out}; next: read {options.out / 'README.md'}")


if __name__ == "__main__":
    main()
