"""Which camera a name opens, and what a user reads where none can be opened."""

import importlib.util
import sys

import pytest
from cameras.made_devices import PlayedDevice, PlayedDriver, drivers, found

from async_tnt.sources.camera_drivers import ALL_KINDS
from async_tnt.sources.cameras import DRIVERS, open_camera
from async_tnt.sources.opening import open_source

HAVE_ND = importlib.util.find_spec("neuromorphic_drivers") is not None
HAVE_DV = importlib.util.find_spec("dv_processing") is not None


def missing(name="neuromorphic_drivers"):
    def make():
        raise ModuleNotFoundError(f"No module named '{name}'")

    return make


def davis(device=None, serial="00000042", **known):
    return found(device or PlayedDevice([], (346, 260)), "iniVation DAVIS 346", ("davis346", "davis"), serial, **known)


def evk4(device=None, serial="00050423", **known):
    return found(device or PlayedDevice([], (1280, 720)), serial=serial, **known)


@pytest.mark.parametrize(
    ("name", "opened"),
    [
        ("camera", "Prophesee EVK4 00050423"),
        ("camera:evk4", "Prophesee EVK4 00050423"),
        ("camera:EVK4:00050424", "Prophesee EVK4 00050424"),
        ("camera:davis346", "iniVation DAVIS 346 00000042"),
        ("camera:davis", "iniVation DAVIS 346 00000042"),
        ("camera:davis:00000042", "iniVation DAVIS 346 00000042"),
    ],
)
def test_a_name_says_which_camera(name, opened):
    table = drivers(evk4(), evk4(serial="00050424"), davis())
    with open_camera(name, drivers=table) as camera:
        assert camera.name == f"{opened} by played 1.0"
        assert camera.sensor == ((346, 260) if "DAVIS" in opened else (1280, 720))


def test_the_first_library_that_has_one_is_used():
    table = {
        "a": missing(),
        "b": lambda: PlayedDriver([], "b 1"),
        **drivers(davis(), name="c"),
        **drivers(evk4(), name="d"),
    }
    assert open_camera("camera", drivers=table).name.endswith("by c 1.0")
    assert open_camera("camera:evk4", drivers=table).name.endswith("by d 1.0")


def test_one_that_does_not_open_is_passed_over():
    busy = evk4(RuntimeError("the device is already used by another program"))
    with open_camera("camera", drivers=drivers(busy, davis())) as camera:
        assert camera.sensor == (346, 260)


def test_a_small_davis_is_no_davis346():
    small = PlayedDevice([], (240, 180))
    with pytest.raises(OSError, match=r"no camera found; .* found iniVation DAVIS 346 7, which has 240x180 pixels"):
        open_camera("camera:davis346", drivers=drivers(davis(small, "7")))
    assert small.n_closed == 1
    with open_camera("camera:davis", drivers=drivers(davis(PlayedDevice([], (240, 180))))) as camera:
        assert camera.sensor == (240, 180)


def test_no_library():
    line = r"camera: cameras are read by a or b, which are missing: pip install '\.\[cameras\]'$"
    with pytest.raises(ImportError, match=line):
        open_camera(drivers={"a": missing(), "b": missing()})


def test_a_library_that_does_not_load_says_why():
    def broken():
        raise ImportError("libusb.so.0: cannot open shared object file")

    with pytest.raises(ImportError, match=r"'\.\[cameras\]' \(a does not load: libusb\.so\.0: cannot open"):
        open_camera(drivers={"a": broken})
    with pytest.raises(OSError, match=r"played 1\.0 looked; a does not load: libusb[^;]*$"):
        open_camera(drivers={"a": broken, **drivers()})


def test_no_camera(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    table = {"a": missing(), **drivers(name="b"), "c": lambda: PlayedDriver(RuntimeError("Other error"), "c 2")}
    with pytest.raises(OSError) as caught:
        open_camera("camera", drivers=table)
    assert str(caught.value) == (
        "camera: no camera found; b 1.0 looked; c 2 cannot look: Other error (no USB here?); a: not installed. "
        "Is it plugged in, and used by no other program? Does lsusb show it, and do udev rules let users read it "
        "(neuromorphic-drivers-install-udev-rules)?"
    )
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(OSError, match=r"no camera found; b 1\.0 looked\. Is it plugged in, .* program\?$"):
        open_camera("camera", drivers=drivers(name="b"))


def test_another_camera_than_the_one_meant():
    with pytest.raises(
        OSError, match=r"camera:evk4:1: no camera found; .* found Prophesee EVK4 00050423, which is another"
    ):
        open_camera("camera:evk4:1", drivers=drivers(evk4()))


def test_a_camera_that_may_not_be_read():
    shy = evk4(RuntimeError("device not found"), serial=None, problem="Access denied (insufficient permissions)")
    line = r"camera:evk4:00050423: cannot be opened; .* found Prophesee EVK4 but cannot open it: Access denied \(insuf"
    with pytest.raises(OSError, match=line):
        open_camera("camera:evk4:00050423", drivers=drivers(shy))


def test_a_panic_is_a_failure_and_ctrl_c_is_none():
    class PanicException(BaseException):  # what libraries in Rust raise
        pass

    with pytest.raises(OSError, match=r"cannot open it: index out of bounds"):
        open_camera(drivers=drivers(evk4(PanicException("index out of bounds"))))
    with pytest.raises(OSError, match=r"cannot look: poisoned"):
        open_camera(drivers={"a": lambda: PlayedDriver(PanicException("poisoned"))})
    with pytest.raises(KeyboardInterrupt):
        open_camera(drivers=drivers(evk4(KeyboardInterrupt())))


@pytest.mark.parametrize("name", ["camera:", "camera:evk4:", "camera::1", "cameras", "evk4"])
def test_no_name_of_a_camera(name):
    with pytest.raises(ValueError, match=r"is camera, camera:KIND or camera:KIND:SERIAL, got '"):
        open_camera(name, drivers=drivers(evk4()))


def test_no_such_kind():
    with pytest.raises(ValueError, match=r"camera:evk9: no such kind of camera; known are davis, davis346, .*, evk4"):
        open_camera("camera:evk9", drivers={})


def test_each_library_answers_to_its_kinds():
    assert {"evk3", "evk4", "davis346", "dvxplorer", "dvs128"} <= set(ALL_KINDS)
    assert list(DRIVERS) == ["neuromorphic-drivers", "dv-processing"]


@pytest.mark.skipif(HAVE_ND or HAVE_DV, reason="a library of the extra `cameras` is installed")
def test_camera_without_the_extra():
    with pytest.raises(ImportError, match=r"by neuromorphic-drivers or dv-processing, .*: pip install '\.\[cameras\]'"):
        open_source("camera")


@pytest.mark.skipif(not (HAVE_ND or HAVE_DV), reason="no library of the extra `cameras` is installed")
def test_camera_with_the_extra_and_no_camera():
    try:
        source = open_source("camera:evk3:no such serial")
    except OSError as error:
        line = str(error)
    else:
        source.close()
        pytest.fail("a camera with this serial number")
    assert line.startswith("camera:evk3:no such serial: ") and "\n" not in line
    assert ("neuromorphic-drivers 0" in line) == HAVE_ND and ("dv-processing 2" in line) == HAVE_DV


def test_one_library_is_enough(monkeypatch):
    """Whatever is installed: the other one is not found."""
    monkeypatch.setitem(sys.modules, "neuromorphic_drivers", None)
    with pytest.raises((OSError, ImportError)) as caught:
        open_source("camera:evk3:no such serial")
    if HAVE_DV:
        assert caught.type is OSError and "neuromorphic-drivers: not installed" in str(caught.value)
    else:
        assert caught.type is ImportError
