"""Models from files: bundled ones, .safetensors files, and ONNX networks (`from_onnx`)."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError

from async_tnt.base.files import refuse_git_lfs, user_path
from async_tnt.base.messages import one_line
from async_tnt.networks.models.model import FORMATS, Model
from async_tnt.networks.models.model_file import (
    checksum_of,
    parse_metadata,
    read_description,
    read_tensors,
)
from async_tnt.networks.onnx.from_onnx import load_onnx
from async_tnt.networks.teaching.statistics import STATISTICS_PREFIX, read_statistics
from async_tnt.volume.config import TNTConfig

SUFFIX = ".safetensors"
"""The end of a model file's name."""


def bundled_models() -> tuple[str, ...]:
    """The names that `load_model` knows without a path."""
    names = []
    for file in _bundled_folder().iterdir():
        if file.name.endswith(SUFFIX):
            names.append(file.name.removesuffix(SUFFIX))
    return tuple(sorted(names))


def _bundled_folder() -> Traversable:
    return resources.files("async_tnt") / "assets"


def load_model(
    name_or_path: str | Path,
    *,
    config: TNTConfig | None = None,
    classes: Sequence[str] | None = None,
    **spiking: Any,
) -> Model:
    """Load a bundled model by its name, such as "digits", or any model by the path of its file.

    The file is a model file, an .onnx network or a .nir graph.

    Parameters
    ----------
    name_or_path : one of `bundled_models()`, or the path of a .safetensors, .onnx or .nir file;
        `~` is the home folder.
    config : how events become volumes, for an .onnx network of another program. Other files contain
        their configuration.
    classes : class names in the order of the logits, for an .onnx network of another program.
        Without them the model has raw outputs, with the names that they have in the file. Also for
        a .nir graph.
    spiking : the other parameters of `Model.from_nir`, for a .nir graph.

    Returns
    -------
    Model.

    Raises
    ------
    FileNotFoundError : there is no such file and no such bundled model. The message lists the
        bundled names.
    ImportError : the file is an .onnx network, and onnx or onnxruntime is not installed.
    TypeError : `config` or `classes` is given, but the file contains its own; or `config` is
        missing, and the file contains no configuration.
    NotImplementedError : a node of an .onnx network has no compiled form, and the message names the
        first such node; or the compiled layers compute other numbers than onnxruntime.
    ValueError : the file is damaged; or it is a pointer of Git LFS; or it holds a network that this
        release cannot run; or it is not a model of this package.
    """
    if str(name_or_path) in bundled_models():
        path = Path(str(_bundled_folder() / f"{name_or_path}{SUFFIX}"))
    else:
        path = user_path(name_or_path)
        if not path.is_file():
            names = ", ".join(bundled_models())
            raise FileNotFoundError(
                f"no model file {path}, and no bundled model of that name (bundled: {names})"
            )
        refuse_git_lfs(path)
    if path.suffix.lower() == ".nir":
        if config is not None:
            raise TypeError("`config` is for .onnx networks; a .nir graph says what it reads")
        return Model.from_nir(path, classes=classes, **spiking)
    if spiking:
        raise TypeError(f"`{next(iter(spiking))}` is for .nir graphs, got {path}")
    if path.suffix.lower() == ".onnx":
        return load_onnx(path, config, classes)
    if config is not None or classes is not None:
        raise TypeError(f"`config` and `classes` are for .onnx networks; {path} has its own")
    return _read_model(path)


def _read_model(path: Path) -> Model:
    """The model in a .safetensors file."""
    try:
        tensors, metadata = read_tensors(path, FORMATS)
    except ValueError as error:
        raise ValueError(
            f"{path} is not a model that this release can read: {one_line(error)}"
        ) from None
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} is not a readable .safetensors file: {one_line(error)}") from None
    try:
        return _checked_model(tensors, metadata)
    except NotImplementedError as error:
        raise ValueError(
            f"{path} holds a network that this release cannot run: {one_line(error)}"
        ) from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path} holds a damaged model: {one_line(error, 1000)}") from None


def _checked_model(tensors: dict[str, np.ndarray], metadata: dict[str, str]) -> Model:
    """The model of a file's tensors and metadata.

    Raises
    ------
    ValueError, TypeError : they are not what `save` wrote.
    NotImplementedError : this release cannot run a layer.
    """
    file_checksum = metadata.get("sha256")
    if file_checksum is not None and file_checksum != checksum_of(tensors, metadata):
        raise ValueError("its checksum differs; copy or download it again")
    description = read_description(metadata, "network", "sha256")
    statistics = None
    if "statistics" in metadata:
        statistics = read_statistics(tensors, parse_metadata(metadata, "statistics"))
    weights = {name: w for name, w in tensors.items() if not name.startswith(STATISTICS_PREFIX)}
    for name, values in weights.items():
        if values.dtype != np.float32:
            raise ValueError(f"`{name}` must be float32, got {values.dtype}")
    network = parse_metadata(metadata, "network")
    return Model(
        description.config,
        weights,
        description.classes,
        description.record,
        network=network,
        outputs=description.outputs,
        by_share=description.by_share,
        statistics=statistics,
    )
