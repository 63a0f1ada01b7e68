"""Kernels in vector registers write the bits of their plain loops, and nothing beside them.

That the loops compute the right numbers is shown where networks and volumes equal their twins in
NumPy.
"""

import math
from functools import cache

import numpy as np
import pytest
from numba import njit

import async_tnt.kernels.decisions.classify  # noqa: F401 (which registers the kernels below)
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.functions import FUNCTIONS, apply_function
from async_tnt.kernels.network.tiles import MOST_PLACES, REGISTERS, SIZES
from async_tnt.kernels.simd import SPELLINGS
from async_tnt.kernels.target import LANES


@cache
def both(name):
    """The plain loops and the instructions of a kernel, to be called from Python."""
    plain, vector = SPELLINGS[name]
    return njit(plain.py_func), njit(lambda *arguments: vector(*arguments))


def numbers(n: int, seed: int, dtype=np.float32) -> np.ndarray:
    """n normally distributed numbers."""
    return np.random.default_rng(seed).normal(size=n).astype(dtype)


MAPS = numbers(9000, 1)
WEIGHTS = numbers(60_000, 2)
# where the step's record begins in a program
AT = P.FIRST_STEP
# where places are listed
LISTED = 5
# where in MAPS place (0, 0) is written
OUT = 6000
# places (row, column), as many as a tile may have
PLACES = [
    (0, 7),
    (3, 2),
    (3, 3),
    (0, 0),
    (5, 6),
    (0, 1),
    (4, 0),
    (0, 2),
    (0, 3),
    (4, 1),
    (0, 9),
    (2, 5),
]
LISTS = {n: [row << 16 | column for row, column in PLACES[:n]] for n in range(1, 13)}
# every number of places that a tile may have, and registers of filters
TILES = [(n_places, registers) for registers, sizes in SIZES.items() for n_places in sizes]
# runs or taps, the length of a run, channels
KERNELS = [
    ([40], 1, 1),
    ([40, 90, 140], 6, LANES),
    ([64, 65, 80], 3, LANES + 3),
    ([0, 17, 33, 35], 7, 2 * LANES - 1),
]


def program_of(kind: int, runs: list[int], run_length: int, channels: int) -> np.ndarray:
    """A program with the record of one step, its runs or inputs behind it, and room for a list."""
    table = runs
    if kind == P.MIX:
        distances = [run + k for run in runs for k in range(run_length)]
        table = [distance | i << 32 for i, distance in enumerate(distances)]
    end = AT + P.STEP_SIZE + len(table)
    program = np.zeros(end + len(table) + 8, np.int64)
    program[P.LISTED] = end
    program[AT + P.STEP_SIZE : end] = table
    record = program[AT : AT + P.STEP_SIZE]
    record[[P.KIND, P.RUNS, P.N_RUNS, P.RUN_LENGTH]] = kind, AT + P.STEP_SIZE, len(runs), run_length
    record[[P.IN, P.IN_DY, P.IN_DX, P.OUT, P.OUT_DY, P.OUT_DX]] = 11, 160, 16, OUT, 400, channels
    record[[P.OUT_CHANNELS, P.WEIGHTS]] = channels, 20
    return program


def weights_of(n_products: int, size: int, low: float, high: float) -> np.ndarray:
    """Random weights, biases and slopes from place 20 on, and limits behind them."""
    weights = WEIGHTS.copy()
    weights[20 + (n_products + 2) * size :][:2] = low, high
    return weights


def assert_same(name: str, program, weights, list_of_places, more, channels: int) -> None:
    """Assert that both spellings write the same bits, only where they may, and return the same.

    A second call must change nothing.

    Parameters
    ----------
    more : (maps, weights) -> the arguments behind `listed`.
    """
    places = np.array([1 << 20] * LISTED + list_of_places, np.uint32)
    may_write = set()
    for place in list_of_places:
        first = OUT + 400 * (place >> 16) + channels * (place & 0xFFFF)
        may_write |= set(range(first, first + channels))
    for value in (None, 0.0, np.inf, -np.inf):
        before = MAPS.copy()
        if value is not None:
            before[:700:3] = value
        found = []
        for run in both(name):
            maps = before.copy()
            changed = run(program, AT, places, LISTED, *more(maps, weights))
            found.append((changed, maps.tobytes()))
            assert run(program, AT, places, LISTED, *more(maps, weights)) == 0
        assert found[0] == found[1]
        if not value:
            assert changed == (1 << len(list_of_places)) - 1
        written = np.flatnonzero(maps.view(np.uint32) != before.view(np.uint32))
        assert set(written.tolist()) <= may_write


@pytest.mark.parametrize("n_places, registers", TILES)
@pytest.mark.parametrize("runs, run_length", [kernel[:2] for kernel in KERNELS])
@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (0.0, np.inf), (-0.5, 6.0)])
def test_mix_tiles(runs, run_length, n_places, registers, limits):
    n_products = len(runs) * run_length
    for channels in ((registers - 1) * LANES + 1, registers * LANES - 1, registers * LANES):
        weights = weights_of(n_products, registers * LANES, *limits)
        program = program_of(P.MIX, runs, run_length, channels)

        def more(maps, weights, channels=channels):
            inputs = (11, AT + P.STEP_SIZE, n_products)
            return n_places, maps, *inputs, OUT, weights, 20, channels

        assert_same("mix_tile", program, weights, LISTS[n_places], more, channels)


def listed(maps, runs: list[int], run_length: int, n_places: int) -> np.ndarray:
    """The inputs that both spellings list, as numbers of the table."""
    places = np.array([1 << 20] * LISTED + LISTS[n_places], np.uint32)
    found = []
    for run in both("list_inputs"):
        program = program_of(P.MIX, runs, run_length, 1)
        before = program.copy()
        n = run(program, AT, places, LISTED, n_places, maps, 11)
        first = program[P.LISTED]
        assert (program[:first] == before[:first]).all()
        found.append(program[first : first + n])
    assert (found[0] == found[1]).all()
    return found[0]


SHARES = (0.0, 0.3, 0.9, 0.99, 1.0)
"""Shares of zeros in a map."""


@pytest.mark.parametrize("n_places", sorted({n for n, _ in TILES}))
@pytest.mark.parametrize("runs, run_length", [kernel[:2] for kernel in KERNELS] + [([3, 99], 41)])
def test_inputs_that_are_0_at_every_place_are_not_listed(runs, run_length, n_places):
    distances = [run + k for run in runs for k in range(run_length)]
    starts = [11 + 160 * row + 16 * column for row, column in PLACES[:n_places]]
    rng = np.random.default_rng(3)
    for share in SHARES:
        maps = MAPS.copy()
        maps[rng.random(maps.size) < share] = 0.0
        expected = [
            distance | i << 32
            for i, distance in enumerate(distances)
            if any(maps[start + distance] != 0 for start in starts)
        ]
        assert listed(maps, runs, run_length, n_places).tolist() == expected


@pytest.mark.parametrize("value", [0.0, -0.0, 1e-45, -1e-45, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("n_places", sorted({n for n, _ in TILES}))
def test_only_0_and_negative_0_are_left_out(n_places, value):
    """A number that is not 0 at one place alone, whichever that is, is listed."""
    for row, column in PLACES[:n_places]:
        maps = np.zeros(9000, np.float32)
        maps[11 + 160 * row + 16 * column + 43] = value
        found = listed(maps, [40], 6, n_places)
        if value == 0:
            assert found.size == 0
        else:
            assert 43 | 3 << 32 in found


@pytest.mark.parametrize("n_places, registers", TILES)
@pytest.mark.parametrize("bias", [0.0, -0.0, 0.5])
def test_a_sum_without_its_zeros_is_the_sum(n_places, registers, bias):
    """The maps hold 0, -0, denormals and others. No inputs at all are the sum of zeros."""
    runs, run_length = [40, 90, 140], 6
    n_products, size = len(runs) * run_length, registers * LANES
    places = np.array([1 << 20] * LISTED + LISTS[n_places], np.uint32)
    weights = weights_of(n_products, size, -np.inf, np.inf)
    weights[20 + n_products * size :][:size] = bias
    weights[20 + (n_products + 1) * size :][:size] = 1.0  # slopes, none of which makes a -0
    rng = np.random.default_rng(4)
    for share in SHARES:
        kinds = rng.choice([0.0, -0.0, 1e-45, -1e-45], MAPS.size).astype(np.float32)
        some = np.where(rng.random(MAPS.size) < share, kinds, MAPS)
        few = np.where(rng.random(MAPS.size) < share, np.copysign(np.float32(0), kinds), some)
        for values in (some, few):
            found = set()
            for mix, list_inputs in zip(both("mix_tile"), both("list_inputs"), strict=True):
                program = program_of(P.MIX, runs, run_length, size)
                n_listed = list_inputs(program, AT, places, LISTED, n_places, values, 11)
                for inputs in ((AT + P.STEP_SIZE, n_products), (program[P.LISTED], n_listed)):
                    maps = values.copy()
                    tile = (AT, places, LISTED, n_places, maps, 11, *inputs, OUT)
                    mix(program, *tile, weights, 20, size)
                    found.add(maps.tobytes())
                    written = maps[OUT + 7 * size :][:size]  # the first place
                    assert not (np.signbit(written) & (written == 0)).any()
            assert len(found) == 1


def of_channel_tile(maps, weights):
    """The arguments of `channel_tile` behind `listed`."""
    return maps, weights


@pytest.mark.parametrize("kind", [P.SUM, P.MAXIMUM])
@pytest.mark.parametrize("runs, run_length, channels", KERNELS)
def test_channel_tiles(kind, runs, run_length, channels):
    size = -(-channels // LANES) * LANES
    weights = weights_of(len(runs) if kind == P.SUM else 0, size, -0.4, 0.9)
    program = program_of(kind, runs, run_length, channels)
    for place in LISTS[12]:
        assert_same("channel_tile", program, weights, [place], of_channel_tile, channels)


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("channels", [1, LANES + 3])
def test_function_tiles(function, channels):
    program = program_of(P.FUNCTION, [40], 1, channels)
    program[AT + P.APPLIED] = list(FUNCTIONS).index(function)
    weights = weights_of(0, -(-channels // LANES) * LANES, -np.inf, 0.8)
    assert_same("channel_tile", program, weights, [7], of_channel_tile, channels)


EXACT = {
    "log1p": np.log1p,
    "sigmoid": lambda x: 1 / (1 + np.exp(-x)),
    "tanh": np.tanh,
    "silu": lambda x: x / (1 + np.exp(-x)),
    "gelu": lambda x: x * np.vectorize(math.erfc)(-x / np.sqrt(2)) / 2,
    "gelu_tanh": lambda x: x * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3))) / 2,
    "hardswish": lambda x: x * np.clip(x + 3, 0, 6) / 6,
    "erf": np.vectorize(math.erf),
    "inverse_sqrt": lambda x: 1 / np.sqrt(x),
}
"""Name of a function -> the function in float64."""


@pytest.mark.parametrize("function", FUNCTIONS)
def test_functions_are_those_of_mathematics(function):
    """They are equal to a few units in the last place of float32, also at the ends of its range.

    GELU, where it is small, is a small difference of larger numbers: it is compared as a share of
    x, to 1e-6.
    """
    apply = njit(lambda which, x: apply_function(which, x))
    which = list(FUNCTIONS).index(function)
    exact = EXACT[function]
    rng = np.random.default_rng(0)
    for values in (
        rng.normal(size=2_000),
        10 * rng.normal(size=2_000),
        10.0 ** rng.uniform(-20, 20, 2_000),
    ):
        x = np.float32(np.abs(values) if function in ("log1p", "inverse_sqrt") else values)
        found = np.array([apply(which, v) for v in x])
        expected = exact(x.astype(np.float64))
        if function.startswith("gelu"):
            size = np.abs(x)
            np.testing.assert_allclose(found / size, expected / size, rtol=1e-6, atol=1e-6)
        elif function == "erf":
            np.testing.assert_allclose(found, expected, rtol=8e-7, atol=1e-37)
        else:
            np.testing.assert_allclose(found, expected, rtol=4e-7, atol=1e-37)

    if function == "inverse_sqrt":
        assert np.isnan(apply(which, np.float32(-0.75)))
        assert apply(which, np.float32(0.0)) == np.inf
    else:
        expected = exact(np.array([-0.75, 0.0]))
        assert apply(which, np.float32(-0.75)) == pytest.approx(expected[0], rel=1e-6)
        assert apply(which, np.float32(0.0)) == expected[1]
    at_infinity = {"sigmoid": 1, "tanh": 1, "erf": 1, "inverse_sqrt": 0}
    assert apply(which, np.float32(np.inf)) == at_infinity.get(function, np.inf)
    assert np.isnan(apply(which, np.float32(np.nan)))


def test_nan_stays_nan():
    """It stays nan as in torch, in a maximum and through limits, too."""
    maps = np.full(9000, np.nan, np.float32)
    maps[11 + 40] = 1.0
    for kind in (P.SUM, P.MAXIMUM):
        program = program_of(kind, [40, 41, 42], 1, 1)
        for run in both("channel_tile"):
            out = maps.copy()
            run(program, AT, np.zeros(9, np.uint32), LISTED, out, weights_of(3, LANES, 0.0, 6.0))
            assert np.isnan(out[OUT])


def test_every_vectorized_kernel_is_tested_here():
    tested = {"list_inputs", "mix_tile", "channel_tile", "round_eight", "add_f64x2"}
    # test_spiking_spellings.py has the others
    assert set(SPELLINGS) - {"add_product", "charge"} == tested
    assert LANES in (8, 16)
    assert len(MOST_PLACES) == REGISTERS == max(SIZES)


def test_add_f64x2():
    weights = numbers(1500, 6, np.float64).reshape(-1, 3)
    expected = np.zeros(10)
    for i, (first, second, factor) in enumerate(weights):
        expected[i % 9 : i % 9 + 2] += first * factor, second * factor
    for run in both("add_f64x2"):
        cells = np.zeros(10)
        for i, (first, second, factor) in enumerate(weights.tolist()):
            run(cells, np.uint64(i % 9), first, second, factor)
        assert cells.tobytes() == expected.tobytes()
        assert cells.all()


@pytest.mark.parametrize(
    "same", [[], range(8), [0, 3, 6, 7]], ids=["none_known", "all_known", "some_known"]
)
def test_round_eight(same):
    buffer = numbers(40, 10, np.float64)
    buffer[7] = 0
    values = buffer[3:11].astype(np.float32)
    maps = MAPS[:50].copy()
    at = 5
    for k in same:
        maps[at + k] = values[k]
    expected = np.concatenate([maps[:at], values, maps[at + 8 :]])
    for run in both("round_eight"):
        found = maps.copy()
        assert run(buffer, 3, found, at) == sum(1 << k for k in range(8) if k not in same)
        assert found.tobytes() == expected.tobytes()


def test_round_eight_writes_no_negative_zero():
    """A cell that has cancelled is 0 or -0: it has not changed, whichever it was."""
    for run in both("round_eight"):
        for value in (0.0, -0.0, -1e-60):
            maps = np.zeros(40, np.float32)
            assert run(np.full(40, value), 2, maps, 0) == 0
            assert maps.tobytes() == bytes(160)
