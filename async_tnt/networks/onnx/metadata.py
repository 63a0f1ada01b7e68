"""The metadata of ONNX files that this package wrote, and their checksum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.models.model import FORMAT, FORMAT_OF_OUTPUTS, Model
from async_tnt.networks.models.model_file import parse_metadata, read_description
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    import onnx

CHECKSUM = "sha256"
"""The name of the metadata entry that holds the checksum of the whole file."""

BLANK = 64 * "0"
"""The text that takes the place of the checksum while the checksum is computed."""


@dataclass(frozen=True)
class Exported:
    """The Model that a network was exported from, without its weights."""

    config: TNTConfig
    classes: tuple[str, ...]
    record: Mapping[str, Any]
    layers: list[Layer]
    outputs: Mapping[str, str]
    by_share: bool


def metadata_of(model: Model) -> dict[str, str]:
    """The metadata of an exported model: the entries of a model file, with a blank checksum.

    `network` holds the classifier's layers only. They are needed to read the file again: ONNX nodes
    do not say which layer they belong to.
    """
    network = json.dumps(model.network[CLASSIFIER])
    return {**model.description(), "network": network, CHECKSUM: BLANK}


def seal(proto: onnx.ModelProto) -> None:
    """Write the checksum of all of a file's bytes into its metadata."""
    (entry,) = [entry for entry in proto.metadata_props if entry.key == CHECKSUM]
    entry.value = BLANK
    entry.value = _checksum(proto.SerializeToString(), BLANK)


def _checksum(content: bytes, written_checksum: str) -> str:
    """The checksum of a file's bytes, computed with `BLANK` in place of the written checksum."""
    blanked = content.replace(written_checksum.encode(), BLANK.encode())
    return hashlib.sha256(blanked).hexdigest()


def read_metadata(metadata: Mapping[str, str], content: bytes) -> Exported | None:
    """The model that a file was exported from; None if another program wrote the file.

    Parameters
    ----------
    metadata : the metadata of the file, by name.
    content : all bytes of the file.

    Raises
    ------
    ValueError : this package wrote the file, but in another version of the format; or the file has
        changed since `seal` wrote its checksum.
    """
    file_format = metadata.get("format", "")
    if not file_format.startswith(FORMAT.split()[0] + " "):
        return None
    if file_format not in (FORMAT, FORMAT_OF_OUTPUTS):
        expected = f"{FORMAT!r} or {FORMAT_OF_OUTPUTS!r}"
        raise ValueError(f"metadata `format` must be {expected}, got {file_format!r}")
    try:
        config, classes, record, outputs, by_share = read_description(metadata, CHECKSUM)
        layers = parse_metadata({"network": metadata.get("network", "")}, "network")
    except TypeError as error:
        raise ValueError(str(error)) from None

    is_list = isinstance(classes, list) and bool(classes or outputs)
    if not is_list or not all(isinstance(name, str) for name in classes):
        raise ValueError(f"metadata `classes` must be a list of names, got {metadata['classes']!r}")
    if not isinstance(record, dict):
        raise ValueError(f"metadata `record` must be a mapping, got {metadata['record']!r}")
    if not isinstance(outputs, dict):
        raise ValueError(
            f"metadata `outputs` must map names to layers, got {metadata['outputs']!r}"
        )
    if not isinstance(layers, list):
        raise ValueError(
            f"metadata `network` must be a list of layers, got {metadata['network']!r}"
        )
    if metadata[CHECKSUM] != _checksum(content, metadata[CHECKSUM]):
        raise ValueError(
            "its checksum differs; copy or export it again (where another program has changed it, "
            "remove `format` from its metadata)"
        )
    return Exported(config, tuple(classes), record, layers, outputs, by_share)
