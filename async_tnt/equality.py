"""Hold the stream against the batch reference on one recording: the product's promise, as a function.

(a) the streamed volume is bit for bit the same however the stream was cut into packets;
(b) at every prefix it equals the batch reference, to 1e-6 of its largest cell, the landmark to 1e-9 px;
(c) logits equal the reference network's to 1e-4, and the class is the same.

Needs torch (extra `reference`), which is imported only when something is checked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .classifier import CompiledClassifier
from .config import LANDMARKS, TNTConfig
from .model import Model
from .processor import Processor
from .volume import TNTVolume

PACKET_SIZES = (1, 2, 7, 100, 0)  # 0: everything at once
VOLUME_BOUND = 1e-6  # of the largest cell
LANDMARK_BOUND = 1e-9  # pixels
LOGIT_BOUND = 1e-4


@dataclass
class Comparison:
    """One promise on one configuration: the worst of `n` comparisons, and the bound it has to keep."""

    what: str
    config: str
    bound: float
    n: int = 0
    worst: float = 0.0

    def add(self, difference: float) -> None:
        self.n += 1
        if not (math.isnan(self.worst) or difference <= self.worst):  # a nan must stay, and fail
            self.worst = float(difference)

    @property
    def holds(self) -> bool:
        """Whether something was compared, and the worst difference keeps the bound."""
        return self.n > 0 and self.worst <= self.bound


def configurations(base: TNTConfig) -> dict[str, TNTConfig]:
    """A configuration with every landmark, with the flow removed, and without the transform."""
    tnt = base.replace(transform="tnt", remove_flow=False)
    every = {landmark: tnt.replace(landmark=landmark) for landmark in LANDMARKS}
    every["line, flow removed"] = tnt.replace(landmark="line", remove_flow=True)
    every["no transform"] = tnt.replace(landmark="center", transform="none")
    return every


def check_recording(
    events: np.ndarray,
    model: Model,
    *,
    prefixes: int | None = 8,
    start_us: int | None = None,
    packet_sizes: Sequence[int] = PACKET_SIZES,
    on_progress: Callable[[], None] = lambda: None,
) -> list[Comparison]:
    """Check all promises on one recording.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`.
    model : its configuration, under every landmark, and its network.
    prefixes : how many prefixes of each window are held against the reference, evenly spread, the last one
        included; None for all of them (minutes for a recording of some thousand events).
    start_us : start of the first window; the first event by default.
    on_progress : called after every configuration.
    """
    comparisons = []
    for name, config in configurations(model.config).items():
        comparisons += _check_config(events, name, config, prefixes, start_us, packet_sizes)
        on_progress()
    comparisons += _check_network(events, model, start_us)
    on_progress()
    return comparisons


def _check_config(
    events: np.ndarray, name: str, config: TNTConfig, prefixes: int | None, start_us: int | None,
    packet_sizes: Sequence[int],
) -> list[Comparison]:  # fmt: skip
    packets = Comparison("bits that depend on packets", name, 0.0)
    volumes = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
    landmarks = Comparison("landmark against reference, px", name, LANDMARK_BOUND)

    expected = closed_volumes(events, config, packet_sizes[0], start_us)
    for size in packet_sizes[1:]:
        got = closed_volumes(events, config, size, start_us)
        packets.add(abs(len(got) - len(expected)))
        for (start_a, a), (start_b, b) in zip(expected, got, strict=False):
            packets.add(float(np.count_nonzero(a.view(np.uint32) != b.view(np.uint32)) + (start_a != start_b)))

    volume = TNTVolume(config)
    for start, _ in expected:
        inside = _events_of_window(events, start, config.window_us)
        volume.open(start)
        before = 0
        for n in _spread(inside.size, prefixes):
            volume.update(inside[before:n])
            before = n
            reference = reference_volume(inside[:n], config, start)
            largest = max(float(np.abs(reference).max()), 1e-30)
            volumes.add(float(np.abs(volume.array - reference).max()) / largest)
            if config.transform == "tnt":
                difference = np.subtract(volume.landmark, reference_landmark(inside[:n], config, start))
                landmarks.add(float(np.abs(difference).max()))
    return [packets, volumes, landmarks] if config.transform == "tnt" else [packets, volumes]


def _check_network(events: np.ndarray, model: Model, start_us: int | None) -> list[Comparison]:
    logits = Comparison("logits against reference", "the model", LOGIT_BOUND)
    classes = Comparison("classes that differ", "the model", 0.0)
    network, reference = CompiledClassifier(model), reference_network(model)
    for start, volume in closed_volumes(events, model.config, 0, start_us):
        inside = _events_of_window(events, start, model.config.window_us)
        ours = network(volume)
        theirs = reference(reference_volume(inside, model.config, start))
        logits.add(float(np.abs(ours - theirs).max()))
        classes.add(float(ours.argmax() != theirs.argmax()))
    return [logits, classes]


def closed_volumes(
    events: np.ndarray, config: TNTConfig, packet_size: int, start_us: int | None
) -> list[tuple[int, np.ndarray]]:
    """(start, volume) of each window with events, streamed in packets of a size (0: all at once; 1: event by
    event as Python's own integers)."""
    volumes: list[np.ndarray] = []

    def keep(volume: np.ndarray) -> list[float]:
        volumes.append(volume.copy())
        return [0.0]

    processor = Processor(config, classifier=keep, start_us=start_us)
    decisions = []
    if packet_size == 1:
        for t, x, y, p in zip(*(events[field].tolist() for field in ("t", "x", "y", "p")), strict=True):
            decisions += processor.push_one(t, x, y, p)
    else:
        size = packet_size or max(1, events.size)
        for first in range(0, events.size, size):
            decisions += processor.push(events[first : first + size])
    decisions += processor.finish()
    return [(decision.window_start_us, volume) for decision, volume in zip(decisions, volumes, strict=True)]


def reference_volume(events: np.ndarray, config: TNTConfig, start_us: int) -> np.ndarray:
    """What the batch reference makes of a window's events: float32, shape (C, H, W)."""
    import tnt_reference

    where = _where(config, start_us) | {"bins": config.bins, "polarity": config.polarity}
    columns = [events[field] for field in ("t", "x", "y", "p")]
    if config.transform == "none":
        return tnt_reference.event_volume(*columns, **where).numpy()
    return tnt_reference.tnt_volume(
        *columns, **where, t_max=config.t_max, landmark=config.landmark, remove_flow=config.remove_flow
    ).numpy()


def reference_landmark(events: np.ndarray, config: TNTConfig, start_us: int) -> tuple[float, float]:
    """The batch reference's landmark of the newest event, in grid pixels."""
    import tnt_reference

    columns = [events[field] for field in ("t", "x", "y")]
    x, y = tnt_reference.landmark(config.landmark, *columns, **_where(config, start_us))[-1].tolist()
    return x, y


def reference_network(model: Model) -> Callable[[np.ndarray], np.ndarray]:
    """The model's network in torch: volume -> logits."""
    import tnt_reference
    import torch

    f1, f2, f3 = (len(model.weights[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1"))
    network = tnt_reference.Classifier(model.config.channels, model.config.grid, len(model.classes), (f1, f2, f3))
    network.load_state_dict({name: torch.tensor(w) for name, w in model.weights.items()})

    def forward(volume: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return network(torch.tensor(volume)).numpy()

    return forward


def _events_of_window(events: np.ndarray, start_us: int, window_us: int) -> np.ndarray:
    """Those the stream adds to a window: an event that comes after the window closed is late."""
    still_open = np.maximum.accumulate(events["t"]) < start_us + window_us
    return events[still_open & (events["t"] >= start_us)]


def _where(config: TNTConfig, start_us: int) -> dict[str, Any]:
    return {
        "start_us": start_us,
        "window_us": config.window_us,
        "sensor": config.sensor,
        "grid": config.grid,
    }


def _spread(n: int, count: int | None) -> list[int]:
    """Up to `count` of 1..n, evenly spread, n included."""
    if count is None or count >= n:
        return list(range(1, n + 1))
    return sorted({round(k * n / count) for k in range(1, count + 1)} - {0})
