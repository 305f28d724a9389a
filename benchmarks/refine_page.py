"""Page of refinement: tables by the number of pushes, a plot, and the figures as JSON."""

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

import service
from benchmarks.refine_measures import FAR, POOL, REPLACED, Measured
from service.storage.disk import replace_whole
from training.tables.push_table import PushTable

PAGE_FILE: Final = "README.md"
FIGURES_FILE: Final = "figures.json"
PLOT_FILE: Final = "errors.png"
PAGE: Final = """# What a few pushes tell of an object

`{command}` asks {model} about {pushes:,} pushes of {objects} objects on {surfaces} (digest {digest}..., cazsl
{version}), before and after k of them went through [`POST /v1/contexts/refine`](../../planning.md#refine-a-context).

{source}\
A group is one object on one surface, {groups} in all. {repeats} times each, the order of its pushes is drawn. The first
{pool} are the pool, k of them are told, and every push outside of the pool is predicted: mean distance in mm, and mean
absolute turn in degrees. k = 0 is the model before any push. The model never saw these objects. That pressure is
refined, and about how wide it spreads, was chosen with recorded pushes in view ([log](../../log.md)). The likelihood
and the prior of the centre of mass were chosen on simulated ones.

## Recorded pushes

{learners}

{summary}

![Mean errors by the number of pushes]({plot})

The mechanics is that of `service/pushing/mechanics.py`, with the centre of mass, the contact friction and the moment
arm fitted to the same pushes (robust least squares with priors, `benchmarks/refine_learners.py`). The meta-learner
knows no outline and was fitted to objects of Omnipush, so that these are outside of its domain.

## Wrong outcomes

Each told outcome is replaced with a chance of {replaced:.0%}: by an object that did not move, a random pose, or the
outcome of another push.

{outliers}

## A centre of mass far off the centroid

{simulated} new objects, simulated (`training/simulation`), with a centre of mass {near:g} to {far:g} sizes from the
centroid (the size is the root mean square distance of the area from it), and 50 mm pushes from everywhere. No context
states the centre of mass. *even* presses evenly on the plate, *any* stands on a few points or on rim and middle, drawn
for each object as for a plate that is not known. The last row states the true centre of mass and friction, but no
pressure. What is left
there is mostly the scatter of pushes, which no context tells.

{loaded}

## Groups

Mean errors in mm and degrees after k pushes.

{by_group}
"""


@dataclass(frozen=True)
class Findings:
    """Measures of all learners, by their names and by the number of pushes."""

    table: PushTable
    source: str
    command: str
    model: str
    groups: Sequence[str]
    repeats: int
    learners: Mapping[str, Mapping[int, Measured]]
    outliers: Mapping[int, Measured]
    loaded: Mapping[str, tuple[Mapping[int, Measured], Measured]]
    objects: int


def learner_table(found: Findings) -> str:
    """Return the table of all learners by the number of pushes, in Markdown."""
    names = list(found.learners)
    first = found.learners[names[0]]
    head = [f"| k | {' | '.join(names)} | 90 % regions of the first |", "|" + "---|" * (len(names) + 2)]
    rows = [
        f"| {k} | {' | '.join(_pair(found.learners[name].get(k)) for name in names)} | {_percent(first[k].region)} |"
        for k in first
    ]
    return "\n".join(head + rows)


def outlier_table(found: Findings) -> str:
    """Return the table of wrong outcomes, in Markdown."""
    first = next(iter(found.learners.values()))
    head = ["| k | all outcomes right | a fifth wrong | wrong ones named | right ones named |", "|" + "---|" * 5]
    rows = [
        f"| {k} | {_pair(first.get(k))} | {_pair(one)} | {_percent(one.found)} | {_percent(one.false)} |"
        for k, one in found.outliers.items()
    ]
    return "\n".join(head + rows)


def loaded_table(found: Findings) -> str:
    """Return the table of simulated objects with a centre of mass far off, in Markdown."""
    names = list(found.loaded)
    counts = list(next(iter(found.loaded.values()))[0])
    head = ["| k | " + " | ".join(f"{name} | of k = 0 | 90 % regions" for name in names) + " |"]
    head.append("|" + "---|" * (1 + 3 * len(names)))
    rows = []
    for k in (*counts, None):
        cells = []
        for name in names:
            by_count, truth = found.loaded[name]
            one, before = truth if k is None else by_count[k], by_count[0]
            shares = one.position_mm / before.position_mm, one.yaw_deg / before.yaw_deg
            cells += [_pair(one), f"{shares[0]:.2f}, {shares[1]:.2f}", _percent(one.region)]
        rows.append(f"| {'body known' if k is None else k} | {' | '.join(cells)} |")
    return "\n".join(head + rows)


def summary(found: Findings) -> str:
    """Return sentences about the first learner: the worst k beside none, and the worst group after 10 pushes."""
    name, first = next(iter(found.learners.items()))
    before = first[0]
    shares = {
        k: max(one.position_mm / before.position_mm, one.yaw_deg / before.yaw_deg) for k, one in first.items() if k
    }
    worst = max(shares, key=lambda k: shares[k])
    texts = [
        f"Worst beside no push is k = {worst}: the larger of both errors is {100.0 * shares[worst]:.1f} % of that "
        f"before ({name})."
    ]
    if 10 in first:
        after = first[10].groups
        ratios = [one[0] / other[0] for one, other in zip(after, before.groups, strict=True)]
        place = max(range(len(ratios)), key=lambda number: ratios[number])
        texts.append(
            f"After 10 pushes, {sum(ratio < 1.0 for ratio in ratios)} of {len(ratios)} groups have a smaller position "
            f"error than before, and the worst is {found.groups[place]} with {100.0 * ratios[place]:.0f} %."
        )
    return textwrap.fill(" ".join(texts), 120)


def write_page(folder: Path, found: Findings) -> None:
    """Write page, plot and figures into a folder that exists."""
    _draw(folder / PLOT_FILE, found)
    replace_whole(folder / FIGURES_FILE, (json.dumps(_figures(found), indent=1) + "\n").encode())
    replace_whole(folder / PAGE_FILE, _page(found).encode())


def _page(found: Findings) -> str:
    table = found.table
    page = PAGE.format(
        command=found.command,
        model=found.model,
        pushes=table.count,
        objects=len(table.objects),
        surfaces=" and ".join(table.surfaces),
        digest=table.digest[:8],
        version=service.__version__,
        source=f"Origin: {found.source.rstrip('.')}.\n\n" if found.source else "",
        groups=len(found.groups),
        repeats=found.repeats,
        pool=POOL,
        learners=learner_table(found),
        summary=summary(found),
        plot=PLOT_FILE,
        replaced=REPLACED,
        outliers=outlier_table(found),
        simulated=found.objects,
        near=FAR[0],
        far=FAR[1],
        loaded=loaded_table(found),
        by_group=_group_table(found),
    )
    blocks = page.rstrip().split("\n\n")
    return "\n\n".join(block if block[0] in "|#!" else textwrap.fill(block, 120) for block in blocks) + "\n"


def _group_table(found: Findings) -> str:
    first = next(iter(found.learners.values()))
    counts = [k for k in (0, 1, 3, 10, 50) if k in first]
    head = ["| object, surface | " + " | ".join(f"k = {k}" for k in counts) + " |", "|" + "---|" * (len(counts) + 1)]
    rows = [
        f"| {name} | " + " | ".join("{:.2f}, {:.2f}".format(*first[k].groups[place]) for k in counts) + " |"
        for place, name in enumerate(found.groups)
    ]
    return "\n".join(head + rows)


def _pair(one: Measured | None) -> str:
    return "-" if one is None else f"{one.position_mm:.2f}, {one.yaw_deg:.2f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f} %"


def _figures(found: Findings) -> dict[str, Any]:
    """Return all figures, rounded to 6 digits."""
    document = {
        "command": found.command,
        "source": found.source,
        "digest": found.table.digest,
        "code_version": service.__version__,
        "model": found.model,
        "groups": list(found.groups),
        "repeats": found.repeats,
        "learners": {name: _by_count(by_count) for name, by_count in found.learners.items()},
        "outliers": _by_count(found.outliers),
        "loaded": {
            name: {"by_count": _by_count(by_count), "body_known": asdict(truth)}
            for name, (by_count, truth) in found.loaded.items()
        },
    }
    rounded: dict[str, Any] = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.6g}"))
    return rounded


def _by_count(measured: Mapping[int, Measured]) -> dict[int, dict[str, Any]]:
    return {k: asdict(one) for k, one in measured.items()}


def _draw(path: Path, found: Findings) -> None:
    """Draw the errors of every learner by the number of pushes."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    for axes, name, label in zip(
        figure.subplots(1, 2), ("position_mm", "yaw_deg"), ("position error (mm)", "yaw error (degrees)"), strict=True
    ):
        for learner, by_count in found.learners.items():
            axes.plot(list(by_count), [getattr(one, name) for one in by_count.values()], "o-", ms=3, label=learner)
        first = next(iter(found.learners.values()))
        wrong = {0: first[0], **found.outliers}
        axes.plot(list(wrong), [getattr(one, name) for one in wrong.values()], "x--", label="refined, a fifth wrong")
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set_xticks([0, 1, 2, 5, 10, 20, 50], ["0", "1", "2", "5", "10", "20", "50"])
        axes.set(xlabel="pushes told", ylabel=f"mean {label}")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=90)
