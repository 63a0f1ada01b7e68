"""An opened camera: packets of events until it is closed or unplugged."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.sources.camera_device import Device, first_line, is_failure
from async_tnt.sources.clock import ContinuousTime
from async_tnt.sources.garbled_times import without_garbled_times

log = logging.getLogger("async_tnt.sources")


@dataclass(frozen=True)
class CameraCounts:
    """What has come so far. None: the library does not say."""

    packets: int
    """With events in them; others are not handed on."""
    events: int
    overflows: int | None
    """Gaps in the stream of events: they were not fetched in time."""
    dropped: int | None
    """Raw packets of the cable that were dropped, as the library counts them."""
    most_waiting: int | None
    """Raw packets that waited in the library, at the worst moment."""
    clock_restarts: int
    """How often the camera's clock fell back by more than a second; times go on nevertheless."""
    off_sensor: int
    """Events left out: they lie outside of the sensor, so the cable or the driver garbled them."""
    garbled_times: int
    """Events left out: their times are far ahead of the others', or beyond 285 years."""


class Camera:
    """Events of a camera, see `open_camera`.

    Iterating yields packets: structured arrays of the library's own fields, never empty, each made anew, in a form
    that `as_events` and `Processor.push` take as it is. Frames, IMU samples and triggers are left out. It ends when
    `close` is called, from any thread, and may be taken up again after a `break`. One thread reads at a time.

    Where the camera is unplugged, OSError is raised after the packets before it, and the camera is closed.

    Attributes
    ----------
    name : the camera's model and serial number, and the library that reads it.
    device : the library's own object, for biases and the like; None where the camera is closed.
    """

    def __init__(self, device: Device, name: str) -> None:
        self.name = name
        self._device = device
        self._sensor = device.sensor
        self._losses = device.losses
        self._clock = ContinuousTime(device.time_field)
        self._packets = self._events = self._off_sensor = self._garbled_times = 0
        self._closing = threading.Event()
        # Held while the device is used. Reentrant: a signal handler may close, on the thread that reads.
        self._using = threading.RLock()
        self._is_open = True

    @property
    def sensor(self) -> tuple[int, int]:
        """(width, height) in pixels, as the library says."""
        return self._sensor

    @property
    def device(self) -> Any:
        return self._device.handle if self._is_open else None

    @property
    def closed(self) -> bool:
        return self._closing.is_set()

    @property
    def counts(self) -> CameraCounts:
        losses = self._losses
        return CameraCounts(
            self._packets,
            self._events,
            losses.overflows,
            losses.dropped,
            losses.most_waiting,
            self._clock.restarts,
            self._off_sensor,
            self._garbled_times,
        )

    def __repr__(self) -> str:
        return f"Camera({self.name}, {'closed' if self.closed else 'open'}, {self.counts})"

    def summary(self) -> str:
        """What was counted so far, in one line for people."""
        counts = self.counts
        lost = []
        if counts.overflows is not None:
            lost.append(f"gaps: {counts.overflows:,}")
        if counts.dropped is not None:
            lost.append(f"raw packets dropped: {counts.dropped:,}")
        if counts.most_waiting is not None:
            lost.append(f"at most {counts.most_waiting:,} waiting")
        if counts.clock_restarts:
            lost.append(f"clock restarts: {counts.clock_restarts:,}")
        if counts.off_sensor:
            lost.append(f"off the sensor: {counts.off_sensor:,}")
        if counts.garbled_times:
            lost.append(f"garbled times: {counts.garbled_times:,}")
        if counts.overflows is None and counts.dropped is None:
            lost.append("lost: unknown")
        return f"{counts.packets:,} packets, {counts.events:,} events ({', '.join(lost)})"

    # -- packets -----------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[np.ndarray]:
        while not self._closing.is_set():
            events = self._read()
            if events is not None:
                yield events
            elif self._device.pause_s:
                self._closing.wait(self._device.pause_s)  # ends at once when the camera is closed

    def _read(self) -> np.ndarray | None:
        """The next packet, its times going on; None if none came."""
        with self._using:
            if not self._is_open:
                return None
            try:
                events = self._device.read()
            except BaseException as error:
                if not is_failure(error):
                    raise
                self.close()
                raise OSError(
                    f"{self.name}: the camera is gone after {self._events:,} events ({first_line(error)}); "
                    "check its cable and power, and open it anew"
                ) from error
            if events is not None and len(events):
                events = self._on_sensor(events)
            if events is not None and len(events):
                events = self._in_time(events)
            if events is None or len(events) == 0:
                return None
            self._packets += 1
            self._events += len(events)
            return self._clock(events)

    def _on_sensor(self, events: np.ndarray) -> np.ndarray:
        """The same array, but for events beside the sensor: one of them would make a processor refuse the packet."""
        width, height = self._sensor
        x, y = events["x"].view(np.uint16), events["y"].view(np.uint16)  # below 0 is beyond any sensor
        if x.max() < width and y.max() < height:
            return events
        kept = events[(x < width) & (y < height)]
        self._off_sensor += len(events) - len(kept)
        return kept

    def _in_time(self, events: np.ndarray) -> np.ndarray:
        """The same array, but for events whose times are garbled."""
        kept = without_garbled_times(events, self._device.time_field, self._clock.newest_us)
        self._garbled_times += len(events) - len(kept)
        return kept

    # -- the end -----------------------------------------------------------------------------------------

    def close(self) -> None:
        """Stop, end every iteration and let go of the camera, from any thread; counts stay. Twice does no harm.

        Takes as long as a read that is going on, 0.1 s or so: when it returns, the camera may be opened anew.
        """
        self._closing.set()
        with self._using:
            if self._is_open:
                self._is_open = False
                try:
                    self._device.close()
                except BaseException as error:
                    if not is_failure(error):
                        raise
                    log.warning("%s: closing it failed: %s", self.name, first_line(error))  # it is gone already

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
