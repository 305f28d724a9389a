"""Judging of refinements: pushes that tell little of an object, or that no body of it explains."""

from collections.abc import Sequence
from typing import Final

from service.pushing.poses import DoubleArray
from service.validity.codes import AnswerWarning, WarningCode

TOLD: Final = 0.8  # std of a value over that before the pushes: above it, they told little of it
MANY_OUTLIERS: Final = 0.3  # of the pushes


def refinement_warnings(left: DoubleArray, outliers: Sequence[int], pushes: int) -> tuple[AnswerWarning, ...]:
    """Return the warnings of a refinement.

    Args:
        left: (6,) std of each value over that before the pushes.
        outliers: rows of the pushes that no body explains.
        pushes: number of pushes.
    """
    warnings = []
    if left.min() > TOLD:
        detail = f"every value is at least {left.min():.0%} as uncertain as before: send more pushes from other sides."
        warnings.append(AnswerWarning(WarningCode.LITTLE_LEARNT, detail, tuple(range(pushes))))
    if len(outliers) > MANY_OUTLIERS * pushes:
        detail = f"no body explains {len(outliers)} of {pushes} outcomes: compare frames, lengths and outline."
        warnings.append(AnswerWarning(WarningCode.MANY_OUTLIERS, detail, tuple(outliers)))
    return tuple(warnings)
