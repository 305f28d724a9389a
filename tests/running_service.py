"""A running service for tests: a real process with sockets, onnxruntime, the shipped models and a small visual model.

``CAZSL_TEST_CONTAINER`` is a command that starts a container instead. In it ``{settings}`` is replaced by options
``--env NAME=VALUE``, and ``{folder}`` by the folder of the registry. See docs/operations.md.
"""

import http.client
import io
import os
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import httpx2
import numpy as np
import onnx
import uvicorn
from onnx import TensorProto, helper

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.manifest import SelfCheck
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.observability.logs import RequestLog
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import draft_manifest

ROOT = Path(__file__).resolve().parent.parent
PATIENCE_S = 60.0  # bounds a hang and is not a measurement


def visual_model() -> bytes:
    """Build a visual graph: mean is -0.1 times the pusher pose, with the mean grey level added to the angle."""
    size = [VISUAL_SIZE, VISUAL_SIZE]
    floats = TensorProto.FLOAT
    nodes = [
        helper.make_node("Mul", ["pusher", "tenth"], ["moved"]),
        helper.make_node("ReduceMean", ["context", "pixels"], ["grey"], keepdims=0),
        helper.make_node("Gather", ["grey", "context_index"], ["turn"], axis=0),
        helper.make_node("Mul", ["turn", "only_angle"], ["turned"]),
        helper.make_node("Add", ["moved", "turned"], ["mean"]),
        helper.make_node("Mul", ["mean", "nothing"], ["zeros"]),
        helper.make_node("Add", ["zeros", "spread"], ["std"]),
    ]
    constants = [
        helper.make_tensor("tenth", floats, [3], [-0.1] * 3),
        helper.make_tensor("pixels", TensorProto.INT64, [2], [2, 3]),
        helper.make_tensor("only_angle", floats, [3], [0.0, 0.0, 1.0]),
        helper.make_tensor("nothing", floats, [1], [0.0]),
        helper.make_tensor("spread", floats, [3], [0.001, 0.002, 0.03]),
    ]
    inputs = [
        helper.make_tensor_value_info("pusher", floats, ["n", 3]),
        helper.make_tensor_value_info("context", floats, ["g", 1, *size]),
        helper.make_tensor_value_info("context_index", TensorProto.INT64, ["n"]),
    ]
    outputs = [helper.make_tensor_value_info(name, floats, ["n", 3]) for name in ("mean", "std")]
    graph = helper.make_graph(nodes, "visual", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return bytes(model.SerializeToString())


def publish_visual(registry: Registry) -> None:
    """Publish the visual graph as the champion of push-visual."""
    model = visual_model()
    pusher = np.array([[-0.08, 0.0, 0.0]], dtype=np.float32)
    context = np.zeros((1, 1, VISUAL_SIZE, VISUAL_SIZE), dtype=np.float32)
    mean, std, _ = OnnxPredictor(model, expected_inputs(ContextKind.VISUAL), OUTPUTS).predict(
        pusher, (context,), np.zeros(1, dtype=np.int64)
    )
    rows = context.reshape(1, -1).tolist()
    check = SelfCheck(pusher.tolist(), rows, [0], mean.tolist(), std.tolist(), 1e-4)
    manifest = replace(draft_manifest("push-visual", ContextKind.VISUAL), self_check=check)
    version = registry.publish(manifest, model, "# push-visual\n").version
    registry.point_alias("push-visual", "champion", version)


def free_port() -> int:
    """Return a port without a listener."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def shipped_models(folder: Path) -> LoadedModels:
    """Load the shipped models from a copy in a folder, which have a model of every kind of context."""
    shutil.copytree(ROOT / "models", folder / "models")
    models = LoadedModels(Registry(folder / "models"), OnnxPredictor)
    models.refresh()
    return models


@contextmanager
def serve(folder: Path, **settings: object) -> Iterator[tuple[int, subprocess.Popen[bytes]]]:
    """Run a service over the shipped models and a visual one of constants.

    Yield its port and process. Expect exit status 0.
    """
    shutil.copytree(ROOT / "models", folder / "models")
    publish_visual(Registry(folder / "models"))
    folder.chmod(0o755)  # a container runs as another user
    port = free_port()
    environment = {"CAZSL_PORT": str(port), "CAZSL_REGISTRY": str(folder / "models"), "CAZSL_LOG_LEVEL": "WARNING"}
    environment |= {f"CAZSL_{name.upper()}": str(value) for name, value in settings.items()}
    command = _command(environment | {"CAZSL_HOST": "127.0.0.1"}, folder)
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=ROOT, env={**os.environ, **environment}, stdout=log, stderr=log)
    try:
        _wait_until_ready(process, port, folder / "log")
        yield port, process
        process.terminate()
        assert process.wait(PATIENCE_S) == 0, (folder / "log").read_text()
    finally:
        process.kill()
        process.wait()


@contextmanager
def serve_in_thread(models: LoadedModels, **settings: Any) -> Iterator[httpx2.Client]:
    """Run a service over these models, which may be fakes, in a thread of this process. Yield a client."""
    chosen = Settings(poll_interval_s=3600, **settings)
    app = create_app(chosen, models, RequestLog(io.StringIO()))
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_config=None, access_log=False, http=app.connections))
    thread = Thread(target=server.run)
    thread.start()
    try:
        wait_until(lambda: server.started)
        port = server.servers[0].sockets[0].getsockname()[1]
        with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
            yield client
    finally:
        server.should_exit = True
        thread.join()


def _command(environment: dict[str, str], folder: Path) -> list[str]:
    """Return the command that starts a service: this interpreter, or the container of ``CAZSL_TEST_CONTAINER``."""
    container = os.environ.get("CAZSL_TEST_CONTAINER")
    if container is None:
        return [sys.executable, "-c", "from service.cli.main import main; main()", "serve"]
    settings = " ".join(f"--env {shlex.quote(f'{name}={value}')}" for name, value in environment.items())
    return shlex.split(container.format(settings=settings, folder=folder))


def is_ready(port: int) -> bool:
    """Return whether /readyz answers with 200 on a new connection."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()


def rss_mib(process: subprocess.Popen[bytes]) -> float:
    """Return the resident memory of a process in MiB."""
    pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def wait_until(condition: Callable[[], bool]) -> None:
    """Poll until a condition holds, for a minute at most."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "the condition did not hold within a minute"
        time.sleep(0.02)


def _wait_until_ready(process: subprocess.Popen[bytes], port: int, log: Path) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_ready(port):
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < end, log.read_text()
        time.sleep(0.05)
