"""Kernels in vector registers give the bits of their plain loops, and of a twin in NumPy."""

import numpy as np
import pytest
from incremental.float32 import fma, relu
from numba import njit

from async_tnt.kernels import conv, sync_input
from async_tnt.kernels.conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2, SEEN_1
from async_tnt.kernels.dense import UNITS
from async_tnt.kernels.simd import LANES, SPELLINGS

N_CHANNELS, ROW_1, PITCH_1 = 5, 5 * 11, 11  # rows of channels: 5 channels of 11 pixels to a row
FIRST, FIRST_WEIGHT, FIRST_BIAS, FIRST_OUT = 3, 7, 2, 5  # nothing begins at 0


def both(name):
    """The plain loops and the instructions of a kernel, to be called from Python."""
    plain, vector = SPELLINGS[name]
    return njit(plain.py_func), njit(lambda *arguments: vector(*arguments))


def numbers(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n).astype(np.float32)


def assert_writes(name, arguments, out, expected):
    """Both spellings write `expected` from FIRST_OUT of `out` on, and nothing around it."""
    whole = out.copy()
    whole[FIRST_OUT : FIRST_OUT + expected.size] = expected.reshape(-1)
    for run in both(name):
        found = out.copy()
        run(*arguments, found, FIRST_OUT)
        assert found.tobytes() == whole.tobytes()


def test_every_vectorized_kernel_is_tested_here():
    tested = "conv_pool_1 conv_pool_2 any_input_1 dense_tile round_eight conv_rows add_f64x2"
    assert set(SPELLINGS) == set(tested.split())
    assert LANES in (8, 16) and FILTERS_1 == LANES and FILTERS_2 == 2 * LANES and UNITS % LANES == 0


@pytest.mark.parametrize("active", [[0], [4], [0, 1, 2, 3, 4], [1, 3], [4, 0, 2]], ids=str)
def test_conv_pool_1(active):
    biases = FIRST_WEIGHT + 9 * N_CHANNELS * FILTERS_1
    inputs, weights = numbers(FIRST + 4 * ROW_1 + 40, 1), numbers(biases + FILTERS_1, 2)
    expected = np.zeros((CELLS_1, FILTERS_1), np.float32)
    for cell, r, q in np.ndindex(CELLS_1, 2, 2):
        total = weights[biases : biases + FILTERS_1]
        for c in active:
            for i, j in np.ndindex(3, 3):
                value = inputs[FIRST + (r + i) * ROW_1 + c * PITCH_1 + 2 * cell + q + j]
                at = FIRST_WEIGHT + (9 * c + 3 * i + j) * FILTERS_1
                total = fma(weights[at : at + FILTERS_1], value, total)
        expected[cell] = expected[cell] + relu(total)
    expected *= np.float32(0.25)
    channels = np.array([*active, 99], np.int64)  # what is behind the active ones is not read
    arguments = inputs, FIRST, ROW_1, PITCH_1, channels, len(active), weights, FIRST_WEIGHT, biases
    assert_writes("conv_pool_1", arguments, numbers(FIRST_OUT + expected.size + 9, 3), expected)
    assert (expected > 0).sum() > 10 or len(active) == 1


@pytest.mark.parametrize("n_channels, pitch", [(1, 16), (5, 8), (16, 16), (17, 32)])
def test_conv_pool_2(n_channels, pitch):
    row = pitch * (2 * CELLS_2 + 3)
    inputs, weights = numbers(FIRST + 4 * row + pitch * 8, 4), numbers(FIRST_WEIGHT + 9 * n_channels * FILTERS_2, 5)
    expected = np.zeros((CELLS_2, FILTERS_2), np.float32)
    for cell, r, q in np.ndindex(CELLS_2, 2, 2):
        total = weights[FIRST_BIAS : FIRST_BIAS + FILTERS_2]
        for i, j, c in np.ndindex(3, 3, n_channels):
            value = inputs[FIRST + (r + i) * row + (2 * cell + q + j) * pitch + c]
            at = FIRST_WEIGHT + ((3 * i + j) * n_channels + c) * FILTERS_2
            total = fma(weights[at : at + FILTERS_2], value, total)
        expected[cell] = expected[cell] + relu(total)
    expected *= np.float32(0.25)
    arguments = inputs, FIRST, row, pitch, n_channels, weights, FIRST_WEIGHT, FIRST_BIAS
    assert_writes("conv_pool_2", arguments, numbers(FIRST_OUT + expected.size + 9, 6), expected)
    assert (expected > 0).mean() > 0.6


def test_conv_pool_1_by_hand():
    """One channel, weights 1 for the middle tap: the means of 2x2 pixels, negative ones left out, plus the bias."""
    inputs = np.zeros(FIRST + 4 * ROW_1 + 40, np.float32)
    for y, pixels in ((1, [1, 2, -8, 5, 0, 0]), (2, [3, 6, -8, -8, 0, -1])):
        inputs[FIRST + y * ROW_1 + 1 :][:6] = pixels
    weights = np.zeros(FIRST_WEIGHT + 10 * FILTERS_1, np.float32)
    biases = FIRST_WEIGHT + 9 * FILTERS_1
    weights[FIRST_WEIGHT + 4 * FILTERS_1 + 1] = 1  # filter 1
    weights[biases + 1] = 0.5
    expected = np.zeros((CELLS_1, FILTERS_1), np.float32)
    expected[:, 1] = [(1.5 + 2.5 + 3.5 + 6.5) / 4, 5.5 / 4, 1.5 / 4]
    arguments = inputs, FIRST, ROW_1, PITCH_1, np.array([0]), 1, weights, FIRST_WEIGHT, biases
    assert_writes("conv_pool_1", arguments, np.full(FIRST_OUT + expected.size, -1, np.float32), expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_tiles_propagate_values_that_are_not_finite(value):
    """max(nan, 0) is nan here, as in torch."""
    inputs, weights = numbers(3000, 12), numbers(3000, 13)
    inputs[FIRST + 2 * ROW_1 + 2 * PITCH_1 + 3] = value  # of tile 1: row 2, channel 2, pixel 3
    inputs[FIRST + 2 * 80 + 16 + 3] = value  # of tile 2: row 2, pixel 1, channel 3
    of_1 = inputs, FIRST, ROW_1, PITCH_1, np.arange(N_CHANNELS), N_CHANNELS, weights, FIRST_WEIGHT, 2000
    of_2 = inputs, FIRST, 80, 16, 5, weights, FIRST_WEIGHT, FIRST_BIAS
    for name, arguments in (("conv_pool_1", of_1), ("conv_pool_2", of_2)):
        found = np.zeros((2, max(CELLS_1 * FILTERS_1, CELLS_2 * FILTERS_2)), np.float32)
        for run, out in zip(both(name), found, strict=True):
            run(*arguments, out, 0)
        assert np.array_equal(*found, equal_nan=True) and not np.isfinite(found[0]).all()


def test_any_input_1():
    """Whether a tile sees anything of a channel: its 4 x 8 pixels, and none beside them."""
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
            inputs[place] = -0.0  # adds nothing either
            assert any_input(inputs, first, row) == 0
        inputs[:] = 1
        inputs[sorted(inside)] = 0
        assert any_input(inputs, first, row) == 0


@pytest.mark.parametrize("n_inputs", [1, 2, 5, 32, 33])
def test_dense_tile(n_inputs):
    inputs, weights = numbers(FIRST + n_inputs + 4, 7), numbers(FIRST_WEIGHT + n_inputs * UNITS, 8)
    total = np.zeros(UNITS, np.float32)
    for f in range(n_inputs):
        total = fma(inputs[FIRST + f], weights[FIRST_WEIGHT + f * UNITS :][:UNITS], total)
    arguments = inputs, FIRST, n_inputs, weights, FIRST_WEIGHT
    assert_writes("dense_tile", arguments, numbers(FIRST_OUT + UNITS + 9, 9), total)


@pytest.mark.parametrize("n_channels, n_blocks", [(1, 1), (3, 2)])
def test_conv_rows(n_channels, n_blocks):
    row, n_places = 7, 3 * conv.PLACES
    plane = n_places + 2 * row + 2
    framed = numbers(n_channels * plane, 14)
    weights, bias = numbers(n_blocks * n_channels * 9 * 8, 15), numbers(n_blocks * 8, 16)
    total = np.repeat(bias, n_places).reshape(-1, n_places)
    for c, tap in np.ndindex(n_channels, 9):
        inputs = framed[c * plane + tap // 3 * row + tap % 3 :][:n_places]
        w = weights.reshape(n_blocks, n_channels, 9, 8)[:, c, tap].reshape(-1, 1)
        total = fma(w, inputs, total)
    for run in both("conv_rows"):
        out = np.zeros(n_blocks * 8 * n_places, np.float32)
        for block, start in np.ndindex(n_blocks, 3):
            run(framed, plane, row, n_channels, start * conv.PLACES, weights, bias, block, out, n_places)
        assert out.tobytes() == total.tobytes()


def test_add_f64x2():
    weights = np.random.default_rng(6).normal(size=(500, 3))
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
    rng = np.random.default_rng(10)
    buffer = rng.normal(size=80)
    buffer[lower + 4] = buffer[upper + 4] = 0
    values = buffer[lower : lower + 16 : 2] + (0 if upper == lower else buffer[upper : upper + 16 : 2])
    values = values.astype(np.float32)
    maps, at, changed = rng.normal(size=50).astype(np.float32), 5, 30
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


@pytest.mark.parametrize("n", [1, 2, 7, 8, 11])
def test_round_cells_of_any_number(n):
    buffer, maps = np.random.default_rng(11).normal(size=80), np.zeros(60, np.float32)
    njit(sync_input.round_cells.py_func)(buffer, 40, 1, n, maps, 3, 30)
    expected = np.zeros(60, np.float32)
    expected[3 : 3 + n] = buffer[40 : 40 + 2 * n : 2] + buffer[1 : 1 + 2 * n : 2]
    expected[30 : 30 + n] = 1
    assert maps.tobytes() == expected.tobytes()
