"""Benchmark of warnings: queries are what they are said to be, are asked and counted, and the page is written."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.warning_pictures import photograph_queries, view_queries
from benchmarks.warning_queries import (
    MARGIN_M,
    MISSING,
    TOUCHING,
    Pushed,
    Queries,
    faulty_omnipush,
    faulty_pushes,
    faulty_shapes,
    inside_queries,
    omnipush_pushes,
    shape_pushes,
)
from benchmarks.warnings import FIGURES_FILE, PAGE_FILE, REFUSED, asked, counted, main, queries_of, summary
from service.client import Client
from service.pushing.images import decode_colour
from service.registry.registry import Registry
from service.validity.codes import WarningCode
from tests.served_graphs import publish_shapes
from training.omnipush.published import different_objects

NO_CONTACT, STRANGE = WarningCode.NO_CONTACT, WarningCode.UNFAMILIAR_OBJECT


def drawn(kind: str = "indicator", count: int = 100, **options: bool) -> Pushed:
    """Return pushes of Omnipush's objects."""
    return omnipush_pushes(kind, count, np.random.default_rng(1), **options)


def test_pushes_inside_are_of_held_out_objects_and_near_misses_are_left_out() -> None:
    """Every held-out object is pushed, and no push that touches is among those that miss."""
    pushed = drawn(count=500)
    assert tuple(pushed.contexts) == different_objects().test
    touching, missing = inside_queries(pushed, knows_object=True)
    assert (touching.name, touching.due) == (TOUCHING, ())
    assert (missing.name, missing.due) == (MISSING, (NO_CONTACT,))
    assert len(touching.pushers) > 5 * len(missing.pushers) > 0
    assert not (pushed.missing(MARGIN_M) & ~pushed.missing()).any()
    noise = np.abs(pushed.pushers - pushed.true).max(axis=0)
    assert 0.0 < noise[0] < 0.003
    assert noise[3] == 0.0


def test_a_version_without_a_domain_is_asked_its_ring() -> None:
    """Starts lie in the ring that the older versions were trained on."""
    start_m = np.hypot(*drawn(ring=True).true[:, :2].T)
    assert start_m.min() > 0.075
    assert start_m.max() < 0.0855


@pytest.mark.parametrize("kind", ["indicator", "none"])
def test_faults_of_pushes_are_those_that_are_named(kind: str) -> None:
    """Starts inside overlap, far ones are far and aimed at the object, and angles are whole degrees."""
    pushed, rng = drawn(kind), np.random.default_rng(2)
    faults = {one.name: one for one in (*faulty_pushes(pushed, rng, True), *faulty_omnipush(pushed, kind, rng))}
    degrees = faults["angles in whole degrees"].pushers[:, 2]
    assert (degrees == np.rint(degrees)).all()
    inside = faults["starts that overlap by 2 mm or more"]
    for number, outline in enumerate(pushed.outlines):
        rows = inside.pushers[pushed.index == number]
        assert (outline.distance_m(rows[:, :2]) < pushed.radii_m[0] - MARGIN_M).all()
    far = faults["starts 130 to 250 mm from the centre, aimed at the object"].pushers
    assert np.hypot(far[:, 0], far[:, 1]).min() >= 0.13
    assert np.abs(np.cos(far[:, 2]) * far[:, 1] - np.sin(far[:, 2]) * far[:, 0]).max() < 0.03
    heavy = faults.get("objects with 3 weights")
    assert (heavy is not None) is (kind == "indicator")
    if heavy is not None:
        assert {sum(letter not in "a1234" for letter in str(name)) for name in heavy.contexts} == {3}


def test_shapes_are_of_every_family_and_their_faults_can_be_sent(tmp_path: Path) -> None:
    """Every query is a valid request, except those that the service refuses by design."""
    publish_shapes(Registry(tmp_path))
    pushed = shape_pushes(60, np.random.default_rng(3))
    every = [*inside_queries(pushed, True), *faulty_shapes(40, np.random.default_rng(4))]
    assert len({one.name for one in every}) == len(every)
    with Client.local(str(tmp_path)) as client:
        refused = {one.name: sum(REFUSED in of_one for of_one in asked(client, "push-shape", one)) for one in every}
    assert {name for name, many in refused.items() if many} == {"a centre of mass 1.5 to 3 sizes off the centroid"}


def test_pictures_are_files_with_one_push_each() -> None:
    """Views are square, photographs come with their scale, and only the first kind of each has no fault."""
    for queries in (view_queries(1, np.random.default_rng(5)), photograph_queries(1, np.random.default_rng(6))):
        assert [one.inside for one in queries] == [True] + [False] * (len(queries) - 1)
        for one in queries:
            (picture,) = one.pictures
            assert decode_colour(picture).levels.std() >= 0.0
            assert one.pushers.shape == (1, 4)
            assert len(one.scales_m) in (0, 1)


def made(name: str, due: tuple[WarningCode, ...], inside: bool) -> Queries:
    """Return queries without content."""
    return Queries(name, due, inside, np.zeros((4, 4)))


def test_codes_are_counted_by_what_is_due() -> None:
    """A code that is not due is a false alarm inside, and a refusal counts as caught outside."""
    touch = counted("m@1", made("touch", (), True), [set(), {"no_contact"}, set(), set()])
    miss = counted("m@1", made("miss", (NO_CONTACT,), True), [{"no_contact"}] * 3 + [{"unfamiliar_object"}])
    box = counted("m@1", made("box", (STRANGE,), False), [{"unfamiliar_object"}, {REFUSED}, set(), {"no_contact"}])
    assert (touch.caught, miss.caught, box.caught, box.refused) == (0, 3, 2, 1)
    rows = {row["code"]: row for row in summary([touch, miss, box])}
    assert set(rows) == {"no_contact", "unfamiliar_object"}
    assert rows["no_contact"] == {
        "code": "no_contact", "model": "m@1", "outside": 4, "caught": 75.0, "inside": 4, "false_alarms": 25.0,
    }  # fmt: skip
    assert (rows["unfamiliar_object"]["caught"], rows["unfamiliar_object"]["false_alarms"]) == (50.0, 12.5)


def test_a_refused_row_does_not_hide_its_batch(project_root: Path) -> None:
    """If a batch is refused, its pushes are asked one by one."""
    pushers = np.array([[-0.08, 0.0, 0.0, 0.05], [-0.08, 0.0, 0.0, 0.07]])
    queries = Queries("lengths", (), False, pushers, ("1a2b3c4a",), np.zeros(2, dtype=np.int64))
    with Client.local(str(project_root / "models")) as client:
        assert asked(client, "push-indicator", queries) == [set(), {REFUSED}]


def test_the_page_has_every_code_and_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run on one model writes page and figures, and the figures hold the worst code."""
    main(["--count", "50", "--model", "push-indicator", "--out", str(tmp_path)])
    assert f"wrote {tmp_path}" in capsys.readouterr().out
    figures: dict[str, Any] = json.loads((tmp_path / FIGURES_FILE).read_text())
    assert figures["least_caught"] == min(row["caught"] for row in figures["by_code"])
    text = (tmp_path / PAGE_FILE).read_text()
    assert all(f"| `{row['code']}` | push-indicator@" in text for row in figures["by_code"])
    assert all(one["name"] in text for one in figures["kinds"])


def test_an_unknown_model_is_one_line() -> None:
    """The command ends with the problem of the service."""
    with pytest.raises(SystemExit, match="unknown_model"):
        main(["--model", "absent"])


def test_a_model_without_context_is_asked_without_objects() -> None:
    """Pushes alone are inside or outside, and no contact is due."""
    found = list(queries_of("none", 20, 1, 7, has_domain=True))
    assert {one.inside for one in found} == {True, False}
    assert not any(one.contexts for one in found)
    assert NO_CONTACT not in {code for one in found for code in one.due}
