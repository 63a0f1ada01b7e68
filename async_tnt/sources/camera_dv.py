"""Cameras by dv-processing, iniVation's own library: the DAVIS, DVXplorer and DVS128 families."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from async_tnt.sources.camera_device import FoundCamera, Losses

PAUSE_S = 0.001  # its reading never waits: it is asked so often, for 3 % of a core

KINDS = {  # KIND of `camera:KIND`, by the library's names of models
    "DVS128": ("dvs128",),
    "DAVIS": ("davis", "davis346"),
    "DAVIS_GEN2": ("davis", "davis346"),
    "DVXPLORER": ("dvxplorer",),
    "DVXPLORER_GEN2": ("dvxplorer",),
    "DVXPLORER_M": ("dvxplorer", "dvxplorer-m"),
    "DVXPLORER_S": ("dvxplorer", "dvxplorer-s"),
}


class DvProcessing:
    """The library, or what tests put in the place of its two ways to the cable.

    Parameters
    ----------
    discover, open : `dv_processing.io.camera.discover` and `dv_processing.io.camera.open`.
    """

    def __init__(self, discover: Callable[[], Sequence[Any]], open: Callable[[Any], Any]) -> None:
        self.name = f"dv-processing {version('dv-processing')}"
        self._discover = discover
        self._open = open

    def find(self) -> list[FoundCamera]:
        found = []
        for descriptor in self._discover():
            model = descriptor.cameraModel.name
            open_this = partial(DvDevice, self._open, descriptor)
            found.append(FoundCamera(model, KINDS.get(model, ()), descriptor.serialNumber or None, open_this))
        return found


class DvDevice:
    """One camera, or anything else of `dv_processing.io.InputBase`: recordings and network streams are read alike."""

    pause_s = PAUSE_S
    time_field = "timestamp"

    def __init__(self, open: Callable[[Any], Any], descriptor: Any) -> None:
        self.handle = open(descriptor)
        self.losses = Losses()  # the library counts none
        resolution = self.handle.getEventResolution()
        if resolution is None:
            raise RuntimeError("it sends no events")
        self.sensor = int(resolution[0]), int(resolution[1])

    def read(self) -> np.ndarray | None:
        running = self.handle.isRunning()  # asked first: what came before the end is still there after it
        store = self.handle.getNextEventBatch()
        if store is not None:
            return store.numpy()  # the only copy: a store is a list of the driver's own packets
        if not running:
            raise RuntimeError("it stopped running")
        return None

    def close(self) -> None:
        self.handle = None  # the library has no other way


def dv_processing() -> DvProcessing:
    """The installed library. ImportError without it."""
    import dv_processing

    return DvProcessing(dv_processing.io.camera.discover, dv_processing.io.camera.open)
