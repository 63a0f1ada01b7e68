"""The comparison of a window that slides with the batch reference, on one recording.

(h) However the stream was cut into packets, the volume has the same bits.
(i) At prefixes of the recording, the volume is that of the reference, which counts the events that
    the window holds by its definition.
(j) A decision after every event has the same bits as the answer of the whole network.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from async_tnt.checking.comparison import PACKET_SIZES, Comparison
from async_tnt.networks.models.compiled_network import compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.streaming.processor import Processor
from async_tnt.streaming.streams import pieces_for
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.volume import TNTVolume


def check_sliding(events: np.ndarray, model: Model, *, prefixes: int | None) -> list[Comparison]:
    """The comparisons of all promises on one recording.

    The parameters are those of `check_recording`.
    """
    n_compared = len(events) if prefixes is None else prefixes
    ends = np.unique(np.linspace(1, len(events), n_compared).astype(int)).tolist()
    return [
        _check_packets(events, model.config),
        _check_volumes(events, model.config, ends),
        _check_network(events, model, ends),
    ]


def _check_packets(events: np.ndarray, config: TNTConfig) -> Comparison:
    packets = Comparison("volumes that depend on packets", "none", 0.0)
    found = []
    for size in PACKET_SIZES:
        volume = TNTVolume(config)
        step = size or len(events)
        for first in range(0, len(events), step):
            volume.update(events[first : first + step])
        found.append(volume.array.tobytes())
    for other in found[1:]:
        packets.add(float(other != found[0]))
    return packets


def _check_volumes(events: np.ndarray, config: TNTConfig, ends: list[int]) -> Comparison:
    volumes = Comparison("volume against reference", "none", 0.0)
    volume = TNTVolume(config)
    for n_before, n in pairwise([0, *ends]):
        volume.update(events[n_before:n])
        difference = np.abs(volume.array - reference_counts(events[:n], config))
        volumes.add(float(difference.max()))
    return volumes


def reference_counts(events: np.ndarray, config: TNTConfig) -> np.ndarray:
    """The counts of the events that a window holds: float32, shape (C, H, W).

    In a window with slices, the first slice begins with the first event.
    """
    from tnt_reference.sliding import last_events, last_us, slices

    t = events["t"]
    if config.last_events is not None:
        bins = last_events(t, config.last_events).numpy() - 1
    elif config.slice_us is not None:
        assert config.last_us is not None
        bins = slices(t, int(t[0]), config.last_us, config.bins).numpy()
    else:
        assert config.last_us is not None
        bins = last_us(t, config.last_us).numpy() - 1
    return np.concatenate(list(_counts_of_bins(events, bins, config)))


def _counts_of_bins(
    events: np.ndarray, bins: np.ndarray, config: TNTConfig
) -> Iterator[np.ndarray]:
    """The planes of the volume, those of ON first.

    bins : the bin of each event; -1 if the window does not hold it.
    """
    from tnt_reference import count_image

    images = []
    for b in range(config.bins):
        columns = [events[bins == b][field] for field in "txyp"]
        images.append(count_image(*columns, sensor=config.sensor).numpy().astype(np.float32))
    on, off = np.stack(images, axis=1)  # each (bins, H, W)
    if config.polarity == "split":
        yield on
        yield off
    elif config.polarity == "signed":
        yield on - off
    else:
        yield on + off


def _check_network(events: np.ndarray, model: Model, ends: list[int]) -> Comparison:
    bits = Comparison("bits that depend on earlier decisions", "the model", 0.0)
    whole = compiled_network_of(model)
    processor: Processor[Any] = Processor(model, every_events=1)
    for n_before, n in pairwise([0, *ends]):
        answers: list[Any] = []
        for piece in pieces_for(processor, events[n_before:n]):
            answers = processor.push(piece)
        expected = whole(processor.volume())
        arrays = answers[-1].arrays if model.outputs else (answers[-1].logits,)
        wanted = expected if isinstance(expected, tuple) else (expected,)
        for own, other in zip(arrays, wanted, strict=True):
            bits.add(float(np.count_nonzero(own.view(np.uint32) != other.view(np.uint32))))
    return bits
