"""Microseconds from an event to the flow, beside one pass of the whole network."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt import CompiledNetwork, Model, Output, Processor
from examples.optical_flow.network import HOP_US, WINDOW_US
from examples.optical_flow.scenes import TRAINED, random_scene
from experiments.speed.interleaved import WorkDiffers
from experiments.speed.timing import is_installed, latency, no_collector, one_thread

SENSOR = (346, 260)
"""Width and height of the sensor, in pixels: those of a DAVIS346."""

N_OBJECTS = 6
"""Number of objects of the scene."""

N_MOMENTS = 300
"""Number of moments at which events and whole passes take turns."""

N_STREAMED = 10_000
"""Number of events that follow each other."""

N_BETWEEN = 50
"""Number of events between two moments, which come at once."""

N_CHANGES = 30
"""Number of changes of windows."""

TOLERANCE = 1e-4
"""Largest allowed difference between another engine's flow and ours, divided by the largest."""

Pass = Callable[[np.ndarray], np.ndarray]
"""Volume (C, H, W) -> flow (2, H, W)."""


def whole_passes(model: Model) -> dict[str, Pass]:
    """Engine -> a pass of the whole network, on one thread; ours first."""
    network = CompiledNetwork(model)
    passes: dict[str, Pass] = {"async_tnt": lambda volume: network(volume)[0]}
    if is_installed("onnx", "onnxruntime"):
        from async_tnt.networks.onnx.export import to_onnx
        from async_tnt.networks.onnx.network import open_session

        content = to_onnx(model).SerializeToString()
        session = open_session(content, "the exported network", threads=1).session
        name = session.get_inputs()[0].name
        passes["onnxruntime"] = lambda volume: session.run(None, {name: volume[None]})[0][0]
    import torch

    from async_tnt.networks.models.torch_modules import torch_classifier

    module = torch_classifier(model)
    tensor = torch.zeros(model.config.shape)
    memory = tensor.numpy()

    def torch_pass(volume: np.ndarray) -> np.ndarray:
        np.copyto(memory, volume)
        with torch.inference_mode():
            return module(tensor[None])[0].numpy()

    passes["torch"] = torch_pass
    return passes


def times(
    model: Model,
    n_moments: int = N_MOMENTS,
    n_changes: int = N_CHANGES,
    n_streamed: int = N_STREAMED,
) -> dict[str, Any]:
    """The times of a model on a scene of `SENSOR`.

    Returns
    -------
    dict : `us`, a `latency` for each thing that is timed; `ratio`, the median of a whole pass
        divided by that of an event; and `a_second`, the events a second of a stream with the flow
        after every event.

    Raises
    ------
    WorkDiffers : the flow after an event is not that of the whole network, to the bit; or another
        engine's flow is not ours within `TOLERANCE`.
    """
    model = model.for_sensor(SENSOR)
    events = _scene_events((N_BETWEEN + 3) * n_moments + n_streamed)
    with one_thread(True), no_collector():
        us = _by_turns(model, events, n_moments)
        us["first event of a new window"] = _changes(model, events, n_changes)
        us["in a stream, one event"] = _stream(model, events[-n_streamed:])
    event_us = float(np.median(us["one event"]))
    passes = [name for name in us if name.startswith("whole pass")]
    return {
        "sensor": list(SENSOR),
        "us": {name: latency(np.array(values)) for name, values in us.items()},
        "ratio": {name: float(np.median(us[name])) / event_us for name in passes},
        "a_second": 1e6 / float(np.mean(us["in a stream, one event"])),
    }


def _scene_events(n: int) -> np.ndarray:
    """The events of a scene with at least `n` of them, in two windows."""
    rng = np.random.default_rng(0)
    duration_us = 2 * WINDOW_US
    while True:
        scene = random_scene(SENSOR, 1e-6 * duration_us, TRAINED, rng, N_OBJECTS)
        events = scene.events(duration_us, rng)
        if len(events) >= n:
            return events


def _by_turns(model: Model, events: np.ndarray, n_moments: int) -> dict[str, list[float]]:
    """What is timed -> microseconds at each moment. Events and whole passes take turns."""
    passes = whole_passes(model)
    processor = Processor[Output](model, start_us=0, hop_us=HOP_US)
    us: dict[str, list[float]] = {}

    def timed(name: str, work: Callable[[Any], Any], argument: Any) -> Any:
        started = time.perf_counter()
        answer = work(argument)
        us.setdefault(name, []).append(1e6 * (time.perf_counter() - started))
        return answer

    def push_and_fire(packet: np.ndarray) -> Output:
        processor.push(packet)
        return processor.fire()

    for moment in range(n_moments):
        new = events[(N_BETWEEN + 3) * moment :][: N_BETWEEN + 3]
        first, *between, second, third = new.tolist()
        processor.every_events = 1
        # other networks have emptied the caches: this time is reported by itself
        timed("one event, right after whole passes", processor.push, first)
        processor.every_events = None
        timed(f"{len(between)} events at once", push_and_fire, new[1:-2])
        processor.every_events = 1
        processor.push(second)
        *_, output = timed("one event", processor.push, third)
        volume = processor.volume()
        names = list(passes) if moment % 2 else list(reversed(passes))
        for name in names:
            whole = timed(f"whole pass, {name}", passes[name], volume)
            _check(name, whole, output.arrays[0])
    return us


def _check(name: str, whole: np.ndarray, flow: np.ndarray) -> None:
    """Compare the flow of a whole pass with the flow after an event."""
    if name == "async_tnt":
        if not np.array_equal(whole, flow):
            raise WorkDiffers("the flow after an event is not that of the whole network")
        return
    difference = float(np.abs(whole - flow).max() / np.abs(flow).max())
    if not difference <= TOLERANCE:
        raise WorkDiffers(f"the flow of {name} is {difference:.1e} away from ours")


def _changes(model: Model, events: np.ndarray, n: int) -> list[float]:
    """Microseconds of the first event that is answered by the next one of overlapping windows."""
    us = []
    for k in range(n):
        start_us = k * HOP_US // n
        processor = Processor[Output](model, start_us=start_us, hop_us=HOP_US)
        first, last = np.searchsorted(events["t"], (start_us, start_us + WINDOW_US))
        processor.push(events[first:last])
        processor.fire()
        processor.every_events = 1
        started = time.perf_counter()
        *_, output = processor.push(events[last].item())
        us.append(1e6 * (time.perf_counter() - started))
        assert output.window_start_us == start_us + HOP_US
    return us


def _stream(model: Model, events: np.ndarray) -> list[float]:
    """Microseconds of each event of a stream that is read after every event."""
    processor = Processor[Output](model, start_us=int(events["t"][0]), hop_us=HOP_US)
    processor.every_events = 1
    us = []
    for event in events.tolist():
        started = time.perf_counter()
        processor.push(event)
        us.append(1e6 * (time.perf_counter() - started))
    return us
