"""Commands of ``cazsl models``, run in this process for tests."""

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from service.cli.main import main

NAME = "push-indicator"


def run(registry: Path, *arguments: str) -> Result:
    """Run one command of ``cazsl models`` on a registry."""
    return CliRunner().invoke(main, ["models", *arguments], env={"CAZSL_REGISTRY": str(registry)})


def document(registry: Path, *arguments: str, status: int = 0) -> Any:
    """Run a command with --json, check its exit status, and return the document."""
    result = run(registry, *arguments, "--json")
    assert result.exit_code == status, result.output
    return json.loads(result.stdout)


def force(registry: Path, version: int, *arguments: str) -> Result:
    """Promote a version past the gates that it does not pass."""
    return run(registry, "promote", NAME, str(version), "--force", "--reason", "trial", *arguments)
