"""The camera libraries behind one interface: a driver finds the connected cameras, a device is
read."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from typing import Any, Protocol

import numpy as np

WAIT_S = 0.1  # how long neuromorphic-drivers waits for events at a time, and `close` at most
PAUSE_S = 0.001  # dv-processing does not wait: it is polled this often, which takes 3 % of a core

NEUROMORPHIC_KINDS = {  # KIND of `camera:KIND`, by neuromorphic-drivers' names of models
    "Prophesee EVK4": ("evk4",),
    "Prophesee EVK3 HD": ("evk3",),
    "iniVation DAVIS 346": ("davis346", "davis"),
    "iniVation DVXplorer": ("dvxplorer",),
    "CenturyArks VGA": ("silkyevcam",),
    "Lucid Triton": ("triton",),
}
DV_KINDS = {  # the same by dv-processing's names, which do not tell a DAVIS346 from other DAVIS
    "DVS128": ("dvs128",),
    "DAVIS": ("davis", "davis346"),
    "DAVIS_GEN2": ("davis", "davis346"),
    "DVXPLORER": ("dvxplorer",),
    "DVXPLORER_GEN2": ("dvxplorer",),
    "DVXPLORER_M": ("dvxplorer", "dvxplorer-m"),
    "DVXPLORER_S": ("dvxplorer", "dvxplorer-s"),
}
DV_SETTINGS = (
    *(
        "ContrastThresholdOn",
        "ContrastThresholdOff",
        "ReadoutFPS",
        "GlobalHold",
        "BackgroundActivityFilter",
    ),
    *(
        "RefractoryPeriodFilter",
        "SkipFilter",
        "CropAreaEvents",
        "CropArea",
        "FirmwareVersion",
        "LogicVersion",
    ),
)
"""What a dv-processing camera is asked for: `getReadoutFPS` and so on."""
ALL_KINDS = sorted(
    {kind for kinds in (*NEUROMORPHIC_KINDS.values(), *DV_KINDS.values()) for kind in kinds}
)


@dataclass
class CameraCounts:
    """What a camera has sent so far. None: the library does not report it."""

    packets: int = 0
    """Those that hold events."""
    events: int = 0
    overflows: int | None = None
    """Gaps in the stream of events, which were not read in time."""
    dropped: int | None = None
    """Raw USB packets that the library dropped."""
    clock_restarts: int = 0
    """How often the camera's clock moved back; times continue, see `Clock`."""
    off_sensor: int = 0
    """Events left out because they lie off the sensor: the cable or the driver garbled them."""
    jumped: int = 0
    """Events left out because their time jumps, see `Clock`."""


class Device(Protocol):
    """An opened camera of one of the libraries. `Camera` calls one method at a time."""

    sensor: tuple[int, int]
    time_field: str
    """Of its packets."""
    counts: CameraCounts
    """It updates what the library reports as lost while it is read; `Camera` does the rest."""
    handle: Any
    """The library's own object."""
    settings: dict[str, Any]
    """Name -> value of what decides which events it sends, when it was opened, as far as the
    library tells."""

    def read(self) -> np.ndarray | None:
        """The next packet, a structured array in new memory; None if there is none now.

        Waits for one, for 0.2 s at most. If the camera is gone, raises what the library raises, see
        `failure`.
        """

    def close(self) -> None:
        """Release the camera."""


@dataclass(frozen=True)
class FoundCamera:
    """A connected camera."""

    model: str
    """The library's name."""
    kinds: tuple[str, ...]
    """Every KIND of `camera:KIND` that matches it."""
    serial: str | None
    open: Callable[[], Device]
    problem: str | None = None
    """Why it may not open, if the library reports it."""

    def __str__(self) -> str:
        return self.model if not self.serial else f"{self.model} {self.serial}"


Driver = Callable[[], Sequence[FoundCamera]]
"""Finds the connected cameras of one library. ImportError without it; if it cannot search, what the
library raises."""


def failure(error: BaseException) -> str:
    """What a library reports when it fails, in one line.

    Libraries in Rust panic with an exception that `except Exception` does not catch.
    dv-processing's messages hold a place in its source, the sentence, and a C++ stack.

    Raises
    ------
    The error itself, if the program is being stopped.

    Examples
    --------
    >>> failure(RuntimeError("/a/b.hpp(88): dv::open()\\nRuntimeError: no such device\\nStacktrace:\\n 0# x"))
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
    """By neuromorphic-drivers: Prophesee EVK3 HD and EVK4, DAVIS346, DVXplorer and others.

    Parameters
    ----------
    library : the module `neuromorphic_drivers`, of which `list_devices` and `open` are called.
    """
    found = []
    for listed in library.list_devices():
        model = listed.name.value
        # by its address if it is in a network and its serial number is unknown
        which = {"serial": listed.serial} if listed.serial else {"address": listed.address}
        open_this = partial(NeuromorphicDevice, library.open, which)
        found.append(
            FoundCamera(
                model, NEUROMORPHIC_KINDS.get(model, ()), listed.serial, open_this, listed.error
            )
        )
    return found


class NeuromorphicDevice:
    """One camera. The library puts each packet in new memory and keeps no reference: it is not
    copied."""

    time_field = "t"

    def __init__(self, open: Callable[..., Any], which: dict[str, str]) -> None:
        self.handle = open(iterator_timeout=WAIT_S, **which)
        self.counts = CameraCounts(overflows=0)
        properties = self.handle.properties()
        self.sensor = int(properties.width), int(properties.height)
        # opened without a configuration, a camera has the default one of its model
        self.settings = asdict(import_module(type(properties).__module__).Configuration())

    def read(self) -> np.ndarray | None:
        status, packet = next(self.handle)
        if (ring := status.ring) is not None:  # None: nothing came within WAIT_S
            self.counts.dropped = ring.dropped_packets
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
    """By dv-processing, iniVation's own library: the DAVIS, DVXplorer and DVS128 families.

    Parameters
    ----------
    library : the module `dv_processing.io.camera`, of which `discover` and `open` are called.
    """
    found = []
    for descriptor in library.discover():
        model = descriptor.cameraModel.name
        open_this = partial(DvDevice, library.open, descriptor)
        found.append(
            FoundCamera(model, DV_KINDS.get(model, ()), descriptor.serialNumber or None, open_this)
        )
    return found


class DvDevice:
    """One camera, or any other `dv_processing.io.InputBase`: recordings and network streams are
    read alike."""

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
            with suppress(Exception):  # this camera has none, or does not tell it
                self.settings[name] = getattr(self.handle, f"get{name}")()

    def read(self) -> np.ndarray | None:
        # first, as events from before the end can be read after it
        running = self.handle.isRunning()
        store = self.handle.getNextEventBatch()
        if store is not None:
            # a copy: a store is a list of the driver's own packets
            events: np.ndarray = store.numpy()
            return events
        if not running:
            raise RuntimeError("it stopped running")
        time.sleep(PAUSE_S)
        return None

    def close(self) -> None:
        self.handle = None  # the library has no other way


DRIVERS: Mapping[str, Driver] = {
    "neuromorphic-drivers": lambda: neuromorphic_cameras(import_module("neuromorphic_drivers")),
    "dv-processing": lambda: dv_cameras(import_module("dv_processing").io.camera),
}
"""Library -> its `Driver`, in the order in which they are tried: the first waits without polling,
and counts losses."""
