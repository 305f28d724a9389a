"""``cazsl-train data``: checks, pages, exports, and broken input: one line, no traceback."""

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

from tests.training.command_line import cazsl_train, sole_line
from tests.training.pickle_trap import PickleTrap
from tests.training.synthetic_omnipush import SOURCE, write_surface, write_views
from tests.training.tables.tables import write_folder
from training.omnipush.published import different_surfaces
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, read_folder

TEN = different_surfaces().test
FIRST_X, FIRST_Y = TEN[0] + PUSHER_SUFFIX, TEN[0] + OUTCOME_SUFFIX
FIRST_VIEW = f"../top-down_view/shape_{TEN[0]}.npy"


@pytest.fixture
def surface(tmp_path: Path) -> Path:
    """Plywood surface, complete with its views."""
    write_views(tmp_path / "top-down_view", TEN)
    return write_surface(tmp_path / "plywood", TEN)


def test_the_group_lists_its_commands() -> None:
    """The help of the group lists its commands, and that of check explains the exit status."""
    group, check = cazsl_train("data", "-h"), cazsl_train("data", "check", "-h")

    assert (group.exit_code, check.exit_code) == (0, 0)
    for command in ("check", "report", "export"):
        assert f"\n  {command} " in group.output
    assert "Exit status 1 means that training" in " ".join(check.output.split())
    assert "data check" in cazsl_train("-h").output


def test_check_of_a_complete_surface_passes(surface: Path) -> None:
    """A complete surface is printed with its source, no finding and the next step."""
    result = cazsl_train("data", "check", surface)

    assert result.exit_code == 0
    assert result.stderr == ""
    assert result.stdout.startswith(f"{surface}: plywood, {SOURCE}\n")
    assert result.stdout.splitlines()[-1].startswith("0 errors, 0 warnings; next: ")


def test_check_for_programs_is_one_document(surface: Path) -> None:
    """The JSON document and the exit status give the same verdict."""
    passed = cazsl_train("data", "check", surface, "--json")
    (surface / FIRST_X).unlink()
    failed = cazsl_train("data", "check", surface, "--json")

    assert (passed.exit_code, json.loads(passed.stdout)["fit_to_train_on"]) == (0, True)
    assert (failed.exit_code, json.loads(failed.stdout)["fit_to_train_on"]) == (1, False)


def test_export_writes_the_variants_asked_for(surface: Path, tmp_path: Path) -> None:
    """Both variants are written by default, and the next step is to check them."""
    result = cazsl_train("data", "export", surface, tmp_path / "both")
    cazsl_train("data", "export", surface, tmp_path / "normalised", "--variant", "normalised")

    assert result.exit_code == 0
    assert result.stdout == (
        f"{tmp_path / 'both'}: 10 objects, both; next: cazsl-train data check {tmp_path / 'both'}\n"
    )
    assert len(list((tmp_path / "both").glob("*.npy"))) == 40
    assert len(list((tmp_path / "normalised").glob("*_3_norm.npy"))) == 20
    assert len(list((tmp_path / "normalised").glob("*.npy"))) == 20


def test_report_writes_a_page_and_two_images(surface: Path, tmp_path: Path) -> None:
    """The page and its images are written beside the pushes or to --out, equal files for equal pushes."""
    default = cazsl_train("data", "report", surface)
    elsewhere = cazsl_train("data", "report", surface, "--out", tmp_path / "docs" / "plywood")

    page = surface / "report" / "report.md"
    assert (default.exit_code, elsewhere.exit_code) == (0, 0)
    assert default.stdout == (
        f"{page}: 10 objects, 2500 pushes, with histograms.png and pushes.png; next: read {page}\n"
    )
    assert page.read_text(encoding="utf-8").startswith(f"# {SOURCE}\n")
    written = {path.name: path.read_bytes() for path in (surface / "report").iterdir()}
    assert sorted(written) == ["histograms.png", "pushes.png", "report.md"]
    assert {path.name: path.read_bytes() for path in (tmp_path / "docs" / "plywood").iterdir()} == written


def test_report_of_an_empty_folder_is_one_line(tmp_path: Path) -> None:
    """The error about a folder without pushes names it, and no page is written."""
    (tmp_path / "empty").mkdir()

    line = sole_line(cazsl_train("data", "report", tmp_path / "empty"))
    assert line.startswith(f"Error: {tmp_path / 'empty'} holds no *_X_3_not_norm.npy file; run 'make data' or name")
    assert list((tmp_path / "empty").iterdir()) == []


def test_report_into_a_blocked_folder_is_one_line(surface: Path) -> None:
    """The error about an output folder in the place of a file names it."""
    (surface / "file").touch()

    line = sole_line(cazsl_train("data", "report", surface, "--out", surface / "file" / "below"))
    assert line == f"Error: {surface / 'file' / 'below'}: Not a directory; fix that or name another path"


def sprung(folder: Path) -> Path:
    """Return the folder that a loaded pickle would make."""
    return folder.parent / "sprung"


def cut(folder: Path) -> None:
    """Damage: a file ends in the middle of its numbers."""
    os.truncate(folder / FIRST_X, 1000)


def pickled(folder: Path) -> None:
    """Damage: an .npy file holds objects, which numpy would unpickle."""
    np.save(folder / FIRST_X, np.array([[PickleTrap(sprung(folder))] * 3] * 250, dtype=object), allow_pickle=True)


def bare_pickle(folder: Path) -> None:
    """Damage: a pickle has the name of an .npy file."""
    (folder / FIRST_Y).write_bytes(pickle.dumps(PickleTrap(sprung(folder))))


def nan_row(folder: Path) -> None:
    """Damage: one row of outcomes is not a number."""
    rows = np.load(folder / FIRST_Y)
    rows[7] = np.nan
    np.save(folder / FIRST_Y, rows)


def shorter(folder: Path) -> None:
    """Damage: an outcome is missing."""
    np.save(folder / FIRST_Y, np.load(folder / FIRST_Y)[:-1])


def unknown_object(folder: Path) -> None:
    """Damage: no object has the descriptor."""
    for name in (FIRST_X, FIRST_Y):
        (folder / name).rename(folder / ("1B" + name[2:]))


def no_descriptor(folder: Path) -> None:
    """Damage: a name does not begin with a descriptor."""
    for name in (FIRST_X, FIRST_Y):
        (folder / name).rename(folder / ("copy_of_" + name))


def twice(folder: Path) -> None:
    """Damage: the same object has two names."""
    for name in (FIRST_X, FIRST_Y):
        shutil.copy(folder / name, folder / (TEN[0] + "_again" + name[8:]))


def twice_turned(folder: Path) -> None:
    """Damage: the same object has two descriptors, one of them turned."""
    for name in (FIRST_X, FIRST_Y):
        shutil.copy(folder / name, folder / (TEN[0][2:] + TEN[0][:2] + name[8:]))


def other_size(folder: Path) -> None:
    """Damage: a view has another size."""
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


@pytest.mark.parametrize(("damage", "file", "fault", "remedy"), BROKEN)
@pytest.mark.parametrize("command", ["check", "export", "fit"])
def test_a_broken_file_ends_in_one_line_that_names_it(
    surface: Path, tmp_path: Path, command: str, damage: Callable[[Path], None], file: str, fault: str, remedy: str
) -> None:
    """Every command ends with exit status 1 and a line with file, fault and remedy, and loads no pickle."""
    damage(surface)
    arguments = {
        "check": ["data", "check", str(surface)],
        "export": ["data", "export", str(surface), str(tmp_path / "out")],
        "fit": ["fit", "push-indicator", "--data", str(surface), "--run", str(tmp_path / "run")],
    }[command]

    result = cazsl_train(*arguments)

    assert result.exit_code == 1
    (line,) = [line for line in result.output.splitlines() if fault in line and file in line]
    assert remedy in line
    assert "Traceback" not in result.output
    assert not sprung(surface).exists()
    assert not (tmp_path / "run").exists()
    if command != "check":
        assert result.output == line + "\n"


def test_the_trap_springs_when_it_is_loaded(tmp_path: Path) -> None:
    """The trap makes its folder when it is loaded as a pickle, so the test above can fail."""
    folder = tmp_path / "plywood"
    folder.mkdir()
    pickled(folder)
    np.load(folder / FIRST_X, allow_pickle=True)

    assert sprung(folder).exists()


@pytest.mark.parametrize(
    ("damage", "file", "fault"),
    [
        pytest.param(other_size, f"shape_{TEN[0]}.npy", "(480, 481); expected (481, 481); fetch or draw", id="view"),
        pytest.param(twice_turned, TEN[0], "keep the files of one of them", id="turned"),
    ],
)
def test_check_finds_faults_that_the_loader_ignores(
    surface: Path, damage: Callable[[Path], None], file: str, fault: str
) -> None:
    """A view of another size and an object under two turned descriptors are errors of a check."""
    damage(surface)
    result = cazsl_train("data", "check", surface)

    assert result.exit_code == 1
    assert any(file in line and fault in line for line in result.stdout.splitlines())
    assert result.stdout.splitlines()[-1].endswith(f"next: fix the errors, then cazsl-train data check {surface}")


@pytest.mark.parametrize("command", ["check", "fit"])
@pytest.mark.parametrize("kind", ["empty", "missing", "a file"])
def test_a_folder_without_pushes_ends_in_one_line(tmp_path: Path, command: str, kind: str) -> None:
    """The error about a folder without pushes names it and the way to get pushes."""
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
def without_root() -> Iterator[None]:
    """Run a block without root's right to write everywhere, or as the user who runs the tests."""
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
    """Folder that only root may write, below folders that every user may pass, unlike tmp_path."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "closed").mkdir(mode=0o555)
        with without_root():
            reachable = os.access(folder / "closed", os.R_OK | os.X_OK, effective_ids=True)
        if not reachable:
            pytest.skip(f"{folder.parent} is closed to other users: the refusal would not be this folder's")
        yield folder / "closed"
        (folder / "closed").chmod(0o755)


def test_a_folder_without_write_permission_ends_in_one_line(read_only: Path) -> None:
    """Exporting into a read-only folder, or below it, prints folder, reason and remedy, and leaves no file."""
    source = write_surface(read_only.parent / "plywood", TEN[:1], rows=2)
    for path in (source, *source.iterdir()):
        path.chmod(0o755)
    with without_root():
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
    """The error about a read-only folder is printed before any simulation."""
    with without_root():
        result = cazsl_train("simulate", read_only, "--pushes", "1", "--threads", "1")

    assert result.exit_code == 1
    assert result.output.splitlines() == [
        f"Error: {read_only / 'abs'} cannot be written (Permission denied); fix that or name another folder"
    ]


def test_a_run_folder_without_write_permission_ends_in_one_line(data_folder: Path, tmp_path: Path) -> None:
    """The error about a run folder below a file, which stops root as well, names it."""
    (tmp_path / "runs").touch()
    result = cazsl_train("fit", "push-indicator", "--data", data_folder, "--run", tmp_path / "runs" / "mine")

    assert result.exit_code == 1
    assert result.output == f"Error: {tmp_path / 'runs' / 'mine'}: Not a directory; fix that or name another path\n"


def test_a_copy_under_turned_names_trains_like_the_published_one(data_folder: Path, tmp_path: Path) -> None:
    """A copy under turned descriptors is found and trained on, each object in the frame of its file."""
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


def test_a_table_is_checked_as_a_folder_is(tmp_path: Path) -> None:
    """A folder with pushes.csv is checked as a table, and its faults end in one line each."""
    table = write_folder(tmp_path / "mine")
    result = cazsl_train("data", "check", table)
    assert result.exit_code == 0
    assert "few-objects" in result.stdout
    assert result.stdout.splitlines()[-1] == f"0 errors, 2 warnings; next: cazsl-train data report {table}"

    (table / "pushes.csv").write_text((table / "pushes.csv").read_text().replace("-0.06", "nan"))
    assert sole_line(cazsl_train("data", "check", table)) == (
        f"Error: {table / 'pushes.csv'}: row 1 (line 2), column pusher_x_m: received 'nan'; "
        "accepted is a number in metres, finite and under 1e6"
    )
    document = json.loads(cazsl_train("data", "check", table, "--json").stdout)
    assert document["code"] == "data"


def test_options_of_tables_are_refused_for_other_folders(data_folder: Path) -> None:
    """The option --objects belongs to tables, so a folder in Omnipush's format with it is a wrong command line."""
    result = cazsl_train("data", "check", data_folder, "--objects", data_folder / "outlines.csv")
    assert result.exit_code == 2
    assert "--objects is for tables" in result.stderr


def test_the_documented_example_prints_as_documented(project_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of the cardboard box in docs/data.md prints the text there, and its report has the same digest."""
    monkeypatch.chdir(project_root)
    result = cazsl_train("data", "check", Path("docs/data/cardboard-box"))
    documented = " ".join((project_root / "docs" / "data.md").read_text(encoding="utf-8").split())

    assert result.exit_code == 0
    assert " ".join(result.stdout.split()) in documented
    digest = next(line for line in result.stdout.splitlines() if "sha256" in line).split()[-1]
    assert digest in (project_root / "docs" / "data" / "cardboard-box" / "report" / "report.md").read_text()


def test_a_report_of_a_table_stands_beside_another(tmp_path: Path) -> None:
    """A report of a table is written into the folder report in it, beside another table if one is named."""
    table, other = write_folder(tmp_path / "mine"), write_folder(tmp_path / "other")
    result = cazsl_train("data", "report", table, "--against", other)

    assert result.exit_code == 0
    page = table / "report" / "report.md"
    assert result.stdout.startswith(f"{page}: 1 push of 1 object, with histograms.png and pushes.png; next: read ")
    assert "distance (mm), other" in page.read_text()
    (other / "pushes.csv").write_text("")
    assert "is empty" in sole_line(cazsl_train("data", "report", table, "--against", other))


def test_a_table_is_checked_beside_other_pushes(data_folder: Path, tmp_path: Path) -> None:
    """The quantiles of a table stand beside those of Omnipush's recordings, and of a folder in its format."""
    table = write_folder(tmp_path / "mine")
    for against, name in ((Path("omnipush"), "Omnipush's recordings"), (data_folder, data_folder.name)):
        result = cazsl_train("data", "check", table, "--against", against, "--json")
        assert result.exit_code == 0
        assert json.loads(result.stdout)["against"]["name"] == name
