"""Models and states of streams as .safetensors files: named arrays and strings, with a checksum over them."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from async_tnt.checks import one_line, short

ALIGNMENT = 8
MAX_HEADER = 100_000_000  # bytes; safetensors' own limit
STATE_FORMAT = "async_tnt stream 2"
Arrays = dict[str, np.ndarray]


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


def state_bytes(arrays: Arrays, about: dict[str, Any]) -> bytes:
    """The state of a stream: arrays, and `about` as JSON, as the content of a file with a checksum."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    text = json.dumps(about, sort_keys=True)
    return tensor_bytes(arrays, {"format": STATE_FORMAT, "about": text, "sha256": checksum(arrays, text)})


def read_state(content: bytes, fixed: Mapping[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
    """The inverse of `state_bytes`.

    Parameters
    ----------
    fixed : settings that must be the same under "fixed" in `about`.

    Raises
    ------
    ValueError : it is something else, damaged, or has other settings, which the message names.
    """
    try:
        arrays, metadata = read_tensors(io.BytesIO(bytes(content)), STATE_FORMAT)
    except (SafetensorError, TypeError, ValueError) as error:
        raise ValueError(f"`state` must be what `save_state` returned, got something else: {one_line(error)}") from None
    text = metadata.get("about", "")
    if metadata.get("sha256") != checksum(arrays, text):
        raise ValueError("`state` is damaged: its checksum differs")
    try:
        about = json.loads(text)
        theirs = about["fixed"] if fixed else {}
        ours, saved = ({**of, **of.get("config", {})} for of in (fixed or {}, theirs))
        differ = [name for name in {**ours, **saved} if name != "config" and saved.get(name) != ours.get(name)]
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:  # the last: nested too deep
        raise ValueError(f"`state` is damaged: {one_line(error)}") from None
    if differ:
        wrong = ", ".join(f"{name} = {short(saved.get(name))} (here {ours.get(name)!r})" for name in differ)
        raise ValueError(f"`state` is of another processor, with {wrong}")
    return arrays, about


def with_prefix(prefix: str, arrays: Arrays) -> Arrays:
    """Names with a prefix, so that the arrays of several objects fit into one state."""
    return {f"{prefix}.{name}": array for name, array in arrays.items()}


def without_prefix(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays whose names have a prefix, without it."""
    return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(prefix + ".")}


def checked_array(arrays: Arrays, name: str, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """One array of a state.

    Raises
    ------
    ValueError : it is missing, or has another type or shape.
    """
    array = arrays.get(name)
    if array is None or array.dtype != dtype or array.shape != shape:
        got = "none" if array is None else f"{array.dtype} {array.shape}"
        raise ValueError(f"its `{name}` must be {np.dtype(dtype)} {shape}, got {got}")
    return array
