"""What the fields of a generated body mean together, made true in place: what no JSON schema can say of them.

Bodies that are right field by field come in; what is drawn stays as far as it can. No number is drawn here.
"""

import base64
import io
import json
import math
import zlib
from typing import Any

import numpy as np
from PIL import Image

from service.api.v1.object_contexts import MAX_IMAGES
from service.pushing.contexts import BITS_PER_SIDE, SHAPE_DIGITS, SIDES, TRIANGULAR
from service.pushing.poses import REACH_M, WORLD_M

Json = dict[str, Any]
KINDS = {"descriptor": "indicator", "indicator": "indicator", "visual": "visual", "image": "visual"}
FORMATS = ("PNG", "JPEG", "WEBP")
NEAR_M = 0.7 * REACH_M  # so near along two axes is in reach, however these are turned


def picture(seed: object) -> bytes:
    """A real little picture, another for another seed."""
    number = zlib.crc32(repr(seed).encode())
    levels = np.random.default_rng(number).integers(0, 256, (1 + number % 40, 1 + number // 40 % 40), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, FORMATS[number % len(FORMATS)])
    return buffer.getvalue()


def mean_one_push(body: Json) -> None:
    """An object that can be, asked of a model that knows its kind, with the pusher in its reach."""
    kind = "none"
    if body.get("context") is not None:
        kind = mean_an_object(body["context"])
    _ask_for(kind, body)
    pusher, pose = body["pusher"], body.get("object_pose") or {"x": 0.0, "y": 0.0}
    for name in ("x", "y"):
        pusher[name] = _near(pusher[name], pose[name])


def mean_many_pushes(body: Json) -> None:
    """Objects of one kind, a place for each push, poses for all or each, and pushers in reach of them."""
    count, contexts = len(body["pushers"]), body.get("contexts")
    kind = "none"
    if contexts is None:
        body.pop("context_index", None)
    else:
        contexts[:] = _of_one_kind(contexts)
        kind = [mean_an_object(context) for context in contexts].pop()
        if body.get("context_index") is not None:
            index = body["context_index"]
            body["context_index"] = [int(index[row % len(index)]) % len(contexts) for row in range(count)]
        elif len(contexts) not in (1, count):
            del contexts[1:]
    _ask_for(kind, body)
    poses = body.get("object_poses") or [[0.0, 0.0, 0.0]]
    if len(poses) not in (1, count):
        del poses[1:]
    for row, pusher in enumerate(body["pushers"]):
        pose = poses[row % len(poses)]
        pusher[:2] = [_near(pusher[axis], pose[axis]) for axis in range(2)]


def mean_an_object(context: Json) -> str:
    """One shape and one weight per side; a text that is a picture. The kind of context that a model must want."""
    form = next(name for name, value in context.items() if value is not None)
    if form == "indicator":
        context[form] = _one_hot(context[form])
    elif form == "image":
        context[form] = base64.b64encode(picture(context[form])).decode()
    return KINDS[form]


def mean_a_file(body: Json) -> None:
    """A real picture where the name of a file stands for one, as in an example."""
    if type(body["image"]) is str:
        body["image"] = picture(body["image"])


def mean_an_upload(body: Json) -> None:
    """One push or many in reach, asked of a visual model; forms with a file are drawn without a look at ``oneOf``."""
    mean_a_file(body)
    push: Json
    if "pushers" in body:
        push = {name: _rows(body[name]) for name in ("pushers", "object_poses") if name in body}
        mean_many_pushes(push)
        push = {name: json.dumps(rows) for name, rows in push.items()}
    else:
        push = {"pusher": {"x": 0.0, "y": 0.0, "angle": 0.0}}
        push |= {name: body[name] for name in ("pusher", "object_pose") if name in body}
        mean_one_push(push)
    model = str(body.get("model"))
    for name in {"pusher", "pushers", "object_pose", "object_poses"} & body.keys():
        del body[name]
    body |= push | ({"model": "push-visual"} if model.startswith("push-") else {})


def mean_an_inference(body: Json) -> None:
    """The tensors of ``push-indicator``, with as many rows, and as many places, as were drawn."""
    count = 1 + int(body["inputs"][0]["shape"][0]) % 5
    drawn = zlib.crc32(repr(body["inputs"]).encode())
    random = np.random.default_rng(drawn)
    objects = np.array([_one_hot(random.integers(0, 2, SIDES * BITS_PER_SIDE).tolist()) for _ in range(count)])
    tensors = {
        "pusher": ("FP32", random.uniform(-REACH_M, REACH_M, (count, 3))),
        "context": ("FP32", objects),
        "context_index": ("INT64", random.integers(0, count, count)),
    }
    if drawn % 2:  # one object each: no index is needed
        del tensors["context_index"]
    body["inputs"] = [
        {"name": name, "datatype": kind, "shape": list(rows.shape), "data": _nested_or_flat(rows, flat=drawn % 3 == 0)}
        for name, (kind, rows) in tensors.items()
    ]
    if body.get("outputs"):
        body["outputs"] = list({output["name"]: output for output in body["outputs"]}.values())


def is_lost_in_a_form(body: object) -> bool:
    """Whether what is wrong with a body may not be sent at all: null and an empty list make no part of a form."""
    return isinstance(body, dict) and any(value is None or value == [] for value in body.values())


def _rows(seed: object) -> list[list[float]]:
    """One pose or a few."""
    number = zlib.crc32(repr(seed).encode())
    rows: list[list[float]] = np.random.default_rng(number).uniform(-NEAR_M, NEAR_M, (1 + number % 3, 3)).tolist()
    return rows


def _nested_or_flat(rows: np.ndarray[Any, Any], *, flat: bool) -> list[Any]:
    return list(rows.reshape(-1).tolist() if flat else rows.tolist())


def _ask_for(kind: str, body: Json) -> None:
    """Models that nobody has stay: they are a 404."""
    if isinstance(body.get("model"), str):
        name, at, rest = body["model"].partition("@")
        body["model"] = f"push-{kind}{at}{rest}" if len(name) % 2 == 0 or name.startswith("push-") else body["model"]


def _near(position_m: float, centre_m: float) -> float:
    """A coordinate of a pusher near the centre of an object, and in the world as well."""
    if abs(position_m - centre_m) <= NEAR_M:
        return position_m
    return centre_m - math.copysign(math.fmod(abs(position_m), NEAR_M), centre_m if abs(centre_m) > WORLD_M / 2 else 1)


def _of_one_kind(contexts: list[Json]) -> list[Json]:
    """Those that are of the first one's kind, and no more pictures than are taken at once."""
    kinds = [KINDS[next(name for name, value in context.items() if value is not None)] for context in contexts]
    found = [context for context, kind in zip(contexts, kinds, strict=True) if kind == kinds[0]]
    return found[:MAX_IMAGES]


def _one_hot(bits: list[float]) -> list[int]:
    """For each side the first shape and the first weight of those drawn, as far as they go together."""
    found: list[int] = []
    for side in range(SIDES):
        drawn = bits[side * BITS_PER_SIDE : (side + 1) * BITS_PER_SIDE]
        shape = ([*drawn[: len(SHAPE_DIGITS)], 1]).index(1) % len(SHAPE_DIGITS)
        weight = ([*drawn[len(SHAPE_DIGITS) :], 1]).index(1) % (BITS_PER_SIDE - len(SHAPE_DIGITS))
        if SHAPE_DIGITS[shape] != TRIANGULAR and weight > 2:  # B and C become b and c
            weight -= 2
        found += [int(place in (shape, len(SHAPE_DIGITS) + weight)) for place in range(BITS_PER_SIDE)]
    return found
