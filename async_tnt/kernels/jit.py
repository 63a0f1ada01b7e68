"""How the kernels are compiled: strictly, and cached on disk where a folder can be written."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from llvmlite.binding import ffi
from numba import config, njit
from numba.core.compiler_lock import global_compiler_lock

if getattr(config, "DISABLE_JIT", 0):
    raise ImportError(
        "async_tnt cannot run with NUMBA_DISABLE_JIT=1, which switches Numba's compiler off: "
        "unset it"
    )

BOUNDS_CHECKED = bool(getattr(config, "BOUNDSCHECK", None))
"""Whether Numba tests every index: NUMBA_BOUNDSCHECK=1."""

# error_model="numpy": 1 / 0 is inf, as in the equations. Python's model would raise, and the test
# for it keeps loops out of vector registers. No fastmath anywhere: how a stream is cut must not
# change a bit. no_cfunc_wrapper: nobody calls these through C pointers, and each wrapper takes time
# to compile.
_strict = partial(njit, error_model="numpy", no_cfunc_wrapper=True)

# Re-entrant: a signal handler that forks may run in the thread that compiles.
_compiling = threading.RLock()
# LLVM's lock, which Numba does not show.
_llvm_lock = getattr(ffi.lib, "_lock", contextlib.nullcontext())
# In the order in which a compilation takes them.
_locks = [_compiling, global_compiler_lock, _llvm_lock]

_files = [path.stat() for path in sorted(Path(__file__).parent.rglob("*.py"))]
# What all cached machine code depends on.
_STAMP = tuple((file.st_mtime, file.st_size) for file in _files), BOUNDS_CHECKED


def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Compile at the first call, or load what an earlier process compiled.

    Where neither the package's folder nor the user's cache folder is writable, Numba refuses to
    decorate a function for its cache (NUMBA_CACHE_DIR names another folder); then every process
    compiles for itself.
    """
    try:
        kernel = _strict(cache=True, **options)(function)
    except RuntimeError:
        return _strict(**options)(function)

    # Numba looks only at the file of the function itself: after an edit of a formula that is
    # compiled into it from another file, it would still serve the old code. So every cached kernel
    # depends on all files here.
    cache_file: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = (cache_file._source_stamp, _STAMP)
    return kernel


compiled_without_gil = partial(compiled, nogil=True)
"""`compiled`, and other Python threads run meanwhile. It is for work that always takes longer than
to release Python's lock."""


def compile_only(kernel: Any, *types: Any) -> None:
    """Compile a kernel for these argument types, and let a call with any others raise a TypeError.

    The call itself then checks types, dimensions, layout and flags of the arrays it is given, which
    in Python would cost more than the work; and no argument can cause another compilation.
    """
    compile_for_types(kernel, types)
    kernel.disable_compile()


def compile_for_types(kernel: Any, types: tuple[Any, ...]) -> None:
    """Compile a kernel for these argument types, unless that has been done."""
    with _compiling:
        if types not in kernel.overloads:
            kernel.compile(types)


def _begin_fork() -> None:
    """Wait until no other thread compiles, and let none begin.

    A child of `fork` has a copy of every lock, but only the thread that forked. A lock that another
    thread held would stay locked there forever, and what it guards would stay half done.
    """
    for lock in _locks:
        lock.__enter__()


def _end_fork() -> None:
    """Let threads compile again, in the parent and in the child."""
    for lock in reversed(_locks):
        lock.__exit__(None, None, None)


if hasattr(os, "register_at_fork"):  # Windows has no `fork`
    os.register_at_fork(before=_begin_fork, after_in_parent=_end_fork, after_in_child=_end_fork)


def is_cached(kernel: Any, types: tuple[Any, ...]) -> bool:
    """Whether an earlier process left this kernel on disk, or this one has compiled it."""
    # Loading changes what another thread may be compiling with.
    with global_compiler_lock:
        if types in kernel.overloads:
            return True
        return kernel._cache.load_overload(types, kernel.targetctx) is not None


def can_be_cached(kernel: Any) -> bool:
    """Whether there is a folder for the kernel's machine code."""
    return kernel.stats.cache_path is not None


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a formula, or a part of a kernel, into each kernel that uses it, and never by itself.

    A part that is `compiled` instead is compiled once by itself, and again within each kernel
    around it.
    """
    return _strict(inline="always")(function)
