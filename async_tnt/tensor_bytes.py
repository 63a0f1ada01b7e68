"""Tensors and metadata as the bytes of a .safetensors file: the same ones for the same content."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from safetensors.numpy import save

ALIGNMENT = 8


def tensor_bytes(tensors: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> bytes:
    """`safetensors.numpy.save`, but for the metadata's order, which is another one there at each call.

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
