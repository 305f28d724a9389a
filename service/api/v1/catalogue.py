"""Catalogue of the served models as bodies: every model, one model, one version."""

import pydantic_core

from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.reference import ModelReference
from service.schemas.models import ModelBody, ModelsBody, ModelVersionDetailBody, ValidityBody
from service.validity.domains import validity_of


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
    domains = {version: validity_of(models.models[name, version].manifest) for version in versions}
    return ModelBody(
        name=name,
        method=newest.manifest.method,
        context_kind=newest.manifest.context_kind,
        versions=versions,
        aliases=models.aliases_of(name),
        vouches_for={version: domain.note for version, domain in domains.items() if domain is not None},
    )


def version_body(models: Snapshot, name: str, version: int) -> ModelVersionDetailBody:
    """Return one version, with its manifest, its card and its domain.

    Raises:
        UnknownModelError, ModelNotReadyError: see ``Snapshot.find``.
    """
    model = models.find(ModelReference(name, None, version))
    aliases = [alias for alias, target in models.aliases_of(name).items() if target == version]
    manifest = pydantic_core.from_json(model.manifest.render())
    domain = validity_of(model.manifest)
    return ModelVersionDetailBody(
        name=name,
        version=version,
        aliases=aliases,
        manifest=manifest,
        card=model.card,
        validity=None if domain is None else ValidityBody(ranges=domain.ranges, note=domain.note),
    )
