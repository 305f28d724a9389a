"""Diagnosis of a registry: its faults, each with a remedy. No file is changed."""

from collections.abc import Iterator

from service.errors import BrokenModelError, CazslError
from service.model.predictor import PredictorFactory
from service.registry.loading import load_version
from service.registry.promotion import is_forced, judge, refusals
from service.registry.registry import Registry
from service.storage.base import RegistryFinding
from service.storage.history import ALIASES, History, ModelState, unrecorded


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
    history = None
    try:
        state, history = registry.record(name)
    except CazslError as error:  # the versions are examined without it
        state = registry.state(name)
        yield RegistryFinding(f"{name}/history", str(error), "restore it from a backup")
    for place, cause in state.faults.items():
        yield RegistryFinding(f"{name}/{place}", cause, _cure(name, place))
    for version in sorted(state.versions):
        named = sorted(alias for alias, to in state.aliases.items() if to == version)
        try:
            model = load_version(registry, load, name, version)
            refused = refusals(judge(model, None, registry.domain)) if named else ""
        except CazslError as error:
            yield RegistryFinding(f"{name}/{version}", str(error), _remedy(error, name, version, named), severe=True)
            continue
        for alias in named if refused else ():
            forced = is_forced(history or History(), alias, version)
            advice = f"promote another version, or go back: cazsl models rollback {name} --alias {alias}"
            wrong = f"names version {version}, which gates refuse: {refused}{' (its promotion was forced)' * forced}"
            yield RegistryFinding(f"{name}@{alias}", wrong, advice, severe=not forced)
    for alias, version in sorted(state.aliases.items()):
        if version not in state.versions:
            advice = f"point it at an existing version: cazsl models promote {name} VERSION --alias {alias}"
            yield RegistryFinding(f"{name}@{alias}", f"names version {version}, which does not exist", advice)
    if history is not None:
        yield from _examine_history(name, state, history)


def _examine_history(name: str, state: ModelState, history: History) -> Iterator[RegistryFinding]:
    yield from _lost(name, state, history.lost(state))
    for number, problem in enumerate(history.problems, start=1):
        torn = history.torn_bytes > 0 and number == len(history.problems)
        advice = "the next change cuts it off" if torn else "compare it with a backup; new lines continue from its end"
        yield RegistryFinding(f"{name}/history", problem, advice, severe=not torn)
    changes = unrecorded(history.state(), state)
    if len(changes) > 1 and not history.problems:  # an interrupted writer leaves one
        wrong = f"{len(changes)} changes are missing, so lines were cut off, or files were changed by hand"
        yield RegistryFinding(f"{name}/history", wrong, "compare it with a backup; the next change records them")
    for event in changes:
        change = f"{event.what} from {event.before} to {event.to} is not in the history"
        yield RegistryFinding(f"{name}/history", change, "the next change records it", severe=False)


def _lost(name: str, state: ModelState, lost: ModelState) -> Iterator[RegistryFinding]:
    """Yield the versions and aliases that are recorded and were never removed, but are not there."""
    for version in sorted(lost.versions):
        advice = f"restore its folder from a backup, or record its end: cazsl models remove {name}@{version}"
        yield RegistryFinding(f"{name}/{version}", "is recorded, but missing, and was not removed", advice)
    for alias, version in sorted(lost.aliases.items()):
        advice = (
            f"set it again: cazsl models promote {name} {version} --alias {alias}, or record its end: "
            f"cazsl models remove {name}@{alias}"
        )
        yield RegistryFinding(f"{name}@{alias}", f"is recorded as {version}, but missing, and not dropped", advice)
    if not state.versions | lost.versions:
        yield RegistryFinding(name, "has no version", "publish a version, or move the folder elsewhere", severe=False)


def _cure(name: str, place: str) -> str:
    alias = place.removeprefix(f"{ALIASES}/")
    if alias == place:
        return "check its kind and its permissions; links are not followed"
    return (
        f"check its permissions, set it again (cazsl models promote {name} VERSION --alias {alias}), or remove it "
        f"(cazsl models remove {name}@{alias})"
    )


def _remedy(error: CazslError, name: str, version: int, named: list[str]) -> str:
    remove = f"cazsl models remove {name}@{version}"
    if named:
        remove = f"point {', '.join(named)} elsewhere (cazsl models rollback {name}), then {remove}"
    if isinstance(error, BrokenModelError) and "signature" in str(error):
        return f"sign it (cazsl models sign {name}@{version} --key KEY), or {remove}"
    return f"restore its files from a backup or another registry (their digests are verified), or {remove}"
