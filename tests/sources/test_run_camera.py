"""async-tnt run camera: the program from a camera's name to its last line, with a played camera."""

import json

import pytest
from sources.made_devices import PlayedDevice, drivers, found

from async_tnt.sources import DRIVERS, open_recording, sample_recordings

UNPLUGGED = RuntimeError("Usb(NoDevice)")


@pytest.fixture
def plug_in(monkeypatch):
    """Put a played camera in the place of both libraries' cameras."""

    def plug(*packets, sensor=(34, 34)):
        device = PlayedDevice(*packets, sensor=sensor)
        for name in list(DRIVERS):
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


def test_a_camera_of_another_size_is_refused(plug_in, program):
    device = plug_in(*three(), sensor=(346, 260))
    code, _, err = program("run", "camera")
    assert code == 2 and "346x260" in err and "34x34" in err and device.n_closed == 1
