"""Bodies: many hypotheses about the body of one object, as the tensors of a shape model.

A hypothesis is a row of six numbers, without units: the centre of mass (x, y) from the centroid in sizes of the object,
the logarithm of the contact friction, and the pressure (xx, xy, yy), see ``service.pushing.support``. A row of the same
six in SI units has the names ``PARAMETERS``. The outline is encoded once, and everything else in arrays.

Tensors, pushes and outcomes are in the **centroid frame**: the caller's, with its origin moved to the centroid. A turn
about a far origin moves the object far, so that errors of place and turn would hardly be told apart there.
"""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.tensors import FloatArray
from service.pushing.mechanics import moment_arm_m
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import BODY, FRICTION, ShapeContext, ShapeTensors
from service.pushing.support import EVEN_PRESSURE, MOST_POINTS, MOST_PRESSURE, even_points, pressure_terms

PARAMETERS: Final = (
    "centre_of_mass_x",
    "centre_of_mass_y",
    "friction",
    "pressure_xx",
    "pressure_xy",
    "pressure_yy",
)
FRICTIONS: Final = (0.01, 2.0)  # that a context may state
_CENTRE, _FRICTION, _PRESSURE = slice(0, 2), 2, slice(3, 6)
_STATED: Final = (BODY.index("centre_of_mass_x"), BODY.index("centre_of_mass_y"), BODY.index("friction"))
_FLAGS: Final = (BODY.index("centre_of_mass_is_known"), BODY.index("friction_is_known"))
_ARM: Final = BODY.index("moment_arm")
_TRIES: Final = 40
_TILT: Final = 50.0
_RIDGE: Final = 1e-6
_BALANCED: Final = 1e-7  # of the size
_OFF: Final = 1e-3  # of the size: a balance that misses its centre by more is none


class Bodies:
    """Hypotheses about the body of one object.

    Attributes:
        stated: (6,) the hypothesis that a context states, with the usual values for what it leaves open.
    """

    def __init__(self, shape: ShapeContext) -> None:
        """Encode the outline of an object."""
        self._shape = shape
        self._origin = shape.outline.centroid_m
        self._outline = Outline(shape.outline.corners - self._origin)
        self._tensors = ShapeContext(self._outline, pusher_radius_m=shape.pusher_radius_m).tensors()
        self._points = even_points(self._outline)
        self._terms = pressure_terms(self._points, self._outline)
        centre = self._origin if shape.centre_of_mass_m is None else np.array(shape.centre_of_mass_m)
        self.stated: DoubleArray = np.array(
            [
                *(centre - self._origin) / self._outline.size_m,
                np.log(FRICTION if shape.friction is None else shape.friction),
                *(shape.pressure or EVEN_PRESSURE),
            ]
        )

    def in_centroid_frame(self, pushes: DoubleArray, outcomes: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return pushes (k, 4) and outcomes (k, 3) of the caller's frame in the centroid frame."""
        (x, y), yaw = self._origin, outcomes[:, 2]
        turned = np.stack([np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y], axis=1)
        pushes, outcomes = pushes.copy(), outcomes.copy()
        pushes[:, :2] -= self._origin
        outcomes[:, :2] += turned - self._origin
        return pushes, outcomes

    def tensors(self, hypotheses: DoubleArray) -> tuple[ShapeTensors, npt.NDArray[np.bool_]]:
        """Return the tensors of hypotheses (n, 6), each with a leading axis n, and (n,) true for the possible ones.

        A possible one can be stated by a context, and its weight is borne by the points of support.
        """
        count = len(hypotheses)
        centres, friction = hypotheses[:, _CENTRE] * self._outline.size_m, np.exp(hypotheses[:, _FRICTION])
        shares, balances = self._balanced(centres, hypotheses[:, _PRESSURE])
        bearing = np.zeros((count, MOST_POINTS, 3), dtype=np.float32)
        bearing[:, : len(self._points), :2] = self._points
        bearing[:, : len(self._points), 2] = shares
        body = np.repeat(self._tensors.body[None], count, axis=0)
        body[:, _STATED] = np.column_stack([centres, np.clip(friction, *FRICTIONS)])
        body[:, _FLAGS] = 1.0
        body[:, _ARM] = [moment_arm_m(self._outline, centre) for centre in centres]
        silhouette, outline = (_repeated(part, count) for part in (self._tensors.silhouette, self._tensors.outline))
        low, high = self._outline.corners.min(axis=0), self._outline.corners.max(axis=0)
        possible = balances & ((low <= centres) & (centres <= high)).all(axis=1)
        possible &= (friction >= FRICTIONS[0]) & (friction <= FRICTIONS[1])
        possible &= (np.abs(hypotheses[:, _PRESSURE]) <= MOST_PRESSURE).all(axis=1)
        return ShapeTensors(silhouette, outline, bearing, body), possible

    def context(self, hypothesis: DoubleArray) -> ShapeContext:
        """Return the context that states a hypothesis (6,), or the nearest one that it can state, and all else."""
        low, high = self._shape.outline.corners.min(axis=0), self._shape.outline.corners.max(axis=0)
        found = self.in_units(hypothesis)
        x, y = np.clip(found[_CENTRE], low, high).tolist()
        friction = float(np.clip(found[_FRICTION], *FRICTIONS))
        xx, xy, yy = np.clip(found[_PRESSURE], -MOST_PRESSURE, MOST_PRESSURE).tolist()
        return replace(self._shape, centre_of_mass_m=(x, y), friction=friction, pressure=(xx, xy, yy))

    def in_units(self, hypothesis: DoubleArray) -> DoubleArray:
        """Return a hypothesis (6,) as ``PARAMETERS``."""
        found = hypothesis.copy()
        found[_CENTRE] = self._origin + hypothesis[_CENTRE] * self._outline.size_m
        found[_FRICTION] = np.exp(hypothesis[_FRICTION])
        return found

    def units(self, hypothesis: DoubleArray) -> DoubleArray:
        """Return the changes (6,) of ``PARAMETERS`` with those of a hypothesis (6,)."""
        size = self._outline.size_m
        return np.array([size, size, np.exp(hypothesis[_FRICTION]), 1.0, 1.0, 1.0])

    def _balanced(self, centres: DoubleArray, pressures: DoubleArray) -> tuple[DoubleArray, npt.NDArray[np.bool_]]:
        """Return shares (n, k) as ``support.balanced`` finds them, and (n,) true where they balance."""
        powers = pressures @ self._terms.T
        arm = (self._points - centres[:, None]) / self._outline.size_m
        x, y = arm[..., 0], arm[..., 1]
        tilt = np.zeros((len(arm), 2))
        for _ in range(_TRIES):
            shares = np.exp(_below_zero(powers + x * tilt[:, :1] + y * tilt[:, 1:]))
            shares /= shares.sum(axis=1, keepdims=True)
            off_x, off_y = (shares * x).sum(axis=1), (shares * y).sum(axis=1)
            if (np.abs(off_x) + np.abs(off_y) < _BALANCED).all():
                break
            xx = (shares * x * x).sum(axis=1) - off_x * off_x + _RIDGE
            yy = (shares * y * y).sum(axis=1) - off_y * off_y + _RIDGE
            xy = (shares * x * y).sum(axis=1) - off_x * off_y
            step = np.stack([yy * off_x - xy * off_y, xx * off_y - xy * off_x], axis=1) / (xx * yy - xy * xy)[:, None]
            tilt -= step * np.minimum(1.0, 2.0 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
            tilt = np.clip(tilt, -_TILT, _TILT)
        return shares, np.abs(off_x) + np.abs(off_y) < _OFF


def _repeated(part: FloatArray, count: int) -> FloatArray:
    return np.broadcast_to(part, (count, *part.shape))


def _below_zero(powers: DoubleArray) -> DoubleArray:
    below: DoubleArray = powers - powers.max(axis=1, keepdims=True)
    return below
