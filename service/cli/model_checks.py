"""``cazsl models``: commands that judge a registry as its service does, by the settings, every check and the gates."""

import sys
from typing import Any, Final

import click

from service.cli.command_line import argument, errors_as_one_line, json_option, registry_option
from service.cli.models import load_reference, state_or_fault
from service.cli.registries import open_as_served
from service.cli.terminal import FAILED, REFUSED, echo, print_json
from service.errors import CazslError, UnknownModelError
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.registry.doctor import examine
from service.registry.promotion import is_forced, judge, refusals
from service.registry.registry import Registry
from service.storage.base import RegistryFinding


@click.command("verify")
@argument("reference", required=False)
@json_option
@registry_option
@errors_as_one_line
def verify(reference: str | None, as_json: bool, registry: str) -> None:
    """Verify digests, signature, graph, tensors, self-check and gates of one version, or of all.

    Versions are judged by the settings of the service, such as CAZSL_REQUIRE_SIGNATURE. Exit status 1 if one is broken,
    3 if gates refuse REFERENCE, or a version that an alias names and whose promotion was not forced.
    """
    store = open_as_served(registry)
    states = {} if reference else {name: state_or_fault(store, name) for name in store.names()}
    references = [reference] if reference else [f"{n}@{v}" for n in states for v in sorted(states[n].versions)]
    found = [
        _broken(f"{name}{'/' * bool(place)}{place}", cause)
        for name, state in states.items()
        for place, cause in state.faults.items()
    ]
    found += [_verified(store, each) for each in references]
    if as_json:
        print_json(found)
    else:
        for line in found:
            _print_verified(line)
    if not all(line["ok"] for line in found):
        sys.exit(FAILED)
    if any(line["refused"] and (reference or _is_served(store, line["reference"])) for line in found):
        sys.exit(REFUSED)


def _verified(registry: Registry, reference: str) -> dict[str, Any]:
    """Return whether a version is whole, the reason if it is not, and the gates that refuse it."""
    try:
        model = load_reference(registry, reference)
        refused = refusals(judge(model, None, registry.domain))
        name = f"{model.manifest.name}@{model.manifest.version}"
        return {"reference": name, "ok": True, "detail": None, "refused": refused or None}
    except UnknownModelError:
        raise
    except CazslError as error:
        return _broken(reference, str(error))


def _broken(reference: str, cause: str) -> dict[str, Any]:
    return {"reference": reference, "ok": False, "detail": cause, "refused": None}


def _print_verified(line: dict[str, Any]) -> None:
    if not line["ok"]:
        echo(f"{line['reference']}  BROKEN  {line['detail']}", err=True)
        return
    echo(f"{line['reference']}  ok" + (f", but gates refuse it: {line['refused']}" if line["refused"] else ""))


def _is_served(registry: Registry, reference: str) -> bool:
    """Return whether an alias names a version, and was not forced to."""
    parsed = ModelReference.parse(reference, "reference")
    history = registry.history(parsed.name)
    return any(
        version == parsed.version and not is_forced(history, alias, version)
        for alias, version in registry.aliases(parsed.name).items()
    )


@click.command("doctor")
@json_option
@registry_option
@errors_as_one_line
def doctor(as_json: bool, registry: str) -> None:
    """List the faults of the registry, each with its remedy. Exit status 1 if predictions suffer.

    Versions are judged by the settings of the service, such as CAZSL_REQUIRE_SIGNATURE, and by the gates.
    """
    found = list(examine(open_as_served(registry), OnnxPredictor))
    if as_json:
        print_json([vars(finding) for finding in found])
    else:
        for finding in found:
            _print_finding(finding)
        if not found:
            echo("no faults found")
    if any(finding.severe for finding in found):
        sys.exit(FAILED)


def _print_finding(finding: RegistryFinding) -> None:
    echo(f"{'BROKEN' if finding.severe else 'note  '}  {finding.where}: {finding.wrong}")
    echo(f"        -> {finding.advice}")


CHECKS: Final = (verify, doctor)
