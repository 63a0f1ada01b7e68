"""Events off the sensor: they are left out and counted.

A recording with many such events is refused, because it is of another sensor.

A flipped bit on a cable, or a lost word of a stream, gives an event a pixel that the sensor does
not have. Such an event says nothing, but the events around it are good. Many such events mean that
the recording is of another sensor than the one that the file states or the caller gives. There are
many if they are more than `FEW` and more than the share `SHARE` of all events, or if they are more
than half of all events. Where no sensor is known, only pixels that no sensor can have are left out:
below 0 or beyond 65535.
"""

from __future__ import annotations

import numpy as np

from async_tnt.volume.events import ANY_SENSOR, EVENT_DTYPE
from async_tnt.volume.sensor import Sensor

FEW = 100
"""The most events off the sensor that never mean another sensor, unless most events are off it."""

SHARE = 0.01
"""The largest share of events off the sensor that does not mean another sensor."""

WIDE_DTYPE = np.dtype([("t", "<i8"), ("x", "<i8"), ("y", "<i8"), ("p", "u1")])
"""The type of events whose pixels may not fit into the 16 bits of `EVENT_DTYPE`.

Events whose pixels do not fit are off every sensor.
"""


class EventsOffSensor(UserWarning):
    """Some events of a recording lie off its sensor and were left out."""


class SensorCheck:
    """Leaves out the events of one recording that lie off its sensor, and counts them.

    Parameters
    ----------
    sensor : (width, height) in pixels; None if it is unknown.

    Attributes
    ----------
    n_events : events seen.
    n_off : how many of them were left out.
    """

    def __init__(self, sensor: Sensor | None) -> None:
        self._sensor = sensor
        self.n_events = 0
        self.n_off = 0
        self._first_off = ""

    def find_off(self, events: np.ndarray) -> np.ndarray:
        """Count the next events, and return which of them lie off the sensor: bool, shape (n,).

        Parameters
        ----------
        events : shape (n,), of `EVENT_DTYPE` or `WIDE_DTYPE`.
        """
        width, height = self._sensor or ANY_SENSOR
        x = events["x"]
        y = events["y"]
        is_off = (x >= width) | (y >= height)
        if events.dtype != EVENT_DTYPE:
            is_off |= (x < 0) | (y < 0)
        n_off = int(np.count_nonzero(is_off))
        if n_off and not self.n_off:
            i = int(np.argmax(is_off))
            self._first_off = f"event {self.n_events + i} at x = {x[i]}, y = {y[i]}"
        self.n_events += len(events)
        self.n_off += n_off
        return is_off

    @property
    def is_another_sensor(self) -> bool:
        """Whether too many events are off the sensor: the recording must be of another sensor."""
        are_many = self.n_off > FEW and self.n_off > SHARE * self.n_events
        return are_many or 2 * self.n_off > self.n_events

    def __str__(self) -> str:
        """What was seen, in words: how many events are off the sensor, and the first of them."""
        if self._sensor is None:
            place = "at no pixel that a sensor can have"
        else:
            place = f"off the {self._sensor[0]} x {self._sensor[1]} sensor"
        verb = "lies" if self.n_off == 1 else "lie"
        subject = "it is" if self.n_off == 1 else "the first is"
        return (
            f"{self.n_off:,} of {self.n_events:,} events {verb} {place}; "
            f"{subject} {self._first_off}"
        )


def likely_side(counts: np.ndarray) -> int:
    """The side of a sensor, in pixels, from the number of events at each of its columns (or rows).

    It is the largest column that has an event, plus 1. Strays do not count. They are the events of
    columns more than twice as far out as all other columns, if they are no more than the share
    `SHARE` of all events.

    Examples
    --------
    >>> counts = np.bincount([3, 33] * 500 + [33014])
    >>> len(counts), likely_side(counts)
    (33015, 34)
    """
    occupied = np.flatnonzero(counts)
    if not len(occupied):
        return 0
    n_beyond = counts.sum() - np.cumsum(counts[occupied])  # events behind each occupied column
    # whether the next occupied column is more than twice as far out
    is_far = occupied[1:] + 1 > 2 * (occupied[:-1] + 1)
    are_few_beyond = n_beyond[:-1] <= SHARE * counts.sum()
    # columns behind which only strays lie
    cuts = np.flatnonzero(is_far & are_few_beyond)
    last = occupied[cuts[0]] if len(cuts) else occupied[-1]
    return int(last) + 1
