"""Model: a configuration, a network's weights and its class names, in one .safetensors file."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError

from async_tnt.checked_tensors import checksum, read_tensors, tensor_bytes
from async_tnt.checks import one_line, plain_array
from async_tnt.config import TNTConfig
from async_tnt.files import replacing
from async_tnt.networks.layer_graph import check_layer_graph, layer_graph

FORMAT = "async_tnt 2"
UNCHECKED_FORMAT = "async_tnt 1"  # the one before, without a checksum
LAYERS = ("conv1", "conv2", "fc1", "fc2")
REGRESSOR_LAYERS = ("regressor.conv1", "regressor.conv2", "regressor.conv3")
HEATMAP = "regressor.heatmap.weight"  # no bias: it would not move the centroid
REGRESSOR_HINT = '; those of the regressor belong to landmark="regressor" with transform="tnt", and only to that'


class UncheckedModelWarning(UserWarning):
    """A model file has no checksum, so damage to its weights cannot be detected."""


@dataclass(frozen=True, eq=False)  # arrays have no single answer to ==
class Model:
    """A trained classifier: how events become a volume, and the weights of the network that reads it.

    Parameters
    ----------
    config : TNTConfig.
    weights : float32 arrays `conv1.weight` (F1, C, 3, 3), `conv2.weight` (F2, F1, 3, 3), `fc1.weight`
        (F3, F2 * (H // 4) * (W // 4)), `fc2.weight` (n_classes, F3), and a `.bias` for each. With landmark
        "regressor" (and transform "tnt"), and then only, its network, too: `regressor.conv1.weight`
        (G1, C, 3, 3), `regressor.conv2.weight` (G2, G1, 3, 3), `regressor.conv3.weight` (G3, G2, 3, 3), a
        `.bias` for each, and `regressor.heatmap.weight` (1, G3, 1, 1).
    classes : names, in the order of the network's outputs.
    record : how it was trained: data, seed, accuracy, what was tried.

    Raises
    ------
    ValueError, TypeError : weights are missing or not finite numbers, or their shapes do not fit each other,
        the configuration or `classes`.
    """

    config: TNTConfig
    weights: Mapping[str, np.ndarray]
    classes: tuple[str, ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.classes, (tuple, list)):
            raise TypeError(f"`classes` must be a tuple or list of names, got {self.classes!r}")
        if not isinstance(self.record, Mapping):
            raise TypeError(f"`record` must be a mapping, got {self.record!r}")
        object.__setattr__(self, "classes", tuple(str(name) for name in self.classes))
        weights = {name: _float32(name, w) for name, w in self.weights.items()}
        object.__setattr__(self, "weights", weights)
        _check_weights(weights, self.config, self.classes)

    def save(self, path: str | Path) -> Path:
        """Write the model to a .safetensors file; returns its path.

        An existing file is replaced in one step when the new one is complete, and kept if that fails.

        Raises
        ------
        OSError : the file cannot be written, or its path is not that of a regular file.
        TypeError : the record holds something that JSON cannot represent.
        """
        path = Path(path)
        metadata = {
            "format": FORMAT,
            "config": json.dumps(self.config.to_dict()),
            "classes": json.dumps(self.classes),
            "record": json.dumps(self.record),
            "network": json.dumps(layer_graph(self.config)),
        }
        metadata["sha256"] = _checksum(self.weights, metadata)
        content = tensor_bytes(self.weights, metadata)
        with replacing(path) as part:
            part.write_bytes(content)
        return path


def bundled_models() -> tuple[str, ...]:
    """Names that `load_model` knows without a path."""
    folder = resources.files("async_tnt") / "assets"
    names = (file.name for file in folder.iterdir())
    return tuple(sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors")))


def load_model(name_or_path: str | Path) -> Model:
    """Load a bundled model by its name, such as "digits", or any model file by its path.

    Raises
    ------
    FileNotFoundError : neither; the message lists the bundled names.
    ValueError : the file is damaged, needs a network that this release cannot run, or is not a model of this package.

    Warns
    -----
    UncheckedModelWarning : the file has format 1, which has no checksum.
    """
    if str(name_or_path) in bundled_models():
        path = Path(str(resources.files("async_tnt") / "assets" / f"{name_or_path}.safetensors"))
    else:
        path = Path(name_or_path)
        if not path.is_file():
            names = ", ".join(bundled_models())
            raise FileNotFoundError(f"no model file {path}, and no bundled model of that name (bundled: {names})")
    try:
        with path.open("rb") as file:
            weights, metadata = read_tensors(file, (FORMAT, UNCHECKED_FORMAT))
    except ValueError as error:
        raise ValueError(f"{path} is not a model that this release can read: {one_line(error)}") from None
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a readable .safetensors file: {one_line(error)}") from None
    try:
        model = _model_of(weights, metadata)
    except NotImplementedError as error:
        raise ValueError(f"{path} holds a network that this release cannot run: {one_line(error)}") from None
    except (TypeError, ValueError, RecursionError) as error:  # the last: JSON nested too deep
        raise ValueError(f"{path} holds a damaged model: {one_line(error, 1000)}") from None
    if metadata["format"] == UNCHECKED_FORMAT:
        warnings.warn(
            f"{path} has no checksum, so damage to it would go unnoticed; load_model(path).save(path) adds one",
            UncheckedModelWarning,
            stacklevel=2,
        )
    return model


def _model_of(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> Model:
    """The model in a file, checked; raises NotImplementedError for a network that only another release can run."""
    checked = metadata["format"] == FORMAT
    needed = ("config", "classes", "record", "network", "sha256") if checked else ("config", "classes")
    missing = [name for name in needed if name not in metadata]
    if missing:
        raise ValueError(f"no {' and no '.join(missing)} in its metadata")
    if checked and metadata["sha256"] != _checksum(weights, metadata):
        raise ValueError("its checksum differs; copy or download it again")
    if not checked and ("sha256" in metadata or "network" in metadata):
        raise ValueError(f"its `format` must be {FORMAT!r}, as it has a checksum, got {UNCHECKED_FORMAT!r}")
    for name, values in weights.items():
        if values.dtype != np.float32:
            raise ValueError(f"`{name}` must be float32, got {values.dtype}")
    config = TNTConfig.from_dict(json.loads(metadata["config"]))
    if checked:
        check_layer_graph(json.loads(metadata["network"]), config)
    return Model(config, weights, json.loads(metadata["classes"]), json.loads(metadata.get("record", "{}")))


def _checksum(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """Of the weights and all metadata other than itself."""
    return checksum(weights, json.dumps({name: metadata[name] for name in sorted(metadata) if name != "sha256"}))


def _float32(name: str, values: Any) -> np.ndarray:
    array = plain_array(name, values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"`{name}` must be an array of numbers, got {array.dtype}")
    with np.errstate(over="ignore"):  # becomes inf, which `_check_weights` refuses
        return np.ascontiguousarray(array, np.float32).copy()  # a copy: the given one may change


def _check_weights(weights: Mapping[str, np.ndarray], config: TNTConfig, classes: tuple[str, ...]) -> None:
    names = {f"{layer}.{kind}" for layer in LAYERS for kind in ("weight", "bias")}
    if config.needs_regressor:
        names |= {f"{layer}.{kind}" for layer in REGRESSOR_LAYERS for kind in ("weight", "bias")} | {HEATMAP}
    if set(weights) != names:
        wrong = set(weights) ^ names
        hint = REGRESSOR_HINT if any(name.startswith("regressor.") for name in wrong) else ""
        raise ValueError(f"`weights` must hold {', '.join(sorted(names))}, got {', '.join(sorted(weights))}{hint}")
    channels, height, width = config.shape
    if height < 4 or width < 4:
        raise ValueError(f"`grid` must be at least (4, 4) for two 2x2 poolings, got {config.grid}")
    if not classes:
        raise ValueError("`classes` must hold at least one name")
    f1, f2, f3 = _widths(weights, ("conv1", "conv2", "fc1"))
    expected = {
        "conv1.weight": (f1, channels, 3, 3),
        "conv2.weight": (f2, f1, 3, 3),
        "fc1.weight": (f3, f2 * (height // 2 // 2) * (width // 2 // 2)),
        "fc2.weight": (len(classes), f3),
    }
    if config.needs_regressor:
        g1, g2, g3 = _widths(weights, REGRESSOR_LAYERS)
        expected |= {
            "regressor.conv1.weight": (g1, channels, 3, 3),
            "regressor.conv2.weight": (g2, g1, 3, 3),
            "regressor.conv3.weight": (g3, g2, 3, 3),
            HEATMAP: (1, g3, 1, 1),
        }
    for name, shape in expected.items():
        _check_array(weights, name, shape)
        bias = name.replace("weight", "bias")
        if bias in names:
            _check_array(weights, bias, shape[:1])
        if not all(np.isfinite(weights[key]).all() for key in {name, bias} & names):
            raise ValueError(f"`{name}`{' and its bias' if bias in names else ''} must be finite numbers")


def _widths(weights: Mapping[str, np.ndarray], layers: tuple[str, ...]) -> tuple[int, ...]:
    widths = tuple(weights[f"{layer}.weight"].shape[0] for layer in layers)
    if 0 in widths:
        raise ValueError(f"every layer must have at least one filter or unit, got widths {widths}")
    return widths


def _check_array(weights: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...]) -> None:
    if weights[name].shape != shape:
        raise ValueError(f"`{name}` must have shape {shape} here, got {weights[name].shape}")
