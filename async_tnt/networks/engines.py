"""Which engine runs a model's networks: what `engine` of `async-tnt run` chooses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from async_tnt.checks import needs_extra
from async_tnt.config import TNTConfig
from async_tnt.networks.loading import load_model
from async_tnt.networks.model import Model
from async_tnt.networks.onnx_export import to_onnx
from async_tnt.networks.onnx_network import OnnxClassifier
from async_tnt.networks.torch_modules import TorchClassifier, landmark_function, torch_classifier

ENGINES = ("compiled", "onnx", "torch")


@dataclass(frozen=True)
class Engine:
    """A model's configuration and classes, and what runs its networks."""

    name: str
    model: Model | TNTConfig
    classes: Sequence[str]
    networks: dict[str, Any] = field(default_factory=dict)
    """Arguments of a `Processor`: `classifier` and, where the configuration needs one, `regressor`; none for a Model
    that runs its own."""

    @property
    def finds_objects(self) -> bool:
        """Whether its answers are objects, and not a class of a window."""
        if isinstance(self.model, Model):
            return self.model.places is not None
        return len(self.networks["classifier"].logits_shape) == 3

    @property
    def config(self) -> TNTConfig:
        """How events become the volumes that the networks read."""
        return self.model.config if isinstance(self.model, Model) else self.model


def choose_engine(
    name_or_path: str | Path, engine: str | None = None, map_sensor: tuple[int, int] | None = None
) -> Engine:
    """A model, and the engine that runs its networks.

    Parameters
    ----------
    name_or_path : as for `load_model`, or an .onnx file that `async-tnt export` wrote.
    engine : `compiled` (Numba; by default), `onnx` (the classifier, exported in memory, by onnxruntime) or `torch` (the
        reference networks). An .onnx file runs by `onnx`, and only by it.
    map_sensor : (width, height), what a map model is to be used for, see `Model.for_sensor`. Other models have theirs.

    Raises
    ------
    ImportError : the engine is not installed.
    FileNotFoundError : no such file.
    ValueError : the file is damaged, or an .onnx file of another program, which lacks the configuration.
    """
    if engine not in (*ENGINES, None):
        raise ValueError(f"`engine` must be one of {', '.join(ENGINES)}, got {engine!r}")
    if is_onnx(name_or_path):
        if engine not in ("onnx", None):
            raise ValueError(
                f"{name_or_path}: an .onnx file runs with engine onnx, not {engine}, which needs the .safetensors file "
                "or bundled model it was exported from"
            )
        return _of_file(Path(name_or_path))
    model = load_model(name_or_path)
    if map_sensor is not None and model.places is not None:
        model = model.for_sensor(map_sensor)
    if engine == "onnx":
        return Engine("onnx", model, model.classes, {"classifier": OnnxClassifier(to_onnx(model))})
    if engine == "torch":
        return Engine("torch", model, model.classes, _torch_networks(model))
    return Engine("compiled", model, model.classes)


def is_onnx(name_or_path: str | Path) -> bool:
    """Whether the suffix is .onnx, in upper or lower case."""
    return Path(name_or_path).suffix.lower() == ".onnx"


def _of_file(path: Path) -> Engine:
    classifier = OnnxClassifier(path)
    if classifier.exported is None:
        raise ValueError(
            f"{path}: an ONNX network without a configuration of this package, which defines how events become its "
            "volume; a Python program can provide one: Processor(TNTConfig(...), classifier=OnnxClassifier(path))"
        )
    return Engine("onnx", classifier.exported.config, classifier.exported.classes, {"classifier": classifier})


def _torch_networks(model: Model) -> dict[str, Any]:
    with needs_extra("reference", "engine torch runs the reference network, which needs torch"):
        import tnt_reference  # noqa: F401
        import torch  # noqa: F401
    networks: dict[str, Any] = {"classifier": TorchClassifier(torch_classifier(model), places=model.places)}
    if model.config.needs_regressor:
        networks["regressor"] = landmark_function(model)
    return networks
