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
from training.publishing.parity_inputs import Batch, extreme_batch, feed, probe_batch

# Torch and onnxruntime sum in another order: float32 leaves a few units in the sixth digit. One tolerance for both
# outputs, absolute in SI units and relative beside it for inputs far outside of anything trained on.
PARITY_TOLERANCE: Final = 1e-5
PARITY_RELATIVE: Final = 1e-4


def check_parity(network: PushNetwork, model: bytes, kind: ContextKind) -> float:
    """The largest difference between torch and onnxruntime on plausible pushes, in SI units; extreme ones agree too.

    Raises:
        PublishError: it is over the tolerance.
    """
    predictor, served = OnnxPredictor(model, expected_inputs(kind), OUTPUTS), ServedNetwork(network).eval()

    def compare(batch: Batch) -> float:
        """The largest difference for this batch."""
        found = np.stack(predictor.predict(batch.pusher, batch.context, batch.context_index))
        arguments = [torch.from_numpy(array) for array in feed(batch, kind)]
        with torch.inference_mode():
            expected, size = (
                np.stack([tensor.numpy() for tensor in gaussian])
                for gaussian in (served(*arguments), served.unwrapped(*arguments))
            )
        difference = np.abs(found - expected)
        difference[0, :, 2] = np.minimum(difference[0, :, 2], 2.0 * math.pi - difference[0, :, 2])  # pi is -pi
        if (difference > PARITY_TOLERANCE + PARITY_RELATIVE * np.abs(size)).any():
            raise PublishError(f"onnxruntime differs from torch by {difference.max():.2e}; nothing was published")
        return float(difference.max())

    compare(extreme_batch(kind))
    return max(compare(probe_batch(kind, 1000, 37, seed=2)), compare(probe_batch(kind, 1, 1, seed=3)))
