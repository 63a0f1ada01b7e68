"""The compiled landmark network against the torch reference, and by hand."""

import numpy as np
import pytest
import torch
from made import random_events, random_model, random_regressor_model

from async_tnt import Model, TNTConfig, TNTVolume
from async_tnt.kernels.heatmap import centroid, draw_heatmap, rectify
from async_tnt.networks.model import HEATMAP
from async_tnt.networks.regressor import CompiledRegressor
from async_tnt.networks.torch_modules import landmark_function

CASES = [  # grid, bins, polarity, widths
    ((34, 34), 9, "signed", (20, 20, 20)),
    ((34, 34), 9, "split", (20, 20, 20)),
    ((32, 48), 5, "signed", (8, 12, 20)),
    ((35, 33), 3, "unsigned", (5, 17, 3)),
    ((4, 4), 1, "signed", (1, 1, 1)),
    ((7, 5), 2, "signed", (3, 9, 24)),
]


def raw_volume(config, n_events, seed=0):
    """Of events in the upper left quarter, so that there is something to find."""
    volume = TNTVolume(config.replace(transform="none", landmark="center"))
    volume.open(0)
    volume.update(random_events(n_events, sensor=tuple(side // 2 for side in config.sensor), seed=seed))
    return volume.array


@pytest.mark.parametrize("grid, bins, polarity, widths", CASES)
def test_landmark_equals_the_reference_network(grid, bins, polarity, widths):
    config = TNTConfig(sensor=grid, grid=grid, bins=bins, polarity=polarity, landmark="regressor")
    center = np.subtract(grid, 1) / 2
    from_center = []
    for seed in range(5):
        model = random_regressor_model(config, regressor_widths=widths, sharpness=5.0, seed=seed)
        regressor, reference = CompiledRegressor(model), landmark_function(model)
        for n_events in (0, 1, 40, 800):
            volume = raw_volume(config, n_events, seed)
            landmark, expected = regressor(volume), reference(volume)
            assert np.abs(np.subtract(landmark, expected)).max() <= 1e-4
            assert 0 <= landmark[0] <= grid[0] - 1 and 0 <= landmark[1] <= grid[1] - 1
            from_center.append(np.abs(landmark - center).max())
    assert max(from_center) > 0.1 * max(grid)  # what was compared does not stand still


def test_the_zero_heatmap_gives_the_image_centre_exactly():
    """Where training starts: exactly, whatever the events and the other layers."""
    for grid in ((34, 34), (35, 12), (5, 4)):
        config = TNTConfig(sensor=grid, grid=grid, landmark="regressor")
        model = random_regressor_model(config, sharpness=0.0)
        assert CompiledRegressor(model)(raw_volume(config, 500)) == ((grid[0] - 1) / 2, (grid[1] - 1) / 2)


def identity_model(config, heatmap):
    """Every convolution passes its input on: the heatmap's exponent is `heatmap` times ReLU(V), of one bin."""
    weights = dict(random_regressor_model(config, regressor_widths=(1, 1, 1)).weights)
    for layer in ("conv1", "conv2", "conv3"):
        kernel = np.zeros((1, 1, 3, 3))
        kernel[0, 0, 1, 1] = 1
        weights |= {f"regressor.{layer}.weight": kernel, f"regressor.{layer}.bias": np.zeros(1)}
    return Model(config, weights | {HEATMAP: np.full((1, 1, 1, 1), heatmap)}, tuple("abcdefghij"))


def test_centroid_by_hand():
    """One cell of weight e^w among 19 of weight 1: l = sum h (x, y) / sum h."""
    config = TNTConfig(sensor=(5, 4), grid=(5, 4), bins=1, landmark="regressor")
    volume = np.zeros((1, 4, 5), np.float32)
    volume[0, 3, 1] = 2.0
    volume[0, 0, 0] = -7.0  # ReLU: as if it were zero
    h = np.ones((4, 5))
    h[3, 1] = np.exp(2.0 * 1.5)
    y, x = np.indices(h.shape)
    expected = (h * x).sum() / h.sum(), (h * y).sum() / h.sum()
    assert CompiledRegressor(identity_model(config, 1.5))(volume) == pytest.approx(expected, abs=1e-12)
    assert expected[0] < 1.6 and expected[1] > 2.2


def test_convolution_taps_of_every_layer_are_not_flipped():
    """Three times one tap left of the middle: what stands at x = 0 is seen at x = 3, and nothing comes in from the
    right side of the row above."""
    config = TNTConfig(sensor=(6, 5), grid=(6, 5), bins=1, landmark="regressor")
    weights = dict(identity_model(config, 500.0).weights)
    kernel = np.zeros((1, 1, 3, 3))
    kernel[0, 0, 1, 0] = 1
    weights |= {f"regressor.{layer}.weight": kernel for layer in ("conv1", "conv2", "conv3")}
    regressor = CompiledRegressor(Model(config, weights, tuple("abcdefghij")))
    volume = np.zeros((1, 5, 6), np.float32)
    volume[0, 2, 0] = 1
    volume[0, 1, 3:] = 2  # shifted out
    assert regressor(volume) == pytest.approx((3.0, 2.0), abs=1e-12)


def test_kernels_by_hand():
    """Two maps of 2 x 2 in rows of 4; the garbage between must not be seen."""
    garbage = 1e30
    maps = np.array([[1, -2, garbage, garbage, 3, 4], [-1, 5, garbage, garbage, 0.5, -9]], np.float32)
    framed = np.zeros((2, 16), np.float32)
    rectify(maps, 2, 2, framed)
    assert framed.reshape(2, 4, 4)[:, 1:3, 1:3].tolist() == [[[1, 0], [3, 4]], [[0, 5], [0.5, 0]]]
    assert np.count_nonzero(framed) == 5
    exponent = np.empty(6, np.float32)
    draw_heatmap(maps, np.array([2, -1], np.float32), exponent)
    assert exponent[[0, 1, 4, 5]].tolist() == [2.0, -5.0, 5.5, 8.0]
    exponent[[2, 3]] = garbage
    h = np.exp(np.array([2.0, -5.0, 5.5, 8.0]))
    expected = (h[1] + h[3]) / h.sum(), (h[2] + h[3]) / h.sum()
    assert centroid(exponent, 2, 2) == pytest.approx(expected, abs=1e-15)


def test_a_large_exponent_does_not_overflow():
    exponent = np.array([3e38, 3e38, 0, 0, -3e38, 0], np.float32)
    assert centroid(exponent, 2, 2) == (0.5, 0.0)
    exponent[:2] = -3e38, 0
    exponent[4:] = -3e38, -3e38
    assert centroid(exponent, 2, 2) == (1.0, 0.0)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 3])
def test_an_exponent_that_overflowed_gives_what_torch_gives(value, place):
    exponent = np.zeros((2, 2), np.float32)
    exponent.flat[place] = value
    h = torch.softmax(torch.tensor(exponent).double().flatten(), 0).reshape(2, 2).numpy()
    padded = np.full(6, 7.0, np.float32)
    padded[[0, 1, 4, 5]] = exponent.flat
    expected = h[:, 1].sum(), h[1].sum()
    assert centroid(padded, 2, 2) == pytest.approx(expected, abs=1e-15, nan_ok=True)


def test_any_float_array_of_the_right_shape_will_do():
    regressor = CompiledRegressor(random_regressor_model())
    volume = np.random.default_rng(0).normal(size=(9, 34, 34)).astype(np.float32)
    expected = regressor(volume)
    assert all(type(value) is float for value in expected)
    assert regressor(volume.astype(np.float64)) == expected
    assert regressor(np.asfortranarray(volume)) == expected
    assert regressor(-volume) != expected
    assert regressor(volume) == expected


def test_wrong_shape():
    with pytest.raises(ValueError, match=r"^`volume` must have shape \(9, 34, 34\), got \(9, 34, 33\)$"):
        CompiledRegressor(random_regressor_model())(np.zeros((9, 34, 33), np.float32))


@pytest.mark.parametrize("settings", [{}, {"landmark": "window"}, {"landmark": "regressor", "transform": "none"}])
def test_a_model_without_a_regressor(settings):
    with pytest.raises(ValueError, match=r'^the model has no regressor: that needs landmark="regressor" and trans'):
        CompiledRegressor(random_model(TNTConfig(**settings)))
