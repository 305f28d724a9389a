"""Contexts of requests, encoded as tensors of a model.

Descriptors and shapes are encoded once and cached, within bounds. Images are timed.
"""

from collections.abc import Hashable, Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from service.api.v1.shape_cache import ShapeCache
from service.errors import InvalidRequestError
from service.inference.query import FIRST_CONTEXT, ContextBatch
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.observability.timings import timed
from service.pushing.contexts import ObjectContext, SupportContext, VisualContext
from service.pushing.image_quality import QualityFlag
from service.pushing.images import decode, visual_context
from service.pushing.shape_context import ShapeContext
from service.schemas.contexts import ContextBody, DomainContext
from service.schemas.shapes import FoundShape, ShapeDetails, ShapeKey, find_shape
from service.turns import pause

MAX_IMAGES: Final = 16  # per batch: each keeps a thread busy for milliseconds, or for a large part of a second
MAX_SHAPES: Final = 1000  # per batch: each takes a thread 2 ms if it has 64 corners, and 60 ms if it has 512
_CACHED_DESCRIPTORS: Final = 4096  # Omnipush has 250 objects
_PART: Final = 256  # contexts between two pauses: other work waits for a millisecond
_FIELD: Final = "body.context"
_NO_CONTEXT: Final = ContextBatch(ContextKind.NONE, (), None, _FIELD)
_SHAPES: Final = ShapeCache()
Tensors = tuple[FloatArray, ...]
Flags = tuple[QualityFlag, ...]


def is_light(context: ContextBody) -> bool:
    """Return whether the event loop may encode a context: it is no image, and no shape that was not seen before."""
    if context.image is not None or context.outline is None:
        return context.image is None
    key = context.key
    return isinstance(key, tuple) and key in _SHAPES


def encode_context(context: ContextBody | None) -> ContextBatch:
    """Encode the context of a single push.

    Raises:
        RequestError: the context is not valid.
    """
    if context is None:
        return _NO_CONTEXT
    key = context.key
    if isinstance(key, str):
        try:
            return _described(key)
        except InvalidRequestError:
            pass  # raised again below, with the field
    kind, tensors, flags = _encode(context, key, _FIELD)
    return ContextBatch(kind, tensors, FIRST_CONTEXT, _FIELD, (flags,) if flags else ())


def encode_known(known: DomainContext, flags: Flags) -> ContextBatch:
    """Encode an object context that was read, with the faults of its photograph."""
    return ContextBatch(known.kind, _tensors(known), FIRST_CONTEXT, _FIELD, (flags,) if flags else ())


def encode_contexts(contexts: Sequence[ContextBody] | None, index: IndexArray | None) -> ContextBatch:
    """Encode the contexts of a batch. A repeated descriptor or outline is encoded once.

    Raises:
        RequestError: a context is not valid, their kinds differ, more than ``MAX_IMAGES`` of them are images, or more
            than ``MAX_SHAPES`` are different shapes.
    """
    where = "body.contexts"
    if contexts is None or index is None:
        return ContextBatch(ContextKind.NONE, (), None, where)
    if sum(context.image is not None for context in contexts) > MAX_IMAGES:
        accepted = f"up to {MAX_IMAGES}; POST /v1/contexts makes a context of each that can be sent instead"
        raise InvalidRequestError.at(where, f"more than {MAX_IMAGES} images", accepted)
    found: ContextKind | None = None
    together: Tensors = ()
    known: dict[Hashable, int] = {}
    flags: list[Flags] = []
    renumbered = np.empty(len(contexts), dtype=np.int64)
    count = 0
    for number, context in enumerate(contexts):
        if number % _PART == 0 or context.is_shape:
            pause()
        key = context.key
        place = None if key is None else known.get(key)
        if place is None:
            kind, tensors, of_one = _encode(context, key, f"{where}.{number}")
            flags.append(of_one)
            if found is None:  # room for all of them: a list of tensors and their copy would take twice the memory
                found = kind
                most = min(len(contexts), MAX_SHAPES) if kind is ContextKind.SHAPE else len(contexts)
                together = tuple(np.empty((most, *one.shape[1:]), dtype=np.float32) for one in tensors)
            elif kind is not found:
                received = f"kind {found} at 0 and kind {kind} at {number}"
                raise InvalidRequestError.at(where, received, "contexts of one kind")
            if kind is ContextKind.SHAPE and count == MAX_SHAPES:
                received = f"more than {MAX_SHAPES} different shapes"
                raise InvalidRequestError.at(where, received, f"up to {MAX_SHAPES} in one request")
            for room, tensor in zip(together, tensors, strict=True):
                room[count] = tensor[0]
            place, count = count, count + 1
            if key is not None:
                known[key] = place
        renumbered[number] = place
    tensors = tuple(room[:count] for room in together)
    faults = tuple(flags) if any(flags) else ()
    return ContextBatch(found or ContextKind.NONE, tensors, renumbered[index], where, faults)


def encode_image(image: bytes, details: ShapeDetails, index: IndexArray) -> ContextBatch:
    """Encode the object in an image file: as a shape if the scale of the image is known. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode`` and ``find_shape``.
        InvalidRequestError: details of a shape came without the scale.
    """
    if details.metres_per_pixel is not None:
        found = read_shape(image, details)
        return ContextBatch(ContextKind.SHAPE, _tensors(found.shape), index, "body.image", (found.flags,))
    details.check_without_scale("body")
    return ContextBatch(ContextKind.VISUAL, _tensors(read_view(image)), index, "body.image")


def read_view(image: bytes) -> VisualContext:
    """Return the visual context of an image file. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode``.
    """
    with timed("decode"):
        return visual_context(decode(image))


def read_shape(image: bytes, details: ShapeDetails) -> FoundShape:
    """Return the object in an image file whose scale is known. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError, InvalidRequestError: see ``find_shape``.
    """
    with timed("decode"):
        return find_shape(image, details, "body")


def _encode(context: ContextBody, key: str | ShapeKey | None, where: str) -> tuple[ContextKind, Tensors, Flags]:
    """Return kind and tensors (1, ...) of one context, and the faults of its photograph."""
    if isinstance(key, str):
        try:
            return ContextKind.INDICATOR, (_tensor_of(key),), ()
        except InvalidRequestError:
            pass  # raised again below, with the field
    elif key is not None and (tensors := _SHAPES.get(key)) is not None:
        return ContextKind.SHAPE, tensors, ()
    if context.image is None:
        known, flags = context.describe(where)
    else:
        with timed("decode"):
            known, flags = context.describe(where)
    tensors = _tensors(known)
    if isinstance(key, tuple):
        _SHAPES.put(key, tensors)
    return known.kind, tensors, flags


def _tensors(known: DomainContext) -> Tensors:
    """Return the tensors (1, ...) of one context, in the order of a model's inputs."""
    found = known.tensors() if isinstance(known, ShapeContext | SupportContext) else (known.tensor(),)
    return tuple(tensor[None] for tensor in found)


@lru_cache(maxsize=_CACHED_DESCRIPTORS)
def _described(descriptor: str) -> ContextBatch:
    return ContextBatch(ContextKind.INDICATOR, (_tensor_of(descriptor),), FIRST_CONTEXT, _FIELD)


@lru_cache(maxsize=_CACHED_DESCRIPTORS)
def _tensor_of(descriptor: str) -> FloatArray:
    tensor = ObjectContext.from_descriptor(descriptor).tensor()[None]
    tensor.setflags(write=False)
    return tensor
