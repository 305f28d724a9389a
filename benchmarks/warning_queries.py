"""Queries with known warnings: pushes and objects as those of training, and ones beyond that a user may send.

Every query is drawn. Those inside are pushes that nothing was trained on, of objects that were held out. Those outside
have one fault each, and the codes of which one is due.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import shapely

from service.client.arguments import Context
from service.model.tensors import IndexArray
from service.pushing.contexts import SHAPE_DIGITS, SIDES, ObjectContext
from service.pushing.first_contact import first_contact
from service.pushing.images import GreyImage, visual_context
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.pushing.shape_context import PUSHER_RADIUS_M
from service.pushing.sides import outline
from service.schemas.contexts import ContextBody
from service.validity.codes import WarningCode
from training.omnipush.published import different_objects
from training.shapes.dataset import ANYWHERE, PUSH_LENGTHS_M
from training.shapes.families import FAMILIES
from training.shapes.objects import DrawnObject, draw_object
from training.shapes.pieces import log_between
from training.simulation.approach import draw_pushers
from training.simulation.dataset import record
from training.simulation.drawing import photograph, top_down_view
from training.simulation.plans import APPROACH, OMNIPUSH_APPROACH, RING, sample_pushers
from training.simulation.solids import solid

TOUCHING, MISSING = "pushes as in training that touch", "pushes as in training that miss"
PUSHES_OF_ONE: Final = 20
SINGLE: Final = 200  # queries that are refused, and therefore sent alone
MARGIN_M: Final = 0.002  # of contact and overlap, beyond the tracker's noise
TOO_FAR_M: Final = (0.13, 0.25)  # of starts from the centre: Omnipush's objects are 126 mm wide
_HEAVY: Final = "bc"  # weights that every shape of side may have


@dataclass(frozen=True, eq=False)
class Queries:
    """Queries of one kind for one model.

    Attributes:
        name: of the kind.
        due: codes of which one is due, the one that is counted first. Empty if none is.
        inside: whether the model vouches for them, so that any other code is a false alarm.
        pushers: (n, 4) x_m, y_m, angle_rad, length_m.
        contexts: distinct contexts, or none.
        index: (n,) context, or picture, of each push.
        pictures: image files that are sent instead of contexts.
        scales_m: metres per pixel of each picture, or none.
    """

    name: str
    due: tuple[WarningCode, ...]
    inside: bool
    pushers: DoubleArray
    contexts: Sequence[Context] = ()
    index: IndexArray | None = None
    pictures: Sequence[bytes] = ()
    scales_m: Sequence[float] = ()


@dataclass(frozen=True, eq=False)
class Pushed:
    """Objects with pushes as in training, with the tracker's noise.

    Attributes:
        outlines: of the objects.
        contexts: of the objects, or none.
        index: (n,) object of each push.
        true: (n, 4) pushes.
        pushers: (n, 4) pushes as they are measured.
        radii_m: (n,) radius of the tip.
    """

    outlines: Sequence[Outline]
    contexts: Sequence[Context]
    index: IndexArray
    true: DoubleArray
    pushers: DoubleArray
    radii_m: DoubleArray

    def missing(self, gap_m: float = 0.0) -> np.ndarray:
        """Return (n,) true for the pushes whose tip stays away from its object by more than a gap."""
        found = np.zeros(len(self.true), dtype=np.bool_)
        for number, one in enumerate(self.outlines):
            rows = self.index == number
            radius_m = float(self.radii_m[rows][0]) + gap_m
            found[rows] = np.isinf(first_contact(one, self.true[rows], radius_m).travel_m)
        return found

    def queries(
        self,
        name: str,
        due: tuple[WarningCode, ...] = (),
        inside: bool = False,
        rows: DoubleArray | None = None,
        chosen: np.ndarray | None = None,
    ) -> Queries:
        """Return queries of these objects, of other pushes (n, 4) if any, or of some rows only."""
        picked = slice(None) if chosen is None else chosen
        pushers = (self.pushers if rows is None else rows)[picked]
        return Queries(name, due, inside, pushers, self.contexts, self.index[picked] if self.contexts else None)

    def drawn(self, draw: Callable[[Outline, float], Sequence[float]]) -> DoubleArray:
        """Return a push (n, 4) for each row, drawn for the outline of its object and the radius of its tip."""
        pairs = zip(self.index.tolist(), self.radii_m.tolist(), strict=True)
        return np.array([draw(self.outlines[number], radius_m) for number, radius_m in pairs])


def omnipush_pushes(
    kind: str, count: int, rng: np.random.Generator, ring: bool = False, camera: bool = False
) -> Pushed:
    """Draw pushes of Omnipush's held-out objects, from the plan of the version's training."""
    names = different_objects().test
    each, plan = max(1, round(count / len(names))), RING if ring else APPROACH
    objects = [ObjectContext.from_descriptor(name) for name in names]
    outlines = [outline(one) for one in objects]
    true = np.concatenate([_omnipush_rows(one, each, rng, ring) for one in objects])
    pushers = true.copy()
    pushers[:, :3] = record(true[:, :3], np.zeros((len(true), 3)), rng, plan)[0]
    contexts: list[Context] = []
    if kind == "indicator":
        contexts = list(names)
    elif kind == "visual":
        contexts = [visual_body(photograph(name, 7) if camera else top_down_view(one)) for name, one in _named(names)]
    index = np.repeat(np.arange(len(names)), each)
    return Pushed(outlines, contexts, index, true, pushers, np.full(len(true), PUSHER_RADIUS_M))


def visual_body(picture: np.ndarray) -> ContextBody:
    """Return a picture [481, 481] as a visual context."""
    levels = np.frombuffer(visual_context(GreyImage(picture)).levels, dtype=np.uint8).reshape(32, 32)
    return ContextBody(visual=(levels / 255.0).tolist())


def _named(names: Sequence[str]) -> list[tuple[str, ObjectContext]]:
    return [(name, ObjectContext.from_descriptor(name)) for name in names]


def _omnipush_rows(context: ObjectContext, count: int, rng: np.random.Generator, ring: bool) -> DoubleArray:
    if ring:
        return np.column_stack([sample_pushers(solid(context), count, rng), np.full(count, PUSH_LENGTH_M)])
    return draw_pushers(outline(context), np.full(count, PUSH_LENGTH_M), PUSHER_RADIUS_M, rng, OMNIPUSH_APPROACH)


def shape_pushes(count: int, rng: np.random.Generator) -> Pushed:
    """Draw pushes of drawn objects of every family, with the parts of their bodies that clients know."""
    families = list(FAMILIES)
    objects = [draw_object(families[number % len(families)], rng) for number in range(-(-count // PUSHES_OF_ONE))]
    true = []
    for one in objects:
        lengths_m = np.array([log_between(rng, *PUSH_LENGTHS_M) for _ in range(PUSHES_OF_ONE)])
        true.append(draw_pushers(one.outline, lengths_m, one.pusher_radius_m, rng, ANYWHERE))
    return _shapes(
        [one.outline for one in objects], np.concatenate(true), [_body(one, rng) for one in objects], objects
    )


def _shapes(
    outlines: Sequence[Outline], rows: DoubleArray, contexts: Sequence[ContextBody], objects: Sequence[DrawnObject]
) -> Pushed:
    index = np.repeat(np.arange(len(outlines)), PUSHES_OF_ONE)
    radii_m = np.array([one.pusher_radius_m for one in objects])[index]
    return Pushed(outlines, list(contexts), index, rows, rows, radii_m)


def _body(one: DrawnObject, rng: np.random.Generator, **changes: object) -> ContextBody:
    known: dict[str, object] = {"outline": one.outline.corners.tolist(), "pusher_radius": one.pusher_radius_m}
    if np.hypot(*(np.array(one.centre_of_mass_m) - one.outline.centroid_m)) > 0.02 * one.outline.size_m:
        known["centre_of_mass"] = list(one.centre_of_mass_m)
    if rng.random() < 0.5:
        known["friction"] = one.friction
    return ContextBody.model_validate(known | changes)


def inside_queries(pushed: Pushed, knows_object: bool, of: str = "") -> list[Queries]:
    """Return the pushes as in training, those that touch and those that miss. Near misses are left out."""
    missing = (WarningCode.NO_CONTACT,) if knows_object else ()
    return [
        pushed.queries(TOUCHING + of, (), inside=True, chosen=~pushed.missing()),
        pushed.queries(MISSING + of, missing, inside=True, chosen=pushed.missing(MARGIN_M)),
    ]


def faulty_pushes(pushed: Pushed, rng: np.random.Generator, knows_object: bool) -> list[Queries]:
    """Return pushes with one fault that any model may be sent."""
    degrees = pushed.pushers.copy()
    degrees[:, 2] = np.rint(np.degrees(degrees[:, 2]))
    found = [pushed.queries("angles in whole degrees", (WarningCode.ANGLE_LOOKS_LIKE_DEGREES,), rows=degrees)]
    if knows_object:
        inside = pushed.drawn(lambda one, radius_m: [*_point_inside(one, radius_m, rng), *_direction(rng)])
        found.append(pushed.queries("starts that overlap by 2 mm or more", (WarningCode.STARTS_INSIDE,), rows=inside))
    return found


def faulty_omnipush(pushed: Pushed, kind: str, rng: np.random.Generator) -> list[Queries]:
    """Return pushes and objects that no version for Omnipush's objects was trained on."""
    due = (WarningCode.UNFAMILIAR_PUSH,)
    far = np.column_stack([_far_starts(len(pushed.pushers), TOO_FAR_M, rng), pushed.pushers[:, 3]])
    longer = pushed.pushers.copy()
    longer[:, 3] = rng.choice([0.01, 0.02, 0.03, 0.07, 0.1, 0.15], len(longer))
    found = [
        pushed.queries("starts 130 to 250 mm from the centre, aimed at the object", due, rows=far),
        pushed.queries(
            "pushes of 10 to 150 mm instead of 50", due, rows=longer, chosen=np.arange(len(longer))[:SINGLE]
        ),
    ]
    if kind == "indicator":
        for weights in (3, 4):
            names = [_descriptor(weights, rng) for _ in pushed.contexts]
            heavy = Pushed(pushed.outlines, names, pushed.index, pushed.true, pushed.pushers, pushed.radii_m)
            found.append(heavy.queries(f"objects with {weights} weights", (WarningCode.UNFAMILIAR_OBJECT,)))
    return found


def faulty_shapes(count: int, rng: np.random.Generator) -> list[Queries]:
    """Return pushes and objects that no version for objects of any shape was trained on."""
    pushed = shape_pushes(count, rng)
    push, thing = (WarningCode.UNFAMILIAR_PUSH,), (WarningCode.UNFAMILIAR_OBJECT,)
    found = []
    for words, low, high in (("of 0.2 to 0.5 m", 0.2, 0.5), ("of 0.5 to 2.5 mm", 0.0005, 0.0025)):
        rows = pushed.pushers.copy()
        rows[:, 3] = rng.uniform(low, high, len(rows))
        found.append(pushed.queries(f"pushes {words}", push, rows=rows))
    far = pushed.drawn(lambda one, _: [*_far_start(one, rng), 0.05])
    found.append(pushed.queries("starts 30 to 60 sizes of the object from it, aimed at it", push, rows=far))
    for words, low, high in (("0.6 to 1.8 m wide", 0.6, 1.8), ("5.1 to 7 mm wide", 0.0051, 0.007)):
        found.append(_changed(f"objects {words}", thing, count, rng, partial(_sized, low_m=low, high_m=high, rng=rng)))
    changes: dict[str, Callable[[DrawnObject], dict[str, object]]] = {
        "friction of 0.9 to 2": lambda _: {"friction": float(rng.uniform(0.9, 2.0))},
        "a tip 1.2 to 3 times as wide as the object": lambda one: {
            "pusher_radius": float(np.clip(rng.uniform(0.6, 1.5) * one.outline.extent_m, 0.0005, 0.1))
        },
        "a centre of mass 1.5 to 3 sizes off the centroid": lambda one: {
            "centre_of_mass": (
                one.outline.centroid_m + rng.uniform(1.5, 3.0) * one.outline.size_m * np.array(_unit(rng))
            ).tolist()
        },
    }
    for words, change in changes.items():
        found.append(_changed(words, thing, count, rng, lambda one: one, change))
    found.append(_changed("combs, springs, gears and branches", thing, count, rng, lambda one: _strange(one, rng)))
    return found


def _changed(
    name: str,
    due: tuple[WarningCode, ...],
    count: int,
    rng: np.random.Generator,
    outline_of: Callable[[DrawnObject], DrawnObject],
    change: Callable[[DrawnObject], dict[str, object]] = lambda _: {},
) -> Queries:
    """Return pushes of drawn objects that were changed."""
    families = list(FAMILIES)
    objects = [outline_of(draw_object(str(rng.choice(families)), rng)) for _ in range(-(-count // PUSHES_OF_ONE))]
    bodies = [_body(one, rng, **change(one)) for one in objects]
    rows = []
    for one, body in zip(objects, bodies, strict=True):
        lengths_m = np.clip(rng.uniform(0.3, 1.0, PUSHES_OF_ONE) * one.outline.size_m, *PUSH_LENGTHS_M)
        rows.append(draw_pushers(one.outline, lengths_m, float(body.pusher_radius or PUSHER_RADIUS_M), rng, ANYWHERE))
    return _shapes([one.outline for one in objects], np.concatenate(rows), bodies, objects).queries(name, due)


def _sized(one: DrawnObject, low_m: float, high_m: float, rng: np.random.Generator) -> DrawnObject:
    return _with_outline(one, one.outline.corners * (rng.uniform(low_m, high_m) / one.outline.extent_m))


def _with_outline(one: DrawnObject, corners: DoubleArray) -> DrawnObject:
    shape = Outline.of(corners)
    radius_m = min(one.pusher_radius_m, 0.1 * shape.extent_m)
    return DrawnObject(one.family, shape, tuple(shape.centroid_m.tolist()), one.mass_kg, one.friction, radius_m)


def _strange(one: DrawnObject, rng: np.random.Generator) -> DrawnObject:
    """Return an object of an outline that is of no family."""
    kind = int(rng.integers(4))
    if kind == 0:  # a comb
        teeth = int(rng.integers(5, 9))
        bars = [shapely.box(2 * tooth, 0, 2 * tooth + 1, 8) for tooth in range(teeth)]
        shape = shapely.union_all([shapely.box(0, 0, 2 * teeth - 1, 1.5), *bars])
    elif kind == 1:  # a spring
        turns = np.arange(int(rng.integers(5, 9)))
        line = np.column_stack([np.repeat(turns, 2) * 2.0, np.tile([0.0, 7.0, 7.0, 0.0], len(turns))[: 2 * len(turns)]])
        shape = shapely.LineString(line).buffer(0.45, cap_style="flat", join_style="mitre")
    elif kind == 2:  # a gear
        angles = np.linspace(0.0, 2.0 * math.pi, 4 * int(rng.integers(9, 16)), endpoint=False)
        radius = np.tile([1.0, 1.0, 0.6, 0.6], len(angles) // 4)
        shape = shapely.Polygon(np.column_stack([radius * np.cos(angles), radius * np.sin(angles)]))
    else:  # a branch
        arms = [shapely.LineString([(x, 0), (x + 1.5, side * 4)]) for x in (1, 4, 7) for side in (-1, 1)]
        shape = shapely.union_all([shapely.LineString([(0, 0), (10, 0)]), *arms]).buffer(0.3)
    corners = shapely.get_coordinates(shapely.simplify(shapely.get_exterior_ring(shape), 0.02))[:-1]
    return _with_outline(one, corners * (one.outline.extent_m / float(np.ptp(corners, axis=0).max())))


def _descriptor(weights: int, rng: np.random.Generator) -> str:
    """Return a descriptor with a number of weights."""
    heavy = set(rng.permutation(SIDES)[:weights].tolist())
    return "".join(
        f"{rng.choice(list(SHAPE_DIGITS))}{rng.choice(list(_HEAVY)) if side in heavy else 'a'}" for side in range(SIDES)
    )


def _unit(rng: np.random.Generator) -> tuple[float, float]:
    turn = rng.uniform(-math.pi, math.pi)
    return math.cos(turn), math.sin(turn)


def _direction(rng: np.random.Generator) -> tuple[float, float]:
    return float(rng.uniform(-math.pi, math.pi)), PUSH_LENGTH_M


def _point_inside(one: Outline, radius_m: float, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a start at which the tip overlaps an outline."""
    low, high = one.corners.min(axis=0) - radius_m, one.corners.max(axis=0) + radius_m
    while True:
        points = rng.uniform(low, high, (64, 2))
        found = points[one.distance_m(points) < min(radius_m - MARGIN_M, 0.0)]
        if len(found):
            return float(found[0, 0]), float(found[0, 1])


def _far_starts(count: int, ring_m: tuple[float, float], rng: np.random.Generator) -> DoubleArray:
    """Draw starts (count, 3) in a ring, with their angles towards points within 20 mm of the origin."""
    bearing, distance = rng.uniform(-math.pi, math.pi, count), rng.uniform(*ring_m, count)
    start = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])
    ahead = rng.uniform(-0.02, 0.02, (count, 2)) - start
    return np.column_stack([start, np.arctan2(ahead[:, 1], ahead[:, 0])])


def _far_start(one: Outline, rng: np.random.Generator) -> list[float]:
    """Draw a start and its angle towards the centroid."""
    (x, y), distance = _unit(rng), rng.uniform(30.0, 60.0) * one.size_m
    start = one.centroid_m + distance * np.array([x, y])
    return [*start.tolist(), math.atan2(-y, -x)]
