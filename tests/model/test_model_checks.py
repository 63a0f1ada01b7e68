"""Weights, classes and configuration that do not fit each other are refused, from Python and from a file."""

import re

import numpy as np
import pytest
from model.small import SMALL, changed, write_file

from async_tnt import Model, load_model

ALL = "conv1.bias, conv1.weight, conv2.bias, conv2.weight, fc1.bias, fc1.weight, fc2.bias, fc2.weight"
WRONG = [
    ({"fc2__bias": None}, ValueError, f"`weights` must hold {ALL}, got {ALL.replace('fc2.bias, ', '')}"),
    ({"fc3__bias": np.zeros(1)}, ValueError, f"`weights` must hold {ALL}, got {ALL}, fc3.bias"),
    (
        {"conv1__weight": np.zeros((2, 3, 3, 3))},
        ValueError,
        "`conv1.weight` must have shape (2, 2, 3, 3) here, got (2, 3, 3, 3)",
    ),
    (
        {"conv1__weight": np.zeros((2, 2, 5, 5))},
        ValueError,
        "`conv1.weight` must have shape (2, 2, 3, 3) here, got (2, 2, 5, 5)",
    ),
    ({"conv1__weight": np.float32(1)}, ValueError, "`conv1.weight` must have shape (1, 2, 3, 3) here, got (1,)"),
    ({"conv1__bias": np.zeros(3)}, ValueError, "`conv1.bias` must have shape (2,) here, got (3,)"),
    ({"conv1__bias": np.zeros((2, 1))}, ValueError, "`conv1.bias` must have shape (2,) here, got (2, 1)"),
    (
        {"conv2__weight": np.zeros((3, 5, 3, 3))},
        ValueError,
        "`conv2.weight` must have shape (3, 2, 3, 3) here, got (3, 5, 3, 3)",
    ),
    (
        {"conv2__weight": np.zeros((3, 2, 3))},
        ValueError,
        "`conv2.weight` must have shape (3, 2, 3, 3) here, got (3, 2, 3)",
    ),
    ({"conv2__bias": np.zeros(2)}, ValueError, "`conv2.bias` must have shape (3,) here, got (2,)"),
    ({"fc1__weight": np.zeros((4, 4))}, ValueError, "`fc1.weight` must have shape (4, 3) here, got (4, 4)"),
    ({"fc1__bias": np.zeros(5)}, ValueError, "`fc1.bias` must have shape (4,) here, got (5,)"),
    ({"fc2__weight": np.zeros((4, 4))}, ValueError, "`fc2.weight` must have shape (3, 4) here, got (4, 4)"),
    ({"fc2__weight": np.zeros((3, 5))}, ValueError, "`fc2.weight` must have shape (3, 4) here, got (3, 5)"),
    ({"fc2__bias": np.zeros(4)}, ValueError, "`fc2.bias` must have shape (3,) here, got (4,)"),
    *[
        ({f"{layer}__bias": np.full(n, value)}, ValueError, f"`{layer}.weight` and its bias must be finite numbers")
        for layer, n in (("conv1", 2), ("conv2", 3), ("fc1", 4), ("fc2", 3))
        for value in (np.nan, np.inf, -np.inf, 1e39)  # beyond float32
    ],
    (
        {"conv2__weight": np.full((3, 2, 3, 3), np.nan)},
        ValueError,
        "`conv2.weight` and its bias must be finite numbers",
    ),
    (
        {"conv1__weight": np.zeros((0, 2, 3, 3))},
        ValueError,
        "every layer must have at least one filter or unit, got widths (0, 3, 4)",
    ),
    (
        {"fc1__weight": np.zeros((0, 3))},
        ValueError,
        "every layer must have at least one filter or unit, got widths (2, 3, 0)",
    ),
    ({"fc1__bias": np.zeros(4, complex)}, TypeError, "`fc1.bias` must be an array of numbers, got complex128"),
    ({"fc1__bias": np.array(["a"] * 4)}, TypeError, "`fc1.bias` must be an array of numbers, got <U1"),
    ({"fc1__bias": [None] * 4}, TypeError, "`fc1.bias` must be an array of numbers, got object"),
    ({"fc1__bias": np.zeros(4, bool)}, TypeError, "`fc1.bias` must be an array of numbers, got bool"),
]


@pytest.mark.parametrize(("weights", "error", "message"), WRONG)
def test_wrong_weights(weights, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Model(SMALL, changed(**weights), ("a", "b", "c"))


@pytest.mark.parametrize(("weights", "message"), [(weights, m) for weights, error, m in WRONG if error is ValueError])
def test_wrong_weights_in_a_file(tmp_path, weights, message):
    with np.errstate(over="ignore"):
        arrays = {name: np.asarray(values, np.float32) for name, values in changed(**weights).items()}
    write_file(tmp_path / "m", arrays)
    with pytest.raises(
        ValueError, match=f"^{re.escape(str(tmp_path / 'm'))} holds a damaged model: {re.escape(message)}$"
    ):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    ("config", "classes", "record", "error", "message"),
    [
        (SMALL, ("a", "b"), {}, ValueError, "`fc2.weight` must have shape (2, 4) here, got (3, 4)"),
        (SMALL, (), {}, ValueError, "`classes` must hold at least one name"),
        (SMALL, "abc", {}, TypeError, "`classes` must be a tuple or list of names, got 'abc'"),
        (SMALL, None, {}, TypeError, "`classes` must be a tuple or list of names, got None"),
        (
            SMALL,
            {"a": 1, "b": 2, "c": 3},
            {},
            TypeError,
            "`classes` must be a tuple or list of names, got {'a': 1, 'b': 2, 'c': 3}",
        ),
        (SMALL, ("a", "b", "c"), None, TypeError, "`record` must be a mapping, got None"),
        (SMALL, ("a", "b", "c"), [1], TypeError, "`record` must be a mapping, got [1]"),
        (
            SMALL.replace(bins=3),
            ("a", "b", "c"),
            {},
            ValueError,
            "`conv1.weight` must have shape (2, 3, 3, 3) here, got (2, 2, 3, 3)",
        ),
        (
            SMALL.replace(polarity="split"),
            ("a", "b", "c"),
            {},
            ValueError,
            "`conv1.weight` must have shape (2, 4, 3, 3) here, got (2, 2, 3, 3)",
        ),
        (
            SMALL.replace(grid=(8, 8)),
            ("a", "b", "c"),
            {},
            ValueError,
            "`fc1.weight` must have shape (4, 12) here, got (4, 3)",
        ),
        (
            SMALL.replace(grid=(3, 8)),
            ("a", "b", "c"),
            {},
            ValueError,
            "`grid` must be at least (4, 4) for two 2x2 poolings, got (3, 8)",
        ),
        (
            SMALL.replace(grid=(8, 2)),
            ("a", "b", "c"),
            {},
            ValueError,
            "`grid` must be at least (4, 4) for two 2x2 poolings, got (8, 2)",
        ),
    ],
)
def test_wrong_parts(config, classes, record, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Model(config, changed(), classes, record)
