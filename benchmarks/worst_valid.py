"""Largest valid requests: as many pushes, contexts, pixels and bytes as the limits allow. Each is answered with 200."""

import base64
import gzip
import io
import json
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, Final

import numpy as np
from PIL import Image

from benchmarks.worst_bodies import BOUNDARY, WorstRequest

PUSHES: Final = 10_000
MAX_PIXELS: Final = (4096, 3072)  # 12,582,912 pixels
_BITS: Final = [1, 0, 0, 0, 1, 0, 0, 0, 0] * 4
_ROW: Final = [-0.07512345, 0.01234567, 0.12345678901234567]
_START: Final = [-0.1, 0.0, 0.0]
_VISUAL: Final = base64.b64encode(bytes(range(256)) * 4).decode()
_JSON: Final = {"Content-Type": "application/json"}
_LENGTH: Final = "Inference-Header-Content-Length"
_MODES: Final = {"PNG": ("L", "RGB", "RGBA", "I;16", "P", "1"), "JPEG": ("L", "RGB", "CMYK"), "WEBP": ("RGB", "RGBA")}


def valid_requests(size: int, pixels: tuple[int, int] = MAX_PIXELS) -> Iterator[WorstRequest]:
    """Yield each largest valid request, with bodies of up to ``size`` bytes, and pictures of these pixels."""
    for kind, batch in _batches(size):
        yield _request("/v1/predict/batch", kind, _JSON, _dumped(batch))
    for route, kind, question in _questions(size):
        yield _request(route, kind, _JSON, _dumped(question))
    for mode, file in _pictures(pixels):
        if 4 * len(file) // 3 > size - 1000:
            continue
        text = base64.b64encode(file).decode()
        push = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"image": text}}
        yield _request("/v1/predict", f"a picture, {mode}", _JSON, _dumped(push))
        if 16 * len(text) < size - 1000:
            many = {"pushers": [_ROW] * 16, "contexts": [{"image": text}] * 16}
            yield _request("/v1/predict/batch", f"16 pictures, {mode}", _JSON, _dumped(many))
        content_type = {"Content-Type": f"image/{mode.partition(' ')[0].lower()}"}
        yield _request("/v1/contexts", f"a picture, {mode}", content_type, _constant(file))
        rows = json.dumps([_ROW] * PUSHES).encode()
        form_type = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        form = _part('image"; filename="a', file) + _part("pushers", rows) + b"--%s--\r\n" % BOUNDARY.encode()
        yield _request("/v1/predict/image", f"a picture and 10,000 pushes, {mode}", form_type, _constant(form))
    for kind, model, headers, body in _inferences(size):
        for encoding in ({}, {"Content-Encoding": "gzip"}):
            content = _constant(gzip.compress(body, 1) if encoding else body)
            name = f"{kind}, gzip" if encoding else kind
            target = f"/v2/models/{model}/infer".encode()
            yield WorstRequest("/v2/models/{name}/infer", name, "POST", target, headers | encoding, content)


def _batches(size: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the largest batches."""
    nulls = {"descriptor": None, "visual": None, "image": None}
    whole = {"pushers": [_ROW] * PUSHES, "context_index": list(range(PUSHES)), "object_poses": [_ROW] * PUSHES}
    yield "10,000 pushes, poses, indices and indicators", whole | {"contexts": [nulls | {"indicator": _BITS}] * PUSHES}
    yield "10,000 descriptors", {"pushers": [_ROW] * PUSHES, "contexts": [{"descriptor": "1a2b3c4a"}] * PUSHES}
    count = min(PUSHES, (size - 1000) // (len(_VISUAL) + 75))
    yield f"{count:,} visual contexts", {"pushers": [[0, 0, 0]] * count, "contexts": [{"visual": _VISUAL}] * count}
    for corners, most in ((512, 50), (8, 1000)):  # more with 512 corners may take longer than the deadline
        count = min(most, (size - 1000) // (corners * 22 + 100))
        push = {"pushers": [_START] * count, "lengths": [0.05] * count, "contexts": _outlines(count, corners)}
        yield f"{count} outlines of {corners} corners", push
    many = {"pushers": [_START] * PUSHES, "lengths": [0.05] * PUSHES, "contexts": _outlines(1, 512)}
    yield "10,000 pushes of one outline of 512 corners", many
    levels = [[0.12345678] * 32] * 32
    count = min(470, (size - 1000) // 12_000)
    yield f"{count} visual contexts as numbers", {"pushers": [_ROW] * count, "contexts": [{"visual": levels}] * count}


def _questions(size: int) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield the largest questions about several pushes of one object: route, kind and document."""
    push = {"x": -0.1, "y": 0.01234567, "angle": 0.12345678901234567, "length": 0.05}
    question = {"object_pose": {"x": 0.0, "y": 0.0, "angle": 0.0}, "context": _outlines(1, 512)[0]}
    count = min(PUSHES, (size - 20_000) // 70) // 50
    for length in (1, 50):
        sequences = [[push] * length] * (count * 50 // length)
        yield "/v1/rollout", f"{len(sequences):,} sequences of {length}", question | {"sequences": sequences}
    returned = {"pushes": [push] * 48, "particles": 1024, "return_particles": True}
    yield "/v1/rollout", "48 pushes with 1,024 particles each, returned", question | returned
    around = {"spacing": 0.0026, "angles": [0.01 * number for number in range(64)]}
    yield "/v1/push-map", "64 angles at 100 places", {"context": question["context"]} | around
    pushers = [[-0.1, 0.001 * (number - 25), 0.0] for number in range(50)]
    outcomes = [[0.02, 0.0, 0.001 * number] for number in range(50)]
    known = {"context": question["context"], "pushers": pushers, "outcomes": outcomes}
    yield "/v1/contexts/refine", "50 pushes of one outline of 512 corners", known


def _outlines(count: int, corners: int) -> list[dict[str, Any]]:
    """Return different objects of this many corners."""
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    star = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (1.0 + 0.1 * np.sin(5.0 * angles))[:, None]
    return [{"outline": (star * (0.04 + 1e-5 * number)).round(8).tolist()} for number in range(count)]


def _inferences(size: int) -> Iterator[tuple[str, str, dict[str, str], bytes]]:
    """Yield the largest inference requests: kind, model, headers and body."""
    pushers = np.tile(np.array(_ROW, dtype="<f4"), (PUSHES, 1))
    indicators = np.tile(np.array(_BITS, dtype="<f4"), (PUSHES, 1))
    for kind, flat in (("flat", True), ("nested", False)):
        inputs = [_tensor("pusher", pushers, flat), _tensor("context", indicators, flat)]
        yield f"10,000 pushes and indicators, {kind}", "push-indicator", _JSON, json.dumps({"inputs": inputs}).encode()
    count = min(PUSHES, (size - 1000) // (4096 + 12))
    raw = {"pusher": pushers[:count], "context": np.full((count, 1, 32, 32), 0.5, dtype="<f4")}
    for kind, model, tensors in (
        (f"{count:,} visual contexts, raw", "push-visual", raw),
        ("10,000 pushes and indicators, raw", "push-indicator", {"pusher": pushers, "context": indicators}),
    ):
        inputs = [
            {
                "name": name,
                "datatype": "FP32",
                "shape": list(array.shape),
                "parameters": {"binary_data_size": array.nbytes},
            }
            for name, array in tensors.items()
        ]
        head = json.dumps({"inputs": inputs}).encode()
        body = head + b"".join(array.tobytes() for array in tensors.values())
        yield kind, model, _JSON | {_LENGTH: str(len(head))}, body


def _tensor(name: str, array: "np.ndarray[Any, Any]", flat: bool) -> dict[str, Any]:
    data = (array.reshape(-1) if flat else array).tolist()
    return {"name": name, "datatype": "FP32", "shape": list(array.shape), "data": data}


@cache
def _pictures(pixels: tuple[int, int]) -> tuple[tuple[str, bytes], ...]:
    """Return pictures of as many pixels as are accepted, in each format and mode, plain and progressive."""
    found: list[tuple[str, bytes]] = []
    for form, modes in _MODES.items():
        for mode in modes:
            image = Image.new(mode, pixels)
            image.paste(1, (0, 0, 64, 64)) if mode in ("1", "L", "P", "I;16") else image.paste(
                (90,) * len(mode), (0, 0, 64, 64)
            )
            for progressive in (False, True) if form == "JPEG" else (False,):
                buffer = io.BytesIO()
                image.save(buffer, form, **({"progressive": True} if progressive else {}))
                found.append((f"{form} {mode}{' progressive' if progressive else ''}", buffer.getvalue()))
    return tuple(found)


def _request(path: str, kind: str, headers: dict[str, str], body: Callable[[], bytes]) -> WorstRequest:
    return WorstRequest(path, kind, "POST", path.encode(), headers, body)


def _dumped(document: dict[str, Any]) -> Callable[[], bytes]:
    return lambda: json.dumps(document, separators=(",", ":")).encode()


def _constant(body: bytes) -> Callable[[], bytes]:
    return lambda: body


def _part(name: str, value: bytes) -> bytes:
    head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'
    return head.encode() + value + b"\r\n"
