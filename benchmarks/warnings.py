"""Warnings inside and outside of the domains of the champions: share that is caught, and share of false alarms.

    python -m benchmarks.warnings [--count 1000] [--pictures 100] [--model NAME ...] [--out docs/results/warnings]

Queries are drawn (``benchmarks.warning_queries``, ``benchmarks.warning_pictures``) and asked through the client in this
process. Those inside are held-out pushes and objects like those of training: any code that is not due is a false alarm.
Those outside have one fault each, and are caught if one of the codes that are due comes with the answer, or if the
request is refused. No data is needed.
"""

import argparse
import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from tqdm import tqdm

import service
from benchmarks.http_load import ROOT
from benchmarks.real_pushes import make_folder
from benchmarks.shape_predictions import answering_version
from benchmarks.warning_pictures import photograph_queries, view_queries
from benchmarks.warning_queries import (
    Queries,
    faulty_omnipush,
    faulty_pushes,
    faulty_shapes,
    inside_queries,
    omnipush_pushes,
    shape_pushes,
)
from benchmarks.warnings_page import page
from service.client import Client, ClientError, ProblemError
from service.errors import CazslError
from service.pushing.poses import PUSH_LENGTH_M
from service.storage.disk import replace_whole
from service.validity.codes import WarningCode

REFUSED: Final = "refused"
PAGE_FILE, FIGURES_FILE = "README.md", "figures.json"
_CODE: Final = re.compile(r"image_\w+")
_PUSHES_AT_ONCE: Final = 400  # of a request: outlines of their objects stay within its limit of lists
_VALIDITY_SINCE: Final = 3  # format of the manifest
Codes = list[set[str]]
"""Codes of the warnings of each query, or ``REFUSED``."""


@dataclass(frozen=True)
class Found:
    """Result of queries of one kind.

    Attributes:
        model: version that was asked, as ``name@version``.
        name: of the kind.
        due: codes of which one is due.
        inside: whether the version vouches for these queries.
        count: of queries.
        caught: queries with a code that is due, or that were refused.
        refused: queries that were refused.
        codes: queries by code.
    """

    model: str
    name: str
    due: tuple[str, ...]
    inside: bool
    count: int
    caught: int
    refused: int
    codes: dict[str, int]


def asked(client: Client, model: str, queries: Queries) -> Codes:
    """Ask a version, and return the codes of each query."""
    if queries.pictures:
        return [_of_picture(client, model, queries, number) for number in range(len(queries.pictures))]
    found: Codes = []
    for begin in range(0, len(queries.pushers), _PUSHES_AT_ONCE):
        rows = np.arange(begin, min(begin + _PUSHES_AT_ONCE, len(queries.pushers)))
        try:
            found += _of_batch(client, model, queries, rows)
        except ProblemError:
            for row in rows.tolist():
                found += _of_row(client, model, queries, row)
    return found


def _of_batch(client: Client, model: str, queries: Queries, rows: np.ndarray) -> Codes:
    """Ask some pushes in one request.

    Raises:
        ProblemError: it is refused.
    """
    pushers = queries.pushers[rows]
    lengths = None if (pushers[:, 3] == PUSH_LENGTH_M).all() else pushers[:, 3]
    contexts, index = None, None
    if queries.index is not None:
        used, index = np.unique(queries.index[rows], return_inverse=True)
        contexts = [queries.contexts[number] for number in used.tolist()]
    answer = client.predict_batch(pushers[:, :3], contexts, index, model=model, lengths=lengths)
    codes: Codes = [set() for _ in rows]
    for warning in answer.warnings:
        for row in warning.rows:
            codes[row].add(warning.code)
    return codes


def _of_row(client: Client, model: str, queries: Queries, row: int) -> Codes:
    try:
        return _of_batch(client, model, queries, np.array([row]))
    except ProblemError as error:
        return [_refusal(error)]


def _of_picture(client: Client, model: str, queries: Queries, number: int) -> set[str]:
    push = queries.pushers[number]
    try:
        if queries.scales_m:
            answer = client.predict_image(
                queries.pictures[number],
                [push[:3]],
                model=model,
                lengths=float(push[3]),
                metres_per_pixel=queries.scales_m[number],
            )
        else:
            answer = client.predict_image(queries.pictures[number], [push[:3]], model=model)
    except ProblemError as error:
        return _refusal(error)
    return {warning.code for warning in answer.warnings}


def _refusal(error: ProblemError) -> set[str]:
    return {REFUSED, *(code for code in _CODE.findall(str(error)) if code in set(WarningCode))}


def counted(model: str, queries: Queries, codes: Codes) -> Found:
    """Count the codes of queries of one kind."""
    due = {*queries.due, REFUSED} if queries.due else set()
    kinds = sorted(set().union(*codes) - {REFUSED}) if codes else []
    return Found(
        model,
        queries.name,
        tuple(code.value for code in queries.due),
        queries.inside,
        len(codes),
        sum(bool(of_one & due) for of_one in codes),
        sum(REFUSED in of_one for of_one in codes),
        {kind: sum(kind in of_one for of_one in codes) for kind in kinds},
    )


def queries_of(kind: str, count: int, pictures: int, seed: int, has_domain: bool) -> Iterator[Queries]:
    """Yield all queries for a model with some kind of context.

    Args:
        kind: of context.
        count: of pushes of each kind of query.
        pictures: of each kind of picture.
        seed: of all draws.
        has_domain: whether the version has a domain of its own. Others have learnt a ring of starts.
    """
    rng = np.random.default_rng([seed, *kind.encode()])
    knows_object = kind != "none"
    if kind == "shape":
        pushed = shape_pushes(count, rng)
        yield from inside_queries(pushed, knows_object)
        yield from faulty_pushes(pushed, rng, knows_object)
        yield from faulty_shapes(count, rng)
        yield from photograph_queries(pictures, rng)
        return
    pushed = omnipush_pushes(kind, count, rng, not has_domain)
    yield from inside_queries(pushed, knows_object)
    yield from faulty_pushes(pushed, rng, knows_object)
    yield from faulty_omnipush(pushed, kind, rng)
    if kind == "visual":
        yield from inside_queries(
            omnipush_pushes(kind, count, rng, not has_domain, camera=True), True, ", camera views"
        )
        yield from view_queries(pictures, rng)


def summary(found: Iterable[Found]) -> list[dict[str, Any]]:
    """Return shares by code and model: of queries outside that are caught, and of queries inside with a false alarm."""
    rows = []
    everything = list(found)
    for model in dict.fromkeys(one.model for one in everything):
        of_model = [one for one in everything if one.model == model]
        for code in [code.value for code in WarningCode]:
            outside = [one for one in of_model if one.due[:1] == (code,)]
            inside = [one for one in of_model if one.inside and code not in one.due]
            many, free = sum(one.count for one in outside), sum(one.count for one in inside)
            if not many:
                continue
            rows.append(
                {
                    "code": code,
                    "model": model,
                    "outside": many,
                    "caught": 100.0 * sum(one.caught for one in outside) / many,
                    "inside": free,
                    "false_alarms": 100.0 * sum(one.codes.get(code, 0) for one in inside) / max(1, free),
                }
            )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Ask the models, print the shares, and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.warnings", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=1000, help="pushes of each kind (1000)")
    parser.add_argument("--pictures", type=int, default=100, help="pictures of each kind (100)")
    parser.add_argument("--seed", type=int, default=24, help="of all draws (24)")
    parser.add_argument("--models", type=Path, default=ROOT / "models", help="folder of the registry (models)")
    parser.add_argument("--model", action="append", help="name, or name@version; may be repeated (every champion)")
    parser.add_argument("--out", type=Path, help="write page and figures into this folder")
    options = parser.parse_args(arguments)
    found: list[Found] = []
    try:
        make_folder(options.out)
        with Client.local(str(options.models)) as client:
            names = options.model or [model.name for model in client.list_models().models]
            for name in names:
                version = answering_version(client, name)
                found += _of_version(client, version, options)
    except (CazslError, ClientError) as error:
        sys.exit(f"error: {error}")
    rows = summary(found)
    figures = {
        "command": f"python -m benchmarks.warnings --count {options.count} --pictures {options.pictures}",
        "code_version": service.__version__,
        "seed": options.seed,
        "least_caught": min(row["caught"] for row in rows),
        "most_false_alarms": max(row["false_alarms"] for row in rows),
        "by_code": rows,
        "kinds": [asdict(one) for one in found],
    }
    text = page(figures)
    print(text)
    if options.out is not None:
        replace_whole(options.out / FIGURES_FILE, (json.dumps(figures, indent=1) + "\n").encode())
        replace_whole(options.out / PAGE_FILE, text.encode())
        print(f"wrote {options.out}")


def _of_version(client: Client, version: str, options: argparse.Namespace) -> list[Found]:
    name, _, number = version.partition("@")
    kind = client.show_model(name).context_kind
    has_domain = client.show_version(name, int(number)).manifest["format"] >= _VALIDITY_SINCE
    found = []
    with tqdm(desc=version, unit="kind", disable=None) as bar:
        for queries in queries_of(kind, options.count, options.pictures, options.seed, has_domain):
            found.append(counted(version, queries, asked(client, version, queries)))
            bar.update()
    return found


if __name__ == "__main__":
    main()
