"""Cameras without cables: a driver whose devices play what a test wrote down."""

import threading
from contextlib import contextmanager

import numpy as np

from async_tnt.sources.camera_drivers import CameraCounts, FoundCamera
from async_tnt.sources.cameras import open_camera

RECORD = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])  # as neuromorphic-drivers has it


class PanicException(BaseException):
    """What libraries in Rust raise."""


def made_events(*times):
    events = np.zeros(len(times), RECORD)
    events["t"], events["x"] = times, range(len(times))
    return events


class PlayedDevice:
    """Hands out packets; raises those that are exceptions; then has nothing more.

    Like the real ones it breaks when two threads use it at a time.
    """

    time_field = "t"

    def __init__(self, *packets, sensor=(3400, 34), pause_s=0.0, read_s=0.0):
        self.packets = list(packets)
        self.sensor, self.pause_s, self.read_s = sensor, pause_s, read_s
        self.counts = CameraCounts()
        self.handle = object()
        self.n_reads = self.n_closed = 0
        self._lock = threading.Lock()

    @contextmanager
    def _borrowed(self):
        assert self._lock.acquire(blocking=False), "Already borrowed"
        try:
            yield
        finally:
            self._lock.release()

    def read(self):
        with self._borrowed():
            assert not self.n_closed, "read after close"
            self.n_reads += 1
            packet = self.packets.pop(0) if self.packets else threading.Event().wait(self.read_s) or None
            if isinstance(packet, BaseException):
                raise packet
            return packet

    def close(self):
        with self._borrowed():
            self.n_closed += 1


def found(device, model="Prophesee EVK4", kinds=("evk4",), serial="00050423", problem=None):
    def open_it():
        if isinstance(device, BaseException):
            raise device
        return device

    return FoundCamera(model, kinds, serial, open_it, problem)


def drivers(*cameras, name="played"):
    """A table for `open_camera(drivers=...)` whose library finds these cameras."""
    return {name: lambda: cameras}


def opened(*packets, **settings):
    """(a device that plays these, its camera)."""
    device = PlayedDevice(*packets, **settings)
    return device, open_camera(drivers=drivers(found(device)))
