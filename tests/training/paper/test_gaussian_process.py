"""The regression's data: the kernel, the sample counts, the windows, and how well the past predicts the next value."""

import numpy as np
import pytest

from training.paper.gaussian_process import TIME_STEP, covariance, draw_paths, draw_sets, draw_training_data, samples_of


def test_a_simulation_has_the_paper_s_counts() -> None:
    """A simulation has 4000 samples of 200 parameter sets to train on, and 400 of 20 others to test on."""
    data = draw_training_data(0)

    assert data.train.inputs.shape == (4000, 1, 3)
    assert data.held_out.inputs.shape == (20, 20, 3)
    assert (data.train.targets.shape, data.held_out.targets.shape) == ((4000, 1, 1), (20, 20, 1))
    assert (data.train.context.shape, data.held_out.context.shape) == ((4000, 2), (20, 2))
    assert data.train.valid.min() == data.held_out.valid.min() == 1.0
    assert "time step 0.3" in data.origin["source"]


def test_parameters_are_uniform_between_a_tenth_and_ten() -> None:
    """Parameters have the range, mean 5.05 and deviation 9.9 / sqrt(12) of a uniform distribution on (0.1, 10)."""
    parameters, _ = draw_sets(np.random.default_rng(1), 4000)

    assert parameters.min() >= 0.1
    assert parameters.max() <= 10.0
    assert parameters.mean(axis=0) == pytest.approx([5.05, 5.05], abs=0.2)
    assert parameters.std(axis=0) == pytest.approx([9.9 / np.sqrt(12.0)] * 2, abs=0.1)


def test_the_kernel_is_the_paper_s() -> None:
    """The kernel is xi^2 exp(-(a - b)^2 / (2 l)), with l and not its square in the denominator."""
    found = covariance(np.array([[3.0, 0.5], [2.0, 8.0]]), np.array([0.0, 0.4, 1.0]))

    for number, (scale, bandwidth) in enumerate([(3.0, 0.5), (2.0, 8.0)]):
        for i, a in enumerate([0.0, 0.4, 1.0]):
            for j, b in enumerate([0.0, 0.4, 1.0]):
                expected = scale**2 * np.exp(-((a - b) ** 2) / (2.0 * bandwidth))
                assert found[number, i, j] == pytest.approx(expected)


def test_paths_have_the_covariance_of_their_kernel() -> None:
    """The second moments of ten thousand paths of one parameter set are K, within their noise."""
    parameters = np.tile([[2.0, 0.7]], (10_000, 1))
    paths = draw_paths(np.random.default_rng(2), parameters)

    times = TIME_STEP * np.arange(23.0)
    expected = covariance(parameters[:1], times)[0]
    assert paths.T @ paths / len(paths) == pytest.approx(expected, abs=0.25)
    assert paths.mean(axis=0) == pytest.approx(np.zeros(23), abs=0.1)


def test_samples_are_the_windows_of_a_path() -> None:
    """Inputs are three values in order of time, the target is the next value, and contexts are scale and bandwidth."""
    samples = samples_of(np.array([[3.0, 0.5]]), np.arange(23.0)[None])

    assert samples.inputs[0, 0].tolist() == [0.0, 1.0, 2.0]
    assert samples.targets[0, 0].tolist() == [3.0]
    assert samples.inputs[0, 19].tolist() == [19.0, 20.0, 21.0]
    assert samples.targets[0, 19].tolist() == [22.0]
    assert samples.context.tolist() == [[3.0, 0.5]]
    assert samples.target_std == (1.0,)


@pytest.mark.parametrize(("bandwidth", "share"), [(0.1, 0.68), (5.0, 0.0057), (10.0, 0.00206)])
def test_at_our_time_step_three_past_values_predict_the_next(bandwidth: float, share: float) -> None:
    """The std that three past values leave open is the share of the scale that the module states."""
    kernel = covariance(np.array([[1.0, bandwidth]]), TIME_STEP * np.arange(4.0))[0]
    left = kernel[3, 3] - kernel[3, :3] @ np.linalg.solve(kernel[:3, :3], kernel[:3, 3])

    assert np.sqrt(left) == pytest.approx(share, rel=0.05)


def test_a_repeat_is_another_simulation_and_always_the_same() -> None:
    """The number of a repeat determines its training and test data, and another number gives other data."""
    first, again, other = draw_training_data(3), draw_training_data(3), draw_training_data(4)

    assert first.origin == again.origin
    assert first.origin["sha256"] != other.origin["sha256"]
    assert (first.train.inputs == again.train.inputs).all()
    assert not (first.held_out.context == other.held_out.context).any()


def test_values_are_in_units_of_the_training_set() -> None:
    """Training values have mean 0 and deviation 1, in a unit of the scale's root mean square, about 5.8."""
    data = draw_training_data(0)
    # every value of a path but its first three is a target once
    inputs, targets = (values.numpy().reshape(200, 20, -1) for values in (data.train.inputs, data.train.targets))
    values = np.concatenate([inputs[:, 0], targets[..., 0]], axis=1)

    assert values.shape == (200, 23)
    assert (values.mean(), values.std()) == pytest.approx((0.0, 1.0), abs=1e-5)
    assert data.train.target_std == data.held_out.target_std
    assert data.train.target_std[0] == pytest.approx(5.8, rel=0.2)
