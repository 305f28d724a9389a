"""Catalogue of the served models as bodies: every model, one model, one version."""

import pydantic_core

from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.reference import ModelReference
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody


def models_body(models: Snapshot) -> ModelsBody:
    """Return every served model, sorted by name, and the default model for each kind of context."""
    return ModelsBody(models=[model_body(models, name) for name in models.names()], defaults=dict(models.defaults))


def model_body(models: Snapshot, name: str) -> ModelBody:
    """Return one model, with its versions and aliases.

    Raises:
        UnknownModelError: no version of it is served.
    """
    versions = models.versions(name)
    newest: LoadedModel = models.models[name, versions[-1]]
    return ModelBody(
        name=name,
        method=newest.manifest.method,
        context_kind=newest.manifest.context_kind,
        versions=versions,
        aliases=models.aliases_of(name),
    )


def version_body(models: Snapshot, name: str, version: int) -> ModelVersionDetailBody:
    """Return one version, with its manifest and its card.

    Raises:
        UnknownModelError, ModelNotReadyError: see ``Snapshot.find``.
    """
    model = models.find(ModelReference(name, None, version))
    aliases = [alias for alias, target in models.aliases_of(name).items() if target == version]
    manifest = pydantic_core.from_json(model.manifest.render())
    return ModelVersionDetailBody(name=name, version=version, aliases=aliases, manifest=manifest, card=model.card)
