"""Judging of pushes, objects and predictions: each warning where it belongs, and nowhere else."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.inference.query import FIRST_CONTEXT, ContextBatch
from service.model.manifest import Manifest, Validity
from service.model.tensors import ContextKind, Gaussians
from service.pushing.contexts import ObjectContext, SupportContext
from service.pushing.image_quality import QualityFlag
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import ShapeContext
from service.validity.codes import AnswerWarning
from service.validity.judging import find_warnings
from tests.fakes import draft_manifest

PLAIN = (-0.08, 0.0, 0.0)
RANGES: dict[str, tuple[float, float]] = {"start_distance_m": (0.0, 0.12), "length_m": (0.005, 0.1)}
BOX = ShapeContext(Outline.of([[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]]))


def described(descriptor: str = "1a2b3c4a", count: int = 1) -> ContextBatch:
    """Return the context of pushes of one object by descriptor."""
    tensor = ObjectContext.from_descriptor(descriptor).tensor()[None]
    return ContextBatch(ContextKind.INDICATOR, (tensor,), np.zeros(count, dtype=np.int64), "body.context")


def shaped(count: int = 1, **changes: Any) -> ContextBatch:
    """Return the context of pushes of a box."""
    tensors = tuple(tensor[None] for tensor in BOX.tensors())
    return replace(ContextBatch(ContextKind.SHAPE, tensors, np.zeros(count, dtype=np.int64), "body.context"), **changes)


def seen(levels: DoubleArray) -> ContextBatch:
    """Return the context of a push of the object in a view (32, 32)."""
    return ContextBatch(ContextKind.VISUAL, (levels.astype(np.float32)[None, None],), FIRST_CONTEXT, "body.context")


def older(kind: ContextKind = ContextKind.INDICATOR) -> Manifest:
    """Return the manifest of a version from before there were domains."""
    return replace(draft_manifest(kind=kind), format=2)


def newer(kind: ContextKind = ContextKind.SHAPE) -> Manifest:
    """Return the manifest of a version that has a domain of its own."""
    return replace(draft_manifest(kind=kind), format=3, validity=Validity(RANGES, "objects like those of the tests"))


def supported() -> ContextBatch:
    """Return the context of a push of an object that is known by one push, which starts 0.2 m away."""
    tensors = SupportContext.of(np.array([[-0.2, 0.0, 0.0]]), np.array([[0.02, 0.0, 0.0]])).tensors()
    return ContextBatch(ContextKind.SUPPORT, tuple(one[None] for one in tensors), FIRST_CONTEXT, "body.context")


def answers(count: int = 1, unfamiliar: tuple[float, float] | None = None, moved: float = 0.03) -> Gaussians:
    """Return predictions of objects that move, with the distances of a domain, if any."""
    mean = np.full((count, 3), moved, dtype=np.float32)
    distances = None if unfamiliar is None else np.tile(np.array(unfamiliar, dtype=np.float32), (count, 1))
    return Gaussians(mean, np.full((count, 3), 0.001, dtype=np.float32), distances)


def judged(
    pushers: Any, contexts: ContextBatch, found: Gaussians | None = None, manifest: Manifest | None = None
) -> tuple[AnswerWarning, ...]:
    """Return the warnings of pushes as they are sent."""
    rows = np.atleast_2d(np.array(pushers, dtype=np.float64))
    version = manifest or older(contexts.kind)
    angles = (("pusher.angle", rows[:, 2]),)
    return find_warnings(version, rows.astype(np.float32), angles, contexts, found or answers(len(rows)))


def codes(*given: Any, **named: Any) -> list[str]:
    """Return the codes of the warnings of pushes."""
    return [warning.code.value for warning in judged(*given, **named)]


@pytest.mark.parametrize(
    ("pusher", "expected"),
    [
        (PLAIN, []),
        ((0.0, 0.08, -math.pi / 2), []),
        ((-0.08, 0.0, math.pi), ["no_contact"]),
        ((-0.08, 0.0, 0.5), ["unfamiliar_push"]),
        ((-0.1, 0.0, 0.0), ["unfamiliar_push"]),
        ((-0.07, 0.0, 0.0), ["unfamiliar_push"]),
        ((0.02, 0.0, 0.0), ["starts_inside", "unfamiliar_push"]),
        ((-0.5, 0.0, 0.0), ["no_contact", "unfamiliar_push"]),
        ((-0.08, 0.0, 360.0), ["no_contact", "unfamiliar_push", "angle_looks_like_degrees"]),
        ((-0.08, 0.0, 2 * math.pi), []),
    ],
)
def test_a_push_by_descriptor_of_an_older_version(pusher: tuple[float, ...], expected: list[str]) -> None:
    """Versions without a domain in the manifest vouch for the ring of starts and aims of their training."""
    assert codes(pusher, described()) == expected


def test_a_row_is_judged_alike_alone_and_in_a_batch() -> None:
    """The bounds that settle a plain push at once agree with the columns, for pushes all around an object."""
    rng = np.random.default_rng(5)
    bearing, distance = rng.uniform(-math.pi, math.pi, 400), rng.uniform(0.0, 0.12, 400)
    rows = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-7.0, 7.0, 400)])
    rows[:200, 2] = bearing[:200] + math.pi + rng.uniform(-0.3, 0.3, 200)
    together: dict[int, list[str]] = {row: [] for row in range(400)}
    for warning in judged(rows, described(count=400)):
        for row in warning.rows:
            together[row].append(warning.code.value)
    assert {row: codes(rows[row], described()) for row in together} == together
    assert {len(each) for each in together.values()} >= {0, 1, 2}


def test_rows_are_named_once_and_the_detail_is_that_of_the_first() -> None:
    """A batch has each code once, with its rows in rising order."""
    (miss, strange) = judged([PLAIN, (-0.5, 0.0, 0.0), PLAIN, (-0.6, 0.0, 0.0)], described(count=4))
    assert (miss.code, miss.rows) == ("no_contact", (1, 3))
    assert miss.detail.startswith("row 1: ")
    assert strange.rows == (1, 3)
    assert "starts 0.5 m" in strange.detail


def test_the_context_of_the_only_push_is_the_one_of_its_index() -> None:
    """A batch of one push may have several objects, of which one is pushed."""
    tensors = np.stack([ObjectContext.from_descriptor(each).tensor() for each in ("1a2b3c4a", "1b2b3c4a")])
    for index, expected in ((0, []), (1, ["unfamiliar_object"])):
        contexts = ContextBatch(ContextKind.INDICATOR, (tensors,), np.array([index]), "body.contexts")
        assert codes(PLAIN, contexts) == expected


def test_an_object_with_three_weights_is_unfamiliar() -> None:
    """Omnipush's objects have at most two weights."""
    assert codes(PLAIN, described("1b2b3c4a")) == ["unfamiliar_object"]
    assert "3 sides have a weight" in judged(PLAIN, described("1b2b3c4a"))[0].detail


def test_the_older_model_without_context_knows_no_contact() -> None:
    """Without an object, no contact can be told, and the ring still counts."""
    nothing = ContextBatch(ContextKind.NONE, (), None, "body.context")
    assert codes(PLAIN, nothing) == []
    assert codes((-0.5, 0.0, 0.0), nothing) == ["unfamiliar_push"]


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        ((0.9, 1.0), []),
        ((1.1, 0.5), ["unfamiliar_push"]),
        ((0.5, 1.1), ["unfamiliar_object"]),
        ((2.0, 3.0), ["unfamiliar_push", "unfamiliar_object"]),
    ],
)
@pytest.mark.parametrize("kind", [ContextKind.INDICATOR, ContextKind.SHAPE])
def test_a_newer_version_judges_by_its_distances(
    kind: ContextKind, distances: tuple[float, float], expected: list[str]
) -> None:
    """The graph tells how unfamiliar push and object are, and the ring of older versions does not count."""
    contexts = described() if kind is ContextKind.INDICATOR else shaped()
    found, manifest = answers(1, distances), newer(kind)
    assert codes((-0.1, 0.0, 0.0), contexts, found, manifest) == expected
    both = ContextBatch(kind, contexts.tensors, np.zeros(2, dtype=np.int64), "body.contexts")
    assert codes([(-0.1, 0.0, 0.0)] * 2, both, answers(2, distances), manifest) == expected


def test_a_warning_names_the_feature_out_of_range_or_the_distance() -> None:
    """The words come from the ranges of the manifest, and its note says what the version vouches for."""
    long = judged((-0.1, 0.0, 0.0, 0.3), shaped(), answers(1, (5.0, 0.5)), newer())[0]
    assert "the push is 0.3 m long (known: 0.005 to 0.1 m)" in long.detail
    assert "objects like those of the tests" in long.detail
    strange = judged((-0.1, 0.0, 0.0, 0.05), shaped(), answers(1, (5.0, 0.5)), newer())[0]
    assert "distance 5, known: up to 1" in strange.detail


def test_a_support_tells_of_no_form_and_is_judged_by_its_pushes() -> None:
    """Where an object begins is not known from its support, so no push is said to miss, or to start inside."""
    manifest = replace(
        newer(ContextKind.SUPPORT), validity=Validity({"support_furthest_start_m": (0.05, 0.12)}, "a test")
    )
    for push in ((-0.01, 0.0, 0.0), (-0.1, 0.0, math.pi)):
        assert codes(push, supported(), answers(1, (0.5, 0.5)), manifest) == []
    (strange,) = judged((-0.1, 0.0, 0.0), supported(), answers(1, (0.5, 3.0)), manifest)
    assert strange.code == "unfamiliar_object"
    assert "a push of the support starts 0.2 m from the object's centre (known: 0.05 to 0.12 m)" in strange.detail


def test_a_warning_of_an_object_names_its_feature() -> None:
    """A weight too many, and a friction out of range, are named. A silhouette is told by its distance."""
    ranges: dict[str, tuple[float, float]] = {"weights": (0.0, 2.0), "friction": (0.1, 0.6)}
    strange = answers(1, (0.5, 1.5))
    for contexts, words in (
        (described("1b2b3c4a"), "3 sides of the object have a weight (known: 0 to 2 sides)"),
        (replace(shaped(), tensors=_rough()), "the friction is 0.9 (known: 0.1 to 0.6)"),
        (shaped(), "unlike those that this version knows (distance 1.5, known: up to 1)"),
    ):
        manifest = replace(newer(contexts.kind), validity=Validity(ranges, "a test"))
        (found,) = judged((-0.1, 0.0, 0.0), contexts, strange, manifest)
        assert (found.code, words in found.detail) == ("unfamiliar_object", True), found.detail


def _rough() -> tuple[Any, ...]:
    """Return the tensors of a box with a friction of 0.9."""
    return tuple(tensor[None] for tensor in replace(BOX, friction=0.9).tensors())


def test_a_shape_at_rest_was_missed() -> None:
    """A model of shapes answers exactly zero for a push that misses, and the warning says by how much."""
    (found,) = judged((-0.1, 0.0, math.pi, 0.05), shaped(), answers(1, (0.5, 0.5), moved=0.0), newer())
    assert found.code == "no_contact"
    assert "no nearer than 35 mm" in found.detail


@pytest.mark.parametrize("count", [1, 3])
def test_faults_of_a_photograph_come_with_the_prediction(count: int) -> None:
    """A flag that was raised while the outline was found is a warning of every push of that object."""
    contexts = shaped(count, flags=((QualityFlag.SEVERAL_OBJECTS,),))
    (found,) = judged([(-0.1, 0.0, 0.0, 0.05)] * count, contexts, answers(count, (0.5, 0.5)), newer())
    assert (found.code, found.rows) == ("image_several_objects", tuple(range(count)))


def test_faults_of_a_view_come_with_the_prediction() -> None:
    """A view of nothing is blank, and one of a box at its side is clipped, off the centre and of no known object."""
    assert "image_blank" in codes(PLAIN, seen(np.zeros((32, 32))))
    beside = np.zeros((32, 32))
    beside[8:24, :12] = 0.5
    assert set(codes(PLAIN, seen(beside))) >= {"image_clipped", "image_off_centre", "unfamiliar_object"}


def test_an_angle_in_the_world_may_look_like_degrees() -> None:
    """Every angle of a request counts, and the warning names its field and the angle that may be meant."""
    angles = (("pusher.angle", (0.0,)), ("object_pose.angle", (-90.0,)))
    pushers = np.array([PLAIN], dtype=np.float32)
    (found,) = find_warnings(older(), pushers, angles, described(), answers())
    assert found.code == "angle_looks_like_degrees"
    assert found.detail.startswith("object_pose.angle: -90 rad")
    assert "send -1.571" in found.detail
