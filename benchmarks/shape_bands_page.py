"""Page of the bands: tables per kind of band, a plot of coverage and errors, and the figures as JSON."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

import service
from benchmarks.push_bands import EDGES, FAMILY, SPREAD
from benchmarks.push_measures import Score
from service.storage.disk import replace_whole

PAGE_FILE, FIGURES_FILE, PLOT_FILE = "README.md", "figures.json", "bands.png"
FEWEST: Final = 300  # pushes of a band that counts in the summary: its coverage is known within 3.4 points
COVERAGE: Final = (0.87, 0.93)  # that 90 % intervals shall have in every band
SEEN, HELD_OUT, GROUPS = "families seen", "families held out", "families"
JUDGED: Final = tuple(EDGES)[:-1]  # kinds of bands that count in the summary: all but the tip's
HOLD: Final = ("intervals", "regions")
_HEAD: Final = "knows | pushes | position (mm) | of the size (%) | yaw (deg) | RMSE | 90 % intervals | 90 % regions"
PAGE: Final = """# Bands of {version}

`{command}`

scores {version} on {pushes:,} pushes of {objects:,} objects that it did not learn from (digest {digest}...,
cazsl {code}).

Origin: {source}.

The version is asked with all that the table has of an object's body, and with the outline alone. Mechanics knows the
body, and nothing of it is fitted. Position and yaw are mean errors (median in brackets). RMSE is in units of the
published output deviations of Omnipush, as in every table of this project. Intervals are those of one coordinate,
regions hold all three at once. An honest model has 90 %. Bands are of the pushes that touch.

Half of the drawn objects carry a load that the outline does not show, and frictions and tips differ by a factor of six
and more. Asked with the outline alone, a model of any shape answers for an object without such a load, with the usual
friction and tip. The rows of the outline alone say how wrong that is here.

## Summary

{overall}

{summary}

![Coverage and error of every band]({plot})

{kinds}
"""


@dataclass(frozen=True)
class BandScore:
    """Measures of the pushes of a band, and the mean position error in percent of the objects' sizes."""

    score: Score
    of_size: float

    @property
    def coverage(self) -> float | None:
        """Share of outcomes inside the 90 % intervals."""
        return None if self.score.calibration is None else self.score.calibration.intervals[1]

    @property
    def regions(self) -> float | None:
        """Share of outcomes inside the 90 % regions."""
        return None if self.score.calibration is None else self.score.calibration.regions[1]


Bands = Mapping[str, Mapping[str, BandScore]]
"""Scores by band and by knowledge, or model."""


@dataclass(frozen=True)
class Findings:
    """Scores of a version on every kind of band."""

    version: str
    command: str
    source: str
    digest: str
    pushes: int
    objects: int
    kinds: Mapping[str, Bands]


def overall_table(findings: Findings, kind: str) -> str:
    """Return the table of a kind of bands, in Markdown."""
    lines = [f"| {kind} | {_HEAD} |", "|" + "---|" * 9]
    for band, scores in findings.kinds[kind].items():
        for name, found in scores.items():
            lines.append(f"| {band} | {name} | {_row(found)} |")
    return "\n".join(lines)


def summary(findings: Findings) -> dict[str, float]:
    """Return the figures that goals are held against, by name. Bands of fewer than 300 pushes do not count."""
    found: dict[str, float] = {}
    for name, score in findings.kinds[SPREAD]["touching"].items():
        short = name.replace(" ", "_")
        found[f"{short}.position_mm"] = score.score.position_mm.mean
        found[f"{short}.yaw_deg"] = score.score.yaw_deg.mean
        found[f"{short}.rmse"] = score.score.rmse
        groups = findings.kinds.get(GROUPS)
        if groups is not None:
            found[f"{short}.held_out_over_seen"] = groups[HELD_OUT][name].score.rmse / groups[SEEN][name].score.rmse
        if score.coverage is None or score.regions is None:
            continue
        found[f"{short}.intervals_90"], found[f"{short}.regions_90"] = score.coverage, score.regions
        for kind in HOLD:
            judged = [share for _, share in _judged(findings, name, kind)]
            if judged:
                found[f"{short}.lowest_{kind}_90"], found[f"{short}.highest_{kind}_90"] = min(judged), max(judged)
    return found


def write_page(folder: Path, findings: Findings) -> None:
    """Write page, plot and figures into a folder that exists."""
    _draw(folder / PLOT_FILE, findings)
    document = {**asdict(findings), "code_version": service.__version__, "summary": summary(findings)}
    rounded = json.loads(json.dumps(document), parse_float=lambda text: float(f"{float(text):.6g}"))
    replace_whole(folder / FIGURES_FILE, (json.dumps(rounded, indent=1) + "\n").encode())
    page = PAGE.format(
        version=findings.version,
        command=findings.command,
        pushes=findings.pushes,
        objects=findings.objects,
        digest=findings.digest[:8],
        code=service.__version__,
        source=findings.source.rstrip("."),
        overall=overall_table(findings, SPREAD),
        summary="\n".join(_sentences(findings)),
        plot=PLOT_FILE,
        kinds="\n\n".join(f"## {kind}\n\n{overall_table(findings, kind)}" for kind in findings.kinds if kind != SPREAD),
    )
    replace_whole(folder / PAGE_FILE, page.encode())


def _sentences(findings: Findings) -> Iterator[str]:
    """Yield the bands whose 90 % intervals hold least and most, and the ratio of families held out to those seen."""
    for name in findings.kinds[SPREAD]["touching"]:
        for kind in HOLD:
            judged = sorted(_judged(findings, name, kind), key=lambda item: item[1])
            if judged:
                outside = sum(not COVERAGE[0] <= share <= COVERAGE[1] for _, share in judged)
                yield (
                    f"- {name}: 90 % {kind} hold least in {judged[0][0]} ({100 * judged[0][1]:.1f} %) and most in "
                    f"{judged[-1][0]} ({100 * judged[-1][1]:.1f} %). {outside} of {len(judged)} bands are outside of "
                    "87 to 93 %."
                )
    groups = findings.kinds.get(GROUPS)
    if groups is not None:
        for name, held in groups[HELD_OUT].items():
            ratio = held.score.rmse / groups[SEEN][name].score.rmse
            yield f"- {name}: the RMSE on families held out is {ratio:.3f} times that on families seen."


def _judged(findings: Findings, name: str, kind: str) -> Iterator[tuple[str, float]]:
    """Yield bands of start, aim, length and size with enough pushes, and what 90 % intervals or regions hold."""
    for quantity in JUDGED:
        for band, scores in findings.kinds.get(quantity, {}).items():
            share = scores[name].coverage if kind == "intervals" else scores[name].regions
            if share is not None and scores[name].score.pushes >= FEWEST:
                yield f"{quantity.partition(' (')[0]} {band}", share


def _row(found: BandScore) -> str:
    score = found.score
    shares = ["-" if share is None else f"{100 * share:.1f} %" for share in (found.coverage, found.regions)]
    return (
        f"{score.pushes:,} | {score.position_mm.mean:.2f} ({score.position_mm.median:.2f}) | {found.of_size:.1f} "
        f"| {score.yaw_deg.mean:.2f} ({score.yaw_deg.median:.2f}) | {score.rmse:.3f} | {' | '.join(shares)}"
    )


def _draw(path: Path, findings: Findings) -> None:
    """Draw the coverage of every band, and its mean error in percent of the size."""
    kinds = [kind for kind in (*EDGES, FAMILY) if kind in findings.kinds]
    widths = [len(findings.kinds[kind]) + 1 for kind in kinds]
    figure = Figure(figsize=(0.34 * sum(widths) + 2, 7.5), dpi=80, layout="constrained")
    upper, lower = figure.subplots(2, len(kinds), squeeze=False, sharey="row", gridspec_kw={"width_ratios": widths})
    for kind, above, below in zip(kinds, upper, lower, strict=True):
        _draw_kind(above, below, kind, findings.kinds[kind])
    upper[0].set_ylabel("90 % intervals hold (%)")
    lower[0].set_ylabel("mean position error (% of size)")
    figure.legend(*lower[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize="small")
    figure.savefig(path, metadata={"Software": None})


def _draw_kind(above: Any, below: Any, kind: str, groups: Bands) -> None:
    above.axhspan(100 * COVERAGE[0], 100 * COVERAGE[1], color="tab:green", alpha=0.2, linewidth=0.0)
    names: Sequence[str] = list(next(iter(groups.values())))
    for number, name in enumerate(names):
        scores = [scores[name] for scores in groups.values()]
        covered = [np.nan if found.coverage is None else 100 * found.coverage for found in scores]
        above.plot(range(len(scores)), covered, "o", color=f"C{number}")
        below.plot(range(len(scores)), [found.of_size for found in scores], "o", color=f"C{number}", label=name)
    above.set_title(kind.replace(": ", ":\n").replace(" (", "\n("), fontsize=8)
    above.set_xticks([])
    below.set_xticks(range(len(groups)), list(groups), rotation=90, fontsize=8)
    below.set_ylim(bottom=0.0)
