"""The engine that runs a model's networks: compiled code or, for an .onnx file, onnxruntime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.files import read_regular, user_path
from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line, short
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.model import Model
from async_tnt.networks.onnx.network import OnnxClassifier, has_raw_outputs
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class Engine:
    """A model and the classifier that runs it, as a `Processor` takes them.

    Parameters
    ----------
    model : a Model, whose networks are compiled; or, where there is a `classifier`, the
        configuration of the volumes that the classifier reads.
    classes : the class names.
    classifier : the classifier of an .onnx file, run by onnxruntime; None for a Model.
    """

    model: Model | TNTConfig
    classes: Sequence[str]
    classifier: OnnxClassifier | None = None

    @property
    def config(self) -> TNTConfig:
        """How events become the volumes that the classifier reads."""
        return self.model if isinstance(self.model, TNTConfig) else self.model.config


def choose_engine(
    name_or_path: str | Path, map_sensor: tuple[int, int] | None = None, config: Path | None = None
) -> Engine:
    """The engine that runs a model's networks, together with the model.

    The networks of a model file run compiled. That of an .onnx file runs in onnxruntime, with two
    exceptions that run compiled: a network of raw outputs, and a network of another program whose
    nodes all have a compiled form.

    Parameters
    ----------
    name_or_path : a model, see `load_model`, or an .onnx file that `async-tnt export` wrote.
    map_sensor : (width, height) of the sensor that a map model is used for, see
        `Model.for_sensor`. Other models have a sensor of their own.
    config : the path of a JSON file, needed for an .onnx file of another program. Its `config`
        holds the fields of a `TNTConfig`. Its `classes`, which may be missing, are the class
        names. `async-tnt info` prints both for a model.

    Raises
    ------
    ImportError : the file is an .onnx file, and onnxruntime is not installed.
    FileNotFoundError : the file does not exist.
    ValueError : the file is damaged; or `config` is missing for an .onnx file of another program;
        or `config` is given for a file that contains its own configuration.
    """
    if config is not None:
        return _engine_of_other_program(user_path(name_or_path), config)
    if is_onnx(name_or_path) and not has_raw_outputs(user_path(name_or_path)):
        classifier = OnnxClassifier(name_or_path)
        if classifier.exported is None:
            raise ParameterValueError(
                "config",
                f"must be given for {name_or_path}, an ONNX network of another program, which does "
                "not say how events become its volume: a file of what `async-tnt info` prints of a "
                "model as JSON",
            )
        return Engine(classifier.exported.config, classifier.exported.classes, classifier)
    model = load_model(name_or_path)
    if map_sensor is not None and model.places is not None:
        model = model.for_sensor(map_sensor)
    return Engine(model, model.classes)


def is_onnx(name_or_path: str | Path) -> bool:
    """Whether a name or path ends in .onnx, in upper or lower case."""
    return Path(name_or_path).suffix.lower() == ".onnx"


def _engine_of_other_program(path: Path, config: Path) -> Engine:
    """The engine of another program's network.

    The network runs compiled if all of its nodes have a compiled form, otherwise in onnxruntime.
    """
    if not is_onnx(path):
        rule = f"is for .onnx files of other programs; {path} has its own"
        raise ParameterValueError("config", rule)
    volume_config, classes = _read_config(config)
    try:
        model = load_model(path, config=volume_config, classes=classes)
    except TypeError:  # the file contains a configuration, so this package wrote it
        rule = f"is for networks of other programs; {path} has its own"
        raise ParameterValueError("config", rule) from None
    except NotImplementedError:
        return _engine_of_onnxruntime(path, config, volume_config, classes)
    return Engine(model, model.classes)


def _read_config(path: Path) -> tuple[TNTConfig, list[str] | None]:
    """The configuration in a JSON file, and the class names if it has some.

    Raises
    ------
    ValueError : the content of the file is wrong. The message names the file and what is wrong.
    """
    try:
        content = parse_json(read_regular(path))
        if not isinstance(content, dict) or "config" not in content:
            raise ValueError(f"no 'config' in it, got {short(content)}")
        config = TNTConfig.from_dict(content["config"])
        classes = content.get("classes")
        if classes is not None and not _are_different_names(classes):
            raise ValueError(f"`classes` must be different names, got {short(classes)}")
    except (ValueError, TypeError) as error:
        raise ValueError(
            f'{path}: expected a JSON object with "config", and maybe "classes": {one_line(error)}'
        ) from None
    return config, classes


def _are_different_names(classes: Any) -> bool:
    """Whether the value is a list of at least one name, without repeated names."""
    if not isinstance(classes, list) or not classes:
        return False
    return len({str(name) for name in classes}) == len(classes)


def _engine_of_onnxruntime(
    path: Path, config: Path, volume_config: TNTConfig, classes: list[str] | None
) -> Engine:
    """The engine of a network without compiled form, which onnxruntime runs."""
    network = OnnxClassifier(_network_of_logits(path), shape=volume_config.shape)
    names = [str(k) for k in range(network.n_classes)]
    if classes is not None:
        names = [str(name) for name in classes]
    if len(names) != network.n_classes:
        raise ValueError(f"{config}: {len(names)} classes, but {path} computes {network.n_classes}")
    return Engine(volume_config, names, network)


def _network_of_logits(path: Path) -> Any:
    """A network whose output is logits: the path itself if no softmax ends the file's network.

    Otherwise the network is returned with a LogSoftmax in place of the softmax. Its output can
    serve as logits: the softmax of this output is the output of the file's network.
    """
    import onnx

    proto = onnx.load(path)
    outputs = [output.name for output in proto.graph.output]
    for node in proto.graph.node:
        if list(node.output) == outputs and node.op_type == "Softmax":
            node.op_type = "LogSoftmax"
            return proto
    return path
