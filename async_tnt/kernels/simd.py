"""Vector instructions, for kernels that keep sums in registers.

LLVM does not find these instructions in plain loops. So such a kernel is written twice, with the
same arguments and the same bits:

    @inlined
    def tile_plain(inputs, first, ...)       loops over numbers; Numba can check their indices

    @vectorized(tile_plain)
    def tile(simd, inputs, first, ...)       the LLVM instructions, through a `Simd`; unchecked

Other kernels call `tile`: the instructions, or under NUMBA_BOUNDSCHECK=1 the loops.

A register holds LANES float32. How many that is depends on the machine, and so does the layout of
weights. Results do not, because every sum is taken in one order, and each product is added with one
rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from async_tnt.kernels.arithmetic import Arithmetic
from async_tnt.kernels.jit import BOUNDS_CHECKED, inlined
from async_tnt.kernels.target import LANES

INDEX = ir.IntType(64)
VECTOR = ir.VectorType(ir.FloatType(), LANES)
"""A register."""
ZERO = ir.Constant(VECTOR, [0.0] * LANES)

SPELLINGS: dict[str, tuple[Any, Any]] = {}
"""Name of a vectorized kernel -> (its plain loops, its instructions)."""


def whole(value: int) -> ir.Constant:
    """A constant index."""
    return ir.Constant(INDEX, value)


class Simd:
    """Builds instructions on vectors of LANES float32. Some methods take vectors of other types.

    Indices count elements of an array, not bytes.
    """

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.builder = builder

    def add(self, first: ir.Value, *others: ir.Value | int) -> ir.Value:
        """The sum of indices."""
        for other in others:
            first = self.builder.add(first, whole(other) if isinstance(other, int) else other)
        return first

    def mul(self, index: ir.Value, factor: ir.Value | int) -> ir.Value:
        """The product of indices."""
        return self.builder.mul(index, whole(factor) if isinstance(factor, int) else factor)

    def at(self, array: ir.Value, index: ir.Value) -> ir.Value:
        """The array from this index on."""
        return self.builder.gep(array, [index])

    def load(self, array: ir.Value, index: ir.Value, kind: ir.VectorType = VECTOR) -> ir.Value:
        """Load as many numbers as `kind` holds, from `index` on."""
        value = self.builder.load(self.builder.bitcast(self.at(array, index), kind.as_pointer()))
        value.align = _alignment(kind)
        return value

    def store(self, value: ir.Value, array: ir.Value, index: ir.Value) -> None:
        """Write a vector from `index` on."""
        pointer = self.builder.bitcast(self.at(array, index), value.type.as_pointer())
        instruction = self.builder.store(value, pointer)
        instruction.align = _alignment(value.type)

    def spread(self, number: ir.Value, lanes: int = LANES) -> ir.Value:
        """One number in every lane."""
        undefined = ir.Constant(ir.VectorType(number.type, lanes), ir.Undefined)
        first = self.builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), None)
        return self.builder.shuffle_vector(first, undefined, zeros)

    def fma(self, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
        """a * b + c with one rounding, in every lane."""
        return Arithmetic(self.builder, VECTOR).fma(a, b, c)

    def loop(self, n: ir.Value, sums: list, body: Callable[[ir.Value, list], list]) -> list:
        """A loop: for k in range(n): sums = body(k, sums).

        Parameters
        ----------
        n : the number of iterations, which may be 0.
        sums : list of values, the values before the first iteration.
        body : builds the instructions of an iteration. It takes k and the values before the
            iteration, and returns the values after it, in a list of the same length.

        Returns
        -------
        list of values, the values after the last iteration.
        """
        builder = self.builder
        before = builder.block
        inside = builder.append_basic_block("sum")
        after = builder.append_basic_block("summed")
        builder.cbranch(builder.icmp_signed("<", whole(0), n), inside, after)

        builder.position_at_end(inside)
        counter = builder.phi(INDEX)
        carried = [builder.phi(value.type) for value in sums]
        next_counter = builder.add(counter, whole(1))
        new = body(counter, carried)
        end = builder.block  # another block than `inside` if the body holds a loop
        counter.add_incoming(whole(0), before)
        counter.add_incoming(next_counter, end)
        for phi, start, value in zip(carried, sums, new, strict=True):
            phi.add_incoming(start, before)
            phi.add_incoming(value, end)
        branch = builder.cbranch(builder.icmp_signed("<", next_counter, n), inside, after)
        branch.set_metadata("llvm.loop", _never_unrolled(builder.module))

        builder.position_at_end(after)
        last = [builder.phi(value.type) for value in sums]
        for phi, first, value in zip(last, sums, new, strict=True):
            phi.add_incoming(first, before)
            phi.add_incoming(value, end)
        return last

    def pack(
        self,
        source: ir.Value,
        first: ir.Value,
        chosen: ir.Value,
        target: ir.Value,
        end: ir.Value,
    ) -> ir.Value:
        """Append the chosen ones of eight whole numbers to those that lie before `end`.

        What lies behind the new end, up to eight numbers from `end` on, is overwritten, too.

        Parameters
        ----------
        source, first : where the eight int64 lie.
        chosen : a bit for each of them.
        target, end : where the numbers before them end.

        Returns
        -------
        The new end.
        """
        builder = self.builder
        bits = builder.bitcast(chosen, ir.IntType(8))
        if LANES == 16:
            kind = ir.VectorType(INDEX, 8)
            values = self.load(source, first, kind)
            function = ir.FunctionType(kind, [kind, kind, chosen.type])
            name = "llvm.x86.avx512.mask.compress.v8i64"
            compress = cgutils.get_or_insert_function(builder.module, function, name)
            self.store(builder.call(compress, [values, values, chosen]), target, end)
            return self.add(end, builder.zext(builder.ctpop(bits), INDEX))

        # Without an instruction for it, each number is written, and the next one perhaps over it.
        bits = builder.zext(bits, INDEX)
        for k in range(8):
            value = builder.load(self.at(source, self.add(first, k)))
            builder.store(value, self.at(target, end))
            end = self.add(end, builder.and_(builder.lshr(bits, whole(k)), whole(1)))
        return end


def _never_unrolled(module: ir.Module) -> Any:
    """A note for LLVM at a loop's branch: it shall not repeat the loop's body.

    A repeated body would not be faster here, and the turns that are left over would be a second
    loop: both ends of a loop of unforeseen length then cost a wrong guess of the processor.
    """
    disable = module.add_metadata([ir.MetaDataString(module, "llvm.loop.unroll.disable")])
    # LLVM knows a loop's note by its first part, which is the note itself. The number keeps the
    # notes of two loops apart.
    number = ir.Constant(ir.IntType(32), len(module.metadata))
    note = module.add_metadata([disable, number])
    note.operands = (note, disable)
    return note


def _alignment(kind: ir.VectorType) -> int:
    """The alignment of a vector, in bytes: that of one of its numbers."""
    return 8 if kind.element in (ir.DoubleType(), INDEX) else 4


def vectorized(plain: Callable[..., Any], returns: types.Type = types.void) -> Callable[..., Any]:
    """Decorate the vector spelling of `plain`.

    It is a function `build(simd, ...)` with the kernel's arguments, arrays as pointers. Arrays are
    contiguous, other arguments int64, uint64 or float64.
    """

    def decorate(build: Callable[..., Any]) -> Any:
        @wraps(build)  # Numba reads its name and its arguments
        def instructions(typingctx: Any, *arguments: types.Type) -> Any:
            scalars = {kind for kind in arguments if not isinstance(kind, types.Array)}
            if not scalars <= {types.int64, types.uint64, types.float64}:
                return None

            def codegen(context: Any, builder: ir.IRBuilder, signature: Any, values: list) -> Any:
                pointers = []
                for kind, value in zip(signature.args, values, strict=True):
                    if isinstance(kind, types.Array):
                        pointers.append(context.make_array(kind)(context, builder, value).data)
                    else:
                        pointers.append(value)
                result = build(Simd(builder), *pointers)
                return context.get_dummy_value() if result is None else result

            return returns(*arguments), codegen

        vector = intrinsic(instructions)
        SPELLINGS[build.__name__] = plain, vector
        return plain if BOUNDS_CHECKED else vector

    return decorate


@intrinsic
def fma(typingctx: Any, a: types.Type, b: types.Type, c: types.Type) -> Any:
    """a * b + c for float32 with one rounding.

    It is the same in scalar and in vector code, and on every machine. If the compiler were allowed
    to contract a * b + c at will, a result would depend on how a loop was vectorized.
    """

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: list) -> ir.Value:
        return builder.fma(*args)

    if a != types.float32 or b != types.float32 or c != types.float32:
        return None
    return types.float32(a, b, c), codegen


@intrinsic
def trailing_zeros(typingctx: Any, word: types.Type) -> Any:
    """The number of the lowest bit that is set in a uint64, which must not be 0."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: list) -> ir.Value:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    if word != types.uint64:
        return None
    return types.int64(word), codegen


@intrinsic
def count_bits(typingctx: Any, word: types.Type) -> Any:
    """How many bits of a uint64 are set."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: list) -> ir.Value:
        return builder.ctpop(args[0])

    if word != types.uint64:
        return None
    return types.int64(word), codegen


@inlined
def add_f64x2_plain(cells, index, first, second, factor):
    """Add two numbers to neighbouring cells.

        cells[index]     += first * factor
        cells[index + 1] += second * factor

    Parameters
    ----------
    cells : float64. Updated in place.
    index : uint64.
    first, second, factor : float64.
    """
    cells[index] += first * factor
    cells[index + np.uint64(1)] += second * factor


@vectorized(add_f64x2_plain)
def add_f64x2(simd, cells, index, first, second, factor):
    builder = simd.builder
    pair = ir.VectorType(ir.DoubleType(), 2)
    lane = [ir.Constant(ir.IntType(32), k) for k in range(2)]

    def pack(one: ir.Value, other: ir.Value) -> ir.Value:
        half = builder.insert_element(ir.Constant(pair, ir.Undefined), one, lane[0])
        return builder.insert_element(half, other, lane[1])

    added = builder.fmul(pack(first, second), pack(factor, factor))
    simd.store(builder.fadd(simd.load(cells, index, pair), added), cells, index)
