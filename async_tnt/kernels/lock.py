"""Release Python's lock inside a kernel, where there is much to compute: to wait for it afterwards
also takes time.

Other threads run until `take_gil`; no return, and nothing that raises, may stand before it. See
WITHOUT_GIL in `state`.
"""

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from async_tnt.kernels.jit import BOUNDS_CHECKED

LARGE = 4_000  # events: taking the lock back may wait until another thread has woken this one


@intrinsic
def release_gil(typingctx, when):
    """Release the lock if `when`; never where indices are checked, which may raise. Returns what
    `take_gil` needs."""

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
