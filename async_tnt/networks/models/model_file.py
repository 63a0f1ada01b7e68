"""The .safetensors file of a model: tensors, metadata, and a checksum of both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from async_tnt.base.checks import one_line, parse_json
from async_tnt.volume.config import TNTConfig

ALIGNMENT = 8


def tensor_bytes(tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """`safetensors.numpy.save` with sorted metadata, whose order otherwise changes from call to
    call.

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


def read_tensors(path: Path, expected: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Tensors and metadata of a file.

    Raises
    ------
    SafetensorError : it is not a .safetensors file, or NumPy lacks the type of a tensor.
    ValueError : `format` in its metadata is not the expected one. Only the header has been read
        then, as tensors of other programs may be huge.
    """
    with safe_open(path, "numpy") as file:
        metadata = file.metadata() or {}
        if metadata.get("format") != expected:
            raise ValueError(f"`format` must be {expected!r}, got {metadata.get('format')!r}")
        try:
            return {name: file.get_tensor(name) for name in sorted(file.keys())}, metadata
        except (KeyError, TypeError, AttributeError) as error:
            raise SafetensorError(f"NumPy lacks the type of a tensor: {one_line(error)}") from None


def parse_metadata(metadata: Mapping[str, str], name: str) -> Any:
    """The JSON value of one name; a ValueError, which names it, if it is damaged."""
    try:
        return parse_json(metadata[name])
    except ValueError as error:
        raise ValueError(f"`{name}` in its metadata cannot be read: {error}") from None


def read_description(metadata: Mapping[str, str], *more: str) -> tuple[TNTConfig, Any, Any]:
    """Configuration, classes and record of `Model.description`; a ValueError if they, or `more`
    names, are missing."""
    if missing := [
        name for name in ("config", "classes", "record", *more, "sha256") if name not in metadata
    ]:
        raise ValueError(f"no {' and no '.join(missing)} in its metadata")
    config, classes, record = (
        parse_metadata(metadata, name) for name in ("config", "classes", "record")
    )
    return TNTConfig.from_dict(config), classes, record


def checksum(tensors: Mapping[str, np.ndarray], text: str) -> str:
    """SHA-256 of a text and of the tensors' names, dtypes, shapes and bytes, in any order and
    memory layout."""
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tensors[name].shape}".encode())
        digest.update(np.ascontiguousarray(tensors[name]).tobytes())
    return digest.hexdigest()


def checksum_of(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """Of the weights and all metadata other than itself."""
    return checksum(
        weights, json.dumps({name: metadata[name] for name in sorted(metadata) if name != "sha256"})
    )
