"""Refinement: what k pushes of an object are worth, on recorded pushes and in the simulation.

    python -m benchmarks.refine FOLDER [--out docs/results/refine] [--repeats 3]

FOLDER holds a table of pushes of any objects (docs/data.md describes the columns). The served model of any shape is
asked before any push, and with the context that ``client.refine`` returns after k of them, through the client in this
process. Beside it stand mechanics with four parameters fitted to the same pushes, and the meta-learner with them as its
support, if it is published. Then a fifth of the outcomes is replaced by wrong ones, and last, new objects with a centre
of mass far off their centroid are simulated.

Printed are mean errors by k, and how far k pushes are worse than none in the worst case. With --out, a page with them,
a plot and the figures are written. The rows of the table are not copied.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmarks.push_predictions import choose
from benchmarks.real_pushes import make_folder
from benchmarks.refine_learners import (
    FittedMechanics,
    Learner,
    MetaLearner,
    RefinedShape,
    all_of_one_length,
    knows_meta_learner,
)
from benchmarks.refine_measures import Group, Measured, groups_of, loaded_groups, measure
from benchmarks.refine_page import Findings, learner_table, loaded_table, outlier_table, summary, write_page
from benchmarks.shape_predictions import answering_version
from service.client import Client, ClientError
from service.errors import CazslError, DataError
from training.tables.push_table import PushTable
from training.tables.reading import read_table

COUNTS: Final = (0, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 50)
FEW_COUNTS: Final = (0, 1, 3, 5, 10, 20, 50)  # of learners that take long, and of the rest
REFINED: Final = "push-shape, refined"
MECHANICS: Final = "mechanics, 4 parameters fitted"
META: Final = "push-anp, pushes as its support"
PRESSURES: Final[Mapping[str, str | None]] = {"even": "even", "any": None}


def find(table: PushTable, options: argparse.Namespace) -> Findings:
    """Measure all learners.

    Raises:
        CazslError: the models cannot be read, or the table has too few pushes of every object.
    """
    groups = groups_of(table)
    if not groups:
        raise DataError("no object has 100 pushes on one surface that start outside of it; give a larger table")
    with Client.local(str(options.models_folder)) as client:
        model = answering_version(client, "push-shape")
        refined, repeats = RefinedShape(client, model), options.repeats

        def by_count(learner: Learner, of: Sequence[Group], counts: Sequence[int], wrong: bool) -> dict[int, Measured]:
            """Return the measures by k."""
            return {k: measure(learner, of, k, repeats, options.seed, wrong) for k in counts if k or not wrong}

        learners: dict[str, dict[int, Measured]] = {REFINED: by_count(refined, groups, COUNTS, False)}
        learners[MECHANICS] = by_count(FittedMechanics(), groups, FEW_COUNTS, False)
        if knows_meta_learner(client) and all(all_of_one_length(group.pushes) for group in groups):
            learners[META] = by_count(MetaLearner(client, "push-anp"), groups, FEW_COUNTS, False)
        outliers = by_count(refined, groups, FEW_COUNTS, True)
        loaded = {
            name: _loaded(client, model, loaded_groups(options.objects, pressure, options.seed), by_count)
            for name, pressure in PRESSURES.items()
        }
    return Findings(
        table=table,
        source=options.source or table.source,
        command=_command(options),
        model=model,
        groups=[group.name for group in groups],
        repeats=repeats,
        learners=learners,
        outliers=outliers,
        loaded=loaded,
        objects=options.objects,
    )


def _loaded(
    client: Client,
    model: str,
    groups: Sequence[Group],
    by_count: Callable[[Learner, Sequence[Group], Sequence[int], bool], dict[int, Measured]],
) -> tuple[dict[int, Measured], Measured]:
    """Return the measures by k of loaded objects, and those of a context that states their true body."""
    known = [by_count(RefinedShape(client, model, _truth(group)), [group], (0,), False)[0] for group in groups]
    position, yaw = (sum(getattr(each, name) for each in known) / len(known) for name in ("position_mm", "yaw_deg"))
    region = sum(each.region or 0.0 for each in known) / len(known)
    truth = Measured(position, yaw, tuple(each.groups[0] for each in known), region)
    return by_count(RefinedShape(client, model), groups, FEW_COUNTS, False), truth


def _truth(group: Group) -> dict[str, object]:
    return {"centre_of_mass": list(group.centre_of_mass_m or ()), "friction": group.friction}


def _command(options: argparse.Namespace) -> str:
    """Return the command that made the findings, without the places of files."""
    parts = ["python -m benchmarks.refine FOLDER"]
    for name, usual in (("repeats", REPEATS), ("objects", OBJECTS), ("seed", 0), ("limit", None)):
        value = getattr(options, name)
        parts += [f"--{name} {value}"] if value != usual else []
    return " ".join(parts)


REPEATS: Final = 3
OBJECTS: Final = 15


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.refine", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="a table of pushes: a folder, or a file of pushes")
    parser.add_argument("--outlines", type=Path, help="the file of outlines; by default beside the pushes")
    parser.add_argument("--out", type=Path, help="write page, plot and figures into this folder")
    parser.add_argument("--repeats", type=int, default=REPEATS, metavar="N", help=f"supports per group ({REPEATS})")
    parser.add_argument("--objects", type=int, default=OBJECTS, metavar="N", help=f"simulated objects ({OBJECTS})")
    parser.add_argument("--seed", type=int, default=0, help="of supports and simulated objects")
    parser.add_argument("--limit", type=int, metavar="N", help="take N pushes of the table, drawn with a fixed seed")
    parser.add_argument("--models-folder", type=Path, default=Path("models"), help="registry of published models")
    parser.add_argument("--source", default="", help="origin and credit of the pushes, as the page shall name them")
    options = parser.parse_args(arguments)
    if min(options.repeats, options.objects) < 1:
        parser.error("--repeats and --objects: positive numbers")
    try:
        make_folder(options.out)
        table = choose(read_table(options.folder, options.outlines), [], options.limit)
        findings = find(table, options)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    for text in (learner_table(findings), outlier_table(findings), loaded_table(findings), summary(findings)):
        print(f"{text}\n")
    if options.out is None:
        print("next: --out FOLDER writes this with every object and surface, a plot and the figures")
    else:
        write_page(options.out, findings)
        print(f"wrote {options.out}; next: read {options.out / 'README.md'}")


if __name__ == "__main__":
    main()
