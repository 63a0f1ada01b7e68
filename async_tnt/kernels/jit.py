"""How the kernels are compiled: strictly, and cached on disk where there is a place for it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from numba import njit

# error_model="numpy": 1 / 0 is inf, as in the equations. Python's model would raise, and the test for it
# keeps loops out of vector registers. No fastmath anywhere: how a stream is cut must not change a bit.
_strict = partial(njit, error_model="numpy")


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at the first call, or load what an earlier process compiled.

    Numba refuses to decorate a function for its cache where neither the package's folder nor the user's cache
    folder is writable (NUMBA_CACHE_DIR names another); then every process compiles anew.
    """
    try:
        return _strict(cache=True)(function)
    except RuntimeError:
        return _strict()(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A formula that several kernels share: compiled into each of them, never called by itself."""
    return _strict(inline="always")(function)
