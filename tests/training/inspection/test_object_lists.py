"""Published lists of objects, compared with the objects of a folder."""

from training.inspection.findings import Severity
from training.inspection.object_lists import membership
from training.omnipush.layout import SurfaceKind
from training.omnipush.published import different_objects, different_surfaces, omnipush_descriptors


def test_the_250_objects_are_complete_on_abs() -> None:
    """The 250 objects are the 200 training and 50 test objects, without a finding."""
    found = membership(SurfaceKind.ABS, omnipush_descriptors())

    assert [(each.name, len(each.present), each.missing) for each in found.lists] == [
        ("train", 200, ()),
        ("test", 50, ()),
    ]
    assert (found.turned, found.extra) == ((), ())
    assert list(found.findings("abs")) == []


def test_turned_names_are_members() -> None:
    """Files under turned descriptors count as the published objects."""
    turned = [name[2:] + name[:2] for name in omnipush_descriptors()]
    found = membership(SurfaceKind.ABS, turned)

    assert [each.missing for each in found.lists] == [(), ()]
    assert set(found.turned) == set(turned) - set(omnipush_descriptors())
    assert list(found.findings("abs")) == []


def test_missing_objects_are_errors_and_extra_ones_warnings() -> None:
    """Missing objects are reported with published descriptors, extra ones with those of their files."""
    split = different_objects()
    present = [name for name in omnipush_descriptors() if name not in (split.train[7], split.test[3])]
    found = list(membership(SurfaceKind.ABS, [*present, "1c1c1c1c"]).findings("here"))

    assert [(finding.severity, finding.code, finding.where) for finding in found] == [
        (Severity.ERROR, "objects-missing", "here"),
        (Severity.ERROR, "objects-missing", "here"),
        (Severity.WARNING, "objects-extra", "here"),
    ]
    assert f"missing of the 200 published to train: 1 object ({split.train[7]});" in found[0].message
    assert f"missing of the 50 published to test: 1 object ({split.test[3]});" in found[1].message
    assert "1c1c1c1c" in found[2].message


def test_plywood_holds_its_own_ten() -> None:
    """The ten plywood objects are complete, and one of them is not among the 250."""
    found = membership(SurfaceKind.PLYWOOD, different_surfaces().test)

    assert [(each.name, len(each.present), each.missing) for each in found.lists] == [("test", 10, ())]
    assert len(set(different_surfaces().test) - set(omnipush_descriptors())) == 1
    assert list(found.findings("plywood")) == []
