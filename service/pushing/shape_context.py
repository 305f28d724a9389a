"""Shape contexts: an object of any outline, and what is known of its body, as the tensors of a shape model.

``ShapeContext.tensors`` is the only conversion. Trainer and service call it, so both see the same numbers. It keeps
metres for mechanics, and adds a silhouette that is centred on the centroid and divided by the object's size (the root
mean square distance of its area from the centroid), because quasi-static pushing has no length scale of its own.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from service.model.tensors import ContextKind, FloatArray
from service.pushing.mechanics import moment_arm_m
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.support import EVEN_PRESSURE, MOST_POINTS, Pressure, support

PUSHER_RADIUS_M: Final = 0.00475  # of a tip of unknown radius: that of Omnipush
FRICTION: Final = 0.20  # of tip and object, if it is not known: least error on recorded pushes of steel shapes
SURE: Final = 0.1  # std of a centre of mass in sizes of the object, above which it counts as not known
SHAPE_REACH_M: Final = 10.0  # of corners and pushers from the origin of the caller's frame
CORNERS: Final = 64  # of the outline that a graph takes
SILHOUETTE_SIZE: Final = 32
SILHOUETTE_REACH: Final = 2.4  # half of the silhouette's width, in sizes of the object
BODY: Final = (
    "centroid_x",
    "centroid_y",
    "size",
    "centre_of_mass_x",
    "centre_of_mass_y",
    "centre_of_mass_is_known",
    "moment_arm",
    "friction",
    "friction_is_known",
    "pusher_radius",
    "pusher_radius_is_known",
)
BODY_UNITS: Final = ("m", "m", "m", "m", "m", "1", "m", "1", "1", "m", "1")


class ShapeTensors(NamedTuple):
    """Tensors of one object, float32."""

    silhouette: FloatArray
    """(1, 32, 32) signed distances from the outline, in sizes, negative inside, clipped to -1..1. x right, y up."""
    outline: FloatArray
    """(64, 2) m, counter-clockwise, in the caller's frame. The last corner is repeated to fill it."""
    support: FloatArray
    """(37, 3) x_m, y_m of the points on which the object rests, and their shares of its weight. Free rows hold 0."""
    body: FloatArray
    """(11,) the values that ``BODY`` names."""


@dataclass(frozen=True, eq=False, slots=True)
class ShapeContext:
    """An object of any outline. Values of None are not known.

    Attributes:
        outline: of the object, in the caller's frame, which is the object frame.
        centre_of_mass_m: (x, y) in that frame.
        friction: coefficient of friction of pusher and object.
        pusher_radius_m: radius of the round tip.
        pressure: spread of the weight over the underside, see ``support``.
        centre_is_sure: whether the centre of mass counts as known: not if pushes have told it only about.
    """

    outline: Outline
    centre_of_mass_m: tuple[float, float] | None = None
    friction: float | None = None
    pusher_radius_m: float | None = None
    pressure: Pressure | None = None
    centre_is_sure: bool = True

    @property
    def kind(self) -> ContextKind:
        """Return the kind of this context."""
        return ContextKind.SHAPE

    def tensors(self) -> ShapeTensors:
        """Return the tensors that a shape model takes."""
        outline = self.outline
        centre = outline.centroid_m if self.centre_of_mass_m is None else np.array(self.centre_of_mass_m)
        body = [
            *outline.centroid_m,
            outline.size_m,
            *centre,
            self.centre_of_mass_m is not None and self.centre_is_sure,
            moment_arm_m(outline, centre),  # of even pressure, as in training
            FRICTION if self.friction is None else self.friction,
            self.friction is not None,
            PUSHER_RADIUS_M if self.pusher_radius_m is None else self.pusher_radius_m,
            self.pusher_radius_m is not None,
        ]
        bearing = np.zeros((MOST_POINTS, 3), dtype=np.float32)
        points, shares = support(outline, centre, self.pressure or EVEN_PRESSURE)
        bearing[: len(points)] = np.column_stack([points, shares])
        return ShapeTensors(silhouette(outline), _fixed(outline.corners), bearing, np.array(body, dtype=np.float32))


def silhouette(outline: Outline) -> FloatArray:
    """Return the silhouette of an outline, (1, 32, 32), see ``ShapeTensors``."""
    half = SILHOUETTE_REACH * outline.size_m
    places = ((np.arange(SILHOUETTE_SIZE) + 0.5) / SILHOUETTE_SIZE * 2.0 - 1.0) * half
    x, y = np.meshgrid(places, -places)
    grid = np.stack([x.ravel(), y.ravel()], axis=1) + outline.centroid_m
    distance = np.clip(outline.distance_m(grid) / outline.size_m, -1.0, 1.0)
    return distance.astype(np.float32).reshape(1, SILHOUETTE_SIZE, SILHOUETTE_SIZE)


def reduced(corners: DoubleArray, count: int) -> DoubleArray:
    """Return at most ``count`` of some corners (n, 2): those whose triangles with their neighbours are largest.

    Corners are dropped one after the other, the smallest triangle first (Visvalingam, Whyatt 1993).
    """
    kept = list(range(len(corners)))
    while len(kept) > count:
        at = corners[kept]
        before, after = np.roll(at, 1, axis=0) - at, np.roll(at, -1, axis=0) - at
        kept.pop(int(np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).argmin()))
    return corners[kept]


def _fixed(corners: DoubleArray) -> FloatArray:
    kept = reduced(corners, CORNERS)
    return np.concatenate([kept, np.repeat(kept[-1:], CORNERS - len(kept), axis=0)]).astype(np.float32)
