"""``cazsl models``: commands that change a registry."""

import sys
from pathlib import Path
from typing import Final

import click

from service.cli.command_line import (
    FILE_THAT_EXISTS,
    argument,
    errors_as_one_line,
    json_option,
    option,
    registry_option,
)
from service.cli.registries import open_as_served, open_unsigned
from service.cli.terminal import REFUSED, confirm, echo, print_json
from service.errors import RegistryError
from service.model.domain import Verdict
from service.model.predictor import OnnxPredictor
from service.model.reference import DEFAULT_ALIAS, ModelReference
from service.registry import promotion
from service.registry.registry import Registry
from service.storage.history import Event

alias_option = option("--alias", default=DEFAULT_ALIAS, show_default=True, help="Alias to move.")
reason_option = option("--reason", help="Reason, kept in the history.")
yes_option = option("--yes", is_flag=True, help="Do not ask.")


@click.command("promote")
@argument("name")
@argument("version", type=click.IntRange(min=1))
@alias_option
@reason_option
@option(
    "--expect",
    type=click.IntRange(min=0),
    help="Move only if the alias names this version. 0: only if there is no such alias.",
)
@option("--force", is_flag=True, help="Move even if a gate refuses. Needs --reason.")
@json_option
@registry_option
@errors_as_one_line
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
    """Run the gates on a version, then point an alias at it. Exit status 3 if a gate refuses.

    Gates: the version passes verification and self-check. No contact means no motion. A turned object gives the turned
    answer. The angle is continuous at pi. Held-out NLL and coverage are not worse than those of the version that the
    alias names now.
    """
    if force and not reason:
        raise click.UsageError("--force needs --reason, which is kept in the history")
    found = promotion.promote(
        open_as_served(registry), OnnxPredictor, name, version, alias, reason=reason, expect=expect, force=force
    )
    _report(name, alias, found, "--force --reason TEXT", as_json)


def _report(name: str, alias: str, found: promotion.Promotion, force: str, as_json: bool) -> None:
    """Print the outcome of a promotion or a rollback, and exit with its status."""
    if as_json:
        document = {"moved": found.event is not None, "gates": [vars(verdict) for verdict in found.verdicts]}
        print_json(document if found.event is None else {**document, "event": found.event.as_document()})
    else:
        _print_promotion(name, alias, found, force)
    if found.event is None:
        sys.exit(REFUSED)


def _print_promotion(name: str, alias: str, found: promotion.Promotion, force: str) -> None:
    for verdict in found.verdicts:
        echo(_verdict_text(verdict))
    if found.event is not None:
        _print_move(name, found.event)
        return
    gates = ", ".join(verdict.gate for verdict in found.refused)
    echo(f"refused by {gates}; {name}@{alias} stays. To move it anyway: {force}", err=True)


def _verdict_text(verdict: Verdict) -> str:
    sign = "ok    " if verdict.passed else "REFUSE"
    return f"{sign}  {verdict.gate:<12} {verdict.figure:8.4f}  ({verdict.meaning})"


def _print_move(name: str, event: Event) -> None:
    echo(f"{name}@{event.alias}: {event.before or 'none'} -> {event.to}; running services switch at their next poll")


@click.command("rollback")
@argument("name")
@alias_option
@reason_option
@yes_option
@json_option
@registry_option
@errors_as_one_line
def rollback(name: str, alias: str, reason: str | None, yes: bool, as_json: bool, registry: str) -> None:
    """Run the gates on the previous version of an alias, then point it back at that version.

    If a gate refuses, a terminal is asked, and a script needs --yes. Without it the alias stays (exit status 3).
    """
    store = open_as_served(registry)
    found = promotion.roll_back(store, OnnxPredictor, name, alias, reason=reason, force=yes)
    if found.event is None and sys.stdin.isatty():
        question = f"gates refuse version {found.version}: {promotion.refusals(found.refused)}. Go back to it?"
        if confirm(question):
            found = promotion.roll_back(store, OnnxPredictor, name, alias, reason=reason, expect=found.seen, force=True)
    _report(name, alias, found, "--yes", as_json)


@click.command("remove")
@argument("reference", metavar="NAME@VERSION|NAME@ALIAS")
@reason_option
@yes_option
@json_option
@registry_option
@errors_as_one_line
def remove(reference: str, reason: str | None, yes: bool, as_json: bool, registry: str) -> None:
    """Remove a version for good, or drop an alias. A version that an alias names cannot be removed.

    A terminal is asked first. A script is not.
    """
    if "@" not in reference:
        raise click.BadParameter("expected NAME@VERSION or NAME@ALIAS", param_hint="reference")
    store, parsed = open_unsigned(registry), ModelReference.parse(reference, "reference")
    kind = "version, for good" if parsed.version is not None else "alias"
    _ask_first(f"Remove {parsed} ({kind})?", yes)
    if parsed.version is not None:
        event = store.remove(parsed.name, parsed.version, reason=reason)
    else:
        event = store.drop_alias(parsed.name, str(parsed.alias), reason=reason)
    if as_json:
        print_json({"event": event.as_document()})
    else:
        echo(f"{parsed} is removed" + ("; its number is not used again" if parsed.version else ""))


def _ask_first(question: str, yes: bool) -> None:
    """Ask on a terminal before something is lost. A script decided when it was written."""
    if not yes and sys.stdin.isatty() and not confirm(question):
        raise click.Abort


@click.command("prune")
@argument("name")
@option("--keep", type=click.IntRange(min=1), required=True, help="Number of newest versions to keep.")
@option("--dry-run", is_flag=True, help="Print the versions that would be removed, and keep them.")
@reason_option
@yes_option
@json_option
@registry_option
@errors_as_one_line
def prune(name: str, keep: int, dry_run: bool, reason: str | None, yes: bool, as_json: bool, registry: str) -> None:
    """Remove old versions. The newest ones, and those that an alias names, are kept. A terminal is asked first."""
    store = open_unsigned(registry)
    state = store.state(name)
    old = sorted(set(sorted(state.versions)[:-keep]) - set(state.aliases.values()))
    if old and not dry_run:
        _ask_first(f"Remove {len(old)} versions of {name} for good ({', '.join(map(str, old))})?", yes)
        for version in old:
            store.remove(name, version, reason=reason or f"pruned, keeping {keep}")
    if as_json:
        print_json({"removed": [] if dry_run else old, "would_remove": old if dry_run else []})
    else:
        echo(f"{'would remove' if dry_run else 'removed'}: {', '.join(map(str, old)) or 'none'}")


@click.command("sign")
@argument("reference")
@option(
    "--key",
    type=FILE_THAT_EXISTS,
    required=True,
    help="Private key in PEM format.",
)
@json_option
@registry_option
@errors_as_one_line
def sign(reference: str, key: Path, as_json: bool, registry: str) -> None:
    """Verify a version and sign it with an elliptic-curve key. The version itself does not change.

    \b
    openssl ecparam -name prime256v1 -genkey -noout -out private.pem
    openssl ec -in private.pem -pubout -out public.pem
    CAZSL_REQUIRE_SIGNATURE=public.pem cazsl serve
    """
    try:
        from service.registry.signing import sign as sign_files
    except ImportError as error:
        raise RegistryError("signatures need the extra 'signing': pip install 'cazsl[signing]'") from error
    store, parsed = open_unsigned(registry), ModelReference.parse(reference, "reference")
    version = store.resolve(parsed)
    store.sign(parsed.name, version, sign_files(store.read(parsed.name, version).files, key))
    if as_json:
        print_json({"name": parsed.name, "version": version})
    else:
        echo(f"{parsed.name}@{version} is signed")


@click.command("push")
@argument("reference")
@argument("destination")
@json_option
@registry_option
@errors_as_one_line
def push(reference: str, destination: str, as_json: bool, registry: str) -> None:
    """Copy a version with its number to another registry. It is verified at both ends."""
    _copy(open_unsigned(registry), open_unsigned(destination), reference, as_json)


@click.command("pull")
@argument("reference")
@argument("source")
@json_option
@registry_option
@errors_as_one_line
def pull(reference: str, source: str, as_json: bool, registry: str) -> None:
    """Copy a version with its number from another registry. It is verified at both ends."""
    _copy(open_unsigned(source), open_unsigned(registry), reference, as_json)


def _copy(source: Registry, destination: Registry, reference: str, as_json: bool) -> None:
    parsed = ModelReference.parse(reference, "reference")
    version = source.resolve(parsed)
    destination.copy(source, parsed.name, version)
    if as_json:
        print_json({"name": parsed.name, "version": version})
    else:
        echo(f"{parsed.name}@{version} is copied, byte for byte; no alias was moved")


CHANGES: Final = (promote, rollback, remove, prune, sign, push, pull)
