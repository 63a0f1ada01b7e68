"""Compare the stream with the batch reference on one recording: the promise of equality as a function.

(a) the streamed volume is bit for bit the same however the stream was cut into packets;
(b) at every prefix it equals the batch reference, to 1e-6 of its largest cell, the landmark to 1e-9 px;
(c) logits equal the reference pipeline's to 1e-4, and the class is the same;
(d) a decision after every event, for which only what changed is computed, has the bits of the whole network's.

With landmark "regressor" the landmark itself comes from float32 convolutions. There (b) is 1e-4 px for the landmark,
1e-6 of the largest cell for the volume about the stream's landmark, and 1e-2 for the volume about the reference's own.

Needs torch (extra `reference`), which is imported only when something is checked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.checking.reference import (
    reference_kept,
    reference_landmark,
    reference_pipeline,
    reference_volume,
)
from async_tnt.config import LANDMARKS, TNTConfig
from async_tnt.deferred_landmark import Regressor
from async_tnt.networks.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.networks.torch_modules import landmark_function
from async_tnt.processor import Processor
from async_tnt.volume import TNTVolume

PACKET_SIZES = (1, 2, 7, 100, 0)  # 0: everything at once
VOLUME_BOUND = 1e-6  # of the largest cell
CANCELLED = 1e-9  # events: where all cells are below it, opposite events cancelled and left their rounding
LANDMARK_BOUND = 1e-9  # pixels
LOGIT_BOUND = 1e-4
REGRESSED_LANDMARK_BOUND = 1e-4
REGRESSED_VOLUME_BOUND = 1e-2  # what a landmark at its bound may do: at TNT time tau an event moves by 1e-4 / tau


@dataclass
class Comparison:
    """One promise for one configuration: the worst of `n` comparisons, and its bound."""

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
        """Whether something was compared, and the worst difference is within the bound."""
        return self.n > 0 and self.worst <= self.bound


def configurations(base: TNTConfig) -> dict[str, TNTConfig]:
    """A configuration with every landmark (`regressor` where it has one), with the flow removed, and without the
    transform."""
    tnt = base.replace(transform="tnt", remove_flow=False)
    landmarks = [name for name in LANDMARKS if name != "regressor" or base.needs_regressor]
    every = {landmark: tnt.replace(landmark=landmark) for landmark in landmarks}
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
    model : its configuration, under every landmark, and its networks.
    prefixes : how many prefixes of each window are compared with the reference, evenly spread, the last one
        included; None for all of them (minutes for a recording of some thousand events).
    start_us : start of the first window; the first event by default.
    on_progress : called after every configuration.
    """
    comparisons = []
    for name, config in configurations(model.config).items():
        comparisons += _check_config(events, name, config, model, prefixes, start_us, packet_sizes)
        on_progress()
    comparisons += _check_network(events, model, prefixes, start_us)
    on_progress()
    return comparisons


def _check_config(
    events: np.ndarray,
    name: str,
    config: TNTConfig,
    model: Model,
    prefixes: int | None,
    start_us: int | None,
    packet_sizes: Sequence[int],
) -> list[Comparison]:
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    expected = closed_volumes(events, config, packet_sizes[0], start_us, regressor)
    packets = Comparison("bits that depend on packets", name, 0.0)
    for size in packet_sizes[1:]:
        got = closed_volumes(events, config, size, start_us, regressor)
        packets.add(abs(len(got) - len(expected)))
        for (start_a, a), (start_b, b) in zip(expected, got, strict=False):
            packets.add(float(np.count_nonzero(a.view(np.uint32) != b.view(np.uint32)) + (start_a != start_b)))

    at_prefix: _Prefix | _RegressedPrefix
    at_prefix = _RegressedPrefix(name, model) if config.needs_regressor else _Prefix(name, config)
    volume = TNTVolume(config, regressor=regressor)
    for start, _ in expected:
        inside = _events_of_window(events, start, config.window_us)
        volume.open(start)
        before = 0
        for n in _spread(inside.size, prefixes):
            volume.update(inside[before:n])
            before = n
            at_prefix.compare(volume, inside[:n], start)
    return [packets, *at_prefix.comparisons]


class _Prefix:
    """Promise (b) on one configuration."""

    def __init__(self, name: str, config: TNTConfig) -> None:
        self.config = config
        self.volumes = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
        self.landmarks = Comparison("landmark against reference, px", name, LANDMARK_BOUND)
        self.comparisons = [self.volumes, self.landmarks] if config.transform == "tnt" else [self.volumes]

    def compare(self, volume: TNTVolume, events: np.ndarray, start_us: int) -> None:
        self.volumes.add(_difference(volume.array, reference_volume(events, self.config, start_us)))
        if self.config.transform == "tnt":
            self.landmarks.add(_distance(volume.landmark, reference_landmark(events, self.config, start_us)))


class _RegressedPrefix:
    """Promise (b) with landmark "regressor"."""

    def __init__(self, name: str, model: Model) -> None:
        self.config = model.config
        self.regressor = landmark_function(model)
        self.about_ours = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
        self.landmarks = Comparison("landmark against reference, px", name, REGRESSED_LANDMARK_BOUND)
        self.about_theirs = Comparison("volume against reference, its own landmark", name, REGRESSED_VOLUME_BOUND)
        self.comparisons = [self.landmarks, self.about_ours, self.about_theirs]

    def compare(self, volume: TNTVolume, events: np.ndarray, start_us: int) -> None:
        ours, config = volume.landmark, self.config
        theirs = self.regressor(reference_volume(events, config.replace(transform="none"), start_us))
        self.landmarks.add(_distance(ours, theirs))
        self.about_ours.add(_difference(volume.array, reference_volume(events, config, start_us, ours)))
        # An event within a millionth of a pixel of the border may be kept about one landmark and not about the
        # other: a whole event of difference, in the outermost cells.
        kept, kept_by_theirs = (reference_kept(events, config, start_us, landmark) for landmark in (ours, theirs))
        rim = 0 if np.array_equal(kept, kept_by_theirs) else 1
        self.about_theirs.add(_difference(volume.array, reference_volume(events, config, start_us, theirs), rim))


def _difference(volume: np.ndarray, reference: np.ndarray, rim: int = 0) -> float:
    """The largest difference, without `rim` rows and columns on each side, as a share of the largest cell."""
    largest = max(float(np.abs(reference).max()), float(np.abs(volume).max()), CANCELLED)
    height, width = volume.shape[-2:]
    inner = np.abs(volume - reference)[:, rim : height - rim, rim : width - rim]
    return float(inner.max()) / largest


def _distance(landmark: tuple[float, float], reference: tuple[float, float]) -> float:
    return float(np.abs(np.subtract(landmark, reference)).max())


def _check_network(events: np.ndarray, model: Model, prefixes: int | None, start_us: int | None) -> list[Comparison]:
    """Promises (c) and (d): a decision after each event, in packets, looked at where prefixes end."""
    renewed = Comparison("bits that depend on earlier decisions", "the model", 0.0)
    logits = Comparison("logits against reference", "the model", LOGIT_BOUND)
    classes = Comparison("classes that differ", "the model", 0.0)
    config, dense, pipeline = model.config, CompiledClassifier(model), reference_pipeline(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    renewing = CompiledClassifier(model)  # through all windows
    for start, _ in closed_volumes(events, config, 0, start_us, regressor):
        inside = _events_of_window(events, start, config.window_us)
        # with a landmark that is found at each read, a decision after each event is as slow as the window is long
        every = None if config.needs_replay else 1
        processor = Processor(model, classifier=renewing, start_us=start, every_events=every)
        before = 0
        for n in _spread(inside.size, prefixes):
            decisions = processor.push(inside[before:n])
            before = n
            ours = decisions[-1].logits if every else processor.fire().logits
            whole = dense(processor.volume())
            theirs = pipeline(inside[:n], start)
            renewed.add(float(np.count_nonzero(ours.view(np.uint32) != whole.view(np.uint32))))
            logits.add(float(np.abs(ours - theirs).max()))
            second, first = np.sort(theirs)[-2:] if theirs.size > 1 else (-np.inf, theirs[0])
            if first - second > 2 * LOGIT_BOUND:  # else either class keeps promise (c)
                classes.add(float(ours.argmax() != theirs.argmax()))
    return [renewed, logits, classes]


def closed_volumes(
    events: np.ndarray, config: TNTConfig, packet_size: int, start_us: int | None, regressor: Regressor | None = None
) -> list[tuple[int, np.ndarray]]:
    """(start, volume) of each window with events, streamed in packets of a size (0: all at once; 1: event by
    event as Python's own integers)."""
    volumes: list[np.ndarray] = []

    def keep(volume: np.ndarray) -> list[float]:
        volumes.append(volume.copy())
        return [0.0]

    processor = Processor(config, classifier=keep, regressor=regressor, start_us=start_us)
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


def _events_of_window(events: np.ndarray, start_us: int, window_us: int) -> np.ndarray:
    """Those the stream adds to a window: an event that comes after the window closed is late."""
    still_open = np.maximum.accumulate(events["t"]) < start_us + window_us
    return events[still_open & (events["t"] >= start_us)]


def _spread(n: int, count: int | None) -> list[int]:
    """Up to `count` of 1..n, evenly spread, n included."""
    if count is None or count >= n:
        return list(range(1, n + 1))
    return sorted({round(k * n / count) for k in range(1, count + 1)} - {0})
