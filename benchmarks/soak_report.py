"""Report of a soak test: a table over time, a plot, the figures, and the losses."""

import json
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

REPORT_FILE = "README.md"
RECORD_FILE = "record.jsonl"
FIGURES_FILE = "figures.json"
PLOT_FILE = "soak.png"
TENTHS = 10
TABLE = {
    "capacity, two instances behind nginx": "{capacity_per_s:.0f} requests/s",
    "asked at; reached": "{rate_per_s:.0f} requests/s ({load:.0%}); {reached_per_s:.0f} ({reached_load:.0%})",
    "requests; failed": "{requests:,}; **{requests_failed}**",
    "p50; p99; the worst slice's p99": "{p50_ms:.2f} ms; {p99_ms:.1f} ms; {worst_slice_p99_ms:.0f} ms",
    "memory of the instance that lived, first tenth; last": "{first_tenth_mib:.1f} MiB; {last_tenth_mib:.1f} MiB",
    "that is a growth of; accepted": "**{grown_mib:+.1f} MiB**; {growth_bound_mib:g} MiB",
    "swaps": "{swaps}",
    "from a promote to an instance's first answer, at most": "{longest_to_reach_s:.2f} s",
    "the instances disagreed for at most": "{longest_apart_s:.2f} s; they look every {poll_interval_s:g} s",
    "SIGTERMs; not ended with 0": "{sigterms}; {ends_without_0}",
    "away for at most, its drain included": "{longest_away_s:.1f} s",
    'checks of `/readyz` with a prediction; "ready" without an answer': "{checks}; {ready_without_an_answer}",
    "hostile requests and connections; status 500 or more": "{hostile_requests:,}; {hostile_server_errors}",
    "requests that nginx sent to the second instance": "{sent_twice}",
    "errors in the instances' logs": "{log_errors}",
}
COMMAND = "python -m benchmarks.soak --minutes {minutes:g} --load {load:g} --swap-every-s {swap_every_s:g}"
REPORT = """# Soak

`{command}` on {started} UTC: two instances, nginx, wrk, a
publisher and hostile clients on {processors} processors, Python {python}, cazsl {version}.
It lasted {lasted_minutes:g} minutes. {verdict}

| | |
|---|---|
{table}

A version counts as there with the first answer that names it, asked ten times a second. Latencies are wrk's, seen
through nginx, and those of all that shares the processors. The instance that is restarted refuses while it is away.

## Over time

| minutes | requests/s | failed | p50 (ms) | p99 (ms) | memory (MiB) | of the restarted one | files | threads | swaps |
|---|---|---|---|---|---|---|---|---|---|
{over_time}

![Memory, latency, and requests over time]({plot})

## What hostile clients got

| | |
|---|---|
{outcomes}
"""
Row = dict[str, Any]


class SoakRecord:
    """A record of a soak test, by kind of line."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._rows: dict[str, list[Row]] = {}
        for row in rows:
            self._rows.setdefault(row["kind"], []).append(row)
        self.run = self.all("run")[0]
        self.began_s = float(self.run["at_s"])
        self.lasted_s = max(row["at_s"] for kind in ("slice", "sample") for row in self.all(kind)) - self.began_s

    def all(self, kind: str) -> list[Row]:
        """Return every line of a kind, in order."""
        return self._rows.get(kind, [])

    def minute(self, row: Row) -> float:
        """Return the time of a line, in minutes from the beginning of the load."""
        return float(row["at_s"] - self.began_s) / 60

    def during(self, tenth: int, kind: str) -> list[Row]:
        """Return the lines of a kind in one tenth of the time."""
        return [row for row in self.all(kind) if self._tenth(row) == tenth]

    def _tenth(self, row: Row) -> int:
        middle_s = row["at_s"] - self.began_s - row.get("took_s", 0.0) / 2
        return min(TENTHS - 1, int(middle_s / self.lasted_s * TENTHS))

    def total(self, kind: str, field: str) -> float:
        """Return the sum of a field over all lines of a kind."""
        return float(sum(row[field] for row in self.all(kind)))

    def of_instances(self, rows: Sequence[Row], place: int, field: str) -> list[float]:
        """Return one figure of one instance for the lines in which it ran."""
        return [row["instances"][place][field] for row in rows if row["instances"][place] is not None]

    def rss_mib(self, tenth: int) -> float:
        """Return the median memory of the instance that lives, in MiB."""
        return _median(self.of_instances(self.during(tenth, "sample"), 0, "rss_mib"))

    def each(self, field: str) -> list[float]:
        """Return the times of a field over all promotions, in s."""
        return [value for row in self.all("promote") for value in row[field]]

    def outcomes(self) -> Counter[str]:
        """Return the outcomes of the hostile clients."""
        return Counter(self.all("hostile")[-1]["outcomes"] if self.all("hostile") else {})

    def wrong_readiness(self) -> int:
        """Count the checks in which an instance was ready but did not predict."""
        checks = self.all("check")
        return sum(
            ready == 200 and version is None
            for check in checks
            for ready, version in zip(check["ready"], check["versions"], strict=True)
        )

    def figures(self) -> Row:
        """Return all figures of the report."""
        outcomes, slices, ends = self.outcomes(), self.all("slice"), self.all("end")
        log = self.all("log")[-1] if self.all("log") else {}
        reached_per_s = self.total("slice", "requests") / self.total("slice", "took_s")
        first_mib, last_mib = self.rss_mib(0), self.rss_mib(TENTHS - 1)
        return {
            **{name: value for name, value in self.run.items() if name not in ("kind", "at_s")},
            "lasted_minutes": round(self.lasted_s / 60, 1),
            "requests": int(self.total("slice", "requests")),
            "requests_failed": int(self.total("slice", "failed")),
            "reached_per_s": reached_per_s,
            "reached_load": reached_per_s / self.run["capacity_per_s"],
            "p50_ms": _median(row["p50_ms"] for row in slices),
            "p99_ms": _median(row["p99_ms"] for row in slices),
            "worst_slice_p99_ms": max(row["p99_ms"] for row in slices),
            "swaps": len(self.all("promote")),
            "longest_to_reach_s": max(self.each("reached_s"), default=0.0),
            "longest_apart_s": max(self.each("apart_s"), default=0.0),
            "sigterms": len(ends),
            "ends_without_0": sum(row["status"] != 0 for row in ends),
            "longest_away_s": max((row["end_s"] + row["start_s"] for row in ends), default=0.0),
            "checks": len(self.all("check")),
            "ready_without_an_answer": self.wrong_readiness(),
            "first_tenth_mib": first_mib,
            "last_tenth_mib": last_mib,
            "grown_mib": last_mib - first_mib,
            "hostile": dict(sorted(outcomes.items())),
            "hostile_requests": sum(count for text, count in outcomes.items() if not text.startswith("unexpected")),
            "hostile_server_errors": sum(count for text, count in outcomes.items() if _is_server_error(text)),
            "log_errors": log.get("errors", "not read"),
            "log_lines": log.get("log_lines", "not read"),
            "sent_twice": log.get("sent_twice", "not read"),
        }


def write_report(folder: Path) -> list[str]:
    """Write table, plot and figures beside the record. Return the losses, a line each."""
    lines = (folder / RECORD_FILE).read_text(encoding="utf-8").splitlines()
    rows = [json.loads(line) for line in lines]
    if not {"run", "slice", "sample"} <= {row["kind"] for row in rows}:
        return ["the run ended before the first measurement"]
    record = SoakRecord(rows)
    figures = record.figures()
    losses = _losses(figures)
    (folder / FIGURES_FILE).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    (folder / REPORT_FILE).write_text(_text(record, figures, losses), encoding="utf-8")
    _draw(record, folder / PLOT_FILE)
    return losses


def _losses(figures: Row) -> list[str]:
    """Return a sentence for each loss."""
    grown, bound = figures["grown_mib"], figures["growth_bound_mib"]
    faults = {
        "requests failed": figures["requests_failed"],
        "SIGTERMs did not end with 0": figures["ends_without_0"],
        "times an instance said that it was ready and did not answer": figures["ready_without_an_answer"],
        "hostile requests got a status of 500 or more": figures["hostile_server_errors"],
    }
    if figures["log_errors"] != "not read":
        faults["errors are in the instances' logs"] = figures["log_errors"]
    found = [f"{count} {words}" for words, count in faults.items() if count]
    if grown > bound:
        found.append(f"memory grew by {grown:.1f} MiB; accepted is at most {bound:g} MiB")
    return found


def _text(record: SoakRecord, figures: Row, losses: Sequence[str]) -> str:
    """Return the text of the report."""
    outcomes = record.outcomes()
    return REPORT.format(
        **figures,
        command=COMMAND.format(**figures) + f" --end-every-s {figures['end_every_s']:g}",
        verdict=f"**Lost: {'; '.join(losses)}.**" if losses else "Nothing was lost.",
        table="\n".join(f"| {words} | {cell.format(**figures)} |" for words, cell in TABLE.items()),
        over_time=_over_time(record),
        outcomes="\n".join(f"| {outcome} | {count} |" for outcome, count in sorted(outcomes.items())),
        plot=PLOT_FILE,
    )


def _over_time(record: SoakRecord) -> str:
    """Return a row of medians per tenth of the time."""
    rows = []
    for tenth in range(TENTHS):
        slices, samples = record.during(tenth, "slice"), record.during(tenth, "sample")
        first, last = (record.lasted_s / 60 * part / TENTHS for part in (tenth, tenth + 1))
        rate = sum(row["requests"] for row in slices) / max(1e-9, sum(row["took_s"] for row in slices))
        cells = [
            f"{first:.1f} to {last:.1f}",
            f"{rate:.0f}",
            f"{sum(row['failed'] for row in slices)}",
            f"{_median(row['p50_ms'] for row in slices):.2f}",
            f"{_median(row['p99_ms'] for row in slices):.1f}",
            f"{record.rss_mib(tenth):.1f}",
            f"{_median(record.of_instances(samples, 1, 'rss_mib')):.1f}",
            f"{_median(record.of_instances(samples, 0, 'files')):.0f}",
            f"{_median(record.of_instances(samples, 0, 'threads')):.0f}",
            f"{len(record.during(tenth, 'promote'))}",
        ]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def _draw(record: SoakRecord, path: Path) -> None:
    """Draw memory, latency and requests over time, one under the other."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    memory, latency, requests = figure.subplots(3, sharex=True)
    for place, name in enumerate(("lives the whole time", "ended by SIGTERM and started again")):
        rows = [row for row in record.all("sample") if row["instances"][place] is not None]
        memory.plot(_minutes(record, rows), record.of_instances(rows, place, "rss_mib"), label=name)
    memory.set(ylabel="memory (MiB)", ylim=(0, None))
    memory.legend(loc="lower right")
    slices = record.all("slice")
    latency.plot(_minutes(record, slices), [row["p99_ms"] for row in slices], label="99th percentile")
    latency.plot(_minutes(record, slices), [row["p50_ms"] for row in slices], label="median")
    latency.set(ylabel="latency (ms)", yscale="log")
    latency.legend(loc="upper right")
    requests.plot(_minutes(record, slices), [row["requests"] / row["took_s"] for row in slices], label="answered")
    requests.plot(_minutes(record, slices), [row["failed"] / row["took_s"] for row in slices], label="failed")
    requests.set(ylabel="requests/s", xlabel="minutes", ylim=(0, None))
    requests.legend(loc="center right")
    figure.savefig(path, dpi=100)


def _minutes(record: SoakRecord, rows: Sequence[Row]) -> list[float]:
    return [record.minute(row) for row in rows]


def _median(values: Iterable[float]) -> float:
    """Return the median of the values, or NaN without values."""
    found = list(values)
    return float(statistics.median(found)) if found else float("nan")


def _is_server_error(outcome: str) -> bool:
    """True if an outcome, such as "attack 400", is a status of 500 or more."""
    return outcome.split()[1].startswith("5")
