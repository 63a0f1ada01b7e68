"""Kernels in vector registers give the bits of their plain spelling, and of a twin in NumPy."""

import numpy as np
import pytest
from incremental.float32 import fma, relu
from numba import njit

from async_tnt.kernels import conv_pool as tile
from async_tnt.kernels import dense as weigh
from async_tnt.kernels import rounding
from async_tnt.kernels.registers import LANES

N_CHANNELS, ROW_1, PITCH_1 = 5, 5 * 11, 11  # rows of channels: 5 channels of 11 pixels to a row
FIRST, FIRST_WEIGHT, FIRST_BIAS, FIRST_OUT = 3, 7, 2, 5  # nothing begins at 0


def numbers(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=n).astype(np.float32)


@njit
def _run_1_plain(inputs, active, n_active, weights, biases, out):
    tile._tile_1_checked(inputs, FIRST, ROW_1, PITCH_1, active, n_active, weights, FIRST_WEIGHT, biases, out, FIRST_OUT)


@njit
def _run_1_registers(inputs, active, n_active, weights, biases, out):
    tile._tile_1_in_registers(
        inputs, FIRST, ROW_1, PITCH_1, active, n_active, weights, FIRST_WEIGHT, biases, out, FIRST_OUT
    )


def tile_1_twin(inputs, active, weights, biases):
    pooled = np.zeros((tile.CELLS_1, tile.FILTERS_1), np.float32)
    for cell, r, q in np.ndindex(tile.CELLS_1, 2, 2):
        total = weights[biases : biases + tile.FILTERS_1]
        for c in active:
            for i, j in np.ndindex(3, 3):
                value = inputs[FIRST + (r + i) * ROW_1 + c * PITCH_1 + 2 * cell + q + j]
                at = FIRST_WEIGHT + (9 * c + 3 * i + j) * tile.FILTERS_1
                total = fma(weights[at : at + tile.FILTERS_1], value, total)
        pooled[cell] = pooled[cell] + relu(total)
    return pooled * np.float32(0.25)


@pytest.mark.parametrize("active", [[0], [4], [0, 1, 2, 3, 4], [1, 3], [4, 0, 2]], ids=str)
def test_tile_1(active):
    n_weights = FIRST_WEIGHT + 9 * N_CHANNELS * tile.FILTERS_1
    inputs, weights = numbers(FIRST + 4 * ROW_1 + 40, 1), numbers(n_weights + tile.FILTERS_1, 2)
    expected = numbers(FIRST_OUT + tile.CELLS_1 * tile.FILTERS_1 + 9, 3)
    found = [expected.copy(), expected.copy()]
    expected[FIRST_OUT:-9] = tile_1_twin(inputs, active, weights, n_weights).reshape(-1)
    channels = np.array([*active, 99], np.int64)  # what is behind the active ones is not looked at
    for run, out in zip((_run_1_plain, _run_1_registers), found, strict=True):
        run(inputs, channels, len(active), weights, n_weights, out)
        assert out.tobytes() == expected.tobytes()  # and around it nothing has changed
    assert (expected[FIRST_OUT:-9] > 0).sum() > 10 or len(active) == 1


@njit
def _run_2_plain(inputs, row, pitch, n_channels, weights, out):
    tile._tile_2_checked(inputs, FIRST, row, pitch, n_channels, weights, FIRST_WEIGHT, FIRST_BIAS, out, FIRST_OUT)


@njit
def _run_2_registers(inputs, row, pitch, n_channels, weights, out):
    tile._tile_2_in_registers(inputs, FIRST, row, pitch, n_channels, weights, FIRST_WEIGHT, FIRST_BIAS, out, FIRST_OUT)


def tile_2_twin(inputs, row, pitch, n_channels, weights):
    pooled = np.zeros((tile.CELLS_2, tile.FILTERS_2), np.float32)
    for cell, r, q in np.ndindex(tile.CELLS_2, 2, 2):
        total = weights[FIRST_BIAS : FIRST_BIAS + tile.FILTERS_2]
        for i, j, c in np.ndindex(3, 3, n_channels):
            value = inputs[FIRST + (r + i) * row + (2 * cell + q + j) * pitch + c]
            at = FIRST_WEIGHT + ((3 * i + j) * n_channels + c) * tile.FILTERS_2
            total = fma(weights[at : at + tile.FILTERS_2], value, total)
        pooled[cell] = pooled[cell] + relu(total)
    return pooled * np.float32(0.25)


@pytest.mark.parametrize("n_channels, pitch", [(1, 16), (5, 8), (16, 16), (17, 32)])
def test_tile_2(n_channels, pitch):
    row = pitch * (2 * tile.CELLS_2 + 3)
    inputs = numbers(FIRST + 4 * row + pitch * 8, 4)
    weights = numbers(FIRST_WEIGHT + 9 * n_channels * tile.FILTERS_2, 5)
    expected = numbers(FIRST_OUT + tile.CELLS_2 * tile.FILTERS_2 + 9, 6)
    found = [expected.copy(), expected.copy()]
    expected[FIRST_OUT:-9] = tile_2_twin(inputs, row, pitch, n_channels, weights).reshape(-1)
    for run, out in zip((_run_2_plain, _run_2_registers), found, strict=True):
        run(inputs, row, pitch, n_channels, weights, out)
        assert out.tobytes() == expected.tobytes()
    assert (expected[FIRST_OUT:-9] > 0).mean() > 0.6


def test_tile_1_by_hand():
    """One channel, weights 1 for the middle tap: the means of 2x2 pixels, negative ones left out, plus the bias."""
    pixels = np.zeros((4, PITCH_1), np.float32)
    pixels[1:3, 1:7] = [[1, 2, -8, 5, 0, 0], [3, 6, -8, -8, 0, -1]]
    inputs = np.zeros(FIRST + 4 * ROW_1 + 40, np.float32)
    for y in range(4):
        inputs[FIRST + y * ROW_1 : FIRST + y * ROW_1 + PITCH_1] = pixels[y]
    weights = np.zeros(FIRST_WEIGHT + 10 * tile.FILTERS_1, np.float32)
    weights[FIRST_WEIGHT + 4 * tile.FILTERS_1 + 1] = 1  # filter 1
    weights[FIRST_WEIGHT + 9 * tile.FILTERS_1 + 1] = 0.5  # its bias
    for run in (_run_1_plain, _run_1_registers):
        out = np.full(FIRST_OUT + tile.CELLS_1 * tile.FILTERS_1, -1, np.float32)
        run(inputs, np.array([0]), 1, weights, FIRST_WEIGHT + 9 * tile.FILTERS_1, out)
        cells = out[FIRST_OUT:].reshape(tile.CELLS_1, tile.FILTERS_1)
        assert cells[:, 1].tolist() == [(1.5 + 2.5 + 3.5 + 6.5) / 4, 5.5 / 4, 1.5 / 4]
        assert not np.delete(cells, 1, axis=1).any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_tiles_pass_on_what_is_no_number(value):
    """max(nan, 0) is nan here, as in torch."""
    inputs, weights = numbers(3000, 12), numbers(3000, 13)
    inputs[FIRST + 2 * ROW_1 + 2 * PITCH_1 + 3] = value  # row 2, channel 2, pixel 3
    found = []
    for run in (_run_1_plain, _run_1_registers):
        found.append(np.zeros(FIRST_OUT + tile.CELLS_1 * tile.FILTERS_1, np.float32))
        run(inputs, np.arange(N_CHANNELS), N_CHANNELS, weights, 2000, found[-1])
    assert np.array_equal(*found, equal_nan=True) and np.isfinite(found[0]).any()
    assert not np.isfinite(found[0]).all()
    inputs[FIRST + 2 * 80 + 16 + 3] = value  # row 2, pixel 1, channel 3
    found = []
    for run in (_run_2_plain, _run_2_registers):
        found.append(np.zeros(FIRST_OUT + tile.CELLS_2 * tile.FILTERS_2, np.float32))
        run(inputs, 80, 16, 5, weights, found[-1])
    assert np.array_equal(*found, equal_nan=True) and not np.isfinite(found[0]).all()


@njit
def _occupied_plain(inputs, first, row):
    return tile._occupied_checked(inputs, first, row)


@njit
def _occupied_registers(inputs, first, row):
    return tile._occupied_in_registers(inputs, first, row)


@pytest.mark.parametrize("occupied", [_occupied_plain, _occupied_registers])
def test_occupied(occupied):
    """Whether a tile sees anything of a channel: its 4 x 8 pixels, and none beside them."""
    inputs, first, row = np.zeros(4 * 13 + 9, np.float32), 5, 13
    inside = {first + r * row + x for r in range(4) for x in range(tile.SEEN_1)}
    assert tile.SEEN_1 == 2 * tile.CELLS_1 + 2 and occupied(inputs, first, row) == 0
    for place in range(len(inputs)):
        for value in (1.0, -3.0, 1e-45, -1e-45, np.nan, np.inf):
            inputs[place] = value
            assert occupied(inputs, first, row) == (place in inside)
        inputs[place] = -0.0  # adds nothing either
        assert occupied(inputs, first, row) == 0
    inputs[:] = 1
    assert occupied(inputs, first, row) == 1
    inputs[sorted(inside)] = 0
    assert occupied(inputs, first, row) == 0


@njit
def _weigh_plain(inputs, n_inputs, weights, out):
    weigh._weigh_checked(inputs, FIRST, n_inputs, weights, FIRST_WEIGHT, out, FIRST_OUT)


@njit
def _weigh_registers(inputs, n_inputs, weights, out):
    weigh._weigh_in_registers(inputs, FIRST, n_inputs, weights, FIRST_WEIGHT, out, FIRST_OUT)


@pytest.mark.parametrize("n_inputs", [1, 2, 5, 32, 33])
def test_weigh(n_inputs):
    inputs, weights = numbers(FIRST + n_inputs + 4, 7), numbers(FIRST_WEIGHT + n_inputs * weigh.UNITS, 8)
    expected = numbers(FIRST_OUT + weigh.UNITS + 9, 9)
    found = [expected.copy(), expected.copy()]
    total = np.zeros(weigh.UNITS, np.float32)
    for f in range(n_inputs):
        total = fma(inputs[FIRST + f], weights[FIRST_WEIGHT + f * weigh.UNITS :][: weigh.UNITS], total)
    expected[FIRST_OUT:-9] = total
    for run, out in zip((_weigh_plain, _weigh_registers), found, strict=True):
        run(inputs, n_inputs, weights, out)
        assert out.tobytes() == expected.tobytes()


@njit
def _round_plain(buffer, early, late, maps, at, marks):
    rounding._round_eight_checked(buffer, early, late, maps, at, marks)


@njit
def _round_registers(buffer, early, late, maps, at, marks):
    rounding._round_eight_in_registers(buffer, early, late, maps, at, marks)


@pytest.mark.parametrize("early, late", [(40, 7), (40, 40), (3, 21)])
@pytest.mark.parametrize("known", ["nothing", "all", "some"])
def test_round_eight(early, late, known):
    rng = np.random.default_rng(10)
    buffer = rng.normal(size=80)
    buffer[early + 4] = buffer[late + 4] = 0
    values = buffer[early : early + 16 : 2] + (0 if late == early else buffer[late : late + 16 : 2])
    values = values.astype(np.float32)
    maps, at, marks = rng.normal(size=50).astype(np.float32), 5, 30
    maps[marks : marks + 8] = [0, 0, 1, 1, 0, 0, 0, 0]  # some were marked before, by another channel
    same = {"nothing": [], "all": range(8), "some": [0, 3, 6, 7]}[known]
    for k in same:
        maps[at + k] = values[k]
    expected = maps.copy()
    expected[at : at + 8] = values
    expected[[marks + k for k in range(8) if k not in same]] = 1
    for run in (_round_plain, _round_registers):
        found = maps.copy()
        run(buffer, early, late, found, at, marks)
        assert found.tobytes() == expected.tobytes()


def test_round_eight_takes_the_two_zeros_for_equal():
    """A cell that has cancelled is 0 or -0: it has not changed, whichever it was."""
    for run in (_round_plain, _round_registers):
        for was, becomes in ((0.0, -0.0), (-0.0, 0.0)):
            buffer, maps = np.full(40, becomes), np.zeros(40, np.float32)
            maps[:8] = was
            run(buffer, 2, 2, maps, 0, 20)
            assert not maps[20:28].any() and maps[:8].tolist() == [0.0] * 8


@pytest.mark.parametrize("n", [1, 2, 7, 8, 11])
def test_round_cells_of_any_number(n):
    @njit
    def run(buffer, early, late, n, maps, at, marks):
        rounding.round_cells_checked(buffer, early, late, n, maps, at, marks)

    buffer, maps = np.random.default_rng(11).normal(size=80), np.zeros(60, np.float32)
    run(buffer, 40, 1, n, maps, 3, 30)
    expected = np.zeros(60, np.float32)
    expected[3 : 3 + n] = buffer[40 : 40 + 2 * n : 2] + buffer[1 : 1 + 2 * n : 2]
    expected[30 : 30 + n] = 1
    assert maps.tobytes() == expected.tobytes()


def test_registers_hold_what_this_machine_has():
    assert LANES in (8, 16) and tile.FILTERS_1 == LANES and tile.FILTERS_2 == 2 * LANES and weigh.UNITS % LANES == 0
