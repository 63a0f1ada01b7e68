"""Events off the sensor are counted, and a listener that receives nothing else is warned."""

import logging
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from listening import free_port, wait_for_listener
from made import events_of, random_events

from async_tnt.sources.datagrams import Decoder, encode
from async_tnt.sources.udp import WARN_AFTER, UdpSource
from async_tnt.sources.udp_sender import UdpSender

SENSOR = (34, 20)
FORMATS = ("t64_x16_y16_on8", "t32_x16_y15_on1", "spif", "spif_t32")


def at_pixel(x, y, n):
    return events_of(np.arange(n), [x] * n, [y] * n, [1] * n)


@pytest.mark.parametrize("format", FORMATS)
def test_the_borders_by_hand(format):
    decoder = Decoder(format, SENSOR)
    events = events_of(range(6), [33, 34, 0, 33, 1280, 0], [19, 0, 20, 0, 720, 0], [1] * 6)
    decoded, malformed = decoder.decode(encode(events, format))
    assert decoded["x"].tolist() == [33, 33, 0] and malformed == decoder.malformed == decoder.off_sensor == 3
    nobody_knows = Decoder(format)
    assert len(nobody_knows.decode(encode(events, format)).events) == 6 and nobody_knows.off_sensor == 0


@given(
    kinds=st.lists(st.sampled_from(["good", "off", "polarity", "ahead", "off and ahead"]), max_size=40),
    cut=st.integers(0, 40),
)
def test_the_counts_add_up(kinds, cut):
    """An event is one thing: off the sensor, else too far ahead; in one datagram or two."""
    events = events_of(
        [5, *range(6, 6 + len(kinds))], [1] * (len(kinds) + 1), [2] * (len(kinds) + 1), [1] * (len(kinds) + 1)
    )
    for k, kind in enumerate(kinds, 1):
        if "off" in kind:
            events["y"][k] = 20
        if "ahead" in kind:
            events["t"][k] = 3_600_000_000
        if kind == "polarity":
            events["p"][k] = 2
    decoder = Decoder(sensor=SENSOR, max_jump_s=10)
    n_events = sum(len(decoder.decode(encode(part)).events) for part in (events[: 1 + cut], events[1 + cut :]))
    assert n_events == 1 + kinds.count("good")
    assert decoder.off_sensor == kinds.count("off") + kinds.count("off and ahead")
    assert decoder.clock.jumped == kinds.count("ahead")
    assert decoder.malformed == decoder.off_sensor + decoder.clock.jumped + kinds.count("polarity")


def test_the_summary_says_how_many_lie_off_the_sensor():
    with UdpSource(port=0, sensor=SENSOR, timeout_s=0.15) as source, UdpSender(port=source.port) as sender:
        sender.send(np.concatenate([at_pixel(34, 0, 4), at_pixel(0, 0, 3)]))
        assert sum(map(len, source)) == 3
        assert source.counts.off_sensor == source.counts.malformed == 4
        assert "3 events (4 malformed, 4 of them off the sensor, 0 out of order" in source.summary()


def warnings_of(caplog):
    return [r.getMessage() for r in caplog.records if r.name == "async_tnt.sources" and r.levelno == logging.WARNING]


def listen_to(*parts, format="t64_x16_y16_on8", sensor=SENSOR, sent_as=None):
    """Each part is read before the next one comes."""
    with (
        UdpSource(port=0, format=format, sensor=sensor, buffer_bytes=4096) as source,
        UdpSender(port=source.port, format=sent_as or format) as sender,
    ):
        for part in parts:
            for first in range(0, len(part), 100):
                sender.send(part[first : first + 100])
                while source.counts.datagrams < sender.datagrams:
                    source.receive(0)
        return source


def test_a_camera_that_is_larger_is_reported_once(caplog):
    source = listen_to(at_pixel(34, 0, WARN_AFTER - 1))
    assert warnings_of(caplog) == []  # one too few
    source = listen_to(at_pixel(34, 0, 3 * WARN_AFTER))
    assert warnings_of(caplog) == [
        f"udp://127.0.0.1:{source.port}: none of the first 1,000 events can be used; "
        "1,000 lie off 34x20 pixels: is the camera larger?"
    ]
    assert source.counts.off_sensor == 3 * WARN_AFTER


def test_another_format_is_reported_once(caplog):
    events = at_pixel(3, 4, 2500)
    listen_to(events, format="spif", sensor=None, sent_as="spif_t32")
    (warning,) = warnings_of(caplog)
    assert "events can be used; " in warning and "pixels" not in warning
    assert warning.endswith(" are not valid spif: does the sender use another (?format=...)?")


def test_both_reasons_are_reported(caplog):
    broken = at_pixel(3, 4, WARN_AFTER // 2)
    broken["p"] = 2
    listen_to(broken, at_pixel(0, 20, WARN_AFTER // 2))
    (warning,) = warnings_of(caplog)
    assert "500 lie off 34x20 pixels: is the camera larger? 500 are not valid t64_x16_y16_on8: does" in warning


def test_one_good_event_before_is_enough_to_say_nothing(caplog):
    source = listen_to(at_pixel(33, 19, 1), at_pixel(34, 0, 2 * WARN_AFTER))
    assert warnings_of(caplog) == [] and source.counts.off_sensor == 2 * WARN_AFTER


def test_the_program_reports_it_on_stderr():
    port = free_port()
    argv = [sys.executable, "-m", "async_tnt.cli", "run", f"udp://127.0.0.1:{port}?timeout_s=1"]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_for_listener(port)
        events = random_events(3000)
        events["x"] += 100
        with UdpSender(port=port) as sender:
            sender.send(events)
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    warnings = [line for line in err.splitlines() if "can be used" in line]
    assert len(warnings) == 1 and "lie off 34x34 pixels: is the camera larger?" in warnings[0]
    assert "0 events (3,000 malformed, 3,000 of them off the sensor" in err and "Traceback" not in err
    assert process.returncode == 0 and out == ""
