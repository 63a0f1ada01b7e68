"""The camera libraries with one interface: a driver finds cameras, a device is an open camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from itertools import chain
from typing import Any, Protocol

import numpy as np

WAIT_S = 0.1
"""Seconds that neuromorphic-drivers waits for events at a time, so that `close` waits no longer."""

PAUSE_S = 0.001
"""Seconds after which dv-processing, which does not wait, is asked again, at 3 % of a core."""

NEUROMORPHIC_KINDS = {
    "Prophesee EVK4": ("evk4",),
    "Prophesee EVK3 HD": ("evk3",),
    "iniVation DAVIS 346": ("davis346", "davis"),
    "iniVation DVXplorer": ("dvxplorer",),
    "CenturyArks VGA": ("silkyevcam",),
    "Lucid Triton": ("triton",),
}
"""Name of a model in neuromorphic-drivers -> every KIND of `camera:KIND` that matches it."""

DV_KINDS = {
    "DVS128": ("dvs128",),
    "DAVIS": ("davis", "davis346"),
    "DAVIS_GEN2": ("davis", "davis346"),
    "DVXPLORER": ("dvxplorer",),
    "DVXPLORER_GEN2": ("dvxplorer",),
    "DVXPLORER_M": ("dvxplorer", "dvxplorer-m"),
    "DVXPLORER_S": ("dvxplorer", "dvxplorer-s"),
}
"""Name of a model in dv-processing -> every KIND of `camera:KIND` that matches it. These names do
not tell a DAVIS346 from another DAVIS."""

DV_SETTINGS = (
    "ContrastThresholdOn",
    "ContrastThresholdOff",
    "ReadoutFPS",
    "GlobalHold",
    "BackgroundActivityFilter",
    "RefractoryPeriodFilter",
    "SkipFilter",
    "CropAreaEvents",
    "CropArea",
    "FirmwareVersion",
    "LogicVersion",
)
"""Settings that a dv-processing camera is asked for: `getReadoutFPS` and so on."""

ALL_KINDS = sorted({*chain(*NEUROMORPHIC_KINDS.values(), *DV_KINDS.values())})
"""Every KIND of `camera:KIND`."""


@dataclass
class CameraCounts:
    """What a camera has sent so far, in numbers. None: the library does not report it."""

    packets: int = 0
    """Packets with events."""
    events: int = 0
    """Events handed on."""
    overflows: int | None = None
    """Gaps in the stream of events, because it was not read in time."""
    dropped: int | None = None
    """Raw USB packets that the library dropped."""
    clock_restarts: int = 0
    """Times that the camera's clock moved back; times continue, see `Clock`."""
    off_sensor: int = 0
    """Events left out because they lie off the sensor: the cable or the driver garbled them."""
    jumped: int = 0
    """Events left out because their time jumps, see `Clock`."""


class Device(Protocol):
    """An opened camera of one of the libraries. `Camera` calls one method at a time."""

    sensor: tuple[int, int]
    """(width, height) in pixels."""
    time_field: str
    """Name of the field of times in its packets."""
    counts: CameraCounts
    """The device counts what the library reports as lost in `read`. `Camera` counts the rest."""
    handle: Any
    """The library's own object."""
    settings: dict[str, Any]
    """Name -> value, when the camera was opened, of the settings that decide which events it sends,
    as far as the library tells."""

    def read(self) -> np.ndarray | None:
        """The next packet, a structured array in new memory; None if no packet is there now.

        It waits for a packet, for 0.2 s at most. If the camera is gone, it raises what the library
        raises, see `failure`.
        """

    def close(self) -> None:
        """Release the camera."""


@dataclass(frozen=True)
class FoundCamera:
    """A connected camera."""

    model: str
    """The library's name of the camera's model."""
    kinds: tuple[str, ...]
    """Every KIND of `camera:KIND` that matches it."""
    serial: str | None
    """Serial number of the camera; None if the library does not tell it."""
    open: Callable[[], Device]
    """Opens the camera."""
    problem: str | None = None
    """Why the camera may not open, if the library reports a reason."""

    def __str__(self) -> str:
        return self.model if not self.serial else f"{self.model} {self.serial}"


Driver = Callable[[], Sequence[FoundCamera]]
"""Function that finds the connected cameras of one library. It raises an ImportError if the library
is not installed, and what the library raises if the library cannot search."""


def failure(error: BaseException) -> str:
    """The message of a library that has failed, in one line.

    Libraries in Rust panic with an exception that `except Exception` does not catch.
    dv-processing's messages hold a place in its source, the sentence, and a C++ stack.

    Raises
    ------
    The error itself, if the program is being stopped.

    Examples
    --------
    >>> lines = ("/a/b.hpp(88): dv::open()", "RuntimeError: no such device", "Stacktrace:")
    >>> failure(RuntimeError("\\n".join(lines)))
    'no such device'
    >>> failure(ValueError())
    'ValueError'
    """
    if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
        raise error
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    for line in lines[1:]:
        kind, colon, sentence = line.partition(": ")
        if colon and kind.endswith(("Error", "Exception")):
            return sentence
    return lines[0] if lines else type(error).__name__


def neuromorphic_cameras(library: Any) -> list[FoundCamera]:
    """The cameras that neuromorphic-drivers finds.

    These are Prophesee EVK3 HD and EVK4, DAVIS346, DVXplorer and others.

    Parameters
    ----------
    library : the module `neuromorphic_drivers`. Its `list_devices` and `open` are called.
    """
    cameras = []
    for device in library.list_devices():
        model = device.name.value
        # a camera in a network may have an address instead of a known serial number
        identity = {"serial": device.serial} if device.serial else {"address": device.address}
        open_device = partial(NeuromorphicDevice, library.open, identity)
        kinds = NEUROMORPHIC_KINDS.get(model, ())
        cameras.append(FoundCamera(model, kinds, device.serial, open_device, device.error))
    return cameras


class NeuromorphicDevice:
    """A camera that neuromorphic-drivers has opened.

    The library puts each packet in new memory and keeps no reference to it, so it is not copied.
    """

    time_field = "t"

    def __init__(self, open: Callable[..., Any], identity: dict[str, str]) -> None:
        self.handle = open(iterator_timeout=WAIT_S, **identity)
        self.counts = CameraCounts(overflows=0)
        properties = self.handle.properties()
        self.sensor = int(properties.width), int(properties.height)
        # opened without a configuration, a camera has the default one of its model
        self.settings = asdict(import_module(type(properties).__module__).Configuration())

    def read(self) -> np.ndarray | None:
        status, packet = next(self.handle)
        if status.ring is not None:  # None: nothing came within WAIT_S
            self.counts.dropped = status.ring.dropped_packets
        events: np.ndarray | None = None if packet is None else packet.polarity_events
        if events is None:
            return None
        gaps = packet.polarity_events_overflow_indices
        if gaps is not None:
            self.counts.overflows = (self.counts.overflows or 0) + len(gaps)
        return events

    def close(self) -> None:
        self.handle.close()


def dv_cameras(library: Any) -> list[FoundCamera]:
    """The cameras that dv-processing, iniVation's own library, finds: DAVIS, DVXplorer and DVS128.

    Parameters
    ----------
    library : the module `dv_processing.io.camera`. Its `discover` and `open` are called.
    """
    cameras = []
    for descriptor in library.discover():
        model = descriptor.cameraModel.name
        open_device = partial(DvDevice, library.open, descriptor)
        kinds = DV_KINDS.get(model, ())
        cameras.append(FoundCamera(model, kinds, descriptor.serialNumber or None, open_device))
    return cameras


class DvDevice:
    """A camera that dv-processing has opened, or any other `dv_processing.io.InputBase`.

    Recordings and network streams are read like cameras.
    """

    time_field = "timestamp"

    def __init__(self, open: Callable[[Any], Any], descriptor: Any) -> None:
        self.handle = open(descriptor)
        self.counts = CameraCounts()  # the library reports no losses
        resolution = self.handle.getEventResolution()
        if resolution is None:
            raise RuntimeError("it has no stream of events")
        self.sensor = int(resolution[0]), int(resolution[1])
        self.settings = {}
        for name in DV_SETTINGS:
            with suppress(Exception):  # this camera has no such setting, or does not tell it
                self.settings[name] = getattr(self.handle, f"get{name}")()

    def read(self) -> np.ndarray | None:
        # This is asked before the read: events that came before the camera stopped can still be
        # read afterwards.
        was_running = self.handle.isRunning()
        store = self.handle.getNextEventBatch()
        if store is not None:
            # a copy: a store is a list of the driver's own packets
            events: np.ndarray = store.numpy()
            return events
        if not was_running:
            raise RuntimeError("it stopped running")
        time.sleep(PAUSE_S)
        return None

    def close(self) -> None:
        self.handle = None  # the library has no method that closes a camera


DRIVERS: Mapping[str, Driver] = {
    "neuromorphic-drivers": lambda: neuromorphic_cameras(import_module("neuromorphic_drivers")),
    "dv-processing": lambda: dv_cameras(import_module("dv_processing").io.camera),
}
"""Library -> its `Driver`, in the order in which they are tried. neuromorphic-drivers comes first,
because it waits without polling and counts losses."""
