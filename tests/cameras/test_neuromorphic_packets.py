"""Packets of neuromorphic-drivers' own classes, through `Camera`, to a processor. Only the cable is played.

The compiled part of the library makes its packets itself and lets nobody else make them; its documented classes of
the same names and fields stand for them, with arrays of the library's dtypes.
"""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import async_tnt
from async_tnt.events import as_events
from async_tnt.sources.camera_drivers import NEUROMORPHIC_KINDS, WAIT_S, NeuromorphicDrivers
from async_tnt.sources.cameras import open_camera
from async_tnt.sources.files.recording import open_recording, sample_recordings

nd = pytest.importorskip("neuromorphic_drivers", reason="neuromorphic-drivers is not installed (extra `cameras`)")
from neuromorphic_drivers import status  # noqa: E402

POLARITY_EVENTS = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
IMU_EVENTS = np.dtype([("t", "<u8"), *((name, "<f4") for name in "abcdefg")])
CLASSES = {
    nd.Name.PROPHESEE_EVK3_HD: nd.Evt3Packet,
    nd.Name.PROPHESEE_EVK4: nd.Evt3Packet,
    nd.Name.CENTURYARKS_VGA: nd.Evt3Packet,
    nd.Name.LUCID_TRITON: nd.Evt3Packet,
    nd.Name.INIVATION_DAVIS346: nd.Davis346Packet,
    nd.Name.INIVATION_DVXPLORER: nd.DvxplorerPacket,
}


def packet_of(events, name=nd.Name.PROPHESEE_EVK4, overflows=(), **others):
    """A packet as the library makes it: columns that have nothing are None."""
    made = CLASSES[name]()
    for column in CLASSES[name].__annotations__:
        setattr(made, column, [] if column == "frames" else None)
    if len(events):
        made.polarity_events = np.empty(len(events), POLARITY_EVENTS)
        for ours, theirs in zip(("t", "x", "y", "p"), POLARITY_EVENTS.names, strict=True):
            made.polarity_events[theirs] = events[ours]
        if len(overflows):
            made.polarity_events_overflow_indices = np.array(overflows, np.uint64)
    for column, value in others.items():
        setattr(made, column, value)
    return made


class PlayedHandle:
    """In the place of `neuromorphic_drivers.Device`: packets, then silence or what is raised."""

    def __init__(self, packets, name, iterator_timeout, serial=None, address=None):
        self._packets = list(packets)
        self._name = name
        self._timeout = iterator_timeout
        self.asked_for = serial or address
        self.backlogs = [3, 11, 5]
        self.dropped_packets = 0
        self.closed = False

    def properties(self):
        return nd.name_to_properties(self._name)

    def __next__(self):
        assert not self.closed, "__next__ called after __exit__"
        if not self._packets:
            time.sleep(min(self._timeout, 0.005))
            return status.RawStatus(system_time=time.time(), ring=None), None
        packet = self._packets.pop(0)
        if isinstance(packet, Exception):
            raise packet
        self.dropped_packets += 2
        self.backlogs.append(self.backlogs.pop(0))
        ring = status.RingStatus(time.time(), self.backlogs[-1], 1, False, 0, self.dropped_packets)
        return status.Status(time.time(), ring), packet

    def close(self):
        self.closed = True


def opened(packets, model=nd.Name.PROPHESEE_EVK4, name="camera"):
    handles = []

    def open_it(configuration=None, **settings):
        handles.append(PlayedHandle(packets, model, **settings))
        return handles[-1]

    listed = [nd.ListedDevice(model, nd.Connection.USB_SUPER, "1:2", "00050423", None)]
    camera = open_camera(
        name, drivers={"nd": lambda: NeuromorphicDrivers(SimpleNamespace(list_devices=lambda: listed, open=open_it))}
    )
    return camera, handles[0]


def read_until_unplugged(camera):
    came = []
    with pytest.raises(OSError, match="the camera is gone"):
        came.extend(camera)
    return came


UNPLUGGED = RuntimeError("Usb(NoDevice)")


@st.composite
def event_packets(draw, width=1280, height=720, start_us=0):
    lengths = draw(st.lists(st.integers(0, 40), max_size=8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = sum(lengths)
    events = np.empty(n, async_tnt.EVENT_DTYPE)
    events["t"] = start_us + np.cumsum(rng.integers(0, 300, n))
    events["x"], events["y"] = rng.integers(0, width, n), rng.integers(0, height, n)
    events["p"] = rng.integers(0, 2, n)
    return np.split(events, np.cumsum(lengths)[:-1]) if lengths else []


@settings(deadline=None)
@given(event_packets())
def test_every_event_comes_through_once_and_in_order(packets):
    camera, _ = opened([*(packet_of(packet) for packet in packets), UNPLUGGED])
    came = [as_events(packet, camera.sensor) for packet in read_until_unplugged(camera)]
    assert [packet.tolist() for packet in came] == [packet.tolist() for packet in packets if len(packet)]
    assert camera.counts.packets == len(came)
    assert camera.counts.events == sum(map(len, packets))


@pytest.mark.parametrize("model", CLASSES)
def test_every_camera_of_the_library(model):
    """Its name opens it, its sensor is the library's, and what else it sends is left out."""
    properties = nd.name_to_properties(model)
    events = np.array([(5, properties.width - 1, 0, 1), (6, 0, properties.height - 1, 0)], async_tnt.EVENT_DTYPE)
    others = {}
    if model == nd.Name.INIVATION_DAVIS346:
        frame = nd.Frame()
        frame.start_t, frame.t, frame.pixels = 1, 2, np.zeros((260, 346), np.uint16)
        others = {"frames": [frame], "imu_events": np.zeros(2, IMU_EVENTS)}
    for kind in NEUROMORPHIC_KINDS[model.value]:
        packets = [packet_of(events, model, **others), packet_of([], model, **others), UNPLUGGED]
        camera, handle = opened(packets, model, f"camera:{kind}:00050423")
        assert camera.sensor == (properties.width, properties.height)
        assert handle.asked_for == "00050423" and camera.device is handle
        (packet,) = read_until_unplugged(camera)
        assert as_events(packet, camera.sensor).tolist() == events.tolist()
        assert handle.closed


def test_every_name_of_the_library_is_known():
    assert set(NEUROMORPHIC_KINDS) == {name.value for name in nd.Name}


def test_events_are_handed_on_uncopied():
    packet = packet_of(np.array([(5, 1, 2, 1)], async_tnt.EVENT_DTYPE))
    camera, _ = opened([packet])
    assert next(iter(camera)) is packet.polarity_events


def test_losses_are_counted():
    events = np.zeros(9, async_tnt.EVENT_DTYPE)
    camera, _ = opened([packet_of(events, overflows=[0, 4]), packet_of(events), packet_of(events, overflows=[8])])
    packets = iter(camera)
    assert camera.counts.overflows == 0 and camera.counts.dropped is None
    for _ in range(3):
        next(packets)
    camera.close()
    assert camera.summary() == "3 packets, 27 events (gaps: 3, raw packets dropped: 6, at most 11 waiting)"


def test_a_silent_camera_waits_in_the_library():
    camera, handle = opened([])
    assert handle._timeout == WAIT_S <= 0.2  # what `close` may have to wait for
    assert camera._read() is None and camera.counts.dropped is None


def test_a_recording_played_as_a_camera_gives_its_decisions():
    model = async_tnt.load_model("digits")
    recording = open_recording(sample_recordings()[3], packet_events=250)
    expected = [decision.label for decision in async_tnt.stream(recording, model)]
    camera, _ = opened([*(packet_of(as_events(packet, (34, 34))) for packet in recording), UNPLUGGED])
    processor = async_tnt.Processor(model)
    decisions = [decision for packet in read_until_unplugged(camera) for decision in processor.push(packet)]
    decisions += processor.finish()
    assert [decision.label for decision in decisions] == expected == ["3", "3", "3"]


def test_the_packet_itself_is_a_form_of_events():
    events = np.array([(5, 1, 2, 1)], async_tnt.EVENT_DTYPE)
    assert as_events(packet_of(events), (34, 34)).tolist() == events.tolist()
    assert len(as_events(packet_of([]), (34, 34))) == 0


def test_a_camera_without_permission():
    """As the library lists it: no serial number, and why. Its address is no network address."""
    listed = [nd.ListedDevice(nd.Name.PROPHESEE_EVK4, nd.Connection.USB_SUPER, "1:2", None, "Access denied")]

    asked = []

    def open_it(**settings):
        asked.append(settings)
        raise RuntimeError('"1:2" is not a valid IPv4 address')

    with pytest.raises(OSError, match=r"cannot be opened; .* found Prophesee EVK4 but cannot open it: Access denied"):
        open_camera(
            "camera:evk4",
            drivers={"nd": lambda: NeuromorphicDrivers(SimpleNamespace(list_devices=lambda: listed, open=open_it))},
        )
    assert asked == [{"iterator_timeout": WAIT_S, "address": "1:2"}]


def test_the_installed_library_looks():
    driver = NeuromorphicDrivers()
    assert driver.name.startswith("neuromorphic-drivers 0.")
    try:
        found = driver.find()
    except RuntimeError as error:  # no USB on this machine
        assert str(error)
    else:
        assert all(camera.model in NEUROMORPHIC_KINDS for camera in found)
