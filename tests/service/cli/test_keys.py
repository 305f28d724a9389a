"""Tests of ``cazsl keys``."""

import hashlib
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from service.cli.main import main


def test_new_key_prints_the_line_for_the_file_and_the_key_apart() -> None:
    """The line for the file of keys is on standard output, and the key itself only on standard error."""
    result = CliRunner().invoke(main, ["keys", "new", "robot-7", "--scope", "predict", "--scope", "metrics"])
    assert result.exit_code == 0, result.output
    key = result.stderr.split()[-1]
    assert result.stdout == f"robot-7 metrics,predict {hashlib.sha256(key.encode()).hexdigest()}\n"


@pytest.mark.parametrize("name", ["Robot 7", "", "a" * 65, "robot#7", "röbot", "a/b", "robot\n7"])
def test_a_name_that_could_not_be_read_back_is_refused(name: str) -> None:
    """A name that would make an invalid line is refused in one line, before a key is shown."""
    result = CliRunner().invoke(main, ["keys", "new", "--", name])
    assert result.exit_code in (1, 2)
    assert (result.stdout, result.stderr.count("\n")) == ("", 1)
    assert "API key" not in result.stderr


def test_new_key_is_added_to_a_file_and_replaces_nothing(tmp_path: Path) -> None:
    """With --file the line is added, also behind a last line without its end, and a name that is taken is refused."""
    path = tmp_path / "keys"
    first = CliRunner().invoke(main, ["keys", "new", "robot-7", "--file", str(path)])
    assert (first.exit_code, first.stdout) == (0, "")
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text(path.read_text().rstrip("\n"))
    assert CliRunner().invoke(main, ["keys", "new", "robot-8", "--file", str(path)]).exit_code == 0
    taken = CliRunner().invoke(main, ["keys", "new", "robot-7", "--file", str(path)])
    assert (taken.exit_code, "API key" in taken.stderr) == (1, False)
    nowhere = CliRunner().invoke(main, ["keys", "new", "robot-9", "--file", str(tmp_path / "missing" / "keys")])
    assert (nowhere.exit_code, "API key" in nowhere.stderr) == (1, False)
    listed = json.loads(CliRunner().invoke(main, ["keys", "list", str(path), "--json"]).stdout)
    assert [key["name"] for key in listed] == ["robot-7", "robot-8"]


def test_check_names_every_bad_line(tmp_path: Path) -> None:
    """A file with bad lines is status 1 and a line for each. The default file is that of CAZSL_KEYS."""
    path = tmp_path / "keys"
    CliRunner().invoke(main, ["keys", "new", "robot-7", "--file", str(path)])
    good = CliRunner().invoke(main, ["keys", "check"], env={"CAZSL_KEYS": str(path)})
    assert (good.exit_code, good.output) == (0, "1 keys, 0 problems\n")
    path.write_text(path.read_text() + "x\ny z\n")
    bad = CliRunner().invoke(main, ["keys", "check", str(path)])
    assert bad.exit_code == 1
    assert [line.split(":")[0] for line in bad.stderr.splitlines()] == ["PROBLEM  line 2", "PROBLEM  line 3"]
    assert CliRunner().invoke(main, ["keys", "check"]).exit_code == 2


def test_check_says_whose_a_key_is(tmp_path: Path) -> None:
    """A key on standard input is named with its scopes, and never repeated. An unknown one is status 1."""
    path = tmp_path / "keys"
    made = CliRunner().invoke(main, ["keys", "new", "robot-7", "--file", str(path)])
    key = made.stderr.split()[-1]
    known = CliRunner().invoke(main, ["keys", "check", str(path)], input=f"\ufeff{key}\r\n")
    assert known.exit_code == 0
    assert "the key is that of robot-7, with predict" in known.output
    unknown = CliRunner().invoke(main, ["keys", "check", str(path)], input="other\n")
    assert unknown.exit_code == 1
    assert "not in the file" in unknown.stderr
    assert key not in known.output
    document = json.loads(CliRunner().invoke(main, ["keys", "check", str(path), "--json"], input=key).stdout)
    assert document["key"]["name"] == "robot-7"
