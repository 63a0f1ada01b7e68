"""async-tnt run camera: the program from a camera's name to its last line, with a played camera."""

import json

import pytest
from cameras.made_devices import PlayedDevice, drivers, found

from async_tnt.cli import main
from async_tnt.sources.cameras import DRIVERS
from async_tnt.sources.files.recording import open_recording, sample_recordings


@pytest.fixture
def plug_in(monkeypatch):
    """Put a played camera in the place of both libraries' cameras."""

    def plug(*packets, sensor=(34, 34)):
        device = PlayedDevice(packets, sensor)
        for name in list(DRIVERS):
            monkeypatch.delitem(DRIVERS, name)
        for name, make in drivers(found(device)).items():
            monkeypatch.setitem(DRIVERS, name, make)
        return device

    return plug


UNPLUGGED = RuntimeError("Usb(NoDevice)")


def three():
    return list(open_recording(sample_recordings()[3], packet_events=250))


def test_decisions_until_the_cable_is_pulled(plug_in, capsys):
    packets = three()
    n_events = sum(map(len, packets))
    device = plug_in(*packets, UNPLUGGED)
    assert main(["run", "camera:evk4:00050423", "--json"]) == 2
    out, err = capsys.readouterr()
    assert [json.loads(line)["label"] for line in out.splitlines()] == ["3", "3", "3"]
    lines = err.splitlines()
    assert any(f"{len(packets):,} packets, {n_events:,} events (lost: unknown); " in line for line in lines)
    assert f"the camera is gone after {n_events:,} events (Usb(NoDevice)); check its cable" in lines[-1]
    assert "Traceback" not in err and device.n_closed == 1


def test_ctrl_c_closes_the_camera(plug_in, capsys):
    device = plug_in(*three(), KeyboardInterrupt())
    assert main(["run", "camera", "--json"]) == 130
    assert len(capsys.readouterr().out.splitlines()) == 3 and device.n_closed == 1


def test_latest_reads_in_the_background(plug_in, capsys):
    device = plug_in(*three(), UNPLUGGED)
    assert main(["run", "camera", "--latest", "1000", "--json"]) == 2
    out, err = capsys.readouterr()
    assert [json.loads(line)["label"] for line in out.splitlines()] == ["3", "3", "3"]
    assert "0 skipped to stay fresh" in err and device.n_closed == 1


def test_a_part_of_a_larger_camera(plug_in, capsys):
    packets = three()
    for packet in packets:
        packet["x"] += 100
        packet["y"] += 50
    plug_in(*packets, UNPLUGGED, sensor=(346, 260))
    assert main(["run", "camera", "--roi", "100,50,34,34", "--crop", "--json"]) == 2
    assert [json.loads(line)["label"] for line in capsys.readouterr().out.splitlines()] == ["3", "3", "3"]


def test_a_camera_of_another_size_is_refused(plug_in, capsys):
    device = plug_in(*three(), sensor=(346, 260))
    assert main(["run", "camera"]) == 2
    err = capsys.readouterr().err
    assert "346x260" in err and "34x34" in err
    assert device.n_closed == 1


def test_no_camera(plug_in, monkeypatch, capsys):
    plug_in()
    monkeypatch.setitem(DRIVERS, "played", drivers()["played"])
    assert main(["run", "camera"]) == 2
    assert "camera: no camera found; played 1.0 looked. Is it plugged in" in capsys.readouterr().err
