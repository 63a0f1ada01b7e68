"""The comparison of the stream with the batch reference on one recording, by four promises.

(a) However the stream was cut into packets, the streamed volume is the same, bit for bit. It is
    made of the events that the reference has in that window.
(b) After every prefix of a window's events, the volume equals the reference's volume to 1e-6 of its
    largest cell, and the landmark equals the reference's landmark to 1e-9 pixels.
(c) The logits equal the reference's logits to 1e-4, or to 1e-4 of the largest logit where that
    exceeds 1. So the class is the same, too, except for ties.
(d) A decision after every event has the same bits as the answer of the whole network, though only
    the changed values are computed.

There are two exceptions. (b): events are kept up to 1e-9 pixels beyond the border. If an event lies
at just this distance, rounding decides whether it is kept. (d): the bits may differ if the caller
switches `torch.set_flush_denormal` between two decisions.

The comparison needs torch (extra `reference`), which is imported only when something is checked.
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

PACKET_SIZES = (1, 2, 7, 100, 0)
"""The packet sizes that are compared, in events. 0 stands for all events at once."""
VOLUME_BOUND = 1e-6
"""Largest difference of two volumes, as a share of the largest cell."""
CANCELLED = 1e-9
"""A small value of a cell, in events. If all cells are below it, opposite events have cancelled
each other, and only rounding errors are left."""
LANDMARK_BOUND = 1e-9
"""Largest distance of two landmarks, in grid pixels."""
REGRESSED_LANDMARK_BOUND = 1e-4
"""Largest distance of two landmarks, in grid pixels, for the landmark `regressor`. That landmark
comes from float32 convolutions."""
LOGIT_BOUND = 1e-4
"""Largest difference of two logits."""


@dataclass
class Comparison:
    """The comparisons for one promise and one configuration: the worst difference, and its bound.

    Parameters
    ----------
    what : the compared values, in words.
    config : name of the configuration.
    bound : largest difference that is allowed.
    n : number of comparisons so far.
    worst : largest difference so far.
    """

    what: str
    config: str
    bound: float
    n: int = 0
    worst: float = 0.0

    def add(self, difference: float) -> None:
        """Add one comparison with this difference."""
        self.include(Comparison(self.what, self.config, self.bound, 1, float(difference)))

    def include(self, other: Comparison) -> None:
        """Add the comparisons of another recording."""
        self.n += other.n
        # A nan must be taken over and then stay, so that the comparison fails. With a nan, `not <=`
        # is true, and `>` would be false.
        is_worse = not other.worst <= self.worst
        if is_worse and not math.isnan(self.worst):
            self.worst = other.worst

    @property
    def holds(self) -> bool:
        """Whether something was compared, and the worst difference is within the bound."""
        return self.n > 0 and self.worst <= self.bound


def configurations(base: TNTConfig) -> dict[str, TNTConfig]:
    """Name of a configuration -> configuration, for all that are compared.

    There is one for each landmark, one with the flow removed, and one without the transform. The
    landmark `regressor` is there only if `base` has it. If `base` makes images of times, it is the
    only one, because they have no transform.
    """
    if base.representation in TIME_IMAGES:
        return {"no transform": base}
    tnt = base.replace(transform="tnt", remove_flow=False)
    landmarks = [name for name in LANDMARKS if name != "regressor" or base.needs_regressor]
    configs = {landmark: tnt.replace(landmark=landmark) for landmark in landmarks}
    configs["line, flow removed"] = tnt.replace(landmark="line", remove_flow=True)
    configs["no transform"] = tnt.replace(landmark="center", transform="none")
    return configs


def check_recording(
    events: np.ndarray,
    model: Model,
    *,
    prefixes: int | None = 8,
    start_us: int | None = None,
    on_progress: Callable[[], None] = lambda: None,
) -> list[Comparison]:
    """The comparisons of all promises on one recording.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`.
    model : the model whose networks are checked. Its configuration is checked with every landmark.
    prefixes : number of prefixes of each window that are compared with the reference. They are
        evenly spread, and the last prefix is one of them. None: all prefixes, which takes minutes
        for some thousand events.
    start_us : start of the first window; the first event by default.
    on_progress : called after every configuration.
    """
    comparisons = []
    for name, config in configurations(model.config).items():
        regressor = CompiledRegressor(model) if config.needs_regressor else None
        closed = _closed_windows(events, config, PACKET_SIZES[0], start_us, regressor)
        comparisons.append(_check_packets(events, name, config, start_us, regressor, closed))
        comparisons += _check_volumes(events, name, config, model, prefixes, start_us, closed)
        on_progress()
    comparisons += _check_network(events, model, prefixes, start_us)
    on_progress()
    return comparisons


def _check_packets(
    events: np.ndarray,
    name: str,
    config: TNTConfig,
    start_us: int | None,
    regressor: Regressor | None,
    closed: list[tuple[int, bytes]],
) -> Comparison:
    """Check the first half of promise (a): volumes do not depend on packets.

    Parameters
    ----------
    closed : the `_closed_windows` for the first of `PACKET_SIZES`.
    """
    packets = Comparison("volumes that depend on packets", name, 0.0)
    for size in PACKET_SIZES[1:]:
        got = _closed_windows(events, config, size, start_us, regressor)
        packets.add(abs(len(got) - len(closed)))
        for one, other in zip(closed, got, strict=False):
            packets.add(float(one != other))
    return packets


def _check_volumes(
    events: np.ndarray,
    name: str,
    config: TNTConfig,
    model: Model,
    prefixes: int | None,
    start_us: int | None,
    closed: list[tuple[int, bytes]],
) -> list[Comparison]:
    """Check windows, volumes and landmarks: the second half of promise (a), and promise (b).

    Parameters
    ----------
    closed : the `_closed_windows` of a stream.
    """
    from async_tnt.checking.reference import reference_landmark, reference_volume, reference_windows

    is_regressed = config.needs_regressor
    landmark_bound = REGRESSED_LANDMARK_BOUND if is_regressed else LANDMARK_BOUND
    windows = Comparison("windows against reference", name, 0.0)
    volumes = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
    landmarks = Comparison("landmark against reference, px", name, landmark_bound)

    in_reference = reference_windows(events, config, start_us)
    starts = [start for start, _ in closed]
    windows.add(float(starts != [start for start, _ in in_reference]))

    digest_of = dict(closed)
    regressor = CompiledRegressor(model) if is_regressed else None
    find_landmark = landmark_function(model) if is_regressed else None
    untransformed = config.replace(transform="none") if is_regressed else config
    volume = TNTVolume(config, regressor=regressor)
    for start, inside, ends in _prefixes(in_reference, prefixes):
        volume.open(start)
        for before, n in pairwise([0, *ends]):
            volume.update(inside[before:n])
            seen = inside[:n]
            ours = volume.landmark
            reference = reference_volume(seen, config, start, ours if is_regressed else None)
            volumes.add(_difference(volume.array, reference))
            if find_landmark is not None:
                theirs = find_landmark(reference_volume(seen, untransformed, start))
                landmarks.add(_distance(ours, theirs))
            elif config.transform == "tnt":
                landmarks.add(_distance(ours, reference_landmark(seen, config, start)))
        windows.add(float(_digest(volume.array) != digest_of.get(start)))

    if config.transform == "tnt":
        return [windows, volumes, landmarks]
    return [windows, volumes]


def _check_network(
    events: np.ndarray, model: Model, prefixes: int | None, start_us: int | None
) -> list[Comparison]:
    """Check promise (c), that logits equal the reference's, and promise (d), about their bits.

    The stream decides after each event. The decisions at the ends of prefixes are compared.
    """
    from async_tnt.checking.reference import reference_pipeline, reference_windows

    repeated = Comparison("bits that depend on earlier decisions", "the model", 0.0)
    logits = Comparison("logits against reference", "the model", LOGIT_BOUND)
    config = model.config
    pipeline = reference_pipeline(model)
    whole_network = CompiledClassifier(model)
    # The same network is used for all windows: it must keep nothing of the previous window.
    incremental = CompiledClassifier(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    # If each read builds the volume anew from all events of the window, a decision after each event
    # would take too long. Then there are decisions only at the ends of prefixes.
    every_events = None if config.needs_replay else 1
    for start, inside, ends in _prefixes(reference_windows(events, config, start_us), prefixes):
        first_us: int | None = start
        still_open = config
        if config.window_events is not None:
            # A full window would be closed, and could not be read. So there is room for one event
            # more.
            first_us = None
            still_open = config.replace(window_events=inside.size + 1)
        processor = Processor(
            still_open,
            classifier=incremental,
            regressor=regressor,
            start_us=first_us,
            every_events=every_events,
        )
        for before, n in pairwise([0, *ends]):
            decisions = processor.push(inside[before:n])
            decision = processor.fire() if every_events is None else decisions[-1]
            ours = decision.logits
            whole = whole_network(processor.volume())
            theirs = pipeline(inside[:n], start).reshape(ours.shape)
            has_other_bits = ours.view(np.uint32) != whole.view(np.uint32)
            repeated.add(float(np.count_nonzero(has_other_bits)))
            largest = max(1.0, np.abs(theirs).max())
            logits.add(float(np.abs(ours - theirs).max() / largest))
    return [repeated, logits]


def _difference(volume: np.ndarray, reference: np.ndarray) -> float:
    """The largest difference of two volumes, as a share of the largest cell."""
    largest = max(float(np.abs(reference).max()), float(np.abs(volume).max()), CANCELLED)
    return float(np.abs(volume - reference).max()) / largest


def _distance(landmark: tuple[float, float], reference: tuple[float, float]) -> float:
    """The larger of the differences in x and in y."""
    return float(np.abs(np.subtract(landmark, reference)).max())


def _closed_windows(
    events: np.ndarray,
    config: TNTConfig,
    packet_size: int,
    start_us: int | None,
    regressor: Regressor | None = None,
) -> list[tuple[int, bytes]]:
    """For each window with events in one stream: its start, and the digest of its volume.

    Parameters
    ----------
    packet_size : number of events in a packet. 0: all events at once. 1: single events, as tuples
        of Python's own integers.
    """
    digests: list[bytes] = []

    # a classifier that only notes the digest of each volume it gets
    def keep(volume: np.ndarray) -> list[float]:
        digests.append(_digest(volume))
        return [0.0]

    processor = Processor(config, classifier=keep, regressor=regressor, start_us=start_us)
    if packet_size == 1:
        packets = events.tolist()
    else:
        size = packet_size or max(1, events.size)
        packets = [events[k : k + size] for k in range(0, events.size, size)]

    starts = []
    for packet in packets:
        starts += [decision.window_start_us for decision in processor.push(packet)]
    starts += [decision.window_start_us for decision in processor.finish()]
    return list(zip(starts, digests, strict=True))


def _digest(volume: np.ndarray) -> bytes:
    return hashlib.blake2b(volume.tobytes()).digest()


def _prefixes(
    windows: list[tuple[int, np.ndarray]], prefixes: int | None
) -> Iterator[tuple[int, np.ndarray, list[int]]]:
    """Yield each window's start, its events, and the lengths of the prefixes to compare."""
    for start_us, inside in windows:
        n = inside.size
        count = n if prefixes is None else min(prefixes, n)
        yield start_us, inside, [round(k * n / count) for k in range(1, count + 1)]
