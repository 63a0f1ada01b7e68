"""Model: a configuration, a network's weights and its class names, in one .safetensors file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from .config import TNTConfig

FORMAT = "async_tnt 1"
LAYERS = ("conv1", "conv2", "fc1", "fc2")


@dataclass(frozen=True)
class Model:
    """What a trained classifier needs: how events become a volume, and what becomes of the volume.

    Parameters
    ----------
    config : TNTConfig.
    weights : float32 arrays `conv1.weight` (F1, C, 3, 3), `conv2.weight` (F2, F1, 3, 3), `fc1.weight`
        (F3, F2 * (H // 4) * (W // 4)), `fc2.weight` (n_classes, F3), and a `.bias` for each.
    classes : names, in the order of the network's outputs.
    record : how it was trained: data, seed, accuracy, what was tried.

    Raises
    ------
    ValueError : weights are missing, or their shapes do not fit each other, the configuration or `classes`.
    """

    config: TNTConfig
    weights: Mapping[str, np.ndarray]
    classes: tuple[str, ...]
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "classes", tuple(str(name) for name in self.classes))
        weights = {name: np.ascontiguousarray(w, np.float32) for name, w in self.weights.items()}
        object.__setattr__(self, "weights", weights)
        _check_weights(weights, self.config, self.classes)

    def save(self, path: str | Path) -> Path:
        """Write the model to a .safetensors file; returns its path. An existing file is replaced at once."""
        path = Path(path)
        metadata = {
            "format": FORMAT,
            "config": json.dumps(self.config.to_dict()),
            "classes": json.dumps(self.classes),
            "record": json.dumps(self.record),
        }
        part = path.with_name(path.name + ".part")
        save_file(dict(self.weights), part, metadata=metadata)
        part.replace(path)
        return path


def bundled_models() -> tuple[str, ...]:
    """Names that `load_model` knows without a path."""
    folder = resources.files("async_tnt") / "assets"
    return tuple(sorted(f.name.removesuffix(".safetensors") for f in folder.iterdir() if f.name.endswith(".safetensors")))


def load_model(name_or_path: str | Path) -> Model:
    """A bundled model by its name, such as "digits", or any model file by its path.

    Raises
    ------
    FileNotFoundError : neither; the message lists the bundled names.
    ValueError : the file is damaged, or no model of this package.
    """
    if str(name_or_path) in bundled_models():
        path = Path(str(resources.files("async_tnt") / "assets" / f"{name_or_path}.safetensors"))
    else:
        path = Path(name_or_path)
        if not path.is_file():
            names = ", ".join(bundled_models())
            raise FileNotFoundError(f"no model file {path}, and no bundled model of that name (bundled: {names})")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a readable .safetensors file: {error}") from None
    if metadata.get("format") != FORMAT:
        raise ValueError(
            f"{path} is not a model of this package: metadata `format` must be {FORMAT!r}, "
            f"got {metadata.get('format')!r}"
        )
    try:
        config = TNTConfig.from_dict(json.loads(metadata["config"]))
        classes: Sequence[str] = json.loads(metadata["classes"])
        return Model(config, weights, tuple(classes), json.loads(metadata.get("record", "{}")))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds a damaged model: {error}") from None


def _check_weights(weights: Mapping[str, np.ndarray], config: TNTConfig, classes: tuple[str, ...]) -> None:
    names = {f"{layer}.{kind}" for layer in LAYERS for kind in ("weight", "bias")}
    if set(weights) != names:
        raise ValueError(f"`weights` must hold {', '.join(sorted(names))}, got {', '.join(sorted(weights))}")
    channels, height, width = config.shape
    if height < 4 or width < 4:
        raise ValueError(f"`grid` must be at least (4, 4) for two 2x2 poolings, got {config.grid}")
    f1, f2 = weights["conv1.weight"].shape[0], weights["conv2.weight"].shape[0]
    f3 = weights["fc1.weight"].shape[0]
    expected = {
        "conv1.weight": (f1, channels, 3, 3),
        "conv2.weight": (f2, f1, 3, 3),
        "fc1.weight": (f3, f2 * (height // 2 // 2) * (width // 2 // 2)),
        "fc2.weight": (len(classes), f3),
    }
    for name, shape in expected.items():
        bias = name.replace("weight", "bias")
        for key, want in ((name, shape), (bias, shape[:1])):
            if weights[key].shape != want:
                raise ValueError(f"`{key}` must have shape {want} here, got {weights[key].shape}")
        if not (np.isfinite(weights[name]).all() and np.isfinite(weights[bias]).all()):
            raise ValueError(f"`{name}` and its bias must be finite numbers")
