"""Inspection of whole folders: every count, and every broken file at once."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from tests.training.synthetic_omnipush import SOURCE, write_surface, write_views
from training.inspection.findings import Severity
from training.inspection.inspection import Inspection, inspect
from training.omnipush.declaration import DATASET_FILE, UNKNOWN_SOURCE
from training.omnipush.files import Variant
from training.omnipush.layout import SurfaceKind
from training.omnipush.published import different_surfaces, omnipush_descriptors

TEN = different_surfaces().test


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Plywood surface, complete with raw and normalised files and views."""
    write_surface(tmp_path / "plywood", TEN, variants=Variant)
    write_views(tmp_path / "top-down_view", TEN)
    return tmp_path


def codes(inspection: Inspection) -> list[tuple[Severity, str]]:
    """Return the severities and codes of the findings."""
    return [(finding.severity, finding.code) for finding in inspection.findings]


def test_a_complete_surface_is_fit_to_train_on(copy: Path) -> None:
    """A complete surface has every count and no finding, and the folder above it gives the same report."""
    for folder in (copy, copy / "plywood"):
        found = inspect(folder, quiet=True)
        (report,) = found.surfaces

        assert (found.folder, codes(found), found.fit_to_train_on) == (folder, [], True)
        assert (report.surface, report.folder, report.source) == (SurfaceKind.PLYWOOD, copy / "plywood", SOURCE)
        assert (report.objects, report.pushes, report.rows) == (10, 2500, (250, 250, 250))
        assert (report.raw_pairs, report.normalised_pairs, report.dtypes) == (10, 10, {"float64": 20})
        assert (report.missed_share, report.views) == (0.0, 10)
        assert [(each.name, len(each.present)) for each in report.membership.lists] == [("test", 10)]
        assert all(0.9 < figure.ratio < 1.1 for figure in report.figures)


def test_a_copy_as_published_is_read_as_it_is(tmp_path: Path) -> None:
    """Both surfaces are read under their published names, with views two levels above, sorted by number of weights."""
    write_surface(tmp_path / "meta-learning_data" / "0,1,2_weights", omnipush_descriptors(), rows=20)
    write_surface(tmp_path / "meta-learning_data" / "plywood", TEN)
    objects = {*omnipush_descriptors(), *TEN}
    for weights in range(3):
        members = [name for name in objects if 4 - name.count("a") == weights]
        write_views(tmp_path / "top-down_view" / f"{weights}_weight", members)

    for folder in (tmp_path, tmp_path / "meta-learning_data"):
        found = inspect(folder, quiet=True)
        assert [report.surface for report in found.surfaces] == [SurfaceKind.ABS, SurfaceKind.PLYWOOD]
        assert [(report.objects, report.pushes, report.views) for report in found.surfaces] == [
            (250, 5000, 250),
            (10, 2500, 10),
        ]
        assert codes(found) == [(Severity.WARNING, "rows-far-from-250")]
        assert found.fit_to_train_on


def test_normalised_files_without_raw_ones_are_read_in_si_units(copy: Path) -> None:
    """Normalised files give the figures of the raw ones, and a warning."""
    raw = inspect(copy, quiet=True).surfaces[0].figures
    for path in copy.rglob("*_not_norm.npy"):
        path.unlink()

    found = inspect(copy, quiet=True)
    assert codes(found) == [(Severity.WARNING, "normalised-only")]
    assert (found.surfaces[0].raw_pairs, found.surfaces[0].normalised_pairs) == (0, 10)
    for mine, theirs in zip(found.surfaces[0].figures, raw, strict=True):
        assert (mine.mean, mine.std) == pytest.approx((theirs.mean, theirs.std), abs=1e-12)


def test_files_under_turned_names_are_the_published_objects(tmp_path: Path) -> None:
    """Files under turned descriptors count as the published objects, and the report counts them."""
    write_surface(tmp_path / "plywood", [name[4:] + name[:4] for name in TEN])
    write_views(tmp_path / "top-down_view", [name[4:] + name[:4] for name in TEN])

    found = inspect(tmp_path, quiet=True)
    assert codes(found) == []
    assert len(found.surfaces[0].membership.turned) == 10


def broken(file: str, content: bytes) -> Callable[[Path], None]:
    """Return damage: a file of the surface holds these bytes."""

    def damage(copy: Path) -> None:
        (copy / "plywood" / file).write_bytes(content)

    return damage


def removed(file: str) -> Callable[[Path], None]:
    """Return damage: a file of the surface is gone."""
    return lambda copy: (copy / "plywood" / file).unlink()


def saved(file: str, shape: tuple[int, ...]) -> Callable[[Path], None]:
    """Return damage: a file of the surface holds zeros of this shape."""
    return lambda copy: np.save(copy / "plywood" / file, np.zeros(shape))


RAW_X, RAW_Y = TEN[0] + Variant.RAW.pusher_suffix, TEN[0] + Variant.RAW.outcome_suffix
TWIN_X, TWIN_Y = TEN[0] + Variant.NORMALISED.pusher_suffix, TEN[0] + Variant.NORMALISED.outcome_suffix


@pytest.mark.parametrize(
    ("damage", "file", "severity", "code"),
    [
        pytest.param(broken(RAW_X, b"half"), RAW_X, "error", "refused", id="broken raw file"),
        pytest.param(removed(RAW_Y), RAW_Y, "error", "refused", id="half a raw pair"),
        pytest.param(saved(RAW_Y, (249, 3)), RAW_Y, "error", "refused", id="raw files of different length"),
        pytest.param(broken(DATASET_FILE, b"{"), DATASET_FILE, "error", "refused", id="broken declaration"),
        pytest.param(broken(TWIN_X, b"half"), TWIN_X, "warning", "twin-broken", id="broken twin"),
        pytest.param(removed(TWIN_Y), TWIN_Y, "warning", "twin-broken", id="half a twin"),
        pytest.param(saved(TWIN_Y, (249, 3)), TWIN_Y, "warning", "twin-broken", id="twins of different length"),
    ],
)
def test_a_broken_file_is_reported_and_the_rest_is_read(
    copy: Path, damage: Callable[[Path], None], file: str, severity: str, code: str
) -> None:
    """One finding names the broken file: an error for a raw file, a warning for a twin."""
    damage(copy)

    found = inspect(copy, quiet=True)
    about = [finding for finding in found.findings if finding.code == code]
    assert [finding.severity for finding in about] == [severity]
    assert file in about[0].message
    assert found.fit_to_train_on == (severity == "warning")
    assert len(found.surfaces) == 1


def test_a_broken_declaration_leaves_the_origin_unknown(copy: Path) -> None:
    """Pushes beside a broken declaration are reported with the unknown source."""
    broken(DATASET_FILE, b"{")(copy)

    assert inspect(copy, quiet=True).surfaces[0].source == UNKNOWN_SOURCE


def test_a_missing_twin_is_reported(copy: Path) -> None:
    """An object without a normalised twin is a warning if other objects have one."""
    for file in (TWIN_X, TWIN_Y):
        removed(file)(copy)

    assert codes(inspect(copy, quiet=True)) == [(Severity.WARNING, "twin-missing")]


def test_every_broken_file_is_reported_at_once(copy: Path) -> None:
    """Every broken file is a finding, unlike in the loader, and a surface without a readable object has no report."""
    for path in copy.rglob("*_X_3_not_norm.npy"):
        path.write_bytes(b"half")

    found = inspect(copy, quiet=True)
    assert codes(found) == [(Severity.ERROR, "refused")] * 10
    assert found.surfaces == ()


def test_a_folder_without_pushes_is_refused(tmp_path: Path) -> None:
    """The error about a folder without pushes names it and the places to get some."""
    with pytest.raises(DataError, match=r"holds no \*_X_3_not_norm\.npy file.*make data.*docs/data\.md") as caught:
        inspect(tmp_path, quiet=True)
    assert str(tmp_path) in str(caught.value)


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    """The error about a missing folder names it."""
    with pytest.raises(DataError, match="nowhere is not a folder of pushes"):
        inspect(tmp_path / "nowhere", quiet=True)
