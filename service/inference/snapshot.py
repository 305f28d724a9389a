"""Snapshot of all models that are served at one instant."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

from service.errors import ModelNotReadyError, UnknownModelError
from service.model.loaded_model import LoadedModel
from service.model.reference import DEFAULT_ALIAS, ModelReference
from service.model.tensors import ContextKind

DEFAULT_MODELS: Final[Mapping[str, str]] = {
    **{kind: f"push-{kind}" for kind in ContextKind},
    ContextKind.SUPPORT: "push-anp",
}
"""Default model for each kind of context, unless a setting names another."""


@dataclass(frozen=True)
class Snapshot:
    """Snapshot of the served models, their aliases, and the problems of the registry. A request uses one throughout.

    Attributes:
        models: loaded versions by name and number.
        aliases: served version by name and alias.
        problems: faults of the registry in words.
        silent: models that have a champion by their record and serve none, with the reason.
        problem_counts: number of problems by model, or by an entry in a model's place.
        defaults: name of the default model for each kind of context.
    """

    models: Mapping[tuple[str, int], LoadedModel] = field(default_factory=dict)
    aliases: Mapping[tuple[str, str], int] = field(default_factory=dict)
    problems: tuple[str, ...] = ("the registry was not read yet",)
    silent: Mapping[str, str] = field(default_factory=dict)
    problem_counts: Mapping[str, int] = field(default_factory=dict)
    defaults: Mapping[str, str] = field(default_factory=lambda: DEFAULT_MODELS)

    def find(self, reference: ModelReference) -> LoadedModel:
        """Return the model that a reference names.

        Raises:
            UnknownModelError: it is not served.
            ModelNotReadyError: no model is served yet, or this one has a champion by its record and does not serve it.
        """
        version = reference.version
        if reference.alias is not None:
            version = self.aliases.get((reference.name, reference.alias))
        model = None if version is None else self.models.get((reference.name, version))
        if model is not None:
            return model
        if not self.models:
            raise ModelNotReadyError(
                f"no model is loaded: {self.problems[0] if self.problems else 'none is published'}"
            )
        if reference.alias == DEFAULT_ALIAS and (reason := self.silent.get(reference.name)) is not None:
            raise ModelNotReadyError(f"{reference} is not served now: {reason}")
        served = ", ".join(f"{name}@{number}" for name, number in sorted(self.models)[:10])
        raise UnknownModelError(f"model: received a reference that is not served; accepted is one of: {served}")

    def find_default(self, kind: ContextKind) -> LoadedModel:
        """Return the champion of the default model for a kind of context.

        Raises:
            UnknownModelError, ModelNotReadyError: see ``find``.
        """
        return self.find(_champion(self.defaults[kind]))

    def names(self) -> list[str]:
        """Return the names of the served models, sorted."""
        return sorted({name for name, _ in self.models})

    def versions(self, name: str) -> list[int]:
        """Return the served versions of a model, oldest first.

        Raises:
            UnknownModelError: none is served.
        """
        numbers = sorted(number for model, number in self.models if model == name)
        if not numbers:
            served = ", ".join(self.names()) or "none"
            raise UnknownModelError(f"name: received a model that is not served; accepted is one of: {served}")
        return numbers

    def aliases_of(self, name: str) -> dict[str, int]:
        """Return the aliases of a model with the versions that they name."""
        return {alias: version for (model, alias), version in self.aliases.items() if model == name}


@lru_cache(maxsize=64)
def _champion(name: str) -> ModelReference:
    """Return the reference to the champion of a model."""
    return ModelReference(name, DEFAULT_ALIAS, None)
