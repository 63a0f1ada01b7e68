"""Compare the stream with the batch reference on one recording: the promise of equality as a
function.

(a) the streamed volume is bit for bit the same however the stream was cut into packets, and made of
the events that
    the reference has in that window;
(b) at every prefix it equals the batch reference, to 1e-6 of its largest cell, the landmark to 1e-9
px; (c) logits equal the reference's to 1e-4 (of the largest, where it exceeds 1), and with them the
class, but for ties; (d) a decision after every event, for which only what changed is computed, has
the bits of the whole network's;

but for (b) where the tolerance of the border ends, 1e-9 px beyond it, where rounding decides
whether an event is kept, and for (d) if the caller switches `torch.set_flush_denormal` between two
decisions.

Needs torch (extra `reference`), which is imported only when something is checked.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.torch_modules import landmark_function
from async_tnt.streaming.processor import Processor
from async_tnt.volume.config import LANDMARKS, TIME_IMAGES, TNTConfig
from async_tnt.volume.regressor import Regressor
from async_tnt.volume.volume import TNTVolume

PACKET_SIZES = (1, 2, 7, 100, 0)  # 0: everything at once
VOLUME_BOUND = 1e-6  # of the largest cell
# events: where all cells are below it, opposite events cancelled and left their rounding
CANCELLED = 1e-9
LANDMARK_BOUND = 1e-9  # pixels
LOGIT_BOUND = 1e-4
REGRESSED_LANDMARK_BOUND = 1e-4  # landmark "regressor" comes from float32 convolutions


@dataclass
class Comparison:
    """One promise for one configuration: the worst of `n` comparisons, and its bound."""

    what: str
    config: str
    bound: float
    n: int = 0
    worst: float = 0.0

    def add(self, difference: float) -> None:
        self.include(Comparison(self.what, self.config, self.bound, 1, float(difference)))

    def include(self, other: Comparison) -> None:
        """Merge the comparisons of another recording."""
        self.n += other.n
        if not (math.isnan(self.worst) or other.worst <= self.worst):  # a nan must stay, and fail
            self.worst = other.worst

    @property
    def holds(self) -> bool:
        """Whether something was compared, and the worst difference is within the bound."""
        return self.n > 0 and self.worst <= self.bound


def configurations(base: TNTConfig) -> dict[str, TNTConfig]:
    """A configuration with every landmark (`regressor` where it has one), with the flow removed,
    and without the transform; images of times have only the last."""
    if base.representation in TIME_IMAGES:
        return {"no transform": base}
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
    on_progress: Callable[[], None] = lambda: None,
) -> list[Comparison]:
    """Check all promises on one recording.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`.
    model : its configuration, under every landmark, and its networks.
    prefixes : how many prefixes of each window are compared with the reference, evenly spread, the
        last one included; None for all of them (minutes for a recording of some thousand events).
    start_us : start of the first window; the first event by default.
    on_progress : called after every configuration.
    """
    comparisons = []
    for name, config in configurations(model.config).items():
        comparisons += _check_config(events, name, config, model, prefixes, start_us)
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
) -> list[Comparison]:
    """Promises (a) and (b) for one configuration."""
    from async_tnt.checking.reference import reference_landmark, reference_volume, reference_windows

    regressed, transformed = config.needs_regressor, config.transform == "tnt"
    regressor = CompiledRegressor(model) if regressed else None
    find_landmark = landmark_function(model) if regressed else None
    packets = Comparison("volumes that depend on packets", name, 0.0)
    volumes = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
    landmark_bound = REGRESSED_LANDMARK_BOUND if regressed else LANDMARK_BOUND
    landmarks = Comparison("landmark against reference, px", name, landmark_bound)

    expected = _closed_windows(events, config, PACKET_SIZES[0], start_us, regressor)
    for size in PACKET_SIZES[1:]:
        got = _closed_windows(events, config, size, start_us, regressor)
        packets.add(abs(len(got) - len(expected)))
        for one, other in zip(expected, got, strict=False):
            packets.add(float(one != other))

    volume = TNTVolume(config, regressor=regressor)
    windows = Comparison("windows against reference", name, 0.0)
    in_reference = reference_windows(events, config, start_us)
    windows.add(float([start for start, _ in expected] != [start for start, _ in in_reference]))
    of_window = dict(expected)
    for start, inside, ends in _prefixes(in_reference, prefixes):
        volume.open(start)
        for before, n in pairwise([0, *ends]):
            volume.update(inside[before:n])
            seen, ours = inside[:n], volume.landmark
            reference = reference_volume(seen, config, start, ours if regressed else None)
            volumes.add(_difference(volume.array, reference))
            if find_landmark is not None:
                theirs = find_landmark(
                    reference_volume(seen, config.replace(transform="none"), start)
                )
                landmarks.add(_distance(ours, theirs))
            elif transformed:
                landmarks.add(_distance(ours, reference_landmark(seen, config, start)))
        windows.add(float(_digest(volume.array) != of_window.get(start)))
    return [packets, windows, volumes, *[landmarks] * transformed]


def _check_network(
    events: np.ndarray, model: Model, prefixes: int | None, start_us: int | None
) -> list[Comparison]:
    """Promises (c) and (d): a decision after each event, in packets, compared where prefixes
    end."""
    from async_tnt.checking.reference import reference_pipeline, reference_windows

    repeated = Comparison("bits that depend on earlier decisions", "the model", 0.0)
    logits = Comparison("logits against reference", "the model", LOGIT_BOUND)
    config, dense, pipeline = model.config, CompiledClassifier(model), reference_pipeline(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    incremental = CompiledClassifier(model)  # through all windows
    # with a landmark that is found at each read, a decision after each event is as slow as the
    # window is long
    every = None if config.needs_replay else 1
    for start, inside, ends in _prefixes(reference_windows(events, config, start_us), prefixes):
        if config.window_events is None:
            first_us, still_open = start, config
        else:  # a full window would be closed, and could not be read
            first_us, still_open = None, config.replace(window_events=inside.size + 1)
        processor = Processor(
            still_open,
            classifier=incremental,
            regressor=regressor,
            start_us=first_us,
            every_events=every,
        )
        for before, n in pairwise([0, *ends]):
            decisions = processor.push(inside[before:n])
            ours = decisions[-1].logits if every else processor.fire().logits
            whole = dense(processor.volume())
            theirs = pipeline(inside[:n], start).reshape(ours.shape)
            repeated.add(float(np.count_nonzero(ours.view(np.uint32) != whole.view(np.uint32))))
            logits.add(float(np.abs(ours - theirs).max() / max(1.0, np.abs(theirs).max())))
    return [repeated, logits]


def _difference(volume: np.ndarray, reference: np.ndarray) -> float:
    """The largest difference, as a share of the largest cell."""
    largest = max(float(np.abs(reference).max()), float(np.abs(volume).max()), CANCELLED)
    return float(np.abs(volume - reference).max()) / largest


def _distance(landmark: tuple[float, float], reference: tuple[float, float]) -> float:
    return float(np.abs(np.subtract(landmark, reference)).max())


def _closed_windows(
    events: np.ndarray,
    config: TNTConfig,
    packet_size: int,
    start_us: int | None,
    regressor: Regressor | None = None,
) -> list[tuple[int, bytes]]:
    """The start of each window with events, and the digest of its volume; streamed in packets of a
    size (0: all at once; 1: event by event as Python's own integers)."""
    digests: list[bytes] = []

    def keep(volume: np.ndarray) -> list[float]:
        digests.append(_digest(volume))
        return [0.0]

    processor = Processor(config, classifier=keep, regressor=regressor, start_us=start_us)
    size = packet_size or max(1, events.size)
    packets = (
        events.tolist()
        if packet_size == 1
        else [events[k : k + size] for k in range(0, events.size, size)]
    )
    decisions = [
        decision for packet in packets for decision in processor.push(packet)
    ] + processor.finish()
    return [
        (decision.window_start_us, digest)
        for decision, digest in zip(decisions, digests, strict=True)
    ]


def _digest(volume: np.ndarray) -> bytes:
    return hashlib.blake2b(volume.tobytes()).digest()


def _prefixes(
    windows: list[tuple[int, np.ndarray]], prefixes: int | None
) -> Iterator[tuple[int, np.ndarray, list[int]]]:
    """The start of each window, its events, and the lengths of the prefixes to compare."""
    for start_us, inside in windows:
        n = inside.size
        count = n if prefixes is None else min(prefixes, n)
        yield start_us, inside, [round(k * n / count) for k in range(1, count + 1)]
