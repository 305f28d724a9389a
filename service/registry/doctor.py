"""Diagnosis of a registry: its faults, each with a remedy. No file is changed."""

from collections.abc import Iterator

from service.errors import BrokenModelError, CazslError
from service.model.predictor import PredictorFactory
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.base import RegistryFinding


def examine(registry: Registry, load: PredictorFactory) -> Iterator[RegistryFinding]:
    """Yield the faults of a registry, model by model.

    Raises:
        RegistryError: the registry cannot be listed.
    """
    yield from registry.survey()
    for name in registry.names():
        try:
            yield from _examine_model(registry, load, name)
        except CazslError as error:
            yield RegistryFinding(name, str(error), "check the disk and its permissions, then run this command again")


def _examine_model(registry: Registry, load: PredictorFactory, name: str) -> Iterator[RegistryFinding]:
    state = registry.state(name)
    for version in sorted(state.versions):
        named = sorted(alias for alias, to in state.aliases.items() if to == version)
        try:
            load_version(registry, load, name, version)
        except CazslError as error:
            yield RegistryFinding(f"{name}/{version}", str(error), _remedy(error, name, version, named), severe=True)
    for alias, version in sorted(state.aliases.items()):
        if version not in state.versions:
            advice = f"point it at an existing version: cazsl models promote {name} VERSION --alias {alias}"
            yield RegistryFinding(f"{name}@{alias}", f"names version {version}, which does not exist", advice)
    if not state.versions:
        yield RegistryFinding(name, "has no version", "publish a version, or move the folder elsewhere", severe=False)
    history = registry.history(name)
    for number, problem in enumerate(history.problems, start=1):
        torn = history.torn_bytes > 0 and number == len(history.problems)
        advice = "the next change cuts it off" if torn else "compare it with a backup; new lines continue from its end"
        yield RegistryFinding(f"{name}/history", problem, advice, severe=not torn)
    for event in registry.unrecorded(name):
        change = f"{event.what} from {event.before} to {event.to} is not in the history"
        yield RegistryFinding(f"{name}/history", change, "the next change records it", severe=False)


def _remedy(error: CazslError, name: str, version: int, named: list[str]) -> str:
    remove = f"cazsl models remove {name}@{version}"
    if named:
        remove = f"point {', '.join(named)} elsewhere (cazsl models rollback {name}), then {remove}"
    if isinstance(error, BrokenModelError) and "signature" in str(error):
        return f"sign it (cazsl models sign {name}@{version} --key KEY), or {remove}"
    return f"restore its files from a backup or another registry (their digests are verified), or {remove}"
