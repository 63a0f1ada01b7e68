"""Arrays in NumPy's `.npy` form, accepted only if their header fits the bytes that follow it.

NumPy's own reader allocates the memory that a header claims, and reports a damaged one in several lines, some of which
advise unpickling the file.
"""

from __future__ import annotations

import math
import os
import warnings
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np

MAGIC = b"\x93NUMPY"  # the first bytes of every .npy file
MAX_HEADER_BYTES = 1 << 16  # NumPy reads what a header claims, up to 4 GiB


def read_npy_header(file: IO[bytes], size: int) -> tuple[np.ndarray, bool]:
    """Read a header, from the first byte up to the array, in a file of `size` bytes.

    Returns
    -------
    An array of the type and shape that the header claims, which takes no memory, and whether it is in Fortran's order.

    Raises
    ------
    ValueError : no header, one of Python objects, or of an array that does not fill the rest of the file. One line,
        without the file's name.
    """
    start = file.read(8)
    if len(start) < 8 or not start.startswith(MAGIC):
        raise ValueError(f"it must begin with {MAGIC!r}, got {start!r}")
    try:
        with warnings.catch_warnings():  # Python's compiler has some for damaged literals
            warnings.simplefilter("ignore")
            is_v1 = start[6] == 1
            read = np.lib.format.read_array_header_1_0 if is_v1 else np.lib.format.read_array_header_2_0
            length = file.read(2 if is_v1 else 4)
            header = file.read(min(int.from_bytes(length, "little"), MAX_HEADER_BYTES))
            shape, is_fortran, dtype = read(BytesIO(length + header))
        claimed = np.broadcast_to(np.empty((), dtype), shape)
    except Exception:  # NumPy evaluates it as a Python literal: SyntaxError, TokenError, RecursionError, ...
        raise ValueError("its header does not describe an array") from None
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not unpickled; save it as an array of numbers")
    if math.prod(shape) * dtype.itemsize != size - file.tell() or dtype.subdtype is not None:
        raise ValueError(
            f"its header claims an array of {str(dtype)[:200]} in shape {shape}, but {size - file.tell()} bytes follow"
        )
    return claimed, is_fortran


def map_npy(path: str | os.PathLike[str]) -> np.memmap:
    """Map the array of a `.npy` file, read-only; a ValueError if it is damaged."""
    with Path(path).open("rb") as file:
        try:
            claimed, is_fortran = read_npy_header(file, os.fstat(file.fileno()).st_size)
        except ValueError as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from None
        return np.memmap(file, claimed.dtype, "r", file.tell(), claimed.shape, "F" if is_fortran else "C")
