"""Models from files: bundled ones, .safetensors files, and ONNX networks."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from safetensors import SafetensorError

from async_tnt.checked_tensors import read_tensors
from async_tnt.checks import needs_extra, one_line
from async_tnt.config import TNTConfig
from async_tnt.networks.compiled import CompiledClassifier
from async_tnt.networks.conversion_check import TOLERANCE, compare
from async_tnt.networks.from_onnx import WAY_OUT, ends_in_softmax, input_type, layers_from_onnx
from async_tnt.networks.graph import CLASSIFIER, layer_shapes
from async_tnt.networks.model import FORMAT, Model, checksum_of
from async_tnt.networks.onnx_metadata import is_damaged, read_metadata
from async_tnt.networks.onnx_session import open_session

if TYPE_CHECKING:
    import onnx


def bundled_models() -> tuple[str, ...]:
    """Names that `load_model` knows without a path."""
    folder = resources.files("async_tnt") / "assets"
    names = (file.name for file in folder.iterdir())
    return tuple(sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors")))


def load_model(
    name_or_path: str | Path, *, config: TNTConfig | None = None, classes: Sequence[str] | None = None
) -> Model:
    """Load a bundled model by its name, such as "digits", any model file by its path, or an .onnx network.

    Parameters
    ----------
    name_or_path : one of `bundled_models()`, or the path of a .safetensors or .onnx file.
    config : how events become volumes, for an .onnx network of another program. Other files contain it.
    classes : class names in the order of the outputs, for the same networks; by default "0", "1", ...

    Returns
    -------
    Model.

    Raises
    ------
    FileNotFoundError : no such file and no such bundled model; the message lists the bundled names.
    ImportError : an .onnx network, and onnx is not installed.
    TypeError : `config` or `classes` for a model that has its own, or no `config` for a network that has none.
    NotImplementedError : names the first node of an .onnx network that has no compiled form; or its layers compute
        other numbers than onnxruntime (where that is not installed, a warning says that nothing was compared).
    ValueError : the file is damaged, needs a network that this release cannot run, or is not a model of this package.
    """
    if str(name_or_path) in bundled_models():
        path = Path(str(resources.files("async_tnt") / "assets" / f"{name_or_path}.safetensors"))
    else:
        path = Path(name_or_path)
        if not path.is_file():
            names = ", ".join(bundled_models())
            raise FileNotFoundError(f"no model file {path}, and no bundled model of that name (bundled: {names})")
    if path.suffix.lower() == ".onnx":
        return _load_onnx(path, config, classes)
    if config is not None or classes is not None:
        raise TypeError(f"`config` and `classes` are for .onnx networks; {path} has its own")
    try:
        with path.open("rb") as file:
            weights, metadata = read_tensors(file, FORMAT)
    except ValueError as error:
        raise ValueError(f"{path} is not a model that this release can read: {one_line(error)}") from None
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a readable .safetensors file: {one_line(error)}") from None
    try:
        return _model_of(weights, metadata)
    except NotImplementedError as error:
        raise ValueError(f"{path} holds a network that this release cannot run: {one_line(error)}") from None
    except (TypeError, ValueError, RecursionError) as error:  # the last: JSON nested too deep
        raise ValueError(f"{path} holds a damaged model: {one_line(error, 1000)}") from None


def _model_of(weights: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> Model:
    """The model in a file, checked; raises NotImplementedError for a network that this release cannot run."""
    missing = [name for name in ("config", "classes", "record", "network", "sha256") if name not in metadata]
    if missing:
        raise ValueError(f"no {' and no '.join(missing)} in its metadata")
    if metadata["sha256"] != checksum_of(weights, metadata):
        raise ValueError("its checksum differs; copy or download it again")
    for name, values in weights.items():
        if values.dtype != np.float32:
            raise ValueError(f"`{name}` must be float32, got {values.dtype}")
    classes, record, network = (json.loads(metadata[name]) for name in ("classes", "record", "network"))
    return Model(TNTConfig.from_dict(json.loads(metadata["config"])), weights, classes, record, network)


def _load_onnx(path: Path, config: TNTConfig | None, classes: Sequence[str] | None) -> Model:
    """See `load_model`."""
    with needs_extra("onnx", "ONNX networks are read by onnx"):
        import onnx
    content = path.read_bytes()
    try:
        proto = onnx.load(path)  # and weights in files beside it
        onnx.checker.check_model(proto)
        metadata = {entry.key: entry.value for entry in proto.metadata_props}
        exported = read_metadata(metadata)
    except Exception as error:  # of many types
        raise ValueError(f"{path} is not a readable ONNX network: {one_line(error)}") from None
    if exported is not None:
        if is_damaged(metadata, content):
            raise ValueError(f"{path} is damaged: its checksum differs; copy or download it again")
        if config is not None or classes is not None:
            raise TypeError(f"`config` and `classes` are for networks of other programs; {path} has its own")
        if exported.config.needs_regressor:
            raise NotImplementedError(f"{path} has a landmark network beside it: load the model it was exported from")
        config, classes = exported.config, exported.classes
    if config is None:
        raise TypeError(
            f"{path} does not say how events become its volume: load_model(path, config=TNTConfig(...), classes=[...])"
        )
    try:
        layers, weights = layers_from_onnx(proto, config.shape)
    except (NotImplementedError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from None
    if classes is None:
        shapes = layer_shapes(layers, config.shape, {name: w.shape for name, w in weights.items()})
        classes = [str(k) for k in range(list(shapes.values())[-1][0])]
    model = Model(config, weights, tuple(classes), exported.record if exported else {}, {CLASSIFIER: layers})
    try:
        _compare_with_onnxruntime(path, proto, model)
    except ImportError:
        warnings.warn(
            f"{path}: its layers were not compared with the network itself, as onnxruntime is not installed",
            stacklevel=3,  # the caller of `load_model`
        )
    except ValueError as error:
        raise NotImplementedError(f"{path} cannot be read as layers: {error}{WAY_OUT}") from None
    return model


def _compare_with_onnxruntime(path: Path, proto: onnx.ModelProto, model: Model) -> None:
    """Compare an ONNX network, run by onnxruntime, with the compiled layers that were read from it.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    ValueError : see `compare`; or onnxruntime cannot open the file.
    """
    session, (given,), *_ = open_session(str(path), str(path), 1)
    dtype, softmax = input_type(proto), ends_in_softmax(proto)
    n = given.shape[0] if given.shape and isinstance(given.shape[0], int) else 1  # some files fix a batch
    compiled = CompiledClassifier(model)

    def theirs(volume: np.ndarray) -> np.ndarray:
        answer: np.ndarray = session.run(None, {given.name: np.repeat(volume[None], n, 0).astype(dtype)})[0]
        return np.asarray(answer.reshape(n, -1)[0], np.float64)

    def ours(volume: np.ndarray) -> np.ndarray:
        logits = compiled(volume).astype(np.float64)
        odds = np.exp(logits - logits.max())
        return odds / odds.sum() if softmax else logits

    compare(theirs, ours, model.config.shape, max(TOLERANCE, 8 * float(np.finfo(dtype).eps)))
