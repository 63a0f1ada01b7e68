"""Cameras by neuromorphic-drivers: Prophesee EVK3 HD and EVK4, DAVIS346, DVXplorer and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from async_tnt.sources.camera_device import FoundCamera, Losses

WAIT_S = 0.1  # the library waits for events outside of Python; this bounds how long `close` takes

KINDS = {  # KIND of `camera:KIND`, by the library's names
    "Prophesee EVK4": ("evk4",),
    "Prophesee EVK3 HD": ("evk3",),
    "iniVation DAVIS 346": ("davis346", "davis"),
    "iniVation DVXplorer": ("dvxplorer",),
    "CenturyArks VGA": ("silkyevcam",),
    "Lucid Triton": ("triton",),
}


class NeuromorphicDrivers:
    """The library, or what tests put in the place of its two ways to the cable.

    Parameters
    ----------
    list_devices, open : `neuromorphic_drivers.list_devices` and `neuromorphic_drivers.open`.
    """

    def __init__(self, list_devices: Callable[[], Sequence[Any]], open: Callable[..., Any]) -> None:
        self.name = f"neuromorphic-drivers {version('neuromorphic-drivers')}"
        self._list_devices = list_devices
        self._open = open

    def find(self) -> list[FoundCamera]:
        found = []
        for listed in self._list_devices():
            model = listed.name.value
            # by its address where it is in a network and has not told its serial number
            which = {"serial": listed.serial} if listed.serial else {"address": listed.address}
            open_this = partial(NeuromorphicDevice, self._open, which)
            found.append(FoundCamera(model, KINDS.get(model, ()), listed.serial, open_this, listed.error))
        return found


class NeuromorphicDevice:
    """One camera. The library makes each packet's array anew and keeps no hold of it: it is handed on uncopied."""

    pause_s = 0.0
    time_field = "t"

    def __init__(self, open: Callable[..., Any], which: dict[str, str]) -> None:
        self.handle = open(iterator_timeout=WAIT_S, **which)
        self.losses = Losses(overflows=0)
        properties = self.handle.properties()
        self.sensor = int(properties.width), int(properties.height)

    def read(self) -> np.ndarray | None:
        status, packet = next(self.handle)
        if (ring := status.ring) is not None:  # None: nothing came within WAIT_S
            self.losses.dropped = ring.dropped_packets
            self.losses.most_waiting = max(ring.backlog, self.losses.most_waiting or 0)
        if packet is None or (events := packet.polarity_events) is None:
            return None
        gaps = packet.polarity_events_overflow_indices
        if gaps is not None:
            self.losses.overflows = (self.losses.overflows or 0) + len(gaps)
        return events

    def close(self) -> None:
        self.handle.close()


def neuromorphic_drivers() -> NeuromorphicDrivers:
    """The installed library. ImportError without it."""
    import neuromorphic_drivers

    return NeuromorphicDrivers(neuromorphic_drivers.list_devices, neuromorphic_drivers.open)
