"""A plain 3x3 convolution at batch size one, for the landmark network, which is computed whole at each read.

Feature maps are stored with a frame of zeros, as one long row: a 3x3 convolution is then nine shifted reads of that
row, without borders, in vector registers. Its values at the frame's places are never read. Sums run input channel by
input channel, tap by tap, each product added with one rounding.

The sums of 8 filters at two registers of neighbouring places stay in registers: each weight is read once for all
places, each input once for 8 filters. LLVM would read and write the outputs for each input channel.
"""

from .jit import compiled, inlined
from .simd import LANES, fma, vectorized, whole

FILTERS = 8
PLACES = 2 * LANES
TAPS = 9


@inlined
def conv_rows_plain(framed, plane, row, n_channels, start, weights, bias, block, out, out_plane):
    """out[f, i] = bias[f] + sum_c,tap w[c, tap, f] in[c, i + tap // 3 * row + tap % 3]

    for 8 filters f of a block and PLACES places i from `start` on; all arrays flat.

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


@vectorized(conv_rows_plain)
def conv_rows(simd, framed, plane, row, n_channels, start, weights, bias, block, out, out_plane):
    halves = [whole(0), whole(LANES)]
    filters = [simd.add(simd.mul(block, FILTERS), f) for f in range(FILTERS)]

    def add_channel(c, sums):
        weight = simd.mul(simd.add(simd.mul(block, n_channels), c), TAPS * FILTERS)
        first = simd.add(start, simd.mul(c, plane))
        for tap in range(TAPS):
            place = simd.add(first, simd.mul(row, tap // 3), tap % 3)
            inputs = [simd.load(framed, simd.add(place, half)) for half in halves]
            totals, sums = iter(sums), []
            for f in range(FILTERS):
                w = simd.spread(simd.at(weights, simd.add(weight, tap * FILTERS + f)))
                sums += [simd.fma(w, value, next(totals)) for value in inputs]
        return sums

    biases = [simd.spread(simd.at(bias, f)) for f in filters for _ in halves]
    sums = iter(simd.loop(n_channels, biases, add_channel))
    for f in filters:
        for half in halves:
            simd.store(next(sums), out, simd.add(simd.mul(f, out_plane), start, half))


@compiled
def frame(volume, framed):
    """Copy a volume (C, H, W) into framed maps, shape (C, at least (H + 2) * (W + 2)), whose frame stays zero."""
    channels, height, width = volume.shape
    for c in range(channels):
        for y in range(height):
            source = volume[c, y]
            target = framed[c, (y + 1) * (width + 2) + 1 :]
            for x in range(width):
                target[x] = source[x]


@compiled
def convolve(framed, weights, bias, width, out):
    """3x3 convolution with zero padding.

        out[f, y, x] = bias[f] + sum_c,i,j w[f, c, i, j] in[c, y + i - 1, x + j - 1]

    Parameters
    ----------
    framed : float32, shape (C, framed places). Framed input maps.
    weights : float32, shape (blocks, C, 9, 8): eight filters a block, the last padded with zeros.
    bias : float32, shape (blocks, 8).
    width : int. W.
    out : float32, shape (8 * blocks, a multiple of PLACES >= H * (W + 2)). Overwritten; places W and W + 1 of each
        row, and those beyond the last row, are garbage.
    """
    n_blocks, n_channels = weights.shape[:2]
    flat_framed, flat_weights = framed.reshape(framed.size), weights.reshape(weights.size)
    flat_bias, flat_out = bias.reshape(bias.size), out.reshape(out.size)
    plane, out_plane = framed.shape[1], out.shape[1]
    for block in range(n_blocks):
        for start in range(0, out_plane, PLACES):
            conv_rows(
                flat_framed, plane, width + 2, n_channels, start, flat_weights, flat_bias, block, flat_out, out_plane
            )
