"""Weights, classes and configuration that do not fit each other are refused, from Python and from a file."""

import re

import numpy as np
import pytest
from model.small import CLASSES, SMALL, WITH_REGRESSOR, changed, small_model, write_file

from async_tnt import Model, load_model

CLASSIFIER = "conv1.bias, conv1.weight, conv2.bias, conv2.weight, fc1.bias, fc1.weight, fc2.bias, fc2.weight"
REGRESSOR = (
    "regressor.conv1.bias, regressor.conv1.weight, regressor.conv2.bias, regressor.conv2.weight, "
    "regressor.conv3.bias, regressor.conv3.weight, regressor.heatmap.weight"
)
ALL = f"{CLASSIFIER}, {REGRESSOR}"
HINT = '; those of the regressor belong to landmark="regressor" with transform="tnt", and only to that'
SHAPES = {  # of the small model
    "conv1.weight": (2, 2, 3, 3),
    "conv1.bias": (2,),
    "conv2.weight": (3, 2, 3, 3),
    "conv2.bias": (3,),
    "fc1.weight": (4, 3),
    "fc1.bias": (4,),
    "fc2.weight": (3, 4),
    "fc2.bias": (3,),
    "regressor.conv1.weight": (5, 2, 3, 3),
    "regressor.conv1.bias": (5,),
    "regressor.conv2.weight": (6, 5, 3, 3),
    "regressor.conv2.bias": (6,),
    "regressor.conv3.weight": (7, 6, 3, 3),
    "regressor.conv3.bias": (7,),
    "regressor.heatmap.weight": (1, 7, 1, 1),
}


def assert_refused(message, path, weights, config=WITH_REGRESSOR):
    """By Model, and by `load_model` as a damaged file."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Model(config, weights, CLASSES)
    with np.errstate(over="ignore"):
        write_file(path, {name: np.asarray(w, np.float32) for name, w in weights.items()}, config)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} holds a damaged model: {message}')}$"):
        load_model(path)


@pytest.mark.parametrize("name", SHAPES)
def test_each_array_has_its_shape(name, tmp_path):
    """One side more, one axis more, one axis less. The first side of most weights is the layer's width, and free."""
    shape = SHAPES[name]
    fixed = 1 if name.endswith("weight") and name not in ("fc2.weight", "regressor.heatmap.weight") else 0
    wrong = [(*shape[:k], shape[k] + 1, *shape[k + 1 :]) for k in range(fixed, len(shape))]
    for other in [*wrong, (*shape, 1), shape[:-1]] if len(shape) > 1 else [*wrong, (*shape, 1)]:
        message = f"`{name}` must have shape {shape} here, got {other}"
        assert_refused(message, tmp_path / "m", changed(WITH_REGRESSOR, **{name: np.zeros(other)}))


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e39])  # the last: beyond float32
def test_each_array_is_finite(name, value, tmp_path):
    layer = name.removesuffix(".bias").removesuffix(".weight")
    pair = "" if layer.endswith("heatmap") else " and its bias"
    values = np.zeros(SHAPES[name])
    values.flat[-1] = value
    weights = changed(WITH_REGRESSOR, **{name: values})
    assert_refused(f"`{layer}.weight`{pair} must be finite numbers", tmp_path / "m", weights)


@pytest.mark.parametrize("name, widths", [("conv1", "(0, 3, 4)"), ("regressor.conv2", "(5, 0, 7)")])
def test_no_layer_is_empty(name, widths, tmp_path):
    weights = changed(WITH_REGRESSOR, **{f"{name}.weight": np.zeros((0, *SHAPES[f"{name}.weight"][1:]))})
    message = f"every layer must have at least one filter or unit, got widths {widths}"
    assert_refused(message, tmp_path / "m", weights)


def test_exactly_the_arrays_of_the_configuration(tmp_path):
    """Those of a landmark network where the landmark needs one, and only there."""
    one_less, one_more = ALL.replace("fc2.bias, ", ""), ALL.replace("fc2.weight", "fc2.weight, fc3.bias")
    path, whole, plain = tmp_path / "m", changed(WITH_REGRESSOR), changed(SMALL)
    assert_refused(f"`weights` must hold {ALL}, got {one_less}", path, changed(WITH_REGRESSOR, fc2__bias=None))
    assert_refused(f"`weights` must hold {ALL}, got {one_more}", path, whole | {"fc3.bias": np.zeros(1)})
    assert_refused(f"`weights` must hold {ALL}, got {CLASSIFIER}{HINT}", path, plain)
    for changes in ({"landmark": "window"}, {"transform": "none"}):
        config = WITH_REGRESSOR.replace(**changes)
        assert_refused(f"`weights` must hold {CLASSIFIER}, got {ALL}{HINT}", path, whole, config)
    assert small_model(config=WITH_REGRESSOR.replace(transform="none")).weights.keys() == plain.keys()


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"bins": 3}, "`conv1.weight` must have shape (2, 3, 3, 3) here, got (2, 2, 3, 3)"),
        ({"grid": (8, 8)}, "`fc1.weight` must have shape (4, 12) here, got (4, 3)"),
        ({"grid": (3, 8)}, "`grid` must be at least (4, 4) for two 2x2 poolings, got (3, 8)"),
    ],
)
def test_weights_of_another_configuration(changes, message, tmp_path):
    assert_refused(message, tmp_path / "m", changed(), SMALL.replace(**changes))


NAMES = "`classes` must be a tuple or list of names, got "


@pytest.mark.parametrize(
    "classes, record, error, message",
    [
        (("a", "b"), {}, ValueError, "`fc2.weight` must have shape (2, 4) here, got (3, 4)"),
        ((), {}, ValueError, "`classes` must hold at least one name"),
        ("abc", {}, TypeError, NAMES + "'abc'"),
        (CLASSES, None, TypeError, "`record` must be a mapping, got None"),
    ],
)
def test_wrong_classes_and_records(classes, record, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Model(SMALL, changed(), classes, record)


@pytest.mark.parametrize(
    "values, dtype",
    [(np.zeros(4, complex), "complex128"), ([True] * 4, "bool")],
)
def test_weights_that_are_not_numbers(values, dtype):
    with pytest.raises(TypeError, match=f"^`fc1.bias` must be an array of numbers, got {dtype}$"):
        Model(SMALL, changed(fc1__bias=values), CLASSES)
