"""Arrays of a .safetensors file as memory maps: nothing is read before it is used, and nothing copied.

    bytes 0-7    length n of the header, little-endian uint64
    n bytes      JSON: {name: {"dtype", "shape", "data_offsets": [begin, end]}, "__metadata__": {str: str}}
    the rest     the arrays, little-endian, C order, one after the other without gaps; offsets count from here

The package `safetensors` reads the same files, but copies.

References
----------
Hugging Face, safetensors, README, section "Format".
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

_TYPES = {"I64": "<i8", "I32": "<i4", "F32": "<f4", "U16": "<u2", "U8": "|u1"}
_MAX_HEADER = 100_000_000  # safetensors' own limit


def map_tensors(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Map a file of int64, int32, float32, uint16 and uint8 arrays.

    Returns
    -------
    tensors : name -> read-only `np.memmap`, aligned for its type. One map, one file descriptor for all.
    metadata : the header's strings.

    Raises
    ------
    ValueError : damaged, or with other types; the message says what is wrong, not in which file.
    OSError : missing or not readable.
    """
    size = Path(path).stat().st_size
    if size < 8:
        raise ValueError(f"a .safetensors file has at least 8 bytes, got {size}")
    raw = np.memmap(path, np.uint8, "r")
    size = len(raw)
    data_start = 8 + int.from_bytes(raw[:8].tobytes(), "little")
    if data_start > min(size, _MAX_HEADER):
        raise ValueError(f"the header must end by byte {min(size, _MAX_HEADER)}, got {data_start}")
    header = _parsed(raw[8:data_start].tobytes())
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("`__metadata__` must map names to strings")

    places = {name: _place(name, entry) for name, entry in header.items()}
    end_before = 0
    for name, (dtype, shape, begin, end) in sorted(places.items(), key=lambda item: item[1][2:]):
        if begin != end_before:
            raise ValueError(f"`{name}` must begin where the array before it ends, {end_before}, got {begin}")
        if end - begin != math.prod(shape) * dtype.itemsize:
            raise ValueError(f"`{name}` of shape {shape} and {dtype} cannot take {end - begin} bytes")
        if (data_start + begin) % dtype.itemsize:  # numpy would bear it, compiled code would not
            raise ValueError(f"`{name}` must lie at a multiple of {dtype.itemsize} bytes, got {data_start + begin}")
        end_before = end
    if data_start + end_before != size:
        raise ValueError(f"the header speaks of {data_start + end_before} bytes, but the file has {size}")
    tensors = {
        name: raw[data_start + begin : data_start + end].view(dtype).reshape(shape)
        for name, (dtype, shape, begin, end) in places.items()
    }
    return tensors, metadata


def _parsed(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # the latter: nested too deep
        raise ValueError(f"the header is not JSON: {error}") from None
    if not isinstance(header, dict):
        raise ValueError("the header must be a JSON object")
    return header


def _place(name: str, entry: Any) -> tuple[np.dtype, tuple[int, ...], int, int]:
    """(dtype, shape, begin, end) of one array, from its entry in the header."""
    try:
        code, shape, (begin, end) = entry["dtype"], entry["shape"], entry["data_offsets"]
        dtype = np.dtype(_TYPES[code])
        numbers = [*shape, begin, end]
    except (TypeError, KeyError, ValueError):
        raise ValueError(f"`{name}` is not described as an array of {', '.join(_TYPES)}") from None
    if not all(type(n) is int and 0 <= n < 1 << 48 for n in numbers) or begin > end or len(shape) > 8:
        raise ValueError(f"`{name}` has an impossible shape {shape} or place {begin}-{end}")
    return dtype, tuple(shape), begin, end
