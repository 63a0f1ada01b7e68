"""What a window that slides costs, beside windows that grow and windows that are replayed.

    python -m experiments.sliding [--quick] [--json FILE]

Events into volumes: packets of 1,300 events on three sensors, by turns. Images of counts: a window
that grows, the last 5,000 events, the last 30 ms. Five bins: a window that grows, and the last 30
ms in five slices.

Decisions after every event: the network of RoShamBo (Lungu et al. 2017) with random weights, on an
image of counts of 64x64 pixels, with about 5,000 events in the window. Where a window slides, two
places change at each decision: an event comes, and one leaves. So a growing window with two new
events a decision is measured, too. `window_events` computes its image again from all events, and
the network wherever these reach. The multiplications that the changed pixels reach are counted. In
the window of the last events it is verified that each image holds exactly these, and that each
decision has the bits of the whole network.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

if __name__ == "__main__":  # libraries read these variables when they are imported
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, TNTVolume
from async_tnt.base.progress import progress
from async_tnt.checking.sliding import reference_counts
from async_tnt.volume.events import EVENT_DTYPE
from experiments.published.event_networks import roshambo
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.interleaved import WorkDiffers
from experiments.speed.timing import interleave, latency, machine, no_collector, one_thread, spread

SENSORS = ((34, 34), (346, 260), (1280, 720))
"""Width and height of the sensors, in pixels."""

N_LAST = 5_000
"""Number of events in a window of `last_events`."""

LAST_US = 30_000
"""Length of a window of `last_us`, in microseconds."""

PACKET = 1_300
"""Number of events in a packet."""

N_EVENTS = 130_000
"""Number of events that a round adds to a volume."""

ROUNDS = 15
"""Number of rounds in which volumes take turns."""

RARELY = 10
"""A window that is replayed decides once in so many decisions of the others."""

SIDE = 64
"""Width and height of RoShamBo's image, in pixels."""

N_DECISIONS = 1_000
"""Number of decisions of each kind of window."""

EVENT_US = 6
"""Time between two events, in microseconds: 30 ms then have 5,000 events."""


def events_of(n: int, sensor: tuple[int, int], seed: int) -> np.ndarray:
    """Events of a spot that moves around the middle of a sensor."""
    rng = np.random.default_rng(seed)
    events = np.empty(n, EVENT_DTYPE)
    events["t"] = EVENT_US * np.arange(1, n + 1)
    angle = 2 * np.pi * np.arange(n) / 20_000
    for axis, side, shift in zip("xy", sensor, (np.cos(angle), np.sin(angle)), strict=True):
        places = side * (0.5 + 0.25 * shift + rng.normal(0, 1 / 16, n))
        events[axis] = np.clip(places, 0, side - 1).astype(np.int64)
    events["p"] = rng.integers(0, 2, n)
    return events


def config_of(sensor: tuple[int, int], polarity: str = "split", **window: Any) -> TNTConfig:
    """An image of counts on the sensor's own grid, unless `window` has another representation."""
    settings = {"representation": "count", "polarity": polarity, **window}
    return TNTConfig(sensor=sensor, grid=sensor, **settings)


BINS: dict[str, Any] = {"representation": "volume", "transform": "none", "bins": 5}
"""Settings of a volume with bins."""

WINDOWS: dict[str, dict[str, Any]] = {
    "growing": {"window_us": 3_600_000_000},
    "last events": {"last_events": N_LAST},
    "last microseconds": {"last_us": LAST_US},
    "growing, 5 bins": {"window_us": EVENT_US * N_EVENTS, **BINS},
    "last microseconds, 5 slices": {"last_us": LAST_US, **BINS},
}
"""Kind of window -> its settings."""

COMPARED_WITH = {name: "growing, 5 bins" if "5" in name else "growing" for name in WINDOWS}
"""Kind of window -> the growing window with which it is compared."""


def volume_times(sensor: tuple[int, int], rounds: int, n_events: int) -> dict[str, Any]:
    """Nanoseconds of an event into volumes of each kind, and the ratios to a growing window."""
    events = events_of(n_events, sensor, 0)
    packets = [events[first : first + PACKET].copy() for first in range(0, n_events, PACKET)]

    def case(window: dict[str, Any]) -> Callable[[], float]:
        volume = TNTVolume(config_of(sensor, **window))

        def run() -> float:
            volume.open(0)
            started = time.perf_counter()
            for packet in packets:
                volume.update(packet)
            return 1e9 * (time.perf_counter() - started) / n_events

        return run

    with no_collector():
        ns = interleave({name: case(window) for name, window in WINDOWS.items()}, rounds)
    return {
        "ns": {name: spread(values) for name, values in ns.items()},
        "ratio": {name: spread(values / ns[COMPARED_WITH[name]]) for name, values in ns.items()},
    }


def roshambo_model(**window: Any) -> Model:
    """RoShamBo's network with the same random weights at each call."""
    import torch

    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = roshambo().eval()
    config = config_of((SIDE, SIDE), "unsigned", **window)
    return Model.from_torch(module, config, classes=["paper", "scissors", "rock", "nothing"])


def reached_multiplications(model: Model, events: np.ndarray) -> int:
    """How many multiplications the pixels of events reach in RoShamBo's network."""
    changed: Any = np.zeros((SIDE, SIDE), bool)
    changed[events["y"], events["x"]] = True
    n = 0
    for layer in model.layers:
        if layer["op"] == "conv":
            weight = model.weights[layer["weights"]["weight"]]
            kernel = weight.shape[2:]
            padded = np.pad(changed, kernel[0] // 2)
            changed = np.any(sliding_window_view(padded, kernel), axis=(2, 3))
            n += int(changed.sum()) * weight.size
        elif layer["op"] == "max_pool":
            rows, columns = changed.shape
            changed = np.any(changed.reshape(rows // 2, 2, columns // 2, 2), axis=(1, 3))
        elif layer["op"] == "dense":
            n += model.weights[layer["weights"]["weight"]].size
    return n


def median_multiplications(
    model: Model, events: np.ndarray, new: dict[str, int], n_decisions: int
) -> dict[str, float]:
    """Kind of window -> the multiplications that a decision's changed pixels reach, the median.

    Parameters
    ----------
    events : all events. The first decisions come after `N_LAST` of them.
    new : kind of window -> new events a decision.
    """
    medians = {}
    for name, n_new in new.items():
        counts = []
        is_replayed = name.startswith("window_events")
        for k in range(len(range(0, n_decisions, RARELY)) if is_replayed else n_decisions):
            first = N_LAST + k * n_new
            changed = events[first : first + n_new]
            if name.startswith("last"):
                left = events[first - N_LAST : first - N_LAST + 1]
                changed = np.concatenate([changed, left])
            if is_replayed:
                changed = events[: first + n_new]  # all of the window
            counts.append(reached_multiplications(model, changed))
        medians[name] = float(np.median(counts))
    return medians


def decision_times(n_decisions: int) -> dict[str, Any]:
    """Microseconds of decisions after every event, for each kind of window, by turns."""
    n_new = 3 * n_decisions
    events = events_of(N_LAST + n_new + 1, (SIDE, SIDE), 1)
    sliding = roshambo_model(last_events=N_LAST)
    growing = roshambo_model(window_us=3_600_000_000)
    replayed = roshambo_model(window_events=2 * N_LAST)
    processors = {
        "growing, 1 new event": Processor(growing, start_us=0),
        "growing, 2 new events": Processor(growing, start_us=0),
        "last events": Processor(sliding, start_us=0),
        "last microseconds": Processor(roshambo_model(last_us=LAST_US), start_us=0),
        "window_events, replayed": Processor(replayed),
    }
    new = dict.fromkeys(processors, 1) | {"growing, 2 new events": 2}
    whole = CompiledClassifier(sliding)
    pushed = dict.fromkeys(processors, N_LAST)
    for processor in processors.values():
        processor.push(events[:N_LAST])
        processor.fire()
    us: dict[str, list[float]] = {name: [] for name in processors}
    with progress(n_decisions, "decisions") as bar, no_collector():
        for k in range(n_decisions):
            names = list(processors) if k % 2 else list(reversed(processors))
            for name in names:
                if name.startswith("window_events") and k % RARELY:
                    continue  # it takes several times as long
                first = pushed[name]
                pushed[name] += new[name]
                processor = processors[name]
                part = [events[i].item() for i in range(first, pushed[name])]
                started = time.perf_counter()
                for event in part:
                    processor.push(event)
                decision = processor.fire()
                us[name].append(1e6 * (time.perf_counter() - started))
                if name == "last events":
                    image = reference_counts(events[: pushed[name]], sliding.config)
                    is_held = np.array_equal(processor.volume(), image)
                    if not is_held or whole(image).tobytes() != decision.logits.tobytes():
                        raise WorkDiffers("a decision is not that of the whole network")
            bar.update()
    two = np.array(us["growing, 2 new events"])
    return {
        "us": {name: latency(np.array(values)) for name, values in us.items()},
        "multiplications": median_multiplications(sliding, events, new, n_decisions),
        "ratio": float(np.median(np.array(us["last events"]) / two)),
        "replayed_ratio": float(
            np.median(us["window_events, replayed"]) / np.median(us["last events"])
        ),
    }


def measure(quick: bool) -> dict[str, Any]:
    """The report."""
    rounds = 2 if quick else ROUNDS
    n_events = 13_000 if quick else N_EVENTS
    with one_thread(True):
        return {
            "machine": machine("torch"),
            "events": {
                f"{width}x{height}": volume_times((width, height), rounds, n_events)
                for width, height in SENSORS
            },
            "decisions": decision_times(30 if quick else N_DECISIONS),
        }


def main(argv: list[str] | None = None) -> int:
    """Measure, print the tables, and write JSON if asked."""
    parser = script_parser("sliding", __doc__, "few events and decisions")
    return run_script(parser, argv, measure, "sliding")


if __name__ == "__main__":
    exit_with(main)
