"""Methods: the rows of the paper's tables, under the paper's names."""

import pytest

from service.model.tensors import ContextKind
from training.networks.methods import METHODS, ContextDistance, ContextUse

NONE, INDICATOR, VISUAL = ContextKind.NONE, ContextKind.INDICATOR, ContextKind.VISUAL


@pytest.mark.parametrize(
    ("name", "use", "distance", "kinds"),
    [
        ("ANP", ContextUse.NONE, ContextDistance.NONE, [NONE]),
        ("FCN", ContextUse.NONE, ContextDistance.NONE, [NONE]),
        ("FCN + CC", ContextUse.CONCATENATED, ContextDistance.NONE, [INDICATOR, VISUAL]),
        ("FCN + CM", ContextUse.MASKED, ContextDistance.NONE, [INDICATOR, VISUAL]),
        ("FCN + CM + L2Reg", ContextUse.MASKED, ContextDistance.EUCLIDEAN, [INDICATOR, VISUAL]),
        ("FCN + CM + NeuralReg", ContextUse.MASKED, ContextDistance.KERNEL, [INDICATOR, VISUAL]),
    ],
)
def test_methods_declare_their_use_of_the_context(
    name: str, use: ContextUse, distance: ContextDistance, kinds: list[ContextKind]
) -> None:
    """Each method has the paper's use of the context, its regulariser and the kinds of context it is tried with."""
    method = METHODS[name]

    assert (method.name, method.context_use, method.distance) == (name, use, distance)
    assert [kind for kind in ContextKind if method.takes(kind)] == kinds


def test_there_are_the_paper_s_six_and_one_is_a_neural_process() -> None:
    """The paper has six methods in the order of its tables, and only ANP is a neural process."""
    assert list(METHODS) == ["ANP", "FCN", "FCN + CC", "FCN + CM", "FCN + CM + L2Reg", "FCN + CM + NeuralReg"]
    assert [name for name, method in METHODS.items() if method.neural_process] == ["ANP"]
