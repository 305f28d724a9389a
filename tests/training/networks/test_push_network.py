"""Push networks: their size, their equations, and a context that is encoded once per object."""

import numpy as np
import pytest
import torch
from torch import Tensor

from service.model.tensors import ContextKind
from tests.training import reference_equations
from tests.training.reference_equations import array_of
from training.networks.angles import PushForm, circular, from_push_frame, in_push_frame
from training.networks.methods import METHODS
from training.networks.push_network import LOG_STD_LIMIT, PUSH_SHAPES, PushNetwork, Shape

NONE, INDICATOR, VISUAL = ContextKind.NONE, ContextKind.INDICATOR, ContextKind.VISUAL
# (3 + 1) 256 + (256 + 1) 256 + (256 + 1) 256 + (256 + 1) 6
FCN_SIZE = 1_024 + 65_792 + 65_792 + 1_542
# conv (9 + 1) 4, norm 4 + 4, conv (36 + 1) 4 and (9 * 4 + 1) 4, norm, dense (256 + 1) 256
VISUAL_ENCODER = 40 + 8 + 148 + 8 + 65_792
SIZES = [
    pytest.param("FCN", NONE, 134_150, id="FCN"),
    pytest.param("FCN + CC", INDICATOR, FCN_SIZE + 36 * 256, id="FCN + CC, indicator: 39 inputs"),
    pytest.param("FCN + CC", VISUAL, FCN_SIZE + VISUAL_ENCODER, id="FCN + CC, visual"),
    pytest.param("FCN + CM", INDICATOR, FCN_SIZE + 37 * 256, id="FCN + CM, indicator: 143,622"),
    pytest.param("FCN + CM", VISUAL, FCN_SIZE + VISUAL_ENCODER, id="FCN + CM, visual"),
    pytest.param("FCN + CM + L2Reg", INDICATOR, FCN_SIZE + 37 * 256, id="FCN + CM + L2Reg, indicator"),
    pytest.param("FCN + CM + L2Reg", VISUAL, FCN_SIZE + VISUAL_ENCODER, id="FCN + CM + L2Reg, visual"),
    # phi: (36 + 1) 10 + (10 + 1) 5
    pytest.param("FCN + CM + NeuralReg", INDICATOR, FCN_SIZE + 37 * 256 + 425, id="FCN + CM + NeuralReg, indicator"),
    # phi: conv (9 + 1) 4, dense (196 + 1) 10
    pytest.param("FCN + CM + NeuralReg", VISUAL, FCN_SIZE + VISUAL_ENCODER + 2_010, id="FCN + CM + NeuralReg, visual"),
]
CELLS = [pytest.param(*size.values[:2], id=str(size.id)) for size in SIZES]
CONDITIONED = [cell for cell in CELLS if cell.values[1] is not NONE]


def network_of(method: str, kind: ContextKind) -> PushNetwork:
    """Build a network with fixed random weights, larger than fresh ones so that every term counts, as if fitted."""
    torch.manual_seed(11)
    network = PushNetwork(METHODS[method], PUSH_SHAPES[kind])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(2.0)
        for name, record in network.named_buffers():  # of the batch norms
            if name.endswith(("mean", "var")):
                record.copy_(torch.rand(record.shape) + 0.2)
    return network.eval()


def random_pushers(objects: int, pushes: int) -> Tensor:
    """Draw normalised pusher poses (objects, pushes, 3)."""
    return torch.randn(objects, pushes, 3, generator=torch.Generator().manual_seed(1))


def random_contexts(kind: ContextKind, objects: int) -> Tensor:
    """Draw zeros and ones, or grey levels."""
    generator = torch.Generator().manual_seed(2)
    if kind is VISUAL:
        return torch.rand(objects, 1, 32, 32, generator=generator)
    return torch.randint(2, (objects, *PUSH_SHAPES[kind].context), generator=generator).float()


@pytest.mark.parametrize(("method", "kind", "parameters"), SIZES)
def test_the_networks_have_the_paper_s_size(method: str, kind: ContextKind, parameters: int) -> None:
    """Networks have four dense layers of width 256, plus concatenation, mask, visual encoder and phi."""
    network = PushNetwork(METHODS[method], PUSH_SHAPES[kind])

    assert sum(parameter.numel() for parameter in network.parameters()) == parameters


@pytest.mark.parametrize("method", ["FCN", "FCN + CC", "FCN + CM"])
def test_a_mean_in_the_push_frame_is_turned_into_the_object_frame(method: str) -> None:
    """The push frame adds features of the push's line, and turns the mean of the paper's equations back."""
    torch.manual_seed(5)
    kind = ContextKind.NONE if method == "FCN" else INDICATOR
    network = PushNetwork(METHODS[method], PUSH_SHAPES[kind], PushForm.PUSH_FRAME).eval()
    pushers, contexts = random_pushers(6, 5), random_contexts(kind, 6)
    with torch.no_grad():
        mean, log_std, conditioning = network(pushers, contexts)
        alone = network.gaussian(pushers[0], None if conditioning is None else conditioning[:1].expand(5, -1))

    expected = reference_equations.network(
        network.state_dict(), method, array_of(in_push_frame(pushers)), array_of(contexts)
    )
    turned = from_push_frame(torch.from_numpy(expected[0]).float(), pushers)
    assert array_of(mean) == pytest.approx(array_of(turned), abs=1e-5)
    assert array_of(log_std) == pytest.approx(expected[1], abs=1e-5)
    assert torch.allclose(alone[0], mean[0], atol=1e-5)


@pytest.mark.parametrize("fitted", [True, False], ids=["fitted", "in training"])
@pytest.mark.parametrize(("method", "kind"), CELLS)
def test_a_forward_pass_is_the_paper_s_equations(method: str, kind: ContextKind, fitted: bool) -> None:
    """Mean, log standard deviation and mask agree with the equations written out in numpy."""
    network, pushers, contexts = (
        network_of(method, kind).train(not fitted),
        random_pushers(6, 5),
        random_contexts(kind, 6),
    )
    weights = {name: value.clone() for name, value in network.state_dict().items()}
    with torch.no_grad():
        mean, log_std, conditioning = network(pushers, contexts)

    expected = reference_equations.network(weights, method, array_of(pushers), array_of(contexts), fitted)
    assert np.abs(expected[1]).max() < LOG_STD_LIMIT
    assert array_of(mean) == pytest.approx(expected[0], abs=2e-4)
    assert array_of(log_std) == pytest.approx(expected[1], abs=2e-4)
    if expected[2] is not None:
        assert conditioning is not None
        assert array_of(conditioning) == pytest.approx(expected[2], abs=1e-4)


@pytest.mark.parametrize("kind", [INDICATOR, VISUAL])
def test_the_kernel_distance_is_an_inner_product_of_embeddings(kind: ContextKind) -> None:
    """The kernel distance is d(c, c') = phi(c) . phi(c'), with phi as in the paper."""
    network, contexts = network_of("FCN + CM + NeuralReg", kind), random_contexts(kind, 8)
    assert network.distance is not None
    with torch.no_grad():
        found = network.distance(contexts[:4], contexts[4:])

    embedded = reference_equations.phi(network.state_dict(), array_of(contexts))
    assert embedded.shape == (8, 5 if kind is INDICATOR else 10)
    assert array_of(found) == pytest.approx((embedded[:4] * embedded[4:]).sum(axis=-1), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("kind", [INDICATOR, VISUAL])
def test_the_euclidean_distance_is_of_vectorised_contexts(kind: ContextKind) -> None:
    """The Euclidean distance is d(c, c') = |c - c'|, of an image over all its pixels."""
    network, contexts = network_of("FCN + CM + L2Reg", kind), random_contexts(kind, 8)
    assert network.distance is not None

    difference = array_of(contexts[:4] - contexts[4:]).reshape(4, -1)
    assert array_of(network.distance(contexts[:4], contexts[4:])) == pytest.approx(
        np.sqrt((difference**2).sum(axis=-1)), rel=1e-5
    )


@pytest.mark.parametrize("method", ["FCN", "FCN + CC", "FCN + CM"])
def test_methods_without_regulariser_have_no_distance(method: str) -> None:
    """Methods without a regulariser have no context distance."""
    assert network_of(method, NONE if method == "FCN" else INDICATOR).distance is None


@pytest.mark.parametrize(("method", "kind"), CONDITIONED)
def test_a_context_is_encoded_once_per_object(method: str, kind: ContextKind) -> None:
    """The conditioning has one row per object, and depends neither on pushes nor, once fitted, on other objects."""
    network, contexts = network_of(method, kind), random_contexts(kind, 4)
    with torch.no_grad():
        found = network(random_pushers(4, 2), contexts).conditioning
        other_pushes = network(-3.0 * random_pushers(4, 7), contexts).conditioning
        alone = network(random_pushers(1, 2), contexts[2:3]).conditioning

    assert found.shape == (4, 256)
    assert torch.equal(found, other_pushes)
    assert array_of(found[2]) == pytest.approx(array_of(alone[0]), abs=1e-5)
    assert not torch.equal(found[0], found[1])


@pytest.mark.parametrize("kind", [INDICATOR, VISUAL])
def test_a_mask_is_never_negative(kind: ContextKind) -> None:
    """A mask is the output of a ReLU: it has zeros and positive values, and no negative ones."""
    with torch.no_grad():
        mask = network_of("FCN + CM", kind).conditioning(random_contexts(kind, 16))

    assert mask is not None
    assert mask.min() == 0.0
    assert mask.max() > 0.0


@pytest.mark.parametrize(("method", "kind"), CONDITIONED)
def test_every_push_meets_the_context_of_its_own_object(method: str, kind: ContextKind) -> None:
    """Predictions of a push depend on the context of its own object, and not on other objects in the batch."""
    network, contexts = network_of(method, kind), random_contexts(kind, 2)
    pushers = random_pushers(1, 6).expand(2, 6, 3)
    with torch.no_grad():
        both = network(pushers, contexts)
        swapped = network(pushers, contexts.flip(0))

    assert not torch.allclose(both.mean[0], both.mean[1])
    assert torch.allclose(both.mean, swapped.mean.flip(0), atol=1e-4)
    assert torch.allclose(both.log_std, swapped.log_std.flip(0), atol=1e-4)


def test_a_network_without_context_ignores_the_object() -> None:
    """The baseline predicts the same for every object."""
    network, pushers = network_of("FCN", NONE), random_pushers(2, 3)
    contexts = random_contexts(INDICATOR, 2)
    with torch.no_grad():
        found, other = network(pushers, contexts), network(pushers, 1.0 - contexts)

    assert torch.equal(found.mean, other.mean)
    assert network.conditioning(contexts) is None


@pytest.mark.parametrize("size", [-1e6, 1e6], ids=["far too certain", "far too uncertain"])
def test_the_log_standard_deviation_is_bounded(size: float) -> None:
    """The predicted standard deviation is a positive, finite float32 for every input."""
    network = network_of("FCN", NONE)
    with torch.no_grad():
        network.last.bias[3:] = size
        found = network(random_pushers(1, 4), random_contexts(NONE, 1)).log_std

    assert found.abs().max() == LOG_STD_LIMIT
    assert torch.isfinite(torch.exp(found)).all()
    assert (torch.exp(found) > 0.0).all()


@pytest.mark.parametrize(("method", "kind"), CELLS)
def test_pushes_by_object_and_pushes_with_their_own_conditioning_are_one_function(
    method: str, kind: ContextKind
) -> None:
    """Masked weights per object (in fitting) and masked activations per push (in serving) give the same Gaussians."""
    network, pushers, contexts = network_of(method, kind), random_pushers(4, 7), random_contexts(kind, 4)
    with torch.no_grad():
        by_object = network(pushers, contexts)
        rows = None if by_object.conditioning is None else by_object.conditioning.repeat_interleave(7, dim=0)
        mean, log_std = network.gaussian(pushers.reshape(28, 3), rows)

    torch.testing.assert_close(mean.reshape(4, 7, 3), by_object.mean, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(log_std.reshape(4, 7, 3), by_object.log_std, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(("method", "kind"), CELLS)
def test_bfloat16_products_leave_float32_gaussians(method: str, kind: ContextKind) -> None:
    """With bfloat16 products the Gaussians move by less than 2 %, and outputs and gradients stay float32."""
    network, pushers, contexts = network_of(method, kind), random_pushers(4, 7), random_contexts(kind, 4)
    exact = network(pushers, contexts)
    mean, log_std = network.conditioned(pushers, network.conditioning(contexts), torch.bfloat16)
    torch.autograd.backward(mean.square().mean() + log_std.mean())

    assert (mean.dtype, log_std.dtype) == (torch.float32, torch.float32)
    assert 0.0 < (mean - exact.mean).abs().max() < 0.02 * exact.mean.abs().max()
    assert network.second.weight.grad is not None
    assert network.second.weight.grad.dtype is torch.float32


def test_the_bound_does_not_apply_in_training() -> None:
    """A log standard deviation beyond the bound keeps its gradient in training."""
    network = network_of("FCN", NONE).train()
    with torch.no_grad():
        network.last.bias[3:] = 50.0
    torch.autograd.backward(network(random_pushers(1, 4), random_contexts(NONE, 1)).log_std.sum())

    assert network.last.bias.grad is not None
    assert network.last.bias.grad[3:].tolist() == [4.0] * 3


@pytest.mark.parametrize("method", ["FCN", "FCN + CC", "FCN + CM"])
def test_a_circular_angle_enters_as_its_cosine_and_sine(method: str) -> None:
    """A circular angle gives the first layer one more input: the paper's equations on (x, y, cos, sin)."""
    torch.manual_seed(4)
    kind = ContextKind.NONE if method == "FCN" else INDICATOR
    network = PushNetwork(METHODS[method], PUSH_SHAPES[kind], PushForm.CIRCULAR).eval()
    pushers, contexts = random_pushers(6, 5), random_contexts(kind, 6)
    with torch.no_grad():
        mean, log_std, conditioning = network(pushers, contexts)
        alone = network.gaussian(pushers[0], None if conditioning is None else conditioning[:1].expand(5, -1))

    expected = reference_equations.network(
        network.state_dict(), method, array_of(circular(pushers)), array_of(contexts)
    )
    assert array_of(mean) == pytest.approx(expected[0], abs=1e-5)
    assert array_of(log_std) == pytest.approx(expected[1], abs=1e-5)
    assert torch.allclose(alone[0], mean[0], atol=1e-5)


@pytest.mark.parametrize("fitted", [True, False], ids=["fitted", "in training"])
def test_a_least_std_is_added_to_every_std(fitted: bool) -> None:
    """The predicted std is that of the layers plus ``least_std``."""
    plain = network_of("FCN + CM", INDICATOR).train(not fitted)
    floored = PushNetwork(METHODS["FCN + CM"], PUSH_SHAPES[INDICATOR], least_std=0.05).train(not fitted)
    floored.load_state_dict(plain.state_dict())
    pushers, contexts = random_pushers(6, 5), random_contexts(INDICATOR, 6)
    with torch.no_grad():
        without, found = plain(pushers, contexts).log_std, floored(pushers, contexts).log_std

    assert torch.allclose(found.exp(), without.exp() + 0.05, rtol=1e-4)


def test_a_regression_has_a_network_of_its_shape() -> None:
    """The regression of section IV-A has three past values and two kernel parameters as input, and one output."""
    torch.manual_seed(3)
    network = PushNetwork(METHODS["FCN + CM"], Shape((2,), inputs=3, outputs=1))
    inputs, contexts = random_pushers(5, 4), torch.rand(5, 2)
    with torch.no_grad():
        mean, log_std, _ = network(inputs, contexts)

    expected = reference_equations.network(network.state_dict(), "FCN + CM", array_of(inputs), array_of(contexts))
    assert mean.shape == log_std.shape == (5, 4, 1)
    assert array_of(mean) == pytest.approx(expected[0], abs=1e-5)
