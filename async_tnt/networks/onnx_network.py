"""Networks in ONNX files, run by onnxruntime on the CPU: volume -> logits, raw volume -> landmark."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.checks import one_line, positive_int
from async_tnt.networks.graph import CLASSIFIER, REGRESSOR
from async_tnt.networks.onnx_metadata import Exported
from async_tnt.networks.onnx_session import DTYPES, check_input, check_output, open_session, source_of
from async_tnt.one_call import Running, one_at_a_time


class _OnnxNetwork:
    """A network of one input, a volume, and one output, a few numbers."""

    kind = ""
    answer = ""
    opens_the_other = ""
    output_types: tuple[str, ...] = ()

    def __init__(self, path_or_bytes: Any, *, threads: int = 1, shape: Sequence[int] | None = None) -> None:
        self.threads = positive_int("threads", threads)
        self._running = Running(type(self).__name__)
        self._source = source = source_of(path_or_bytes)
        self._name = name = f"the ONNX network of {len(source):_} bytes" if isinstance(source, bytes) else source
        self._session, inputs, outputs, exported = open_session(source, name, self.threads)
        if exported is not None and exported.network != self.kind:
            raise ValueError(f"{name} holds a {exported.network}, not a {self.kind}: {self.opens_the_other} opens it")
        try:
            self.shape = check_input(inputs, shape)
            check_output(outputs, self.output_types, self.answer)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        self._volume, self._answer, self._binding = self._bind(inputs[0].name, outputs[0])
        self.exported: Exported | None = exported
        if exported is not None and exported.config.shape != self.shape:
            raise ValueError(
                f"{name} is damaged: its configuration gives volumes of shape {exported.config.shape}, its network "
                f"takes {self.shape}"
            )
        self.config = None if exported is None else exported.config
        self.classes = None if exported is None else exported.classes

    def __reduce__(self) -> Any:  # a session cannot be copied, only opened again
        return functools.partial(type(self), self._source, threads=self.threads, shape=self.shape), ()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(volumes of {self.shape}, {self._answer.size} outputs, {self.threads} threads)"

    def _bind(self, input_name: str, output: Any) -> tuple[np.ndarray, np.ndarray, Any]:
        """Memory that the network reads from and writes to, bound once.

        This is the fastest way that onnxruntime offers. For `digits` on one Xeon core: 50 us, where `session.run` takes
        52 to 57 (it checks a dictionary and makes a list and an array), an `io_binding` for each volume 55, and
        `run_with_ort_values` 93.
        """
        try:
            volume = np.zeros((1, *self.shape), np.float32)
            (answer,) = self._session.run([output.name], {input_name: volume})  # its size may depend on the input's
        except Exception as error:  # of many types, none of them a ValueError
            raise ValueError(f"{self._name}: the network fails on an empty volume: {one_line(error)}") from None
        if answer.size == 0 or answer.size != max(answer.shape, default=1):
            raise ValueError(f"{self._name}: the network must give {self.answer} of a volume, got shape {answer.shape}")
        answer = np.zeros(answer.shape, DTYPES[output.type])
        binding = self._session.io_binding()
        binding.bind_input(input_name, "cpu", 0, np.float32, volume.shape, volume.ctypes.data)
        binding.bind_output(output.name, "cpu", 0, answer.dtype.type, answer.shape, answer.ctypes.data)
        return volume[0], answer.reshape(-1), binding

    @one_at_a_time
    def _run(self, volume: np.ndarray) -> np.ndarray:
        """The network's numbers, a new array."""
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        np.copyto(self._volume, volume)
        try:
            self._session.run_with_iobinding(self._binding)
        except Exception as error:  # as above
            raise ValueError(f"{self._name}: the network fails on this volume: {one_line(error)}") from None
        return self._answer.copy()


class OnnxClassifier(_OnnxNetwork):
    """A classifier in an ONNX file, run by onnxruntime: volume (C, H, W) -> logits (n_classes,).

    `Processor(config, classifier=OnnxClassifier("net.onnx"))` decides by any network of one input, float32 of shape
    (1, C, H, W) or with an open batch, and one output, float32 logits of any shape that has one axis longer than 1.
    Files by `to_onnx` or `async-tnt export` hold their configuration and classes:
    `Processor(net.config, classifier=net, classes=net.classes)`.

    Holds scratch memory: one instance per thread. Copies and pickles open the network again, from the same path or
    bytes.

    Parameters
    ----------
    path_or_bytes : an .onnx file's path, its content, or an `onnx.ModelProto`.
    threads : of onnxruntime, within a node and between nodes, at least 1. With 1 it starts no threads; with more,
        they sleep between calls instead of spinning.
    shape : (C, H, W), for networks that leave these sides open.

    Attributes
    ----------
    shape : (C, H, W).
    n_classes : logits.
    config, classes : TNTConfig and names, if this package wrote the file; else None.

    Raises
    ------
    ImportError : onnxruntime is not installed.
    FileNotFoundError : no such file.
    ValueError, TypeError : the file is damaged, or its network has other inputs or outputs; (when called) the volume
        has another shape.
    """

    kind, answer, output_types = CLASSIFIER, "logits (1, n_classes)", ("tensor(float)",)
    opens_the_other = "OnnxRegressor"

    def __init__(self, path_or_bytes: Any, *, threads: int = 1, shape: Sequence[int] | None = None) -> None:
        super().__init__(path_or_bytes, threads=threads, shape=shape)
        self.n_classes = self._answer.size
        if self.classes is not None and len(self.classes) != self.n_classes:
            raise ValueError(
                f"{self._name} is damaged: it names {len(self.classes)} classes, its network gives "
                f"{self.n_classes} logits"
            )

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """Logits of one volume: float32, shape (n_classes,), a new array."""
        return self._run(volume)


class OnnxRegressor(_OnnxNetwork):
    """A landmark network in an ONNX file, run by onnxruntime: raw volume (C, H, W) -> landmark (x, y).

    For `Processor(..., regressor=OnnxRegressor("net.regressor.onnx"))` and `TNTVolume`. The output is two numbers in
    grid pixels, float64 or float32. `path_or_bytes`, `threads`, `shape` and all else are as for `OnnxClassifier`.
    """

    kind, answer, output_types = REGRESSOR, "a landmark (1, 2)", ("tensor(float)", "tensor(double)")
    opens_the_other = "OnnxClassifier"

    def __init__(self, path_or_bytes: Any, *, threads: int = 1, shape: Sequence[int] | None = None) -> None:
        super().__init__(path_or_bytes, threads=threads, shape=shape)
        if self._answer.size != 2:
            raise ValueError(f"{self._name}: a landmark network gives two numbers (x, y), got {self._answer.size}")

    def __call__(self, volume: np.ndarray) -> tuple[float, float]:
        """The landmark of one raw volume, in grid pixels."""
        x, y = self._run(volume).tolist()
        return x, y
