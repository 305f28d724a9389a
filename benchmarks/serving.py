"""Serving compared with other servers: single pushes, batches, outlines, pushes beside longer work, start.

    python -m benchmarks.serving [--rounds 7] [--seconds 2] [--part images] [--peer litserve=PYTHON] ...

All servers run at once on loopback, one process each; child processes are counted with it. wrk sends requests to them
in turn, round by round, so a drift of the machine's speed affects all. Printed are medians over the rounds, ratios, and
the server's processor time per request, which a busy machine disturbs less than the throughput. A peer is a script in
benchmarks/peers, run by the interpreter of an environment in which the peer is installed.
"""

import argparse
import io
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from benchmarks.http_load import OURS, PUSH, ROOT, Load, Server, WrkFigures, free_port, run_wrk, server, wrk_command
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.processors import processors
from service.pushing.contexts import ObjectContext
from service.pushing.onnx_interface import OUTPUTS, expected_inputs

ROWS = 1000
CONNECTIONS = 16
CORNERS = 64
EMPTY = "(a) empty FastAPI endpoint, same schemas"
_JSON: Final = {"Content-Type": "application/json"}
_VARIED = """
local number = 0
request = function()
  number = number + 1
  return wrk.format(nil, nil, nil, (wrk.body:gsub("0.25,", string.format("0.2%07d,", number))))
end
"""


def median(runs: list[WrkFigures], field: str) -> float:
    """Return the median of one figure over the rounds."""
    return float(statistics.median(getattr(run, field) for run in runs))


def pushes() -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Return random pushes around an object (1000, 3), m, m, rad."""
    return np.random.default_rng(0).uniform(-0.1, 0.1, (ROWS, 3)).astype(np.float32)


def bare_runtime() -> Callable[[], float]:
    """Return a measurement of the bare runtime: pushes per second of the served graph, in this process, one thread."""
    folder = ROOT / "models/push-indicator"
    version = (folder / "aliases/champion").read_text().strip()
    predictor = OnnxPredictor(
        (folder / version / "model.onnx").read_bytes(), expected_inputs(ContextKind.INDICATOR), OUTPUTS
    )
    rows, context = pushes(), ObjectContext.from_descriptor("1a2b3c4a").tensor()[None]
    index = np.zeros(ROWS, dtype=np.int64)

    def measure() -> float:
        began, runs = time.perf_counter(), 0
        while time.perf_counter() - began < 1.0:
            predictor.predict(rows, (context,), index)
            runs += 1
        return runs * ROWS / (time.perf_counter() - began)

    return measure


def batch_loads() -> dict[str, Load]:
    """Return requests of a thousand pushes of one object, as JSON and as binary tensors."""
    rows = pushes()
    shortest = [[float(str(x)) for x in row] for row in rows]
    body = json.dumps({"pushers": shortest, "contexts": [{"descriptor": "1a2b3c4a"}]})
    context = ObjectContext.from_descriptor("1a2b3c4a").tensor()[None]
    tensors = [("pusher", "FP32", rows), ("context", "FP32", context)]
    inputs = [
        {"name": name, "datatype": kind, "shape": list(array.shape), "parameters": {"binary_data_size": array.nbytes}}
        for name, kind, array in tensors
    ]
    head = json.dumps({"inputs": inputs, "parameters": {"binary_data_output": True}}).encode()
    raw = head + b"".join(array.tobytes() for _, _, array in tensors)
    return {
        "JSON": Load("/v1/predict/batch", body.encode(), _JSON),
        "binary, /v2": Load(
            "/v2/models/push-indicator/infer", raw, {"Inference-Header-Content-Length": str(len(head))}
        ),
    }


def image_load() -> Load:
    """Return a request with a photograph of two megapixels to convert."""
    levels = np.random.default_rng(0).integers(0, 256, (1200, 1600, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, "JPEG")
    return Load("/v1/contexts", buffer.getvalue(), {"Content-Type": "image/jpeg"})


def single_pushes(servers: dict[str, Server], folder: Path, rounds: int, seconds: int) -> None:
    """Measure every server in turn with one push per request."""
    script = Load("/v1/predict", PUSH, _JSON).script(folder, "push")
    runs: dict[str, list[WrkFigures]] = {name: [] for name in servers}
    for _ in range(rounds):
        for name, target in servers.items():
            runs[name].append(run_wrk(target, script, "/v1/predict", CONNECTIONS, seconds))
    empty = runs[EMPTY]
    print(f"\n## Single pushes, {CONNECTIONS} connections\n")
    print("| server | requests/s | times (a) | processor us per request | times less than (a) | p50 (ms) | p99 (ms) |")
    print("|---|---|---|---|---|---|---|")
    for name, figures in runs.items():
        ratio = statistics.median(o.requests_per_s / e.requests_per_s for o, e in zip(figures, empty, strict=True))
        less = statistics.median(e.cpu_us / o.cpu_us for o, e in zip(figures, empty, strict=True))
        print(
            f"| {name} | {median(figures, 'requests_per_s'):.0f} | {ratio:.2f} | {median(figures, 'cpu_us'):.0f} "
            f"| {less:.2f} | {median(figures, 'p50_us') / 1e3:.2f} | {median(figures, 'p99_us') / 1e3:.2f} |"
        )


def batches(ours: Server, folder: Path, rounds: int, seconds: int) -> None:
    """Measure the service with a thousand pushes per request, beside the bare runtime."""
    loads, runtime = batch_loads(), bare_runtime()
    alone: list[float] = []
    runs: dict[str, list[WrkFigures]] = {name: [] for name in loads}
    for _ in range(rounds):
        alone.append(runtime())
        for number, (name, load) in enumerate(loads.items()):
            runs[name].append(run_wrk(ours, load.script(folder, f"batch{number}"), load.path, 2, seconds))
    print(f"\n## Batches of {ROWS} pushes of one object, 2 connections\n")
    print("| | pushes/s | of the bare runtime |")
    print("|---|---|---|")
    print(f"| bare runtime in process, one thread | {statistics.median(alone):.0f} | 1.00 |")
    for name, figures in runs.items():
        ratio = statistics.median(run.requests_per_s * ROWS / one for run, one in zip(figures, alone, strict=True))
        print(f"| ours, {name} | {median(figures, 'requests_per_s') * ROWS:.0f} | {ratio:.2f} |")


def outline() -> list[list[float]]:
    """Return an outline of 64 corners in m: a rounded star of about 120 x 80 mm."""
    angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    radius = 1.0 + 0.15 * np.sin(5.0 * angles)
    corners = np.stack([0.055 * radius * np.cos(angles), 0.037 * radius * np.sin(angles)], axis=1)
    found: list[list[float]] = corners.round(5).tolist()
    return found


def shapes(ours: Server, empty: Server, folder: Path, rounds: int, seconds: int) -> None:
    """Measure pushes of an outline of 64 corners beside those of a descriptor and the empty endpoint, in one run."""
    context = {"friction": 0.25, "outline": outline()}  # the friction comes first, so that it can be varied
    pusher = {"x": -0.1, "y": 0.0, "angle": 0.0, "length": 0.06}
    rng = np.random.default_rng(0)
    starts = rng.uniform((-0.1, -0.04, -0.4), (-0.09, 0.04, 0.4), (ROWS, 3)).round(5).tolist()
    batch = json.dumps({"pushers": starts, "lengths": 0.06, "contexts": [context]})
    one = json.dumps({"pusher": pusher, "context": context})
    loads = {
        "empty endpoint": (empty, Load("/v1/predict", PUSH, _JSON), CONNECTIONS),
        "one push by descriptor": (ours, Load("/v1/predict", PUSH, _JSON), CONNECTIONS),
        "one push of an outline that was seen": (ours, Load("/v1/predict", one.encode(), _JSON), CONNECTIONS),
        "one push of an outline that is new": (ours, Load("/v1/predict", one.encode(), _JSON), CONNECTIONS),
        "1,000 pushes by descriptor": (ours, batch_loads()["JSON"], 2),
        "1,000 pushes of one outline": (ours, Load("/v1/predict/batch", batch.encode(), _JSON), 2),
    }
    scripts = {name: load.script(folder, f"shape{number}") for number, (name, (_, load, _)) in enumerate(loads.items())}
    new = scripts["one push of an outline that is new"]
    new.write_text(new.read_text() + _VARIED)
    runs: dict[str, list[WrkFigures]] = {name: [] for name in loads}
    for _ in range(rounds):
        for name, (target, load, connections) in loads.items():
            runs[name].append(run_wrk(target, scripts[name], load.path, connections, seconds))
    print(f"\n## Outlines of {CORNERS} corners\n")
    print("| | requests/s | p50 (ms) | times the empty endpoint |\n|---|---|---|---|")
    for name, figures in runs.items():
        rate, p50 = median(figures, "requests_per_s"), median(figures, "p50_us") / 1e3
        print(f"| {name} | {rate:.0f} | {p50:.2f} | {_ratio(figures, runs['empty endpoint']):.2f} |")
    slower = 1.0 / _ratio(runs["1,000 pushes of one outline"], runs["1,000 pushes by descriptor"])
    print(f"\n1,000 pushes of one outline take {slower:.1f} times the time of 1,000 by descriptor")


def _ratio(figures: list[WrkFigures], others: list[WrkFigures]) -> float:
    """Return the median over the rounds of the throughput, in times of another one."""
    pairs = zip(figures, others, strict=True)
    return statistics.median(one.requests_per_s / other.requests_per_s for one, other in pairs)


def rollout_load() -> Load:
    """Return a request for 40 candidate sequences of five pushes of an outline, with 64 particles each."""
    push = {"x": 0.3, "y": 0.1, "angle": 0.0, "length": 0.05}
    sequences = [[{**push, "y": 0.06 + 0.002 * number}] * 5 for number in range(40)]
    body = {"context": {"outline": outline()}, "object_pose": {"x": 0.4, "y": 0.1, "angle": 0.0}}
    return Load("/v1/rollout", json.dumps(body | {"sequences": sequences, "particles": 64}).encode(), _JSON)


def plan_load() -> Load:
    """Return a request for a plan of an outline around an obstacle."""
    obstacle = [[0.5, 0.1], [0.55, 0.1], [0.55, 0.2], [0.5, 0.2]]
    poses = {"object_pose": {"x": 0.4, "y": 0.1, "angle": 0.0}, "goal": {"x": 0.7, "y": 0.2, "angle": 1.0}}
    body = {"context": {"outline": outline()}, **poses, "obstacles": [obstacle]}
    return Load("/v1/plan", json.dumps(body).encode(), _JSON)


def refine_load() -> Load:
    """Return a request to refine an outline by ten pushes."""
    pushers = [[-0.1, 0.004 * number - 0.02, 0.0] for number in range(10)]
    outcomes = [[0.03, 0.0, 0.1 - 0.02 * number] for number in range(10)]
    body = {"context": {"outline": outline()}, "pushers": pushers, "outcomes": outcomes}
    return Load("/v1/contexts/refine", json.dumps(body).encode(), _JSON)


BESIDE: Final[dict[str, tuple[str, Callable[[], Load]]]] = {
    "images": ("while photographs are decoded", image_load),
    "rollouts": ("while sequences are rolled out", rollout_load),
    "refine": ("while contexts are refined", refine_load),
    "plans": ("while plans are searched", plan_load),
}
PARTS = ("singles", "batches", "shapes", *BESIDE, "start")


def pushes_beside(ours: Server, part: str, folder: Path, rounds: int, seconds: int) -> None:
    """Measure single pushes on one connection, idle and while two other connections ask for longer work."""
    push = Load("/v1/predict", PUSH, _JSON).script(folder, "push")
    words, make = BESIDE[part]
    load = make()
    others = wrk_command(load.script(folder, part), f"http://127.0.0.1:{ours.port}{load.path}", 2, seconds + 1)
    runs: dict[str, list[WrkFigures]] = {"idle": [], words: []}
    for _ in range(rounds):
        runs["idle"].append(run_wrk(ours, push, "/v1/predict", 1, seconds))
        asking = subprocess.Popen(others, stdout=subprocess.DEVNULL)
        time.sleep(0.5)
        runs[words].append(run_wrk(ours, push, "/v1/predict", 1, seconds))
        asking.wait()
    print(f"\n## Single pushes {words}, 1 connection\n")
    print("| | p50 (ms) | p99 (ms) | of the rounds |\n|---|---|---|---|")
    for name, figures in runs.items():
        tails = sorted(run.p99_us / 1e3 for run in figures)
        p50, p99 = median(figures, "p50_us") / 1e3, statistics.median(tails)
        print(f"| {name} | {p50:.2f} | {p99:.2f} | {tails[0]:.2f} to {tails[-1]:.2f} |")
    idle, busy = (median(figures, "p99_us") for figures in runs.values())
    each = statistics.median(one.p99_us / other.p99_us for other, one in zip(*runs.values(), strict=True))
    print(f"\np99 {busy / idle:.2f} times the idle one; median over the rounds {each:.2f}")


def start(rounds: int) -> None:
    """Measure the time from start to first answer, and the memory at that moment."""
    times, memory = [], []
    for _ in range(rounds):
        began = time.perf_counter()
        with server([sys.executable, *OURS], free_port()) as found:
            times.append(time.perf_counter() - began)
            memory.append(found.rss_mib())
    print("\n## Start\n\n| | median |\n|---|---|")
    print(f"| to the first answer | {statistics.median(times):.2f} s |")
    print(f"| memory then | {statistics.median(memory):.1f} MiB |")


def main() -> None:
    """Measure and print the figures."""
    peers = ROOT / "benchmarks" / "peers"
    known = sorted(path.name.removesuffix("_peer.py") for path in peers.glob("*_peer.py"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=2, help="length of one run of wrk")
    parser.add_argument("--rounds", type=int, default=7, help="runs of each")
    parser.add_argument("--peer", action="append", default=[], metavar="NAME=PYTHON", help=f"one of {', '.join(known)}")
    parser.add_argument("--part", choices=PARTS, action="append", help="measure this part only; may be repeated")
    options = parser.parse_args()
    parts = options.part or PARTS
    if shutil.which("wrk") is None:
        raise SystemExit("wrk is not installed: apt-get install wrk")
    commands = {
        "ours": [sys.executable, *OURS],
        EMPTY: [sys.executable, str(peers / "empty_fastapi.py")],
        "(b) thirty lines of FastAPI and onnxruntime": [sys.executable, str(peers / "thirty_lines.py")],
        "(c) bare ASGI function, constant bytes": [sys.executable, str(peers / "bare_asgi.py")],
    }
    for peer in options.peer:
        name, _, python = peer.partition("=")
        if name not in known or not python:
            raise SystemExit(f"--peer: received {peer!r}; accepted is NAME=PYTHON, NAME one of {', '.join(known)}")
        commands[name] = [python, str(peers / f"{name}_peer.py")]
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder, servers = Path(temporary), {}
        for name, command in commands.items():
            if name != "ours" and "singles" not in parts and not (name == EMPTY and "shapes" in parts):
                continue
            port = free_port()
            own = command if name == "ours" else [*command, str(port)]
            servers[name] = stack.enter_context(server(own, port))
        print(f"{options.rounds} rounds of {options.seconds} s, {processors()} processors, medians; load by wrk.")
        if "singles" in parts:
            single_pushes(servers, folder, options.rounds, options.seconds)
        if "batches" in parts:
            batches(servers["ours"], folder, options.rounds, options.seconds)
        if "shapes" in parts:
            shapes(servers["ours"], servers[EMPTY], folder, options.rounds, options.seconds)
        for part in BESIDE.keys() & set(parts):
            pushes_beside(servers["ours"], part, folder, options.rounds, options.seconds)
    if "start" in parts:
        start(options.rounds)


if __name__ == "__main__":
    main()
