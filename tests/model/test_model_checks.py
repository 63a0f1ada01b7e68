"""Weights, classes and configuration that do not fit each other are refused, from Python and from a file."""

import re

import numpy as np
import pytest
from model.small import CLASSES, SMALL, WITH_REGRESSOR, changed, small_model, write_file

from async_tnt import Model, load_model

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
    """By Model, and by `load_model` as a damaged file; `message` is a regular expression."""
    with pytest.raises(ValueError, match=f"^{message}$"):
        Model(config, weights, CLASSES)
    with np.errstate(over="ignore"):
        write_file(path, {name: np.asarray(w, np.float32) for name, w in weights.items()}, config)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} holds a damaged model: ')}{message}$"):
        load_model(path)


@pytest.mark.parametrize("name", SHAPES)
def test_each_array_has_its_shape(name, tmp_path):
    """One side more, one axis more, one axis less: of the layer itself, or of the next one, whose inputs these are."""
    shape = SHAPES[name]
    wrong = [(*shape[:k], shape[k] + 1, *shape[k + 1 :]) for k in range(len(shape))]
    for other in [*wrong, (*shape, 1), shape[:-1]]:
        message = r"layer '\w+' \((conv|dense)\): its (weight|bias) must have shape .* here, got .*"
        if (name, other) == ("regressor.heatmap.weight", (2, 7, 1, 1)):
            message = r"layer 'landmark' \(heatmap_centroid\): its input must be a heatmap \(1, H, W\), got \(2, 6, 5\)"
        assert_refused(message, tmp_path / "m", changed(WITH_REGRESSOR, **{name: np.zeros(other)}))


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e39])  # the last: beyond float32
def test_each_array_is_finite(name, value, tmp_path):
    values = np.zeros(SHAPES[name])
    values.flat[-1] = value
    weights = changed(WITH_REGRESSOR, **{name: values})
    assert_refused(f"`{name}` must be finite numbers", tmp_path / "m", weights)


@pytest.mark.parametrize("name", ["conv1", "regressor.conv2", "fc1"])
def test_no_layer_is_empty(name, tmp_path):
    weights = changed(WITH_REGRESSOR, **{f"{name}.weight": np.zeros((0, *SHAPES[f"{name}.weight"][1:]))})
    assert_refused(r"layer '\w+' \((conv|dense)\): .*", tmp_path / "m", weights)


def test_exactly_the_arrays_of_the_network(tmp_path):
    """Those of a landmark network where the landmark needs one, and only there."""
    path, whole, plain = tmp_path / "m", changed(WITH_REGRESSOR), changed(SMALL)
    one_less = r"layer 'fc2' \(dense\): no tensor is named 'fc2.bias'"
    assert_refused(one_less, path, changed(WITH_REGRESSOR, fc2__bias=None))
    assert_refused("no layer has the weights fc3.bias", path, whole | {"fc3.bias": np.zeros(1)})
    assert_refused(r"layer 'conv1' \(conv\): no tensor is named 'regressor.conv1.weight'", path, plain)
    for changes in ({"landmark": "window"}, {"transform": "none"}):
        config = WITH_REGRESSOR.replace(**changes)
        names = ", ".join(sorted(name for name in SHAPES if name.startswith("regressor.")))
        assert_refused(f"no layer has the weights {names}", path, whole, config)
    assert small_model(config=WITH_REGRESSOR.replace(transform="none")).weights.keys() == plain.keys()


@pytest.mark.parametrize(
    "changes, message",
    [
        (
            {"bins": 3},
            r"layer 'conv1' \(conv\): its weight must have shape \(2, 3, 3, 3\) here, got \(2, 2, 3, 3\)",
        ),
        ({"grid": (8, 8)}, r"layer 'fc1' \(dense\): its weight must have shape \(4, 12\) here, got \(4, 3\)"),
        (
            {"grid": (3, 8)},
            r"layer 'pool2' \(average_pool\): its kernel reaches over 2 places, its input has 1 with the padding "
            r"\(input \(3, 4, 1\)\)",
        ),
    ],
)
def test_weights_of_another_configuration(changes, message, tmp_path):
    assert_refused(message, tmp_path / "m", changed(), SMALL.replace(**changes))


NAMES = "`classes` must be a tuple or list of names, got "


@pytest.mark.parametrize(
    "classes, record, error, message",
    [
        (("a", "b"), {}, ValueError, "the network must compute 2 logits, one for each class, got (3,)"),
        ((), {}, ValueError, "`classes` must hold at least one name"),
        (("a", "b", "a"), {}, ValueError, "`classes` must have different names, got ('a', 'b', 'a')"),
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
