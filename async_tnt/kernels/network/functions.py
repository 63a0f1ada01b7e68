"""Functions of one float32 that networks apply to each value: logarithm, sigmoid, GELU and others.

They are written here with additions, products, divisions, square roots and comparisons alone, each
of which IEEE 754 rounds in one way. The functions of a library differ in their last bits from one
machine to the next. Errors are at most a few units in the last place, except for results below
1e-37, and for Phi.

    exp        e^x = 2^n e^r,  n = round(x / log 2),  |r| <= log 2 / 2
               e^r by its series up to r^7 / 7!
    log1p      1 + x = 2^k m,  m in [sqrt 1/2, sqrt 2)
               log m = 2 artanh s,  s = (m - 1) / (m + 1), by its series up to s^9
    sigmoid    1 / (1 + e^-x)
    tanh       1 - 2 / (1 + e^2x); where |x| < 0.4, by its series up to x^11
    silu       x sigmoid(x)
    gelu       x Phi(x), with Phi by Abramowitz and Stegun 1964, 7.1.26 (absolute error 1.5e-7)
    gelu_tanh  x (1 + tanh(u)) / 2 = x sigmoid(2 u),  u = sqrt(2 / pi) (x + 0.044715 x^3)
    hardswish  x clip(x + 3, 0, 6) / 6
    erf        2 Phi(sqrt 2 x) - 1, with the same Phi; where |x| < 0.4, by its series up to x^9
    inverse_sqrt  1 / sqrt x
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from async_tnt.kernels.arithmetic import Arithmetic

ROUND = 1.5 * 2**23
"""x + ROUND - ROUND is x rounded to a whole number, which the lowest bits of x + ROUND hold."""
LOG2 = math.log(2)
LOG2_HIGH = float(np.floor(LOG2 * 2**12) / 2**12)
"""The first bits of LOG2: few enough for exact products with whole numbers."""
LOG2_LOW = LOG2 - LOG2_HIGH
GELU_TANH = 2 * math.sqrt(2 / math.pi)
"""The factor of x in 2 u of `gelu_tanh`."""


def _exp(a: Arithmetic, x: ir.Value) -> ir.Value:
    """e^x, with x limited to [-87, 87]: there neither e^x nor e^-x is subnormal."""
    x = a.clip(x, -87.0, 87.0)
    shifted = a.fma(x, 1 / LOG2, ROUND)
    n = a.sub(shifted, ROUND)
    rest = a.fma(n, -LOG2_LOW, a.fma(n, -LOG2_HIGH, x))
    exponent = a.on_bits("shl", a.bits(shifted), 23)
    power = a.of_bits(a.on_bits("add", exponent, 127 << 23))  # 2^n
    return a.mul(a.polynomial(rest, [1 / math.factorial(k) for k in range(8)]), power)


def _log1p(a: Arithmetic, x: ir.Value) -> ir.Value:
    """log(1 + x): -inf at -1, nan below."""
    u = a.add(x, 1.0)
    # What 1 + x has lost by being rounded.
    lost = a.where(x, ">", 1.0, a.sub(1.0, a.sub(u, x)), a.sub(x, a.sub(u, 1.0)))

    # u = 2^k m. The bits of sqrt 1/2 are 0x3F3504F3.
    bits = a.bits(u)
    k = a.on_bits("ashr", a.on_bits("sub", bits, 0x3F3504F3), 23)
    exponent = a.on_bits("shl", k, 23)
    m = a.of_bits(a.on_bits("sub", bits, exponent))
    inverse = a.of_bits(a.on_bits("sub", 127 << 23, exponent))  # 2^-k

    f = a.fma(lost, inverse, a.sub(m, 1.0))
    s = a.div(f, a.add(f, 2.0))
    z = a.mul(s, s)
    series = a.mul(z, a.polynomial(z, [2 / 3, 2 / 5, 2 / 7, 2 / 9]))
    whole = a.to_float(k)
    log = a.fma(whole, LOG2_HIGH, a.fma(whole, LOG2_LOW, a.fma(s, series, a.mul(s, 2.0))))

    log = a.where(u, "==", math.inf, u, log)
    log = a.where(u, "==", 0.0, -math.inf, log)
    return a.where(u, "<", 0.0, math.nan, log)


def _sigmoid(a: Arithmetic, x: ir.Value) -> ir.Value:
    return a.div(1.0, a.add(_exp(a, a.mul(x, -1.0)), 1.0))


def _tanh(a: Arithmetic, x: ir.Value) -> ir.Value:
    z = a.mul(x, x)
    near = a.mul(x, a.polynomial(z, [1.0, -1 / 3, 2 / 15, -17 / 315, 62 / 2835, -1382 / 155925]))
    far = a.sub(1.0, a.div(2.0, a.add(_exp(a, a.mul(x, 2.0)), 1.0)))
    return a.where(z, "<", 0.16, near, far)


def _times_sigmoid(a: Arithmetic, x: ir.Value, inner: ir.Value) -> ir.Value:
    """x sigmoid(inner); 0 times x where `_exp` would limit its argument."""
    return a.where(inner, "<", -87.0, a.mul(x, 0.0), a.mul(x, _sigmoid(a, inner)))


def _silu(a: Arithmetic, x: ir.Value) -> ir.Value:
    return _times_sigmoid(a, x, x)


def _tail(a: Arithmetic, x: ir.Value) -> ir.Value:
    """Phi(-|x|)."""
    size = a.where(x, "<", 0.0, a.mul(x, -1.0), x)
    t = a.div(1.0, a.fma(size, 0.3275911 / math.sqrt(2), 1.0))
    series = a.polynomial(t, [0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429])
    return a.mul(a.mul(a.mul(series, t), 0.5), _exp(a, a.mul(a.mul(x, x), -0.5)))


def _gelu(a: Arithmetic, x: ir.Value) -> ir.Value:
    tail = _tail(a, x)
    return a.mul(x, a.where(x, "<", 0.0, tail, a.sub(1.0, tail)))


def _gelu_tanh(a: Arithmetic, x: ir.Value) -> ir.Value:
    inner = a.mul(x, a.fma(a.mul(x, x), 0.044715 * GELU_TANH, GELU_TANH))
    return _times_sigmoid(a, x, inner)


def _hardswish(a: Arithmetic, x: ir.Value) -> ir.Value:
    return a.mul(a.mul(x, a.clip(a.add(x, 3.0), 0.0, 6.0)), 1 / 6)


def _erf(a: Arithmetic, x: ir.Value) -> ir.Value:
    z = a.mul(x, x)
    terms = [(-1) ** k / (math.factorial(k) * (2 * k + 1)) for k in range(5)]
    near = a.mul(a.mul(x, a.polynomial(z, terms)), 2 / math.sqrt(math.pi))
    size = a.fma(_tail(a, a.mul(x, math.sqrt(2))), -2.0, 1.0)
    far = a.where(x, "<", 0.0, a.mul(size, -1.0), size)
    return a.where(z, "<", 0.16, near, far)


def _inverse_sqrt(a: Arithmetic, x: ir.Value) -> ir.Value:
    return a.div(1.0, a.sqrt(x))


FUNCTIONS: dict[str, Callable[[Arithmetic, ir.Value], ir.Value]] = {
    "log1p": _log1p,
    "sigmoid": _sigmoid,
    "tanh": _tanh,
    "silu": _silu,
    "gelu": _gelu,
    "gelu_tanh": _gelu_tanh,
    "hardswish": _hardswish,
    "erf": _erf,
    "inverse_sqrt": _inverse_sqrt,
}
"""Name -> instructions. A program holds their places in this table."""


def choose(
    builder: ir.IRBuilder, which: ir.Value, cases: Mapping[int, Callable[[], ir.Value]]
) -> ir.Value:
    """The value of the case number `which`.

    Parameters
    ----------
    which : a number that `cases` has.
    cases : number -> a function that builds the instructions of that case and returns their value.
    """
    blocks = [builder.append_basic_block() for _ in cases]
    done = builder.append_basic_block()
    switch = builder.switch(which, blocks[0])
    values = []
    for (number, build), block in zip(cases.items(), blocks, strict=True):
        switch.add_case(ir.Constant(which.type, number), block)
        builder.position_at_end(block)
        values.append((build(), builder.block))
        builder.branch(done)
    builder.position_at_end(done)
    result = builder.phi(values[0][0].type)
    for value, block in values:
        result.add_incoming(value, block)
    return result


def applied(builder: ir.IRBuilder, which: ir.Value, x: ir.Value) -> ir.Value:
    """Function number `which` of x, a float32 or a vector of them."""
    arithmetic = Arithmetic(builder, x.type)
    cases = {k: partial(build, arithmetic, x) for k, build in enumerate(FUNCTIONS.values())}
    return choose(builder, which, cases)


@intrinsic
def apply_function(typingctx: Any, which: types.Type, x: types.Type) -> Any:
    """Function number `which` (int64) of a float32."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: list) -> ir.Value:
        return applied(builder, *args)

    if which != types.int64 or x != types.float32:
        return None
    return types.float32(which, x), codegen
