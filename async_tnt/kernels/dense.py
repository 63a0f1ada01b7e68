"""The innermost step of the dense layer: what one pooled cell adds to all hidden units, in registers.

partial[j] = sum over filters f of in[f] w[f, j]        UNITS units j, in the order of f
"""

import numpy as np
from numba import config, types
from numba.extending import intrinsic

from .fma import fma
from .jit import inlined
from .registers import LANES, ZERO, Registers, only_int64, whole

UNITS = 64


@inlined
def _weigh_checked(inputs, first, n_inputs, weights, first_weight, out, first_out):
    """Arrays float32 and flat; weights (n_inputs, UNITS) from `first_weight` on; `out` is updated in place."""
    for j in range(UNITS):
        total = np.float32(0)
        for f in range(n_inputs):
            total = fma(inputs[first + f], weights[first_weight + f * UNITS + j], total)
        out[first_out + j] = total


@intrinsic
def _weigh_in_registers(typingctx, inputs, first, n_inputs, weights, first_weight, out, first_out):
    """`_weigh_checked`, with the sums in registers. Indices are not checked."""

    def codegen(context, builder, signature, args):
        registers = Registers(context, builder, signature, args)
        _, first, n_inputs, _, first_weight, _, first_out = args
        lanes = range(0, UNITS, LANES)

        def add_input(f, sums):
            value = registers.spread(registers.pointer(0, builder.add(first, f)))
            at = builder.add(first_weight, builder.mul(f, whole(UNITS)))
            ws = (registers.load(3, builder.add(at, whole(j))) for j in lanes)
            return [registers.fma(value, w, total) for w, total in zip(ws, sums, strict=True)]

        sums = registers.loop(n_inputs, [ZERO] * len(lanes), add_input)
        for j, total in zip(lanes, sums, strict=True):
            registers.store(total, 5, builder.add(first_out, whole(j)))
        return context.get_dummy_value()

    if not only_int64(first, n_inputs, first_weight, first_out):
        return None
    return types.void(inputs, first, n_inputs, weights, first_weight, out, first_out), codegen


weigh = _weigh_checked if getattr(config, "BOUNDSCHECK", None) else _weigh_in_registers
