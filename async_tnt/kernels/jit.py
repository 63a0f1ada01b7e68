"""How kernels are compiled: strictly, and cached on disk where a folder can be written."""

from __future__ import annotations

import contextlib
import hashlib
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
compiling = threading.RLock()
"""Held while an entry point is compiled or loaded."""
# LLVM's lock, which Numba does not show.
_llvm_lock = getattr(ffi.lib, "_lock", contextlib.nullcontext())
# In the order in which a compilation takes them.
_locks = [compiling, global_compiler_lock, _llvm_lock]


def sources_digest() -> str:
    """The SHA-256 of all files of kernels, on which compiled code depends."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        # The name and the length keep two files apart from one file with the content of both.
        digest.update(f"{path.relative_to(folder).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()


SOURCES = sources_digest()
"""The digest of the files that this process has imported, see `sources_digest`."""


def cached(function: Callable[..., Any], **options: Any) -> Any:
    """Numba's dispatcher of a function. It compiles the function, or loads its code from the disk.

    An earlier process has stored this code in Numba's cache: in the package's folder, or else in
    the user's cache folder. If neither folder can be written, Numba raises a RuntimeError for a
    function with a cache. Then the function has no cache, and every process compiles it.
    NUMBA_CACHE_DIR can name another folder.
    """
    try:
        kernel = _strict(cache=True, **options)(function)
    except RuntimeError:
        return _strict(**options)(function)

    # Numba takes the code in its cache as current if the function's own file has the same time and
    # size. It would load old code after an edit of a formula that is compiled into the function
    # from another file. So the cached code of every kernel depends on the content of all files of
    # `kernels`.
    cache_file: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = (SOURCES, BOUNDS_CHECKED)
    return kernel


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a part of kernels once, and link it into each kernel that calls it."""
    return _strict()(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a formula, or a part of a kernel, into each kernel that uses it, and never by itself.

    A part that is `compiled` instead is compiled once by itself, and then linked into each kernel
    around it.
    """
    return _strict(inline="always")(function)


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
