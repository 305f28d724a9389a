"""Gradients in shards: equal to those of the whole batch, and the same to the bit on any number of cores."""

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from service.model.tensors import ContextKind
from training.fitting.losses import context_regulariser, gaussian_nll
from training.fitting.recipe import Recipe
from training.fitting.samples import Samples
from training.fitting.sharded_gradients import set_gradients, shards_of, thread_pool
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork

CELLS = [
    (method.name, kind)
    for method in METHODS.values()
    if not method.neural_process
    for kind in ContextKind
    if method.takes(kind)
]


def batch_of(kind: ContextKind, objects: int = 10, pushes: int = 250) -> Samples:
    """Draw random pushes. The last object has a single valid push."""
    generator = torch.Generator().manual_seed(3)
    inputs, targets = torch.randn(2, objects, pushes, 3, generator=generator)
    valid = torch.ones(objects, pushes)
    valid[-1, 1:] = 0.0
    context = (torch.rand(objects, *PUSH_SHAPES[kind].context, generator=generator) < 0.3).float()
    return Samples(inputs, targets, valid, context, (1.0, 1.0, 1.0))


def network_of(method: str, kind: ContextKind) -> PushNetwork:
    """Build a fresh network in training mode."""
    torch.manual_seed(1)
    return PushNetwork(METHODS[method], PUSH_SHAPES[kind]).train()


def recipe_of(method: str, kind: ContextKind) -> Recipe:
    """Make a recipe whose regulariser has a large weight."""
    return Recipe("push", method, str(kind), "different-objects", 1, 64, 0.002, 0, 0.5, 2.0, "float32", 0)


def gradients(network: PushNetwork) -> list[Tensor]:
    """Return the gradient of every parameter, zeros where it has none."""
    return [torch.zeros_like(value) if value.grad is None else value.grad for value in network.parameters()]


@pytest.fixture
def threads() -> Iterator[None]:
    """Restore the number of torch's threads after a test."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(("method", "kind"), CELLS)
def test_shards_add_up_to_the_gradient_of_the_whole_loss(method: str, kind: ContextKind) -> None:
    """Likelihood over all pushes, regulariser over all pairs and batch norm over all objects match autograd's."""
    batch, recipe = batch_of(kind), recipe_of(method, kind)
    network, whole = network_of(method, kind), network_of(method, kind)
    mean, log_std, conditioning = whole(batch.inputs, batch.context)
    expected = [gaussian_nll(mean, log_std, batch.targets, batch.valid), torch.zeros(())]
    if whole.distance is not None:
        expected[1] = context_regulariser(conditioning, batch.context, whole.distance, 0.5, 2.0)
    torch.autograd.backward(expected[0] + expected[1])

    found = set_gradients(network, batch, recipe, torch.float32)

    assert len(shards_of(batch)) > 1
    torch.testing.assert_close(found, tuple(value.detach() for value in expected))
    torch.testing.assert_close(gradients(network), gradients(whole), atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16], ids=["float32", "bfloat16"])
@pytest.mark.parametrize(("method", "kind"), [("FCN", ContextKind.NONE), ("FCN + CM + L2Reg", ContextKind.INDICATOR)])
def test_a_gradient_is_the_same_to_the_bit_on_any_number_of_cores(
    method: str, kind: ContextKind, dtype: torch.dtype, threads: None
) -> None:
    """Gradients on one, two and three threads are equal to the bit."""
    found = []
    for count in (1, 2, 3):
        torch.set_num_threads(count)
        network = network_of(method, kind)
        with thread_pool() as shard_map:
            terms = set_gradients(network, batch_of(kind), recipe_of(method, kind), dtype, shard_map)
        found.append([*terms, *gradients(network)])

    assert all(torch.equal(one, other) for others in found[1:] for one, other in zip(found[0], others, strict=True))


def test_gradients_do_not_accumulate() -> None:
    """The gradients of a step replace those of the step before."""
    batch, recipe = batch_of(ContextKind.INDICATOR), recipe_of("FCN + CM + NeuralReg", ContextKind.INDICATOR)
    network = network_of(recipe.method, ContextKind.INDICATOR)
    set_gradients(network, batch, recipe, torch.float32)
    before = [value.clone() for value in gradients(network)]

    set_gradients(network, batch, recipe, torch.float32)

    assert all(torch.equal(*pair) for pair in zip(before, gradients(network), strict=True))


@pytest.mark.parametrize(
    ("objects", "pushes", "sizes"),
    [(64, 250, [16] * 4), (8, 250, [2] * 4), (3, 250, [3]), (5, 250, [2, 3]), (32, 18, [32]), (1, 2000, [1])],
)
def test_a_batch_is_cut_into_few_shards_of_whole_objects(objects: int, pushes: int, sizes: list[int]) -> None:
    """Every object is in one shard, and no shard is too small to be worth a call."""
    shards = shards_of(batch_of(ContextKind.NONE, objects, pushes))

    assert [shard.stop - shard.start for shard in shards] == sizes
    assert [number for shard in shards for number in range(shard.start, shard.stop)] == list(range(objects))


def test_torch_gets_its_threads_back(threads: None) -> None:
    """Torch has its former number of threads after a step, even one that failed."""
    torch.set_num_threads(2)
    with pytest.raises(ZeroDivisionError), thread_pool() as shard_map:
        list(shard_map(lambda shard: 1 / 0, [slice(0, 1)]))  # type: ignore[arg-type,return-value]

    assert torch.get_num_threads() == 2
