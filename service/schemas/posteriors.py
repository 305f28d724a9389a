"""Posterior of a refined context: how sure the values are that pushes told of an object's body."""

import math
from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.pushing.poses import DoubleArray
from service.schemas.body import Body, at_most

UNCERTAIN: Final = ("centre_of_mass", "friction", "pressure")
"""Fields of a context whose values are the mean of its posterior."""
NUMBERS: Final = 6
_MOST_STD: Final = 10.0
_LEAST_STD: Final = 1e-9
_ROUNDED: Final = 1e-4  # of correlations: digits that a caller may have dropped
_ORDER: Final = "centre_of_mass x and y, friction, pressure xx, xy and yy"
STD_EXAMPLE: Final = [0.002, 0.002, 0.05, 0.5, 0.3, 0.5]
CORRELATION_EXAMPLE: Final = np.eye(NUMBERS).tolist()
_Std = Annotated[float, Field(json_schema_extra={"minimum": _LEAST_STD, "maximum": _MOST_STD})]
_Row = Annotated[
    list[Annotated[float, Field(json_schema_extra={"minimum": -1, "maximum": 1})]],
    Field(min_length=NUMBERS, max_length=NUMBERS, fail_fast=True),
    at_most(NUMBERS),
]


class PosteriorBody(Body):
    """Gaussian about the centre of mass, the friction and the pressure that a refined context states."""

    std: Annotated[
        list[_Std],
        Field(
            min_length=NUMBERS,
            max_length=NUMBERS,
            fail_fast=True,
            description=f"standard deviations, in m and without unit, of {_ORDER}",
            examples=[STD_EXAMPLE],
        ),
        at_most(NUMBERS),
    ]
    correlation: Annotated[
        list[_Row],
        Field(
            min_length=NUMBERS,
            max_length=NUMBERS,
            fail_fast=True,
            description="6 x 6, of the same six numbers",
            examples=[CORRELATION_EXAMPLE],
        ),
        at_most(NUMBERS),
    ]

    @model_validator(mode="after")
    def _check(self) -> Self:
        std, found = np.array(self.std), np.array(self.correlation)
        if not ((std >= _LEAST_STD) & (std <= _MOST_STD)).all():
            raise PydanticCustomError("std", f"standard deviations of {_LEAST_STD:g} to {_MOST_STD:g}")
        is_one = np.abs(np.diagonal(found) - 1.0).max() <= _ROUNDED and np.abs(found - found.T).max() <= _ROUNDED
        if not (is_one and np.abs(found).max() <= 1.0 and np.linalg.eigvalsh(found).min() >= -_ROUNDED):
            raise PydanticCustomError("correlation", "correlations as POST /v1/contexts/refine answers them")
        return self

    def centre_std(self) -> float:
        """Return the standard deviation of the centre of mass in m, of both coordinates together."""
        return math.hypot(*self.std[:2])

    def moments(self) -> tuple[DoubleArray, DoubleArray]:
        """Return standard deviations (6,) and the correlation (6, 6), positive definite in spite of dropped digits."""
        found = np.array(self.correlation)
        found = (found + found.T) / 2.0
        np.fill_diagonal(found, 1.0 + 2.0 * _ROUNDED)
        return np.array(self.std), found
