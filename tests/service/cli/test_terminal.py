"""Output of commands: no control characters, no encoding that fails, and one module that writes."""

import ast
import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.cli.terminal import echo, echo_lines, print_json, printable

HOSTILE = [
    "\x1b[2J",
    "\x9b31m",
    "\u202egnp.",
    "\u2066",
    "a\nb",
    "a\rb",
    "\x07",
    "\x7f",
    "\u2028",
    "\ufeff",
    "\udcff",
    "\0",
]
WRITERS = {"echo", "secho", "echo_via_pager", "style", "confirm", "prompt", "pause", "clear"}


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_brings_a_control_character_to_the_terminal(capsys: pytest.CaptureFixture[str], text: str) -> None:
    """Every control, format and half character becomes an escape in ASCII, and a line stays one line."""
    echo(f"name {text} end")
    assert printable(text).isascii()
    (line,) = capsys.readouterr().out.splitlines()
    assert line.isprintable()
    assert line.startswith("name ")


def test_plain_text_is_printed_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """Letters of any language and signs stay. A card keeps its lines, and nothing else that is not printable."""
    echo("Überschub 推 ±3 mm")
    echo_lines("# card\n\n* one\x1b[31m\n")
    assert capsys.readouterr().out == "Überschub 推 ±3 mm\n# card\n\n* one\\x1b[31m\n\n"


@pytest.mark.parametrize("text", HOSTILE)
def test_json_is_ascii_and_holds_the_text(capsys: pytest.CaptureFixture[str], text: str) -> None:
    """A JSON document has every character as an escape, and is read back unchanged."""
    print_json({text: [text]})
    shown = capsys.readouterr().out
    assert shown.replace("\n", "").isprintable()
    assert shown.isascii()
    assert json.loads(shown) == {text: [text]}


@pytest.mark.parametrize("err", [False, True])
def test_a_stream_of_ascii_gets_escapes(monkeypatch: pytest.MonkeyPatch, err: bool) -> None:
    """Under LANG=C, a character that the stream cannot encode is an escape and no error."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stderr" if err else "stdout", io.TextIOWrapper(written, encoding="ascii"))
    echo("\N{GREEK SMALL LETTER SIGMA} = 1 mm", err)
    assert written.getvalue() == b"\\u03c3 = 1 mm\n"


def writers_of(path: Path) -> Iterator[str]:
    """Yield every call in a module that writes to a terminal by itself."""
    names = {"print", "sys.stdout.write", "sys.stderr.write", *(f"click.{name}" for name in WRITERS)}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in names:
            yield ast.unparse(node.func)


def test_no_other_module_writes_to_a_terminal(project_root: Path) -> None:
    """All output passes through one module, so that a new command cannot forget to escape."""
    found = {
        str(path.relative_to(project_root)): calls
        for top in ("service", "training")
        for path in sorted((project_root / top).rglob("*.py"))
        if (calls := list(writers_of(path)))
    }
    assert list(found) == ["service/cli/terminal.py"]
