"""What a UdpSource reports: its counts in one line, losses, and streams of unusable events."""

import logging
import socket
import sys

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources import NetworkCounts, UdpSender, UdpSource
from async_tnt.sources.udp import WARN_AFTER

EVENTS = random_events(2500, duration_us=50_000)
SENSOR = (34, 20)


def test_the_summary_is_one_line_of_what_was_counted():
    counts = NetworkCounts(2, 90, 1234, malformed=5, late=0, lost=6, jumped=3, off_sensor=1, clock_restarts=7)
    assert counts.summary() == (
        "2 datagrams, 1,234 events (5 malformed, 3 of them time jumps, 1 of them off the sensor, 0 out of order, "
        "datagrams lost: 6, clock restarts: 7)"
    )
    with UdpSource(port=0, sensor=SENSOR) as source, UdpSender(port=source.port) as sender:
        sender.send(events_of([5, 9, 2**62 - 1, 2**62 - 1, 8], [0, 1, 2, 34, 3], [0] * 5, [0] * 5))
        assert source.receive(60)["t"].tolist() == [5, 9, 8]
        counts = source.counts
        assert counts.summary().startswith("1 datagrams, 3 events (2 malformed, 1 of them time jumps, 1 of them off")
    assert source.counts == counts  # closed: they stay


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux counts what it drops")
def test_lost_datagrams_are_counted():
    with UdpSource(port=0, buffer_bytes=4096, timeout_s=0.15) as source:
        source._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with UdpSender(port=source.port) as sender:
            sender.send(EVENTS)  # 25 datagrams, where 4 have room
        list(source)
        counts = source.counts
        assert counts.lost > 0 and counts.datagrams > 0 and counts.datagrams + counts.lost == sender.datagrams
    assert source.counts == counts  # closed: they stay


# -- streams of unusable events --------------------------------------------------------------------------


def at_pixel(x, y, n):
    return events_of(np.arange(n), [x] * n, [y] * n, [1] * n)


def invalid(n):
    events = at_pixel(3, 4, n)
    events["p"] = 2
    return events


BOTH = [invalid(WARN_AFTER // 2), at_pixel(0, 20, WARN_AFTER // 2)]
LINE = (
    "none of the first 1,000 events can be used; 500 lie off 34x20 pixels: is the camera larger? 500 are not valid "
    "t64_x16_y16_on8: does the sender use another (?format=...)?"
)


@pytest.mark.parametrize(("parts", "warning"), [(BOTH * 2, LINE), ([at_pixel(33, 19, 1), *BOTH], None)])
def test_a_stream_without_one_good_event_is_reported_once(parts, warning, caplog):
    with UdpSource(port=0, sensor=SENSOR) as source, socket.socket(type=socket.SOCK_DGRAM) as sender:
        n_sent = 0
        for part in parts:
            for first in range(0, len(part), 100):
                sender.sendto(part[first : first + 100].tobytes(), (source.address, source.port))
                n_sent += 1
                while source.counts.datagrams < n_sent:
                    source.receive(0)
    warnings = [r.getMessage() for r in caplog.records if r.name == "async_tnt.sources" and r.levelno > logging.INFO]
    warnings = [line for line in warnings if "waiting datagrams" not in line]  # a system may give little room
    assert warnings == ([f"udp://127.0.0.1:{source.port}: {warning}"] if warning else [])
