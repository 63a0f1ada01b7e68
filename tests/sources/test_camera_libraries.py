"""Packets of both camera libraries, through `Camera` to a processor: laws of both, and what only one of them has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of, random_events
from sources.camera_libraries import Dv, Neuromorphic

from async_tnt.events import as_events
from async_tnt.kernels.clock import AGREEING_PACKETS as N
from async_tnt.sources import open_recording, sample_recordings

HOUR_US = 3_600_000_000
EPOCH_US = 1_700_000_000_000_000  # dv-processing's times count from 1970
LIBRARIES = {"neuromorphic_drivers": Neuromorphic, "dv_processing": Dv}


def library_of(package):
    return LIBRARIES[package](pytest.importorskip(package, reason="the extra `cameras` is not installed"))


@pytest.fixture(params=LIBRARIES, scope="module")
def library(request):
    return library_of(request.param)


@pytest.fixture(scope="module")
def neuromorphic():
    return library_of("neuromorphic_drivers")


@pytest.fixture(scope="module")
def dv():
    return library_of("dv_processing")


def read_until_unplugged(camera):
    """Its packets as arrays of ours."""
    came = []
    with pytest.raises(OSError, match=r"00050423 by (neuromorphic-drivers 0|dv-processing 2)\..*: the camera is gone"):
        came.extend(camera)
    return [as_events(packet, camera.sensor) for packet in came]


# -- laws of both ----------------------------------------------------------------------------------------


@given(lengths=st.lists(st.one_of(st.none(), st.integers(0, 30)), max_size=8), seed=st.integers(0, 2**32))
def test_every_event_comes_through_once_and_in_order(library, lengths, seed):
    n = sum(length or 0 for length in lengths)
    events = random_events(n, seed=seed, sensor=(346, 260), start_us=EPOCH_US)
    parts = iter(np.split(events, np.cumsum([length for length in lengths if length is not None])[:-1]))
    packets = [None if length is None else next(parts) for length in lengths]  # None: nothing came
    camera = library.opened(*(None if packet is None else library.packet_of(packet) for packet in packets))
    came = read_until_unplugged(camera)
    assert [packet.tolist() for packet in came] == [p.tolist() for p in packets if p is not None and len(p)]
    assert (camera.counts.packets, camera.counts.events) == (len(came), n)
    assert library.lost in camera.summary()


def test_a_clock_that_restarts_twice_continues(library):
    """`Clock` states the rule; its tests are in test_clock.py."""
    times = [HOUR_US, *[0] * N, 900_000, 1_800_000, 2_700_000, *[0] * N]
    camera = library.opened(*(library.packet_of(events_of([t], [1], [2], [1])) for t in times))
    came = np.concatenate(read_until_unplugged(camera))
    assert (came["t"] - HOUR_US).tolist() == [0, 0, 900_000, 1_800_000, 2_700_000, 2_700_000]
    assert (camera.counts.jumped, camera.counts.clock_restarts) == (2 * (N - 1), 2)
    assert f"clock restarts: 2, jumps in time: {2 * (N - 1)}" in camera.summary()


def test_events_off_the_sensor_are_left_out(library):
    """neuromorphic-drivers has unsigned coordinates, dv-processing signed ones."""
    width, height = library.sensor
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


# -- neuromorphic-drivers alone --------------------------------------------------------------------------


def test_losses_are_counted(neuromorphic):
    packets = [neuromorphic.packet_of(random_events(9), overflows=overflows) for overflows in ([0, 4], [], [8])]
    camera = neuromorphic.opened(*packets)
    assert camera.summary() == "0 packets, 0 events (gaps: 0)"
    read_until_unplugged(camera)
    assert camera.summary() == "3 packets, 27 events (gaps: 3, raw packets dropped: 6, at most 11 waiting)"
    counts = camera.counts
    assert (counts.overflows, counts.dropped, counts.most_waiting) == (3, 6, 11)


# -- dv-processing alone ---------------------------------------------------------------------------------


def test_a_file_of_the_library_read_as_a_camera(dv, tmp_path):
    """Nothing is played: the library writes events, reads them and ends."""
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
