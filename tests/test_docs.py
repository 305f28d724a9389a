"""Code blocks of docs/api.md and docs/client.md, run in the order of the page against a service process."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from service import errors
from tests.documented_api import listed_errors
from tests.running_service import ROOT, serve

PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(sh|python)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)

CLIENT_BLOCKS = re.findall(
    r"^```python\n(.*?)^```$", (ROOT / "docs" / "client.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Run a service. Return its port."""
    with serve(tmp_path_factory.mktemp("docs")) as (found, _):
        yield found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working folder with the image of the examples."""
    grey = np.zeros((64, 64), dtype=np.uint8)
    grey[20:44, 20:44] = 128
    Image.fromarray(grey).save(tmp_path / "view.png")
    return tmp_path


def run(command: list[str], code: str, folder: Path) -> str:
    """Run a command with code on standard input. Check that it succeeds, and return its output."""
    done = subprocess.run(command, input=code, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def test_every_shell_block_prints_json(port: int, folder: Path) -> None:
    """Every shell block of docs/api.md succeeds and prints JSON. Its curl fails on a status that is not a success."""
    blocks = [code for language, code in BLOCKS if language == "sh"]
    assert len(blocks) == 5
    for code in blocks:
        printed = run(["bash", "-e"], code.replace("localhost:8000", f"127.0.0.1:{port}"), folder)
        assert printed.startswith("{"), code


def test_every_python_block_runs(port: int, folder: Path) -> None:
    """The Python blocks of docs/api.md run as one program, because later blocks use the variables of earlier ones."""
    blocks = [code for language, code in BLOCKS if language == "python"]
    assert len(blocks) == 5
    printed = run([sys.executable, "-"], "\n".join(blocks).replace("localhost:8000", f"127.0.0.1:{port}"), folder)
    assert "turns the object least" in printed
    assert (folder / "seen.png").exists()


def test_every_line_about_the_client_runs(port: int, folder: Path) -> None:
    """The code blocks of docs/client.md run as one program, in a folder with the shipped models."""
    assert len(CLIENT_BLOCKS) == 10
    (folder / "models").symlink_to(ROOT / "models")
    code = "\n".join(CLIENT_BLOCKS).replace("localhost:8000", f"127.0.0.1:{port}")
    command = [sys.executable, "-W", "error", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}"]
    printed = run(command, "", folder)
    assert "422 invalid_request body.pusher.x" in printed
    assert "world" in printed


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
