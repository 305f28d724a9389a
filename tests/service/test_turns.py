"""Work pauses where it can: before each picture, and between the pieces of a prediction and of contexts."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from contextvars import copy_context

import numpy as np
import pytest

from service.api.v1.object_contexts import encode_contexts
from service.errors import DeadlineError
from service.inference.pieces import predict_in_pieces
from service.model.loaded_model import LoadedModel
from service.model.push_cost import MAX_CONTEXTS, MAX_PUSHES
from service.model.tensors import ContextKind
from service.schemas.contexts import IMAGE_EXAMPLE, ContextBody
from service.turns import TURN, ending, pause
from tests.fakes import FakePredictor, draft_manifest


class NotingTurn:
    """A turn that notes the memory that each pause asks for, and ends the work at one of them."""

    def __init__(self, last: int = 1 << 30) -> None:
        self.last = last
        self.needed: list[int] = []

    def pause(self, needed_bytes: int) -> None:
        """See ``service.turns.pause``."""
        self.needed.append(needed_bytes)
        if len(self.needed) == self.last:
            raise DeadlineError(1.0)

    def ending(self, end: Callable[[], None]) -> AbstractContextManager[None]:
        """See ``service.turns.ending``."""
        end()
        return nullcontext()


def within(turn: NotingTurn, work: Callable[[], object]) -> None:
    """Work in a turn."""
    context = copy_context()
    context.run(TURN.set, turn)
    context.run(work)


def pictures() -> object:
    """Encode a batch of five pictures of 32 x 32 pixels."""
    return encode_contexts([ContextBody(image=IMAGE_EXAMPLE)] * 5, np.zeros(1, dtype=np.int64))


def views() -> object:
    """Encode a batch of many contexts."""
    return encode_contexts(
        [ContextBody(indicator=[1.0, 0, 0, 0, 1, 0, 0, 0, 0] * 4)] * 700, np.zeros(1, dtype=np.int64)
    )


def pushes() -> object:
    """Predict three pieces of pushes without context."""
    model = LoadedModel(draft_manifest("push-none", ContextKind.NONE), "", FakePredictor(b"", takes_context=False))
    return predict_in_pieces(model, np.zeros((3 * MAX_PUSHES, 3), dtype=np.float32), (), None)


def objects() -> object:
    """Predict four pieces of contexts, with a push each."""
    model = LoadedModel(draft_manifest(), "", FakePredictor(b"", takes_context=True))
    count = 4 * MAX_CONTEXTS
    contexts = np.zeros((count, 36), dtype=np.float32)
    return predict_in_pieces(model, np.zeros((count, 3), dtype=np.float32), (contexts,), np.arange(count))


PAUSES = {pictures: 5, views: 3, pushes: 3, objects: 4}


@pytest.mark.parametrize(("work", "parts"), PAUSES.items(), ids=[work.__name__ for work in PAUSES])
def test_work_pauses_between_its_parts(work: Callable[[], object], parts: int) -> None:
    """There is a pause for each part, so that others wait for one part at most, and each may be the end."""
    turn = NotingTurn()
    within(turn, work)
    assert parts <= len(turn.needed) <= parts + 1
    ended = NotingTurn(last=2)
    with pytest.raises(DeadlineError):
        within(ended, work)
    assert len(ended.needed) == 2


def test_a_picture_asks_for_the_memory_of_its_pixels() -> None:
    """The cost of a picture is counted in pixels, before it is decoded."""
    turn = NotingTurn()
    within(turn, pictures)
    needed = [needed for needed in turn.needed if needed]
    assert len(needed) == 5
    assert min(needed) >= 32 * 32


def test_without_a_turn_work_goes_on() -> None:
    """Outside of a pool a pause does nothing, and nothing ends the work."""
    pause(1 << 60)
    with ending(lambda: pytest.fail("ended")):
        pictures()


def test_within_a_turn_the_end_of_a_block_is_registered() -> None:
    """The function that ends a block is passed to the turn."""
    called: list[str] = []

    def work() -> None:
        with ending(lambda: called.append("ended")):
            called.append("worked")

    within(NotingTurn(), work)
    assert called == ["ended", "worked"]
