"""Networks in ONNX files, run by onnxruntime on the CPU: volume -> logits."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import async_tnt.volume.config as limits
from async_tnt.base.checks import Running, needs_extra, one_at_a_time, one_line, positive_int
from async_tnt.base.files import refuse_git_lfs, user_path
from async_tnt.networks.models.objects import LOGITS, Places, logits_shape, places_of
from async_tnt.networks.onnx.export import Exported, read_metadata

if TYPE_CHECKING:
    import onnxruntime


class OnnxClassifier:
    """A classifier in an ONNX file, run by onnxruntime: volume (C, H, W) -> logits (n_classes,).

    `Processor(config, classifier=OnnxClassifier("net.onnx"))` decides by any network of one input,
    float32 of shape (1, C, H, W) or with an open batch, and one output, float32 logits of any shape
    that has one axis longer than 1, or a map (1, n_classes + 1, R, C), see `Model`.
    Files by `to_onnx` or `async-tnt export` hold their configuration and classes:
    `Processor(net.config, classifier=net, classes=net.classes)`.

    Holds scratch memory: one instance per thread. Copies and pickles open the network again, from
    the same path or bytes.

    Parameters
    ----------
    path_or_bytes : an .onnx file's path, its content, or an `onnx.ModelProto`.
    threads : of onnxruntime, within a node and between nodes, at least 1. With 1 it starts no
        threads; with more, they sleep between calls instead of spinning.
    shape : (C, H, W), for networks that leave these sides open.

    Attributes
    ----------
    shape : (C, H, W).
    n_classes : logits, or channels of a map but for the last.
    places : of a map in a file by this package: where its places lie. Else None: they divide the
        sensor evenly.
    config, classes : TNTConfig and names, if this package wrote the file; else None.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    FileNotFoundError : no such file.
    ValueError, TypeError : the file is damaged, or its network has other inputs or outputs; (when
        called) the volume has another shape.
    """

    def __init__(
        self, path_or_bytes: Any, *, threads: int = 1, shape: Sequence[int] | None = None
    ) -> None:
        self.threads = positive_int("threads", threads)
        self._running = Running("OnnxClassifier")
        self._source = source = source_of(path_or_bytes)
        self._name = name = (
            f"the ONNX network of {len(source):_} bytes" if isinstance(source, bytes) else source
        )
        self._session, inputs, outputs, exported = open_session(source, name, self.threads)
        try:
            self.shape = check_input(inputs, shape)
            if len(outputs) != 1 or outputs[0].type != "tensor(float)":
                wanted = f"one output, logits {LOGITS}, tensor(float)"
                raise ValueError(f"the network must have {wanted}; got {_listed(outputs)}")
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._volume, self._answer, self._binding = self._bind(inputs[0].name, outputs[0])
        self.n_classes = self._answer.size if self._answer.ndim == 1 else len(self._answer) - 1
        self.exported: Exported | None = exported
        self.config = None if exported is None else exported.config
        self.classes = None if exported is None else exported.classes
        self.places = (
            None if exported is None or self._answer.ndim == 1 else _places_of(exported, name)
        )
        if self.config is not None and self.config.shape != self.shape:
            raise ValueError(
                f"{name} is damaged: its configuration gives volumes of shape {self.config.shape}, "
                "its network takes "
                f"{self.shape}"
            )
        if self.classes is not None and len(self.classes) != self.n_classes:
            raise ValueError(
                f"{name} is damaged: it names {len(self.classes)} classes, its network gives "
                f"{self.n_classes} logits"
            )

    def __reduce__(self) -> Any:  # a session cannot be copied, only opened again
        return functools.partial(
            type(self), self._source, threads=self.threads, shape=self.shape
        ), ()

    def _bind(self, input_name: str, output: Any) -> tuple[np.ndarray, np.ndarray, Any]:
        """Memory that the network reads from and writes to, bound once.

        This is the fastest way that onnxruntime offers. For `digits` on one Xeon core: 50 us, where
        `session.run` takes 52 to 57 (it checks a dictionary and makes a list and an array), an
        `io_binding` for each volume 55, and `run_with_ort_values` 93.
        """
        try:
            volume = np.zeros((1, *self.shape), np.float32)
            # its size may depend on the input's
            (answer,) = self._session.run([output.name], {input_name: volume})
        except Exception as error:  # of many types, none of them a ValueError
            raise ValueError(
                f"{self._name}: the network fails on an empty volume: {one_line(error)}"
            ) from None
        if (shape_read := logits_shape(answer.shape)) is None:
            raise ValueError(
                f"{self._name}: the network must give logits {LOGITS}, of a volume, got shape "
                f"{answer.shape}"
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
        """(n_classes,), of a map (n_classes + 1, R, C)."""
        return self._answer.shape

    @one_at_a_time
    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """Logits of one volume: float32, shape (n_classes,) or (n_classes + 1, R, C), a new
        array."""
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        np.copyto(self._volume, volume)
        try:
            self._session.run_with_iobinding(self._binding)
        except Exception as error:  # as above
            raise ValueError(
                f"{self._name}: the network fails on this volume: {one_line(error)}"
            ) from None
        return self._answer.copy()


def _places_of(exported: Exported, name: str) -> Places:
    try:
        return places_of(exported.layers, exported.config)
    except (LookupError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{name} is damaged: its layers cannot be read ({one_line(error)})"
        ) from None


# -- opening a file, and whether its network takes one volume and gives one answer -----------------


def source_of(path_or_bytes: Any) -> str | bytes:
    """A network as onnxruntime opens it: the path of its file, or its bytes; a TypeError for
    anything else."""
    if hasattr(path_or_bytes, "SerializeToString"):  # onnx.ModelProto, without importing onnx
        return bytes(path_or_bytes.SerializeToString())
    if isinstance(path_or_bytes, (bytes, bytearray, memoryview)):
        return bytes(path_or_bytes)
    if not isinstance(path_or_bytes, (str, os.PathLike)):
        raise TypeError(
            f"`path_or_bytes` must be a path, bytes or an onnx.ModelProto, got "
            f"{type(path_or_bytes).__name__}"
        )
    path = user_path(path_or_bytes)
    if not path.exists():
        raise FileNotFoundError(f"no file {path}")
    refuse_git_lfs(path)
    return str(path)


def import_onnxruntime() -> Any:
    """The library, with telemetry off unless the user's environment turns it on.

    Raises
    ------
    ImportError : it is not installed.
    """
    # read when it is loaded: its API's own switch comes too late
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    with needs_extra("onnx", "ONNX networks are run by onnxruntime"):
        import onnxruntime
    return onnxruntime


def open_session(
    source: str | bytes, name: str, threads: int
) -> tuple[onnxruntime.InferenceSession, list[Any], list[Any], Exported | None]:
    """The session, its inputs and outputs, and the metadata if the file is ours."""
    onnxruntime = import_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = threads
    # a spinning helper thread would take a core from the source of the events
    for pool in ("intra_op", "inter_op"):
        options.add_session_config_entry(f"session.{pool}.allow_spinning", "0")
    options.log_severity_level = 4  # errors are raised; nothing else is printed
    try:
        session = onnxruntime.InferenceSession(
            source,
            options,
            providers=["CPUExecutionProvider"],
            enable_fallback=0,  # otherwise it prints that it tries again
        )
        inputs, outputs = session.get_inputs(), session.get_outputs()
        metadata = session.get_modelmeta().custom_metadata_map
    except Exception as error:  # of many types, none of them a ValueError
        raise ValueError(f"{name} is not a readable ONNX network: {one_line(error)}") from None
    try:
        exported = read_metadata(
            metadata, Path(source).read_bytes() if isinstance(source, str) else source
        )
    except ValueError as error:
        raise ValueError(f"{name} is damaged: {one_line(error)}") from None
    return session, inputs, outputs, exported


def check_input(inputs: list[Any], shape: Sequence[int] | None) -> tuple[int, int, int]:
    """The shape (C, H, W) of a network's volumes; `shape` where it leaves sides open."""
    sides = tuple(inputs[0].shape) if inputs else ()
    one_volume = len(sides) == 4 and (sides[0] == 1 or not isinstance(sides[0], int))
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or not one_volume:
        raise ValueError(
            "the network must have one input, a volume, tensor(float) of shape (1, C, H, W), or of "
            "any number of them; "
            f"got {_listed(inputs)}"
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
    channels, height, width = (positive_int("shape", side) for side in shape)
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


def _listed(values: list[Any]) -> str:
    return (
        ", ".join(f"{value.name!r} {value.type} {_spelled(value.shape)}" for value in values)
        or "none"
    )


def _spelled(sides: Sequence[Any]) -> str:
    """(1, 9, height, ?): a side is a number, a name or unknown."""
    return "(" + ", ".join("?" if side is None else str(side) for side in sides) + ")"
