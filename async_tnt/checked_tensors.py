"""Models as .safetensors files: named arrays and strings, with a checksum over them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import BinaryIO

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

ALIGNMENT = 8
MAX_HEADER = 100_000_000  # bytes; safetensors' own limit


def tensor_bytes(tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """`safetensors.numpy.save` with sorted metadata, whose order otherwise changes from call to call.

    Examples
    --------
    >>> from safetensors.numpy import load
    >>> content = tensor_bytes({"x": np.arange(3)}, {"b": "2", "a": "1"})
    >>> load(content)["x"].tolist(), content == tensor_bytes({"x": np.arange(3)}, {"a": "1", "b": "2"})
    ([0, 1, 2], True)
    """
    content = save(dict(tensors), metadata=dict(metadata))
    end = ALIGNMENT + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:end])
    header = {"__metadata__": dict(sorted(header.pop("__metadata__").items())), **header}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNMENT)  # tensors begin at multiples of 8
    return len(text).to_bytes(8, "little") + text + content[end:]


def read_tensors(file: BinaryIO, expected: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Tensors and metadata of an open file, which is read once.

    Raises
    ------
    SafetensorError : it is not a .safetensors file, or NumPy lacks the type of a tensor.
    ValueError : `format` in its metadata is not the expected one. Only the header has been read then, as tensors of
        other programs may be huge.
    """
    size = file.read(8)
    n_bytes = int.from_bytes(size, "little")
    if len(size) < 8 or n_bytes > MAX_HEADER:
        raise SafetensorError("it does not begin with the length of a header")
    text = file.read(n_bytes)
    try:
        metadata = json.loads(text).get("__metadata__") or {}
        written = metadata.get("format")
    except (AttributeError, ValueError, RecursionError):
        raise SafetensorError("its header is not a JSON object") from None
    if written != expected:
        raise ValueError(f"`format` must be {expected!r}, got {written!r}")
    try:
        tensors = load(size + text + file.read())
    except KeyError as error:
        raise SafetensorError(f"NumPy has no type {error.args[0]}") from None
    return dict(sorted(tensors.items())), metadata  # `load` returns them in a different order each time


def checksum(tensors: Mapping[str, np.ndarray], text: str) -> str:
    """SHA-256 of a text and of the tensors' names, dtypes, shapes and bytes, in any order and memory layout."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tensors[name].shape}".encode())
        digest.update(np.ascontiguousarray(tensors[name]).tobytes())
    return digest.hexdigest()
