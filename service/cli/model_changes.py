"""``cazsl models``: the commands that change a registry."""

import sys
from pathlib import Path
from typing import Final

import click

from service.cli.terminal import REFUSED, json_option, mend, registry_option, say
from service.errors import CazslError, RegistryError, UnknownModelError
from service.model.loaded_model import LoadedModel
from service.model.predictor import OnnxPredictor
from service.model.reference import DEFAULT_ALIAS, ModelReference
from service.pushing.gates import Verdict
from service.registry.loading import load_version
from service.registry.location import open_registry
from service.registry.promotion import judge
from service.registry.registry import NOWHERE, Registry
from service.storage.history import Event, History

alias_option = click.option("--alias", default=DEFAULT_ALIAS, show_default=True, help="The alias to move.")
reason_option = click.option("--reason", help="Why; kept in the history.")


@click.command("promote")
@click.argument("name")
@click.argument("version", type=click.IntRange(min=1))
@alias_option
@reason_option
@click.option("--expect", type=click.IntRange(min=0), help="Move only if the alias names this version; 0: nothing yet.")
@click.option("--force", is_flag=True, help="Move although gates refuse; needs --reason.")
@json_option
@registry_option
@mend
def promote(
    name: str,
    version: int,
    alias: str,
    reason: str | None,
    expect: int | None,
    force: bool,
    as_json: bool,
    registry: str,
) -> None:
    """Run the gates on a version, then point an alias at it; exit status 3 where a gate refuses.

    Gates: verification and self-check; no contact means no motion; a turned object gives the turned answer; the angle
    is continuous at pi; held-out NLL and coverage are not worse than those of the version that the alias names now.
    """
    if force and not reason:
        raise click.UsageError("--force needs --reason: the history keeps why")
    store = open_registry(registry)
    store.resolve(ModelReference(name, None, version))
    current = store.aliases(name).get(alias)
    candidate = load_version(store, OnnxPredictor, name, version)
    verdicts = judge(candidate, _champion(store, name, current))
    refused = [verdict for verdict in verdicts if not verdict.passed]
    if not as_json:
        for verdict in verdicts:
            click.echo(_line(verdict))
    if refused and not force:
        if as_json:
            say({"moved": False, "gates": [vars(verdict) for verdict in verdicts]})
        else:
            gates = ", ".join(verdict.gate for verdict in refused)
            click.echo(
                f"refused by {gates}; {name}@{alias} stays. Move it all the same with --force --reason TEXT", err=True
            )
        sys.exit(REFUSED)
    if refused:
        reason = f"{reason} (forced past {', '.join(f'{v.gate} {v.figure:.3g} > {v.limit:.3g}' for v in refused)})"
    seen = expect if expect is not None else (current or NOWHERE)
    event = store.point_alias(name, alias, version, expect=seen, reason=reason)
    if as_json:
        say({"moved": True, "gates": [vars(verdict) for verdict in verdicts], "event": event.as_document()})
    else:
        _done(name, event)


def _champion(store: Registry, name: str, version: int | None) -> LoadedModel | None:
    """Whom the candidate is measured against; one that does not load is no standard."""
    try:
        return None if version is None else load_version(store, OnnxPredictor, name, version)
    except CazslError:
        return None


def _line(verdict: Verdict) -> str:
    sign = "ok    " if verdict.passed else "REFUSE"
    return f"{sign}  {verdict.gate:<12} {verdict.figure:8.4f}  ({verdict.meaning})"


def _done(name: str, event: Event) -> None:
    click.echo(
        f"{name}@{event.alias}: {event.before or 'nothing'} -> {event.to}; running services follow at their next look"
    )


@click.command("rollback")
@click.argument("name")
@alias_option
@reason_option
@json_option
@registry_option
@mend
def rollback(name: str, alias: str, reason: str | None, as_json: bool, registry: str) -> None:
    """Point an alias back at what it named before; the version is verified, the gates are not asked."""
    store = open_registry(registry)
    state = store.state(name)
    current = state.aliases.get(alias)
    before = _before(store.history(name), alias, current, state.versions)
    if current is None or before is None:
        raise UnknownModelError(f"{name}@{alias} named no other version before that is still there")
    event = store.point_alias(
        name, alias, before, expect=current, reason=f"rollback: {reason}" if reason else "rollback"
    )
    if as_json:
        say({"moved": True, "event": event.as_document()})
    else:
        _done(name, event)


def _before(history: History, alias: str, current: int | None, versions: frozenset[int]) -> int | None:
    """The last version that the alias named and that is neither the current one nor gone."""
    named = [event.to for event in history.events if event.alias == alias and event.to is not None]
    return next((version for version in reversed(named) if version != current and version in versions), None)


@click.command("remove")
@click.argument("reference", metavar="NAME@VERSION|NAME@ALIAS")
@reason_option
@json_option
@registry_option
@mend
def remove(reference: str, reason: str | None, as_json: bool, registry: str) -> None:
    """Remove a version for ever, or take an alias away; what an alias names cannot be removed."""
    if "@" not in reference:
        raise click.BadParameter("say which: NAME@VERSION or NAME@ALIAS", param_hint="reference")
    store, parsed = open_registry(registry), ModelReference.parse(reference, "reference")
    if parsed.version is not None:
        event = store.remove(parsed.name, parsed.version, reason=reason)
    else:
        event = store.drop_alias(parsed.name, str(parsed.alias), reason=reason)
    if as_json:
        say({"event": event.as_document()})
    else:
        click.echo(f"{parsed} is removed" + ("; its number is not given again" if parsed.version else ""))


@click.command("prune")
@click.argument("name")
@click.option("--keep", type=click.IntRange(min=1), required=True, help="How many of the newest versions stay.")
@click.option("--dry-run", is_flag=True, help="Only say what would go.")
@reason_option
@json_option
@registry_option
@mend
def prune(name: str, keep: int, dry_run: bool, reason: str | None, as_json: bool, registry: str) -> None:
    """Remove old versions: all but the newest and those that an alias names."""
    store = open_registry(registry)
    state = store.state(name)
    old = sorted(set(sorted(state.versions)[:-keep]) - set(state.aliases.values()))
    if not dry_run:
        for version in old:
            store.remove(name, version, reason=reason or f"pruned, keeping {keep}")
    if as_json:
        say({"removed": [] if dry_run else old, "would_remove": old if dry_run else []})
    else:
        click.echo(f"{'would remove' if dry_run else 'removed'}: {', '.join(map(str, old)) or 'nothing'}")


@click.command("sign")
@click.argument("reference")
@click.option(
    "--key", type=click.Path(exists=True, dir_okay=False, path_type=Path), required=True, help="Private key, PEM."
)
@json_option
@registry_option
@mend
def sign(reference: str, key: Path, as_json: bool, registry: str) -> None:
    """Sign a version that verifies with an elliptic-curve key; the version itself does not change.

    \b
    openssl ecparam -name prime256v1 -genkey -noout -out private.pem
    openssl ec -in private.pem -pubout -out public.pem
    CAZSL_REQUIRE_SIGNATURE=public.pem cazsl serve
    """
    try:
        from service.registry.signing import sign as sign_files
    except ImportError as error:
        raise RegistryError("signatures need the extra 'signing': pip install 'cazsl[signing]'") from error
    store, parsed = open_registry(registry), ModelReference.parse(reference, "reference")
    version = store.resolve(parsed)
    store.sign(parsed.name, version, sign_files(store.read(parsed.name, version).files, key))
    if as_json:
        say({"name": parsed.name, "version": version})
    else:
        click.echo(f"{parsed.name}@{version} is signed")


@click.command("push")
@click.argument("reference")
@click.argument("destination")
@json_option
@registry_option
@mend
def push(reference: str, destination: str, as_json: bool, registry: str) -> None:
    """Copy a version, number and all, into another registry; verified at both ends."""
    _copy(open_registry(registry), open_registry(destination), reference, as_json)


@click.command("pull")
@click.argument("reference")
@click.argument("source")
@json_option
@registry_option
@mend
def pull(reference: str, source: str, as_json: bool, registry: str) -> None:
    """Copy a version, number and all, from another registry; verified at both ends."""
    _copy(open_registry(source), open_registry(registry), reference, as_json)


def _copy(source: Registry, destination: Registry, reference: str, as_json: bool) -> None:
    parsed = ModelReference.parse(reference, "reference")
    version = source.resolve(parsed)
    destination.copy(source, parsed.name, version)
    if as_json:
        say({"name": parsed.name, "version": version})
    else:
        click.echo(f"{parsed.name}@{version} is there, byte for byte; no alias moved")


CHANGES: Final = (promote, rollback, remove, prune, sign, push, pull)
