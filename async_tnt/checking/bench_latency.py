"""Latency from the last event to the decision: stream and batch, interleaved, on one recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from async_tnt import Model, Processor, TNTConfig, bundled_models, load_model
from async_tnt.checking.bench_volumes import PACKETS
from async_tnt.checking.interleaved import WorkDiffers
from async_tnt.checking.timing import interleave, latency, no_collector, spread, work_clock

TOLERANCE = 1e-4
"""Largest difference of a cell, in parts of the largest cell, and of a logit, in parts of the largest logit."""


def bench_model(name_or_path: str | None, landmark: str, seed: int) -> tuple[Model, str]:
    """The model to time and its name: the given one, else the bundled "digits", else random weights."""
    if name_or_path is None and "digits" in bundled_models():
        name_or_path = "digits"
    if name_or_path is not None:
        return load_model(name_or_path), name_or_path
    config = TNTConfig(landmark=landmark)
    rng = np.random.default_rng(seed)
    shapes = {
        "conv1": (16, config.channels, 3, 3),
        "conv2": (32, 16, 3, 3),
        "fc1": (64, 32 * (config.grid[1] // 4) * (config.grid[0] // 4)),
        "fc2": (10, 64),
    }
    weights = {}
    for layer, shape in shapes.items():
        bound = 1 / np.sqrt(np.prod(shape[1:]))
        weights[f"{layer}.weight"] = rng.uniform(-bound, bound, shape).astype(np.float32)
        weights[f"{layer}.bias"] = rng.uniform(-bound, bound, shape[0]).astype(np.float32)
    return Model(config, weights, tuple("0123456789")), "random weights"


def bench_stream(model: Model, events: np.ndarray, *, rounds: int, with_torch: bool) -> dict[str, Any]:
    """Nanoseconds per event of a whole recording through a Processor, its windows' decisions included.

    With torch, `batch` is the best case of batch processing: each window once, when all its events have arrived. Both
    must give the same classes.
    """
    cases = {"single": _singles(Processor(model), events)}
    for size in PACKETS:
        cases[f"packet_{size}_structured"] = _packets(Processor(model), events, size)
    if with_torch:
        cases["batch"] = _batch_windows(model, events)
    measured = interleave(cases, rounds)
    return {
        "events": len(events),
        "windows": len(_window_starts(model.config, events)),
        "ns_per_event": {name: spread(values) for name, values in measured.items()},
    }


def bench_latency(model: Model, events: np.ndarray, *, moments: int, with_torch: bool) -> dict[str, Any]:
    """Microseconds from the call with the last event to the decision, at many moments of a stream.

    Stream: `push_one` of the event, then `fire`. Batch: the volume of the window's events up to this one, whose
    tensors are prepared, then the network. Both run at every moment, in alternating order, and all volumes, logits and
    classes are compared.

    Raises
    ------
    WorkDiffers : they are not equal within TOLERANCE.
    """
    batch = None
    if with_torch:
        from async_tnt.checking.torch_batch import TorchBatch

        batch = TorchBatch.of(model)
    processor = Processor(model)
    taken: dict[str, list[float]] = {"stream": [], "push_one": [], "fire": []}
    if batch is not None:
        taken |= {"batch": [], "batch_volume": [], "batch_network": []}
    worst = {"volume": 0.0, "logits": 0.0}
    at = np.unique(np.linspace(len(events) // 50, len(events) - 1, moments).astype(int))
    n_warm = min(20, len(at) // 4)
    done = 0
    with no_collector():
        for k, i in enumerate(at):
            processor.push(events[done:i])
            done = int(i) + 1
            window, start_us = _window_so_far(model.config, events, done)
            logits, volume = None, None
            if batch is not None and k % 2:
                logits, volume = _time_batch(batch, window, start_us, taken)
            decision = _time_stream(processor, events[i], taken)
            if batch is not None and logits is None:
                logits, volume = _time_batch(batch, window, start_us, taken)
            if logits is not None and volume is not None:
                _compare(processor.volume(), volume, decision, logits, worst)
    result: dict[str, Any] = {
        "moments": len(at) - n_warm,
        "us": {name: latency(1e6 * np.array(values[n_warm:])) for name, values in taken.items()},
    }
    if batch is not None:
        ratio = np.array(taken["batch"][n_warm:]) / np.array(taken["stream"][n_warm:])
        result["batch_over_stream"] = spread(ratio)
        result["largest_difference"] = worst
    return result


def _time_stream(processor: Processor, event: np.void, taken: dict[str, list[float]]) -> Any:
    t, x, y, p = (int(event[name]) for name in "txyp")
    started = time.perf_counter()
    processor.push_one(t, x, y, p)
    pushed = time.perf_counter()
    decision = processor.fire()
    ended = time.perf_counter()
    taken["stream"].append(ended - started)
    taken["push_one"].append(pushed - started)
    taken["fire"].append(ended - pushed)
    return decision


def _time_batch(
    batch: Any, window: np.ndarray, start_us: int, taken: dict[str, list[float]]
) -> tuple[np.ndarray, np.ndarray]:
    import torch

    from async_tnt.checking.torch_batch import as_tensors

    columns = as_tensors(window, start_us)
    with torch.inference_mode():
        started = time.perf_counter()
        volume = batch.volume(*columns)
        built = time.perf_counter()
        logits = batch.logits(volume)
        int(logits.argmax())
        ended = time.perf_counter()
    taken["batch"].append(ended - started)
    taken["batch_volume"].append(built - started)
    taken["batch_network"].append(ended - built)
    return logits.numpy(), volume.numpy()


def _compare(
    volume: np.ndarray, batch_volume: np.ndarray, decision: Any, logits: np.ndarray, worst: dict[str, float]
) -> None:
    differ = float(np.abs(volume - batch_volume).max() / max(np.abs(volume).max(), 1e-30))
    differ_logits = float(np.abs(decision.logits - logits).max() / max(np.abs(logits).max(), 1e-30))
    worst["volume"] = max(worst["volume"], differ)
    worst["logits"] = max(worst["logits"], differ_logits)
    second, first = np.sort(logits)[-2:] if logits.size > 1 else (-np.inf, logits[0])
    clear = first - second > 2 * TOLERANCE * np.abs(logits).max()  # else either class is right
    if differ > TOLERANCE or differ_logits > TOLERANCE or (clear and decision.index != int(logits.argmax())):
        raise WorkDiffers(
            f"stream and batch must agree within {TOLERANCE}, got volumes {differ:.1e} and logits "
            f"{differ_logits:.1e} apart, classes {decision.index} and {int(logits.argmax())}, "
            f"at {decision.time_us} us"
        )


def _window_starts(config: TNTConfig, events: np.ndarray) -> list[int]:
    first_us = int(events["t"][0])
    numbers = np.unique((events["t"] - first_us) // config.window_us)  # without windows that have no events
    return [first_us + int(k) * config.window_us for k in numbers]


def _window_so_far(config: TNTConfig, events: np.ndarray, n: int) -> tuple[np.ndarray, int]:
    """Of the first n events those in the window of event n - 1, and the window's start."""
    first_us, newest_us = int(events["t"][0]), int(events["t"][n - 1])
    start_us = newest_us - (newest_us - first_us) % config.window_us
    return events[int(np.searchsorted(events["t"], start_us)) : n], start_us


def _singles(processor: Processor, events: np.ndarray) -> Callable[[], float]:
    rows = list(zip(*(events[name].tolist() for name in "txyp"), strict=True))

    def run() -> float:
        processor.reset()
        push_one = processor.push_one
        started = work_clock()
        for t, x, y, p in rows:
            push_one(t, x, y, p)
        processor.finish()
        return 1e9 * (work_clock() - started) / len(rows)

    return run


def _packets(processor: Processor, events: np.ndarray, size: int) -> Callable[[], float]:
    packets = [events[first : first + size] for first in range(0, len(events), size)]

    def run() -> float:
        processor.reset()
        started = work_clock()
        for packet in packets:
            processor.push(packet)
        processor.finish()
        return 1e9 * (work_clock() - started) / len(events)

    return run


def _batch_windows(model: Model, events: np.ndarray) -> Callable[[], float]:
    import torch

    from async_tnt.checking.torch_batch import TorchBatch, as_tensors

    batch = TorchBatch.of(model)
    starts = _window_starts(model.config, events)
    edges = np.searchsorted(events["t"], [*starts, starts[-1] + model.config.window_us])
    windows = [events[a:b] for a, b in pairwise(edges)]
    processor = Processor(model)
    decisions = processor.push(events) + processor.finish()
    labels: list[int] = []

    def run() -> float:
        started = work_clock()
        with torch.inference_mode():
            found = [
                int(batch.logits(batch.volume(*as_tensors(window, start_us))).argmax())
                for window, start_us in zip(windows, starts, strict=True)
            ]
        taken = work_clock() - started
        labels[:] = found
        return 1e9 * taken / len(events)

    run()
    if labels != [decision.index for decision in decisions]:
        ours = [decision.index for decision in decisions]
        raise WorkDiffers(f"the windows' classes must be the same, got {ours} and {labels}")
    return run
