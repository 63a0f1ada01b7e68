"""The comparison of the stream with the batch reference on one recording, by four promises.

(a) However the stream was cut into packets, the streamed volume is the same, bit for bit. It is
    made of the events that the reference has in that window.
(b) After every prefix of a window's events, the volume equals the reference's volume to 1e-6 of its
    largest cell, and the landmark equals the reference's landmark to 1e-9 pixels.
(c) The logits equal the reference's logits to 1e-4, or to 1e-4 of the largest logit where that
    exceeds 1. So the class is the same, too, except for ties. The same holds for raw outputs.
(d) A decision after every event has the same bits as the answer of the whole network, though only
    the changed values are computed.

There are two exceptions. (b): events are kept up to 1e-9 pixels beyond the border. If an event lies
at just this distance, rounding decides whether it is kept. (d): the bits may differ if the caller
switches `torch.set_flush_denormal` between two decisions.

The comparison needs torch (extra `reference`), which is imported only when something is checked.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from async_tnt.checking.comparison import PACKET_SIZES, Comparison
from async_tnt.checking.spikes import check_spikes
from async_tnt.networks.models.compiled import CompiledRegressor
from async_tnt.networks.models.compiled_network import compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.torch_modules import landmark_function
from async_tnt.streaming.decision import Decision
from async_tnt.streaming.output import Output
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import pieces_for
from async_tnt.volume.config import LANDMARKS, TIME_IMAGES, TNTConfig
from async_tnt.volume.regressor import Regressor
from async_tnt.volume.volume import TNTVolume

VOLUME_BOUND = 1e-6
"""Largest difference of two volumes, as a share of the largest cell."""
LEAST_CELL = 1e-9
"""A small value of a cell, in events. If all cells are below this value, opposite events have
cancelled each other, and only rounding errors are left."""
LANDMARK_BOUND = 1e-9
"""Largest distance of two landmarks, in grid pixels."""
REGRESSED_LANDMARK_BOUND = 1e-4
"""Largest distance of two landmarks, in grid pixels, for the landmark `regressor`. That landmark
comes from float32 convolutions."""
OUTPUT_BOUND = 1e-4
"""Largest difference of two logits, or of two numbers of a raw output."""


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


def n_steps(model: Model) -> int:
    """In how many steps `check_recording` compares a recording."""
    # each configuration, and then the network
    return 1 if model.is_spiking else len(configurations(model.config)) + 1


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
    on_progress : called after each of `n_steps` steps.
    """
    if model.is_spiking:
        comparisons = check_spikes(events, model, prefixes=prefixes, start_us=start_us)
        on_progress()
        return comparisons
    comparisons = []
    for name, config in configurations(model.config).items():
        regressor = CompiledRegressor(model) if config.needs_regressor else None
        digests = _window_digests(events, config, PACKET_SIZES[0], start_us, regressor)
        comparisons.append(_check_packets(events, name, config, start_us, regressor, digests))
        comparisons += _check_volumes(events, name, config, model, prefixes, start_us, digests)
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
    digests: list[tuple[int, bytes]],
) -> Comparison:
    """Check the first half of promise (a): volumes do not depend on packets.

    Parameters
    ----------
    digests : what `_window_digests` returns for the first of `PACKET_SIZES`.
    """
    packets = Comparison("volumes that depend on packets", name, 0.0)
    for size in PACKET_SIZES[1:]:
        other_digests = _window_digests(events, config, size, start_us, regressor)
        # windows that only one of the two streams has
        packets.add(abs(len(other_digests) - len(digests)))
        for digest, other_digest in zip(digests, other_digests, strict=False):
            packets.add(float(digest != other_digest))
    return packets


def _check_volumes(
    events: np.ndarray,
    name: str,
    config: TNTConfig,
    model: Model,
    prefixes: int | None,
    start_us: int | None,
    digests: list[tuple[int, bytes]],
) -> list[Comparison]:
    """Check windows, volumes and landmarks: the second half of promise (a), and promise (b).

    Parameters
    ----------
    digests : what `_window_digests` returns for a stream.
    """
    from async_tnt.checking.reference import reference_landmark, reference_volume, reference_windows

    is_regressed = config.needs_regressor
    landmark_bound = REGRESSED_LANDMARK_BOUND if is_regressed else LANDMARK_BOUND
    windows = Comparison("windows against reference", name, 0.0)
    volumes = Comparison("volume against reference, of the largest cell", name, VOLUME_BOUND)
    landmarks = Comparison("landmark against reference, px", name, landmark_bound)

    windows_of_reference = reference_windows(events, config, start_us)
    starts = [window_start_us for window_start_us, _ in digests]
    windows.add(float(starts != [window_start_us for window_start_us, _ in windows_of_reference]))

    digest_of_window = dict(digests)
    regressor = CompiledRegressor(model) if is_regressed else None
    find_landmark = landmark_function(model) if is_regressed else None
    untransformed = config.replace(transform="none") if is_regressed else config
    volume = TNTVolume(config, regressor=regressor)
    for window_start_us, window_events, ends in _prefixes(windows_of_reference, prefixes):
        volume.open(window_start_us)
        for n_before, n in pairwise([0, *ends]):
            volume.update(window_events[n_before:n])
            prefix = window_events[:n]
            stream_landmark = volume.landmark
            reference = reference_volume(
                prefix, config, window_start_us, stream_landmark if is_regressed else None
            )
            volumes.add(_difference(volume.array, reference))
            if find_landmark is not None:
                network_landmark = find_landmark(
                    reference_volume(prefix, untransformed, window_start_us)
                )
                landmarks.add(_distance(stream_landmark, network_landmark))
            elif config.transform == "tnt":
                landmarks.add(
                    _distance(stream_landmark, reference_landmark(prefix, config, window_start_us))
                )
        windows.add(float(_digest(volume.array) != digest_of_window.get(window_start_us)))

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

    bits = Comparison("bits that depend on earlier decisions", "the model", 0.0)
    what = "outputs" if model.outputs else "logits"
    outputs = Comparison(f"{what} against reference", "the model", OUTPUT_BOUND)
    config = model.config
    pipeline = reference_pipeline(model)
    whole_network = compiled_network_of(model)
    # The same network is used for all windows, because it must keep nothing of the previous window.
    incremental = compiled_network_of(model)
    regressor = CompiledRegressor(model) if config.needs_regressor else None
    # If each read builds the volume again from all events of the window, a decision after each
    # event would take too long. Then there are decisions only at the ends of prefixes.
    every_events = None if config.needs_replay else 1
    for window_start_us, window_events, ends in _prefixes(
        reference_windows(events, config, start_us), prefixes
    ):
        first_us: int | None = window_start_us
        open_config = config
        if config.window_events is not None:
            # A full window would be closed, and could not be read. So there is room for one event
            # more.
            first_us = None
            open_config = config.replace(window_events=window_events.size + 1)
        processor: Processor[Any] = Processor(
            open_config,
            classifier=incremental,
            regressor=regressor,
            start_us=first_us,
            every_events=every_events,
        )
        for n_before, n in pairwise([0, *ends]):
            for piece in pieces_for(processor, window_events[n_before:n]):
                answers = processor.push(piece)
            answer = processor.fire() if every_events is None else answers[-1]
            of_reference = pipeline(window_events[:n], window_start_us)
            whole = _arrays(whole_network(processor.volume()))
            for array, other, expected in zip(_arrays(answer), whole, of_reference, strict=True):
                has_other_bits = array.view(np.uint32) != other.view(np.uint32)
                bits.add(float(np.count_nonzero(has_other_bits)))
                largest = max(1.0, np.abs(expected).max())
                difference = np.abs(array - expected.reshape(array.shape)).max()
                outputs.add(float(difference / largest))
    return [bits, outputs]


def _arrays(answer: Any) -> tuple[np.ndarray, ...]:
    """The arrays of a Decision or an Output, or of what a network returned."""
    if isinstance(answer, Output):
        return answer.arrays
    if isinstance(answer, Decision):
        return (answer.logits,)
    return answer if isinstance(answer, tuple) else (answer,)


def _difference(volume: np.ndarray, reference: np.ndarray) -> float:
    """The largest difference of two volumes, as a share of the largest cell."""
    largest = max(float(np.abs(reference).max()), float(np.abs(volume).max()), LEAST_CELL)
    return float(np.abs(volume - reference).max()) / largest


def _distance(landmark: tuple[float, float], reference: tuple[float, float]) -> float:
    """The larger of the differences in x and in y."""
    return float(np.abs(np.subtract(landmark, reference)).max())


def _window_digests(
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
    def note_digest(volume: np.ndarray) -> list[float]:
        digests.append(_digest(volume))
        return [0.0]

    processor = Processor(config, classifier=note_digest, regressor=regressor, start_us=start_us)
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
    for start_us, window_events in windows:
        n_events = window_events.size
        n_prefixes = n_events if prefixes is None else min(prefixes, n_events)
        lengths = [round(k * n_events / n_prefixes) for k in range(1, n_prefixes + 1)]
        yield start_us, window_events, lengths
