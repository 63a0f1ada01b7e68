"""Release Python's lock inside a kernel, where there is much to compute: to wait for it afterwards also takes time.

Between `release_gil` and `take_gil` other threads run; no return, and nothing that raises, may stand there.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .jit import BOUNDS_CHECKED

LARGE = 4_000
"""Events that are many: taking the lock back may wait until another thread has woken this one."""


@intrinsic
def release_gil(typingctx, when):
    """Release the lock if `when`, and if this thread has it: compiled code around may have released it already. Never
    where indices are checked, which may raise. Returns what `take_gil` needs."""

    def codegen(context, builder, signature, args):
        thread = cgutils.alloca_once_value(builder, cgutils.get_null_value(cgutils.voidptr_t))
        if not BOUNDS_CHECKED:
            asks = ir.FunctionType(ir.IntType(32), [])
            with builder.if_then(args[0], likely=False):
                has_it = builder.call(cgutils.get_or_insert_function(builder.module, asks, "PyGILState_Check"), [])
                with builder.if_then(cgutils.is_not_null(builder, has_it)):
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
