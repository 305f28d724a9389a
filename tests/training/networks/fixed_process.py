"""A neural process with fixed weights, for the tests of the network and of its training step."""

import torch

from training.networks.neural_process import NeuralProcess


def fixed_process() -> NeuralProcess:
    """Build a process with fixed random weights, larger than fresh ones so that every term counts, as if fitted."""
    torch.manual_seed(21)
    network = NeuralProcess()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(1.5)
    return network.eval()
