"""Bodies of the catalogue: the models and versions that are served."""

from typing import Annotated, Any

from pydantic import FailFast, Field

from service.schemas.body import Body

_MODEL_EXAMPLE = {
    "name": "push-indicator",
    "method": "FCN + CM + L2Reg",
    "context_kind": "indicator",
    "versions": [1, 2],
    "aliases": {"champion": 2},
    "vouches_for": {"2": "pushes of 50 mm that start between touch and 124 mm from the centre"},
}
_VALIDITY_EXAMPLE = {
    "ranges": {"start_distance_m": [0.0467, 0.1235], "length_m": [0.05, 0.05]},
    "note": "pushes of 50 mm that start between touch and 124 mm from the centre",
}
_DEFAULTS_EXAMPLE = {
    "none": "push-none",
    "indicator": "push-indicator",
    "visual": "push-visual",
    "shape": "push-shape",
    "support": "push-anp",
}


class ValidityBody(Body):
    """Domain that a version vouches for."""

    ranges: Annotated[
        dict[str, tuple[float, float]],
        Field(
            description="lowest and highest value of each feature, named with its SI unit",
            examples=[_VALIDITY_EXAMPLE["ranges"]],
        ),
    ]
    note: Annotated[
        str,
        Field(
            description="the domain in words",
            examples=[_VALIDITY_EXAMPLE["note"]],
        ),
    ]


class ModelVersionBody(Body):
    """Model version that answered."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="number of the version, which never changes", examples=[1])]


class ModelBody(Body):
    """Model that is served, with its versions and aliases."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    method: Annotated[str, Field(description="method, a row of the paper's tables", examples=["FCN + CM + L2Reg"])]
    context_kind: Annotated[
        str,
        Field(description="kind of context that it takes: none, indicator, visual or shape", examples=["indicator"]),
    ]
    versions: Annotated[
        list[int], FailFast(), Field(description="versions that are served, oldest first", examples=[[1, 2]])
    ]
    aliases: Annotated[dict[str, int], Field(description="version that each alias names", examples=[{"champion": 2}])]
    vouches_for: Annotated[
        dict[int, str],
        Field(
            description="domain of each version in words. Versions without one are left out.",
            examples=[_MODEL_EXAMPLE["vouches_for"]],
        ),
    ] = {}  # noqa: RUF012 (pydantic copies it)


class ModelsBody(Body):
    """Models that are served."""

    models: Annotated[
        list[ModelBody], FailFast(), Field(description="models, sorted by name", examples=[[_MODEL_EXAMPLE]])
    ]
    defaults: Annotated[
        dict[str, str],
        Field(
            description="for each kind of context the model whose champion answers if a request names no model. "
            "A setting of the service.",
            examples=[_DEFAULTS_EXAMPLE],
        ),
    ] = {}  # noqa: RUF012 (pydantic copies it)


class ModelVersionDetailBody(Body):
    """Model version with its manifest and its card."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="number of the version, which never changes", examples=[1])]
    aliases: Annotated[
        list[str], FailFast(), Field(description="aliases that name this version now", examples=[["champion"]])
    ]
    manifest: Annotated[
        dict[str, Any],
        Field(
            description="manifest.json as published: method, data, metrics, tensors with units, digests",
            examples=[{"format": 1, "name": "push-indicator", "version": 1, "method": "FCN + CM + L2Reg"}],
        ),
    ]
    card: Annotated[str, Field(description="model card, in Markdown", examples=["# push-indicator\n"])]
    validity: Annotated[
        ValidityBody | None,
        Field(
            description="domain that the version vouches for: that of its manifest or, for a version published before "
            "manifests had one, the ring of starts that it learnt",
            examples=[_VALIDITY_EXAMPLE],
        ),
    ] = None
