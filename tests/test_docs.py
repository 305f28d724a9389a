"""Code blocks of the pages in docs/, run in the order of the page, against a service process where there is a need."""

import contextlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from PIL import Image

from service import errors
from service.cli.main import main
from service.model.reference import ModelReference
from service.registry.registry import Registry
from tests.documented_api import listed_errors
from tests.running_service import ROOT, free_port, serve

PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(sh|python)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)

CLIENT_BLOCKS = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs" / "client.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)

PLANNING_BLOCKS = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs" / "planning.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Run a service. Return its port."""
    with serve(tmp_path_factory.mktemp("docs")) as (found, _):
        yield found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working folder with the image of the examples."""
    shutil.copy(ROOT / "docs" / "images" / "view.png", tmp_path)
    return tmp_path


def run(command: list[str], code: str, folder: Path, environment: dict[str, str] | None = None) -> str:
    """Run a command with code on standard input. Check that it succeeds, and return its output."""
    done = subprocess.run(command, input=code, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, code + done.stderr + done.stdout
    return done.stdout


def test_every_shell_block_prints_json(port: int, folder: Path) -> None:
    """Every shell block of docs/api.md succeeds and prints JSON. Its curl fails on a status that is not a success."""
    blocks = [code for language, code in BLOCKS if language == "sh"]
    assert len(blocks) == 9
    for code in blocks:
        printed = run(["bash", "-e"], code.replace("localhost:8000", f"127.0.0.1:{port}"), folder)
        assert printed.startswith("{"), code


def test_every_python_block_runs(port: int, folder: Path) -> None:
    """The Python blocks of docs/api.md run as one program, because later blocks use the variables of earlier ones."""
    blocks = [code for language, code in BLOCKS if language == "python"]
    assert len(blocks) == 9
    printed = run([sys.executable, "-"], "\n".join(blocks).replace("localhost:8000", f"127.0.0.1:{port}"), folder)
    assert "turns the object least" in printed
    assert (folder / "seen.png").exists()


def test_every_line_about_the_client_runs(port: int, folder: Path) -> None:
    """The code blocks of docs/client.md run as one program, in a folder with the shipped models."""
    assert len(CLIENT_BLOCKS) == 13
    shutil.copytree(ROOT / "models", folder / "models")
    printed = run_python("\n".join(CLIENT_BLOCKS), port, folder)
    assert "422 invalid_request body.pusher.x" in printed
    assert "world" in printed


def test_every_line_about_planning_runs(port: int, folder: Path) -> None:
    """The code blocks of docs/planning.md run as one program, but for those that are programs of their own."""
    blocks = [block for block in PLANNING_BLOCKS if not block.startswith(("import matplotlib", "import gymnasium"))]
    assert len(blocks) == 7
    printed = run_python("\n".join(blocks), port, folder)
    assert "turns the object least" in printed
    assert "touches something with probability 0.0" in printed
    assert "weight at [0.0" in printed


def test_the_program_from_a_photograph_to_three_pushes_draws_them(port: int, folder: Path) -> None:
    """The program of docs/planning.md that reads a photograph has about twenty lines, and writes a picture."""
    (program,) = (block for block in PLANNING_BLOCKS if block.startswith("import matplotlib"))
    assert len([line for line in program.splitlines() if line]) <= 20
    printed = run_python(program, port, folder)
    assert re.search(r"[1-3] pushes, at the goal with probability 0\.[5-9]", printed)
    with Image.open(folder / "plan.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10.0


def test_the_program_in_the_simulator_reaches_its_goal(port: int, folder: Path) -> None:
    """The program of docs/planning.md that plans again after each push has at most twenty lines."""
    pytest.importorskip("gymnasium", reason="the environment needs the extra gym")
    (program,) = (block for block in PLANNING_BLOCKS if block.startswith("import gymnasium"))
    assert len([line for line in program.splitlines() if line]) <= 20
    printed = run_python(program, port, folder)
    assert re.search(r"^\d+ pushes, \d+ mm from the goal, reached: True$", printed, re.MULTILINE), printed


def test_the_python_of_the_readme_plans_a_push(port: int, folder: Path) -> None:
    """The snippet of the README prints the first push of a plan."""
    (block,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert len(run_python(block, port, folder).strip("[] \n").split()) == 4


def run_python(code: str, port: int, folder: Path) -> str:
    """Run code against the service, with warnings as errors and without a display. Return its output."""
    path = f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"
    command = [sys.executable, "-W", "error", "-c", path + code.replace("localhost:8000", f"127.0.0.1:{port}")]
    return run(command, "", folder, {**os.environ, "MPLBACKEND": "Agg"})


def test_every_error_that_a_client_can_get_is_in_the_table() -> None:
    """The table of errors has the status and code of every error, but those that are never sent to clients."""
    known = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.CazslError)]
    never_sent = {
        errors.RequestError,
        errors.UnavailableError,
        errors.DataError,
        errors.SettingsError,
        errors.WorkforceError,
    }
    for kind in known:
        if kind not in never_sent and not issubclass(kind, errors.RegistryError):
            assert (int(kind.status), kind.code) in listed_errors(), kind


# Commands that a test cannot run: they need a network, a cluster, a container, hours, or run until they are stopped.
NOT_RUN = (
    "pip install",
    "docker ",
    "kubectl ",
    "export CAZSL_REGISTRY=s3:",
    "cazsl models push push-indicator@4 s3:",
    "cazsl-train reproduce",
    "CAZSL_TEST_CONTAINER=",
)
UNTIL_STOPPED = " cazsl serve"


def commands(page: str) -> list[str]:
    """Return the shell commands of a page, without those that a test cannot run."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    return [line for line in lines if not line.startswith(NOT_RUN) and "--ray" not in line]


@pytest.fixture
def workplace(tmp_path: Path) -> tuple[Path, dict[str, str]]:
    """Return a folder with the shipped models, one more version and a file of pushes, and an environment for cazsl."""
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "cazsl"
    command.write_text(f"#!{sys.executable}\nfrom service.cli.main import main\nmain()\n", encoding="utf-8")
    command.chmod(0o755)
    shutil.copytree(ROOT / "models", tmp_path / "models")
    registry = Registry(tmp_path / "models")
    champion = registry.read("push-indicator", registry.resolve(ModelReference.parse("push-indicator")))
    registry.publish(champion.manifest, champion.model, champion.card)
    columns = {"x_m": [-0.08], "y_m": [0.0], "angle_rad": [0.0], "descriptor": ["1a2b3c4a"]}
    pq.write_table(pa.table(columns), tmp_path / "pushes.parquet")
    path = f"{tmp_path / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    return tmp_path, {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


@pytest.mark.parametrize(("page", "count"), [("registry.md", 14), ("operations.md", 8)])
def test_every_command_of_a_page_runs_as_written(
    workplace: tuple[Path, dict[str, str]], monkeypatch: pytest.MonkeyPatch, page: str, count: int
) -> None:
    """The commands of a page succeed in its order, in a folder with models. Only the folder of keys is another one."""
    folder, environment = workplace
    monkeypatch.chdir(folder)
    found = commands(page)
    assert len(found) == count
    for line in (line.replace("/etc/cazsl", str(folder / "etc")) for line in found):
        if line.startswith("cazsl ") and ">" not in line:  # in this process, which has loaded the libraries
            result = CliRunner().invoke(main, shlex.split(line, comments=True)[1:])
            assert result.exit_code == 0, f"{line}\n{result.output}"
        elif UNTIL_STOPPED in line:
            starts_and_stops(line, environment)
        else:
            run(["bash", "-e"], line, folder, environment)


def starts_and_stops(line: str, environment: dict[str, str]) -> None:
    """Start a service by a command, wait until it answers, and end it in order."""
    variables, _, _ = line.partition("cazsl serve")
    port = free_port()
    command = ["bash", "-c", f"{variables} exec cazsl serve"]
    process = subprocess.Popen(command, env={**environment, "CAZSL_PORT": str(port)})
    try:
        for _ in range(600):
            with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/livez") as answer:
                assert answer.status == 200
                break
            time.sleep(0.1)
            assert process.poll() is None, line
        process.terminate()
        assert process.wait(60.0) == 0, line
    finally:
        process.kill()
        process.wait()
