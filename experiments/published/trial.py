"""What becomes of a published network: is it accepted, exact, and how fast after an event?"""

from __future__ import annotations

import contextlib
import copy
import importlib.util
import io
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import nn

from async_tnt import CompiledNetwork, Model, TNTConfig, TNTVolume, load_model
from async_tnt.networks.onnx.network import output_function
from async_tnt.networks.torch.outputs import named_outputs
from experiments.published.build import build
from experiments.published.zoo_list import Entry
from experiments.speed.timing import interleave
from experiments.speed.work import work_of

LONGEST = 300
"""Most characters of a reason."""

OPSET = 18
"""Version of ONNX's operators that networks are exported with."""


N_BEFORE = 300
"""Number of events in the window before those that are compared."""

N_EVENTS = 30
"""Number of events after each of which the outputs are compared bit by bit."""

N_ROUNDS = 20
"""How often an event and a whole pass of ONNX Runtime take turns."""


def tried(entry: Entry) -> dict[str, Any]:
    """What became of a network: the entry of the report.

    "torch" and "onnx" are empty if the network is accepted, and otherwise say why it is not. An
    accepted one also has "exact", and "speed" where ONNX Runtime is installed.
    """
    started = time.monotonic()
    module = build(entry)
    config = _config(entry.shape)
    numbers: dict[str, Any] = {
        "source": entry.source,
        "shape": entry.shape,
        "parameters": sum(parameter.numel() for parameter in module.parameters()),
    }
    with TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        models: list[Model] = []
        numbers["torch"] = _reason(lambda: models.append(Model.from_torch(module, config)))
        reason = _reason(lambda: _from_onnx(module, entry.shape, config, path))
        numbers["onnx"] = reason.replace(str(path), path.name)
        if models:
            numbers |= _exactness(models[0], module)
            if importlib.util.find_spec("onnxruntime") is not None and path.exists():
                numbers["speed"] = _speed(models[0], path)
    return {**numbers, "seconds": round(time.monotonic() - started, 1)}


def _config(shape: tuple[int, int, int]) -> TNTConfig:
    """Volumes of this shape, in which an event changes one pixel."""
    channels, height, width = shape
    size = (width, height)
    return TNTConfig(sensor=size, grid=size, bins=channels, transform="none", window_us=1_000_000)


def _from_onnx(
    module: nn.Module, shape: tuple[int, int, int], config: TNTConfig, path: Path
) -> Model:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")  # of the exporter, which also prints whole graphs
        torch.onnx.export(
            module, (torch.zeros(1, *shape),), path, opset_version=OPSET, dynamo=False
        )
    return load_model(path, config=config)


def _events(config: TNTConfig) -> Iterator[tuple[int, int, int, int]]:
    """Events of a spot that moves across the sensor."""
    rng = np.random.default_rng(0)
    width, height = config.sensor
    for k in range(1, 1_000_000):
        x = (0.2 + 0.6 * (k % 2_000) / 2_000) * width + rng.normal(0, width / 16)
        y = 0.5 * height + rng.normal(0, height / 16)
        column = int(np.clip(x, 0, width - 1))
        row = int(np.clip(y, 0, height - 1))
        yield 400 * k % config.window_us, column, row, int(rng.integers(2))


def _open_window(config: TNTConfig, events: Iterator[tuple[int, int, int, int]]) -> TNTVolume:
    """A volume with the first events."""
    volume = TNTVolume(config)
    volume.open(0)
    for event in islice(events, N_BEFORE):
        volume.update_one(*event)
    return volume


def _exactness(model: Model, module: nn.Module) -> dict[str, Any]:
    """How the outputs after single events compare with whole passes, and with torch.

    "wrong_bits" counts numbers with other bits than in a whole pass. "deviation" is the largest
    difference from torch in float64, as a share of the largest number, and "own_deviation" that of
    torch in float32.
    """
    events = _events(model.config)
    volume = _open_window(model.config, events)
    network = CompiledNetwork(model)
    whole = CompiledNetwork(model)
    network.refresh(volume)
    wrong_bits = 0
    for event in islice(events, N_EVENTS):
        volume.update_one(*event)
        arrays = network.refresh(volume)
        for array, expected in zip(arrays, whole(volume.array), strict=True):
            bits = np.ascontiguousarray(array).view(np.uint32)
            wrong_bits += int(np.count_nonzero(bits != expected.view(np.uint32)))
    exact = _torch_outputs(module, volume.array, torch.float64)
    rounded = _torch_outputs(module, volume.array, torch.float32)
    return {
        "wrong_bits": wrong_bits,
        "deviation": _deviation(arrays, exact),
        "own_deviation": _deviation(rounded, exact),
    }


def _torch_outputs(module: nn.Module, volume: np.ndarray, dtype: torch.dtype) -> list[np.ndarray]:
    twin = copy.deepcopy(module).to(dtype)
    with torch.no_grad():
        value = twin(torch.tensor(volume, dtype=dtype)[None])
    return [tensor[0].numpy() for tensor in named_outputs(value).values()]


def _deviation(arrays: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> float:
    """The largest difference, as a share of the largest number of the same output."""
    shares = []
    for array, wanted in zip(arrays, expected, strict=True):
        largest = float(np.abs(wanted).max()) or 1.0
        shares.append(float(np.abs(array.reshape(wanted.shape) - wanted).max()) / largest)
    return max(shares)


def _speed(model: Model, path: Path) -> dict[str, float]:
    """What an event costs beside a whole pass of ONNX Runtime, in microseconds and multiplications.

    "share" is the part of a whole pass that an event computes again.
    """
    events = _events(model.config)
    volume = _open_window(model.config, events)
    network = CompiledNetwork(model)
    runtime = output_function(path)
    network.refresh(volume)
    shares = []

    def after_an_event() -> float:
        volume.update_one(*next(events))
        started = time.perf_counter()
        network.refresh(volume)
        duration = time.perf_counter() - started
        work = work_of(network)
        whole = sum(step.products * step.places for step, _ in work)
        shares.append(sum(step.products * n for step, n in work) / max(1, whole))
        return 1e6 * duration

    def whole_pass() -> float:
        array = volume.array
        started = time.perf_counter()
        runtime(array)
        return 1e6 * (time.perf_counter() - started)

    measured = interleave({"event": after_an_event, "runtime": whole_pass}, N_ROUNDS)
    event_us = float(np.median(measured["event"]))
    runtime_us = float(np.median(measured["runtime"]))
    return {
        "event_us": event_us,
        "onnxruntime_us": runtime_us,
        "ratio": runtime_us / event_us,
        "share": float(np.median(shares)),
    }


def _reason(convert: Callable[[], object]) -> str:
    """Why a conversion is refused, in one line; empty if it is not."""
    try:
        convert()
    except (NotImplementedError, ValueError, TypeError, RuntimeError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."
    return ""
