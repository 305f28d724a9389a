"""``cazsl-train data`` as a person uses it, and every broken input through the command line: one line, no traceback."""

import json
import os
import pickle
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.training.copies import SOURCE, write_surface, write_views
from training.cli.main import main
from training.omnipush.published import different_surfaces
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, read_folder

TEN = different_surfaces().test
FIRST_X, FIRST_Y = TEN[0] + PUSHER_SUFFIX, TEN[0] + OUTCOME_SUFFIX
FIRST_VIEW = f"../top-down_view/shape_{TEN[0]}.npy"


def cazsl_train(*arguments: str | Path) -> Result:
    """Run the command line in this process; what no person should see is raised here."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def surface(tmp_path: Path) -> Path:
    """A whole plywood surface with its views."""
    write_views(tmp_path / "top-down_view", TEN)
    return write_surface(tmp_path / "plywood", TEN)


def test_help_says_what_is_wrong_and_what_is_not() -> None:
    """Each command explains itself, and the group lists them."""
    group, check = cazsl_train("data", "-h"), cazsl_train("data", "check", "-h")

    assert (group.exit_code, check.exit_code) == (0, 0)
    for command in ("check", "export"):
        assert f"\n  {command} " in group.output
    assert "Exit status 1 means that training" in " ".join(check.output.split())
    assert "data check" in cazsl_train("-h").output


def test_check_of_a_whole_surface_passes(surface: Path) -> None:
    """The table, the label, and what to do next."""
    result = cazsl_train("data", "check", surface)

    assert result.exit_code == 0
    assert result.stderr == ""
    assert result.stdout.startswith(f"{surface}: plywood, {SOURCE}\n")
    assert result.stdout.splitlines()[-1].startswith("0 errors, 0 warnings; next: ")


def test_check_for_programs_is_one_document(surface: Path) -> None:
    """The same verdict in JSON and in the exit status."""
    passed = cazsl_train("data", "check", surface, "--json")
    (surface / FIRST_X).unlink()
    failed = cazsl_train("data", "check", surface, "--json")

    assert (passed.exit_code, json.loads(passed.stdout)["fit_to_train_on"]) == (0, True)
    assert (failed.exit_code, json.loads(failed.stdout)["fit_to_train_on"]) == (1, False)


def test_export_writes_what_is_asked_for(surface: Path, tmp_path: Path) -> None:
    """Both variants unless told otherwise; the next step is to check them."""
    result = cazsl_train("data", "export", surface, tmp_path / "both")
    cazsl_train("data", "export", surface, tmp_path / "normalised", "--variant", "normalised")

    assert result.exit_code == 0
    assert result.stdout == (
        f"{tmp_path / 'both'}: 10 objects, both; next: cazsl-train data check {tmp_path / 'both'}\n"
    )
    assert len(list((tmp_path / "both").glob("*.npy"))) == 40
    assert len(list((tmp_path / "normalised").glob("*_3_norm.npy"))) == 20
    assert len(list((tmp_path / "normalised").glob("*.npy"))) == 20


class Trap:
    """An object whose unpickling writes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str, int], int], tuple[str, int]]:
        return os.open, (str(self.path), os.O_CREAT | os.O_WRONLY)


def sprung(folder: Path) -> Path:
    """The file that only a loaded pickle writes."""
    return folder.parent / "sprung"


def cut(folder: Path) -> None:
    """Damage: a file ends in the middle of its numbers."""
    os.truncate(folder / FIRST_X, 1000)


def pickled(folder: Path) -> None:
    """Damage: an .npy file of objects, which numpy would unpickle."""
    np.save(folder / FIRST_X, np.array([[Trap(sprung(folder))] * 3] * 250, dtype=object), allow_pickle=True)


def bare_pickle(folder: Path) -> None:
    """Damage: a pickle under the name of an .npy file."""
    (folder / FIRST_Y).write_bytes(pickle.dumps(Trap(sprung(folder))))


def nan_row(folder: Path) -> None:
    """Damage: one row of outcomes is not a number."""
    rows = np.load(folder / FIRST_Y)
    rows[7] = np.nan
    np.save(folder / FIRST_Y, rows)


def shorter(folder: Path) -> None:
    """Damage: an outcome is missing."""
    np.save(folder / FIRST_Y, np.load(folder / FIRST_Y)[:-1])


def unknown_object(folder: Path) -> None:
    """Damage: a descriptor that no object has."""
    for name in (FIRST_X, FIRST_Y):
        (folder / name).rename(folder / ("1B" + name[2:]))


def no_descriptor(folder: Path) -> None:
    """Damage: a name that begins with none."""
    for name in (FIRST_X, FIRST_Y):
        (folder / name).rename(folder / ("copy_of_" + name))


def twice(folder: Path) -> None:
    """Damage: the same object under two names."""
    for name in (FIRST_X, FIRST_Y):
        shutil.copy(folder / name, folder / (TEN[0] + "_again" + name[8:]))


def twice_turned(folder: Path) -> None:
    """Damage: the same kind of object under two turns of its descriptor."""
    for name in (FIRST_X, FIRST_Y):
        shutil.copy(folder / name, folder / (TEN[0][2:] + TEN[0][:2] + name[8:]))


def other_size(folder: Path) -> None:
    """Damage: a view of another size."""
    (folder / FIRST_VIEW).unlink()
    np.save(folder / FIRST_VIEW, np.zeros((480, 481)))


BROKEN = [
    pytest.param(cut, FIRST_X, "not a complete .npy file", "fetch or simulate", id="truncated"),
    pytest.param(pickled, FIRST_X, "not a complete .npy file", "fetch or simulate", id="a pickle inside an npy"),
    pytest.param(bare_pickle, FIRST_Y, "not a complete .npy file", "fetch or simulate", id="a bare pickle"),
    pytest.param(nan_row, FIRST_Y, "row 7 is not finite", "remove that push", id="a NaN row"),
    pytest.param(shorter, FIRST_Y, "has 249 rows", "fetch or simulate", id="X and y of different length"),
    pytest.param(
        unknown_object, "1B" + FIRST_X[2:], "B and C only on shape 2", "rename or remove", id="no such object"
    ),
    pytest.param(no_descriptor, "copy_of_" + FIRST_X, "8-character descriptor", "rename or remove", id="no descriptor"),
    pytest.param(twice, FIRST_X, "are the same object", "keep one of them", id="two files for one object"),
]


@pytest.mark.parametrize(("damage", "file", "says", "remedy"), BROKEN)
@pytest.mark.parametrize("command", ["check", "export", "fit"])
def test_a_broken_file_ends_in_one_line_that_names_it(
    surface: Path, tmp_path: Path, command: str, damage: Callable[[Path], None], file: str, says: str, remedy: str
) -> None:
    """Exit status 1, the file, what is wrong and what to do; whatever command meets it, and no pickle is loaded."""
    damage(surface)
    arguments = {
        "check": ["data", "check", str(surface)],
        "export": ["data", "export", str(surface), str(tmp_path / "out")],
        "fit": ["fit", "push-indicator", "--data", str(surface), "--run", str(tmp_path / "run")],
    }[command]

    result = cazsl_train(*arguments)

    assert result.exit_code == 1
    (line,) = [line for line in result.output.splitlines() if says in line and file in line]
    assert remedy in line
    assert "Traceback" not in result.output
    assert not sprung(surface).exists()
    assert not (tmp_path / "run").exists()
    if command != "check":
        assert result.output == line + "\n"


def test_the_trap_is_one(tmp_path: Path) -> None:
    """Loaded as a pickle it does write its file: not loading it is what kept the file away."""
    folder = tmp_path / "plywood"
    folder.mkdir()
    pickled(folder)
    np.load(folder / FIRST_X, allow_pickle=True)

    assert sprung(folder).exists()


@pytest.mark.parametrize(
    ("damage", "file", "says"),
    [
        pytest.param(other_size, f"shape_{TEN[0]}.npy", "(480, 481); expected (481, 481); fetch or draw", id="view"),
        pytest.param(twice_turned, TEN[0], "keep the files of one of them", id="turned"),
    ],
)
def test_check_tells_what_a_loader_of_pushes_does_not_see(
    surface: Path, damage: Callable[[Path], None], file: str, says: str
) -> None:
    """A view of another size, and one kind of object under two turned names."""
    damage(surface)
    result = cazsl_train("data", "check", surface)

    assert result.exit_code == 1
    assert any(file in line and says in line for line in result.stdout.splitlines())
    assert result.stdout.splitlines()[-1].endswith(f"next: fix the errors, then cazsl-train data check {surface}")


@pytest.mark.parametrize("command", ["check", "fit"])
@pytest.mark.parametrize("kind", ["empty", "missing", "a file"])
def test_a_folder_without_pushes_ends_in_one_line(tmp_path: Path, command: str, kind: str) -> None:
    """The folder is named, and where to get pushes."""
    folder = tmp_path / "data"
    if kind == "empty":
        folder.mkdir()
    elif kind == "a file":
        folder.touch()
    words = ["data", "check"] if command == "check" else ["fit", "push-indicator", "--data"]

    result = cazsl_train(*words, folder)
    last = result.stderr.splitlines()[-1]
    assert result.exit_code == (
        2 if (command, kind) == ("fit", "a file") else 1
    )  # 2: click knows that --data is a folder
    assert str(folder) in last
    assert ("is a file" if result.exit_code == 2 else "make data") in last


@contextmanager
def nobody() -> Iterator[None]:
    """Without root's right to write everywhere; the user who runs the tests otherwise."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def read_only() -> Iterator[Path]:
    """A folder that nobody but root may write, below folders that everybody may pass: tmp_path is root's alone."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "closed").mkdir(mode=0o555)
        with nobody():
            reachable = os.access(folder / "closed", os.R_OK | os.X_OK, effective_ids=True)
        if not reachable:
            pytest.skip(f"{folder.parent} is closed to other users: the refusal would not be this folder's")
        yield folder / "closed"
        (folder / "closed").chmod(0o755)


def test_a_folder_without_write_permission_ends_in_one_line(read_only: Path) -> None:
    """Exporting into it, or below it: the folder, the system's reason, what to do; nothing is left behind."""
    source = write_surface(read_only.parent / "plywood", TEN[:1], rows=2)
    for path in (source, *source.iterdir()):
        path.chmod(0o755)
    with nobody():
        with pytest.raises(PermissionError):
            (read_only / "probe").touch()
        results = [cazsl_train("data", "export", source, target) for target in (read_only / "below", read_only)]

    for result, path in zip(results, (read_only / "below", read_only / "dataset.json"), strict=True):
        assert result.exit_code == 1
        assert result.output == (
            f"Error: {path} cannot be written (Permission denied); fix that or name another folder\n"
        )
    assert list(read_only.iterdir()) == []


def test_simulating_into_a_folder_without_write_permission_ends_in_one_line(read_only: Path) -> None:
    """Before anything is simulated."""
    with nobody():
        result = cazsl_train("simulate", read_only, "--pushes", "1", "--threads", "1")

    assert result.exit_code == 1
    assert result.output.splitlines() == [
        f"Error: {read_only / 'abs'} cannot be written (Permission denied); fix that or name another folder"
    ]


def test_a_run_folder_without_write_permission_ends_in_one_line(data_folder: Path, tmp_path: Path) -> None:
    """A file stands where the run's parent should be, which stops root as well."""
    (tmp_path / "runs").touch()
    result = cazsl_train("fit", "push-indicator", "--data", data_folder, "--run", tmp_path / "runs" / "mine")

    assert result.exit_code == 1
    assert result.output == f"Error: {tmp_path / 'runs' / 'mine'}: Not a directory; fix that or name another path\n"


def test_a_copy_under_turned_names_trains_like_the_published_one(data_folder: Path, tmp_path: Path) -> None:
    """Objects are found by kind; each keeps the descriptor of its file, whose frame its pushes are in."""
    turned = tmp_path / "turned"
    shutil.copytree(data_folder, turned)
    for path in turned.glob("*.npy"):
        path.rename(turned / (path.name[2:8] + path.name[:2] + path.name[8:]))
    recipe = tmp_path / "short.toml"
    recipe.write_text(
        'name = "push-indicator"\nmethod = "FCN + CM"\ncontext = "indicator"\nset_up = "different-objects"\n'
        "epochs = 1\nbatch_objects = 64\nlearning_rate = 0.002\nwarm_up_steps = 0\nlambda_1 = 0.0\nlambda_2 = 0.0\n"
        'precision = "auto"\nseed = 0\n'
    )

    result = cazsl_train("fit", recipe, "--data", turned, "--run", tmp_path / "run")
    assert result.exit_code == 0
    assert len(read_folder(turned).descriptors) == 250
