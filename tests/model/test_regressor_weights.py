"""The weights of a landmark regressor in a model: there exactly where the landmark needs them, and fitting."""

import re

import numpy as np
import pytest
from made import random_model, random_regressor_model
from model.small import SMALL, assert_same, write_file

from async_tnt import Model, TNTConfig, load_model
from async_tnt.networks.regressor import CompiledRegressor

WITH = SMALL.replace(landmark="regressor")
CLASSES = ("a", "b", "c")
CLASSIFIER = "conv1.bias, conv1.weight, conv2.bias, conv2.weight, fc1.bias, fc1.weight, fc2.bias, fc2.weight"
REGRESSOR = (
    "regressor.conv1.bias, regressor.conv1.weight, regressor.conv2.bias, regressor.conv2.weight, "
    "regressor.conv3.bias, regressor.conv3.weight, regressor.heatmap.weight"
)
ALL = f"{CLASSIFIER}, {REGRESSOR}"
HINT = '; those of the regressor belong to landmark="regressor" with transform="tnt", and only to that'


def small_regressor_model(seed=0):
    return random_regressor_model(WITH, classes=3, widths=(2, 3, 4), regressor_widths=(5, 6, 7), seed=seed)


def changed(**weights):
    """The small model's weights, some of the regressor's replaced or left out (None)."""
    weights = {f"regressor.{name.replace('__', '.')}": values for name, values in weights.items()}
    weights = {**small_regressor_model().weights, **weights}
    return {name: values for name, values in weights.items() if values is not None}


WRONG = [
    ({"conv2__bias": None}, f"`weights` must hold {ALL}, got {ALL.replace('regressor.conv2.bias, ', '')}{HINT}"),
    (
        {"heatmap__weight": None},
        f"`weights` must hold {ALL}, got {ALL.replace(', regressor.heatmap.weight', '')}{HINT}",
    ),
    (
        {"heatmap__bias": np.zeros(1)},
        f"`weights` must hold {ALL}, got "
        f"{ALL.replace('regressor.heatmap', 'regressor.heatmap.bias, regressor.heatmap')}{HINT}",
    ),
    (
        {"conv4__bias": np.zeros(1)},
        f"`weights` must hold {ALL}, got "
        f"{ALL.replace('regressor.heatmap', 'regressor.conv4.bias, regressor.heatmap')}{HINT}",
    ),
    (
        {"conv1__weight": np.zeros((5, 3, 3, 3))},
        "`regressor.conv1.weight` must have shape (5, 2, 3, 3) here, got (5, 3, 3, 3)",
    ),
    (
        {"conv1__weight": np.zeros((5, 2, 5, 5))},
        "`regressor.conv1.weight` must have shape (5, 2, 3, 3) here, got (5, 2, 5, 5)",
    ),
    ({"conv1__weight": np.float32(1)}, "`regressor.conv1.weight` must have shape (1, 2, 3, 3) here, got (1,)"),
    ({"conv1__bias": np.zeros(4)}, "`regressor.conv1.bias` must have shape (5,) here, got (4,)"),
    ({"conv1__bias": np.zeros((5, 1))}, "`regressor.conv1.bias` must have shape (5,) here, got (5, 1)"),
    (
        {"conv2__weight": np.zeros((6, 4, 3, 3))},
        "`regressor.conv2.weight` must have shape (6, 5, 3, 3) here, got (6, 4, 3, 3)",
    ),
    ({"conv2__bias": np.zeros(5)}, "`regressor.conv2.bias` must have shape (6,) here, got (5,)"),
    (
        {"conv3__weight": np.zeros((7, 6, 3))},
        "`regressor.conv3.weight` must have shape (7, 6, 3, 3) here, got (7, 6, 3)",
    ),
    ({"conv3__bias": np.zeros(1)}, "`regressor.conv3.bias` must have shape (7,) here, got (1,)"),
    (
        {"heatmap__weight": np.zeros((1, 6, 1, 1))},
        "`regressor.heatmap.weight` must have shape (1, 7, 1, 1) here, got (1, 6, 1, 1)",
    ),
    (
        {"heatmap__weight": np.zeros((2, 7, 1, 1))},
        "`regressor.heatmap.weight` must have shape (1, 7, 1, 1) here, got (2, 7, 1, 1)",
    ),
    ({"heatmap__weight": np.zeros(7)}, "`regressor.heatmap.weight` must have shape (1, 7, 1, 1) here, got (7,)"),
    (
        {"conv2__weight": np.zeros((0, 5, 3, 3))},
        "every layer must have at least one filter or unit, got widths (5, 0, 7)",
    ),
    *[
        ({f"{layer}__bias": np.full(n, value)}, f"`regressor.{layer}.weight` and its bias must be finite numbers")
        for layer, n in (("conv1", 5), ("conv2", 6), ("conv3", 7))
        for value in (np.nan, np.inf, -1e39)
    ],
    *[
        ({"heatmap__weight": np.full((1, 7, 1, 1), value)}, "`regressor.heatmap.weight` must be finite numbers")
        for value in (np.nan, np.inf, 1e39)
    ],
]


@pytest.mark.parametrize(("weights", "message"), WRONG)
def test_wrong_weights(tmp_path, weights, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Model(WITH, changed(**weights), CLASSES)
    with np.errstate(over="ignore"):
        arrays = {name: np.asarray(values, np.float32) for name, values in changed(**weights).items()}
    write_file(tmp_path / "m", arrays, WITH)
    path = re.escape(str(tmp_path / "m"))
    with pytest.raises(ValueError, match=f"^{path} holds a damaged model: {re.escape(message)}$"):
        load_model(tmp_path / "m")


@pytest.mark.parametrize("changes", [{"landmark": "window"}, {"landmark": "center"}, {"transform": "none"}])
def test_a_regressor_where_none_belongs(tmp_path, changes):
    message = f"`weights` must hold {CLASSIFIER}, got {ALL}{HINT}"
    config = WITH.replace(**changes)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Model(config, changed(), CLASSES)
    write_file(tmp_path / "m", small_regressor_model().weights, config)
    with pytest.raises(ValueError, match=re.escape(f"m holds a damaged model: {message}")):
        load_model(tmp_path / "m")


def test_no_regressor_where_one_belongs(tmp_path):
    plain = random_model(SMALL, classes=3, widths=(2, 3, 4))
    message = f"`weights` must hold {ALL}, got {CLASSIFIER}{HINT}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Model(WITH, plain.weights, CLASSES)
    write_file(tmp_path / "m", plain.weights, WITH)
    with pytest.raises(ValueError, match=re.escape(f"m holds a damaged model: {message}")):
        load_model(tmp_path / "m")


def test_the_landmark_is_ignored_without_the_transform():
    model = random_model(WITH.replace(transform="none"), classes=3, widths=(2, 3, 4))
    assert not any(name.startswith("regressor") for name in model.weights)


@pytest.mark.parametrize("seed", range(3))
def test_a_file_gives_the_same_model_and_the_same_landmarks(tmp_path, seed):
    model = small_regressor_model(seed)
    again = load_model(model.save(tmp_path / "m.safetensors"))
    assert_same(model, again)
    volume = np.random.default_rng(seed).normal(size=model.config.shape).astype(np.float32)
    assert CompiledRegressor(model)(volume) == CompiledRegressor(again)(volume)


def test_the_thesis_width_is_no_more_than_a_default():
    model = random_regressor_model(TNTConfig(landmark="regressor"))
    assert [len(model.weights[f"regressor.conv{k}.bias"]) for k in (1, 2, 3)] == [20, 20, 20]


@pytest.mark.parametrize("n_bytes", [100, -1, -400, -5000])
def test_a_truncated_file(tmp_path, n_bytes):
    path = small_regressor_model().save(tmp_path / "m")
    path.write_bytes(path.read_bytes()[:n_bytes])
    with pytest.raises(ValueError, match=r"m is not a readable \.safetensors file"):
        load_model(path)
