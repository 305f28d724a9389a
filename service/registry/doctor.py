"""What is wrong with a registry, and what to do about each thing; looks only."""

from collections.abc import Iterator

from service.errors import BrokenModelError, CazslError
from service.model.loaded_model import PredictorFactory
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.base import RegistryFinding


def examine(registry: Registry, load: PredictorFactory) -> Iterator[RegistryFinding]:
    """Every finding, folder by folder.

    Raises:
        RegistryError: the registry cannot be told at all.
    """
    yield from registry.survey()
    for name in registry.names():
        try:
            yield from _examine_model(registry, load, name)
        except CazslError as error:
            yield RegistryFinding(name, str(error), "see whether the disk and its rights are in order, then look again")


def _examine_model(registry: Registry, load: PredictorFactory, name: str) -> Iterator[RegistryFinding]:
    state = registry.state(name)
    for version in sorted(state.versions):
        named = sorted(alias for alias, to in state.aliases.items() if to == version)
        try:
            load_version(registry, load, name, version)
        except CazslError as error:
            yield RegistryFinding(f"{name}/{version}", str(error), _cure(error, name, version, named), severe=True)
    for alias, version in sorted(state.aliases.items()):
        if version not in state.versions:
            advice = f"point it at one that is there: cazsl models promote {name} VERSION --alias {alias}"
            yield RegistryFinding(f"{name}@{alias}", f"names version {version}, which is not there", advice)
    if not state.versions:
        yield RegistryFinding(name, "has no version", "publish one, or move the folder elsewhere", severe=False)
    history = registry.history(name)
    for problem in history.problems:
        torn = problem.startswith("the last line is torn")
        advice = "the next change cuts it off" if torn else "compare it with a backup; new lines go on from where it is"
        yield RegistryFinding(f"{name}/history", problem, advice, severe=not torn)
    for event in registry.unrecorded(name):
        what = f"{event.what} from {event.before} to {event.to} is not in the history"
        yield RegistryFinding(f"{name}/history", what, "the next change records it", severe=False)


def _cure(error: CazslError, name: str, version: int, named: list[str]) -> str:
    remove = f"cazsl models remove {name}@{version}"
    if named:
        remove = f"point {', '.join(named)} elsewhere (cazsl models rollback {name}), then {remove}"
    if isinstance(error, BrokenModelError) and "signature" in str(error):
        return f"sign it (cazsl models sign {name}@{version} --key KEY), or {remove}"
    return f"put its files back from a backup or another registry (digests tell whether they are right), or {remove}"
