"""The compiled landmark network by hand.

Against the torch reference: test_volume_equals_reference.py.
"""

import numpy as np
import pytest
import torch
from made import random_model, random_regressor_model, thesis_model

from async_tnt import CompiledRegressor, TNTConfig
from async_tnt.kernels.network.heatmap import centroid


def test_the_zero_heatmap_gives_the_image_centre_exactly():
    """Where training starts: whatever the events and the other layers."""
    config = TNTConfig(sensor=(35, 12), grid=(35, 12), landmark="regressor")
    volume = np.random.default_rng(0).normal(size=config.shape).astype(np.float32)
    assert CompiledRegressor(random_regressor_model(config, sharpness=0.0))(volume) == (17.0, 5.5)


def middle_taps(config: TNTConfig, heatmap: float) -> CompiledRegressor:
    """Every convolution is its middle tap.

    So the heatmap's exponent is `heatmap` times ReLU(V), of one bin.
    """
    weights = dict(random_regressor_model(config, regressor_widths=(1, 1, 1)).weights)
    kernel = np.zeros((1, 1, 3, 3))
    kernel[0, 0, 1, 1] = 1
    for layer in ("conv1", "conv2", "conv3"):
        weights |= {f"regressor.{layer}.weight": kernel, f"regressor.{layer}.bias": np.zeros(1)}
    return CompiledRegressor(
        thesis_model(
            config,
            weights | {"regressor.heatmap.weight": np.full((1, 1, 1, 1), heatmap)},
            tuple("abcdefghij"),
        )
    )


def test_centroid_of_one_cell_by_hand():
    """One cell of weight e^w among 19 of weight 1: l = sum h (x, y) / sum h."""
    volume = np.zeros((1, 4, 5), np.float32)
    volume[0, 3, 1] = 2.0
    volume[0, 0, 0] = -7.0  # ReLU: as if it were zero
    h = np.ones((4, 5))
    h[3, 1] = np.exp(2.0 * 1.5)
    y, x = np.indices(h.shape)
    expected = (h * x).sum() / h.sum(), (h * y).sum() / h.sum()
    config = TNTConfig(sensor=(5, 4), grid=(5, 4), bins=1, landmark="regressor")
    assert middle_taps(config, 1.5)(volume) == pytest.approx(expected, abs=1e-12)
    assert expected[0] < 1.6 and expected[1] > 2.2


@pytest.mark.parametrize(
    "heatmap", [[3e38, 3e38, -3e38, 0], [-3e38, 0, -3e38, -3e38], *np.eye(4)[:2] * 3e38], ids=str
)
@pytest.mark.parametrize("value", [None, np.inf, -np.inf, np.nan])
def test_large_exponents_and_those_that_overflowed_give_what_torch_gives(heatmap, value):
    exponent = np.array(heatmap, np.float32)
    exponent[3] = exponent[3] if value is None else value
    h = torch.softmax(torch.tensor(exponent).double(), 0).numpy()
    in_rows = np.array([*exponent[:2], 7, 7, *exponent[2:]], np.float32)
    assert centroid(in_rows, 4, 2, 2) == pytest.approx(
        (h[1] + h[3], h[2] + h[3]), abs=1e-15, nan_ok=True
    )


@pytest.mark.parametrize("settings", [{"landmark": "line"}, {"transform": "none"}], ids=str)
def test_a_model_without_a_landmark_network_has_no_regressor(settings):
    """What it is made for does not need one."""
    model = random_model(TNTConfig(**{"landmark": "regressor"} | settings))
    message = (
        '^the model has no regressor: that needs landmark="regressor" and transform="tnt", got '
        f"landmark={model.config.landmark!r}, transform={model.config.transform!r}$"
    )
    with pytest.raises(ValueError, match=message):
        CompiledRegressor(model)
