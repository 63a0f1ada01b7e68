"""The metadata of an exported network: a Model's configuration, classes, record and checksums."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from async_tnt.checked_tensors import checksum
from async_tnt.config import TNTConfig
from async_tnt.networks.graph import CLASSIFIER, REGRESSOR
from async_tnt.networks.model import FORMAT, Model

if TYPE_CHECKING:
    import onnx

BLANK = 64 * "0"  # in place of the checksum while it is computed


@dataclass(frozen=True)
class Exported:
    """The Model that a network was exported from, without its weights."""

    network: str
    """Which of its networks: `classifier` or `regressor`."""
    config: TNTConfig
    classes: tuple[str, ...]
    record: Mapping[str, Any]
    weights: str
    """The hash of all its weights: two files of the same model agree in it."""


def metadata_of(model: Model, network: str) -> dict[str, str]:
    """What `read_metadata` reads, as strings, which ONNX requires.

    Raises
    ------
    TypeError : the record holds something that JSON cannot represent.
    """
    return {
        "format": FORMAT,
        "network": network,
        "config": json.dumps(model.config.to_dict()),
        "classes": json.dumps(model.classes),
        "record": json.dumps(model.record),
        "weights": checksum(model.weights, ""),
        "sha256": BLANK,
    }


def seal(made: onnx.ModelProto) -> None:
    """Write the checksum of all of a file's bytes into its metadata."""
    (entry,) = (entry for entry in made.metadata_props if entry.key == "sha256")
    entry.value = BLANK
    entry.value = _checksum(made.SerializeToString(), BLANK)


def is_damaged(metadata: Mapping[str, str], content: bytes) -> bool:
    """Whether a file of ours differs from what `seal` wrote."""
    return metadata["sha256"] != _checksum(content, metadata["sha256"])


def _checksum(content: bytes, sha256: str) -> str:
    return hashlib.sha256(content.replace(sha256.encode(), BLANK.encode())).hexdigest()


def read_metadata(metadata: Mapping[str, str]) -> Exported | None:
    """A file's metadata; None where another program wrote the file.

    Raises
    ------
    ValueError : our file, but of another version, or damaged.
    """
    written = metadata.get("format", "")
    if not written.startswith(FORMAT.split()[0] + " "):
        return None
    if written != FORMAT:
        raise ValueError(f"metadata `format` must be {FORMAT!r}, got {written!r}")
    needed = ("network", "config", "classes", "record", "weights", "sha256")
    missing = [name for name in needed if name not in metadata]
    if missing:
        raise ValueError(f"no {' and no '.join(missing)} in its metadata")
    if metadata["network"] not in (CLASSIFIER, REGRESSOR):
        raise ValueError(f"metadata `network` must be {CLASSIFIER} or {REGRESSOR}, got {metadata['network']!r}")
    try:
        config = TNTConfig.from_dict(json.loads(metadata["config"]))
        classes, record = json.loads(metadata["classes"]), json.loads(metadata["record"])
    except (TypeError, RecursionError) as error:  # the last: JSON nested too deep
        raise ValueError(str(error)) from None
    if not (isinstance(classes, list) and classes and all(isinstance(name, str) for name in classes)):
        raise ValueError(f"metadata `classes` must be a list of names, got {metadata['classes']!r}")
    if not isinstance(record, dict):
        raise ValueError(f"metadata `record` must be a mapping, got {metadata['record']!r}")
    return Exported(metadata["network"], config, tuple(classes), record, metadata["weights"])
