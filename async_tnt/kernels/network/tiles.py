"""The innermost steps of every network: a map at a handful of places, anywhere in it, with all sums
in registers.

A register holds LANES channels of one place. A MIX keeps the sums of up to PLACES places and two
registers of filters: each weight is read once for all places, each input once for all filters.
Every sum is taken in one order, each product added with one rounding, so how places are put
together changes no bit. A place's last register may hold more channels than the map has: what lies
behind them in memory is written as it was.
"""

from functools import partial

import numpy as np
from llvmlite import ir
from numba import types

from async_tnt.kernels.arithmetic import Arithmetic
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.functions import applied, apply_function, choose
from async_tnt.kernels.simd import INDEX, LANES, VECTOR, ZERO, fma, vectorized, whole

SIZES = (1, 2, 4, 6, 8, 12) if LANES == 16 else (1, 2, 4, 6)
"""How many places a tile of a MIX may have: as fit in the registers, 32 of 16 lanes or 16 of 8.
Each number has code of its own, which takes time to compile."""
PLACES = SIZES[-1]
AT_ONCE = 4
"""Registers of channels of a SUM or MAXIMUM: one alone would wait four cycles for each tap."""
WORDS = ir.VectorType(ir.IntType(32), LANES)


@inlined
def mix_tile_plain(
    program, at, places, listed, n_places, maps, inputs, output, weights, block, n_filters
):
    """One block of a step's filters, of one or two registers, at some places of its list.

    Parameters
    ----------
    program, at, places, maps, weights : see `program`; `at` is where the step's record begins.
    listed, n_places : where in `places` they are listed, and how many, of SIZES. One may be listed
        twice.
    inputs, output : where in `maps` place (0, 0) reads and writes, for this group and block.
    block : where in `weights` the block begins.
    n_filters : how many of the block's filters exist and are written, at least 1; up to LANES lie
        in one register.

    Returns
    -------
    int : bit p is set if the bits of place p differ from what was there.
    """
    words = maps.view(np.uint32)
    size = 2 * LANES if n_filters > LANES else LANES
    n_runs, run_length = program[at + P.N_RUNS], program[at + P.RUN_LENGTH]
    bias = block + n_runs * run_length * size
    changed = np.int64(0)
    for p in range(n_places):
        y, x = np.int64(places[listed + p]) >> 16, np.int64(places[listed + p]) & 0xFFFF
        start = inputs + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
        out = output + y * program[at + P.OUT_DY] + x * program[at + P.OUT_DX]
        for f in range(n_filters):
            total = weights[bias + f]
            for r in range(n_runs):
                for k in range(run_length):
                    value = maps[start + program[program[at + P.RUNS] + r] + k]
                    total = fma(weights[block + (r * run_length + k) * size + f], value, total)
            before = words[out + f]
            maps[out + f] = activated(total, weights, bias + size, f, size)
            changed |= np.int64(words[out + f] != before) << p
    return changed


@inlined
def activated(value, weights, slopes, f, size):
    """clip(value < 0 ? slope value : value, low, high); nan stays nan.

    slopes, size : where in `weights` `size` slopes begin, then low and high.
    """
    low, high = weights[slopes + size], weights[slopes + size + 1]
    value = value * weights[slopes + f] if value < 0 else value
    value = low if value < low else value
    return high if value > high else value


@vectorized(mix_tile_plain, returns=types.int64)
def mix_tile(
    simd, program, at, places, listed, n_places, maps, inputs, output, weights, block, n_filters
):
    tile = _Tile(simd, program, at, places, listed, maps, inputs, output)
    return tile.mix(n_places, weights, block, n_filters)


@inlined
def channel_tile_plain(program, at, places, listed, maps, weights):
    """All channels of a SUM, MAXIMUM or FUNCTION at one place of its list; otherwise as
    `mix_tile_plain`."""
    words = maps.view(np.uint32)
    kind, channels = program[at + P.KIND], program[at + P.OUT_CHANNELS]
    n_taps, taps = program[at + P.N_RUNS], program[at + P.RUNS]
    size = (channels + LANES - 1) // LANES * LANES
    y, x = np.int64(places[listed]) >> 16, np.int64(places[listed]) & 0xFFFF
    first = (
        program[at + P.WEIGHTS] + (y * program[at + P.COLUMNS] + x) * program[at + P.PLACE_WEIGHTS]
    )
    bias = first + (n_taps * size if kind == P.SUM else 0)
    start = program[at + P.IN] + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
    out = program[at + P.OUT] + y * program[at + P.OUT_DY] + x * program[at + P.OUT_DX]
    changed = np.int64(0)
    for c in range(channels):
        if kind == P.SUM:
            total = weights[bias + c]
            for r in range(n_taps):
                total = fma(
                    weights[first + r * size + c], maps[start + program[taps + r] + c], total
                )
        elif kind == P.FUNCTION:
            total = apply_function(program[at + P.APPLIED], maps[start + program[taps] + c])
        else:
            total = maps[start + program[taps] + c]
            for r in range(1, n_taps):
                value = maps[start + program[taps + r] + c]
                total = value if value > total or np.isnan(value) else total
        before = words[out + c]
        maps[out + c] = activated(total, weights, bias + size, c, size)
        changed |= np.int64(words[out + c] != before)
    return changed


@vectorized(channel_tile_plain, returns=types.int64)
def channel_tile(simd, program, at, places, listed, maps, weights):
    tile = _Tile(simd, program, at, places, listed, maps, None, None)
    return tile.by_channel(weights)


class _Tile:
    """Builds a tile's instructions."""

    def __init__(self, simd, program, at, places, listed, maps, inputs, output):
        self._simd, self._program, self._at = simd, program, at
        self._places, self._listed, self._maps = places, listed, maps
        self._inputs = self._slot(P.IN) if inputs is None else inputs
        self._output = self._slot(P.OUT) if output is None else output

    def _slot(self, slot):
        simd = self._simd
        return simd.builder.load(simd.at(self._program, simd.add(self._at, slot)))

    def _place(self, p):
        """Row and column of the p-th listed place."""
        simd, builder = self._simd, self._simd.builder
        place = builder.zext(builder.load(simd.at(self._places, simd.add(self._listed, p))), INDEX)
        return builder.lshr(place, whole(16)), builder.and_(place, whole(0xFFFF))

    def _starts(self, n_places):
        """Of each place, what it reads from and where it writes."""
        simd = self._simd
        slots = {slot: self._slot(slot) for slot in (P.IN_DY, P.IN_DX, P.OUT_DY, P.OUT_DX)}
        starts = []
        for p in range(n_places):
            y, x = self._place(p)
            start = simd.add(self._inputs, simd.mul(y, slots[P.IN_DY]), simd.mul(x, slots[P.IN_DX]))
            out = simd.add(self._output, simd.mul(y, slots[P.OUT_DY]), simd.mul(x, slots[P.OUT_DX]))
            starts.append((simd.at(self._maps, start), out))
        return starts

    def mix(self, n_places, weights, block, n_filters):
        """Each number of places, and of registers, has its own instructions."""

        def of_registers(n_vectors):
            build = partial(
                self._mix, weights=weights, block=block, n_filters=n_filters, n_vectors=n_vectors
            )
            return choose(builder, n_places, {n: partial(build, n) for n in SIZES})

        builder = self._simd.builder
        n_vectors = builder.select(
            builder.icmp_signed(">", n_filters, whole(LANES)), whole(2), whole(1)
        )
        return choose(builder, n_vectors, {n: partial(of_registers, n) for n in (1, 2)})

    def _mix(self, n_places, weights, block, n_filters, n_vectors):
        simd, builder = self._simd, self._simd.builder
        size, vectors = n_vectors * LANES, range(n_vectors)
        starts = self._starts(n_places)
        runs, n_runs, run_length = (
            self._slot(P.RUNS),
            self._slot(P.N_RUNS),
            self._slot(P.RUN_LENGTH),
        )
        n_weights = simd.mul(run_length, size)  # of a run
        bias = simd.add(block, simd.mul(n_runs, n_weights))

        def add_run(r, sums):
            distance = builder.load(simd.at(self._program, simd.add(runs, r)))
            inputs = [simd.at(start, distance) for start, _ in starts]
            of_run = simd.at(weights, simd.add(block, simd.mul(r, n_weights)))

            def add_input(k, sums):
                w = [simd.load(of_run, simd.add(simd.mul(k, size), v * LANES)) for v in vectors]
                totals, new = iter(sums), []
                for start in inputs:
                    value = simd.spread(builder.load(simd.at(start, k)))
                    new += [simd.fma(each, value, next(totals)) for each in w]
                return new

            return simd.loop(run_length, sums, add_input)

        biases = [simd.load(weights, simd.add(bias, v * LANES)) for v in vectors]
        sums = iter(simd.loop(n_runs, biases * n_places, add_run))
        slopes = simd.add(bias, size)
        slope = [simd.load(weights, simd.add(slopes, v * LANES)) for v in vectors]
        limits = self._limits(weights, simd.add(slopes, size))
        changed = whole(0)
        for p, (_, out) in enumerate(starts):
            differs = ir.Constant(WORDS, None)
            for v in vectors:
                value = self._activated(next(sums), slope[v], limits)
                is_last = v == n_vectors - 1
                left = simd.add(n_filters, -v * LANES) if is_last else None
                differs = builder.or_(differs, self._replace(value, simd.add(out, v * LANES), left))
            changed = builder.or_(changed, builder.shl(self._any(differs), whole(p)))
        return changed

    def by_channel(self, weights):
        """Each kind of step has its own instructions."""
        kinds = {
            kind: partial(self._by_channel, weights, kind)
            for kind in (P.SUM, P.MAXIMUM, P.FUNCTION)
        }
        return choose(self._simd.builder, self._slot(P.KIND), kinds)

    def _by_channel(self, weights, kind):
        simd, builder = self._simd, self._simd.builder
        ((start, out),) = self._starts(1)
        channels, taps, n_taps = (
            self._slot(P.OUT_CHANNELS),
            self._slot(P.RUNS),
            self._slot(P.N_RUNS),
        )
        n_vectors = builder.udiv(simd.add(channels, LANES - 1), whole(LANES))
        size = simd.mul(n_vectors, LANES)
        y, x = self._place(0)
        number = simd.add(simd.mul(y, self._slot(P.COLUMNS)), x)
        first = simd.add(self._slot(P.WEIGHTS), simd.mul(number, self._slot(P.PLACE_WEIGHTS)))
        bias = simd.add(first, simd.mul(n_taps, size)) if kind == P.SUM else first
        slopes = simd.add(bias, size)
        limits = self._limits(weights, simd.add(slopes, size))

        def input_of(tap, c):
            distance = builder.load(simd.at(self._program, simd.add(taps, tap)))
            return simd.load(start, simd.add(distance, c))

        def registers(n):
            """n side by side, in turn; the last ones may have been computed before."""
            last = builder.sub(n_vectors, whole(n))

            def compute(k, carried):
                v0 = simd.mul(k, n)
                v0 = builder.select(builder.icmp_signed("<", v0, last), v0, last)
                at = [simd.mul(simd.add(v0, v), LANES) for v in range(n)]

                def add_tap(tap, sums):
                    of_tap = simd.add(first, simd.mul(tap, size))
                    return [
                        simd.fma(simd.load(weights, simd.add(of_tap, c)), input_of(tap, c), total)
                        for c, total in zip(at, sums, strict=True)
                    ]

                def compare_tap(tap, largest):
                    return [
                        self._larger(input_of(tap, c), value)
                        for c, value in zip(at, largest, strict=True)
                    ]

                if kind == P.SUM:
                    values = simd.loop(
                        n_taps, [simd.load(weights, simd.add(bias, c)) for c in at], add_tap
                    )
                elif kind == P.FUNCTION:
                    values = [
                        applied(builder, self._slot(P.APPLIED), input_of(whole(0), c)) for c in at
                    ]
                else:
                    values = simd.loop(n_taps, [input_of(whole(0), c) for c in at], compare_tap)
                differs = builder.bitcast(carried[0], WORDS)
                for c, value in zip(at, values, strict=True):
                    value = self._activated(value, simd.load(weights, simd.add(slopes, c)), limits)
                    new = self._replace(value, simd.add(out, c), builder.sub(channels, c))
                    differs = builder.or_(differs, new)
                return [builder.bitcast(differs, VECTOR)]

            differs = simd.loop(builder.udiv(simd.add(n_vectors, n - 1), whole(n)), [ZERO], compute)
            return builder.bitcast(differs[0], WORDS)

        if kind == P.FUNCTION:  # whose instructions are many
            return self._any(registers(1))
        at_once = builder.select(
            builder.icmp_signed("<", n_vectors, whole(AT_ONCE)), whole(1), whole(AT_ONCE)
        )
        return self._any(choose(builder, at_once, {n: partial(registers, n) for n in (1, AT_ONCE)}))

    def _larger(self, value, largest):
        builder = self._simd.builder
        larger = builder.or_(
            builder.fcmp_ordered(">", value, largest), builder.fcmp_unordered("uno", value, value)
        )
        return builder.select(larger, value, largest)

    def _limits(self, weights, at):
        simd = self._simd
        low, high = (simd.builder.load(simd.at(weights, simd.add(at, k))) for k in range(2))
        return simd.spread(low), simd.spread(high)

    def _activated(self, value, slope, limits):
        a = Arithmetic(self._simd.builder, VECTOR)
        return a.clip(a.where(value, "<", 0.0, a.mul(value, slope), value), *limits)

    def _replace(self, value, at, left):
        """Write a register of channels, of which `left` belong to the place (None: all); the bits
        that differ."""
        simd, builder = self._simd, self._simd.builder
        before, new = simd.load(self._maps, at, WORDS), builder.bitcast(value, WORDS)
        if left is not None:
            numbers = ir.Constant(WORDS, list(range(LANES)))
            limits = simd.spread(builder.trunc(left, ir.IntType(32)))
            new = builder.select(builder.icmp_signed("<", numbers, limits), new, before)
        simd.store(builder.bitcast(new, VECTOR), self._maps, at)
        return builder.xor(new, before)

    def _any(self, words):
        """1 if a bit is set, else 0."""
        builder = self._simd.builder
        lanes = builder.bitcast(
            builder.icmp_unsigned("!=", words, ir.Constant(WORDS, None)), ir.IntType(LANES)
        )
        return builder.zext(builder.icmp_unsigned("!=", lanes, ir.Constant(lanes.type, 0)), INDEX)
