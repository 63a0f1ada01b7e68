"""A camera from its opening to its end: packets, counts, closing and cables."""

import threading
import time
from itertools import islice

import numpy as np
import pytest
from cameras.made_devices import RECORD, PlayedDevice, drivers, found, made_events

import async_tnt
from async_tnt.kernels.clock import AGREEING_PACKETS
from async_tnt.sources.background_reader import BackgroundReader
from async_tnt.sources.cameras import open_camera
from async_tnt.sources.files.recording import open_recording, sample_recordings


def opened(packets, **how):
    device = PlayedDevice(packets, **how)
    return device, open_camera(drivers=drivers(found(device)))


def closed_soon(camera, after_s=0.05):
    """Close from another thread, in a moment."""
    timer = threading.Timer(after_s, camera.close)
    timer.start()
    return timer


def test_packets_come_uncopied_and_empty_ones_do_not():
    packets = [made_events([1, 2]), None, made_events([]), made_events([3])]
    _, camera = opened(packets)
    closed_soon(camera)
    came = list(camera)
    assert [packet is made for packet, made in zip(came, (packets[0], packets[3]), strict=True)] == [True, True]
    assert (camera.counts.packets, camera.counts.events) == (2, 3)


@pytest.mark.parametrize(("pause_s", "read_s"), [(0.0, 0.005), (0.001, 0.0), (30.0, 0.0)])
def test_close_from_another_thread_ends_the_loop(pause_s, read_s):
    device, camera = opened([made_events([1])], pause_s=pause_s, read_s=read_s)
    timer = closed_soon(camera)
    assert len(list(camera)) == 1
    timer.join()
    assert camera.closed and device.n_closed == 1 and camera.device is None


def test_close_returns_when_the_camera_is_let_go():
    device, camera = opened([], read_s=0.05)
    reader = threading.Thread(target=lambda: list(camera))
    reader.start()
    while device.n_reads == 0:
        time.sleep(0.001)
    camera.close()
    assert device.n_closed == 1  # now, not when the reader comes round
    reader.join(5)
    assert not reader.is_alive()


def test_many_threads_may_close():
    for _ in range(20):
        device, camera = opened([made_events([k]) for k in range(1000)])
        closers = [threading.Thread(target=camera.close) for _ in range(4)]
        reader = threading.Thread(target=lambda camera=camera: list(camera))
        for thread in (reader, *closers):
            thread.start()
        for thread in (reader, *closers):
            thread.join(10)
        assert device.n_closed == 1 and not reader.is_alive()
        assert camera.counts.events == 1000 - len(device.packets)


def test_closing_while_a_packet_is_used():
    device, camera = opened([made_events([k]) for k in range(5)])
    for n, _ in enumerate(camera):
        if n == 1:
            camera.close()
    assert n == 1 and device.n_closed == 1 and camera.counts.packets == 2
    assert list(camera) == []


def test_a_loop_may_be_left_and_taken_up():
    _, camera = opened([made_events([k]) for k in range(3)])
    assert next(iter(camera))["t"].tolist() == [0]
    assert next(iter(camera))["t"].tolist() == [1]


def test_with_closes():
    device, camera = opened([])
    with camera as same:
        assert same is camera and camera.device is device.handle and not camera.closed
    assert device.n_closed == 1 and camera.closed
    camera.close()
    assert device.n_closed == 1


def test_unplugged_after_the_packets_before():
    device, camera = opened([made_events([1, 2]), None, made_events([3]), RuntimeError("Usb(NoDevice)")])
    came = []
    line = (
        r"^Prophesee EVK4 00050423 by played 1\.0: the camera is gone after 3 events \(Usb\(NoDevice\)\); "
        r"check its cable and power, and open it again$"
    )
    with pytest.raises(OSError, match=line) as caught:
        came.extend(camera)  # what came before the error stays
    assert np.concatenate(came)["t"].tolist() == [1, 2, 3]
    assert isinstance(caught.value.__cause__, RuntimeError)
    assert camera.closed and device.n_closed == 1
    assert list(camera) == [] and camera.counts.events == 3


def test_unplugged_inside_a_background_reader():
    _, camera = opened([made_events([1, 2]), OSError("gone")])
    came = []
    with (
        pytest.raises(OSError, match=r"is gone after 2 events \(gone\)"),
        BackgroundReader(camera, copy=False, on_close=camera.close) as reader,
    ):
        came.extend(reader)
    assert np.concatenate(came)["t"].tolist() == [1, 2]


def test_a_device_that_cannot_even_be_closed(caplog):
    device, camera = opened([RuntimeError("Usb(Pipe)")])

    def close():
        raise RuntimeError("Usb(NoDevice)")

    device.close = close
    with pytest.raises(OSError, match=r"Usb\(Pipe\)"):
        list(camera)
    assert "closing it failed: Usb(NoDevice)" in caplog.text


def test_panics_are_failures_and_ctrl_c_is_none():
    class PanicException(BaseException):
        pass

    _, camera = opened([PanicException("the ring lock is not poisoned")])
    with pytest.raises(OSError, match=r"the ring lock is not poisoned"):
        list(camera)
    device, camera = opened([KeyboardInterrupt(), made_events([1])])
    with pytest.raises(KeyboardInterrupt):
        list(camera)
    assert not camera.closed and device.n_closed == 0
    assert next(iter(camera))["t"].tolist() == [1]


def test_a_background_reader_closes_a_silent_camera():
    device, camera = opened([], pause_s=0.001)
    reader = BackgroundReader(camera, latest=True, on_close=camera.close)
    while device.n_reads == 0:
        time.sleep(0.001)
    assert reader.close(5) and device.n_closed == 1


def test_a_silent_camera_does_not_burn_a_core():
    device, camera = opened([], pause_s=0.01)
    closed_soon(camera, 0.2)
    assert list(camera) == []
    assert device.n_reads < 40  # 20 and few


def test_summary_and_counts():
    device, camera = opened([made_events(range(1500)), made_events([2_000])])
    assert camera.summary() == "0 packets, 0 events (lost: unknown)"
    next(iter(camera))
    assert camera.summary() == "1 packets, 1,500 events (lost: unknown)"
    device.losses.overflows, device.losses.dropped, device.losses.most_waiting = 2, 1234, 17
    next(iter(camera))
    camera.close()
    assert camera.summary() == "2 packets, 1,501 events (gaps: 2, raw packets dropped: 1,234, at most 17 waiting)"
    assert camera.counts.overflows == 2 and camera.counts.dropped == 1234 and camera.counts.most_waiting == 17
    assert repr(camera).startswith("Camera(Prophesee EVK4 00050423 by played 1.0, closed, CameraCounts(packets=2, ")


def test_events_beside_the_sensor_are_left_out_and_counted():
    """Unsigned beyond its end, as neuromorphic-drivers has them, and signed below 0, as dv-processing has."""
    packets = [made_events(range(4)), made_events([9]), made_events([10])]
    packets[0]["x"], packets[0]["y"] = [34, 33, 0, 5], [0, 33, 34, 0]
    packets[1]["x"] = 40_000
    signed = np.dtype([("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("on", "?")])
    below = np.array([(20, -1, 3, 1), (21, 3, -1, 0), (22, 33, 33, 0)], signed)
    _, camera = opened([*packets, below, RuntimeError()])
    came = []
    with pytest.raises(OSError, match="is gone after 4 events"):
        came.extend(camera)
    assert [packet["t"].tolist() for packet in came] == [[1, 3], [10], [22]]
    assert came[1] is packets[2]
    assert camera.counts.off_sensor == 5 and camera.counts.packets == 3
    assert camera.summary() == "3 packets, 4 events (off the sensor: 5, lost: unknown)"


@pytest.mark.parametrize("field", ["x", "y"])
def test_the_first_pixel_beside_the_sensor(field):
    inside, beside = made_events([1, 2]), made_events([3])
    inside[field], beside[field] = [33, 0], 34
    _, camera = opened([inside, beside, made_events([4])])
    assert [packet["t"].tolist() for packet in islice(camera, 2)] == [[1, 2], [4]]
    assert camera.counts.off_sensor == 1


def as_camera(events):
    """Events of ours as neuromorphic-drivers has them."""
    packet = np.empty(len(events), RECORD)
    for field, name in (("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")):
        packet[field] = events[name]
    return packet


def decided(packets):
    """What a processor decides of a camera's packets, and the counts of both."""
    processor = async_tnt.Processor(async_tnt.load_model("digits"))
    _, camera = opened([*(packet.copy() for packet in packets), RuntimeError()])
    decisions = []
    with pytest.raises(OSError, match="is gone"):
        for packet in camera:
            decisions += processor.push(packet)
    decisions += processor.finish()
    keys = [(decision.label, decision.window_start_us, decision.logits.tobytes()) for decision in decisions]
    return keys, camera, processor.counts


def test_decisions_of_a_camera_whose_clock_restarts():
    """But for the packets until it is believed, every event is decided on, and times never fall back."""
    window_us = async_tnt.load_model("digits").config.window_us
    first = made_events(np.arange(0, 3 * window_us, 200) + 7_000_000, seed=1)
    second = np.array_split(made_events(np.arange(0, 3 * window_us, 200), seed=2), 50)
    decisions, camera, processor = decided([first, *second])
    n_dropped = sum(map(len, second[: AGREEING_PACKETS - 1]))
    assert camera.counts.jumped == n_dropped and processor.dropped_late == 0
    assert processor.received == len(first) + sum(map(len, second)) - n_dropped == camera.counts.events
    starts = [start for _, start, _ in decisions]
    assert len(starts) == 6 and starts == sorted(set(starts))
    assert camera.counts.clock_restarts == 1
    assert f"clock restarts: 1, jumps in time: {n_dropped}" in camera.summary().replace(", lost", "")


@pytest.mark.parametrize("bit", [21, 30, 52, 63])
@pytest.mark.parametrize("number", [0, 3, 19])
@pytest.mark.parametrize("place", [0, 10, -1])
def test_one_garbled_time_costs_its_event_and_no_more(number, place, bit):
    """In the first packet, a middle one and the last, wherever in it, and whichever bit flipped."""
    events = as_camera(open_recording(sample_recordings()[3]).read())
    packets = np.array_split(events, 20)
    without = list(packets)
    without[number] = np.delete(packets[number], place)
    expected, _, _ = decided(without)
    packets[number]["t"][place] |= np.uint64(1 << bit)
    decisions, camera, processor = decided(packets)
    assert decisions == expected and len(decisions) == 3
    assert (camera.counts.jumped, camera.counts.clock_restarts) == (1, 0)
    assert camera.counts.events == processor.received == len(events) - 1


def test_a_packet_of_garbled_times_alone_does_not_come():
    packets = [made_events([1, 1 << 63]), made_events([1 << 60]), made_events([3])]
    _, camera = opened(packets)
    came = list(islice(camera, 2))
    assert came[0]["t"].tolist() == [1] and came[1] is packets[2] and camera.counts.packets == 2
    assert camera.summary() == "2 packets, 2 events (jumps in time: 2, lost: unknown)"
