"""Both camera libraries with made devices.

Only the cable is played. Packets are of the libraries' own classes.

The compiled part of neuromorphic-drivers makes its packets itself and lets nobody else make them;
its documented classes of the same names and fields stand for them, with arrays of the library's
dtypes. dv-processing makes stores.
"""

import json
import time
import weakref
from types import SimpleNamespace

import numpy as np
import pytest
from made import random_events
from sources.test_cameras import RECORD

from async_tnt.sources import open_camera, open_recording, sample_recordings
from async_tnt.sources.live import camera_drivers
from async_tnt.sources.live.camera_drivers import (
    DV_KINDS,
    NEUROMORPHIC_KINDS,
    WAIT_S,
    DvDevice,
    dv_cameras,
    failure,
    neuromorphic_cameras,
)
from async_tnt.sources.live.cameras import Camera
from async_tnt.volume.events import as_events

SERIAL = "00050423"
EPOCH_US = 1_700_000_000_000_000  # dv-processing's times count from 1970


class Neuromorphic:
    """neuromorphic-drivers and its only camera.

    The camera sends these packets (None: nothing comes) and is unplugged.
    """

    kinds = NEUROMORPHIC_KINDS
    find = staticmethod(neuromorphic_cameras)
    lost = ("gaps: 8", "raw packets dropped: 10")

    def __init__(self, packets=(), model="Prophesee EVK4"):
        self._module = pytest.importorskip(
            "neuromorphic_drivers", reason="the extra `cameras` is not installed"
        )
        self.models = {name.value: name for name in self._module.Name}
        self._model = self.models[model]
        self._packets = list(packets)
        self._n_dropped = 0

    def list_devices(self):
        usb = self._module.Connection.USB_SUPER
        return [self._module.ListedDevice(self._model, usb, "1:2", SERIAL, None)]

    def open(self, **settings):
        return self

    def properties(self):
        return self._module.name_to_properties(self._model)

    def __next__(self):
        if not self._packets:
            raise RuntimeError("Usb(NoDevice)")
        events = self._packets.pop(0)
        if events is None:
            return self._module.status.RawStatus(system_time=time.time(), ring=None), None
        self._n_dropped += 2
        ring = self._module.status.RingStatus(time.time(), 5, 1, False, 0, self._n_dropped)
        return self._module.status.Status(time.time(), ring), self._packet_of(events)

    def _packet_of(self, events):
        """A packet as the library makes it: columns that have nothing are None."""
        special = {
            "iniVation DAVIS 346": "Davis346Packet",
            "iniVation DVXplorer": "DvxplorerPacket",
        }
        made = getattr(self._module, special.get(self._model.value, "Evt3Packet"))()
        for column in type(made).__annotations__:
            setattr(made, column, [] if column == "frames" else None)
        if len(events):
            made.polarity_events = np.empty(len(events), RECORD)
            for ours, theirs in zip("txyp", RECORD.names, strict=True):
                made.polarity_events[theirs] = events[ours]
            made.polarity_events_overflow_indices = np.array([0, 0], np.uint64)
        return made

    def close(self):
        self._packets = None


class Dv:
    """dv-processing and its only camera.

    The camera sends these packets (None: nothing comes) and stops running.
    """

    kinds = DV_KINDS
    find = staticmethod(dv_cameras)
    lost = ("lost: unknown",)

    def __init__(self, packets=(), model="DAVIS"):
        self._module = pytest.importorskip(
            "dv_processing", reason="the extra `cameras` is not installed"
        )
        self.models = self._module.io.camera.CameraModel.__members__
        self._model = self.models[model]
        self._packets = list(packets)

    def discover(self):
        # its own class has no constructor
        return [SimpleNamespace(cameraModel=self._model, serialNumber=SERIAL)]

    def open(self, descriptor):
        return self

    def getEventResolution(self):
        return 346, 260

    def getBackgroundActivityFilter(self):
        return True

    def getFirmwareVersion(self):
        return 6

    def getCropArea(self):
        raise RuntimeError("not supported")

    def isRunning(self):
        return bool(self._packets)

    def getNextEventBatch(self):
        events = self._packets.pop(0) if self._packets else None
        return None if events is None else store_of(self._module, events)


def store_of(module, events):
    store = module.EventStore()
    for t, x, y, p in events.tolist():
        store.push_back(t, x, y, bool(p))
    return store


of_both = pytest.mark.parametrize("library", [Neuromorphic, Dv])


def read_until_unplugged(camera):
    """Its packets as arrays of ours."""
    came = []
    with pytest.raises(OSError, match=r" by \w+: the camera is gone"):
        came.extend(camera)
    return [as_events(packet, camera.sensor) for packet in came]


def opened(played, name="camera"):
    return open_camera(name, drivers={"played": lambda: played.find(played)})


@of_both
def test_every_event_on_the_sensor_comes_through_once_and_in_order(library):
    """neuromorphic-drivers has unsigned coordinates, dv-processing signed ones."""
    width, height = opened(library()).sensor
    events = random_events(60, sensor=(width, height), start_us=EPOCH_US)
    mixed = np.zeros(7, [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
    mixed["t"] = events["t"][-1] + np.arange(7)
    mixed["x"] = [0, width, width - 1, -1, 3, 3, 3]
    mixed["y"] = [0, 0, height - 1, 3, height, height - 1, -1]
    camera = opened(library([None, events[:30], events[:0], None, events[30:], mixed, mixed[1:2]]))
    assert camera.summary().startswith("0 packets, 0 events (")
    came = read_until_unplugged(camera)
    times = [events["t"][:30], events["t"][30:], mixed["t"][[0, 2, 5]]]
    assert [packet["t"].tolist() for packet in came] == [t.tolist() for t in times]
    assert np.concatenate(came[:2]).tolist() == events.tolist() and camera.counts.off_sensor == 5
    assert camera.summary().startswith("3 packets, 63 events (")
    assert all(words in camera.summary() for words in ("off the sensor: 5", *library.lost))


@of_both
def test_every_model_opens_by_each_of_its_kinds(library):
    assert set(library.kinds) == set(library().models)
    for model, kinds in library.kinds.items():
        for kind in kinds:
            camera = opened(library([random_events(9)], model), f"camera:{kind}:{SERIAL}")
            assert camera.name == f"{model} {SERIAL} by played"
            assert len(read_until_unplugged(camera)) == 1 and camera.device is None


@of_both
def test_settings_are_what_the_library_tells_when_the_camera_is_opened(library):
    """A setting that a camera does not have, or does not tell, is not among them."""
    settings = opened(library()).settings
    if library is Dv:
        assert settings == {"BackgroundActivityFilter": True, "FirmwareVersion": 6}
    else:
        assert settings["biases"].keys() >= {"diff_on", "diff_off", "refr"}
    json.dumps(settings, default=str)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (("/a/b.hpp(88): dv::open()", "RuntimeError: no such device", "Stack:"), "no such device"),
        (("/a/b.hpp(88): dv::open()", "dv::IOException: it is busy", "Stack:"), "it is busy"),
        (("no such device", "Hint: is it plugged in?"), "no such device"),
        (("LIBUSB_ERROR", "RuntimeError", ""), "LIBUSB_ERROR"),
    ],
)
def test_the_sentence_of_a_librarys_error_is_told(lines, told):
    """It is behind the name of the error, if that stands in a line below the first."""
    assert failure(RuntimeError("\n".join(lines))) == told


def test_dv_processing_is_asked_for_the_settings_that_change_events():
    class Talkative(PlayedHandle):
        """It has every setting, and others beside them."""

        def __getattr__(self, name):
            return lambda: name

    assert DvDevice(lambda descriptor: Talkative(), None).settings.keys() == {
        *("ContrastThresholdOn", "ContrastThresholdOff", "ReadoutFPS", "GlobalHold"),
        *("BackgroundActivityFilter", "RefractoryPeriodFilter", "SkipFilter"),
        *("CropAreaEvents", "CropArea", "FirmwareVersion", "LogicVersion"),
    }


class PlayedHandle:
    """An opened camera of dv-processing, which needs no library. What it returns is played: a store
    of events, or None; then it stops running."""

    def __init__(self, *batches):
        self._batches = list(batches)

    def getEventResolution(self):
        return 34, 34

    def isRunning(self):
        return bool(self._batches)

    def getNextEventBatch(self):
        return self._batches.pop(0) if self._batches else None

    def stop_with(self, batch):
        """Stop, with a last batch that can still be read."""
        self._batches = []
        self.getNextEventBatch = lambda: self.__dict__.pop("last", None)
        self.last = batch


def test_events_that_come_while_a_camera_stops_are_read(monkeypatch):
    """It stops, and has a last batch, just after the device has found none."""
    last = SimpleNamespace(numpy=lambda: random_events(5))
    handle = PlayedHandle(None, None)
    device = DvDevice(lambda descriptor: handle, None)
    next_batch = handle.getNextEventBatch

    def none_and_stop():
        assert next_batch() is None
        handle.stop_with(last)

    naps = []
    monkeypatch.setattr(camera_drivers.time, "sleep", naps.append)
    handle.getNextEventBatch = none_and_stop
    assert device.read() is None and naps == [camera_drivers.PAUSE_S]
    assert len(device.read()) == 5
    with pytest.raises(RuntimeError, match="it stopped running"):
        device.read()


def test_a_camera_of_dv_processing_without_events_is_not_opened():
    handle = PlayedHandle()
    handle.getEventResolution = lambda: None
    with pytest.raises(RuntimeError, match=r"^it has no stream of events$"):
        DvDevice(lambda descriptor: handle, None)


def test_closing_a_camera_of_dv_processing_lets_go_of_it():
    """The library releases a camera when nothing refers to it any more."""
    handles = [PlayedHandle(None)]
    camera = Camera(DvDevice(lambda descriptor: handles.pop(), None), "played")
    handle = weakref.ref(camera.device)
    assert handle() is not None
    camera.close()
    assert handle() is None and camera.device is None


def test_a_camera_without_a_serial_number_is_opened_by_its_address():
    opened_by = []
    listed = [
        SimpleNamespace(
            name=SimpleNamespace(value="Lucid Triton"),
            serial=serial,
            address=address,
            error=f"{address} does not answer",
        )
        for serial, address in (("7", "10.0.0.7"), (None, "10.0.0.8"))
    ]
    library = SimpleNamespace(list_devices=lambda: listed, open=lambda **how: opened_by.append(how))
    for found in neuromorphic_cameras(library):
        with pytest.raises(AttributeError):  # nothing was opened
            found.open()
        assert found.problem == f"10.0.0.{found.serial or 8} does not answer"
    assert opened_by == [
        {"iterator_timeout": WAIT_S, "serial": "7"},
        {"iterator_timeout": WAIT_S, "address": "10.0.0.8"},
    ]


def test_dv_processing_tells_no_serial_number_by_an_empty_one():
    model = SimpleNamespace(name="DVXPLORER_M")
    library = SimpleNamespace(
        discover=lambda: [SimpleNamespace(cameraModel=model, serialNumber="")], open=None
    )
    (found,) = dv_cameras(library)
    assert (found.serial, str(found)) == (None, "DVXPLORER_M")
    assert found.kinds == ("dvxplorer", "dvxplorer-m")


def test_a_file_of_dv_processing_read_as_a_camera(tmp_path):
    """Nothing is played: the library writes events, reads them and ends."""
    dv = pytest.importorskip("dv_processing", reason="the extra `cameras` is not installed")
    events = open_recording(sample_recordings()[3]).read()
    path = str(tmp_path / "a.aedat4")
    writer = dv.io.MonoCameraWriter(
        path, dv.io.MonoCameraWriter.EventOnlyConfig("DAVIS346_00000042", (34, 34))
    )
    for part in np.array_split(events, 20):
        writer.writeEvents(store_of(dv, part))
    del writer
    camera = Camera(DvDevice(dv.io.MonoCameraRecording, path), "a file by dv")
    assert camera.sensor == (34, 34)
    came = read_until_unplugged(camera)
    assert np.concatenate(came).tolist() == events.tolist()
    assert camera.counts.packets == len(came) > 1
