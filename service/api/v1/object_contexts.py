"""Contexts of a request as the tensors of a model."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from service.errors import InvalidRequestError
from service.inference.query import FIRST_OBJECT, NO_OBJECT, Objects
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import ObjectContext
from service.pushing.images import decode, visual_context
from service.schemas.contexts import ContextBody
from service.schemas.pushes import PredictRequest

MAX_IMAGES: Final = 16  # in one batch: each takes a thread for milliseconds, or for a good part of a second
_CACHED_OBJECTS: Final = 4096  # Omnipush has 250


def _object(request: PredictRequest) -> Objects:
    return NO_OBJECT if request.context is None else Objects(*_encoded(request.context, "body.context"), FIRST_OBJECT)


def _seen(image: bytes, places: IndexArray) -> Objects:
    return Objects(ContextKind.VISUAL, visual_context(decode(image)).tensor()[None], places)


def _objects(contexts: Sequence[ContextBody], places: IndexArray) -> Objects:
    """The distinct objects among contexts; those told by one descriptor are encoded once."""
    if sum(context.image is not None for context in contexts) > MAX_IMAGES:
        accepted = f"up to {MAX_IMAGES}; POST /v1/contexts makes a visual context of each"
        raise InvalidRequestError.at("body.contexts", f"more than {MAX_IMAGES} images", accepted)
    kinds: dict[ContextKind, int] = {}
    tensors: list[FloatArray] = []
    known: dict[str, int] = {}
    renumbered = np.empty(len(contexts), dtype=np.int64)
    for number, context in enumerate(contexts):
        descriptor = context.only_descriptor
        place = None if descriptor is None else known.get(descriptor)
        if place is None:
            kind, tensor = _encoded(context, f"body.contexts.{number}")
            kinds.setdefault(kind, number)
            place = len(tensors)
            tensors.append(tensor)
            if descriptor is not None:
                known[descriptor] = place
        renumbered[number] = place
    if len(kinds) > 1:
        received = " and ".join(f"kind {kind} at {number}" for kind, number in kinds.items())
        raise InvalidRequestError.at("body.contexts", received, "contexts of one kind")
    return Objects(next(iter(kinds)), np.concatenate(tensors), renumbered[places])


def _encoded(context: ContextBody, where: str) -> tuple[ContextKind, FloatArray]:
    """Kind and tensor (1, ...) of one object."""
    descriptor = context.only_descriptor
    if descriptor is not None:
        try:
            return ContextKind.INDICATOR, _tensor_of(descriptor)
        except InvalidRequestError:
            pass  # said below, with its place
    known = context.to_contract(where)
    return known.kind, known.tensor()[None]


@lru_cache(maxsize=_CACHED_OBJECTS)
def _tensor_of(descriptor: str) -> FloatArray:
    tensor = ObjectContext.from_descriptor(descriptor).tensor()[None]
    tensor.setflags(write=False)
    return tensor
