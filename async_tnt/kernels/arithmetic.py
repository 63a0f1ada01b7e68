"""Instructions on a float32 or on a vector of them, as LLVM builds them."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils


class Arithmetic:
    """Builds instructions on a float32 or on a vector of them.

    Numbers in Python become constants. `kind` is LLVM's type of the values.
    """

    def __init__(self, builder: ir.IRBuilder, kind: Any) -> None:
        self._builder = builder
        self._kind = kind
        self._lanes = kind.count if isinstance(kind, ir.VectorType) else None
        bits = ir.IntType(32)
        self._bits = bits if self._lanes is None else ir.VectorType(bits, self._lanes)

    def _value(self, value: Any, kind: Any) -> ir.Value:
        if isinstance(value, ir.Value):
            return value
        return ir.Constant(kind, value if self._lanes is None else [value] * self._lanes)

    def _floats(self, *values: Any) -> list[ir.Value]:
        return [self._value(value, self._kind) for value in values]

    def add(self, a: Any, b: Any) -> ir.Value:
        return self._builder.fadd(*self._floats(a, b))

    def sub(self, a: Any, b: Any) -> ir.Value:
        return self._builder.fsub(*self._floats(a, b))

    def mul(self, a: Any, b: Any) -> ir.Value:
        return self._builder.fmul(*self._floats(a, b))

    def div(self, a: Any, b: Any) -> ir.Value:
        return self._builder.fdiv(*self._floats(a, b))

    def fma(self, a: Any, b: Any, c: Any) -> ir.Value:
        """a b + c with one rounding."""
        name = "llvm.fma.f32" if self._lanes is None else f"llvm.fma.v{self._lanes}f32"
        kind = ir.FunctionType(self._kind, [self._kind] * 3)
        function = cgutils.get_or_insert_function(self._builder.module, kind, name)
        return self._builder.call(function, self._floats(a, b, c))

    def sqrt(self, a: Any) -> ir.Value:
        """The square root, which IEEE 754 rounds in one way."""
        name = "llvm.sqrt.f32" if self._lanes is None else f"llvm.sqrt.v{self._lanes}f32"
        kind = ir.FunctionType(self._kind, [self._kind])
        function = cgutils.get_or_insert_function(self._builder.module, kind, name)
        return self._builder.call(function, self._floats(a))

    def polynomial(self, x: ir.Value, coefficients: list[float]) -> ir.Value:
        """c0 + x (c1 + x (c2 + ...))"""
        total = self._floats(coefficients[-1])[0]
        for coefficient in coefficients[-2::-1]:
            total = self.fma(total, x, coefficient)
        return total

    def where(self, a: Any, relation: str, b: Any, then: Any, otherwise: Any) -> ir.Value:
        """`then` where a relation holds between a and b, else `otherwise`.

        Where a or b is nan, it is `otherwise`.

        relation : "<", ">" or another one of LLVM's comparisons.
        """
        holds = self._builder.fcmp_ordered(relation, *self._floats(a, b))
        return self._builder.select(holds, *self._floats(then, otherwise))

    def clip(self, x: ir.Value, low: Any, high: Any) -> ir.Value:
        x = self.where(x, "<", low, low, x)
        return self.where(x, ">", high, high, x)

    def bits(self, x: ir.Value) -> ir.Value:
        """The bits of a float32, as a whole number of 32 bits."""
        return self._builder.bitcast(x, self._bits)

    def of_bits(self, bits: ir.Value) -> ir.Value:
        """The float32 with these bits."""
        return self._builder.bitcast(bits, self._kind)

    def on_bits(self, operation: str, a: Any, b: Any) -> ir.Value:
        """The operation of this name of the builder, on whole numbers of 32 bits."""
        build = getattr(self._builder, operation)
        return build(self._value(a, self._bits), self._value(b, self._bits))

    def to_float(self, bits: ir.Value) -> ir.Value:
        """A whole number of 32 bits, converted to float32."""
        return self._builder.sitofp(bits, self._kind)
