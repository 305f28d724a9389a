"""Who may import whom, held over the source tree."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SERVICE: dict[str, set[str]] = {
    "errors": set(),
    "contract": {"errors"},
    "canonical": set(),
    "manifest": {"canonical", "errors", "contract"},
    "history": {"errors"},
    "storage": {"history"},
    "disk": {"errors"},
    "folder_writer": {"errors", "history", "manifest", "disk"},
    "folder": {"errors", "history", "manifest", "storage", "disk", "folder_writer"},
    "verification": {"errors", "manifest", "storage"},
    "registry": {"errors", "history", "manifest", "storage", "folder", "verification"},
    "image_files": {"errors"},
    "stopwatch": set(),
    "images": {"errors", "contract", "image_files", "stopwatch"},
    "graph": {"errors"},
    "predictor": {"errors", "contract", "manifest", "graph"},
    "frames": set(),
    "self_check": {"errors", "contract", "manifest", "predictor"},
    "tally": set(),
    "loaded_models": {
        "errors",
        "contract",
        "frames",
        "history",
        "manifest",
        "registry",
        "predictor",
        "self_check",
        "stopwatch",
        "tally",
    },
    "readiness": {"errors", "loaded_models", "self_check"},
    "schemas": set(),
    "object_bodies": {"errors", "contract", "images", "schemas"},
    "catalogue": {"loaded_models", "manifest", "schemas"},
    "rows": {"frames"},
    "requests": {"errors", "contract", "frames", "manifest", "object_bodies", "rows", "schemas"},
    "uploads": {"errors"},
    "predictions": {"errors", "contract", "frames", "images", "loaded_models", "object_bodies", "requests", "uploads"},
    "tensors": {"errors", "manifest"},
    "inference": {"errors", "contract", "frames", "loaded_models", "manifest", "predictions", "requests", "tensors"},
    "keys": {"errors"},
    "workers": {"errors", "stopwatch"},
    "settings": set(),
    "configuration": {"errors", "settings"},
    "metrics": {"stopwatch"},
    "telemetry": {"stopwatch"},
    "problems": {"errors", "schemas", "telemetry"},
    "documented_requests": {"object_bodies", "uploads"},
    "examples": {"errors", "problems"},
    "access": {"errors", "keys", "loaded_models", "predictions", "readiness", "workers"},
    "routes": {
        "access",
        "catalogue",
        "documented_requests",
        "errors",
        "examples",
        "loaded_models",
        "object_bodies",
        "predictions",
        "requests",
        "schemas",
        "uploads",
    },
    "inference_bodies": {"schemas", "tensors"},
    "open_inference": {
        "access",
        "documented_requests",
        "errors",
        "examples",
        "inference",
        "inference_bodies",
        "manifest",
        "predictions",
        "tensors",
    },
    "documentation": set(),
    "intake": {"errors", "keys", "problems"},
    "monitoring": {"access", "metrics"},
    "short_way": {"errors", "fast_path", "inference", "intake", "predictions", "telemetry", "turns"},
    "connections": {"fast_path", "problems", "short_way"},
    "server": {"connections"},
    "vitals": {"intake", "loaded_models", "metrics", "readiness", "workers"},
    "turns": {"contract", "predictions", "stopwatch"},
    "fast_path": {
        "errors",
        "inference",
        "intake",
        "keys",
        "loaded_models",
        "predictions",
        "problems",
        "requests",
        "turns",
        "uploads",
        "workers",
    },
    "app": {
        "access",
        "documentation",
        "errors",
        "examples",
        "fast_path",
        "inference_bodies",
        "intake",
        "keys",
        "loaded_models",
        "metrics",
        "monitoring",
        "open_inference",
        "problems",
        "readiness",
        "routes",
        "schemas",
        "settings",
        "short_way",
        "telemetry",
        "vitals",
        "workers",
    },
    "in_process": {
        "catalogue",
        "errors",
        "loaded_models",
        "location",
        "object_bodies",
        "predictions",
        "predictor",
        "problems",
        "requests",
        "uploads",
    },
    "client_errors": {"errors"},
    "retries": set(),
    "calls": {"client_errors", "errors", "object_bodies", "schemas"},
    "caller": {"calls", "client_errors", "retries"},
    "async_client": {"caller", "calls", "in_process", "retries", "schemas"},
    "client": {
        "async_client",
        "caller",
        "calls",
        "client_errors",
        "in_process",
        "object_bodies",
        "retries",
        "schemas",
    },
    "gates": {"contract", "manifest", "loaded_models"},
    "doctor": {"errors", "storage", "registry", "loaded_models"},
    "cache": {"errors", "manifest", "disk"},
    "bucket": {"errors"},
    "object_store": {"errors", "history", "manifest", "storage", "bucket", "cache", "folder_writer"},
    "signatures": {"errors"},
    "location": {"errors", "storage", "verification", "registry", "object_store", "signatures"},
    "tracing": {"telemetry"},
    "terminal": {"configuration", "errors"},
    "config_cli": {"configuration", "errors", "terminal"},
    "workforce": {"errors"},
    "new_file": {"errors"},
    "bulk": {
        "errors",
        "contract",
        "frames",
        "loaded_models",
        "manifest",
        "predictor",
        "requests",
        "self_check",
    },
    "parquet_file": {"bulk", "contract", "errors", "manifest"},
    "bulk_prediction": {"bulk", "contract", "new_file", "parquet_file", "workforce"},
    "bulk_cli": {
        "bulk",
        "bulk_prediction",
        "errors",
        "loaded_models",
        "manifest",
        "parquet_file",
        "registry",
        "workers",
        "workforce",
    },
    "models_cli": {
        "errors",
        "history",
        "manifest",
        "storage",
        "registry",
        "predictor",
        "loaded_models",
        "doctor",
        "location",
        "terminal",
    },
    "changes_cli": {
        "errors",
        "history",
        "manifest",
        "registry",
        "predictor",
        "loaded_models",
        "gates",
        "location",
        "models_cli",
        "signatures",
        "terminal",
    },
    "cli": {
        "bulk_cli",
        "connections",
        "errors",
        "contract",
        "keys",
        "predictor",
        "loaded_models",
        "location",
        "object_bodies",
        "predictions",
        "requests",
        "config_cli",
        "server",
        "telemetry",
        "terminal",
        "tracing",
        "app",
        "models_cli",
        "changes_cli",
    },
}
OUTSIDE: dict[str, set[str]] = {
    "errors": set(),
    "contract": {"numpy"},
    "canonical": set(),
    "manifest": set(),
    "history": set(),
    "storage": set(),
    "disk": set(),
    "folder_writer": set(),
    "folder": set(),
    "verification": set(),
    "registry": set(),
    "image_files": set(),
    "images": {"numpy", "PIL"},
    "graph": {"google", "onnx"},
    "predictor": {"numpy", "onnxruntime"},
    "stopwatch": set(),
    "self_check": {"numpy"},
    "tally": set(),
    "loaded_models": {"numpy"},
    "readiness": set(),
    "frames": {"numpy"},
    "schemas": {"pydantic"},
    "object_bodies": {"numpy", "pydantic"},
    "rows": {"numpy", "pydantic", "pydantic_core"},
    "requests": {"numpy", "orjson", "pydantic"},
    "uploads": {"pydantic_core", "starlette"},
    "predictions": {"numpy", "orjson"},
    "tensors": {"numpy", "orjson", "pydantic"},
    "inference": {"numpy"},
    "keys": set(),
    "workers": set(),
    "settings": {"pydantic", "pydantic_settings"},
    "configuration": {"pydantic", "pydantic_settings"},
    "metrics": {"numpy", "prometheus_client"},
    "monitoring": {"fastapi", "prometheus_client"},
    "server": {"uvicorn"},
    "vitals": set(),
    "tracing": {"opentelemetry", "starlette"},
    "telemetry": {"orjson", "starlette", "pythonjsonlogger"},
    "problems": {"fastapi", "orjson", "starlette"},
    "documented_requests": set(),
    "examples": set(),
    "access": {"fastapi"},
    "routes": {"fastapi", "pydantic", "pydantic_core"},
    "inference_bodies": {"numpy", "pydantic"},
    "open_inference": {"fastapi", "pydantic"},
    "documentation": {"fastapi"},
    "intake": {"starlette"},
    "short_way": {"pydantic", "starlette"},
    "connections": {"starlette", "uvicorn"},
    "turns": {"numpy"},
    "fast_path": {"pydantic", "starlette"},
    "app": {"fastapi", "starlette"},
    "catalogue": {"pydantic_core"},
    "in_process": {"httpx2", "pydantic", "pydantic_core", "starlette"},
    "client_errors": set(),
    "retries": set(),
    "calls": {"numpy", "orjson", "pydantic"},
    "caller": {"httpx2"},
    "async_client": {"httpx2", "numpy"},
    "client": {"httpx2", "numpy"},
    "gates": {"numpy"},
    "doctor": set(),
    "cache": set(),
    "bucket": {"obstore"},
    "object_store": set(),
    "signatures": {"model_signing"},
    "location": set(),
    "terminal": {"click"},
    "workforce": set(),  # ray by its name, when it is asked for
    "new_file": set(),
    "bulk": {"numpy"},
    "parquet_file": {"numpy", "pyarrow"},
    "bulk_prediction": {"pyarrow"},
    "bulk_cli": {"click"},
    "models_cli": {"click"},
    "changes_cli": {"click"},
    "config_cli": {"click"},
    "cli": {"click", "prometheus_client", "pydantic", "starlette", "uvicorn"},
}
TRAINING_TAKES = {"errors", "contract", "manifest", "registry", "images", "predictor", "workforce"}


def imported(path: Path) -> set[str]:
    """Every module that a file imports, functions included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative import"
            module = node.module or ""
            found |= {f"{module}.{alias.name}" if module in ("service", "training") else module for alias in node.names}
    return found


def rooms(modules: set[str], package: str) -> set[str]:
    """The rooms of one package among imported modules."""
    return {module.split(".")[1] for module in modules if module.startswith(package + ".")}


def files(project_root: Path, package: str) -> list[Path]:
    """The source files of a package."""
    return sorted(path for path in (project_root / package).rglob("*.py"))


def test_every_room_of_the_service_has_its_place_in_the_table(project_root: Path) -> None:
    """A new room is a decision: it is added to the tables above."""
    found = {path.stem for path in files(project_root, "service")} - {"__init__"}
    assert found == set(SERVICE) == set(OUTSIDE)


@pytest.mark.parametrize("room", SERVICE)
def test_a_room_of_the_service_imports_only_what_stands_below_it(project_root: Path, room: str) -> None:
    """Imports inside the service point one way."""
    assert rooms(imported(project_root / "service" / f"{room}.py"), "service") <= SERVICE[room]


@pytest.mark.parametrize("room", OUTSIDE)
def test_a_room_of_the_service_uses_only_its_own_libraries(project_root: Path, room: str) -> None:
    """Each library has its rooms: onnxruntime one, the web framework the upper ones, the core none."""
    modules = {module.split(".")[0] for module in imported(project_root / "service" / f"{room}.py")}
    assert modules - set(sys.stdlib_module_names) - {"service"} <= OUTSIDE[room]


def test_the_tables_have_no_cycle() -> None:
    """Every room can be placed below those that import it."""
    placed: set[str] = set()
    while len(placed) < len(SERVICE):
        ready = {room for room, below in SERVICE.items() if room not in placed and below <= placed}
        assert ready, f"a cycle among {set(SERVICE) - placed}"
        placed |= ready


def test_the_rooms_of_the_trainer_have_no_cycle(project_root: Path) -> None:
    """Each can be placed below those that import it: imports inside the trainer point one way too."""
    rooms_below = {
        path.stem if path.stem != "__init__" else path.parent.name: rooms(imported(path), "training")
        for path in files(project_root, "training")
    }
    placed: set[str] = set()
    while set(rooms_below) - placed:
        ready = {room for room, below in rooms_below.items() if room not in placed and below - {room} <= placed}
        assert ready, f"a cycle among {set(rooms_below) - placed}"
        placed |= ready


def test_the_trainer_takes_only_the_shared_rooms_of_the_service(project_root: Path) -> None:
    """Training uses the service's core and nothing of its web side."""
    for path in files(project_root, "training"):
        assert rooms(imported(path), "service") - {"__version__"} <= TRAINING_TAKES, path.name


def test_serving_loads_neither_torch_nor_the_trainer(project_root: Path) -> None:
    """A fresh interpreter that imports the app and the command line has no torch, no trainer, no pickle loader."""
    code = "import sys, service.app, service.cli.main; print(sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    modules = set(ast.literal_eval(done.stdout))
    loaded = {module.split(".")[0] for module in modules}
    assert not modules & {"opentelemetry.sdk", "opentelemetry.exporter"}  # its interface is FastAPI's to import
    assert "service" in loaded
    assert not loaded & {"torch", "training", "mujoco", "safetensors", "obstore", "model_signing", "pyarrow", "ray"}


def test_a_client_of_a_service_loads_no_part_of_one(project_root: Path) -> None:
    """Who asks over HTTP has neither the runtime nor the web framework nor torch in memory."""
    code = "import sys, service.client; print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stdout))
    assert "httpx2" in loaded
    assert not loaded & {"torch", "training", "onnx", "onnxruntime", "fastapi", "starlette", "uvicorn", "click"}


def test_nothing_happens_at_import(project_root: Path) -> None:
    """Importing every room of the service writes nothing, starts no thread and reads no setting."""
    code = (
        "import importlib, threading, os; os.environ['CAZSL_PORT'] = 'nonsense';"
        f"[importlib.import_module('service.' + room) for room in {sorted(SERVICE)}];"
        "print(threading.active_count())"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
    assert done.stderr == ""
