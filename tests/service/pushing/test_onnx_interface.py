"""Tensors of a push model, by the kind of its context."""

import pytest

from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS, expected_inputs

POSE_UNITS = ("m", "m", "rad")


@pytest.mark.parametrize(
    ("kind", "shapes"),
    [
        (ContextKind.NONE, {"pusher": ("n", 3)}),
        (ContextKind.INDICATOR, {"pusher": ("n", 3), "context": ("g", 36), "context_index": ("n",)}),
        (ContextKind.VISUAL, {"pusher": ("n", 3), "context": ("g", 1, 32, 32), "context_index": ("n",)}),
    ],
)
def test_the_inputs_follow_from_the_kind_of_context(
    kind: ContextKind, shapes: dict[str, tuple[int | str, ...]]
) -> None:
    """A model takes pushes, and one with context also the distinct contexts and the index of each push's context."""
    inputs = expected_inputs(kind)
    assert [(tensor.name, tensor.shape) for tensor in inputs] == list(shapes.items())
    assert [tensor.dtype for tensor in inputs] == ["float32", "float32", "int64"][: len(inputs)]
    assert [tensor.units for tensor in inputs] == [POSE_UNITS, ("1",), ("1",)][: len(inputs)]


def test_a_support_has_pushers_and_outcomes_and_says_which_are_pushes() -> None:
    """A meta-learner takes for each object 50 pushers and outcomes in SI units, and ones where there is a push."""
    _, pushers, outcomes, valid, _ = expected_inputs(ContextKind.SUPPORT)
    assert [(tensor.name, tensor.shape) for tensor in (pushers, outcomes, valid)] == [
        ("support_pushers", ("g", 50, 3)),
        ("support_outcomes", ("g", 50, 3)),
        ("support_valid", ("g", 50)),
    ]
    assert pushers.units == outcomes.units == POSE_UNITS


def test_the_outputs_are_mean_and_std_of_a_pose() -> None:
    """Every push model gives a mean and a std per push, in m, m, rad."""
    assert [(tensor.name, tensor.dtype, tensor.shape, tensor.units) for tensor in OUTPUTS] == [
        ("mean", "float32", ("n", 3), POSE_UNITS),
        ("std", "float32", ("n", 3), POSE_UNITS),
    ]
