"""Eight neighbouring cells of a volume, rounded and compared with what was known of them, in registers.

    value = cells[b, y, x, 0] + cells[b - 1, y, x, 1], rounded to float32

The shares to bin b and to bin b + 1 lie side by side (see `state`), so that every other number is wanted, and
differences go into another map than values: LLVM does find vector code for that, three times slower than this.
"""

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from .jit import inlined

CELLS = 8


@inlined
def round_cells_checked(buffer, early, late, n, maps, at, marks):
    """The plain spelling, for any number of cells.

    Parameters
    ----------
    buffer : float64, a volume's `state`.
    early, late : int. Where the share of bin b, and that of bin b - 1, of the first cell lie; `late` is `early` for
        the first bin, to which nothing comes from before.
    maps : float32. Values from `at` on are updated in place; marks from `marks` on become 1 where they differed.
    """
    for x in range(n):
        late_share = 0.0 if late == early else buffer[late + 2 * x]
        value = np.float32(buffer[early + 2 * x] + late_share)
        if maps[at + x] != value:
            maps[marks + x] = 1
        maps[at + x] = value


@inlined
def _round_eight_checked(buffer, early, late, maps, at, marks):
    round_cells_checked(buffer, early, late, CELLS, maps, at, marks)


@intrinsic
def _round_eight_in_registers(typingctx, buffer, early, late, maps, at, marks):
    """`round_cells_checked` for eight cells. Indices are not checked."""

    def codegen(context, builder, signature, args):
        singles, doubles = ir.VectorType(ir.FloatType(), CELLS), ir.VectorType(ir.DoubleType(), CELLS)
        pairs = ir.VectorType(ir.DoubleType(), 2 * CELLS)
        arrays = {k: context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 3)}
        _, early, late, _, at, marks = args

        def pointer(array, index, kind):
            return builder.bitcast(builder.gep(arrays[array], [index]), kind.as_pointer())

        def every_other(index):
            loaded = builder.load(pointer(0, index, pairs))
            loaded.align = 8
            mask = ir.Constant(ir.VectorType(ir.IntType(32), CELLS), list(range(0, 2 * CELLS, 2)))
            return builder.shuffle_vector(loaded, ir.Constant(pairs, ir.Undefined), mask)

        def load(index):
            value = builder.load(pointer(3, index, singles))
            value.align = 4
            return value

        # as a select and not a branch: what is read at `early` in vain is in the cache already
        is_first = builder.icmp_signed("==", late, early)
        late_shares = builder.select(is_first, ir.Constant(doubles, [0.0] * CELLS), every_other(late))
        value = builder.fptrunc(builder.fadd(every_other(early), late_shares), singles)
        differs = builder.fcmp_unordered("!=", load(at), value)
        mark = builder.select(differs, ir.Constant(singles, [1.0] * CELLS), load(marks))
        builder.store(value, pointer(3, at, singles)).align = 4
        builder.store(mark, pointer(3, marks, singles)).align = 4
        return context.get_dummy_value()

    if any(index != types.int64 for index in (early, late, at, marks)):
        return None
    return types.void(buffer, early, late, maps, at, marks), codegen


round_eight = _round_eight_checked if getattr(config, "BOUNDSCHECK", None) else _round_eight_in_registers
