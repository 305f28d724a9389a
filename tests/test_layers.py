"""The architecture: which package may import which, and which libraries each may use (docs/architecture.md)."""

import ast
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

# For each package the packages that it may import. The root modules of the service count as packages of one module.
PACKAGES: Mapping[str, frozenset[str]] = {
    package: frozenset(below.split())
    for package, below in {
        "service.errors": "",
        "service.settings": "service.model",
        "service.files": "",
        "service.processors": "",
        "service.turns": "",
        "service.background": "",
        "service.observability": "service.background",
        "service.model": "service.errors service.turns service.processors",
        "service.pushing": "service.errors service.turns service.model",
        "service.silhouettes": "service.errors service.turns service.pushing",
        "service.validity": "service.turns service.model service.pushing",
        "service.planning": "service.errors service.turns service.model service.pushing",
        "service.storage": "service.errors service.model",
        "service.registry": "service.errors service.files service.model service.pushing service.storage",
        "service.schemas": "service.errors service.model service.pushing service.silhouettes service.validity",
        "service.schemas.planning": "service.errors service.pushing service.validity service.planning service.schemas",
        "service.inference": "service.errors service.turns service.model service.pushing service.validity "
        "service.planning "
        "service.storage service.registry service.background service.observability",
        "service.transport": "service.errors service.files service.turns service.processors service.inference "
        "service.schemas service.background service.observability",
        "service.connections": "service.errors service.transport",
        "service.bulk": "service.errors service.files service.model service.pushing service.storage service.schemas "
        "service.inference service.validity",
        "service.api": "service.errors service.inference service.schemas service.background service.observability "
        "service.transport",
        "service.api.v1": "service.errors service.turns service.model service.pushing service.silhouettes "
        "service.validity "
        "service.inference service.schemas service.observability service.transport service.api",
        "service.api.planning": "service.errors service.turns service.model service.pushing service.validity "
        "service.planning service.inference service.schemas service.schemas.planning service.transport service.api "
        "service.api.v1",
        "service.api.open_inference": "service.errors service.model service.pushing service.inference service.schemas "
        "service.transport service.api",
        "service.app": "service.errors service.settings service.inference service.schemas service.background "
        "service.observability service.transport service.connections service.api service.api.v1 "
        "service.api.open_inference service.api.planning",
        "service.client": "service.errors service.model service.schemas service.schemas.planning",
        "service.cli": "service.errors service.settings service.files service.processors service.background "
        "service.observability service.model service.storage service.registry service.validity service.schemas "
        "service.inference "
        "service.transport service.bulk service.api.v1 service.connections service.app",
        "training.omnipush": "service.errors service.files service.model service.pushing service.storage",
        "training.tables": "service.errors service.files service.pushing service.bulk training.omnipush",
        "training.simulation": "service.errors service.processors service.pushing training.omnipush training.tables",
        "training.shapes": "service.errors service.pushing service.bulk training.omnipush training.tables "
        "training.simulation",
        "training.environments": "service.errors service.pushing service.planning training.simulation training.shapes",
        "training.networks": "service.model service.pushing training.omnipush",
        "training.inspection": "service.errors service.pushing service.storage training.omnipush training.simulation",
        "training.inspection.tables": "service.errors service.pushing service.storage training.inspection "
        "training.omnipush training.tables",
        "training.fitting": "service.errors service.files service.model service.pushing service.storage "
        "training.omnipush training.tables training.networks",
        "training.publishing": "service.errors service.model service.pushing service.registry training.omnipush "
        "training.tables training.networks training.fitting",
        "training.paper": "service.errors service.files service.model service.storage service.bulk training.omnipush "
        "training.networks training.fitting",
        "training.recipes": "",
        "training.cli": "service.errors service.files service.processors service.model service.registry service.bulk "
        "service.cli training.omnipush training.tables training.simulation training.shapes training.networks "
        "training.inspection training.inspection.tables training.fitting training.publishing training.paper",
    }.items()
}
# Modules that import more than their package may: the transport of ``Client.local``, which answers in this process.
EXCEPTIONS: Mapping[str, frozenset[str]] = {
    "service.client.local": frozenset(
        (
            "service.inference",
            "service.registry",
            "service.transport",
            "service.api.v1",
            "service.api.planning",
            *PACKAGES["service.client"],
        )
    )
}
# Of the lower packages the trainer takes these modules only.
TRAINING_TAKES: Mapping[str, str | tuple[str, ...]] = {
    "service.storage": "service.storage.disk",
    "service.bulk": ("service.bulk.executors", "service.bulk.parquet_pages"),
    "service.cli": ("service.cli.terminal", "service.cli.command_line"),
}
# Libraries that every module of some packages may use.
LIBRARIES: Mapping[str, frozenset[str]] = {
    package: frozenset(libraries.split())
    for package, libraries in {
        "service.settings": "pydantic pydantic_settings",
        "service.observability": "numpy orjson prometheus_client pythonjsonlogger starlette",
        "service.model": "numpy",
        "service.pushing": "numpy",
        "service.silhouettes": "numpy",
        "service.validity": "numpy",
        "service.planning": "numpy",
        "service.schemas": "numpy orjson pydantic pydantic_core",
        "service.schemas.planning": "numpy pydantic",
        "service.inference": "numpy",
        "service.transport": "orjson starlette",
        "service.connections": "httptools starlette uvicorn",
        "service.bulk": "numpy pyarrow",
        "service.api": "fastapi prometheus_client starlette",
        "service.api.v1": "numpy orjson pydantic_core starlette",
        "service.api.open_inference": "numpy orjson pydantic",
        "service.api.planning": "numpy orjson",
        "service.app": "fastapi starlette",
        "service.client": "httpx2 numpy orjson pydantic",
        "service.cli": "click pydantic pydantic_settings",
        "training.omnipush": "numpy tqdm",
        "training.tables": "numpy pyarrow tqdm",
        "training.shapes": "matplotlib numpy shapely tqdm",
        "training.simulation": "mujoco numpy tqdm",
        "training.environments": "mujoco numpy",
        "training.networks": "torch",
        "training.inspection": "matplotlib numpy tqdm",
        "training.inspection.tables": "matplotlib numpy tqdm",
        "training.fitting": "numpy safetensors torch tqdm",
        "training.publishing": "numpy torch",
        "training.paper": "matplotlib numpy torch tqdm",
        "training.cli": "click torch",
    }.items()
}
# Libraries with a single home in the service or the trainer.
HOMES: Mapping[str, frozenset[str]] = {
    module: frozenset(libraries.split())
    for module, libraries in {
        "service.model.manifest": "pydantic",
        "service.model.predictor": "onnxruntime",
        "service.model.onnx_graph": "onnx google",
        "service.pushing.image_files": "PIL",
        "service.pushing.images": "PIL",
        "service.pushing.image_quality": "PIL",
        "service.silhouettes.planes": "PIL",
        "service.silhouettes.tracing": "contourpy",
        "service.storage.bucket": "obstore",
        "service.registry.signing": "model_signing",
        "service.observability.tracing": "opentelemetry",
        "service.transport.draining": "uvicorn",
        "service.api.v1.routes": "fastapi",
        "service.api.v1.uploads": "python_multipart",
        "service.api.open_inference.routes": "fastapi",
        "service.api.planning.routes": "fastapi",
        "service.cli.serve": "starlette uvicorn",
        "training.publishing.onnx_export": "onnx",
        "training.environments.environment": "gymnasium",
        "training.environments.pictures": "PIL",
        "training.simulation.camera": "PIL",
        "training.simulation.pieces": "shapely",
    }.items()
}
LARGEST_PACKAGE = 13


def modules(project_root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the name and the file of every module, without the files that only open a package."""
    for top in ("service", "training"):
        for path in sorted((project_root / top).rglob("*.py")):
            if path.stem != "__init__":
                yield ".".join(path.relative_to(project_root).with_suffix("").parts), path


def package_of(module: str) -> str:
    """Return the package of a module; a root module of the service is its own."""
    return module if module in PACKAGES else module.rpartition(".")[0]


def imported(path: Path) -> set[str]:
    """Return every module that a file imports, functions included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: relative import"
            module = node.module or ""
            is_package = module in PACKAGES or module in ("service", "training")
            found |= {
                f"{module}.{alias.name}" if is_package and _is_module(path, module, alias.name) else module
                for alias in node.names
            }
    return found


def _is_module(path: Path, package: str, name: str) -> bool:
    root = next(parent for parent in path.parents if (parent / "pyproject.toml").is_file())
    return (root / package.replace(".", "/") / f"{name}.py").is_file()


def of_ours(names: set[str]) -> set[str]:
    """Return the modules of the project among imported ones; the version of the service is no module."""
    return {name for name in names if name.startswith(("service.", "training."))}


def test_every_package_stands_in_the_table(project_root: Path) -> None:
    """A new package is a decision: it is added to the table, and to docs/architecture.md."""
    found = {package_of(module) for module, _ in modules(project_root)}
    assert found | {"training.recipes"} == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_packages_below_it(project_root: Path, package: str) -> None:
    """Imports between packages point one way."""
    for module, path in modules(project_root):
        if package_of(module) == package:
            allowed = EXCEPTIONS.get(module, PACKAGES[package]) | {package}
            assert {package_of(name) for name in of_ours(imported(path))} <= allowed, module


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_uses_only_its_own_libraries(project_root: Path, package: str) -> None:
    """Each library has its place: onnxruntime one module, the web framework the upper packages, the core none."""
    for module, path in modules(project_root):
        if package_of(module) == package:
            libraries = {name.split(".")[0] for name in imported(path)} - set(sys.stdlib_module_names)
            allowed = LIBRARIES.get(package, frozenset()) | HOMES.get(module, frozenset())
            assert libraries - {"service", "training"} <= allowed, module


def test_the_table_has_no_cycle() -> None:
    """Every package can be placed above those that it imports."""
    placed: set[str] = set()
    while len(placed) < len(PACKAGES):
        ready = {package for package, below in PACKAGES.items() if package not in placed and below <= placed}
        assert ready, f"a cycle among {set(PACKAGES) - placed}"
        placed |= ready


@pytest.mark.parametrize("package", [package for package in PACKAGES if "." in package])
def test_the_modules_of_a_package_have_no_cycle(project_root: Path, package: str) -> None:
    """Every module can be placed above those of its package that it imports."""
    below = {
        module: {name for name in imported(path) if package_of(name) == package and name != package}
        for module, path in modules(project_root)
        if package_of(module) == package
    }
    placed: set[str] = set()
    while len(placed) < len(below):
        ready = {module for module, needed in below.items() if module not in placed and needed <= placed}
        assert ready, f"a cycle among {set(below) - placed}"
        placed |= ready


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_is_small_and_says_what_is_in_it(project_root: Path, package: str) -> None:
    """A newcomer finds the line to change from the names of folders, and a sentence in each."""
    folder = project_root / package.replace(".", "/")
    if folder.is_dir():
        assert len([path for path in folder.glob("*.py") if path.stem != "__init__"]) <= LARGEST_PACKAGE
        assert len(ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or "") > 80


def test_no_module_is_longer_than_300_lines(project_root: Path) -> None:
    """A module past 300 lines is two modules."""
    lengths = {module: len(path.read_text(encoding="utf-8").splitlines()) for module, path in modules(project_root)}
    assert {module: length for module, length in lengths.items() if length > 300} == {}


def test_tests_mirror_modules(project_root: Path) -> None:
    """The test of service/storage/disk.py is tests/service/storage/test_disk.py."""
    known = {path.relative_to(project_root) for _, path in modules(project_root)}
    for top in ("service", "training"):
        for path in sorted((project_root / "tests" / top).rglob("test_*.py")):
            mirrored = path.relative_to(project_root / "tests").with_name(path.name.removeprefix("test_"))
            assert mirrored in known, f"{path.relative_to(project_root)} tests no module"


def test_the_trainer_takes_only_shared_modules_of_the_service(project_root: Path) -> None:
    """Training uses the core of the service, and none of its web side."""
    for module, path in modules(project_root):
        if module.startswith("training."):
            for name in of_ours(imported(path)):
                assert name.startswith(TRAINING_TAKES.get(package_of(name), name)), f"{module} imports {name}"


def loaded_by(project_root: Path, code: str) -> set[str]:
    """Return the modules that a fresh interpreter has loaded after some code."""
    code = f"import sys; {code}; print(sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    return set(ast.literal_eval(done.stdout))


def test_serving_loads_neither_torch_nor_the_trainer(project_root: Path) -> None:
    """A fresh interpreter that imports the app and the command line has no torch, no trainer, no pickle loader."""
    names = loaded_by(project_root, "import service.app, service.cli.main")
    loaded = {name.split(".")[0] for name in names}
    assert not names & {"opentelemetry.sdk", "opentelemetry.exporter"}  # FastAPI itself imports the interface
    assert "service" in loaded
    assert not loaded & {"torch", "training", "mujoco", "safetensors", "obstore", "model_signing", "pyarrow", "ray"}


def test_a_client_of_a_service_loads_no_part_of_one(project_root: Path) -> None:
    """A client over HTTP has neither the runtime nor the web framework nor torch in memory."""
    loaded = {name.split(".")[0] for name in loaded_by(project_root, "import service.client")}
    assert "httpx2" in loaded
    assert not loaded & {"torch", "training", "onnx", "onnxruntime", "fastapi", "starlette", "uvicorn", "click"}


def test_importing_a_module_of_the_service_has_no_effect(project_root: Path) -> None:
    """Importing every module of the service writes no file, starts no thread and reads no setting."""
    names = [module for module, _ in modules(project_root) if module.startswith("service.")]
    code = (
        "import importlib, threading, os; os.environ['CAZSL_PORT'] = 'nonsense';"
        f"[importlib.import_module(name) for name in {names}];"
        "print(threading.active_count())"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
    assert done.stderr == ""
