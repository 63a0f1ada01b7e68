"""Networks in ONNX files, run by onnxruntime on the CPU: volume -> logits."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import async_tnt.volume.config as limits
from async_tnt.base.checks import ParameterTypeError, ParameterValueError, positive_int
from async_tnt.base.extras import needs_extra
from async_tnt.base.files import refuse_git_lfs, user_path
from async_tnt.base.messages import one_line
from async_tnt.base.running import Running, one_at_a_time
from async_tnt.networks.layers.conversion_check import Function
from async_tnt.networks.models.objects import (
    LOGITS_SHAPES,
    Places,
    logits_shape,
    n_of_boxes,
    places_of,
)
from async_tnt.networks.onnx.metadata import Exported, read_metadata
from async_tnt.volume.config import TNTConfig

if TYPE_CHECKING:
    import onnxruntime


class OnnxClassifier:
    """A classifier in an ONNX file, run by onnxruntime: volume (C, H, W) -> logits (n_classes,).

    `Processor(config, classifier=OnnxClassifier("net.onnx"))` decides by any network of one input
    and one output. The input is float32 of shape (1, C, H, W), or with an open batch. The output is
    float32 logits of any shape that has one axis longer than 1, or a map (1, n_classes + 1, R, C),
    see `Model`. Files by `to_onnx` or `async-tnt export` hold their configuration and classes:
    `Processor(net.config, classifier=net, classes=net.classes)`.

    An instance holds scratch memory: use one instance per thread. A copy, or an instance read from
    a pickle, opens the network again from the same path or bytes.

    Parameters
    ----------
    path_or_bytes : an .onnx file's path, its content, or an `onnx.ModelProto`.
    threads : how many threads onnxruntime uses within a node and between nodes, at least 1. With 1
        it starts no threads. With more, the threads sleep between calls instead of spinning.
    shape : (C, H, W) of a volume, needed if the network leaves these sides open.

    Attributes
    ----------
    shape : (C, H, W).
    n_classes : the number of logits; for a map, the number of channels without the last.
    places : where the places of a map lie, if this package wrote the file; else None, which means
        that the places divide the sensor evenly.
    config, classes : TNTConfig and names, if this package wrote the file; else None.
    exported : the Model of the file, without its weights, if this package wrote the file; else
        None.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    FileNotFoundError : the file does not exist.
    ValueError, TypeError : the file is damaged, or its network has other inputs or outputs; or, in
        a call, the volume has another shape.
    """

    def __init__(
        self, path_or_bytes: Any, *, threads: int = 1, shape: Sequence[int] | None = None
    ) -> None:
        self.threads = positive_int("threads", threads)
        self._running = Running("OnnxClassifier")
        self._source = source_of(path_or_bytes)
        if isinstance(self._source, bytes):
            self._name = f"the ONNX network of {len(self._source):_} bytes"
        else:
            self._name = self._source
        opened = open_session(self._source, self._name, self.threads)
        self._session = opened.session
        try:
            self.shape = check_input(opened.inputs, shape)
            _check_output(opened.outputs)
        except ValueError as error:
            raise ValueError(f"{self._name}: {error}") from None

        memory_and_binding = self._bind(opened.inputs[0].name, opened.outputs[0])
        self._volume, self._answer, self._binding = memory_and_binding
        is_map = self._answer.ndim > 1
        self.n_classes = len(self._answer) - 1 if is_map else self._answer.size

        self.exported = opened.exported
        self.config: TNTConfig | None = None
        self.classes: tuple[str, ...] | None = None
        self.places: Places | None = None
        if self.exported is not None:
            self.config = self.exported.config
            self.classes = self.exported.classes
            if is_map:
                self.places = _places_of(self.exported, self._name)
                if n_of_boxes(len(self._answer), len(self.classes)):
                    self.n_classes = len(self.classes)
            self._check_exported(self.exported)

    def _check_exported(self, exported: Exported) -> None:
        """Refuse a file whose metadata and network do not fit each other."""
        shape = exported.config.shape
        if shape != self.shape:
            raise ValueError(
                f"{self._name} is damaged: its configuration gives volumes of shape {shape}, "
                f"its network takes {self.shape}"
            )
        n_names = len(exported.classes)
        if n_names != self.n_classes:
            raise ValueError(
                f"{self._name} is damaged: it names {n_names} classes, its network gives "
                f"{self.n_classes} logits"
            )

    def __reduce__(self) -> Any:  # a session cannot be copied, only opened again
        open_again = functools.partial(
            type(self), self._source, threads=self.threads, shape=self.shape
        )
        return open_again, ()

    def _bind(self, input_name: str, output: Any) -> tuple[np.ndarray, np.ndarray, Any]:
        """Allocate the memory that the network reads from and writes to, and bind it once.

        This is the fastest way that onnxruntime offers. For `digits` on one Xeon core it takes
        50 us. `session.run` takes 52 to 57, as it checks a dictionary and makes a list and an
        array; an `io_binding` for each volume takes 55, and `run_with_ort_values` 93.

        Returns
        -------
        The volume (C, H, W), the answer in the shape in which it is read, and the binding.
        """
        try:
            volume = np.zeros((1, *self.shape), np.float32)
            # the file may not say the answer's shape: one run shows it
            (answer,) = self._session.run([output.name], {input_name: volume})
        except Exception as error:  # onnxruntime raises errors of many types
            raise ValueError(
                f"{self._name}: the network fails on an empty volume: {one_line(error)}"
            ) from None
        shape_read = logits_shape(answer.shape)
        if shape_read is None:
            raise ValueError(
                f"{self._name}: the network must give logits {LOGITS_SHAPES}, of a volume, got "
                f"shape {answer.shape}"
            )
        answer = np.zeros(answer.shape, np.float32)
        binding = self._session.io_binding()
        binding.bind_input(input_name, "cpu", 0, np.float32, volume.shape, volume.ctypes.data)
        binding.bind_output(
            output.name, "cpu", 0, answer.dtype.type, answer.shape, answer.ctypes.data
        )
        return volume[0], answer.reshape(shape_read), binding

    @property
    def logits_shape(self) -> tuple[int, ...]:
        """The shape of an answer: (n_classes,), or (n_classes + 1, R, C) for a map."""
        return self._answer.shape

    @one_at_a_time
    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """The logits of one volume, a new array: float32, (n_classes,) or (n_classes + 1, R, C)."""
        if volume.shape != self.shape:
            raise ParameterValueError("volume", f"must have shape {self.shape}", volume.shape)
        np.copyto(self._volume, volume)
        try:
            self._session.run_with_iobinding(self._binding)
        except Exception as error:  # onnxruntime raises errors of many types
            raise ValueError(
                f"{self._name}: the network fails on this volume: {one_line(error)}"
            ) from None
        return self._answer.copy()


def has_raw_outputs(path: Path) -> bool:
    """Whether a file is the export of a model of raw outputs. A missing file is none."""
    if not path.is_file():
        return False
    opened = open_session(str(path), str(path), 1)
    return opened.exported is not None and bool(opened.exported.outputs)


def output_function(path: Path) -> Function:
    """All outputs of a network in a file by onnxruntime, as a function of a volume (C, H, W).

    Raises
    ------
    ImportError, ValueError : see `open_session`.
    """
    opened = open_session(str(path), str(path), 1)
    name = opened.inputs[0].name

    def outputs(volume: np.ndarray) -> list[np.ndarray]:
        answers: list[np.ndarray] = opened.session.run(None, {name: volume[None]})
        return answers

    return outputs


def _places_of(exported: Exported, name: str) -> Places:
    """Where the places of an exported map model's map lie."""
    try:
        return places_of(exported.layers, exported.config)
    except (LookupError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{name} is damaged: its layers cannot be read ({one_line(error)})"
        ) from None


# -- opening a file, checking that its network takes one volume and gives one answer ---------------


def source_of(path_or_bytes: Any) -> str | bytes:
    """A network as onnxruntime opens it: the path of its file, or its bytes.

    Raises
    ------
    ParameterTypeError : the argument is of another type.
    FileNotFoundError : there is no such file.
    """
    if hasattr(path_or_bytes, "SerializeToString"):  # onnx.ModelProto, without importing onnx
        return bytes(path_or_bytes.SerializeToString())
    if isinstance(path_or_bytes, (bytes, bytearray, memoryview)):
        return bytes(path_or_bytes)
    if not isinstance(path_or_bytes, (str, os.PathLike)):
        raise ParameterTypeError(
            "path_or_bytes",
            "must be a path, bytes or an onnx.ModelProto",
            type(path_or_bytes).__name__,
        )
    path = user_path(path_or_bytes)
    if not path.exists():
        raise FileNotFoundError(f"no file {path}")
    refuse_git_lfs(path)
    return str(path)


def import_onnxruntime() -> Any:
    """The module onnxruntime, with telemetry off unless the user's environment turns it on.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    """
    # onnxruntime reads this variable while it is imported. Its API can turn telemetry off only
    # after the import.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    with needs_extra("onnx", "ONNX networks are run by onnxruntime"):
        import onnxruntime
    return onnxruntime


@dataclass(frozen=True)
class OpenedNetwork:
    """An ONNX network that onnxruntime has opened.

    Parameters
    ----------
    inputs, outputs : onnxruntime's descriptions of the network's inputs and outputs.
    exported : the Model of the file, without its weights, if this package wrote the file; else
        None.
    """

    session: onnxruntime.InferenceSession
    inputs: list[Any]
    outputs: list[Any]
    exported: Exported | None


def open_session(source: str | bytes, name: str, threads: int) -> OpenedNetwork:
    """Open a network in onnxruntime.

    Parameters
    ----------
    source : the path of the network's file, or its bytes.
    name : the network's name in messages.
    threads : see `OnnxClassifier`.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    ValueError : the file is no ONNX network, or this package wrote it and it is damaged.
    """
    onnxruntime = import_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = threads
    # a spinning helper thread would take a core from the source of the events
    for pool in ("intra_op", "inter_op"):
        options.add_session_config_entry(f"session.{pool}.allow_spinning", "0")
    options.log_severity_level = 4  # errors are raised; nothing else is printed
    try:
        session = onnxruntime.InferenceSession(
            source,
            options,
            providers=["CPUExecutionProvider"],
            enable_fallback=0,  # with a fallback, onnxruntime would print that it tries again
        )
        inputs = session.get_inputs()
        outputs = session.get_outputs()
        metadata = session.get_modelmeta().custom_metadata_map
    except Exception as error:  # onnxruntime raises errors of many types
        raise ValueError(f"{name} is not a readable ONNX network: {one_line(error)}") from None
    content = Path(source).read_bytes() if isinstance(source, str) else source
    try:
        exported = read_metadata(metadata, content)
    except ValueError as error:
        raise ValueError(f"{name} is damaged: {one_line(error)}") from None
    return OpenedNetwork(session, inputs, outputs, exported)


def check_input(inputs: list[Any], shape: Sequence[int] | None) -> tuple[int, int, int]:
    """The shape (C, H, W) of a network's volumes.

    The result is `shape` if it is given. Otherwise it is the shape of the network's input, which
    must not leave a side open.
    """
    sides = tuple(inputs[0].shape) if inputs else ()
    is_one_volume = len(sides) == 4 and (sides[0] == 1 or not isinstance(sides[0], int))
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or not is_one_volume:
        raise ValueError(
            "the network must have one input, a volume, tensor(float) of shape (1, C, H, W), or of "
            f"any number of them; got {_listed(inputs)}"
        )
    if shape is None:
        if not all(isinstance(side, int) for side in sides[1:]):
            raise ValueError(
                f"the network's input {_spelled(sides)} leaves sides open: `shape` must be (C, H, "
                "W)"
            )
        shape = sides[1:]
    elif len(shape) != 3:
        raise ValueError(f"`shape` must be (C, H, W), got {shape!r}")
    channels, height, width = [positive_int("shape", side) for side in shape]
    for side, wanted in zip(sides[1:], (channels, height, width), strict=True):
        if isinstance(side, int) and side != wanted:
            raise ValueError(
                f"`shape` must fit the network's input {_spelled(sides)}, got {tuple(shape)}"
            )
    if channels * height * width > limits.MAX_CELLS:
        raise ValueError(
            f"the network's input must have at most {limits.MAX_CELLS:_} cells, got "
            f"{_spelled(sides)}"
        )
    return channels, height, width


def _check_output(outputs: list[Any]) -> None:
    """Refuse a network that does not have one output of float32."""
    if len(outputs) != 1 or outputs[0].type != "tensor(float)":
        wanted = f"one output, logits {LOGITS_SHAPES}, tensor(float)"
        raise ValueError(f"the network must have {wanted}; got {_listed(outputs)}")


def _listed(values: list[Any]) -> str:
    """Inputs or outputs with their types and shapes, for messages."""
    if not values:
        return "none"
    return ", ".join(f"{value.name!r} {value.type} {_spelled(value.shape)}" for value in values)


def _spelled(sides: Sequence[Any]) -> str:
    """A shape for messages, such as (1, 9, height, ?): a side is a number, a name or unknown."""
    return "(" + ", ".join("?" if side is None else str(side) for side in sides) + ")"
