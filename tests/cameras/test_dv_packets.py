"""Stores of dv-processing, from a played camera and from a file of the library's own, through `Camera`."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import async_tnt
from async_tnt.events import as_events
from async_tnt.sources.camera_drivers import DV_KINDS, DvProcessing
from async_tnt.sources.cameras import open_camera
from async_tnt.sources.files.recording import open_recording, sample_recordings

dv = pytest.importorskip("dv_processing", reason="dv-processing is not installed (extra `cameras`)")

EPOCH_US = 1_700_000_000_000_000  # its times count from 1970


def store_of(events):
    store = dv.EventStore()
    for t, x, y, p in events.tolist():
        store.push_back(t, x, y, bool(p))
    return store


class PlayedInput:
    """In the place of a camera of `dv_processing.io.camera`: stores and Nones, then silence or the end."""

    def __init__(self, batches, resolution=(346, 260), ends=True):
        self._batches = list(batches)
        self._resolution = resolution
        self._ends = ends
        self.n_asked = 0

    def getEventResolution(self):
        return self._resolution

    def isRunning(self):
        return bool(self._batches) or not self._ends

    def getNextEventBatch(self):
        self.n_asked += 1
        if not self._batches:
            return None
        batch = self._batches.pop(0)
        if isinstance(batch, Exception):
            raise batch
        return batch


def opened(device, model=dv.io.camera.CameraModel.DAVIS, name="camera"):
    descriptor = SimpleNamespace(cameraModel=model, serialNumber="00000042")  # the library's has no constructor
    library = SimpleNamespace(discover=lambda: [descriptor], open=lambda asked: device if asked is descriptor else None)
    driver = DvProcessing(library)
    return open_camera(name, drivers={"dv": lambda: driver})


def read_until_unplugged(camera):
    came = []
    with pytest.raises(OSError, match=r"DAVIS 00000042 by dv-processing 2\..*: the camera is gone after [\d,]+ events"):
        came.extend(camera)
    return came


@st.composite
def event_packets(draw):
    lengths = draw(st.lists(st.integers(0, 30), max_size=8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = sum(lengths)
    events = np.empty(n, async_tnt.EVENT_DTYPE)
    events["t"] = EPOCH_US + np.cumsum(rng.integers(0, 300, n))
    events["x"], events["y"] = rng.integers(0, 346, n), rng.integers(0, 260, n)
    events["p"] = rng.integers(0, 2, n)
    return np.split(events, np.cumsum(lengths)[:-1]) if lengths else []


@settings(deadline=None)
@given(event_packets(), st.data())
def test_every_event_comes_through_once_and_in_order(packets, data):
    batches = [store_of(packet) for packet in packets]
    for _ in range(data.draw(st.integers(0, 3))):
        batches.insert(data.draw(st.integers(0, len(batches))), None)  # nothing there
    camera = opened(PlayedInput(batches))
    came = [as_events(packet, camera.sensor) for packet in read_until_unplugged(camera)]
    assert [packet.tolist() for packet in came] == [packet.tolist() for packet in packets if len(packet)]
    assert (camera.counts.packets, camera.counts.events) == (len(came), sum(map(len, packets)))
    assert camera.summary().endswith(" events (lost: unknown)")


def test_stores_of_several_parts_and_what_shares_them():
    """A store is a list of packets that it may share: what is handed on is a copy of them all."""
    first = np.array([(EPOCH_US, 1, 2, 1)], async_tnt.EVENT_DTYPE)
    second = np.array([(EPOCH_US + 5, 3, 4, 0)], async_tnt.EVENT_DTYPE)
    store = store_of(first)
    store.add(store_of(second))
    (packet,) = read_until_unplugged(opened(PlayedInput([store])))
    packet["x"] = 99
    assert [event.x() for event in store] == [1, 3]
    assert as_events(store, (346, 260)).tolist() == first.tolist() + second.tolist()


def test_a_silent_camera_is_asked_now_and_then():
    device = PlayedInput([None] * 5, ends=False)
    camera = opened(device)
    timer = threading.Timer(0.2, camera.close)
    timer.start()
    assert list(camera) == []
    timer.join()
    assert 5 < device.n_asked <= 200  # every millisecond at most
    assert camera.device is None


@pytest.mark.parametrize("model", list(dv.io.camera.CameraModel.__members__))
def test_every_model_of_the_library(model):
    member = dv.io.camera.CameraModel.__members__[model]
    for kind in DV_KINDS[model]:
        camera = opened(PlayedInput([]), member, f"camera:{kind}:00000042")
        assert camera.name.startswith(f"{model} 00000042 by dv-processing") and camera.sensor == (346, 260)


def test_a_camera_of_frames_alone():
    with pytest.raises(OSError, match=r"found DAVIS 00000042 but cannot open it: it sends no events"):
        opened(PlayedInput([], resolution=None))


def test_what_the_library_says_fits_a_line():
    with pytest.raises(RuntimeError) as caught:
        dv.io.camera.open("no such serial")
    broken = PlayedInput([store_of(np.array([(EPOCH_US, 1, 2, 1)], async_tnt.EVENT_DTYPE)), caught.value])
    came = []
    with pytest.raises(OSError, match=r"is gone after 1 events \(Could not find device with given serial number\); "):
        came.extend(opened(broken))
    assert len(came) == 1


def test_a_file_of_the_library_read_as_a_camera(tmp_path):
    """Nothing is played: the library writes events, reads them and ends; decisions are those of the recording."""
    model = async_tnt.load_model("digits")
    recording = open_recording(sample_recordings()[3], packet_events=250)
    path = str(tmp_path / "a.aedat4")
    writer = dv.io.MonoCameraWriter(path, dv.io.MonoCameraWriter.EventOnlyConfig("DAVIS346_00000042", (34, 34)))
    for packet in recording:
        writer.writeEvents(store_of(as_events(packet, (34, 34))))
    del writer
    camera = opened(dv.io.MonoCameraRecording(path))
    assert camera.sensor == (34, 34)
    came = read_until_unplugged(camera)
    assert camera.counts.packets == len(came) > 1
    events = np.concatenate([as_events(packet, (34, 34)) for packet in came])
    assert events.tolist() == open_recording(sample_recordings()[3]).read().tolist()
    processor = async_tnt.Processor(model)
    decisions = [decision for packet in came for decision in processor.push(packet)] + processor.finish()
    assert [decision.label for decision in decisions] == ["3", "3", "3"]


def test_the_installed_library_looks():
    driver = DvProcessing()
    assert driver.name.startswith("dv-processing 2.")
    assert all(camera.model in DV_KINDS for camera in driver.find())
