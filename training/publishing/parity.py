"""Parity of torch and onnxruntime, checked before a version is published."""

import math
from typing import Final

import numpy as np
import torch

from service.errors import PublishError
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from training.networks.push_network import PushNetwork
from training.publishing.onnx_export import ServedNetwork
from training.publishing.parity_inputs import Batch, extreme_batch, graph_inputs, plausible_batch

# Torch and onnxruntime add in another order, so float32 leaves a few units in the sixth digit. One tolerance holds for
# both outputs: absolute in SI units, plus a relative part for inputs far outside of the training data.
PARITY_TOLERANCE: Final = 1e-5
PARITY_RELATIVE: Final = 1e-4


def check_parity(network: PushNetwork, model: bytes, kind: ContextKind) -> float:
    """Check that torch and onnxruntime agree on plausible and extreme pushes.

    Return the largest difference on plausible pushes, in SI units.

    Raises:
        PublishError: a difference is over the tolerance.
    """
    predictor, served = OnnxPredictor(model, expected_inputs(kind), OUTPUTS), ServedNetwork(network).eval()

    def largest_difference(batch: Batch) -> float:
        """Return the largest difference for this batch."""
        found = np.stack(predictor.predict(batch.pusher, batch.contexts, batch.context_index)[:2])
        arguments = [torch.from_numpy(array) for array in graph_inputs(batch, kind)]
        with torch.inference_mode():
            expected, size = (
                np.stack([tensor.numpy() for tensor in gaussian])
                for gaussian in (served(*arguments), served.before_wrapping(*arguments))
            )
        difference = np.abs(found - expected)
        difference[0, :, 2] = np.minimum(difference[0, :, 2], 2.0 * math.pi - difference[0, :, 2])  # pi is -pi
        if (difference > PARITY_TOLERANCE + PARITY_RELATIVE * np.abs(size)).any():
            raise PublishError(f"onnxruntime differs from torch by {difference.max():.2e}; no version was published")
        return float(difference.max())

    largest_difference(extreme_batch(kind))
    plausible = plausible_batch(kind, 1000, 37, seed=2), plausible_batch(kind, 1, 1, seed=3)
    return max(largest_difference(batch) for batch in plausible)
