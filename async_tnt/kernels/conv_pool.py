"""The innermost step of the classifier: a few neighbouring pooled outputs of a convolution, in registers.

    pooled[Y, X, f] = mean over the 2x2 places (2Y + r, 2X + q) of ReLU(conv[.., f])
    conv[y, x, f] = bias[f] + sum over taps (i, j) and channels c of w[i, j, c, f] in[y + i, x + j, c]

A register holds filters of one place, so that a tile may be as small as a pooled cell or two: an event touches
few places, and what is computed anew should be little more than those. Each weight is read once for all places
of a tile, each input once for all its filters. How a map is cut into tiles changes no bit, see `registers`.

The first convolution sums channel by channel, and leaves out those in which a tile sees only zeros: of an event
volume's bins many are empty here or there, and adding a zero changes nothing. The second sums tap by tap.
"""

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from .fma import fma
from .jit import inlined
from .registers import LANES, ZERO, Registers, constant, only_int64, whole

CELLS_1, FILTERS_1 = 3, LANES  # a tile of the first convolution: pooled cells side by side, filters
CELLS_2, FILTERS_2 = (2 if LANES == 16 else 1), 2 * LANES  # of the second
SEEN_1 = 2 * CELLS_1 + 2  # pixels side by side that a tile of the first sees
QUARTER = np.float32(0.25)


# -- the plain spelling: for NUMBA_BOUNDSCHECK=1, where Numba can test the indices ---------------------------


@inlined
def _tile_1_checked(inputs, first, row, pitch, active, n_active, weights, first_weight, first_bias, out, first_out):
    """One tile of the first convolution; input (y, x, c) lies at first + y row + c pitch + x.

    Parameters
    ----------
    inputs : float32. `first` is the place of pixel (2Y, 2X) of the framed maps: one up and left of the tile.
    active : int64. Its first `n_active` >= 1 numbers are the channels to be summed.
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


@inlined
def _tile_2_checked(inputs, first, row, pitch, n_channels, weights, first_weight, first_bias, out, first_out):
    """One tile of the second convolution; input (y, x, c) lies at first + y row + x pitch + c.

    As `_tile_1_checked`, with weights (9, C, FILTERS_2) and all channels.
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


@inlined
def _occupied_checked(inputs, first, row):
    """1 if any of the 4 x SEEN_1 numbers from `first` on, rows `row` apart, is not zero; else 0."""
    for r in range(4):
        for x in range(SEEN_1):
            if inputs[first + r * row + x] != 0:
                return 1
    return 0


# -- the same in registers; indices are not checked ----------------------------------------------------------


@intrinsic
def _tile_1_in_registers(
    typingctx, inputs, first, row, pitch, active, n_active, weights, first_weight, first_bias, out, first_out
):
    def codegen(context, builder, signature, args):
        _, first, row, pitch, _, n_active, _, first_weight, first_bias, _, first_out = args
        tile = _Tile(Registers(context, builder, signature, args), CELLS_1, FILTERS_1, 6)
        starts = [builder.add(first, builder.mul(row, whole(r))) for r in range(4)]

        def add_channel(k, sums):
            c = builder.load(tile.registers.pointer(4, k))
            weight = builder.add(first_weight, builder.mul(c, whole(9 * FILTERS_1)))
            rows = [tile.registers.pointer(0, builder.add(start, builder.mul(c, pitch))) for start in starts]
            for i, j in np.ndindex(3, 3):
                at = builder.add(weight, whole((3 * i + j) * FILTERS_1))
                pointers = {(r, x): builder.gep(rows[r + i], [whole(x + j)]) for r, x in tile.places}
                sums = tile.add_products(sums, at, pointers)
            return sums

        tile.pool(tile.registers.loop(n_active, tile.biases(first_bias), add_channel), 9, first_out)
        return context.get_dummy_value()

    if not only_int64(first, row, pitch, n_active, first_weight, first_bias, first_out):
        return None
    arguments = (inputs, first, row, pitch, active, n_active, weights, first_weight, first_bias, out, first_out)
    return types.void(*arguments), codegen


@intrinsic
def _tile_2_in_registers(
    typingctx, inputs, first, row, pitch, n_channels, weights, first_weight, first_bias, out, first_out
):
    def codegen(context, builder, signature, args):
        _, first, row, pitch, n_channels, _, first_weight, first_bias, _, first_out = args
        tile = _Tile(Registers(context, builder, signature, args), CELLS_2, FILTERS_2, 5)
        starts = [builder.add(first, builder.mul(row, whole(r))) for r in range(4)]
        sums = tile.biases(first_bias)
        for i, j in np.ndindex(3, 3):
            weight = builder.add(first_weight, builder.mul(n_channels, whole((3 * i + j) * FILTERS_2)))
            columns = [builder.mul(pitch, whole(x + j)) for x in range(2 * CELLS_2)]
            starts_of = {
                (r, x): tile.registers.pointer(0, builder.add(starts[r + i], columns[x])) for r, x in tile.places
            }

            def add_channel(c, sums, weight=weight, starts_of=starts_of):
                at = builder.add(weight, builder.mul(c, whole(FILTERS_2)))
                return tile.add_products(sums, at, {place: builder.gep(p, [c]) for place, p in starts_of.items()})

            sums = tile.registers.loop(n_channels, sums, add_channel)
        tile.pool(sums, 8, first_out)
        return context.get_dummy_value()

    if not only_int64(first, row, pitch, n_channels, first_weight, first_bias, first_out):
        return None
    arguments = (inputs, first, row, pitch, n_channels, weights, first_weight, first_bias, out, first_out)
    return types.void(*arguments), codegen


@intrinsic
def _occupied_in_registers(typingctx, inputs, first, row):
    def codegen(context, builder, signature, args):
        registers = Registers(context, builder, signature, args)
        places = [builder.add(args[1], builder.mul(args[2], whole(r))) for r in range(4)]
        return registers.any_not_zero([registers.pointer(0, place) for place in places], SEEN_1)

    if not only_int64(first, row):
        return None
    return types.int64(inputs, first, row), codegen


class _Tile:
    """The sums of a tile, each place's filters in registers: a list in the order of places, then of filters."""

    def __init__(self, registers: Registers, n_cells: int, n_filters: int, weights: int) -> None:
        self.registers = registers
        self.places = [(r, x) for r in range(2) for x in range(2 * n_cells)]
        self._lanes = range(0, n_filters, LANES)
        self._n_cells, self._n_filters = n_cells, n_filters
        self._weights = weights  # which of the intrinsic's arguments

    def _load(self, at: ir.Value) -> list:
        return [self.registers.load(self._weights, self.registers.builder.add(at, whole(f))) for f in self._lanes]

    def biases(self, at: ir.Value) -> list:
        return self._load(at) * len(self.places)

    def add_products(self, sums: list, at: ir.Value, pointers: dict) -> list:
        """One tap of one channel, its weights from `at` on, for every place, whose input is at its pointer."""
        weights = self._load(at)
        totals = iter(sums)
        new = []
        for place in self.places:
            value = self.registers.spread(pointers[place])
            new += [self.registers.fma(w, value, next(totals)) for w in weights]
        return new

    def pool(self, sums: list, out: int, first_out: ir.Value) -> None:
        """ReLU and the mean of 2x2 places, into the array that is the intrinsic's argument `out`."""
        registers, builder = self.registers, self.registers.builder
        total = dict(zip([(*place, f) for place in self.places for f in self._lanes], sums, strict=True))
        for cell in range(self._n_cells):
            for f in self._lanes:
                pooled = ZERO
                for r, q in np.ndindex(2, 2):
                    pooled = builder.fadd(pooled, registers.relu(total[r, 2 * cell + q, f]))
                at = builder.add(first_out, whole(cell * self._n_filters + f))
                registers.store(builder.fmul(pooled, constant(QUARTER)), out, at)


_checked = getattr(config, "BOUNDSCHECK", None)
tile_1 = _tile_1_checked if _checked else _tile_1_in_registers
tile_2 = _tile_2_checked if _checked else _tile_2_in_registers
occupied = _occupied_checked if _checked else _occupied_in_registers
