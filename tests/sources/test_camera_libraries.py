"""Both camera libraries with made devices: only the cable is played, packets are of the libraries' own classes.

The compiled part of neuromorphic-drivers makes its packets itself and lets nobody else make them; its documented
classes of the same names and fields stand for them, with arrays of the library's dtypes. dv-processing makes stores.
"""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.events import as_events
from async_tnt.sources import open_camera, open_recording, sample_recordings
from async_tnt.sources.camera_drivers import DV_KINDS, NEUROMORPHIC_KINDS, dv_cameras, neuromorphic_cameras

POLARITY_EVENTS = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
SERIAL = "00050423"
EPOCH_US = 1_700_000_000_000_000  # dv-processing's times count from 1970


class Neuromorphic:
    """neuromorphic-drivers."""

    kinds = NEUROMORPHIC_KINDS
    lost = "gaps: 0"

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
        library = SimpleNamespace(list_devices=lambda: [listed], open=lambda **settings: handle)
        return open_camera(name, drivers={"nd": lambda: neuromorphic_cameras(library)})


class PlayedHandle:
    """In the place of `neuromorphic_drivers.Device`."""

    def __init__(self, module, packets, name):
        self._module, self._packets, self._name = module, list(packets), name
        self._dropped = 0

    def properties(self):
        return self._module.name_to_properties(self._name)

    def __next__(self):
        if not self._packets:
            raise RuntimeError("Usb(NoDevice)")
        packet = self._packets.pop(0)
        if packet is None:  # nothing came
            return self._module.status.RawStatus(system_time=time.time(), ring=None), None
        self._dropped += 2
        ring = self._module.status.RingStatus(time.time(), 5, 1, False, 0, self._dropped)
        return self._module.status.Status(time.time(), ring), packet

    def close(self):
        self._packets = None


class Dv:
    """dv-processing."""

    kinds = DV_KINDS
    lost = "lost: unknown"

    def __init__(self, module):
        self.module = module
        self.models = module.io.camera.CameraModel.__members__

    def sensor_of(self, model):
        return PlayedInput.sensor

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
        return open_camera(name, drivers={"dv": lambda: dv_cameras(library)})


class PlayedInput:
    """In the place of a camera of `dv_processing.io.camera`."""

    sensor = (346, 260)

    def __init__(self, batches):
        self._batches = list(batches)

    def getEventResolution(self):
        return self.sensor

    def isRunning(self):
        return bool(self._batches)

    def getNextEventBatch(self):
        return self._batches.pop(0) if self._batches else None


LIBRARIES = {"neuromorphic_drivers": Neuromorphic, "dv_processing": Dv}


def library_of(package):
    return LIBRARIES[package](pytest.importorskip(package, reason="the extra `cameras` is not installed"))


@pytest.fixture(params=LIBRARIES, scope="module")
def library(request):
    return library_of(request.param)


def read_until_unplugged(camera):
    """Its packets as arrays of ours."""
    came = []
    with pytest.raises(OSError, match=r"00050423 by (nd|dv): the camera is gone"):
        came.extend(camera)
    return [as_events(packet, camera.sensor) for packet in came]


# -- laws of both ----------------------------------------------------------------------------------------


def test_every_event_comes_through_once_and_in_order(library):
    events = random_events(60, sensor=(346, 260), start_us=EPOCH_US)
    packets = [None, events[:30], events[:0], events[30:31], None, events[31:]]  # None: nothing came
    camera = library.opened(*(None if packet is None else library.packet_of(packet) for packet in packets))
    came = read_until_unplugged(camera)
    assert [packet.tolist() for packet in came] == [packets[k].tolist() for k in (1, 3, 5)]
    assert (camera.counts.packets, camera.counts.events) == (3, 60) and library.lost in camera.summary()


def test_events_off_the_sensor_are_left_out(library):
    """neuromorphic-drivers has unsigned coordinates, dv-processing signed ones."""
    width, height = library.opened().sensor
    columns = [0, width, width - 1, -1, 3, 3, 3], [0, 0, height - 1, 3, height, height - 1, -1]
    events = np.zeros(7, [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
    events["t"], (events["x"], events["y"]) = range(7), columns
    camera = library.opened(library.packet_of(events), library.packet_of(events[1:2]))
    (came,) = read_until_unplugged(camera)
    assert came["t"].tolist() == [0, 2, 5] and camera.counts.off_sensor == 5
    assert camera.summary().startswith("1 packets, 3 events (") and "off the sensor: 5" in camera.summary()


def test_every_model_opens_by_each_of_its_kinds(library):
    assert set(library.kinds) == set(library.models)
    for model, kinds in library.kinds.items():
        width, height = library.sensor_of(model)
        corners = events_of([5, 6], [width - 1, 0], [0, height - 1], [1, 0])
        for kind in kinds:
            camera = library.opened(library.packet_of(corners, model), model=model, name=f"camera:{kind}:00050423")
            assert camera.name.startswith(f"{model} 00050423 by ") and camera.sensor == (width, height)
            (came,) = read_until_unplugged(camera)
            assert came.tolist() == corners.tolist() and camera.device is None


# -- what only one of them has ---------------------------------------------------------------------------


def test_losses_are_counted():
    library = library_of("neuromorphic_drivers")
    packets = [library.packet_of(random_events(9), overflows=overflows) for overflows in ([0, 4], [], [8])]
    camera = library.opened(*packets)
    assert camera.summary() == "0 packets, 0 events (gaps: 0)"
    read_until_unplugged(camera)
    assert camera.summary() == "3 packets, 27 events (gaps: 3, raw packets dropped: 6)"


def test_a_file_of_dv_processing_read_as_a_camera(tmp_path):
    """Nothing is played: the library writes events, reads them and ends."""
    dv = library_of("dv_processing")
    events, path = open_recording(sample_recordings()[3]).read(), str(tmp_path / "a.aedat4")
    writing = dv.module.io.MonoCameraWriter.EventOnlyConfig("DAVIS346_00000042", (34, 34))
    writer = dv.module.io.MonoCameraWriter(path, writing)
    for part in np.array_split(events, 20):
        writer.writeEvents(dv.packet_of(part))
    del writer
    camera = dv.opened_input(dv.module.io.MonoCameraRecording(path))
    assert camera.sensor == (34, 34)
    came = read_until_unplugged(camera)
    assert np.concatenate(came).tolist() == events.tolist() and camera.counts.packets == len(came) > 1
