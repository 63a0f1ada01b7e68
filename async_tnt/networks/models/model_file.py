"""The .safetensors file of a model: tensors, metadata, and a checksum of both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line
from async_tnt.volume.config import TNTConfig

ALIGNMENT = 8
"""How many bytes hold the header's length. The tensors begin at a multiple of this number."""


def tensor_bytes(tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """The content of a .safetensors file, the same bytes for the same tensors and metadata.

    The metadata are sorted here: `safetensors.numpy.save` writes them in an order that changes from
    call to call.

    Examples
    --------
    >>> from safetensors.numpy import load
    >>> content = tensor_bytes({"x": np.arange(3)}, {"b": "2", "a": "1"})
    >>> load(content)["x"].tolist()
    [0, 1, 2]
    >>> content == tensor_bytes({"x": np.arange(3)}, {"a": "1", "b": "2"})
    True
    """
    content = save(dict(tensors), metadata=dict(metadata))
    end = ALIGNMENT + int.from_bytes(content[:ALIGNMENT], "little")
    header = json.loads(content[ALIGNMENT:end])
    sorted_metadata = dict(sorted(header.pop("__metadata__").items()))
    header = {"__metadata__": sorted_metadata, **header}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNMENT)
    return len(text).to_bytes(ALIGNMENT, "little") + text + content[end:]


def read_tensors(
    path: Path, formats: Sequence[str]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Tensors and metadata of a file.

    Raises
    ------
    SafetensorError : the file is not a .safetensors file, or NumPy lacks the type of a tensor.
    ValueError : `format` in the file's metadata is none of `formats`. This is checked before any
        tensor is read, as the tensors of another program may be huge.
    """
    with safe_open(path, "numpy") as file:
        metadata = file.metadata() or {}
        if metadata.get("format") not in formats:
            expected = " or ".join(map(repr, formats))
            raise ValueError(f"`format` must be {expected}, got {metadata.get('format')!r}")
        try:
            return {name: file.get_tensor(name) for name in sorted(file.keys())}, metadata
        except (KeyError, TypeError, AttributeError) as error:
            raise SafetensorError(f"NumPy lacks the type of a tensor: {one_line(error)}") from None


def parse_metadata(metadata: Mapping[str, str], name: str) -> Any:
    """The JSON value of one name; a ValueError with this name if the value is damaged."""
    try:
        return parse_json(metadata[name])
    except ValueError as error:
        raise ValueError(f"`{name}` in its metadata cannot be read: {error}") from None


class Description(NamedTuple):
    """What a file says about a model, apart from the network. Only `config` has been checked."""

    config: TNTConfig
    classes: Any
    record: Any
    outputs: Any
    by_share: Any


def read_description(metadata: Mapping[str, str], *further_names: str) -> Description:
    """Configuration, classes, record and outputs, as `Model.description` wrote them.

    Parameters
    ----------
    further_names : further names that the metadata must have.

    Raises
    ------
    ValueError : a name is missing, or its value cannot be read.
    """
    expected = ("config", "classes", "record", *further_names)
    missing = [name for name in expected if name not in metadata]
    if missing:
        raise ValueError(f"no {' and no '.join(missing)} in its metadata")
    config = parse_metadata(metadata, "config")
    classes = parse_metadata(metadata, "classes")
    record = parse_metadata(metadata, "record")
    outputs = parse_metadata(metadata, "outputs") if "outputs" in metadata else {}
    by_share = parse_metadata(metadata, "by_share") if "by_share" in metadata else False
    return Description(TNTConfig.from_dict(config), classes, record, outputs, by_share)


def checksum(tensors: Mapping[str, np.ndarray], text: str) -> str:
    """SHA-256 of a text and of the tensors' names, dtypes, shapes and bytes.

    It does not depend on the tensors' order, nor on how they lie in memory.
    """
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tensors[name].shape}".encode())
        digest.update(np.ascontiguousarray(tensors[name]).tobytes())
    return digest.hexdigest()


def checksum_of(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """The checksum of the weights and of all metadata except the checksum itself."""
    other_entries = {name: metadata[name] for name in sorted(metadata) if name != "sha256"}
    return checksum(weights, json.dumps(other_entries))
