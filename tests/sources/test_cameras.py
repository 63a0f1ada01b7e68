"""A played camera from its opening to its end: packets, counts, closing, cables; and `async-tnt run camera`."""

import json
from itertools import islice

import numpy as np
import pytest
from sources.made_devices import PanicException, PlayedDevice, drivers, found, made_events, opened
from waiting import meanwhile, until

from async_tnt.sources import DRIVERS, BackgroundReader, open_recording, sample_recordings

HOUR_US = 3_600_000_000


@pytest.mark.parametrize(("pause_s", "read_s"), [(0.0, 0.005), (0.001, 0.0), (3600.0, 0.0)])
def test_close_from_another_thread_ends_the_loop(pause_s, read_s):
    device, camera = opened(made_events(1), pause_s=pause_s, read_s=read_s)
    with meanwhile(list, camera):
        until(lambda: device.n_reads >= 2)
        camera.close()
        assert device.n_closed == 1  # now, not when the reader comes round
    assert camera.closed and camera.device is None and camera.counts.events == 1


def test_a_loop_may_be_left_and_resumed_until_the_camera_is_closed():
    device, camera = opened(*(made_events(k) for k in range(5)))
    with camera as same:
        assert same is camera and camera.device is device.handle and not camera.closed
        assert next(iter(camera))["t"].tolist() == [0]
        for packet in camera:
            if packet["t"] == [2]:
                camera.close()
        assert packet["t"] == [2] and camera.counts.packets == 3
    assert list(camera) == [] and camera.closed and device.n_closed == 1


# -- the cable -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("background", "error"),
    [(False, RuntimeError("Usb(NoDevice)")), (True, PanicException("Usb(NoDevice)\nat lib.rs:3"))],
)
def test_unplugged_after_the_packets_before(background, error):
    device, camera = opened(made_events(1, 2), None, made_events(3), error)
    came = []
    line = (
        r"^Prophesee EVK4 00050423 by played: the camera is gone after 3 events \(Usb\(NoDevice\)\); "
        r"check its cable and power, and open it again$"
    )
    with pytest.raises(OSError, match=line) as caught:
        came.extend(BackgroundReader(camera, copy=False) if background else camera)  # what came before the error stays
    assert np.concatenate(came)["t"].tolist() == [1, 2, 3] and caught.value.__cause__ is error
    assert camera.closed and device.n_closed == 1
    assert list(camera) == [] and camera.counts.events == 3


# -- counts, and invalid events --------------------------------------------------------------------------


def test_events_whose_time_jumps_are_left_out():
    """`Clock` states the rule; packets that hold nothing else do not come."""
    packets = [made_events(1, 1 << 63), made_events(HOUR_US), made_events(3)]
    _, camera = opened(*packets)
    came = list(islice(camera, 2))
    assert came[0]["t"].tolist() == [1] and came[1] is packets[2] and camera.counts.packets == 2
    assert camera.summary() == "2 packets, 2 events (jumps in time: 2, lost: unknown)"


# -- async-tnt run camera --------------------------------------------------------------------------------

UNPLUGGED = RuntimeError("Usb(NoDevice)")


@pytest.fixture
def plug_in(monkeypatch):
    """Put a played camera in the place of both libraries' cameras."""

    def plug(*packets, sensor=(34, 34)):
        device = PlayedDevice(*packets, sensor=sensor)
        for name in reversed(list(DRIVERS)):  # which puts them back in their order
            monkeypatch.delitem(DRIVERS, name)
        monkeypatch.setitem(DRIVERS, "played", drivers(found(device))["played"])
        return device

    return plug


def three():
    return list(open_recording(sample_recordings()[3], packet_events=250))


def labels(out):
    return [json.loads(line)["label"] for line in out.splitlines()]


@pytest.mark.parametrize(
    ("flags", "lost"),
    [([], "(lost: unknown); "), (["--latest", "1000"], "0 skipped to stay fresh")],
    ids=["read when it is due", "read in the background"],
)
def test_decisions_until_the_cable_is_pulled(flags, lost, plug_in, program):
    packets = three()
    n_events = sum(map(len, packets))
    device = plug_in(*packets, UNPLUGGED)
    code, out, err = program("run", "camera:evk4:00050423", "--json", *flags)
    assert code == 2 and labels(out) == ["3", "3", "3"]
    assert f"{len(packets):,} packets, {n_events:,} events" in err and lost in err
    assert f"the camera is gone after {n_events:,} events (Usb(NoDevice)); check its cable" in err.splitlines()[-1]
    assert "Traceback" not in err and device.n_closed == 1


def test_ctrl_c_closes_the_camera(plug_in, program):
    device = plug_in(*three(), KeyboardInterrupt())
    code, out, _ = program("run", "camera", "--json")
    assert code == 130 and labels(out) == ["3", "3", "3"] and device.n_closed == 1
