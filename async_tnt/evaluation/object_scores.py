"""How well a map model finds objects.

Two shares say it. Recall: of the objects that are really there, the share that the model finds.
Precision: of the objects that the model finds, the share that is really there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from async_tnt.evaluation.box_conventions import ALL_BOXES, Convention
from async_tnt.evaluation.box_scores import FoundBoxes
from async_tnt.evaluation.object_tables import ObjectTable
from async_tnt.kernels.decisions.objects import CLASS, FOUND_SIZE, X, Y
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import Recording
from async_tnt.streaming.processor import Processor
from async_tnt.volume.events import EVENT_DTYPE

Value = TypeVar("Value")

EARLY_MS = (10, 30, 50, 100)
"""Moments at which found objects are scored before a window's end, in milliseconds since its start.
"""


def moments_us(window_us: int) -> tuple[int, ...]:
    """The moments at which found objects are scored, in microseconds since a window's start.

    These are the moments of `EARLY_MS` before the window's end, and the end.

    Examples
    --------
    >>> moments_us(105_000), moments_us(50_000)
    ((10000, 30000, 50000, 100000, 105000), (10000, 30000, 50000))
    """
    early_us = [1000 * ms for ms in EARLY_MS if 1000 * ms < window_us]
    return (*early_us, window_us)


def by_milliseconds(values: Mapping[int, Value]) -> dict[str, Value]:
    """The same values, with their moments in milliseconds, as a report names them.

    Examples
    --------
    >>> by_milliseconds({10_000: "early", 52_500: "late"})
    {'10': 'early', '52.5': 'late'}
    """
    return {f"{us / 1e3:g}": value for us, value in values.items()}


@dataclass(frozen=True)
class ObjectScores:
    """Three counts for each class.

    Parameters
    ----------
    n_present : int64, (K,): number of objects that are there, by the table.
    n_found : int64, (K,): number of objects that the model finds.
    n_right : int64, (K,): number of found objects that match an object of the table, see
        `score_objects`.
    """

    n_present: np.ndarray
    n_found: np.ndarray
    n_right: np.ndarray

    def __add__(self, other: ObjectScores) -> ObjectScores:
        return ObjectScores(
            self.n_present + other.n_present,
            self.n_found + other.n_found,
            self.n_right + other.n_right,
        )

    @property
    def f1(self) -> float:
        """The F1 score over all classes: 2 n_right / (n_present + n_found)."""
        return _f1(self.n_present.sum(), self.n_found.sum(), self.n_right.sum())

    def to_dict(self, classes: Sequence[str]) -> dict[str, Any]:
        """The scores as plain values for JSON, over all classes and for each class."""
        n_present = int(self.n_present.sum())
        n_found = int(self.n_found.sum())
        n_right = int(self.n_right.sum())
        per_class = {}
        for k, name in enumerate(classes):
            n_present_k = int(self.n_present[k])
            n_found_k = int(self.n_found[k])
            n_right_k = int(self.n_right[k])
            per_class[name] = {
                "f1": round(_f1(n_present_k, n_found_k, n_right_k), 5),
                "objects": n_present_k,
                "found": n_found_k,
                "right": n_right_k,
            }
        return {
            "f1": round(self.f1, 5),
            "precision": round(n_right / max(1, n_found), 5),
            "recall": round(n_right / max(1, n_present), 5),
            "objects": n_present,
            "found": n_found,
            "per_class": per_class,
        }


def _f1(n_present: int, n_found: int, n_right: int) -> float:
    """The F1 score of three counts; 0 if there are no objects at all."""
    return float(2 * n_right / max(1, n_present + n_found))


def score_objects(
    found: np.ndarray,
    labels: np.ndarray,
    middles: np.ndarray,
    reach: np.ndarray | float,
    n_classes: int,
) -> ObjectScores:
    """Match the objects that a model found with the objects that are there, and count them.

    Found objects are matched one after the other, the likeliest first. A found object takes the
    nearest object of its class that is near enough and not taken yet. If there is such an object,
    the found object is right. A found object at (x, y) is near enough to an object with middle
    (u, v) and reach (a, b) if ((x - u) / a)^2 + ((y - v) / b)^2 <= 1.

    Parameters
    ----------
    found : float64, (M, FOUND_SIZE): the found objects, the likeliest first. The columns are those
        of `kernels.decisions.objects`.
    labels : int64, (N,): the class of each object that is there.
    middles : float64, (N, 2): the middle (x, y) of each object that is there, in sensor pixels.
    reach : float64, (N, 2): the reach (a, b) of each object that is there, in pixels; or one number
        for all objects.
    n_classes : number of classes, K.

    Examples
    --------
    >>> found = np.array([[10.0, 10, 0.9, 1, 0], [30.0, 10, 0.8, 1, 1], [10.0, 12, 0.7, 1, 2]])
    >>> labels = np.array([1, 0])
    >>> middles = np.array([[11.0, 10.0], [30.0, 10.0]])
    >>> scores = score_objects(found, labels, middles, reach=5.0, n_classes=2)
    >>> scores.n_present.tolist(), scores.n_found.tolist(), scores.n_right.tolist()
    ([1, 1], [0, 3], [0, 1])
    """
    is_free = np.ones(len(labels), bool)
    for found_object in found:
        offset = (middles - found_object[[X, Y]]) / reach  # (N, 2)
        distance = np.hypot(offset[:, 0], offset[:, 1])
        can_match = is_free & (labels == found_object[CLASS])
        distance[~can_match] = np.inf
        # a distance of 1 is the edge of the ellipse
        if len(distance) and distance.min() <= 1:
            is_free[distance.argmin()] = False
    return ObjectScores(
        n_present=_counts(labels, n_classes),
        n_found=_counts(found[:, CLASS], n_classes),
        n_right=_counts(labels[~is_free], n_classes),
    )


def _counts(classes: np.ndarray, n_classes: int) -> np.ndarray:
    """The number of times that each class occurs: int64, (K,)."""
    return np.bincount(classes.astype(np.int64), minlength=n_classes)


def score_recording(
    model: Model,
    recording: Recording,
    table: ObjectTable,
    boxes: Mapping[int, FoundBoxes] | None = None,
    convention: Convention = ALL_BOXES,
) -> dict[int, ObjectScores]:
    """Score the objects that a model finds in a recording, early in a window and at its end.

    A window ends at each time of the table. It is empty at its start, also if the model's windows
    slide. The recording is read twice, so that the scores do not depend on the order of the events
    or on packets.

    Parameters
    ----------
    model : a map model, for the recording's sensor.
    boxes : for each of `moments_us`, the boxes at all times so far, to which those of this
        recording are added; None: boxes are not kept.
    convention : which found objects count. The caller has already left out the rows of the table
        that do not count, by `Convention.of_table`. If no row is left, the recording is not read.

    Returns
    -------
    For each of `moments_us` of the model's windows, the scores over all times of the table.

    Raises
    ------
    ValueError, OSError : the recording is damaged, or has no events before the moments of the
        table.
    """
    window_us = model.config.window_us
    n_classes = len(model.classes)
    processor = Processor(model, start_us=0)
    zeros = np.zeros(n_classes, np.int64)
    moments = moments_us(window_us)
    scores = dict.fromkeys(moments, ObjectScores(zeros, zeros, zeros))
    # the boxes of a recording that turns out to be damaged do not count
    found_boxes: list[tuple[int, slice, np.ndarray]] = []
    if not len(table.t):
        return scores

    times_us, rows_of = zip(*table.moments(), strict=True)
    n_events = 0
    windows = _windows(recording, times_us, window_us)
    for t_us, rows, events in zip(times_us, rows_of, windows, strict=True):
        processor.reset()
        n_events += len(events)
        stops = np.searchsorted(events["t"], moments)
        # the last part is empty, because no event is after the window
        parts = np.split(events, stops)[:-1]
        for moment, part in zip(moments, parts, strict=True):
            processor.push(part)
            found = convention.of_found(_objects_of(processor, moment - 1), t_us)
            if boxes is not None:
                found_boxes.append((moment, rows, found))
            scores[moment] += score_objects(
                found,
                table.label[rows],
                table.middle[rows],
                table.reach[rows],
                n_classes,
            )

    if n_events == 0:
        times = f"{times_us[0]} to {times_us[-1]}"
        raise ValueError(
            f"{recording.path}: no event in the {window_us} us before any time in its table, "
            f"{times}"
        )
    for moment, rows, found in found_boxes:
        assert boxes is not None
        boxes[moment].add(table, rows, found)
    return scores


def _objects_of(processor: Processor, now_us: int) -> np.ndarray:
    """The objects that a Processor finds in its open window now: float64, (M, FOUND_SIZE)."""
    objects = processor.fire(at_us=now_us).objects or ()
    rows = [
        (
            item.x,
            item.y,
            item.probability,
            item.index,
            item.id,
            item.width or 0.0,
            item.height or 0.0,
        )
        for item in objects
    ]
    return np.array(rows, float).reshape(-1, FOUND_SIZE)


def _windows(
    packets: Iterable[np.ndarray], ends_us: Sequence[int], window_us: int
) -> Iterator[np.ndarray]:
    """Yield the events of each window that ends at one of these times.

    The events are sorted by time, and their times count from the window's start. The result does
    not depend on the order of the recording's events or on packets. Memory holds only packets with
    events that this window or a later one needs.

    Parameters
    ----------
    packets : a recording's events; iterated twice.
    ends_us : the ends of the windows, in increasing order.
    """
    # how many packets must be read for each window, and for the windows before it
    n_needed = np.maximum.accumulate(_packets_needed(packets, np.array(ends_us), window_us))
    stream = iter(packets)
    n_read = 0
    held_packets: list[np.ndarray] = []
    for end_us, n_packets in zip(ends_us, n_needed.tolist(), strict=True):
        start_us = end_us - window_us
        held_packets = [packet for packet in held_packets if packet["t"].max() >= start_us]
        for packet in itertools.islice(stream, n_packets - n_read):
            later_events = packet[packet["t"] >= start_us]
            if len(later_events):
                held_packets.append(later_events)
        n_read = n_packets

        events = np.concatenate([np.empty(0, EVENT_DTYPE), *held_packets])
        events = events[(events["t"] >= start_us) & (events["t"] < end_us)]
        events["t"] -= start_us
        yield events[np.argsort(events["t"], kind="stable")]


def _packets_needed(
    packets: Iterable[np.ndarray], ends_us: np.ndarray, window_us: int
) -> np.ndarray:
    """For each end of a window, how many packets must be read to have all events of the window."""
    n_needed = np.zeros(len(ends_us), np.int64)
    for n, packet in enumerate(packets, 1):
        if not len(packet):
            continue
        t_us = np.sort(packet["t"])
        first = np.searchsorted(ends_us, t_us[0], side="right")
        stop = np.searchsorted(ends_us, t_us[-1] + window_us, side="right")
        # only these windows end after the packet's first event and start before or at its last one
        near_ends_us = ends_us[first:stop]
        n_before_start = np.searchsorted(t_us, near_ends_us - window_us)
        n_before_end = np.searchsorted(t_us, near_ends_us)
        has_events = n_before_start < n_before_end
        n_needed[first:stop][has_events] = n
    return n_needed
