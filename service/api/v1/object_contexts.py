"""Contexts of requests, encoded as tensors of a model. Descriptors are encoded once and cached, images are timed."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from service.errors import InvalidRequestError
from service.inference.query import FIRST_CONTEXT, ContextBatch
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.observability.timings import timed
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.images import decode, visual_context
from service.schemas.contexts import ContextBody
from service.turns import pause

MAX_IMAGES: Final = 16  # per batch: each keeps a thread busy for milliseconds, or for a large part of a second
_CACHED_DESCRIPTORS: Final = 4096  # Omnipush has 250 objects
_PART: Final = 256  # contexts between two pauses: other work waits for a millisecond
_FIELD: Final = "body.context"
_NO_CONTEXT: Final = ContextBatch(ContextKind.NONE, (), None, _FIELD)


def encode_context(context: ContextBody | None) -> ContextBatch:
    """Encode the context of a single push.

    Raises:
        RequestError: the context is not valid.
    """
    if context is None:
        return _NO_CONTEXT
    kind, tensor = _encode(context, _FIELD)
    return ContextBatch(kind, (tensor,), FIRST_CONTEXT, _FIELD)


def encode_contexts(contexts: Sequence[ContextBody] | None, index: IndexArray | None) -> ContextBatch:
    """Encode the contexts of a batch. A repeated descriptor is encoded once.

    Raises:
        RequestError: a context is not valid, their kinds differ, or more than ``MAX_IMAGES`` of them are images.
    """
    where = "body.contexts"
    if contexts is None or index is None:
        return ContextBatch(ContextKind.NONE, (), None, where)
    if sum(context.image is not None for context in contexts) > MAX_IMAGES:
        accepted = f"up to {MAX_IMAGES}; POST /v1/contexts makes a visual context of each"
        raise InvalidRequestError.at(where, f"more than {MAX_IMAGES} images", accepted)
    found: ContextKind | None = None
    tensors = np.empty((0,), dtype=np.float32)
    known: dict[str, int] = {}
    renumbered = np.empty(len(contexts), dtype=np.int64)
    count = 0
    for number, context in enumerate(contexts):
        if number % _PART == 0:
            pause()
        descriptor = context.only_descriptor
        place = None if descriptor is None else known.get(descriptor)
        if place is None:
            kind, tensor = _encode(context, f"{where}.{number}")
            if found is None:  # room for all of them: a list of tensors and their copy would take twice the memory
                found, tensors = kind, np.empty((len(contexts), *tensor.shape[1:]), dtype=np.float32)
            elif kind is not found:
                received = f"kind {found} at 0 and kind {kind} at {number}"
                raise InvalidRequestError.at(where, received, "contexts of one kind")
            tensors[count] = tensor[0]
            place, count = count, count + 1
            if descriptor is not None:
                known[descriptor] = place
        renumbered[number] = place
    return ContextBatch(found or ContextKind.NONE, (tensors[:count],), renumbered[index], where)


def encode_image(image: bytes, index: IndexArray) -> ContextBatch:
    """Encode the object in an image file. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode``.
    """
    return ContextBatch(ContextKind.VISUAL, (read_view(image).tensor()[None],), index, "body.image")


def read_view(image: bytes) -> VisualContext:
    """Return the visual context of an image file. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode``.
    """
    with timed("decode"):
        return visual_context(decode(image))


def _encode(context: ContextBody, where: str) -> tuple[ContextKind, FloatArray]:
    """Return kind and tensor (1, ...) of one context."""
    descriptor = context.only_descriptor
    if descriptor is not None:
        try:
            return ContextKind.INDICATOR, _tensor_of(descriptor)
        except InvalidRequestError:
            pass  # raised again below, with the field
    if context.image is None:
        known = context.to_domain(where)
    else:
        with timed("decode"):
            known = context.to_domain(where)
    return known.kind, known.tensor()[None]


@lru_cache(maxsize=_CACHED_DESCRIPTORS)
def _tensor_of(descriptor: str) -> FloatArray:
    tensor = ObjectContext.from_descriptor(descriptor).tensor()[None]
    tensor.setflags(write=False)
    return tensor
