"""UdpSource on loopback: packets, the ways to iterate and to end it, counts, names."""

import inspect
import random
import re
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from listening import free_port, send
from made import events_of, random_events

from async_tnt.sources import UdpSource, encode, open_udp
from async_tnt.sources.live.datagrams import EVENT_BYTES, Decoder
from async_tnt.sources.live.udp import WARN_AFTER, NetworkCounts

EVENTS = random_events(2500, duration_us=50_000)
SENSOR = (34, 20)
SILENCE_S = 0.1


def listening(**settings):
    return UdpSource(port=0, **{"timeout_s": SILENCE_S, **settings})


# -- packets ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", EVENT_BYTES)
def test_what_comes_is_what_a_decoder_makes_of_the_datagrams(format):
    """Good events, cut ones, random bytes, and more than any good datagram holds."""
    rng = np.random.default_rng(1)
    datagrams = [b"\xff" * 65_507]
    for k in range(100):
        good = encode(EVENTS[k : k + 9], format)
        datagrams += [good[: len(good) - k % 3], rng.bytes(int(rng.integers(0, 300)))]
    decoder = Decoder(format, (34, 34))
    got = []
    with (
        listening(format=format, sensor=(34, 34), max_jump_s=None) as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        for k, datagram in enumerate(datagrams):
            sock.sendto(datagram, ("127.0.0.1", source.port))
            while k % 20 == 0 and source.counts.datagrams <= k:
                got.append(source.receive(0))
        counts = source.counts
    got = np.concatenate([packet for packet in got if packet is not None])
    expected = np.concatenate([decoder.decode(datagram) for datagram in datagrams])
    # `spif` has the time of arrival
    fields = ["x", "y", "p"] if format == "spif" else ["t", "x", "y", "p"]
    assert got[fields].tolist() == expected[fields].tolist() and len(got) > 100
    assert counts.datagrams == 201
    assert counts.bytes == sum(map(len, datagrams))
    assert counts.events == len(got)
    assert (counts.malformed, counts.off_sensor) == (decoder.malformed, decoder.off_sensor)
    assert format == "spif" or counts.late == decoder.clock.late


def test_many_datagrams_become_one_packet_up_to_the_limit(monkeypatch):
    monkeypatch.setattr("async_tnt.sources.live.udp.MAX_DATAGRAMS", 8)
    source = listening(sensor=(34, 34))
    assert send(source.port, EVENTS[:2000]) == 20
    packets = list(source)
    source.close()
    assert [len(packet) for packet in packets] == [800, 800, 400]
    # none was overwritten by the next
    assert np.concatenate(packets).tobytes() == EVENTS[:2000].tobytes()
    assert source.counts == NetworkCounts(20, 13 * 2000, 2000, malformed=0, late=0)


def test_a_full_memory_ends_a_packet_and_cuts_no_datagram_off(monkeypatch):
    """It has room for two of the datagrams, and a third might be longer than what is left."""
    monkeypatch.setattr("async_tnt.sources.live.udp.ROOM", 1300)
    monkeypatch.setattr("async_tnt.sources.live.udp.BATCH_BYTES", 3000)
    source = listening(sensor=(34, 34))
    assert send(source.port, EVENTS[:500]) == 5  # of 1300 bytes
    packets = list(source)
    source.close()
    assert [len(packet) for packet in packets] == [200, 200, 100]
    assert np.concatenate(packets).tobytes() == EVENTS[:500].tobytes()
    assert source.counts.malformed == 0


def test_the_datagram_that_ends_a_wait_is_a_packet_of_its_own():
    """It is handed on at once; what has come with it is the next packet."""
    with listening(sensor=(34, 34)) as source:
        selector = source._selector
        source._selector = SimpleNamespace(
            select=lambda left_s: send(source.port, EVENTS[:300]), close=selector.close
        )
        got = [source.receive(60), source.receive(0)]
    assert [len(packet) for packet in got] == [100, 200]


# -- waiting, and the end --------------------------------------------------------------------------


def test_closed_by_a_thread_at_any_moment():
    """No hang, no error, and the socket is closed."""
    chance = random.Random(0)
    for _ in range(50):
        source = UdpSource(port=0, buffer_bytes=4096)
        closing = threading.Timer(chance.random() * 1e-3, source.close)
        closing.start()
        assert list(source) == []
        closing.join()
        assert source._socket.fileno() == -1 and source.receive(0) is None and source.closed


def test_silence_ends_a_loop_and_a_loop_may_close_its_source():
    source = listening()
    for ends in (True, False):
        sending = threading.Timer(0.01, send, [source.port, EVENTS[:100]])
        sending.start()
        for packet in source:
            assert packet.tobytes() == EVENTS[:100].tobytes()
            if not ends:
                source.close()
        sending.join()
    assert source.closed and source.counts.events == 200


# -- counts ----------------------------------------------------------------------------------------


def test_the_summary_is_one_line_of_what_was_counted():
    with UdpSource(port=0, sensor=SENSOR) as source:
        send(
            source.port,
            events_of([5, 9, 2**62 - 1, 2**62 - 1, 8], [0, 1, 2, 34, 3], [0] * 5, [0] * 5),
        )
        assert source.receive(60)["t"].tolist() == [5, 9, 8]
        counts = source.counts
    assert counts == NetworkCounts(1, 65, 3, malformed=2, late=1, jumped=1, off_sensor=1)
    assert source.counts == counts
    assert source.summary() == (
        "1 datagrams, 3 events (2 malformed, 1 of them time jumps, 1 of them off the sensor, 1 out "
        "of order)"
    )


def test_a_sender_that_starts_again_is_counted():
    """Eight datagrams agree that its clock moved back."""
    with UdpSource(port=0) as source:
        for k in range(9):
            send(source.port, events_of([60_000_000 if k == 0 else k], [0], [0], [0]))
        times = []
        while len(times) < 2:
            times += source.receive(60)["t"].tolist()
        counts = source.counts
    assert times == [60_000_000] * 2
    assert (counts.clock_restarts, counts.jumped, counts.malformed) == (1, 7, 7)
    assert source.summary().endswith(
        "2 events (7 malformed, 7 of them time jumps, 0 out of order, clock restarts: 1)"
    )


def test_by_default_a_time_may_lie_ten_seconds_ahead():
    """In one datagram, so that no time passes."""
    with UdpSource(port=0) as source:
        send(source.port, events_of([5, 10_000_005, 20_000_006], [0] * 3, [0] * 3, [0] * 3))
        assert source.receive(60)["t"].tolist() == [5, 10_000_005]


def test_events_without_times_have_that_of_their_arrival_since_the_source_was_opened(monkeypatch):
    now_ns = [5_000_000_000]
    clock = SimpleNamespace(monotonic_ns=lambda: now_ns[0], monotonic=time.monotonic)
    monkeypatch.setattr("async_tnt.sources.live.udp.time", clock)
    with UdpSource(port=0, format="spif") as source:
        for passed_us in (0, 1, 70, 2_000_000):
            now_ns[0] = 5_000_000_999 + 1_000 * passed_us
            send(source.port, EVENTS[:2], "spif")
            assert source.receive(60)["t"].tolist() == [passed_us] * 2


def test_a_stream_without_one_good_event_is_reported_once(caplog):
    events = events_of(
        range(WARN_AFTER), [0] * WARN_AFTER, [20] * WARN_AFTER, [1, 2] * (WARN_AFTER // 2)
    )
    with listening(sensor=SENSOR) as source, socket.socket(type=socket.SOCK_DGRAM) as sender:
        for _ in range(2):
            sender.sendto(events.tobytes(), (source.address, source.port))
            assert list(source) == []
        assert source.counts.malformed == 2 * WARN_AFTER
    (message,) = caplog.messages
    assert message.endswith(
        "none of the first 1000 events can be used, 500 of them lie off the sensor; does the "
        "sender use another format "
        "than t64_x16_y16_on8 (?format=...), or a larger camera?"
    )


def test_a_stream_with_a_good_event_is_not_reported(caplog):
    """Some noise between good events says nothing against format and camera."""
    wrong = events_of(range(WARN_AFTER), [0] * WARN_AFTER, [0] * WARN_AFTER, [2] * WARN_AFTER)
    with listening(sensor=SENSOR) as source, socket.socket(type=socket.SOCK_DGRAM) as sender:
        for events in (events_of([0], [0], [0], [1]), wrong):
            sender.sendto(events.tobytes(), (source.address, source.port))
        assert sum(map(len, source)) == 1 and source.counts.malformed == WARN_AFTER
    assert caplog.text == ""


# -- names and settings ----------------------------------------------------------------------------


def test_a_url_has_a_format_and_a_timeout():
    with open_udp("udp://127.0.0.1:0?format=spif&timeout_s=0.5", (34, 20)) as source:
        assert (source.format, source.timeout_s, source.sensor) == ("spif", 0.5, (34, 20))
        assert source.address == "127.0.0.1" and source.port > 0
        with pytest.raises(OSError, match=rf"udp://127.0.0.1:{source.port}"):
            open_udp(f"udp://127.0.0.1:{source.port}")  # taken
    with UdpSource(port=source.port) as again:  # the port is free; by default for this machine only
        assert again.address == "127.0.0.1"


def test_a_source_is_named_by_its_address_and_says_whether_it_is_open():
    with open_udp("udp://127.0.0.1:0/?format=spif") as source:
        assert source.name == f"udp://127.0.0.1:{source.port}"
        assert repr(source).startswith(f"UdpSource({source.name}?format=spif, open, NetworkCounts(")
    assert repr(source).startswith(f"UdpSource({source.name}?format=spif, closed, ")
    source.address = "::1"
    assert source.name == f"udp://[::1]:{source.port}"


def test_sender_and_listener_have_one_default_format():
    formats = [inspect.signature(f).parameters["format"] for f in (encode, Decoder, UdpSource)]
    assert [one.default for one in formats] == ["t64_x16_y16_on8"] * 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(({"port": port}, rf"`port` must be .*, got {port}") for port in (-1, 65_536)),
        *(
            ({"buffer_bytes": n}, rf"`buffer_bytes` must be in \[1, 2\*\*30\), got {n}")
            for n in (0, 1 << 30)
        ),
        *(({"timeout_s": s}, "`timeout_s` must be a positive number of seconds") for s in (0, 1e6)),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        UdpSource(**({"port": 0} | settings))


@pytest.mark.parametrize("buffer_bytes", [1 << 14, 1 << 16])
def test_the_buffer_has_the_bytes_that_were_asked_for(buffer_bytes):
    with UdpSource(port=0, buffer_bytes=buffer_bytes) as source:
        assert source.buffer_bytes == buffer_bytes


@pytest.mark.parametrize(
    "address",
    ["nothing.invalid", "a" * 64 + ".b", "a..b"],
    ids=["unknown", "too long", "empty part"],
)
def test_an_address_that_cannot_be_one_is_named(address):
    with pytest.raises(OSError, match=re.escape(f"{address}:7: no such host or port (")):
        UdpSource(address, 7)


def test_a_wrong_setting_leaves_the_port_free():
    port = free_port()
    with pytest.raises(ValueError, match="`format` must be one of"):
        UdpSource(port=port, format="aer")
    UdpSource(port=port).close()


@pytest.mark.parametrize(
    "url, message",
    [
        ("udp://127.0.0.1", "expected udp://HOST:PORT, such as udp://127.0.0.1:3333"),
        *(
            (url, "expected udp://HOST:PORT, such as udp://127.0.0.1:3333")
            for url in (
                "tcp://127.0.0.1:1",
                "udp://127.0.0.1:1/events",
                "udp://me@127.0.0.1:1",
                "udp://:1",
            )
        ),
        ("udp://127.0.0.1:99999", "Port out of range 0-65535"),
        (
            "udp://127.0.0.1:1?format=aer",
            f"`format` must be one of {', '.join(EVENT_BYTES)}, got 'aer'",
        ),
        (
            "udp://127.0.0.1:1?format=",
            f"`format` must be one of {', '.join(EVENT_BYTES)}, got ''",
        ),
        ("udp://127.0.0.1:1?speed=1", "unknown option 'speed', expected format or timeout_s"),
        (
            "udp://127.0.0.1:1?timeout_s=nan",
            "`timeout_s` must be a positive number of seconds below 1e+06, got nan",
        ),
    ],
)
def test_wrong_urls_say_what_is_wrong(url, message):
    with pytest.raises(ValueError) as caught:
        open_udp(url)
    assert str(caught.value) == f"{url}: {message}"
