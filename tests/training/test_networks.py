"""The paper's networks: their size, their equations, and a mask that knows the object alone."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from service.contract import ContextKind
from training.networks import LOG_STD_LIMIT, METHODS, PushNetwork

Array = npt.NDArray[np.float64]


def network_of(masked: bool) -> PushNetwork:
    """A network with known random weights, larger than fresh ones so that every term counts."""
    torch.manual_seed(11)
    network = PushNetwork(masked)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.mul_(2.0)
    return network


def some_pushers(objects: int, pushes: int) -> Tensor:
    """Normalised pusher poses (objects, pushes, 3)."""
    return torch.randn(objects, pushes, 3, generator=torch.Generator().manual_seed(1))


def some_contexts(objects: int) -> Tensor:
    """Random zeros and ones (objects, 36)."""
    return torch.randint(2, (objects, 36), generator=torch.Generator().manual_seed(2)).float()


def array_of(tensor: Tensor) -> Array:
    """The numbers of a tensor in double precision."""
    array: Array = tensor.detach().to(torch.float64).numpy()
    return array


def numpy_network(
    weights: Mapping[str, Tensor], pusher: Array, indicator: Array | None
) -> tuple[Array, Array, Array | None]:
    """Mean, log std and mask of normalised pushes (n, 3) of one object, from the paper's equations.

    ``g(x, c) = g4(g3(g2(g1(x) * m(c))))`` and ``m(c) = ReLU(W c + b)``.
    """

    def dense(name: str, value: Array) -> Array:
        result: Array = value @ array_of(weights[f"{name}.weight"]).T + array_of(weights[f"{name}.bias"])
        return result

    mask = None if indicator is None else np.maximum(dense("context_mask", indicator), 0.0)
    hidden = np.maximum(dense("first", pusher), 0.0)
    if mask is not None:
        hidden = hidden * mask
    for layer in ("second", "third"):
        hidden = np.maximum(dense(layer, hidden), 0.0)
    output = dense("last", hidden)
    return output[:, :3], output[:, 3:], mask


@pytest.mark.parametrize(
    ("masked", "parameters"),
    [
        # (3 + 1) 256 + (256 + 1) 256 + (256 + 1) 256 + (256 + 1) 6
        pytest.param(False, 1_024 + 65_792 + 65_792 + 1_542, id="FCN: 134,150"),
        # and (36 + 1) 256
        pytest.param(True, 134_150 + 9_472, id="FCN + CM: 143,622"),
    ],
)
def test_the_networks_have_the_paper_s_size(masked: bool, parameters: int) -> None:
    """Four dense layers of width 256; the mask adds one more from 36 context values."""
    assert sum(parameter.numel() for parameter in PushNetwork(masked).parameters()) == parameters


@pytest.mark.parametrize("masked", [False, True], ids=["FCN", "FCN + CM"])
def test_a_forward_pass_is_the_paper_s_equations(masked: bool) -> None:
    """Mean, log standard deviation and mask agree with the equations written out in numpy."""
    network, pushers, contexts = network_of(masked), some_pushers(3, 5), some_contexts(3)
    with torch.no_grad():
        mean, log_std, mask = network(pushers, contexts)

    for row in range(3):
        indicator = array_of(contexts[row]) if masked else None
        expected = numpy_network(network.state_dict(), array_of(pushers[row]), indicator)
        assert np.abs(expected[1]).max() < LOG_STD_LIMIT
        assert array_of(mean[row]) == pytest.approx(expected[0], abs=1e-4)
        assert array_of(log_std[row]) == pytest.approx(expected[1], abs=1e-4)
        if masked:
            assert array_of(mask[row]) == pytest.approx(expected[2], abs=1e-5)
    assert (mask is None) is not masked


def test_the_mask_depends_on_the_object_alone() -> None:
    """One mask per object, the same whatever the pushes and whoever else is in the batch."""
    network, contexts = network_of(masked=True), some_contexts(4)
    with torch.no_grad():
        mask = network(some_pushers(4, 2), contexts).mask
        other_pushes = network(-3.0 * some_pushers(4, 7), contexts).mask
        alone = network(some_pushers(1, 2), contexts[2:3]).mask

    assert mask.shape == (4, 256)
    assert torch.equal(mask, other_pushes)
    assert array_of(mask[2]) == pytest.approx(array_of(alone[0]), abs=1e-6)
    assert not torch.equal(mask[0], mask[1])


def test_the_mask_is_never_negative() -> None:
    """It is a rectified layer: some activations are switched off, some pass, none changes its sign."""
    with torch.no_grad():
        mask = network_of(masked=True).mask(some_contexts(16))

    assert mask is not None
    assert mask.min() == 0.0
    assert mask.max() > 0.0


def test_every_push_meets_the_mask_of_its_own_object() -> None:
    """The same pushes of two objects have two outcomes, and those of one object do not change with its neighbours."""
    network, contexts, pushers = network_of(masked=True), some_contexts(2), some_pushers(1, 6).expand(2, 6, 3)
    with torch.no_grad():
        both = network(pushers, contexts)
        swapped = network(pushers, contexts.flip(0))

    assert not torch.allclose(both.mean[0], both.mean[1])
    assert torch.allclose(both.mean, swapped.mean.flip(0), atol=1e-6)
    assert torch.allclose(both.log_std, swapped.log_std.flip(0), atol=1e-6)


def test_a_network_without_mask_ignores_the_object() -> None:
    """The baseline predicts the same for every object."""
    network, pushers = network_of(masked=False), some_pushers(2, 3)
    with torch.no_grad():
        found, other = network(pushers, some_contexts(2)), network(pushers, 1.0 - some_contexts(2))

    assert torch.equal(found.mean, other.mean)
    assert network.mask(some_contexts(2)) is None


@pytest.mark.parametrize("size", [-1e6, 1e6], ids=["far too sure", "far too unsure"])
def test_the_log_standard_deviation_is_bounded(size: float) -> None:
    """Whatever the input, the standard deviation is a positive, finite float32."""
    network = network_of(masked=False)
    with torch.no_grad():
        network.last.bias[3:] = size
        found = network(some_pushers(1, 4), some_contexts(1)).log_std

    assert found.abs().max() == LOG_STD_LIMIT
    assert torch.isfinite(torch.exp(found)).all()
    assert (torch.exp(found) > 0.0).all()


@pytest.mark.parametrize(
    ("name", "kind", "regularised"),
    [
        ("FCN", ContextKind.NONE, False),
        ("FCN + CM", ContextKind.INDICATOR, False),
        ("FCN + CM + L2Reg", ContextKind.INDICATOR, True),
    ],
)
def test_methods_say_what_they_want_of_the_object(name: str, kind: ContextKind, regularised: bool) -> None:
    """Each row of the paper's tables has its context and its regulariser."""
    method = METHODS[name]

    assert (method.name, method.context_kind, method.regularised) == (name, kind, regularised)


def test_pushes_by_object_and_pushes_with_their_own_masks_are_one_function() -> None:
    """Fitted is the mask in the weights, per object; served is the mask on the activations, per push."""
    torch.manual_seed(5)
    network = PushNetwork(masked=True)
    pusher, context = torch.randn(4, 7, 3), (torch.rand(4, 36) < 0.25).float()
    by_object = network(pusher, context)
    assert by_object.mask is not None
    mean, log_std = network.gaussian(pusher.reshape(28, 3), by_object.mask.repeat_interleave(7, dim=0))
    torch.testing.assert_close(mean.reshape(4, 7, 3), by_object.mean)
    torch.testing.assert_close(log_std.reshape(4, 7, 3), by_object.log_std)
