"""Latency from the last event to the decision: stream and batch, interleaved, on one recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from experiments.bench_interleaved import WorkDiffers, check_logits
from experiments.bench_moments import windows_of
from experiments.bench_timing import interleave, latency, no_collector, spread, work_clock
from experiments.bench_volumes import PACKETS, timed_packets, timed_singles

TOLERANCE = 1e-4
"""Largest difference of a cell, as a share of the largest cell."""


def bench_stream(model: Model, events: np.ndarray, *, rounds: int, with_torch: bool) -> dict[str, Any]:
    """Nanoseconds per event of a whole recording through a Processor, its windows' decisions included.

    With torch, `batch` is the best case of batch processing: each window once, when all its events have arrived. Both
    must give the same classes.
    """
    windows = windows_of(events, model.config.window_us)
    processor = Processor(model, start_us=0)
    cases = {
        "single": timed_singles(
            processor.push_one, [events[name] for name in "txyp"], processor.reset, processor.finish
        )
    }
    for size in PACKETS:
        packets = [events[first : first + size] for first in range(0, len(events), size)]
        cases[f"packet_{size}_structured"] = timed_packets(
            processor.push, packets, len(events), processor.reset, processor.finish
        )
    if with_torch:
        classes = [decision.index for decision in processor.push(events) + processor.finish()]
        cases["batch"] = _batch_windows(model, windows, classes)
    measured = interleave(cases, rounds)
    return {
        "events": len(events),
        "windows": len(windows),
        "ns_per_event": {name: spread(values) for name, values in measured.items()},
    }


def bench_latency(model: Model, events: np.ndarray, *, moments: int, with_torch: bool) -> dict[str, Any]:
    """Microseconds from the call with the last event to the decision, at many moments of a stream.

    Stream: `push_one` of the event, then `fire`. Batch: the volume of the window's events up to this one, whose
    tensors are prepared, then the network. Both run at every moment, in alternating order, and all volumes and logits
    are compared.

    Raises
    ------
    WorkDiffers : volumes are not equal within TOLERANCE, or logits within LOGIT_TOLERANCE.
    """
    processor, window_us = Processor(model, start_us=0), model.config.window_us
    batch = None
    taken: dict[str, list[float]] = {"stream": [], "push_one": [], "fire": []}
    if with_torch:
        from experiments.bench_torch_batch import TorchBatch

        batch = TorchBatch(model.config, model)
        taken |= {"batch": [], "batch_volume": [], "batch_network": []}
    worst = {"volume": 0.0, "logits": 0.0}
    at = np.unique(np.linspace(len(events) // 50, len(events) - 1, moments).astype(int))
    n_warm = min(20, len(at) // 4)
    done = 0
    with no_collector():
        for k, i in enumerate(at):
            processor.push(events[done:i])
            done = int(i) + 1
            start_us = int(events["t"][i]) // window_us * window_us
            window = events[int(np.searchsorted(events["t"], start_us)) : done]
            found = _time_batch(batch, window, start_us, taken) if k % 2 else None
            decision = _time_stream(processor, events[i], taken)
            found = found or _time_batch(batch, window, start_us, taken)
            if found is not None:
                where = f"{decision.time_us} us"
                worst["volume"] = max(worst["volume"], _check_volumes(processor.volume(), found[0], where))
                logits = {"stream": decision.logits, "batch": found[1]}
                worst["logits"] = max(worst["logits"], check_logits(logits, where))
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
    t, x, y, p = event.tolist()
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
) -> tuple[np.ndarray, np.ndarray] | None:
    """Volume and logits; None without a batch to time."""
    if batch is None:
        return None
    import torch

    from experiments.bench_torch_batch import as_tensors

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
    return volume.numpy(), logits.numpy()


def _check_volumes(ours: np.ndarray, theirs: np.ndarray, where: str) -> float:
    differ = float(np.abs(ours - theirs).max() / max(np.abs(ours).max(), 1e-30))
    if not differ <= TOLERANCE:
        raise WorkDiffers(f"stream and batch must agree within {TOLERANCE}, got volumes {differ:.1e} apart at {where}")
    return differ


def _batch_windows(model: Model, windows: list[np.ndarray], classes: list[int]) -> Callable[[], float]:
    import torch

    from experiments.bench_torch_batch import TorchBatch, as_tensors

    batch = TorchBatch(model.config, model)

    def run() -> float:
        started = work_clock()
        with torch.inference_mode():
            found = [int(batch.logits(batch.volume(*as_tensors(window, 0))).argmax()) for window in windows]
        taken = work_clock() - started
        if found != classes:
            raise WorkDiffers(f"the windows' classes must be the same, got {classes} and {found}")
        return 1e9 * taken / sum(map(len, windows))

    return run
