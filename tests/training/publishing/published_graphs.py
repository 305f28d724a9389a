"""Graphs of fitted networks for tests: the kinds of context, and predictions with onnxruntime."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind, FloatArray
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from training.fitting.run_folder import load_run
from training.networks.push_network import PushNetwork

KINDS: Final = [ContextKind.INDICATOR, ContextKind.NONE, ContextKind.VISUAL]
SAME: Final = 1e-6  # metres and radians: the difference that another order of float32 sums may make


def load_push_network(run: Path) -> PushNetwork:
    """Load the network of a run, which must be of a served method."""
    network = load_run(run)[1]
    assert isinstance(network, PushNetwork)
    return network


def predict_graph(
    graph: bytes, kind: ContextKind, pusher: FloatArray, contexts: tuple[FloatArray, ...], index: Sequence[int]
) -> FloatArray:
    """Predict with onnxruntime: mean and std, (2, n, 3)."""
    outputs = OUTPUTS_WITH_UNFAMILIARITY if b"unfamiliarity" in graph else OUTPUTS
    predictor = OnnxPredictor(graph, expected_inputs(kind), outputs)
    return np.stack(predictor.predict(pusher, contexts, np.array(index, dtype=np.int64))[:2])
