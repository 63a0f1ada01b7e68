"""How many of the objects that a recording shows a map model finds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from async_tnt.evaluation.object_scores import ObjectScores, score_objects
from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.events import EVENT_DTYPE
from async_tnt.networks.model import Model
from async_tnt.processor import Processor
from async_tnt.sources.files.recording import Recording

SHARES = 0.3, 0.5, 1.0
"""Of a window, after which objects are looked for."""


def score_recording(model: Model, recording: Recording, table: ObjectTable) -> dict[float, ObjectScores]:
    """Of a window that ends at each moment of the table, after each of `SHARES` of it.

    Parameters
    ----------
    model : a map model, for the recording's sensor.

    Raises
    ------
    ValueError, OSError : the recording is damaged, or has no events before the moments of the table.
    """
    window_us, n_classes = model.config.window_us, len(model.classes)
    processor = Processor(model, start_us=0)
    nothing = np.zeros(n_classes, np.int64)
    scores = dict.fromkeys(SHARES, ObjectScores(nothing, nothing, nothing))
    times_us, rows_of = zip(*table.moments(), strict=True)
    n_events = 0
    for rows, events in zip(rows_of, _windows(recording, times_us, window_us), strict=True):
        processor.reset()
        n_events += len(events)
        begin = 0
        for share in SHARES:
            end = int(np.searchsorted(events["t"], share * window_us))
            processor.push(events[begin:end])
            begin = end
            objects = processor.fire().objects or ()
            found = np.array([(o.x, o.y, o.probability, o.index, o.id) for o in objects], float).reshape(-1, 5)
            scores[share] += score_objects(found, table.label[rows], table.middle[rows], table.reach[rows], n_classes)
    if n_events == 0:
        times = f"{times_us[0]} to {times_us[-1]}"
        raise ValueError(f"{recording.path}: no event in the {window_us} us before any time in its table, {times}")
    return scores


def _windows(packets: Iterable[np.ndarray], ends_us: Sequence[int], window_us: int) -> Iterator[np.ndarray]:
    """The events of a window before each of these times, sorted, from time 0 on."""
    stream = iter(packets)
    kept: list[np.ndarray] = []
    newest_us = -1
    for end_us in ends_us:
        while newest_us < end_us and (packet := next(stream, None)) is not None:
            kept.append(packet)
            newest_us = max(newest_us, int(packet["t"].max(initial=-1)))
        kept = [packet for packet in kept if packet["t"].max(initial=-1) >= end_us - window_us]
        events = np.concatenate([np.empty(0, EVENT_DTYPE), *kept])
        events = events[(events["t"] >= end_us - window_us) & (events["t"] < end_us)]
        events["t"] -= end_us - window_us
        yield events[np.argsort(events["t"], kind="stable")]
