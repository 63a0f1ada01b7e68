"""Vector registers for kernels that hold sums in them: what LLVM does not find in plain loops by itself.

A register holds LANES filters (or units) of one place. How many it holds depends on the machine, and so does
the layout of weights; results do not: every sum is taken in one order, each product added with one rounding.
"""

import llvmlite.binding as llvm
from llvmlite import ir
from numba import config, types


def _lanes_of_this_machine():
    if getattr(config, "CPU_NAME", None):  # NUMBA_CPU_NAME: code for another machine
        return 16 if "+avx512f" in (config.CPU_FEATURES or "") else 8
    return 16 if llvm.get_host_cpu_features().get("avx512f", False) else 8


LANES = _lanes_of_this_machine()
INDEX = ir.IntType(64)
VECTOR = ir.VectorType(ir.FloatType(), LANES)


def constant(value):
    """One number in every lane, as a constant."""
    return ir.Constant(VECTOR, [float(value)] * LANES)


ZERO = constant(0)


def whole(value):
    """A number as a constant index."""
    return ir.Constant(INDEX, value)


class Registers:
    """Vector instructions on the float32 arrays that an intrinsic is called with; indices are not checked."""

    def __init__(self, context, builder, signature, args):
        self.builder = builder
        self._data = {
            k: context.make_array(kind)(context, builder, args[k]).data
            for k, kind in enumerate(signature.args)
            if isinstance(kind, types.Array)
        }
        name, kind = f"llvm.fma.v{LANES}f32", ir.FunctionType(VECTOR, [VECTOR] * 3)
        self._fma = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)

    def pointer(self, array, index):
        """To one number; `array` counts the intrinsic's arguments."""
        return self.builder.gep(self._data[array], [index])

    def load(self, array, index):
        """LANES numbers from `index` on."""
        value = self.builder.load(self.builder.bitcast(self.pointer(array, index), VECTOR.as_pointer()))
        value.align = 4
        return value

    def store(self, value, array, index):
        pointer = self.builder.bitcast(self.pointer(array, index), VECTOR.as_pointer())
        self.builder.store(value, pointer).align = 4

    def spread(self, pointer):
        """One number in every lane."""
        undefined = ir.Constant(VECTOR, ir.Undefined)
        first = self.builder.insert_element(undefined, self.builder.load(pointer), ir.Constant(ir.IntType(32), 0))
        return self.builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), None))

    def fma(self, a, b, c):
        return self.builder.call(self._fma, [a, b, c])

    def relu(self, value):
        """max(value, 0); nan stays nan."""
        negative = self.builder.fcmp_ordered("<", value, ZERO)
        return self.builder.select(negative, ZERO, value)

    def any_not_zero(self, pointers, n):
        """1 if any of the n numbers at one of the places is not zero (-0 counts as 0, nan does not), else 0."""
        builder = self.builder
        words = ir.VectorType(ir.IntType(32), n)
        found = ir.Constant(words, None)
        for pointer in pointers:
            value = builder.load(builder.bitcast(pointer, words.as_pointer()))
            value.align = 4
            found = builder.or_(found, value)
        found = builder.shl(found, ir.Constant(words, [1] * n))  # without the sign
        flags = builder.bitcast(builder.icmp_unsigned("!=", found, ir.Constant(words, None)), ir.IntType(n))
        return builder.zext(builder.icmp_unsigned("!=", flags, ir.Constant(ir.IntType(n), 0)), INDEX)

    def loop(self, n, sums, body):
        """for k in range(n): sums = body(k, sums)        sums: a list of registers; n is at least 1."""
        builder = self.builder
        before = builder.block
        inside = builder.append_basic_block("sum")
        after = builder.append_basic_block("summed")
        builder.branch(inside)
        builder.position_at_end(inside)
        carried = [(builder.phi(INDEX), whole(0)), *((builder.phi(VECTOR), value) for value in sums)]
        counter = carried[0][0]
        new = [builder.add(counter, whole(1)), *body(counter, [phi for phi, _ in carried[1:]])]
        for (phi, first), value in zip(carried, new, strict=True):
            phi.add_incoming(first, before)
            phi.add_incoming(value, inside)
        builder.cbranch(builder.icmp_signed("<", new[0], n), inside, after)
        builder.position_at_end(after)
        return new[1:]


def only_int64(*numbers):
    """Whether an intrinsic is called with the types it is written for."""
    return all(number == types.int64 for number in numbers)
