"""The innermost step of a convolution: 8 filters at 32 neighbouring places, in registers.

LLVM does not find this blocking by itself: it would read and write the outputs for each input channel. Here
the 8 x 32 sums stay in sixteen 512-bit registers (or pairs of smaller ones, where a machine has no such), each
weight is read once for 32 places and each input once for 8 filters. The order of the additions is that of the
plain spelling below, and each is rounded once, so both give the same bits.
"""

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

from .fma import fma
from .jit import inlined

FILTERS = 8
LANES = 16
PLACES = 2 * LANES
TAPS = 9


@inlined
def _convolve_strip_checked(framed, plane, row, n_channels, start, weights, bias, block, out, out_plane):
    """out[f, i] = bias[f] + sum_c,tap w[c, tap, f] in[c, i + tap // 3 * row + tap % 3]

    for 8 filters f of a block and 32 places i from `start` on; all arrays flat.

    Parameters
    ----------
    framed : float32. Input maps, `plane` numbers each, `row` of them in a row.
    weights : float32, (blocks, n_channels, 9, 8). bias : float32, (blocks, 8).
    out : float32, (blocks, 8, out_plane). Updated in place.
    """
    for f in range(FILTERS):
        for i in range(start, start + PLACES):
            total = bias[block * FILTERS + f]
            for c in range(n_channels):
                for tap in range(TAPS):
                    w = weights[((block * n_channels + c) * TAPS + tap) * FILTERS + f]
                    total = fma(w, framed[c * plane + i + tap // 3 * row + tap % 3], total)
            out[(block * FILTERS + f) * out_plane + i] = total


@intrinsic
def _convolve_strip_in_registers(
    typingctx, framed, plane, row, n_channels, start, weights, bias, block, out, out_plane
):
    """`_convolve_strip_checked`, with the sums in registers. Indices are not checked."""

    def codegen(context, builder, signature, args):
        lanes = ir.VectorType(ir.FloatType(), LANES)
        arrays = {k: context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 5, 6, 8)}
        plane, row, n_channels, start, block, out_plane = (args[k] for k in (1, 2, 3, 4, 7, 9))
        integer = start.type
        vector_fma = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(lanes, [lanes] * 3), f"llvm.fma.v{LANES}f32"
        )

        def whole(value):
            return ir.Constant(integer, value)

        def spread(scalar):
            first = builder.insert_element(ir.Constant(lanes, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
            mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            return builder.shuffle_vector(first, ir.Constant(lanes, ir.Undefined), mask)

        def lanes_at(array, index):
            return builder.bitcast(builder.gep(arrays[array], [index]), lanes.as_pointer())

        sums = [[cgutils.alloca_once(builder, lanes) for _ in range(2)] for _ in range(FILTERS)]
        first_filter = builder.mul(block, whole(FILTERS))
        for f in range(FILTERS):
            value = spread(builder.load(builder.gep(arrays[6], [builder.add(first_filter, whole(f))])))
            for half in range(2):
                builder.store(value, sums[f][half])
        with cgutils.for_range(builder, n_channels, intp=integer) as loop:
            base = builder.add(start, builder.mul(loop.index, plane))
            weight = builder.add(builder.mul(block, n_channels), loop.index)
            weight = builder.mul(weight, whole(TAPS * FILTERS))
            for tap in range(TAPS):
                place = builder.add(base, builder.add(builder.mul(row, whole(tap // 3)), whole(tap % 3)))
                inputs = []
                for half in range(2):
                    value = builder.load(lanes_at(0, builder.add(place, whole(half * LANES))))
                    value.align = 4
                    inputs.append(value)
                for f in range(FILTERS):
                    index = builder.add(weight, whole(tap * FILTERS + f))
                    w = spread(builder.load(builder.gep(arrays[5], [index])))
                    for half in range(2):
                        total = builder.call(vector_fma, [w, inputs[half], builder.load(sums[f][half])])
                        builder.store(total, sums[f][half])
        for f in range(FILTERS):
            target = builder.add(builder.mul(builder.add(first_filter, whole(f)), out_plane), start)
            for half in range(2):
                place = lanes_at(8, builder.add(target, whole(half * LANES)))
                builder.store(builder.load(sums[f][half]), place).align = 4
        return context.get_dummy_value()

    arguments = (framed, plane, row, n_channels, start, weights, bias, block, out, out_plane)
    if any(argument != types.int64 for argument in (plane, row, n_channels, start, block, out_plane)):
        return None
    return types.void(*arguments), codegen


# NUMBA_BOUNDSCHECK=1 takes the plain spelling, whose indices Numba can test.
convolve_strip = _convolve_strip_checked if getattr(config, "BOUNDSCHECK", None) else _convolve_strip_in_registers
