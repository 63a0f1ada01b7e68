"""a * b + c with one rounding, the same in scalar and in vector code and on every machine."""

from numba import types
from numba.extending import intrinsic


@intrinsic
def fma(typingctx, a, b, c):
    """fma(a, b, c) for float32: explicit, because letting the compiler contract a * b + c as it likes would
    make a result depend on how a loop was vectorized."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    if a != types.float32 or b != types.float32 or c != types.float32:
        return None
    return types.float32(a, b, c), codegen
