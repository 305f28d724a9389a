"""Values from outside, tried on every command of both programs and on each of its parameters.

Paths are folders, pipes, devices or not UTF-8, files are empty, deep, huge or odd, outputs are closed or full. A
command succeeds, or ends with one line. The tests walk the commands, so a new one is tried too.
"""

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import click
import pytest
from click.testing import CliRunner, Result

import service.cli.main
import training.cli.main
from service.cli.command_line import Argument, Option
from service.settings import PREFIX, Settings

PROGRAMS: Final = {"cazsl": service.cli.main.main, "cazsl-train": training.cli.main.main}
MODEL: Final = "push-none"
# Values of the parameters that are not tried: they let a command come as far as possible.
USUAL: Final = {
    **dict.fromkeys(("reference", "first", "second", "name", "recipe"), MODEL),
    **{"version": "1", "when": "2026-11-01", "keep": "8"},
    **{name: "{tmp}/" + name for name in ("destination", "source", "target", "run")},
    **{"key": "{tmp}/key.pem", "registry": "{tmp}/models"},
}
SMALL: Final = {
    "omnipush": ["--surface", "plywood", "--pushes", "1"],
    "shapes": ["--objects", "1", "--pushes", "1", "--families", "box", "--jobs", "1"],
    "reproduce": ["different-objects"],
}
SERVES: Final = "serve"  # starts a service with many of the values, and has the options of config
DRAWS: Final = {"omnipush", "shapes", "images"}  # slow where they can write
LIMIT_S: Final = 60


def commands(command: click.Command, *path: str) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield every command below a group with its words."""
    if isinstance(command, click.Group):
        for name, below in command.commands.items():
            yield from commands(below, *path, name)
    else:
        yield path, command


COMMANDS: Final = [(program, path, command) for program, top in PROGRAMS.items() for path, command in commands(top)]
PARAMETERS: Final = [
    (program, path, parameter)
    for program, path, command in COMMANDS
    for parameter in command.params
    if not getattr(parameter, "is_flag", False)
]
TEXTS: Final = [
    found
    for found in PARAMETERS
    if isinstance(found[2].type, click.Path | click.types.StringParamType) and found[1][-1] != SERVES
]


def label(found: tuple[str, tuple[str, ...], Any]) -> str:
    """Return the name of a command, or of its parameter, for the report of the tests."""
    program, path, tried = found
    return "-".join((program, *path, *([tried.name] if isinstance(tried, click.Parameter) else [])))


def odd_paths(folder: Path) -> dict[str, str]:
    """Make files of every odd kind in a folder. Return their paths by kind."""
    found = {
        "missing": folder / "missing",
        "folder": folder / "folder",
        "pipe": folder / "pipe.toml",
        "device": Path("/dev/full"),
        "endless": Path("/dev/zero"),
        "empty": folder / "empty.toml",
        "huge": folder / "huge.toml",
        "deep": folder / "deep.toml",
        "bytes": folder / "bytes.toml",
        "mark": folder / "mark.toml",
        "below": folder / "empty.toml" / "below",
        "long": folder / ("a" * 300),
        "not-utf-8": Path(os.fsdecode(os.fsencode(folder) + b"/\xff\xfe.toml")),
        "control": folder / "a\x1b[2J\u202e\nb.toml",
    }
    found["folder"].mkdir()
    os.mkfifo(found["pipe"])
    found["empty"].touch()
    with found["huge"].open("wb") as file:
        file.truncate(1 << 40)
    found["deep"].write_text("a = " + "[" * 5000 + "]" * 5000)
    found["bytes"].write_bytes(bytes(range(256)))
    found["mark"].write_bytes(b"\xef\xbb\xbfepochs = 1\n")
    found["not-utf-8"].touch()
    return {kind: str(path) for kind, path in found.items()}


@contextlib.contextmanager
def time_limit() -> Iterator[None]:
    """Fail a block that waits for a pipe or reads without an end."""

    def stop(*_: object) -> None:
        """Raise an error in the waiting call."""
        raise AssertionError(f"the command did not end within {LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def words(path: tuple[str, ...], command: click.Command, tried: click.Parameter, value: str, folder: Path) -> list[str]:
    """Return a command with a value for one parameter, and usual ones for those that it needs."""
    options: list[str] = list(SMALL.get(path[-1], []))
    arguments: list[str] = []
    for parameter in command.params:
        wanted = parameter is tried or parameter.required or parameter.name == "registry"
        if not wanted:
            continue
        text = value if parameter is tried else USUAL.get(parameter.name or "", "x").format(tmp=folder)
        if isinstance(parameter, click.Argument):
            arguments += [text]
        else:
            options += [parameter.opts[0], *[text] * parameter.nargs]
    return [*path, *options, "--", *arguments]


def check(result: Result) -> None:
    """Check the end of a command: no traceback, one line if it failed, and no control character."""
    assert isinstance(result.exception, SystemExit | None), result.exception
    assert result.exit_code in range(6)
    assert "Traceback" not in result.output
    assert "unexpected" not in result.output, result.output
    assert all(line.isprintable() for line in result.output.split("\n")), result.output
    if result.exit_code and not result.stdout:
        assert result.stderr.count("\n") == 1, result.stderr


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """Return a registry of one version, and a key that signs."""
    folder = tmp_path_factory.mktemp("usual")
    for entry in ("1", "aliases"):
        source = project_root / "models" / MODEL / entry
        if source.exists():
            shutil.copytree(source, folder / "models" / MODEL / entry)
    (folder / "key.pem").touch()
    return folder


@pytest.mark.parametrize("found", TEXTS, ids=map(label, TEXTS))
def test_an_odd_path_ends_in_one_line(
    found: tuple[str, tuple[str, ...], click.Parameter], models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every parameter that takes a text is tried with every odd path. None hangs, and none leads to a traceback."""
    program, path, parameter = found
    command = next(command for *name, command in COMMANDS if name == [program, path])
    folder = tmp_path / "usual"
    shutil.copytree(models, folder)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")  # defaults such as runs/ and data/ are below this folder
    for kind, value in odd_paths(tmp_path).items():
        if path[-1] in DRAWS and kind in {"missing", "folder", "control"}:
            continue
        with time_limit():
            check(CliRunner().invoke(PROGRAMS[program], words(path, command, parameter, value, folder)))


@pytest.mark.parametrize("found", PARAMETERS, ids=map(label, PARAMETERS))
def test_every_parameter_is_of_a_kind_that_knows_empty_texts(
    found: tuple[str, tuple[str, ...], click.Parameter],
) -> None:
    """An option without text is not set, and an argument without text is refused, because the kind says so."""
    assert isinstance(found[2], Option | Argument)


@pytest.mark.parametrize("found", COMMANDS, ids=map(label, COMMANDS))
@pytest.mark.parametrize("ending", ["full", "closed"])
def test_output_that_cannot_be_written_is_a_failure(
    found: tuple[str, tuple[str, ...], click.Command], ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If standard output is full or closed, a command ends with a status other than 0, and one line at most."""
    program, path, _ = found
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with contextlib.closing(Path("/dev/full").open("w", encoding="utf-8")) as full:
        monkeypatch.setattr(sys, "stdout", full if ending == "full" else None)
        with pytest.raises(SystemExit) as ended:
            PROGRAMS[program].main([*path, "--help"], program)
    assert ended.value.code == 1
    assert said.getvalue().count("\n") == 1
    assert said.getvalue().startswith("Error: ")


REDIRECTIONS: Final = {
    "closed output": (">&-", 1),
    "full output": (">/dev/full", 1),
    "closed errors": ("2>&-", 0),
    "all closed": ("<&- >&- 2>&-", 1),
    "a reader that leaves": ("| true; exit ${PIPESTATUS[0]}", 1),
}


@pytest.mark.parametrize(
    ("program", "redirection"), [*(("cazsl", each) for each in REDIRECTIONS), ("cazsl-train", "all closed")]
)
def test_standard_streams_of_a_process(program: str, redirection: str) -> None:
    """A process whose standard streams are closed or full has an exit status that tells, and no traceback."""
    shell, status = REDIRECTIONS[redirection]
    command = "config" if program == "cazsl" else "--version"
    package = "service" if program == "cazsl" else "training"
    code = f"import sys; from {package}.cli.main import main; main(sys.argv[1:], {program!r})"
    done = subprocess.run(
        ["/bin/bash", "-c", f'"$1" -c "$2" {command} {shell}', "bash", sys.executable, code],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "LANG": "C", "PYTHONIOENCODING": "ascii"},
        cwd=Path(__file__).parent.parent,
    )
    assert done.returncode == status
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") <= 1


ODD_VALUES: Final = (
    *("nan", "inf", "-1", "1e400", "9" * 5000, "x" * 100_000, "\ufeff1", "\uff11", "a\nb", "a\x1b[2J", "\udcff", "[]"),
    *("tcp://10.0.0.1:8000", "/dev/zero", "\u202e"),
)


@pytest.mark.parametrize("name", Settings.model_fields)
def test_an_odd_value_of_a_variable_ends_in_one_line_with_its_name(name: str) -> None:
    """Every setting is tried with every odd value. It is accepted as text, or refused in one line with its name."""
    variable = PREFIX + name.upper()
    for value in ODD_VALUES:
        result = CliRunner().invoke(PROGRAMS["cazsl"], ["config"], env={variable: value})
        check(result)
        assert result.exit_code == 0 or variable in result.stderr
        assert len(result.stderr) < 2500


ODD_ENTRIES: Final = (
    *(
        '""',
        '" "',
        '"a\\u001bb"',
        "[]",
        "{}",
        "{a = 1}",
        "inf",
        "nan",
        "-inf",
        "1e400",
        "1" * 5000,
        "true",
        "2026-01-01",
    ),
    *("07:00:00", '"\\u202e"', f'"{"x" * 100_000}"', "0x10", "-0.0", "[[[", "1 2", "", "\x00", "\u2028"),
)


@pytest.mark.parametrize("name", Settings.model_fields)
def test_an_odd_entry_of_the_file_ends_in_one_line_with_its_name(name: str, tmp_path: Path) -> None:
    """Every setting is tried with every odd entry of TOML, as every variable is."""
    path = tmp_path / "cazsl.toml"
    for entry in ODD_ENTRIES:
        path.write_text(f"{name} = {entry}\n", encoding="utf-8")
        result = CliRunner().invoke(PROGRAMS["cazsl"], ["config", "--config", str(path)])
        check(result)
        assert result.exit_code == 0 or str(path) in result.stderr
        assert len(result.output) < 100_000


@pytest.mark.parametrize("name", Settings.model_fields)
@pytest.mark.parametrize("empty", ["", " ", "\n", "\t \r\n"])
def test_a_variable_without_text_is_not_set(name: str, empty: str) -> None:
    """A setting whose variable is empty has its default, from the default."""
    result = CliRunner().invoke(PROGRAMS["cazsl"], ["config"], env={PREFIX + name.upper(): empty})
    unset = CliRunner().invoke(PROGRAMS["cazsl"], ["config"])
    assert (result.exit_code, result.output) == (0, unset.output)


@pytest.mark.parametrize("name", Settings.model_fields)
def test_white_space_at_the_ends_of_a_variable_is_cut_off(name: str, tmp_path: Path) -> None:
    """A setting from a file of secrets, which ends in a line feed, is the same as without it."""
    default = Settings.model_fields[name].default
    example = {"metrics_port": 9000, "otlp_endpoint": "http://host/v1"}.get(name, tmp_path)
    value = str(example if default in (None, "") else default)
    plain, spaced = (
        CliRunner().invoke(PROGRAMS["cazsl"], ["config"], env={PREFIX + name.upper(): text})
        for text in (value, f" {value}\r\n")
    )
    assert plain.exit_code == 0
    assert spaced.output == plain.output
