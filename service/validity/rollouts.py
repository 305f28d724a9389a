"""Judging of rollouts: pushes that some of the particles never meet, or meet where a model does not vouch for it."""

from typing import Final

import numpy as np

from service.pushing.poses import DoubleArray
from service.validity.codes import AnswerWarning, WarningCode

LIKELY: Final = 0.05  # share of the particles above which a push has a warning
_SENTENCES: Final = {
    WarningCode.NO_CONTACT: "the tip never touches the object",
    WarningCode.STARTS_INSIDE: "the tip starts inside of the object",
    WarningCode.UNFAMILIAR_PUSH: "the push is outside of those that the model vouches for",
}


def rollout_warnings(shares: DoubleArray, by_sequence: bool) -> tuple[AnswerWarning, ...]:
    """Return the warnings of rollouts.

    Args:
        shares: (3, s, k) share of the particles that each push of each sequence misses, starts inside of, and meets
            where the model does not vouch for it. NaN behind the end of a sequence.
        by_sequence: whether the rows of a warning are sequences, or the pushes of the only one.
    """
    warnings = []
    for (code, sentence), share in zip(_SENTENCES.items(), shares, strict=True):
        over = share > LIKELY  # not where it is NaN
        if over.any():
            sequence, push = (int(place) for place in np.argwhere(over)[0])
            where = f"sequence {sequence}, push {push}" if by_sequence else f"push {push}"
            rows = np.flatnonzero(over.any(axis=1) if by_sequence else over[0])
            particles = f"for {share[sequence, push]:.0%} of the particles"
            warnings.append(AnswerWarning(code, f"{where}: {sentence} {particles}.", tuple(rows.tolist())))
    return tuple(warnings)
