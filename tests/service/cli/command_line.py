"""Commands of ``cazsl models``, run in this process for tests."""

import contextlib
import json
import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from service.cli.main import main

ROOT = Path(__file__).resolve().parents[3]
NAME = "push-indicator"


def run(registry: Path, *arguments: str) -> Result:
    """Run one command of ``cazsl models`` on a registry."""
    return CliRunner().invoke(main, ["models", *arguments], env={"CAZSL_REGISTRY": str(registry)})


def at_a_terminal(registry: Path, answer: str, *arguments: str) -> tuple[int, str]:
    """Run one command of ``cazsl models`` at a terminal of its own. Return its exit status and the printed text."""
    user, terminal = pty.openpty()
    os.write(user, answer.encode())
    process = subprocess.Popen(
        [sys.executable, "-c", "from service.cli.main import main; main()", "models", *arguments],
        env=os.environ | {"CAZSL_REGISTRY": str(registry)},
        cwd=ROOT,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
    )
    os.close(terminal)
    printed = b""
    with contextlib.suppress(OSError):  # the last process has closed the terminal
        while part := os.read(user, 4096):
            printed += part
    os.close(user)
    return process.wait(), printed.decode().replace("\r\n", "\n")


def document(registry: Path, *arguments: str, status: int = 0) -> Any:
    """Run a command with --json, check its exit status, and return the document."""
    result = run(registry, *arguments, "--json")
    assert result.exit_code == status, result.output
    return json.loads(result.stdout)


def force(registry: Path, version: int, *arguments: str) -> Result:
    """Promote a version past the gates that it does not pass."""
    return run(registry, "promote", NAME, str(version), "--force", "--reason", "trial", *arguments)
