"""Arrays from callers, without a mask."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import DTypeLike


def plain_array(name: str, values: Any, dtype: DTypeLike | None = None) -> np.ndarray:
    """`np.asarray`, which drops the mask of a masked array without a word, for arrays that have none.

    Raises
    ------
    TypeError : a masked array.
    """
    refuse_mask(name, values, "`.filled(value)`, or `.data` to use every value")
    return np.asarray(values, dtype)


def refuse_mask(name: str, values: Any, advice: str) -> None:
    """Raise a TypeError for a masked array, even one that masks nothing; `advice` is what to pass instead."""
    # by `sys.modules`: before somebody imports numpy.ma nothing can be masked, and importing it takes 10 ms
    if isinstance(values, getattr(sys.modules.get("numpy.ma"), "MaskedArray", ())):
        raise TypeError(f"`{name}` must not be a masked array, whose mask would be ignored; pass {advice}")
