"""What runs a model's networks: the compiled ones or, of an .onnx file, onnxruntime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from async_tnt.base.checks import one_line, parse_json, short
from async_tnt.base.files import read_regular, user_path
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.model import Model
from async_tnt.networks.onnx.network import OnnxClassifier
from async_tnt.volume.config import TNTConfig


@dataclass(frozen=True)
class Engine:
    """A model as a `Processor` takes it. Without `classifier`, a Model runs its own networks."""

    model: Model | TNTConfig
    classes: Sequence[str]
    classifier: OnnxClassifier | None = None


def choose_engine(
    name_or_path: str | Path, map_sensor: tuple[int, int] | None = None, config: Path | None = None
) -> Engine:
    """A model, and the engine that runs its networks: `compiled` (Numba), or `onnx` for an .onnx
    file.

    Parameters
    ----------
    name_or_path : as for `load_model`, or an .onnx file that `async-tnt export` wrote.
    map_sensor : (width, height), what a map model is to be used for, see `Model.for_sensor`. Other
        models have theirs.
    config : for an .onnx file of another program: a JSON file with the fields of a `TNTConfig` as
        `config`, and optionally `classes`, as `async-tnt info` prints them of a model.

    Raises
    ------
    ImportError : an .onnx file, and onnxruntime is not installed.
    FileNotFoundError : no such file.
    ValueError : the file is damaged; an .onnx file of another program without `config`, or `config`
        for another model.
    """
    if config is not None:
        return _of_other_program(user_path(name_or_path), config)
    if is_onnx(name_or_path):
        classifier = OnnxClassifier(name_or_path)
        if classifier.exported is None:
            raise ValueError(
                f"{name_or_path}: an ONNX network without a configuration of this package, which "
                "defines how events "
                "become its volume; give one, `config`: a file of what `async-tnt info` prints of "
                "a model as JSON"
            )
        return Engine(classifier.exported.config, classifier.exported.classes, classifier)
    model = load_model(name_or_path)
    if map_sensor is not None and model.places is not None:
        model = model.for_sensor(map_sensor)
    return Engine(model, model.classes)


def is_onnx(name_or_path: str | Path) -> bool:
    """Whether the suffix is .onnx, in upper or lower case."""
    return Path(name_or_path).suffix.lower() == ".onnx"


def _of_other_program(path: Path, config: Path) -> Engine:
    """The compiled form of another program's network, where it has one; else onnxruntime."""
    if not is_onnx(path):
        raise ValueError(f"`config` is for .onnx files of other programs; {path} has its own")
    try:
        given = parse_json(read_regular(config))
        if not isinstance(given, dict) or "config" not in given:
            raise ValueError(f"no 'config' in it, got {short(given)}")
        volume = TNTConfig.from_dict(given["config"])
        classes = given.get("classes")
        if classes is not None and not (
            isinstance(classes, list) and 0 < len(set(map(str, classes))) == len(classes)
        ):
            raise ValueError(f"`classes` must be different names, got {short(classes)}")
    except (ValueError, TypeError) as error:
        what = one_line(error)
        raise ValueError(
            f'{config}: expected a JSON object with "config", and maybe "classes": {what}'
        ) from None
    try:
        model = load_model(path, config=volume, classes=classes)
    except TypeError as error:  # the file has its own
        raise ValueError(one_line(error)) from None
    except NotImplementedError:
        network = OnnxClassifier(_of_logits(path), shape=volume.shape)
        names = list(map(str, range(network.n_classes) if classes is None else classes))
        if len(names) != network.n_classes:
            raise ValueError(
                f"{config}: {len(names)} classes, but {path} computes {network.n_classes}"
            ) from None
        return Engine(volume, names, network)
    return Engine(model, model.classes)


def _of_logits(path: Path) -> Any:
    """The file or, if a softmax ends its network, the network with its logarithm, which are logits
    of the same."""
    import onnx

    proto = onnx.load(path)
    ends = [
        node
        for node in proto.graph.node
        if list(node.output) == [output.name for output in proto.graph.output]
    ]
    if not ends or ends[0].op_type != "Softmax":
        return path
    ends[0].op_type = "LogSoftmax"
    return proto
