"""Arrays in NumPy's `.npy` form, believed only where their header fits the bytes that follow it.

NumPy's own reader asks for the memory that a header claims, and answers a damaged one with messages of several lines,
some of which advise to unpickle the file.
"""

from __future__ import annotations

import math
import os
import warnings
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

MAGIC = b"\x93NUMPY"  # that every .npy file begins with
MOST_HEADER = 10_000  # bytes, NumPy's own limit; a header takes some 100
MOST_BYTES = 1 << 62  # beyond, NumPy's sizes overflow
MOST_DIMENSIONS = 32


class NpyHeader(NamedTuple):
    """What a `.npy` header says."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype
    start: int
    """Bytes before the array."""


def read_npy_header(file: IO[bytes], size: int) -> NpyHeader:
    """Read a header; the file stands at the array then.

    Parameters
    ----------
    file : at the first byte.
    size : bytes in it, header and array together.

    Raises
    ------
    ValueError : no such header, one of Python objects, or one of an array that does not take the rest of the file. One
        line, without the file's name.
    """
    prefix = file.read(8)
    if len(prefix) < 8 or not prefix.startswith(MAGIC):
        raise ValueError(f"it must begin with {MAGIC!r}, got {prefix!r}")
    n_length = 2 if prefix[6] == 1 else 4  # since version 2
    length = int.from_bytes(file.read(n_length), "little")
    if length > MOST_HEADER:
        raise ValueError(f"its header must have at most {MOST_HEADER} bytes, got {length}")
    text = file.read(length)
    try:
        shape, fortran_order, dtype = _parsed(text, is_utf8=prefix[6] == 3)
    except Exception:  # NumPy evaluates it as a Python literal: SyntaxError, TokenError, RecursionError, ...
        raise ValueError(f"its header must describe an array, got {text[:80].decode('latin-1')!r}") from None
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not unpickled; save it as an array of numbers")
    if len(shape) > MOST_DIMENSIONS or min(shape, default=0) < 0 or dtype.subdtype is not None:
        raise ValueError(f"its header must describe an array, got {text[:80].decode('latin-1')!r}")
    if math.prod(max(side, 1) for side in shape) * max(dtype.itemsize, 1) >= MOST_BYTES:
        raise ValueError(f"its header must describe an array of less than 2**62 bytes, got shape {str(shape)[:80]}")
    start = 8 + n_length + length
    n_bytes = math.prod(shape) * dtype.itemsize
    if start + n_bytes != size:
        raise ValueError(
            f"its header says {n_bytes} bytes of {str(dtype)[:200]} in shape {shape}, but {size - start} follow"
        )
    return NpyHeader(shape, fortran_order, dtype, start)


def map_npy(path: str | os.PathLike[str]) -> np.memmap:
    """Map the array of a `.npy` file, read-only.

    Raises
    ------
    ValueError : damaged, or of another size than its header says. OSError : missing or not readable.
    """
    with Path(path).open("rb") as file:
        try:
            shape, fortran_order, dtype, start = read_npy_header(file, os.fstat(file.fileno()).st_size)
        except ValueError as error:
            raise ValueError(f"{path}: not a readable NumPy file: {error}") from None
        return np.memmap(file, dtype, "r", start, shape, "F" if fortran_order else "C")


def _parsed(text: bytes, is_utf8: bool) -> tuple[tuple[int, ...], bool, np.dtype]:
    if is_utf8:  # version 3; as Python's escapes, version 2 can say the same names
        text = text.decode("utf-8").encode("ascii", "backslashreplace")
    with warnings.catch_warnings():  # Python's compiler has some for damaged literals
        warnings.simplefilter("ignore")
        return np.lib.format.read_array_header_2_0(BytesIO(len(text).to_bytes(4, "little") + text))
