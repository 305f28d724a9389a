"""Parity of torch and onnxruntime, checked before a version is published."""

import math
from typing import Final

import numpy as np
import torch
from torch import nn

from service.errors import PublishError
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind, FloatArray, Tensor
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PushNetwork
from training.publishing.onnx_export import ServedNetwork, ServedProcess, graph_outputs
from training.publishing.parity_inputs import Batch, extreme_batch, graph_inputs, plausible_batch

# Torch and onnxruntime add in another order, so float32 leaves a few units in the sixth digit. One tolerance holds for
# both outputs: absolute in SI units, plus a relative part for inputs far outside of the training data.
PARITY_TOLERANCE: Final = 1e-5
PARITY_RELATIVE: Final = 1e-4
DISTANCE_TOLERANCE: Final = 1e-3  # of the unfamiliarity, absolute and relative
# Mechanics may take another of two contacts that are equally near, after another rounding. So a share of pushes may
# differ by more, but not many, and sums over steps leave a digit more.
SHAPE_TOLERANCE: Final = 1e-4
MOST_JUMPS: Final = 0.02


def check_shape_parity(served: nn.Module, model: bytes) -> float:
    """Check that torch and onnxruntime agree on all outputs for plausible and extreme pushes of shapes.

    Return the largest difference on plausible pushes, in SI units, without the share that may differ by more.

    Args:
        served: module that takes the inputs of a graph and returns its outputs.
        model: the graph.

    Raises:
        PublishError: more pushes differ than may.
    """
    kind = ContextKind.SHAPE
    predictor = OnnxPredictor(model, expected_inputs(kind), OUTPUTS_WITH_UNFAMILIARITY)

    def differences(batch: Batch) -> FloatArray:
        """Return the largest difference of each push (n,), in tolerances."""
        found = predictor.predict(batch.pusher, batch.contexts, batch.context_index)
        with torch.inference_mode():
            expected = served.eval()(*(torch.from_numpy(array) for array in graph_inputs(batch, kind)))
        parts = []
        for ours, theirs in zip(found, expected, strict=True):
            limit = SHAPE_TOLERANCE + PARITY_RELATIVE * np.abs(theirs.numpy())
            parts.append((np.abs(ours - theirs.numpy()) / limit).max(axis=1))
        worst: FloatArray = np.maximum.reduce(parts)
        jumps = float((worst > 1.0).mean())
        if jumps > MOST_JUMPS:
            raise PublishError(f"onnxruntime differs from torch in {jumps:.1%} of pushes; no version was published")
        return worst

    differences(extreme_batch(kind))
    return SHAPE_TOLERANCE * float(np.quantile(differences(plausible_batch(kind, 1000, 37, seed=2)), 1.0 - MOST_JUMPS))


def check_parity(
    network: PushNetwork, model: bytes, kind: ContextKind, domain: OmnipushDomain | None = None, scale: float = 1.0
) -> float:
    """Check that torch and onnxruntime agree on plausible and extreme pushes.

    Return the largest difference on plausible pushes, in SI units.

    Raises:
        PublishError: a difference is over the tolerance.
    """
    return check_served_parity(ServedNetwork(network, domain, scale), model, kind, graph_outputs(domain))


def check_served_parity(
    served: ServedNetwork | ServedProcess, model: bytes, kind: ContextKind, outputs: tuple[Tensor, ...]
) -> float:
    """Check like ``check_parity`` a module that takes the inputs of a graph and returns its outputs.

    Raises:
        PublishError: a difference is over the tolerance.
    """
    predictor = OnnxPredictor(model, expected_inputs(kind), outputs)
    served.eval()

    def largest_difference(batch: Batch) -> float:
        """Return the largest difference for this batch."""
        *gaussians, unfamiliarity = predictor.predict(batch.pusher, batch.contexts, batch.context_index)
        found = np.stack(gaussians)
        arguments = [torch.from_numpy(array) for array in graph_inputs(batch, kind)]
        with torch.inference_mode():
            answer, before = served(*arguments), served.before_wrapping(*arguments)
        expected, size = (np.stack([tensor.numpy() for tensor in gaussian[:2]]) for gaussian in (answer, before))
        if unfamiliarity is not None:
            _check_unfamiliarity(unfamiliarity, answer[2].numpy())
        difference = np.abs(found - expected)
        difference[0, :, 2] = np.minimum(difference[0, :, 2], 2.0 * math.pi - difference[0, :, 2])  # pi is -pi
        if (difference > PARITY_TOLERANCE + PARITY_RELATIVE * np.abs(size)).any():
            raise PublishError(f"onnxruntime differs from torch by {difference.max():.2e}; no version was published")
        return float(difference.max())

    largest_difference(extreme_batch(kind))
    plausible = plausible_batch(kind, 1000, 37, seed=2), plausible_batch(kind, 1, 1, seed=3)
    return max(largest_difference(batch) for batch in plausible)


def _check_unfamiliarity(found: FloatArray, expected: FloatArray) -> None:
    """Refuse a graph whose distances are others than those of torch, beyond rounding.

    Raises:
        PublishError: a distance differs by more.
    """
    if not np.allclose(found, expected, rtol=DISTANCE_TOLERANCE, atol=DISTANCE_TOLERANCE):
        largest = float(np.abs(found - expected).max())
        raise PublishError(f"onnxruntime's unfamiliarity differs from torch's by {largest:.2e}; no version published")
