"""Cameras: `open_camera` opens a camera by its name, `Camera` yields the camera's packets."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np

from async_tnt.sources.live.camera_drivers import (
    ALL_KINDS,
    DRIVERS,
    CameraCounts,
    Device,
    Driver,
    FoundCamera,
    failure,
)
from async_tnt.sources.live.clock import Clock

MAX_JUMP_S = 1.0
"""Seconds that a time may lie ahead of the expected time. One is enough, because a camera's events
arrive in order and soon."""

ADVICE = "Is it plugged in, and used by no other program?"
LINUX_ADVICE = (
    " Does lsusb show it, and do udev rules let users read it "
    "(neuromorphic-drivers-install-udev-rules)?"
)

log = logging.getLogger("async_tnt.sources")


class Camera(AbstractContextManager["Camera"]):
    """A camera and its events. `open_camera` makes it.

    Iterating yields packets: structured arrays with the library's own fields, never empty, each in
    new memory, in a form that `Processor.push` accepts. Frames, IMU samples and triggers are left
    out. Iterating ends when `close` is called, from any thread, and may be resumed after a `break`.
    One thread reads at a time.

    If the camera is unplugged, an OSError is raised after the packets that came before, and the
    camera is closed.

    Attributes
    ----------
    name : the camera's model and serial number, and the library that reads it.
    sensor : (width, height) in pixels, as the library reports it.
    settings : name -> value of the camera's biases, filters and the like, at the time when it was
        opened, as far as the library tells.
    """

    def __init__(self, device: Device, name: str) -> None:
        self.name = name
        self._device = device
        self.sensor = device.sensor
        self.settings = device.settings
        self._counts = device.counts
        self._clock = Clock(MAX_JUMP_S)
        self._closing = threading.Event()
        # Held while the device is used. Re-entrant: a signal handler may close, on the thread that
        # reads.
        self._using = threading.RLock()
        self._is_open = True

    @property
    def device(self) -> Any:
        """The library's own object, for biases and the like; None once the camera is closed."""
        return self._device.handle if self._is_open else None

    @property
    def closed(self) -> bool:
        """Whether `close` was called, or the camera is gone."""
        return self._closing.is_set()

    @property
    def counts(self) -> CameraCounts:
        """What the camera has sent so far: packets, events, and what was lost."""
        return replace(self._counts, clock_restarts=self._clock.restarts)

    def __repr__(self) -> str:
        return f"Camera({self.name}, {'closed' if self.closed else 'open'}, {self.counts})"

    def summary(self) -> str:
        """The counts so far, in one line for people."""
        counts = self.counts
        numbers = {
            "gaps: {:,}": counts.overflows,
            "raw packets dropped: {:,}": counts.dropped,
            "clock restarts: {:,}": counts.clock_restarts or None,
            "off the sensor: {:,}": counts.off_sensor or None,
            "jumps in time: {:,}": counts.jumped or None,
        }
        losses = [text.format(number) for text, number in numbers.items() if number is not None]
        if counts.overflows is None and counts.dropped is None:
            losses.append("lost: unknown")
        return f"{counts.packets:,} packets, {counts.events:,} events ({', '.join(losses)})"

    # -- packets -----------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[np.ndarray]:
        while not self._closing.is_set():
            events = self._read()
            if events is not None:
                yield events

    def _read(self) -> np.ndarray | None:
        """The next packet; None if there is none now."""
        with self._using:
            if not self._is_open:
                return None
            try:
                events = self._device.read()
            except BaseException as error:
                reason = failure(error)
                self.close()
                raise OSError(
                    f"{self.name}: the camera is gone after {self._counts.events:,} events "
                    f"({reason}); check its cable and power, and open it again"
                ) from error
            if events is None or not len(events):
                return None
            events = self._valid(events)
            if not len(events):
                return None
            self._counts.packets += 1
            self._counts.events += len(events)
            return events

    def _valid(self, events: np.ndarray) -> np.ndarray:
        """The packet without garbled events, which a processor would refuse.

        The cable or the driver can garble them.
        """
        width, height = self.sensor
        # as an unsigned number, a pixel below 0 lies beyond any sensor
        x = events["x"].view(np.uint16)
        y = events["y"].view(np.uint16)
        n = len(events)
        if x.max() >= width or y.max() >= height:
            events = events[(x < width) & (y < height)]
            self._counts.off_sensor += n - len(events)
            n = len(events)
        events = self._clock(events, self._device.time_field, time.monotonic_ns() // 1000)
        # counted here, as `Clock.jumped` does not count times outside of [0, 2**62) us
        self._counts.jumped += n - len(events)
        return events

    # -- the end -----------------------------------------------------------------------------------

    def close(self) -> None:
        """Stop, end every iteration and release the camera; counts stay.

        Any thread may call this, and it may be called again. It waits for a read in progress, about
        0.1 s. After that the camera may be opened again.
        """
        self._closing.set()
        with self._using:
            if self._is_open:
                self._is_open = False
                try:
                    self._device.close()
                except BaseException as error:  # the camera is gone already
                    log.warning("%s: closing it failed: %s", self.name, failure(error))

    def __exit__(self, *error: object) -> None:
        self.close()


def open_camera(name: str = "camera", *, drivers: Mapping[str, Driver] = DRIVERS) -> Camera:
    """Open a camera.

    Parameters
    ----------
    name : `camera` (the first camera that is found), `camera:KIND` (evk4, evk3, davis346,
        dvxplorer, ...) or `camera:KIND:SERIAL`.
    drivers : the libraries to try, in this order, by name.

    Returns
    -------
    `Camera`, which is running: read it, or the buffer of its driver overflows.

    Raises
    ------
    ValueError : there is no such kind of camera.
    OSError : no such camera is connected, or it cannot be opened; the message names the libraries
        that searched, and what to check.
    ImportError : no library is installed.
    """
    kind, serial = parse_camera_name(name)
    problems = []
    empty_searches = []
    n_missing = 0
    was_found = False
    for package, find in drivers.items():
        try:
            cameras = find()
        except ModuleNotFoundError:
            n_missing += 1
            problems.append(f"{package} is not installed")
            continue
        except BaseException as error:
            problems.append(f"{package} cannot search: {failure(error)}")
            continue
        if not cameras:
            empty_searches.append(package)
        for camera in cameras:
            if not _is_wanted(camera, kind, serial):
                problems.append(f"{package} found {camera}, which is another camera")
                continue
            try:
                return Camera(camera.open(), f"{camera} by {package}")
            except BaseException as error:
                reason = failure(error)
                problems.append(
                    f"{package} found {camera} but cannot open it: {camera.problem or reason}"
                )
                was_found = True
    if n_missing == len(drivers):
        raise ImportError(
            f"{name}: {'; '.join(problems)}: cameras need one of them, pip install "
            "'async_tnt[cameras]'"
        )
    if empty_searches:
        problems.insert(0, f"{' and '.join(empty_searches)} found none")
    problems.insert(0, "cannot be opened" if was_found else "no camera found")
    advice = ADVICE + (LINUX_ADVICE if sys.platform.startswith("linux") else "")
    raise OSError(f"{name}: {'; '.join(problems)}. {advice}")


def _is_wanted(camera: FoundCamera, kind: str | None, serial: str | None) -> bool:
    """Whether a camera is of this kind, and has this serial number.

    None stands for any kind, or any number.

    A camera that hides its serial number may be the right one. An attempt to open it shows why it
    hides the number.
    """
    if kind and kind not in camera.kinds:
        return False
    return not serial or camera.serial in (serial, None)


def parse_camera_name(name: str) -> tuple[str | None, str | None]:
    """The kind and the serial number in a camera's name; None for a part that is not there.

    Examples
    --------
    >>> parse_camera_name("camera:EVK4")
    ('evk4', None)
    >>> parse_camera_name("camera:davis346:00000042")
    ('davis346', '00000042')
    """
    word, *parts = name.split(":", 2)
    if word != "camera" or "" in parts:
        raise ValueError(
            f"a camera's name is camera, camera:KIND or camera:KIND:SERIAL, got {name!r}"
        )
    kind = parts[0].lower() if parts else None
    if kind is not None and kind not in ALL_KINDS:
        raise ValueError(f"{name}: no such kind of camera; known are {', '.join(ALL_KINDS)}")
    return kind, parts[1] if len(parts) == 2 else None
