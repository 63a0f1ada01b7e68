"""The two innermost loops of spiking networks, in vector registers.

The numbers of a place lie in blocks of BLOCK, the last of which is filled up: what fills it has no
weights and never fires. Each number is computed with the same operations as in the plain loops.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from async_tnt.kernels.jit import inlined
from async_tnt.kernels.simd import Simd, vectorized, whole

BLOCK = 8
"""How many numbers a vector holds."""

DOUBLES = ir.VectorType(ir.DoubleType(), BLOCK)
FLOATS = ir.VectorType(ir.FloatType(), BLOCK)


@inlined
def add_product_plain(state, first, value, weights, first_weight, n_blocks):
    """Add a number times float32 weights to some float64 numbers of the state.

    Parameters
    ----------
    state, weights : float64 and float32.
    first, first_weight : int. Where the numbers and the weights begin.
    value : float64.
    n_blocks : int. The numbers are BLOCK times as many.
    """
    for k in range(BLOCK * n_blocks):
        state[first + k] += value * np.float64(weights[first_weight + k])


@vectorized(add_product_plain)
def add_product(simd, state, first, value, weights, first_weight, n_blocks):
    builder = simd.builder
    values = simd.spread(value, BLOCK)

    def add_block(k: ir.Value, sums: list) -> list:
        offset = simd.mul(k, BLOCK)
        weight = builder.fpext(simd.load(weights, simd.add(first_weight, offset), FLOATS), DOUBLES)
        place = simd.add(first, offset)
        total = builder.fadd(simd.load(state, place, DOUBLES), builder.fmul(values, weight))
        simd.store(total, state, place)
        return []

    simd.loop(n_blocks, [], add_block)


@inlined
def charge_plain(state, params, membranes, sums, gains, thresholds):
    """Add the sums of one block of neurons to their membranes, and empty the sums.

    Parameters
    ----------
    state, params : float64.
    membranes, sums : int. Where the block's numbers begin in the state.
    gains, thresholds : int. Where they begin in the params.

    Returns
    -------
    int : bit k is set if the membrane of neuron k is above its threshold.
    """
    above = 0
    for k in range(BLOCK):
        membrane = state[membranes + k] + params[gains + k] * state[sums + k]
        state[membranes + k] = membrane
        state[sums + k] = 0.0
        if membrane > params[thresholds + k]:
            above |= 1 << k
    return above


@vectorized(charge_plain, returns=types.int64)
def charge(simd: Simd, state, params, membranes, sums, gains, thresholds):
    builder = simd.builder
    arrived = builder.fmul(simd.load(params, gains, DOUBLES), simd.load(state, sums, DOUBLES))
    membrane = builder.fadd(simd.load(state, membranes, DOUBLES), arrived)
    simd.store(membrane, state, membranes)
    simd.store(ir.Constant(DOUBLES, None), state, sums)
    is_above = builder.fcmp_ordered(">", membrane, simd.load(params, thresholds, DOUBLES))
    return builder.zext(builder.bitcast(is_above, ir.IntType(BLOCK)), whole(0).type)
