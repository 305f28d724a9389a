"""The paper's equations in numpy, in double precision, written from the formulas without the code under test."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from torch import Tensor

Array = npt.NDArray[np.float64]
Weights = Mapping[str, Tensor]


def array_of(tensor: Tensor) -> Array:
    """Return the numbers of a tensor in double precision."""
    array: Array = tensor.detach().cpu().double().numpy()
    return array


def relu(value: Array) -> Array:
    """Return the larger of a value and zero."""
    return np.maximum(value, 0.0)


def dense(weights: Weights, name: str, value: Array) -> Array:
    """Compute W x + b of rows."""
    result: Array = value @ array_of(weights[f"{name}.weight"]).T + array_of(weights[f"{name}.bias"])
    return result


def convolution(weights: Weights, name: str, images: Array) -> Array:
    """Compute a 3x3 cross-correlation of (n, channels, height, width), padded with zeros to the same size."""
    kernel, bias = array_of(weights[f"{name}.weight"]), array_of(weights[f"{name}.bias"])
    padded = np.pad(images, ((0, 0), (0, 0), (1, 1), (1, 1)))
    height, width = images.shape[2:]
    result = np.zeros((len(images), len(kernel), height, width)) + bias[:, None, None]
    for row in range(3):
        for column in range(3):
            window = padded[:, :, row : row + height, column : column + width]
            result += np.einsum("nchw,oc->nohw", window, kernel[:, :, row, column])
    return result


def batch_norm(weights: Weights, name: str, images: Array, fitted: bool) -> Array:
    """Normalise each channel to zero mean and unit variance, of the batch in training and of the record once fitted."""
    if fitted:
        mean, variance = array_of(weights[f"{name}.running_mean"]), array_of(weights[f"{name}.running_var"])
    else:
        mean, variance = images.mean(axis=(0, 2, 3)), images.var(axis=(0, 2, 3))
    scaled = (images - mean[:, None, None]) / np.sqrt(variance + 1e-5)[:, None, None]
    result: Array = scaled * array_of(weights[f"{name}.weight"])[:, None, None]
    return result + array_of(weights[f"{name}.bias"])[:, None, None]


def max_pool_2(images: Array) -> Array:
    """Return the largest value of each 2x2 block."""
    n, channels, height, width = images.shape
    result: Array = images.reshape(n, channels, height // 2, 2, width // 2, 2).max(axis=(3, 5))
    return result


def average_pool_8(images: Array) -> Array:
    """Return the mean of each 8x8 block, blocks 4 apart."""
    places = range(0, images.shape[2] - 7, 4)
    rows = [[images[:, :, i : i + 8, j : j + 8].mean(axis=(2, 3)) for j in places] for i in places]
    result: Array = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return result


def visual_encoding(weights: Weights, views: Array, fitted: bool) -> Array:
    """Apply twice (convolution, batch norm, ReLU, max-pool), then flatten 4x8x8 values, ReLU, dense: (objects, 256)."""
    value = views
    for conv, norm in ((0, 1), (4, 5)):
        value = convolution(weights, f"context_encoder.convolutions.{conv}", value)
        value = relu(batch_norm(weights, f"context_encoder.convolutions.{norm}", value, fitted))
        value = max_pool_2(value)
    return dense(weights, "context_encoder.dense", relu(value.reshape(len(value), 4 * 8 * 8)))


def network(
    weights: Weights, method: str, pusher: Array, context: Array, fitted: bool = True
) -> tuple[Array, Array, Array | None]:
    """Predict with the paper's networks, which give each push its own copy of the context.

    ``context`` is (objects, 36) or (objects, 1, 32, 32). FCN ignores it.

    Returns:
        Mean and log std, (objects, pushes, 3) each, and the encoding of the context, (objects, 256), if there is one.
    """
    visual = context.ndim == 4
    given: Array | None = None
    if method == "FCN":
        hidden = relu(dense(weights, "first", pusher))
    elif method == "FCN + CC" and visual:
        given = visual_encoding(weights, context, fitted)
        hidden = relu(dense(weights, "first", pusher) + given[:, None, :])
    elif method == "FCN + CC":
        copies = np.repeat(context[:, None, :], pusher.shape[1], axis=1)
        hidden = relu(dense(weights, "first", np.concatenate([pusher, copies], axis=-1)))
    else:
        encoding = visual_encoding(weights, context, fitted) if visual else dense(weights, "context_encoder", context)
        given = relu(encoding)
        hidden = relu(dense(weights, "first", pusher)) * given[:, None, :]
    hidden = relu(dense(weights, "second", hidden))
    hidden = relu(dense(weights, "third", hidden))
    output = dense(weights, "last", hidden)
    half = output.shape[-1] // 2
    return output[..., :half], output[..., half:], given


def phi(weights: Weights, context: Array) -> Array:
    """Compute phi: W2 max(0, W1 x) of vectors, W avg-pool(max(0, conv(x))) of images."""
    if context.ndim == 2:
        return dense(weights, "distance.phi.2", relu(dense(weights, "distance.phi.0", context)))
    pooled = average_pool_8(relu(convolution(weights, "distance.phi.0", context)))
    return dense(weights, "distance.phi.4", pooled.reshape(len(context), 196))


def regulariser(mask: Array, distance: Array, lambda_1: float, lambda_2: float) -> float:
    """Compute lambda_1 (|m - m'| - lambda_2 d)^2, the mean over pairs of the two halves of a batch."""
    half = len(mask) // 2
    apart = np.sqrt(((mask[:half] - mask[half : 2 * half]) ** 2).sum(axis=-1))
    return float((lambda_1 * (apart - lambda_2 * distance) ** 2).mean())


def softmax(value: Array) -> Array:
    """Return shares that sum to 1 over the last axis."""
    grown = np.exp(value - value.max(axis=-1, keepdims=True))
    result: Array = grown / grown.sum(axis=-1, keepdims=True)
    return result


def attention(weights: Weights, name: str, queries: Array, keys: Array, values: Array) -> Array:
    """Compute attention of one object: four heads of width 32, softmax(q k / sqrt(32)) v, mixed, added, normalised."""
    q, k, v = (
        dense(weights, f"{name}.{part}", of) for part, of in (("query", queries), ("key", keys), ("value", values))
    )
    heads = []
    for head in range(4):
        of = slice(32 * head, 32 * head + 32)
        heads.append(softmax(q[:, of] @ k[:, of].T / np.sqrt(32.0)) @ v[:, of])
    total = queries + dense(weights, f"{name}.mixture", np.concatenate(heads, axis=-1))
    centred = total - total.mean(axis=-1, keepdims=True)
    scaled = centred / np.sqrt(total.var(axis=-1, keepdims=True) + 1e-5)
    result: Array = scaled * array_of(weights[f"{name}.norm.weight"]) + array_of(weights[f"{name}.norm.bias"])
    return result


def points(weights: Weights, name: str, inputs: Array, targets: Array) -> Array:
    """Encode inputs and targets of one object by a dense layer, then self-attention twice: (n, 128)."""
    encoded = dense(weights, f"{name}.embed", np.concatenate([inputs, targets], axis=-1))
    for layer in range(2):
        encoded = attention(weights, f"{name}.layers.{layer}", encoded, encoded, encoded)
    return encoded


def latent(weights: Weights, inputs: Array, targets: Array) -> tuple[Array, Array]:
    """Compute mean and std of z given these points of one object: (128,) each, std = 0.1 + 0.9 sigmoid."""
    hidden = relu(dense(weights, "latent_hidden", points(weights, "latent_points", inputs, targets).mean(axis=0)))
    std = 0.1 + 0.9 / (1.0 + np.exp(-dense(weights, "latent_std", hidden)))
    return dense(weights, "latent_mean", hidden), std


def neural_process(
    weights: Weights, support_inputs: Array, support_targets: Array, inputs: Array, z: Array
) -> tuple[Array, Array]:
    """Predict mean and log std (n, 3) of inputs (n, 3) of one object, given its support and z, without dropout."""
    encoded = points(weights, "support_points", support_inputs, support_targets)
    found, keys = dense(weights, "place", inputs), dense(weights, "place", support_inputs)
    for layer in range(2):
        found = attention(weights, f"cross.{layer}", found, keys, encoded)
    everywhere = np.repeat(z[None], len(inputs), axis=0)
    hidden = np.concatenate([dense(weights, "target_input", inputs), found, everywhere], axis=-1)
    for layer in range(3):
        hidden = relu(dense(weights, f"decoder.{layer}", hidden))
    output = dense(weights, "last", hidden)
    return output[:, :3], output[:, 3:]
