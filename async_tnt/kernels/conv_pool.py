"""The innermost step of the classifier's convolutions: a tile of a few neighbouring pooled cells, in registers.

    pooled[Y, X, f] = mean over the 2x2 places (2Y + r, 2X + q) of ReLU(conv[.., f])
    conv[y, x, f] = bias[f] + sum over taps (i, j) and channels c of w[i, j, c, f] in[y + i, x + j, c]

A register holds filters of one place, so a tile may be as small as one or two pooled cells: an event touches few
places, and little more than those should be computed. Each weight is read once for all places of a tile, each
input once for all its filters. How a map is cut into tiles changes no bit (see `simd`).

The first convolution sums channel by channel and leaves out those in which a tile sees only zeros: many bins of an
event volume are empty here or there, and adding a zero changes nothing. The second sums tap by tap.
"""

import numpy as np
from llvmlite import ir
from numba import types

from .jit import inlined
from .simd import INDEX, LANES, VECTOR, ZERO, fma, vectorized, whole

CELLS_1, FILTERS_1 = 3, LANES  # a tile of the first convolution: pooled cells side by side, filters
CELLS_2, FILTERS_2 = (2 if LANES == 16 else 1), 2 * LANES  # of the second
SEEN_1 = 2 * CELLS_1 + 2  # pixels side by side that a tile of the first sees
QUARTER = np.float32(0.25)


@inlined
def conv_pool_1_plain(inputs, first, row, pitch, active, n_active, weights, first_weight, first_bias, out, first_out):
    """One tile of the first convolution; input (y, x, c) lies at first + y row + c pitch + x.

    Parameters
    ----------
    inputs : float32. `first` is the index of pixel (2Y, 2X) of the framed maps: one up and left of the tile.
    active : int64. Its first `n_active` >= 1 numbers are the channels to sum.
    weights : float32; (C, 9, FILTERS_1) from `first_weight` on, the biases from `first_bias` on.
    out : float32; (CELLS_1, FILTERS_1) from `first_out` on. Updated in place.
    """
    for cell in range(CELLS_1):
        for f in range(FILTERS_1):
            pooled = np.float32(0)
            for r in range(2):
                for x in range(2 * cell, 2 * cell + 2):
                    total = weights[first_bias + f]
                    for k in range(n_active):
                        for tap in range(9):
                            place = (r + tap // 3) * row + active[k] * pitch + x + tap % 3
                            w = weights[first_weight + (9 * active[k] + tap) * FILTERS_1 + f]
                            total = fma(w, inputs[first + place], total)
                    pooled += np.float32(0) if total < 0 else total
            out[first_out + cell * FILTERS_1 + f] = pooled * QUARTER


@vectorized(conv_pool_1_plain)
def conv_pool_1(simd, inputs, first, row, pitch, active, n_active, weights, first_weight, first_bias, out, first_out):
    tile = _Tile(simd, CELLS_1, FILTERS_1, weights)
    starts = [simd.add(first, simd.mul(row, r)) for r in range(4)]

    def add_channel(k, sums):
        c = simd.builder.load(simd.at(active, k))
        weight = simd.add(first_weight, simd.mul(c, 9 * FILTERS_1))
        rows = [simd.at(inputs, simd.add(start, simd.mul(c, pitch))) for start in starts]
        for i, j in np.ndindex(3, 3):
            pixels = {(r, x): simd.at(rows[r + i], whole(x + j)) for r, x in tile.places}
            sums = tile.add_products(sums, simd.add(weight, (3 * i + j) * FILTERS_1), pixels)
        return sums

    tile.pool(simd.loop(n_active, tile.load(first_bias) * len(tile.places), add_channel), out, first_out)


@inlined
def conv_pool_2_plain(inputs, first, row, pitch, n_channels, weights, first_weight, first_bias, out, first_out):
    """One tile of the second convolution; input (y, x, c) lies at first + y row + x pitch + c.

    As `conv_pool_1_plain`, with weights (9, C, FILTERS_2) and all channels.
    """
    for cell in range(CELLS_2):
        for f in range(FILTERS_2):
            pooled = np.float32(0)
            for r in range(2):
                for x in range(2 * cell, 2 * cell + 2):
                    total = weights[first_bias + f]
                    for tap in range(9):
                        for c in range(n_channels):
                            place = (r + tap // 3) * row + (x + tap % 3) * pitch + c
                            w = weights[first_weight + (tap * n_channels + c) * FILTERS_2 + f]
                            total = fma(w, inputs[first + place], total)
                    pooled += np.float32(0) if total < 0 else total
            out[first_out + cell * FILTERS_2 + f] = pooled * QUARTER


@vectorized(conv_pool_2_plain)
def conv_pool_2(simd, inputs, first, row, pitch, n_channels, weights, first_weight, first_bias, out, first_out):
    tile = _Tile(simd, CELLS_2, FILTERS_2, weights)
    starts = [simd.add(first, simd.mul(row, r)) for r in range(4)]
    sums = tile.load(first_bias) * len(tile.places)
    for i, j in np.ndindex(3, 3):
        weight = simd.add(first_weight, simd.mul(n_channels, (3 * i + j) * FILTERS_2))
        columns = [simd.mul(pitch, x + j) for x in range(2 * CELLS_2)]
        pixels = {(r, x): simd.at(inputs, simd.add(starts[r + i], columns[x])) for r, x in tile.places}

        def add_channel(c, sums, weight=weight, pixels=pixels):
            at = simd.add(weight, simd.mul(c, FILTERS_2))
            return tile.add_products(sums, at, {place: simd.at(pixel, c) for place, pixel in pixels.items()})

        sums = simd.loop(n_channels, sums, add_channel)
    tile.pool(sums, out, first_out)


class _Tile:
    """The sums of a tile, each place's filters in registers: a list in the order of places, then of filters."""

    def __init__(self, simd, n_cells, n_filters, weights):
        self.places = [(r, x) for r in range(2) for x in range(2 * n_cells)]
        self._simd, self._weights = simd, weights
        self._n_cells, self._n_filters, self._lanes = n_cells, n_filters, range(0, n_filters, LANES)

    def load(self, at):
        """Weights, or biases, of all filters."""
        return [self._simd.load(self._weights, self._simd.add(at, f)) for f in self._lanes]

    def add_products(self, sums, at, pixels):
        """Add one tap of one channel at every place. Its weights start at `at`; `pixels` maps a place to its input."""
        weights, totals, new = self.load(at), iter(sums), []
        for place in self.places:
            value = self._simd.spread(pixels[place])
            new += [self._simd.fma(w, value, next(totals)) for w in weights]
        return new

    def pool(self, sums, out, first_out):
        """ReLU and the mean of 2x2 places."""
        simd, builder = self._simd, self._simd.builder
        total = dict(zip([(*place, f) for place in self.places for f in self._lanes], sums, strict=True))
        for cell in range(self._n_cells):
            for f in self._lanes:
                pooled = ZERO
                for r, q in np.ndindex(2, 2):
                    pooled = builder.fadd(pooled, simd.relu(total[r, 2 * cell + q, f]))
                mean = builder.fmul(pooled, ir.Constant(VECTOR, [float(QUARTER)] * LANES))
                simd.store(mean, out, simd.add(first_out, cell * self._n_filters + f))


@inlined
def any_input_1_plain(inputs, first, row):
    """1 if a tile of the first convolution sees any number of a channel that is not zero, else 0.

    inputs, first, row : its 4 x SEEN_1 pixels, from `first` on, rows `row` apart. -0 is zero, nan is not.
    """
    for r in range(4):
        for x in range(SEEN_1):
            if inputs[first + r * row + x] != 0:
                return 1
    return 0


@vectorized(any_input_1_plain, returns=types.int64)
def any_input_1(simd, inputs, first, row):
    builder, words = simd.builder, ir.VectorType(ir.IntType(32), SEEN_1)
    found = ir.Constant(words, None)
    for r in range(4):
        found = builder.or_(found, simd.load(inputs, simd.add(first, simd.mul(row, r)), words))
    found = builder.shl(found, ir.Constant(words, [1] * SEEN_1))  # without the sign
    flags = builder.bitcast(builder.icmp_unsigned("!=", found, ir.Constant(words, None)), ir.IntType(SEEN_1))
    return builder.zext(builder.icmp_unsigned("!=", flags, ir.Constant(flags.type, 0)), INDEX)
