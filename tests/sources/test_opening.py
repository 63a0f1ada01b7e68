"""Which source a name opens, and what a user reads where none can be opened."""

import importlib.util

import pytest
from sources.made_devices import PanicException, PlayedDevice, drivers, found

from async_tnt.sources import DRIVERS, UdpSource, open_camera, open_recording, open_source, sample_recordings


def test_any_source_by_name():
    """A URL, a path, an array; and cameras below."""
    assert list(DRIVERS) == ["neuromorphic-drivers", "dv-processing"]
    with open_source("udp://127.0.0.1:0?format=spif", (34, 20)) as source:
        assert isinstance(source, UdpSource) and (source.format, source.sensor) == ("spif", (34, 20))
    path = sample_recordings()[3]
    recorded = open_recording(path).read().tobytes()
    for name in (path, str(path), open_recording(path).read()):
        assert b"".join(packet.tobytes() for packet in open_source(name)) == recorded
    assert open_source(path, (60, 48)).sensor == (60, 48)
    with pytest.raises(FileNotFoundError):
        open_source("gone.npy")


def davis():
    return found(PlayedDevice(sensor=(346, 260)), "iniVation DAVIS 346", ("davis346", "davis"), "00000042")


def evk4(device=None, serial="00050423", **known):
    return found(device or PlayedDevice(sensor=(1280, 720)), serial=serial, **known)


def missing():
    raise ModuleNotFoundError("No module named 'neuromorphic_drivers'")


def broken():
    raise ImportError("libusb.so.0: cannot open shared object file")


def poisoned():
    raise PanicException("poisoned")


ALL = drivers(evk4(), evk4(serial="00050424"), davis())
SEVERAL = {"a": missing, **drivers(name="b"), **drivers(davis(), name="c")}
BUSY = drivers(evk4(RuntimeError("already used by another program")), davis())


@pytest.mark.parametrize(
    ("name", "table", "opened"),
    [
        ("camera", ALL, "Prophesee EVK4 00050423 by played"),
        ("camera:EVK4:00050424", ALL, "Prophesee EVK4 00050424 by played"),
        ("camera:davis:00000042", ALL, "iniVation DAVIS 346 00000042 by played"),
        ("camera", SEVERAL, "iniVation DAVIS 346 00000042 by c"),  # the first library that has one
        ("camera", BUSY, "iniVation DAVIS 346 00000042 by played"),  # the first that opens
    ],
)
def test_a_name_selects_a_camera(name, table, opened):
    assert open_camera(name, drivers=table).name == opened


SHY = evk4(RuntimeError("device not found"), serial=None, problem="Access denied (insufficient permissions)")
UNKNOWN = r"a camera's name is camera, camera:KIND or camera:KIND:SERIAL, got '"


@pytest.mark.parametrize(
    ("name", "table", "error", "message"),
    [
        (
            "camera",
            {"a": missing, "b": missing},
            ImportError,
            r"camera: a is not installed; b is not installed: cameras need one of them, "
            r"pip install 'async_tnt\[cameras\]'$",
        ),
        ("camera", {"a": broken, **drivers()}, OSError, r"played found none; a cannot search: libusb[^;]*$"),
        (
            "camera:evk4:1",
            drivers(evk4()),
            OSError,
            r"^camera:evk4:1: no camera found; .* found Prophesee EVK4 00050423, which is another camera\. ",
        ),
        (
            "camera:evk4:00050423",
            drivers(SHY),
            OSError,
            r"^camera:evk4:00050423: cannot be opened; .* Prophesee EVK4 but cannot open it: Access denied \(insuf",
        ),
        ("camera", {"c": poisoned}, OSError, "c cannot search: poisoned"),
        ("camera", drivers(evk4(KeyboardInterrupt())), KeyboardInterrupt, "^$"),
        ("camera:evk9", {}, ValueError, "camera:evk9: no such kind of camera; known are davis, davis346, .*, evk4"),
        *((name, {}, ValueError, UNKNOWN) for name in ("camera:", "camera::1", "cameras")),
    ],
)
def test_what_a_user_reads(name, table, error, message):
    with pytest.raises(error, match=message):
        open_camera(name, drivers=table)


def test_the_installed_libraries_look_for_a_camera():
    """Each is named as missing, or has searched."""
    with pytest.raises((OSError, ImportError)) as caught:
        open_source("camera:evk3:no such serial")
    line = str(caught.value)
    assert line.startswith("camera:evk3:no such serial: ") and "\n" not in line
    for module, name in (("neuromorphic_drivers", "neuromorphic-drivers"), ("dv_processing", "dv-processing")):
        assert (f"{name} is not installed" in line) == (importlib.util.find_spec(module) is None)
