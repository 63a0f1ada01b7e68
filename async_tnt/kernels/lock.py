"""Release Python's lock inside a kernel, where there is much to compute.

Other threads run between `release_gil` and `take_gil`. Where there is little to compute, the lock
is kept, because to wait for it afterwards may take longer. See also WITHOUT_GIL in `state`.

The rule: no return, and nothing that raises, may stand between the two. A test reads the kernels
and verifies it. Numba's own way, `nogil=True`, needs no rule, but holds for all calls of a kernel.
Then each kernel is needed twice, for little work and for much work. As measured, a user's first
start then takes 27.0 s instead of 23.6 s to compile, and the choice in Python takes 1 to 2 % of a
`push` of 10 events.
"""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from async_tnt.kernels.jit import BOUNDS_CHECKED

LARGE = 4_000
"""Events from which on the lock is released: taking it back may wait for another thread."""


@intrinsic
def release_gil(typingctx, when):
    """Release the lock if `when`. Returns what `take_gil` needs.

    Where indices are checked, a kernel may raise an error, so the lock is never released.
    """

    def codegen(context, builder, signature, args):
        thread = cgutils.alloca_once_value(builder, cgutils.get_null_value(cgutils.voidptr_t))
        if not BOUNDS_CHECKED:
            with builder.if_then(args[0], likely=False):
                builder.store(context.get_python_api(builder).save_thread(), thread)
        return builder.load(thread)

    return types.voidptr(types.boolean), codegen


@intrinsic
def take_gil(typingctx, released):
    """Take the lock back, if it was released."""

    def codegen(context, builder, signature, args):
        with builder.if_then(cgutils.is_not_null(builder, args[0]), likely=False):
            context.get_python_api(builder).restore_thread(args[0])
        return context.get_dummy_value()

    return types.void(types.voidptr), codegen
