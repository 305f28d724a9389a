"""Findings about pushes: each check with its severity, and none for plausible pushes."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from tests.training.synthetic_omnipush import plausible_pushes
from training.inspection.findings import (
    DatasetFinding,
    ObjectPushes,
    Severity,
    odd_normalised,
    odd_quantiles,
    odd_statistics,
    surface_findings,
)
from training.inspection.statistics import MotionQuantiles, compare_statistics, recorded_motion
from training.omnipush.files import Array
from training.omnipush.layout import SurfaceKind
from training.omnipush.published import published_normalisation

FOUR = ("1a1a1a1a", "1a2b3c4a", "2B3a3a4a", "3a3a4a4a")
ERROR, WARNING = Severity.ERROR, Severity.WARNING


def plausible_objects(count: int = 250) -> list[ObjectPushes]:
    """Return four objects without a fault."""
    return [
        ObjectPushes(name, *plausible_pushes(count, number), ("float64", "float64")) for number, name in enumerate(FOUR)
    ]


def findings(objects: Sequence[ObjectPushes]) -> list[DatasetFinding]:
    """Return the findings about these objects."""
    pushers = np.concatenate([item.pushers for item in objects])
    outcomes = np.concatenate([item.outcomes for item in objects])
    return surface_findings("here", objects, compare_statistics(pushers, outcomes, published_normalisation()))


def codes_of(objects: Sequence[ObjectPushes]) -> list[tuple[Severity, str]]:
    """Return the severities and codes of the findings."""
    return [(finding.severity, finding.code) for finding in findings(objects)]


def changed(
    change: Callable[[Array, Array], tuple[Array, Array]], objects: Sequence[ObjectPushes] | None = None
) -> list[ObjectPushes]:
    """Return the objects with a change of every pusher and outcome."""
    return [
        ObjectPushes(item.descriptor, *change(item.pushers.copy(), item.outcomes.copy()), item.dtypes)
        for item in objects or plausible_objects()
    ]


def test_plausible_pushes_have_no_finding() -> None:
    """Plausible pushes have no finding, so that every finding below is caused by its damage."""
    assert findings(plausible_objects()) == []


@pytest.mark.parametrize(
    ("factors", "messages"),
    [
        ((1000, 1000, 1), ["pusher positions look like millimetres", "object positions look like millimetres"]),
        ((100, 100, 1), ["pusher positions look like centimetres", "object positions look like centimetres"]),
        ((1, 1, 180 / math.pi), ["push angles look like degrees", "object yaws look like degrees"]),
    ],
    ids=["millimetres", "centimetres", "degrees"],
)
def test_other_units_are_errors(factors: tuple[float, float, float], messages: list[str]) -> None:
    """Other units are reported once, with the remedy, instead of by their consequences."""
    found = findings(changed(lambda pushers, outcomes: (pushers * factors, outcomes * factors)))

    assert [(finding.severity, finding.code) for finding in found] == [(ERROR, "units")] * 2
    for finding, words in zip(found, messages, strict=True):
        assert words in finding.message


def test_normalised_numbers_under_a_raw_name_are_an_error() -> None:
    """Deviations near 1 in all six quantities are reported as normalised numbers."""
    found = findings(changed(published_normalisation().normalised))

    assert (found[0].severity, found[0].code) == (ERROR, "units")
    assert "look normalised" in found[0].message


@pytest.mark.parametrize(
    ("scale", "severity"), [(1.2, None), (1.4, WARNING), (0.7, WARNING), (2.5, ERROR), (0.4, ERROR)]
)
def test_a_spread_unlike_the_published_one_is_reported(scale: float, severity: Severity | None) -> None:
    """A deviation is odd from a quarter on and wrong from a factor of two on."""
    found = codes_of(changed(lambda pushers, outcomes: (pushers * [scale, 1, 1], outcomes)))

    assert found == ([] if severity is None else [(severity, "statistics")])


@pytest.mark.parametrize(("scale", "severity"), [(1.4, None), (0.7, None), (1.6, WARNING), (2.5, ERROR)])
def test_a_spread_on_another_surface_may_differ_more(scale: float, severity: Severity | None) -> None:
    """The published deviations are those on ABS: on plywood one is odd from a half on, and wrong from two on."""
    objects = changed(lambda pushers, outcomes: (pushers, outcomes * (1.0, 1.0, scale)))
    pushers, outcomes = (np.concatenate(rows) for rows in zip(*((o.pushers, o.outcomes) for o in objects), strict=True))
    figures = compare_statistics(pushers, outcomes, published_normalisation())

    found = [item.severity for item in odd_statistics("here", figures, len(pushers), SurfaceKind.PLYWOOD)]
    assert found == ([] if severity is None else [severity])


@pytest.mark.parametrize(("shift", "severity"), [(0.005, None), (0.03, WARNING), (0.08, ERROR)])
def test_another_origin_is_reported(shift: float, severity: Severity | None) -> None:
    """A mean far from the published one, in published deviations, is reported."""
    found = codes_of(changed(lambda pushers, outcomes: (pushers + np.array([shift, 0, 0]), outcomes)))

    assert found == ([] if severity is None else [(severity, "statistics")])


def test_few_pushes_are_not_compared() -> None:
    """Statistics of few pushes are not compared, and the number of pushes is reported."""
    assert codes_of(plausible_objects(100)) == [(WARNING, "statistics"), (WARNING, "rows-far-from-250")]


@pytest.mark.parametrize(("rows", "severity"), [(1, WARNING), (40, ERROR)])
@pytest.mark.parametrize("column", ["pusher", "object"])
def test_angles_that_are_not_wrapped_are_reported(rows: int, severity: Severity, column: str) -> None:
    """A few unwrapped angles are a warning, and one in a hundred is an error, as the service wraps angles."""
    objects = plausible_objects()
    (objects[0].pushers if column == "pusher" else objects[0].outcomes)[:rows, 2] = 3.2

    found = [finding for finding in findings(objects) if finding.code == "angles-unwrapped"]
    assert [finding.severity for finding in found] == [severity]
    assert {"pusher": "push angles", "object": "object yaws"}[column] in found[0].message


def test_pi_in_single_precision_is_wrapped() -> None:
    """Pi as float32, which is above pi, and -pi, which arctan2 may give, count as wrapped."""
    objects = plausible_objects()
    objects[0].pushers[:2, 2] = np.float32(math.pi), -np.float32(math.pi)

    assert findings(objects) == []


@pytest.mark.parametrize(("share", "severity"), [(0.01, None), (0.29, None), (0.4, WARNING), (0.7, ERROR)])
def test_pushes_without_contact_are_reported(share: float, severity: Severity | None) -> None:
    """Pushes without contact are reported if they are many more than the 29 % of the raw recordings."""
    still = round(share * 250)

    def stop(pushers: Array, outcomes: Array) -> tuple[Array, Array]:
        outcomes[:still] = 1e-5
        return pushers, outcomes

    found = [finding.severity for finding in findings(changed(stop)) if finding.code == "no-contact"]
    assert found == ([] if severity is None else [severity])


def test_an_object_that_never_moved_is_an_error() -> None:
    """An object that never moved, as if not tracked, is an error even if the others moved."""
    objects = plausible_objects()
    objects[2].outcomes[:] = 0.0

    found = next(finding for finding in findings(objects) if finding.code == "objects-still")
    assert found.severity is ERROR
    assert FOUR[2] in found.message
    assert FOUR[1] not in found.message


@pytest.mark.parametrize(("rows", "odd"), [(225, False), (275, False), (224, True), (276, True)])
def test_objects_with_far_from_250_pushes_are_reported(rows: int, odd: bool) -> None:
    """An object may have up to 25 pushes more or fewer than the published 250."""
    objects = [*plausible_objects(), ObjectPushes("4a4a4a4a", *plausible_pushes(rows, 9), ("float64", "float64"))]

    assert codes_of(objects) == ([(WARNING, "rows-far-from-250")] if odd else [])
    assert all(f"4a4a4a4a ({rows})" in finding.message for finding in findings(objects))


def test_repeated_pushes_are_reported() -> None:
    """Repeated pushes are counted by object."""
    objects = plausible_objects()
    for array in (objects[1].pushers, objects[1].outcomes):
        array[5:8] = array[0]

    (found,) = findings(objects)
    assert (found.severity, found.code) == (WARNING, "pushes-twice")
    assert f"{FOUR[1]} (3)" in found.message


def test_half_precision_is_reported() -> None:
    """Files of float16, which rounds positions noticeably, are a warning."""
    objects = plausible_objects()
    objects[0] = ObjectPushes(FOUR[0], objects[0].pushers, objects[0].outcomes, ("float64", "float16"))

    assert codes_of(objects) == [(WARNING, "precision")]


def turned(item: ObjectPushes, descriptor: str) -> ObjectPushes:
    """Return the same pushes of the object turned by +90 degrees."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    pushers, outcomes = item.pushers.copy(), item.outcomes.copy()
    pushers[:, :2], outcomes[:, :2] = pushers[:, :2] @ turn.T, outcomes[:, :2] @ turn.T
    pushers[:, 2] = np.angle(np.exp(1j * (pushers[:, 2] + math.pi / 2)))
    return ObjectPushes(descriptor, pushers, outcomes, item.dtypes)


def test_an_object_under_two_descriptors_is_an_error() -> None:
    """A turned descriptor of the same object is an error, with the same pushes in the other frame or with others."""
    objects = plausible_objects()
    same = turned(objects[1], "4a1a2b3c")
    other = ObjectPushes("4a1a2b3c", *plausible_pushes(250, 77), ("float64", "float64"))

    for second, words in ((same, "hold the same pushes"), (other, "hold different pushes")):
        (found,) = findings([*objects, second])
        assert (found.severity, found.code) == (ERROR, "object-twice")
        assert f"{FOUR[1]} and 4a1a2b3c are the same object" in found.message
        assert words in found.message


def test_the_same_pushes_under_two_names_are_an_error() -> None:
    """Two objects with the same pushes in any order are an error, as one may be tested on the other's training data."""
    objects = plausible_objects()
    order = np.random.default_rng(3).permutation(250)
    objects[3] = ObjectPushes(FOUR[3], objects[0].pushers[order], objects[0].outcomes[order], objects[0].dtypes)

    (found,) = findings(objects)
    assert (found.severity, found.code) == (ERROR, "same-pushes")
    assert f"{FOUR[0]} and {FOUR[3]}" in found.message


def twin(item: ObjectPushes) -> Array:
    """Return the normalised twin of an object."""
    return np.column_stack(published_normalisation().normalised(item.pushers, item.outcomes))


def test_twins_that_agree_have_no_finding() -> None:
    """A normalised twin agrees in double and in single precision."""
    item = plausible_objects()[0]
    for array in (twin(item), twin(item).astype(np.float32).astype(np.float64)):
        assert list(odd_normalised("here", {item.descriptor: (item, array)})) == []


@pytest.mark.parametrize(
    ("change", "severity", "code"),
    [
        pytest.param(lambda array: array[:-1], ERROR, "twin-differs", id="a push is missing"),
        pytest.param(lambda array: array[::-1], ERROR, "twin-differs", id="another order"),
        pytest.param(lambda array: array * 1.1 + 0.2, WARNING, "twin-statistics", id="other statistics"),
    ],
)
def test_twins_that_disagree_are_reported(change: Callable[[Array], Array], severity: Severity, code: str) -> None:
    """A twin with other pushes is an error, and one with other statistics is a warning."""
    item = plausible_objects()[0]

    (found,) = odd_normalised("here", {item.descriptor: (item, change(twin(item)))})
    assert (found.severity, found.code) == (severity, code)
    assert item.descriptor in found.message


def test_quantiles_far_from_another_table_are_found() -> None:
    """Compare each quantile, with a slack of half a millimetre and half a degree for small ones."""
    here = MotionQuantiles(0.1, (1.0, 8.0, 17.0, 27.0, 50.0), (0.6, 3.6, 8.3, 14.6, 20.8))
    there = MotionQuantiles(0.1, (1.4, 8.5, 17.0, 27.0, 36.4), (0.6, 3.6, 8.3, 14.6, 20.8))

    (found,) = odd_quantiles("here", here, there, "Omnipush")
    assert found.message.endswith("differ from those of Omnipush by over 15 %: 95 %: 50.0 instead of 36.4")


def test_motion_unlike_the_recorded_one_is_a_warning_unless_units_are_wrong() -> None:
    """A ring of starts moves every object by 12 mm and more: a warning names the quantiles, beside none for units."""
    figures = compare_statistics(*plausible_pushes(500, 1), published_normalisation())
    ring = MotionQuantiles(0.0, (12.0, 15.6, 19.0, 25.1, 38.0), (0.8, 4.0, 8.9, 14.1, 21.6))

    (found,) = surface_findings("here", plausible_objects(), figures, ring)
    assert (found.severity, found.code) == (WARNING, "quantiles")
    assert "Omnipush's recordings by over 15 %: 5 %: 12.0 instead of 1.8, 25 %: 15.6 instead of 7.8" in found.message
    assert surface_findings("here", plausible_objects(), figures, recorded_motion()) == []
    millimetres = changed(lambda pushers, outcomes: (pushers * (1e3, 1e3, 1.0), outcomes * (1e3, 1e3, 1.0)))
    figures = compare_statistics(
        np.concatenate([item.pushers for item in millimetres]),
        np.concatenate([item.outcomes for item in millimetres]),
        published_normalisation(),
    )
    assert {each.code for each in surface_findings("here", millimetres, figures, ring)} == {"units"}
