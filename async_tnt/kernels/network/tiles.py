"""The innermost steps of every network: a map at a handful of places, with all sums in registers.

A register holds LANES channels of one place. A MIX keeps the sums of some places and up to
REGISTERS registers of filters: each weight is read once for all places, each input once for all
filters. Every sum is taken in one order, each product added with one rounding, so how places are
put together changes no bit. A place's last register may hold more channels than the map has: what
lies behind them in memory is written as it was.

A MIX leaves inputs out that are 0 at every place of a tile: behind a ReLU most of them are. Their
products are 0 or -0, as weights are finite, and could change a sum from -0 to 0 only. So 0 is added
last, which does the same to every -0. Where few inputs are 0, looking for them costs more than it
saves, and the next tiles are computed from all inputs. A step with a weight that is not finite is
always computed from all inputs: 0 times that weight is nan.

The tiles take more than eight arguments: those of a vectorized kernel are plain numbers and arrays.
"""

from functools import partial

import numpy as np
from llvmlite import ir
from numba import types

from async_tnt.kernels.arithmetic import Arithmetic
from async_tnt.kernels.jit import inlined
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.functions import applied, apply_function, choose
from async_tnt.kernels.simd import INDEX, VECTOR, ZERO, fma, vectorized, whole
from async_tnt.kernels.target import LANES

MOST_PLACES = (8, 4, 4, 4) if LANES == 16 else (6, 6)
"""The most places of a tile of a MIX with one register of filters, with two, and so on. The sums
fit in the registers, which are 32 of 16 lanes or 16 of 8; the fewer places, the more inputs are 0
at all of them."""
REGISTERS = len(MOST_PLACES)
"""The most registers of filters of a tile."""
SIZES = {n + 1: sorted({1, 2, 4, most}) for n, most in enumerate(MOST_PLACES)}
"""Registers of filters -> how many places a tile may have. Each number has code of its own, which
takes time to compile."""
DISTANCE = 0xFFFF_FFFF
"""The bits of an input that hold its distance."""
AT_ONCE = 4
"""Registers of channels of a SUM or MAXIMUM that are computed together: one alone would wait four
cycles for each tap."""
WORDS = ir.VectorType(ir.IntType(32), LANES)
"""A register as whole numbers of 32 bits."""
CHANNEL_KINDS = (P.SUM, P.MAXIMUM, P.FUNCTION)
"""The kinds of steps that treat each channel by itself, and compute something."""


@inlined
def list_inputs_plain(program, at, places, listed, n_places, maps, inputs):
    """List the inputs of a MIX that are not 0 at every one of some places of its list.

    They are listed from LISTED on, in `program`, which is updated in place. For parameters see
    `mix_tile_plain`.

    Returns
    -------
    int : how many inputs are listed.
    """
    first = program[at + P.RUNS]
    end = program[P.LISTED]
    for i in range(program[at + P.N_RUNS] * program[at + P.RUN_LENGTH]):
        is_zero = True
        for p in range(n_places):
            y = np.int64(places[listed + p]) >> 16
            x = np.int64(places[listed + p]) & 0xFFFF
            start = inputs + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
            is_zero &= maps[start + (program[first + i] & DISTANCE)] == 0  # nan is not
        if not is_zero:
            program[end] = program[first + i]
            end += 1
    return end - program[P.LISTED]


@vectorized(list_inputs_plain, returns=types.int64)
def list_inputs(simd, program, at, places, listed, n_places, maps, inputs):
    tile = _Tile(simd, program, at, places, listed, maps, inputs, None)
    sizes = sorted({n for sizes in SIZES.values() for n in sizes})
    return choose(simd.builder, n_places, {n: partial(_listed_inputs, tile, n) for n in sizes})


@inlined
def mix_tile_plain(
    program,
    at,
    places,
    listed,
    n_places,
    maps,
    inputs,
    first_input,
    n_inputs,
    output,
    weights,
    block,
    n_filters,
):
    """Compute one block of a step's filters at some places of its list.

    Parameters
    ----------
    program, at, places, maps, weights : see `program`. `at` is where the step's record begins.
    listed, n_places : int. Where in `places` they are listed, and how many, one of SIZES. A place
        may be listed twice.
    inputs, output : int. Where in `maps` place (0, 0) reads and writes, for this group and block.
    first_input, n_inputs : int. Where in `program` the inputs lie that are taken, and how many. All
        others are 0 at these places.
    block : int. Where in `weights` the block begins.
    n_filters : int. How many of the block's filters exist and are written, at least 1. Up to LANES
        lie in one register.

    Returns
    -------
    int : bit p is set if the bits of place p differ from what was there.
    """
    words = maps.view(np.uint32)
    size = (n_filters + LANES - 1) // LANES * LANES  # the filters, in whole registers
    bias = block + program[at + P.N_RUNS] * program[at + P.RUN_LENGTH] * size
    changed = np.int64(0)
    for p in range(n_places):
        y = np.int64(places[listed + p]) >> 16
        x = np.int64(places[listed + p]) & 0xFFFF
        start = inputs + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
        out = output + y * program[at + P.OUT_DY] + x * program[at + P.OUT_DX]
        for f in range(n_filters):
            total = weights[bias + f]
            for i in range(first_input, first_input + n_inputs):
                value = maps[start + (program[i] & DISTANCE)]
                total = fma(weights[block + (program[i] >> 32) * size + f], value, total)
            total += np.float32(0)  # 0 where it is -0
            before = words[out + f]
            maps[out + f] = activated(total, weights, bias + size, f, size)
            changed |= np.int64(words[out + f] != before) << p
    return changed


@inlined
def activated(value, weights, slopes, f, size):
    """clip(value < 0 ? slope value : value, low, high); nan stays nan.

    Parameters
    ----------
    slopes, size : int. Where in `weights` `size` slopes begin, then low and high.
    f : int. Which slope.
    """
    low = weights[slopes + size]
    high = weights[slopes + size + 1]
    value = value * weights[slopes + f] if value < 0 else value
    value = low if value < low else value
    return high if value > high else value


@vectorized(mix_tile_plain, returns=types.int64)
def mix_tile(
    simd,
    program,
    at,
    places,
    listed,
    n_places,
    maps,
    inputs,
    first_input,
    n_inputs,
    output,
    weights,
    block,
    n_filters,
):
    tile = _Tile(simd, program, at, places, listed, maps, inputs, output)
    listed_inputs = simd.at(program, first_input)
    return _mixed(tile, n_places, listed_inputs, n_inputs, weights, block, n_filters)


@inlined
def channel_tile_plain(program, at, places, listed, maps, weights):
    """Compute all channels of a SUM, MAXIMUM or FUNCTION at one place of its list.

    For parameters and the result see `mix_tile_plain`.
    """
    words = maps.view(np.uint32)
    kind = program[at + P.KIND]
    channels = program[at + P.OUT_CHANNELS]
    n_taps = program[at + P.N_RUNS]
    taps = program[at + P.RUNS]
    size = (channels + LANES - 1) // LANES * LANES  # the channels, in whole registers
    y = np.int64(places[listed]) >> 16
    x = np.int64(places[listed]) & 0xFFFF
    place = y * program[at + P.COLUMNS] + x
    first = program[at + P.WEIGHTS] + place * program[at + P.PLACE_WEIGHTS]
    bias = first + (n_taps * size if kind == P.SUM else 0)
    start = program[at + P.IN] + y * program[at + P.IN_DY] + x * program[at + P.IN_DX]
    out = program[at + P.OUT] + y * program[at + P.OUT_DY] + x * program[at + P.OUT_DX]
    changed = np.int64(0)
    for c in range(channels):
        if kind == P.SUM:
            total = weights[bias + c]
            for r in range(n_taps):
                value = maps[start + program[taps + r] + c]
                total = fma(weights[first + r * size + c], value, total)
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
    # Each kind of step has its own instructions.
    kinds = {kind: partial(_by_channel, tile, weights, kind) for kind in CHANNEL_KINDS}
    return choose(simd.builder, tile.slot(P.KIND), kinds)


class _Tile:
    """Builds what the instructions of all tiles have in common.

    Parameters are those of `mix_tile`. If `inputs` or `output` is None, it is taken from the step's
    record.
    """

    def __init__(self, simd, program, at, places, listed, maps, inputs, output):
        self.simd = simd
        self.program = program
        self._at = at
        self._places = places
        self._listed = listed
        self._maps = maps
        self._inputs = self.slot(P.IN) if inputs is None else inputs
        self._output = self.slot(P.OUT) if output is None else output

    def slot(self, slot):
        """A number of the step's record."""
        simd = self.simd
        return simd.builder.load(simd.at(self.program, simd.add(self._at, slot)))

    def place(self, p):
        """Row and column of the p-th listed place."""
        simd = self.simd
        builder = simd.builder
        place = builder.zext(builder.load(simd.at(self._places, simd.add(self._listed, p))), INDEX)
        return builder.lshr(place, whole(16)), builder.and_(place, whole(0xFFFF))

    def starts(self, n_places):
        """For each place, the address where its input begins, and the index of its output."""
        simd = self.simd
        slots = {slot: self.slot(slot) for slot in (P.IN_DY, P.IN_DX, P.OUT_DY, P.OUT_DX)}
        starts = []
        for p in range(n_places):
            y, x = self.place(p)
            start = simd.add(self._inputs, simd.mul(y, slots[P.IN_DY]), simd.mul(x, slots[P.IN_DX]))
            out = simd.add(self._output, simd.mul(y, slots[P.OUT_DY]), simd.mul(x, slots[P.OUT_DX]))
            starts.append((simd.at(self._maps, start), out))
        return starts

    def limits(self, weights, at):
        """The two limits of an activation, each in every lane."""
        simd = self.simd
        low = simd.builder.load(simd.at(weights, simd.add(at, 0)))
        high = simd.builder.load(simd.at(weights, simd.add(at, 1)))
        return simd.spread(low), simd.spread(high)

    def activated(self, value, slope, limits):
        """clip(value < 0 ? slope value : value, low, high), in every lane."""
        a = Arithmetic(self.simd.builder, VECTOR)
        return a.clip(a.where(value, "<", 0.0, a.mul(value, slope), value), *limits)

    def replace(self, value, at, left):
        """Write a register of channels. Returns the bits that differ from what was there.

        Parameters
        ----------
        left : how many of the channels belong to the place; None: all.
        """
        simd = self.simd
        builder = simd.builder
        before = simd.load(self._maps, at, WORDS)
        new = builder.bitcast(value, WORDS)
        if left is not None:
            numbers = ir.Constant(WORDS, list(range(LANES)))
            limits = simd.spread(builder.trunc(left, ir.IntType(32)))
            new = builder.select(builder.icmp_signed("<", numbers, limits), new, before)
        simd.store(builder.bitcast(new, VECTOR), self._maps, at)
        return builder.xor(new, before)

    def any_bit(self, words):
        """1 if a bit of a register is set, else 0."""
        builder = self.simd.builder
        is_set = builder.icmp_unsigned("!=", words, ir.Constant(WORDS, None))
        lanes = builder.bitcast(is_set, ir.IntType(LANES))
        return builder.zext(builder.icmp_unsigned("!=", lanes, ir.Constant(lanes.type, 0)), INDEX)


def _listed_inputs(tile, n_places):
    """Build the list of the inputs that are not 0 at every one of so many places."""
    simd = tile.simd
    builder = simd.builder
    words = ir.VectorType(ir.IntType(32), 8)
    numbers = ir.Constant(words, list(range(8)))
    starts = [start for start, _ in tile.starts(n_places)]
    first = tile.slot(P.RUNS)
    run_length = tile.slot(P.RUN_LENGTH)
    n_eights = builder.udiv(simd.add(run_length, 7), whole(8))

    def add_run(r, ends):
        of_run = simd.add(first, simd.mul(r, run_length))
        distance = builder.and_(builder.load(simd.at(tile.program, of_run)), whole(DISTANCE))

        def add_eight(k, ends):
            at = simd.mul(k, 8)
            bits = simd.load(starts[0], simd.add(distance, at), words)
            for start in starts[1:]:
                bits = builder.or_(bits, simd.load(start, simd.add(distance, at), words))
            # All bits but the sign's: -0 is 0, too.
            bits = builder.and_(bits, ir.Constant(words, [0x7FFF_FFFF] * 8))
            chosen = builder.icmp_unsigned("!=", bits, ir.Constant(words, None))
            left = simd.spread(builder.trunc(builder.sub(run_length, at), ir.IntType(32)), 8)
            chosen = builder.and_(chosen, builder.icmp_signed("<", numbers, left))
            return [simd.pack(tile.program, simd.add(of_run, at), chosen, tile.program, ends[0])]

        return simd.loop(n_eights, ends, add_eight)

    begin = builder.load(simd.at(tile.program, whole(P.LISTED)))
    (end,) = simd.loop(tile.slot(P.N_RUNS), [begin], add_run)
    return builder.sub(end, begin)


def _mixed(tile, n_places, listed_inputs, n_inputs, weights, block, n_filters):
    """Build a tile of a MIX. Each number of places, and of registers, has its own instructions."""
    simd = tile.simd
    builder = simd.builder

    def of_registers(n_vectors):
        build = partial(
            _mixed_places,
            tile,
            listed_inputs=listed_inputs,
            n_inputs=n_inputs,
            weights=weights,
            block=block,
            n_filters=n_filters,
            n_vectors=n_vectors,
        )
        return choose(builder, n_places, {n: partial(build, n) for n in SIZES[n_vectors]})

    n_vectors = builder.udiv(simd.add(n_filters, LANES - 1), whole(LANES))
    return choose(builder, n_vectors, {n: partial(of_registers, n) for n in SIZES})


def _mixed_places(tile, n_places, listed_inputs, n_inputs, weights, block, n_filters, n_vectors):
    """Build a tile of a MIX with this number of places, and of registers of filters."""
    simd = tile.simd
    builder = simd.builder
    size = n_vectors * LANES
    starts = tile.starts(n_places)
    n_products = simd.mul(tile.slot(P.N_RUNS), tile.slot(P.RUN_LENGTH))
    bias = simd.add(block, simd.mul(n_products, size))
    of_block = simd.at(weights, block)

    def registers_at(array, index):
        return [simd.load(array, simd.add(index, v * LANES)) for v in range(n_vectors)]

    def add_input(i, sums):
        number = builder.load(simd.at(listed_inputs, i))
        distance = builder.and_(number, whole(DISTANCE))
        filters = registers_at(of_block, simd.mul(builder.lshr(number, whole(32)), size))
        new = []
        for p, (start, _) in enumerate(starts):
            value = simd.spread(builder.load(simd.at(start, distance)))
            for v, each in enumerate(filters):
                new.append(simd.fma(each, value, sums[p * n_vectors + v]))
        return new

    biases = registers_at(weights, bias)
    sums = simd.loop(n_inputs, biases * n_places, add_input)
    sums = [builder.fadd(total, ZERO) for total in sums]  # 0 where it is -0

    slopes = simd.add(bias, size)
    slope = registers_at(weights, slopes)
    limits = tile.limits(weights, simd.add(slopes, size))
    changed = whole(0)
    for p, (_, out) in enumerate(starts):
        differs = ir.Constant(WORDS, None)
        for v in range(n_vectors):
            value = tile.activated(sums[p * n_vectors + v], slope[v], limits)
            is_last = v == n_vectors - 1
            left = simd.add(n_filters, -v * LANES) if is_last else None
            differs = builder.or_(differs, tile.replace(value, simd.add(out, v * LANES), left))
        changed = builder.or_(changed, builder.shl(tile.any_bit(differs), whole(p)))
    return changed


def _by_channel(tile, weights, kind):
    """Build a tile of a step of this kind, which treats each channel by itself."""
    channels = _Channels(tile, weights, kind)
    if kind == P.FUNCTION:  # Its instructions are too many to have them twice.
        return tile.any_bit(channels.compute(1))

    builder = tile.simd.builder
    is_small = builder.icmp_signed("<", channels.n_vectors, whole(AT_ONCE))
    at_once = builder.select(is_small, whole(1), whole(AT_ONCE))
    cases = {n: partial(channels.compute, n) for n in (1, AT_ONCE)}
    return tile.any_bit(choose(builder, at_once, cases))


class _Channels:
    """Builds the instructions of all channels of one place.

    Attributes
    ----------
    n_vectors : registers of channels.
    """

    def __init__(self, tile, weights, kind):
        simd = tile.simd
        builder = simd.builder
        self._tile = tile
        self._weights = weights
        self._kind = kind
        ((self._start, self._out),) = tile.starts(1)
        self._channels = tile.slot(P.OUT_CHANNELS)
        self._taps = tile.slot(P.RUNS)
        self._n_taps = tile.slot(P.N_RUNS)
        self.n_vectors = builder.udiv(simd.add(self._channels, LANES - 1), whole(LANES))
        self._size = simd.mul(self.n_vectors, LANES)

        y, x = tile.place(0)
        number = simd.add(simd.mul(y, tile.slot(P.COLUMNS)), x)
        self._first = simd.add(tile.slot(P.WEIGHTS), simd.mul(number, tile.slot(P.PLACE_WEIGHTS)))
        self._bias = self._first
        if kind == P.SUM:
            self._bias = simd.add(self._first, simd.mul(self._n_taps, self._size))
        self._slopes = simd.add(self._bias, self._size)
        self._limits = tile.limits(weights, simd.add(self._slopes, self._size))

    def compute(self, n):
        """Compute all registers, n at a time. Returns the bits that differ.

        The last n may overlap the n before them, and compute some registers again.
        """
        tile = self._tile
        simd = tile.simd
        builder = simd.builder
        last = builder.sub(self.n_vectors, whole(n))

        def compute_next(k, carried):
            # The last n registers begin at `last`, so that none lies beyond the map's channels.
            register = simd.mul(k, n)
            is_before_last = builder.icmp_signed("<", register, last)
            register = builder.select(is_before_last, register, last)
            channels = [simd.mul(simd.add(register, i), LANES) for i in range(n)]
            differs = builder.bitcast(carried[0], WORDS)
            for channel, value in zip(channels, self._values(channels), strict=True):
                slope = simd.load(self._weights, simd.add(self._slopes, channel))
                value = tile.activated(value, slope, self._limits)
                n_left = builder.sub(self._channels, channel)
                out = simd.add(self._out, channel)
                differs = builder.or_(differs, tile.replace(value, out, n_left))
            return [builder.bitcast(differs, VECTOR)]

        n_turns = builder.udiv(simd.add(self.n_vectors, n - 1), whole(n))
        differs = simd.loop(n_turns, [ZERO], compute_next)
        return builder.bitcast(differs[0], WORDS)

    def _values(self, at):
        """The sum, maximum or function of the registers at these channels."""
        simd = self._tile.simd
        if self._kind == P.SUM:
            biases = [simd.load(self._weights, simd.add(self._bias, c)) for c in at]
            return simd.loop(self._n_taps, biases, partial(self._add_tap, at))
        inputs = [self._input(whole(0), c) for c in at]
        if self._kind == P.MAXIMUM:
            return simd.loop(self._n_taps, inputs, partial(self._compare_tap, at))
        return [applied(simd.builder, self._tile.slot(P.APPLIED), value) for value in inputs]

    def _input(self, tap, c):
        """The register that a tap reads for the channels from c on."""
        simd = self._tile.simd
        distance = simd.builder.load(simd.at(self._tile.program, simd.add(self._taps, tap)))
        return simd.load(self._start, simd.add(distance, c))

    def _add_tap(self, at, tap, sums):
        simd = self._tile.simd
        of_tap = simd.add(self._first, simd.mul(tap, self._size))
        new = []
        for c, total in zip(at, sums, strict=True):
            weight = simd.load(self._weights, simd.add(of_tap, c))
            new.append(simd.fma(weight, self._input(tap, c), total))
        return new

    def _compare_tap(self, at, tap, largest):
        return [
            self._larger(self._input(tap, c), value) for c, value in zip(at, largest, strict=True)
        ]

    def _larger(self, value, largest):
        """The larger number in every lane; nan where `value` is nan."""
        builder = self._tile.simd.builder
        is_larger = builder.fcmp_ordered(">", value, largest)
        is_nan = builder.fcmp_unordered("uno", value, value)
        return builder.select(builder.or_(is_larger, is_nan), value, largest)
