"""An ONNX file opened by onnxruntime, and whether its network takes one volume and gives one answer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from async_tnt.checks import needs_extra, one_line, positive_int
from async_tnt.config import MAX_CELLS
from async_tnt.networks.onnx_metadata import Exported, is_damaged, read_metadata

if TYPE_CHECKING:
    import onnxruntime

Shape = tuple[int, int, int]
DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}  # by onnxruntime's names


def source_of(path_or_bytes: Any) -> str | bytes:
    """A network as onnxruntime opens it: the path of its file, or its bytes; a TypeError for anything else."""
    if hasattr(path_or_bytes, "SerializeToString"):  # onnx.ModelProto, without importing onnx
        return bytes(path_or_bytes.SerializeToString())
    if isinstance(path_or_bytes, (bytes, bytearray, memoryview)):
        return bytes(path_or_bytes)
    if not isinstance(path_or_bytes, (str, os.PathLike)):
        raise TypeError(
            f"`path_or_bytes` must be a path, bytes or an onnx.ModelProto, got {type(path_or_bytes).__name__}"
        )
    path = Path(path_or_bytes)
    if not path.exists():
        raise FileNotFoundError(f"no file {path}")
    return str(path)


def import_onnxruntime() -> Any:
    """The library, with telemetry off unless the user's environment turns it on.

    Raises
    ------
    ImportError : it is not installed.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when it is loaded: its API's own switch comes too late
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
    for pool in ("intra_op", "inter_op"):  # a spinning helper thread would take a core from the source of the events
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
        exported = read_metadata(metadata)
    except ValueError as error:
        raise ValueError(f"{name} is damaged: {one_line(error)}") from None
    if exported is not None and is_damaged(metadata, Path(source).read_bytes() if isinstance(source, str) else source):
        raise ValueError(
            f"{name} is damaged: its checksum differs; copy or export it again (where another program has changed "
            "it, remove `format` from its metadata)"
        )
    return session, inputs, outputs, exported


def check_input(inputs: list[Any], shape: Sequence[int] | None) -> Shape:
    """The shape (C, H, W) of a network's volumes; `shape` where it leaves sides open."""
    if len(inputs) != 1:
        raise ValueError(f"the network must have one input, a volume, got {len(inputs)}{_listed(inputs)}")
    (volume,) = inputs
    if volume.type != "tensor(float)":
        raise ValueError(
            f"the network's input must be float32, as volumes are, got {_type_name(volume.type)} for {volume.name!r}"
        )
    sides = tuple(volume.shape)
    if len(sides) != 4:
        raise ValueError(f"the network's input must have shape (1, C, H, W), got {_spelled(sides)} for {volume.name!r}")
    if isinstance(sides[0], int) and sides[0] != 1:
        raise ValueError(f"the network must take one volume at a time, or any number, got input {_spelled(sides)}")
    if shape is None:
        if not all(isinstance(side, int) for side in sides[1:]):
            raise ValueError(f"the network's input {_spelled(sides)} leaves sides open: `shape` must be (C, H, W)")
        shape = sides[1:]
    elif len(shape) != 3:
        raise ValueError(f"`shape` must be (C, H, W), got {shape!r}")
    channels, height, width = (positive_int("shape", side) for side in shape)
    for side, wanted in zip(sides[1:], (channels, height, width), strict=True):
        if isinstance(side, int) and side != wanted:
            raise ValueError(f"`shape` must fit the network's input {_spelled(sides)}, got {tuple(shape)}")
    if channels * height * width > MAX_CELLS:
        raise ValueError(f"the network's input must have at most {MAX_CELLS:_} cells, got {_spelled(sides)}")
    return channels, height, width


def check_output(outputs: list[Any], types: tuple[str, ...], answer: str) -> None:
    """Refuse a network that does not have one output of one of these types; `answer` says what it should hold."""
    if len(outputs) != 1:
        raise ValueError(f"the network must have one output, {answer}, got {len(outputs)}{_listed(outputs)}")
    if outputs[0].type not in types:
        expected = " or ".join(_type_name(name) for name in types)
        raise ValueError(f"the network's output must be {expected}, got {_type_name(outputs[0].type)}")


def _listed(nodes: list[Any]) -> str:
    return ": " + ", ".join(f"{node.name!r} {_spelled(node.shape)}" for node in nodes) if nodes else ""


def _spelled(sides: Sequence[Any]) -> str:
    """(1, 9, height, ?): a side is a number, a name or unknown."""
    return "(" + ", ".join("?" if side is None else str(side) for side in sides) + ")"


def _type_name(name: str) -> str:
    """In NumPy's words: float16 and int64 have one name here and there."""
    return np.dtype(DTYPES[name]).name if name in DTYPES else name.removeprefix("tensor(").removesuffix(")")
