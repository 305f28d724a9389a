"""Bodies of supports: lists and arrays of pushes with their outcomes."""

import numpy as np
import pytest
from pydantic import ValidationError

from service.errors import InvalidRequestError
from service.pushing.contexts import MAX_SUPPORT, SupportContext
from service.schemas.contexts import ContextBody
from service.schemas.supports import SUPPORT_EXAMPLE, SupportBody


def test_lists_and_arrays_are_the_same_support() -> None:
    """A client's arrays become lists, and both are the same context, whose document is plain JSON."""
    arrays = {name: np.array(rows) for name, rows in SUPPORT_EXAMPLE.items()}
    bodies = [SupportBody.model_validate(given) for given in (SUPPORT_EXAMPLE, arrays)]
    assert bodies[0].model_dump() == bodies[1].model_dump() == SUPPORT_EXAMPLE
    found = ContextBody(support=bodies[1]).to_domain()
    assert isinstance(found, SupportContext)
    for one, other in zip(found.tensors(), bodies[0].to_domain("support").tensors(), strict=True):
        assert (one == other).all()


def test_the_longest_support_is_accepted_and_one_push_more_is_not() -> None:
    """Fifty pushes are a support, and fifty-one are refused without being looked at."""
    rows = [[0.1, 0.0, 1.0]] * (MAX_SUPPORT + 1)
    assert len(SupportBody(pushers=rows[1:], outcomes=rows[1:]).to_domain("x").pushers) == MAX_SUPPORT
    with pytest.raises(ValidationError, match="at most 50 items"):
        SupportBody(pushers=[["no number"]] * (MAX_SUPPORT + 1), outcomes=rows)  # type: ignore[list-item]


@pytest.mark.parametrize("beside", [{"descriptor": "1a2b3c4a"}, {"outline": [[0, 0], [1, 0], [0, 1]]}])
def test_a_support_is_the_only_form_of_its_context(beside: dict[str, object]) -> None:
    """A support beside another form, or beside what is known of a shape, is refused."""
    with pytest.raises(InvalidRequestError, match="support"):
        ContextBody.model_validate({"support": SUPPORT_EXAMPLE, **beside}).to_domain()
    with pytest.raises(InvalidRequestError, match="friction"):
        ContextBody.model_validate({"support": SUPPORT_EXAMPLE, "friction": 0.3}).to_domain()
