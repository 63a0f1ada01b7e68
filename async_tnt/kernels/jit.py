"""How the kernels are compiled: strictly, and cached on disk where there is a place for it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from numba import config, njit

# error_model="numpy": 1 / 0 is inf, as in the equations. Python's model would raise, and the test for it
# keeps loops out of vector registers. No fastmath anywhere: how a stream is cut must not change a bit.
_strict = partial(njit, error_model="numpy")


@cache
def _stamp_of(folder: Path) -> tuple[Any, ...]:
    files = [os.stat(path) for path in sorted(folder.glob("*.py"))]
    return tuple((f.st_mtime, f.st_size) for f in files), getattr(config, "BOUNDSCHECK", None)


_compiling = threading.Lock()
STAMP = _stamp_of(Path(__file__).parent)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, or load what an earlier process compiled.

    Numba refuses to decorate a function for its cache where neither the package's folder nor the user's cache
    folder is writable (NUMBA_CACHE_DIR names another); then every process compiles anew.
    """
    return _compiled(function)


def compiled_without_gil(function: Callable[..., Any]) -> Callable[..., Any]:
    """`compiled`, and other Python threads run meanwhile: for work that takes longer than handing the lock over."""
    return _compiled(function, nogil=True)


def _compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    try:
        kernel = _strict(cache=True, **options)(function)
    except RuntimeError:
        return _strict(**options)(function)
    # Numba looks only at the file of the function itself: after an edit of a formula that is compiled into it
    # from elsewhere, it would go on serving the old code. So every cached kernel depends on all files here, and
    # on all files beside its own, for the kernels of other folders.
    cache_file: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(cache_file, "_source_stamp"):
        beside = _stamp_of(Path(function.__code__.co_filename).parent)
        cache_file._source_stamp = (cache_file._source_stamp, STAMP, beside)
    return kernel


def compile_only(kernel: Any, *types: Any) -> None:
    """Compile a kernel for these argument types, and let a call with any others raise a TypeError.

    So the call itself checks types, dimensions, layout and flags of the arrays it is given, which in Python
    would cost more than the work; and nothing a caller hands over can set off a compilation.
    """
    with _compiling:
        if not kernel.signatures:
            kernel.compile(types)
            kernel.disable_compile()


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A formula that several kernels share: compiled into each of them, never called by itself."""
    return _strict(inline="always")(function)
