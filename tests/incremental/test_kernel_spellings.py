"""Kernels in vector registers write the bits of their plain loops, and nothing beside them.

That the loops compute the right numbers is shown where networks and volumes equal their twins in NumPy.
"""

from functools import cache

import numpy as np
import pytest
from numba import njit

import async_tnt.kernels.classify  # noqa: F401 (which registers the kernels below)
from async_tnt.kernels.conv import PLACES
from async_tnt.kernels.conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2, SEEN_1
from async_tnt.kernels.dense import UNITS
from async_tnt.kernels.simd import LANES, SPELLINGS


@cache
def both(name):
    """The plain loops and the instructions of a kernel, to be called from Python."""
    plain, vector = SPELLINGS[name]
    return njit(plain.py_func), njit(lambda *arguments: vector(*arguments))


def numbers(n: int, seed: int, dtype=np.float32) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n).astype(dtype)


IN, WEIGHTS, OUT = numbers(9000, 1), numbers(40_000, 2), numbers(4000, 3)
TILE_1, TILE_2 = range(5, 5 + CELLS_1 * FILTERS_1), range(9, 9 + CELLS_2 * FILTERS_2)
UNITS_OUT = range(7, 7 + UNITS)
ROWS = [20 + f * 3 * PLACES + i for f in range(8) for i in range(PLACES)]
CASES = [  # kernel, arguments before the array that it writes, arguments behind it, places that it may change
    *(
        ("conv_pool_1", (IN, 3, 55, 11, np.array([*active, 99]), len(active), WEIGHTS, 7, 2), (5,), TILE_1)
        for active in ([0], [4], [1, 3], [4, 0, 2], range(5))  # what is behind the active channels is not read
    ),
    *(
        ("conv_pool_2", (IN, 3, pitch * 9, pitch, n_channels, WEIGHTS, 7, 2), (9,), TILE_2)
        for n_channels, pitch in ((1, 16), (5, 8), (16, 16), (17, 32))
    ),
    *(("dense_tile", (IN, 3, n_inputs, WEIGHTS, 5), (7,), UNITS_OUT) for n_inputs in (1, 2, 5, 32, 33)),
    *(
        ("conv_rows", (IN, 3 * PLACES + 16, 7, n_channels, start, WEIGHTS, WEIGHTS[50:], 0), (3 * PLACES,), ROWS)
        for n_channels, start in ((1, 20), (3, 20))
    ),
]


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name, before, behind, places", CASES)
def test_tiles(name, before, behind, places, value):
    """max(nan, 0) is nan here, as in torch: values that are not finite reach the output."""
    inputs = before[0].copy()
    inputs[: 50 if value else 0 : 3] = value
    found = [OUT.copy(), OUT.copy()]
    for run, out in zip(both(name), found, strict=True):
        run(inputs, *before[1:], out, *behind)
    assert np.array_equal(*found, equal_nan=True)
    assert value == 0 or not np.isfinite(found[0]).all()
    changed = np.flatnonzero(found[0] != OUT)
    assert set(changed) <= set(places) and changed.size > 0.9 * len(places)


def test_every_vectorized_kernel_is_tested_here():
    tested = {name for name, *_ in CASES} | {"any_input_1", "round_eight", "add_f64x2"}
    assert set(SPELLINGS) == tested
    assert LANES in (8, 16) and FILTERS_1 == LANES and FILTERS_2 == 2 * LANES and UNITS % LANES == 0


def test_any_input_1():
    """Whether a tile sees anything of a channel: its 4 x 8 pixels, and none beside them; -0 is nothing, nan is not."""
    first, row = 5, 13
    inside = {first + r * row + x for r in range(4) for x in range(SEEN_1)}
    assert SEEN_1 == 2 * CELLS_1 + 2
    for any_input in both("any_input_1"):
        inputs = np.zeros(4 * 13 + 9, np.float32)
        assert any_input(inputs, first, row) == 0
        for place in range(len(inputs)):
            for value in (1.0, -3.0, 1e-45, -1e-45, np.nan, np.inf):
                inputs[place] = value
                assert any_input(inputs, first, row) == (place in inside)
            inputs[place] = -0.0
            assert any_input(inputs, first, row) == 0


def test_add_f64x2():
    weights = numbers(1500, 6, np.float64).reshape(-1, 3)
    expected = np.zeros(10)
    for i, (lower, upper, weight) in enumerate(weights):
        expected[2 * (i % 5) : 2 * (i % 5) + 2] += lower * weight, upper * weight
    for run in both("add_f64x2"):
        cells = np.zeros(10)
        for i, (lower, upper, weight) in enumerate(weights.tolist()):
            run(cells, np.uint64(2 * (i % 5)), lower, upper, weight)
        assert cells.tobytes() == expected.tobytes() and cells.all()


@pytest.mark.parametrize("lower, upper", [(40, 7), (40, 40), (3, 21)])
@pytest.mark.parametrize("same", [[], range(8), [0, 3, 6, 7]], ids=["none_known", "all_known", "some_known"])
def test_round_eight(lower, upper, same):
    buffer = numbers(80, 10, np.float64)
    buffer[lower + 4] = buffer[upper + 4] = 0
    values = buffer[lower : lower + 16 : 2] + (0 if upper == lower else buffer[upper : upper + 16 : 2])
    values = values.astype(np.float32)
    maps, at, changed = OUT[:50].copy(), 5, 30
    maps[changed : changed + 8] = [0, 0, 1, 1, 0, 0, 0, 0]  # some were marked before, by another channel
    for k in same:
        maps[at + k] = values[k]
    expected = maps.copy()
    expected[at : at + 8] = values
    expected[[changed + k for k in range(8) if k not in same]] = 1
    for run in both("round_eight"):
        found = maps.copy()
        run(buffer, lower, upper, found, at, changed)
        assert found.tobytes() == expected.tobytes()


def test_round_eight_treats_the_two_zeros_as_equal():
    """A cell that has cancelled is 0 or -0: it has not changed, whichever it was."""
    for run in both("round_eight"):
        for was, becomes in ((0.0, -0.0), (-0.0, 0.0)):
            buffer, maps = np.full(40, becomes), np.zeros(40, np.float32)
            maps[:8] = was
            run(buffer, 2, 2, maps, 0, 20)
            assert not maps[20:28].any() and maps[:8].tolist() == [0.0] * 8
