"""Both camera libraries with made devices: only the cable is played, packets are of the libraries' own classes.

The compiled part of neuromorphic-drivers makes its packets itself and lets nobody else make them; its documented
classes of the same names and fields stand for them, with arrays of the library's dtypes. dv-processing makes stores.
"""

import time
from types import SimpleNamespace

import numpy as np

from async_tnt.sources import open_camera
from async_tnt.sources.camera_drivers import DV_KINDS, NEUROMORPHIC_KINDS, DvProcessing, NeuromorphicDrivers

POLARITY_EVENTS = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
SERIAL = "00050423"


class Neuromorphic:
    """neuromorphic-drivers."""

    kinds = NEUROMORPHIC_KINDS
    lost = "gaps: 0"
    sensor = (1280, 720)

    def __init__(self, module):
        self.module = module
        self.models = {name.value: name for name in module.Name}
        special = {"iniVation DAVIS 346": module.Davis346Packet, "iniVation DVXplorer": module.DvxplorerPacket}
        self._packets = {model: special.get(model, module.Evt3Packet) for model in self.models}

    def sensor_of(self, model):
        properties = self.module.name_to_properties(self.models[model])
        return properties.width, properties.height

    def packet_of(self, events, model="Prophesee EVK4", overflows=()):
        """As the library makes it: columns that have nothing are None."""
        made = self._packets[model]()
        for column in self._packets[model].__annotations__:
            setattr(made, column, [] if column == "frames" else None)
        if len(events):
            made.polarity_events = np.empty(len(events), POLARITY_EVENTS)
            for ours, theirs in zip("txyp", POLARITY_EVENTS.names, strict=True):
                made.polarity_events[theirs] = events[ours]
            if len(overflows):
                made.polarity_events_overflow_indices = np.array(overflows, np.uint64)
        return made

    def opened(self, *packets, model="Prophesee EVK4", name="camera"):
        """A camera that sends these and is unplugged then."""
        listed = self.module.ListedDevice(self.models[model], self.module.Connection.USB_SUPER, "1:2", SERIAL, None)
        handle = PlayedHandle(self.module, packets, self.models[model])
        library = SimpleNamespace(list_devices=lambda: [listed], open=handle.open)
        return open_camera(name, drivers={"nd": lambda: NeuromorphicDrivers(library)})


class PlayedHandle:
    """In the place of `neuromorphic_drivers.Device`."""

    def __init__(self, module, packets, name):
        self._module, self._packets, self._name = module, list(packets), name
        self._dropped = 0
        self.closed = False

    def open(self, **settings):
        return self

    def properties(self):
        return self._module.name_to_properties(self._name)

    def __next__(self):
        assert not self.closed, "__next__ called after __exit__"
        if not self._packets:
            raise RuntimeError("Usb(NoDevice)")
        packet = self._packets.pop(0)
        if packet is None:  # nothing came
            return self._module.status.RawStatus(system_time=time.time(), ring=None), None
        self._dropped += 2
        ring = self._module.status.RingStatus(time.time(), 11 if self._dropped == 4 else 5, 1, False, 0, self._dropped)
        return self._module.status.Status(time.time(), ring), packet

    def close(self):
        self.closed = True


class Dv:
    """dv-processing."""

    kinds = DV_KINDS
    lost = "lost: unknown"
    sensor = (346, 260)

    def __init__(self, module):
        self.module = module
        self.models = module.io.camera.CameraModel.__members__

    def sensor_of(self, model):
        return self.sensor

    def packet_of(self, events, model=None):
        store = self.module.EventStore()
        for t, x, y, p in events.tolist():
            store.push_back(t, x, y, bool(p))
        return store

    def opened(self, *packets, model="DAVIS", name="camera"):
        """A camera that sends these and stops running then."""
        return self.opened_input(PlayedInput(packets), model, name)

    def opened_input(self, source, model="DAVIS", name="camera"):
        """Anything in the place of the library's camera."""
        descriptor = SimpleNamespace(cameraModel=self.models[model], serialNumber=SERIAL)  # it has no constructor
        library = SimpleNamespace(discover=lambda: [descriptor])
        library.open = lambda asked: source if asked is descriptor else None
        return open_camera(name, drivers={"dv": lambda: DvProcessing(library)})


class PlayedInput:
    """In the place of a camera of `dv_processing.io.camera`."""

    def __init__(self, batches):
        self._batches = list(batches)

    def getEventResolution(self):
        return Dv.sensor

    def isRunning(self):
        return bool(self._batches)

    def getNextEventBatch(self):
        return self._batches.pop(0) if self._batches else None
