"""Object contexts: an object as its four sides, as a small view or as some of its pushes, and the index of contexts.

Sides count counter-clockwise from the x axis of the object frame (see ``service.pushing.poses``).
Standard library and numpy only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from service.errors import FieldFault, InvalidRequestError
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.poses import DoubleArray, reachable

SIDES: Final = 4
SHAPE_DIGITS: Final = "1234"  # concave, triangular, circular, rectangular
WEIGHT_LETTERS: Final = "abcBC"  # none, 60 g, 150 g, and 60 g, 150 g in a triangle's second position
SECOND_POSITION_LETTERS: Final = "BC"
TRIANGULAR: Final = "2"
BITS_PER_SIDE: Final = len(SHAPE_DIGITS) + len(WEIGHT_LETTERS)
INDICATOR_LENGTH: Final = SIDES * BITS_PER_SIDE
VISUAL_SIZE: Final = 32
MAX_SUPPORT: Final = 50  # pushes, as many as the paper's meta-learner is given


@dataclass(frozen=True, slots=True)
class Side:
    """One side of an object: a shape digit and a weight letter."""

    shape: str
    weight: str

    def bits(self) -> tuple[int, ...]:
        """Return the shape one-hot, then the weight one-hot: 4 + 5 values."""
        return tuple(int(self.shape == digit) for digit in SHAPE_DIGITS) + tuple(
            int(self.weight == letter) for letter in WEIGHT_LETTERS
        )


@dataclass(frozen=True, slots=True)
class ObjectContext:
    """An Omnipush object as its four sides, counter-clockwise from the x axis of the object frame.

    It has two forms: the **descriptor** (``1a2b3c4a``) and the **indicator** (36 zeros and ones). Round trips hold:
    ``from_descriptor(c.descriptor()) == c`` and ``from_indicator(c.indicator()) == c``.
    """

    sides: tuple[Side, Side, Side, Side]

    @classmethod
    def from_descriptor(cls, descriptor: str, where: str = "descriptor") -> Self:
        """Parse a descriptor: for each side a shape digit and a weight letter.

        Raises:
            InvalidRequestError: the text is not a descriptor. The message names each faulty side.
        """
        if len(descriptor) != 2 * SIDES:
            accepted = "8 characters: four times a shape digit 1-4 and a weight letter a, b, c, B or C"
            raise InvalidRequestError.at(where, f"{len(descriptor)} characters", accepted)
        return cls._from_sides([Side(*descriptor[2 * i : 2 * i + 2]) for i in range(SIDES)], where)

    @classmethod
    def from_indicator(cls, indicator: Sequence[float], where: str = "indicator") -> Self:
        """Parse an indicator, 36 zeros and ones: for each side the shape one-hot (4), then the weight one-hot (5).

        Raises:
            InvalidRequestError: a side has not exactly one shape and one weight. The message names each such side.
        """
        if len(indicator) != INDICATOR_LENGTH:
            accepted = f"{INDICATOR_LENGTH} values: for each of {SIDES} sides, 4 for the shape and 5 for the weight"
            raise InvalidRequestError.at(where, f"{len(indicator)} values", accepted)
        faults: list[FieldFault] = []
        sides: list[Side] = []
        for number in range(1, SIDES + 1):
            bits = tuple(indicator[(number - 1) * BITS_PER_SIDE : number * BITS_PER_SIDE])
            shapes = _names_of_ones(bits[: len(SHAPE_DIGITS)], SHAPE_DIGITS)
            weights = _names_of_ones(bits[len(SHAPE_DIGITS) :], WEIGHT_LETTERS)
            if any(bit not in (0, 1) for bit in bits):
                faults.append(FieldFault(f"{where} side {number}", "a value other than 0 and 1", "0 or 1"))
            elif len(shapes) != 1:
                received = f"{len(shapes)} shapes" + (f" ({', '.join(shapes)})" if shapes else "")
                faults.append(FieldFault(f"{where} side {number}", received, "exactly one shape of 1, 2, 3, 4"))
            elif len(weights) != 1:
                received = f"{len(weights)} weights" + (f" ({', '.join(weights)})" if weights else "")
                faults.append(FieldFault(f"{where} side {number}", received, "exactly one weight of a, b, c, B, C"))
            else:
                sides.append(Side(shapes, weights))
        if faults:
            raise InvalidRequestError(faults)
        return cls._from_sides(sides, where)

    @classmethod
    def _from_sides(cls, sides: list[Side], where: str) -> Self:
        faults = [
            FieldFault(f"{where} side {number}", *fault)
            for number, side in enumerate(sides, start=1)
            if (fault := _side_fault(side)) is not None
        ]
        if faults:
            raise InvalidRequestError(faults)
        first, second, third, fourth = sides
        return cls((first, second, third, fourth))

    def descriptor(self) -> str:
        """Return the descriptor, 8 characters."""
        return "".join(side.shape + side.weight for side in self.sides)

    def indicator(self) -> FloatArray:
        """Return the indicator, float32 [36]."""
        return np.array([bit for side in self.sides for bit in side.bits()], dtype=np.float32)

    @property
    def kind(self) -> ContextKind:
        """Return the kind of this context."""
        return ContextKind.INDICATOR

    def tensor(self) -> FloatArray:
        """Return the tensor that the networks take: the indicator, float32 [36]."""
        return self.indicator()

    def turned(self, quarter_turns: int) -> Self:
        """Return the object turned by that many quarter turns (+90 degrees) in a fixed frame: side 1 becomes side 2.

        Turning the object and the push turns the outcome by the same angle. Models are tested for this symmetry.
        """
        shift = quarter_turns % SIDES
        first, second, third, fourth = self.sides[-shift:] + self.sides[:-shift]
        return type(self)((first, second, third, fourth))


@dataclass(frozen=True, slots=True)
class VisualContext:
    """An object as a small top-down view: 32 x 32 grey levels, one byte each, row by row, 0..255 for 0..1.

    Levels have eight bits on purpose: trainer and service see the same numbers to the bit.
    """

    levels: bytes

    @classmethod
    def from_bytes(cls, levels: bytes, where: str = "visual") -> Self:
        """Create a visual context from 1,024 grey levels.

        Raises:
            InvalidRequestError: there are fewer or more levels.
        """
        if len(levels) != VISUAL_SIZE**2:
            accepted = f"{VISUAL_SIZE**2} bytes: {VISUAL_SIZE} rows of {VISUAL_SIZE} grey levels"
            raise InvalidRequestError.at(where, f"{len(levels)} bytes", accepted)
        return cls(bytes(levels))

    @property
    def kind(self) -> ContextKind:
        """Return the kind of this context."""
        return ContextKind.VISUAL

    def tensor(self) -> FloatArray:
        """Return the tensor that the networks take, float32 [1, 32, 32] in [0, 1]."""
        grey = np.frombuffer(self.levels, dtype=np.uint8).astype(np.float32) / np.float32(255.0)
        return grey.reshape(1, VISUAL_SIZE, VISUAL_SIZE)


@dataclass(frozen=True, slots=True, eq=False)
class SupportContext:
    """An object as some of its pushes with their outcomes: the support of a meta-learner.

    Attributes:
        pushers: (k, 3) poses of the tip before each push, m, m, rad, in the object frame before that push.
        outcomes: (k, 3) pose of the object after each push, in the same frame.
    """

    pushers: DoubleArray
    outcomes: DoubleArray

    @classmethod
    def of(cls, pushers: DoubleArray, outcomes: DoubleArray, where: str = "support") -> Self:
        """Create a support of 1 to 50 pushes (k, 3) and as many outcomes (k, 3). Angles are wrapped.

        Raises:
            InvalidRequestError: there are none, too many or unequally many, or a coordinate is over ``REACH_M``. The
                message names the row.
        """
        if not 1 <= len(pushers) <= MAX_SUPPORT:
            raise InvalidRequestError.at(f"{where}.pushers", f"{len(pushers)} pushes", f"1 to {MAX_SUPPORT} pushes")
        if len(outcomes) != len(pushers):
            accepted = f"as many as pushers, {len(pushers)}: one per push"
            raise InvalidRequestError.at(f"{where}.outcomes", f"{len(outcomes)} outcomes", accepted)
        return cls(reachable(pushers, f"{where}.pushers"), reachable(outcomes, f"{where}.outcomes"))

    @property
    def kind(self) -> ContextKind:
        """Return the kind of this context."""
        return ContextKind.SUPPORT

    def tensors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the tensors that the networks take: pushers and outcomes [50, 3], and [50] ones for pushes, float32.

        Rows after the last push are zeros.
        """
        count = len(self.pushers)
        poses, valid = np.zeros((2, MAX_SUPPORT, 3), dtype=np.float32), np.zeros(MAX_SUPPORT, dtype=np.float32)
        poses[0, :count], poses[1, :count], valid[:count] = self.pushers, self.outcomes, 1.0
        return poses[0], poses[1], valid


def index_contexts(
    contexts: int, pushes: int, given: Sequence[int] | IndexArray | None, fields: tuple[str, str]
) -> IndexArray:
    """Return the index of each push's context: as given, or 0 for one context, or one context per push.

    Args:
        contexts: number of contexts.
        pushes: number of pushes.
        given: (n,) the index of each push's context, from 0, or None if it was left out.
        fields: the fields of the request that hold the contexts and the index, for errors.

    Raises:
        InvalidRequestError: contexts and index do not fit the pushes.
    """
    where_contexts, where_index = fields
    if given is None:
        if contexts not in (1, pushes):
            accepted = f"1 context, {pushes} contexts (one per push), or any number with context_index"
            raise InvalidRequestError.at(where_contexts, f"{contexts} contexts", accepted)
        return np.zeros(pushes, dtype=np.int64) if contexts == 1 else np.arange(pushes, dtype=np.int64)
    if len(given) != pushes:
        raise InvalidRequestError.at(where_index, f"{len(given)} values", f"{pushes} values: one per push")
    index = np.asarray(given)  # an array of Python integers if one is beyond int64
    outside = np.flatnonzero((index < 0) | (index >= contexts))
    if len(outside):
        received = "an index beyond the contexts"
        raise InvalidRequestError.at(f"{where_index}.{outside[0]}", received, f"0 to {contexts - 1}")
    return index.astype(np.int64)


def _names_of_ones(bits: Sequence[float], names: str) -> str:
    return "".join(name for bit, name in zip(bits, names, strict=True) if bit)


def _side_fault(side: Side) -> tuple[str, str] | None:
    """Return the received and the accepted value of an invalid side, or None."""
    if side.shape not in SHAPE_DIGITS:
        return "an unknown shape", "1 concave, 2 triangular, 3 circular or 4 rectangular"
    if side.weight not in WEIGHT_LETTERS:
        return "an unknown weight", "a none, b 60 g, c 150 g, or B, C for the second position of a triangle"
    if side.weight in SECOND_POSITION_LETTERS and side.shape != TRIANGULAR:
        return f"weight {side.weight} on shape {side.shape}", "B and C only on shape 2 (triangular)"
    return None
