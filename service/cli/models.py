"""``cazsl models``: list, compare and inspect the models of a registry."""

import itertools
import json
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, time
from typing import Any

import click

from service.cli.command_line import HELP, argument, errors_as_one_line, json_option, option, registry_option
from service.cli.registries import open_unsigned
from service.cli.terminal import FAILED, echo, echo_lines, print_json
from service.errors import CazslError, UnknownModelError
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.reference import DEFAULT_ALIAS, ModelReference
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.history import Event, ModelState
from service.validity.domains import RING, is_published_without


@click.group(context_settings=HELP)
def models() -> None:
    """Inspect and change the registry.

    \b
    cazsl models list                                       all models, versions and aliases
    cazsl models diff NAME@champion NAME@4                  figures, recipe and data side by side
    cazsl models promote NAME 4 --reason "new data"         run the gates, then make it the champion
    cazsl models rollback NAME --reason "robots complain"   back to the previous champion
    cazsl models doctor                                     faults, each with its remedy

    Exit status: 0 done, 1 failed or broken, 2 wrong command line, 3 refused by a gate, 4 changed by another writer or
    in use, 5 no such model, version or alias.
    """


def load_reference(registry: Registry, reference: str) -> LoadedModel:
    """Load and verify the version that a reference names.

    Raises:
        CazslError: there is no such version, or it is broken.
    """
    parsed = ModelReference.parse(reference, "reference")
    return load_version(registry, OnnxPredictor, parsed.name, registry.resolve(parsed))


@models.command("list")
@json_option
@registry_option
@errors_as_one_line
def list_models(registry: str, as_json: bool) -> None:
    """List every model with its versions and aliases. Exit status 1 if a part cannot be read; the rest is listed."""
    store = open_unsigned(registry)
    states = {name: state_or_fault(store, name) for name in store.names()}
    if as_json:
        print_json(
            [
                {"name": name, "versions": sorted(state.versions), "aliases": dict(sorted(state.aliases.items()))}
                | ({"faults": dict(state.faults)} if state.faults else {})
                for name, state in states.items()
            ]
        )
    else:
        _print_states(states)
    if any(state.faults for state in states.values()):
        sys.exit(FAILED)


def state_or_fault(store: Registry, name: str) -> ModelState:
    """Return the state of a model. One that cannot be read has the cause as its only content."""
    try:
        return store.state(name)
    except CazslError as error:
        return ModelState(faults={"": str(error)})


def _print_states(states: Mapping[str, ModelState]) -> None:
    for name, state in states.items():
        aliases = ", ".join(f"{alias} -> {version}" for alias, version in sorted(state.aliases.items())) or "no alias"
        echo(f"{name}  versions {', '.join(map(str, sorted(state.versions))) or 'none'}  {aliases}")
        for place, cause in state.faults.items():
            echo(f"BROKEN  {name}{'/' * bool(place)}{place}: {cause}", err=True)
    if not states:
        echo("the registry has no models; train and publish one with: make train")


@models.command("show")
@argument("reference")
@json_option
@registry_option
@errors_as_one_line
def show(reference: str, as_json: bool, registry: str) -> None:
    """Print the card of a version, or its manifest with --json. REFERENCE is NAME, NAME@ALIAS or NAME@VERSION.

    Below the card of a version that was published before cards named a domain is a note of it.
    """
    store, parsed = open_unsigned(registry), ModelReference.parse(reference, "reference")
    version = store.read(parsed.name, store.resolve(parsed))
    if as_json:
        print_json(json.loads(version.manifest.render()))
    else:
        echo_lines(version.card)
        if is_published_without(version.manifest):
            echo_lines(f"## Domain\n\nNot in the card, which never changes: this version vouches for {RING.note}.")


@models.command("diff")
@argument("first")
@argument("second")
@option("--all", "everything", is_flag=True, help="List equal fields too.")
@json_option
@registry_option
@errors_as_one_line
def diff(first: str, second: str, everything: bool, as_json: bool, registry: str) -> None:
    """Compare metrics, calibration, recipe, data and preprocessing of two versions."""
    store = open_unsigned(registry)
    sides = []
    for reference in (first, second):
        parsed = ModelReference.parse(reference, "reference")
        sides.append(_figures(store.read(parsed.name, store.resolve(parsed)).manifest))
    rows = [(key, sides[0].get(key), sides[1].get(key)) for key in sorted(sides[0].keys() | sides[1].keys())]
    rows = [row for row in rows if everything or row[1] != row[2]]
    if as_json:
        print_json([{"field": key, "first": before, "second": after} for key, before, after in rows])
        return
    if not rows:
        echo("no difference")
    width = max((len(key) for key, *_ in rows), default=0)
    for key, before, after in rows:
        echo(f"{key:<{width}}  {_text(before):>24}  {_text(after):>24}  {_change(before, after)}".rstrip())


def _figures(manifest: Manifest) -> dict[str, Any]:
    """Return the comparable fields under flat names: without tensors, self-check and digests of files."""
    document = json.loads(manifest.render())
    kept = ("method", "context_kind", "code_version", "created", "recipe", "data", "metrics", "calibration")
    return dict(_flat({key: document[key] for key in (*kept, "normalisation", "image_convention")}, ""))


def _flat(value: Any, prefix: str) -> Sequence[tuple[str, Any]]:
    if isinstance(value, dict):
        return list(
            itertools.chain.from_iterable(
                _flat(part, f"{prefix}.{key}" if prefix else key) for key, part in value.items()
            )
        )
    return [(prefix, value)]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return "[" + " ".join(map(_text, value)) + "]"
    return "-" if value is None else str(value)


def _change(before: Any, after: Any) -> str:
    numbers = isinstance(before, int | float) and isinstance(after, int | float)
    return f"{(after - before) / abs(before):+.1%}" if numbers and before not in (0, after) else ""


@models.command("history")
@argument("name")
@json_option
@registry_option
@errors_as_one_line
def history(name: str, as_json: bool, registry: str) -> None:
    """List every publish, alias move and removal of a model. Exit status 1 if the chain of digests is broken."""
    store = open_unsigned(registry)
    found, unrecorded = store.history(name), store.unrecorded(name)
    if as_json:
        print_json(
            {
                "events": [event.as_document() for event in found.events],
                "unrecorded": [event.as_document() for event in unrecorded],
                "problems": list(found.problems),
            }
        )
    else:
        for event in found.events:
            echo(f"{event.time}  {event.who:<12}  {_event_text(event)}")
        for event in unrecorded:
            echo(f"not recorded yet: {_event_text(event)}")
        for problem in found.problems:
            echo(f"PROBLEM  {problem}", err=True)
    if found.problems:
        sys.exit(FAILED)


def _event_text(event: Event) -> str:
    moved = [str(version) for version in (event.before, event.to) if version is not None]
    if event.alias is not None and event.to is None:
        moved.append("none")
    return f"{event.what} {' -> '.join(moved)}".rstrip() + (f"  ({event.reason})" if event.reason else "")


@models.command("at")
@argument("reference", metavar="NAME@ALIAS")
@argument("when")
@json_option
@registry_option
@errors_as_one_line
def at(reference: str, when: str, as_json: bool, registry: str) -> None:
    """Print the version that an alias named at WHEN: a day (its end) or a time, in ISO 8601, UTC by default."""
    parsed = ModelReference.parse(reference, "reference")
    moment = _moment(when)
    alias = parsed.alias or DEFAULT_ALIAS
    version = open_unsigned(registry).alias_at(parsed.name, alias, moment)
    if version is None:
        raise UnknownModelError(
            f"{parsed.name}@{alias} named no version at {moment.isoformat()}; see `cazsl models history {parsed.name}`"
        )
    if as_json:
        print_json({"name": parsed.name, "alias": alias, "at": moment.isoformat(), "version": version})
    else:
        echo(f"{parsed.name}@{version}")


def _moment(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise click.BadParameter(
            "expected a day or a time in ISO 8601, such as 2026-11-01 or 2026-11-01T14:03"
        ) from error
    if len(text) <= len("2026-11-01"):
        found = datetime.combine(found, time.max)
    return found if found.tzinfo else found.replace(tzinfo=UTC)
