"""The loops of spiking networks in vector registers write the bits of their plain loops."""

from functools import cache

import numpy as np
import pytest
from numba import njit

import async_tnt.kernels.spiking.absorb  # noqa: F401 (which registers the kernels)
from async_tnt.kernels.simd import SPELLINGS
from async_tnt.kernels.spiking.vectors import BLOCK

NUMBERS = [0.0, -0.0, 1.0, -1.5, 0.1, 5e-324, 1e300, -1e300, np.inf, -np.inf, np.nan]


@cache
def both(name):
    """The plain loops and the instructions of a kernel, to be called from Python."""
    plain, vector = SPELLINGS[name]
    return njit(plain.py_func, error_model="numpy"), njit(lambda *arguments: vector(*arguments))


def mixed(n, seed, dtype=np.float64):
    """Normally distributed numbers, and some that are special."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=n)
    special = rng.random(n) < 0.2
    values[special] = rng.choice(NUMBERS, special.sum())
    with np.errstate(over="ignore"):
        return values.astype(dtype)


@pytest.mark.parametrize("n_blocks", [0, 1, 2, 7])
@pytest.mark.parametrize("value", NUMBERS)
def test_products_are_added(n_blocks, value):
    weights = mixed(100, 1, np.float32)
    found = []
    for run in both("add_product"):
        state = mixed(100, 2)
        run(state, 13, value, weights, 21, n_blocks)
        found.append(state.tobytes())
    assert found[0] == found[1]
    n = BLOCK * n_blocks
    expected = mixed(100, 2)
    with np.errstate(invalid="ignore", over="ignore"):
        expected[13 : 13 + n] += value * weights[21 : 21 + n].astype(np.float64)
    np.testing.assert_array_equal(np.frombuffer(found[0]), expected)


@pytest.mark.parametrize("seed", range(50))
def test_a_block_of_neurons_is_charged(seed):
    params = mixed(60, seed)
    found = []
    for run in both("charge"):
        state = mixed(60, 100 + seed)
        above = run(state, params, 11, 31, 3, 41)
        found.append((above, state.tobytes()))
    assert found[0] == found[1]
    state = mixed(60, 100 + seed)
    with np.errstate(invalid="ignore", over="ignore"):
        membranes = state[11:19] + params[3:11] * state[31:39]
    is_above = membranes > params[41:49]
    assert found[0][0] == sum(1 << k for k in np.flatnonzero(is_above).tolist())
    state[11:19] = membranes
    state[31:39] = 0.0
    np.testing.assert_array_equal(np.frombuffer(found[0][1]), state)
