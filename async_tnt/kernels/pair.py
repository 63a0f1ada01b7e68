"""Two neighbouring float64 numbers as one vector register.

Numba does not merge neighbouring scalar operations into vector ones, so `splat.add_event` says it here: half
the loads, additions and stores, with the same rounding in each lane.
"""

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from .jit import inlined


@inlined
def _add_pair_checked(cells, index, first, second, weight):
    """`add_pair` in plain words, for NUMBA_BOUNDSCHECK=1: there Numba can test the indices."""
    cells[index] += first * weight
    cells[index + np.uint64(1)] += second * weight


@intrinsic
def _add_pair_vectorized(typingctx, cells, index, first, second, weight):
    """cells[index] += first * weight; cells[index + 1] += second * weight. The index is not checked.

    cells : float64, flat, contiguous. index : uint64. first, second, weight : float64.
    """

    def codegen(context, builder, signature, args):
        pair = ir.VectorType(ir.DoubleType(), 2)
        place = [ir.Constant(ir.IntType(32), k) for k in range(2)]

        def of(first, second):
            empty = ir.Constant(pair, ir.Undefined)
            return builder.insert_element(builder.insert_element(empty, first, place[0]), second, place[1])

        array = context.make_array(signature.args[0])(context, builder, args[0])
        pointer = builder.bitcast(builder.gep(array.data, [args[1]]), pair.as_pointer())
        old = builder.load(pointer)
        old.align = 8
        share = builder.fmul(of(args[2], args[3]), of(args[4], args[4]))
        stored = builder.store(builder.fadd(old, share), pointer)
        stored.align = 8
        return context.get_dummy_value()

    return types.void(cells, index, first, second, weight), codegen


add_pair = _add_pair_checked if getattr(config, "BOUNDSCHECK", None) else _add_pair_vectorized
