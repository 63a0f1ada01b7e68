"""A played camera, and `async-tnt run camera`.

The tests are about names, packets, counts, closing and cables.
"""

import importlib.util
import json
import threading
from contextlib import contextmanager
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from waiting import meanwhile, until

from async_tnt.sources import (
    BackgroundReader,
    UdpSource,
    open_camera,
    open_recording,
    open_source,
    sample_recordings,
)
from async_tnt.sources.live import cameras
from async_tnt.sources.live.camera_drivers import DRIVERS, CameraCounts, FoundCamera

HOUR_US = 3_600_000_000
# The record of an event in neuromorphic-drivers.
RECORD = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])


class PanicException(BaseException):
    """What libraries in Rust raise."""


UNPLUGGED = RuntimeError("Usb(NoDevice)")
"""What the library raises where the cable is pulled."""


def made_events(*times):
    events = np.zeros(len(times), RECORD)
    events["t"] = times
    events["x"] = range(len(times))
    return events


class PlayedDevice:
    """Hands out packets; raises those that are exceptions; then has nothing more.

    Like the real ones it breaks when two threads use it at a time.
    """

    time_field = "t"

    def __init__(self, *packets, sensor=(3400, 34), read_s=0.0):
        self.packets = list(packets)
        self.sensor = sensor
        self.read_s = read_s
        self.counts = CameraCounts()
        self.handle = object()
        self.settings = {"biases": {"diff_on": 3}}
        self.n_reads = 0
        self.n_closed = 0
        self._lock = threading.Lock()

    @contextmanager
    def _borrowed(self):
        assert self._lock.acquire(blocking=False), "Already borrowed"
        try:
            yield
        finally:
            self._lock.release()

    def read(self):
        with self._borrowed():
            assert not self.n_closed, "read after close"
            self.n_reads += 1
            if not self.packets:
                threading.Event().wait(self.read_s)
                return None
            packet = self.packets.pop(0)
            if isinstance(packet, BaseException):
                raise packet
            return packet

    def close(self):
        with self._borrowed():
            self.n_closed += 1


def found(device, model="Prophesee EVK4", kinds=("evk4",), serial="00050423", problem=None):
    def open_it():
        if isinstance(device, BaseException):
            raise device
        return device

    return FoundCamera(model, kinds, serial, open_it, problem)


def drivers(*cameras, name="played"):
    """A table for `open_camera(drivers=...)` whose library finds these cameras."""
    return {name: lambda: cameras}


def opened(*packets, **settings):
    """(a device that plays these, its camera)."""
    device = PlayedDevice(*packets, **settings)
    return device, open_camera(drivers=drivers(found(device)))


# -- which source a name opens ---------------------------------------------------------------------


def test_any_source_by_name():
    """A URL, a path, an array; and cameras below."""
    assert list(DRIVERS) == ["neuromorphic-drivers", "dv-processing"]
    with open_source("udp://127.0.0.1:0?format=spif", (34, 20)) as source:
        assert isinstance(source, UdpSource)
        assert (source.format, source.sensor) == (
            "spif",
            (34, 20),
        )
    path = sample_recordings()[3]
    recorded = open_recording(path).read().tobytes()
    for name in (path, str(path), open_recording(path).read()):
        assert b"".join(packet.tobytes() for packet in open_source(name)) == recorded
    assert open_source(path, (60, 48)).sensor == (60, 48)
    with pytest.raises(FileNotFoundError):
        open_source("gone.npy")


def davis():
    return found(
        PlayedDevice(sensor=(346, 260)), "iniVation DAVIS 346", ("davis346", "davis"), "00000042"
    )


def evk4(device=None, serial="00050423", **known):
    return found(device or PlayedDevice(sensor=(1280, 720)), serial=serial, **known)


def missing():
    raise ModuleNotFoundError("No module named 'neuromorphic_drivers'")


def poisoned():
    raise PanicException("libusb: cannot open")


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


SHY = evk4(
    RuntimeError("device not found"),
    serial=None,
    problem="Access denied (insufficient permissions)",
)
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
        (
            "camera",
            {"a": poisoned, **drivers()},
            OSError,
            r"played found none; a cannot search: libusb[^;]*$",
        ),
        (
            "camera",
            {"a": missing, **drivers(name="b"), **drivers(name="c")},
            OSError,
            r"^camera: no camera found; b and c found none; a is not installed\. Is it plugged in",
        ),
        (
            "camera:evk4:10.0.0.7:5",  # a serial number may have any characters
            drivers(evk4()),
            OSError,
            r"^camera:evk4:10.0.0.7:5: no camera found; .* which is another camera",
        ),
        (
            "camera:evk4:1",
            drivers(evk4()),
            OSError,
            r"^camera:evk4:1: no camera found; .* found Prophesee EVK4 00050423, which is another "
            r"camera\. ",
        ),
        (
            "camera:evk4:00050423",
            drivers(SHY),
            OSError,
            r"^camera:evk4:00050423: cannot be opened; .* Prophesee EVK4 but cannot open it: "
            r"Access denied \(insuf",
        ),
        ("camera", drivers(evk4(KeyboardInterrupt())), KeyboardInterrupt, "^$"),
        (
            "camera:evk9",
            {},
            ValueError,
            "camera:evk9: no such kind of camera; known are davis, davis346, .*, evk4",
        ),
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
    for module, name in (
        ("neuromorphic_drivers", "neuromorphic-drivers"),
        ("dv_processing", "dv-processing"),
    ):
        assert (f"{name} is not installed" in line) == (importlib.util.find_spec(module) is None)


# -- packets and the end ---------------------------------------------------------------------------


def test_close_from_another_thread_ends_the_loop():
    device, camera = opened(made_events(1), read_s=0.005)
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


def test_a_camera_that_fails_to_close_is_closed_and_said_to_have_failed(caplog):
    device, camera = opened(made_events(1))
    device.close = poisoned
    assert repr(camera).startswith("Camera(Prophesee EVK4 00050423 by played, open, CameraCounts(")
    camera.close()
    camera.close()
    assert camera.closed and camera.device is None and list(camera) == []
    assert repr(camera).startswith("Camera(Prophesee EVK4 00050423 by played, closed, ")
    (message,) = caplog.messages
    assert message == ("Prophesee EVK4 00050423 by played: closing it failed: libusb: cannot open")


# -- the cable -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("background", "error"),
    [(False, RuntimeError("Usb(NoDevice)")), (True, PanicException("Usb(NoDevice)\nat lib.rs:3"))],
)
def test_unplugged_after_the_packets_before(background, error):
    device, camera = opened(made_events(1, 2), None, made_events(3), error)
    came = []
    line = (
        r"^Prophesee EVK4 00050423 by played: the camera is gone after 3 events "
        r"\(Usb\(NoDevice\)\); check its cable and power, and open it again$"
    )
    with pytest.raises(OSError, match=line) as caught:
        # what came before the error stays
        came.extend(BackgroundReader(camera, copy=False) if background else camera)
    assert np.concatenate(came)["t"].tolist() == [1, 2, 3] and caught.value.__cause__ is error
    assert camera.closed and device.n_closed == 1
    assert list(camera) == [] and camera.counts.events == 3


# -- counts, and invalid events --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "told"),
    [
        ({}, "lost: unknown"),
        ({"overflows": 0}, "gaps: 0"),
        ({"dropped": 7}, "raw packets dropped: 7"),
        ({"overflows": 2, "dropped": 1_000}, "gaps: 2, raw packets dropped: 1,000"),
    ],
)
def test_a_loss_is_unknown_if_the_library_tells_none(counts, told):
    device, camera = opened(made_events(3))
    for name, number in counts.items():
        setattr(device.counts, name, number)
    next(iter(camera))
    assert camera.summary() == f"1 packets, 1 events ({told})"


def test_events_whose_time_jumps_are_left_out():
    """`Clock` states the rule; packets that hold nothing else do not come."""
    packets = [made_events(1, 1 << 63), made_events(HOUR_US), made_events(3)]
    _, camera = opened(*packets)
    came = list(islice(camera, 2))
    assert came[0]["t"].tolist() == [1] and came[1] is packets[2] and camera.counts.packets == 2
    assert camera.summary() == "2 packets, 2 events (jumps in time: 2, lost: unknown)"


def test_a_time_may_lie_a_second_ahead_by_the_cameras_clock_and_by_ours(monkeypatch):
    """Beyond the time that has passed here since."""
    now_us = [7_000_000]
    clock = SimpleNamespace(monotonic_ns=lambda: 1_000 * now_us[0])
    monkeypatch.setattr(cameras, "time", clock)
    _, camera = opened(
        made_events(5, 1_000_005, 2_000_006), made_events(12_000_005, 13_000_006), UNPLUGGED
    )
    packets = iter(camera)
    assert next(packets)["t"].tolist() == [5, 1_000_005]
    now_us[0] += 10_000_000
    assert next(packets)["t"].tolist() == [12_000_005]
    assert camera.counts.jumped == 2


def test_a_camera_that_starts_again_goes_on_and_its_counts_say_so():
    _, camera = opened(made_events(HOUR_US), *[made_events(k, 10 + k) for k in range(9)], UNPLUGGED)
    before = camera.counts
    times = [packet["t"].tolist() for packet in islice(camera, 3)]
    assert times == [[HOUR_US], [HOUR_US, HOUR_US + 10], [HOUR_US + 1, HOUR_US + 11]]
    assert (camera.counts.clock_restarts, before.clock_restarts, before.events) == (1, 0, 0)
    assert camera.summary() == (
        "3 packets, 5 events (clock restarts: 1, jumps in time: 14, lost: unknown)"
    )


def test_events_off_the_sensor_are_left_out_and_counted_once():
    """Events are off the sensor in x or in y, also with a time that jumps.

    A packet of nothing else does not come.
    """
    packets = [made_events(1, 2, 3, 1 << 63), made_events(4), made_events(5)]
    packets[0]["x"] = [0, 3, 2, 3]
    packets[1]["y"] = 4
    _, camera = opened(*packets, sensor=(3, 4))
    came = list(islice(camera, 2))
    assert [packet["t"].tolist() for packet in came] == [[1, 3], [5]]
    assert camera.summary() == "2 packets, 3 events (off the sensor: 3, lost: unknown)"


# -- async-tnt run camera --------------------------------------------------------------------------


@pytest.fixture
def plug_in(monkeypatch):
    """Put a played camera in the place of both libraries' cameras."""

    def plug(*packets, sensor=(34, 34)):
        device = PlayedDevice(*packets, sensor=sensor)
        for name in DRIVERS:
            monkeypatch.setitem(DRIVERS, name, lambda: [found(device)])
        return device

    return plug


def three():
    return list(open_recording(sample_recordings()[3], packet_events=250))


def labels(out):
    return [json.loads(line)["label"] for line in out.splitlines()]


@pytest.mark.parametrize(
    ("flags", "lost"),
    [([], "(lost: unknown); "), (["--keep-up", "60000"], "0 skipped to stay fresh")],
    ids=["read when it is due", "read in the background"],
)
def test_decisions_until_the_cable_is_pulled(flags, lost, plug_in, program):
    packets = three()
    n_events = sum(map(len, packets))
    device = plug_in(*packets, UNPLUGGED)
    code, out, err = program("run", "camera:evk4:00050423", "--json", *flags)
    assert code == 2 and labels(out) == ["3", "3", "3"]
    assert f"{len(packets):,} packets, {n_events:,} events" in err and lost in err
    last = err.splitlines()[-1]
    assert f"the camera is gone after {n_events:,} events (Usb(NoDevice)); check its cable" in last
    assert "Traceback" not in err and device.n_closed == 1


def test_ctrl_c_closes_the_camera(plug_in, program):
    device = plug_in(*three(), KeyboardInterrupt())
    code, out, _ = program("run", "camera", "--json")
    assert code == 130 and labels(out) == ["3", "3", "3"] and device.n_closed == 1
