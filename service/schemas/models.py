"""Bodies that describe served models and versions."""

from typing import Annotated, Any

from pydantic import Field

from service.schemas.body import Body

_MODEL_EXAMPLE = {
    "name": "push-indicator",
    "method": "FCN + CM + L2Reg",
    "context_kind": "indicator",
    "versions": [1, 2],
    "aliases": {"champion": 2},
}


class ModelVersionBody(Body):
    """Which model answered."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="version, immutable", examples=[1])]


class ModelBody(Body):
    """A model as it is served now."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    method: Annotated[str, Field(description="row of the paper's tables", examples=["FCN + CM + L2Reg"])]
    context_kind: Annotated[str, Field(description="what it wants to know of the object", examples=["indicator"])]
    versions: Annotated[list[int], Field(description="versions served, oldest first", examples=[[1, 2]])]
    aliases: Annotated[dict[str, int], Field(description="what each alias means", examples=[{"champion": 2}])]


class ModelsBody(Body):
    """Every model that is served."""

    models: Annotated[list[ModelBody], Field(description="sorted by name", examples=[[_MODEL_EXAMPLE]])]


class ModelVersionDetailBody(Body):
    """One version: its manifest and its card."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="version, immutable", examples=[1])]
    aliases: Annotated[list[str], Field(description="aliases that mean this version now", examples=[["champion"]])]
    manifest: Annotated[
        dict[str, Any],
        Field(
            description="manifest.json as published: method, data, metrics, tensors with units, digests",
            examples=[{"format": 1, "name": "push-indicator", "version": 1, "method": "FCN + CM + L2Reg"}],
        ),
    ]
    card: Annotated[str, Field(description="the model card, Markdown", examples=["# push-indicator\n"])]
