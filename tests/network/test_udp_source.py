"""UdpSource on loopback: packets, counts, loss, ends."""

import asyncio
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt import Processor, TNTConfig, astream, stream
from async_tnt.sources.background_reader import BackgroundReader
from async_tnt.sources.datagrams import encode
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.opening import open_source
from async_tnt.sources.udp import UdpSource, open_udp
from async_tnt.sources.udp_sender import UdpSender

EVENTS = random_events(2500, duration_us=50_000)
CONFIG = TNTConfig(window_us=10_000)
SILENCE_S = 0.15


def classifier(volume):
    return [float(volume.sum()), 1.0]


def keys(decisions):
    return [(d.trigger, d.window_start_us, d.events, d.logits.tobytes()) for d in decisions]


def listening(**settings):
    return UdpSource(port=0, **{"timeout_s": SILENCE_S, **settings})


def raw(source, *datagrams):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for datagram in datagrams:
            sock.sendto(datagram, ("127.0.0.1", source.port))


@pytest.mark.parametrize("format", ["t64_x16_y16_on8", "t32_x16_y15_on1", "spif_t32"])
@pytest.mark.parametrize("packet_events", [1, 100, 4000])
def test_what_is_sent_arrives_in_order(format, packet_events):
    events = EVENTS[:300] if packet_events == 1 else EVENTS
    with (
        listening(format=format) as source,
        UdpSender("127.0.0.1", source.port, format, packet_events=packet_events) as sender,
    ):
        sender.send(events)
        received = np.concatenate(list(source))
        assert received.tobytes() == events.tobytes()
        assert source.counts.datagrams == sender.datagrams == -(-len(events) // packet_events)
        assert (source.counts.events, source.counts.bytes) == (len(events), sender.bytes)
        assert (source.counts.malformed, source.counts.late) == (0, 0)


def test_many_datagrams_become_one_packet_up_to_the_limit():
    with listening(max_datagrams=8) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS[:2000])
        assert [len(packet) for packet in source] == [800, 800, 400]


def test_packets_stay_what_they_were():
    with listening(max_datagrams=1) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS[:300])
        packets = list(source)
        assert np.concatenate(packets).tobytes() == EVENTS[:300].tobytes()


def test_spif_events_carry_the_time_of_arrival():
    with listening(format="spif") as source, UdpSender(port=source.port, format="spif") as sender:
        sender.send(EVENTS[:150])
        first = source.receive(1)
        time.sleep(0.02)
        sender.send(EVENTS[150:200])
        second = source.receive(1)
    assert np.concatenate([first["x"], second["x"]]).tolist() == EVENTS["x"][:200].tolist()
    assert (np.diff(first["t"]) >= 0).all() and second["t"][0] - first["t"][-1] >= 20_000


def test_invalid_events_are_counted_and_the_rest_handed_on():
    good = encode(EVENTS[:3])
    off = encode(events_of([1, 2], [40, 1], [1, 34], [0, 0]))
    with listening(sensor=(34, 34)) as source:
        raw(source, good + b"cut", b"", b"x", off, b"\xff" * 65_507, good)
        assert np.concatenate(list(source)).tobytes() == np.concatenate([EVENTS[:3]] * 2).tobytes()
        counts = source.counts
        assert (counts.datagrams, counts.events) == (6, 6)
        assert counts.malformed == 1 + 1 + 2 + 5039
        assert counts.late == 2  # the first three again: only the last of them is not older


def test_late_events_are_counted_across_packets():
    t = [5, 9, 7, 9, 8, 20]
    for size in (1, 2, 6):
        with listening(max_datagrams=2) as source, UdpSender(port=source.port, packet_events=size) as sender:
            sender.send(events_of(t, [0] * 6, [0] * 6, [0] * 6))
            assert np.concatenate(list(source))["t"].tolist() == t
            assert source.counts.late == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux counts what it drops")
def test_lost_datagrams_are_counted():
    with listening(buffer_bytes=4096) as source:
        source._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        with UdpSender(port=source.port) as sender:
            sender.send(EVENTS)  # 25 datagrams, where 4 have room
            n_sent = sender.datagrams
        list(source)
        counts = source.counts
        assert counts.lost > 0 and counts.datagrams > 0
        assert counts.datagrams + counts.lost == n_sent
    assert source.counts == counts  # closed: they stay


def test_a_smaller_buffer_is_reported(caplog):
    with listening(buffer_bytes=(1 << 30) - 1) as source:
        assert source.buffer_bytes < (1 << 30) - 1
        assert "bursts may be lost" in source.advice and source.advice in caplog.text
    caplog.clear()
    with listening(buffer_bytes=8192) as source:
        assert source.advice is None and not caplog.records and source.buffer_bytes >= 8192


def test_stream_decides_what_it_decides_on_the_events_themselves():
    expected = keys(stream([EVENTS], CONFIG, classifier=classifier))
    with listening() as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        assert keys(stream(source, CONFIG, classifier=classifier)) == expected and len(expected) == 5


def by_reader(monkeypatch):
    pass


def by_thread(monkeypatch):
    """Windows' default event loop."""

    def refuse(self, *args):
        raise NotImplementedError

    monkeypatch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)


@pytest.mark.parametrize("way", [by_reader, by_thread])
def test_astream_decides_the_same(way, monkeypatch):
    way(monkeypatch)

    async def run():
        decisions = []
        async with listening() as source:
            with UdpSender(port=source.port) as sender:
                feeding = asyncio.ensure_future(feed(sender))
                async for decision in astream(source, Processor(CONFIG, classifier=classifier)):
                    decisions.append(decision)
                await feeding
        assert source.closed
        return decisions

    async def feed(sender):
        for part in np.array_split(EVENTS, 5):
            sender.send(part)
            await asyncio.sleep(0.005)

    assert keys(asyncio.run(run())) == keys(stream([EVENTS], CONFIG, classifier=classifier))


def test_cancelling_the_task_closes_the_socket():
    async def run():
        source = listening(timeout_s=None)
        task = asyncio.ensure_future(anext(astream(source, CONFIG, classifier=classifier)))
        await asyncio.sleep(0.01)
        assert not source.closed
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return source

    source = asyncio.run(run())
    assert source.closed and source._socket.fileno() == -1
    UdpSource(port=source.port).close()  # the port is free


def test_other_tasks_run_while_datagrams_never_pause():
    async def run():
        async with listening(max_datagrams=1) as source:
            with UdpSender(port=source.port) as sender:
                sender.send(EVENTS)
            turns = []

            async def other():
                while True:
                    turns.append(1)
                    await asyncio.sleep(0)

            task = asyncio.ensure_future(other())
            n = 0
            async for _ in source:
                n += 1
                if n == 25:
                    break
            task.cancel()
            assert len(turns) >= 20

    asyncio.run(run())


def test_close_from_another_thread_ends_a_waiting_for():
    source = listening(timeout_s=None)
    threading.Timer(0.02, source.close).start()
    assert list(source) == [] and source.closed
    source.close()
    assert source.receive(0) is None


def test_close_from_another_thread_ends_a_for_that_never_waits():
    """Datagrams never pause; the port is free at once, and no later socket is read in place of ours."""
    source = listening(timeout_s=None, max_datagrams=1)
    stop = threading.Event()

    def flood():
        with UdpSender(port=source.port) as sender:
            while not stop.is_set():
                sender.send(EVENTS[:100])

    flooding = threading.Thread(target=flood)
    flooding.start()
    n_packets = 0

    def read():
        nonlocal n_packets
        for _ in source:
            n_packets += 1

    reading = threading.Thread(target=read)
    reading.start()
    while n_packets < 20:
        time.sleep(0.001)
    source.close()
    UdpSource(port=source.port).close()
    reading.join(5)
    stop.set()
    flooding.join()
    assert not reading.is_alive() and source.counts.datagrams >= 20


def test_close_within_the_loop_over_it_ends_the_loop():
    with listening(timeout_s=None) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS[:1])
        for packet in source:
            assert len(packet) == 1
            source.close()


def test_a_background_reader_closes_it():
    source = listening(timeout_s=None)
    with BackgroundReader(source, on_close=source.close) as reader, UdpSender(port=source.port) as sender:
        sender.send(EVENTS[:10])
        assert next(reader).tobytes() == EVENTS[:10].tobytes()
        assert reader.close(5)  # its thread has stopped, though it waited in the source
    assert source.closed and source.counts.events == 10


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="signals")
def test_close_in_a_signal_handler_ends_the_wait_it_interrupts():
    source = listening(timeout_s=None)
    before = signal.signal(signal.SIGALRM, lambda *_: source.close())
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        assert list(source) == []
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("spin_us", [0, 2000])
def test_spinning_hands_over_the_same_and_nothing_within_the_time_is_none(spin_us):
    with listening(spin_us=spin_us) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        assert np.concatenate(list(source)).tobytes() == EVENTS.tobytes()
        assert source.receive(0) is None
        started = time.monotonic()
        assert source.receive(0.03) is None
        assert time.monotonic() - started > 0.025


@pytest.mark.parametrize("spin_us", [-1, 1e7, float("nan")])
def test_a_wrong_time_to_spin(spin_us):
    with pytest.raises(ValueError, match=r"`spin_us` must be in \[0, 1,000,000\] microseconds"):
        UdpSource(port=0, spin_us=spin_us)


def test_the_summary_is_one_line_of_what_was_counted():
    with listening(sensor=(34, 34)) as source:
        raw(source, encode(EVENTS[:3]) + b"cut", encode(events_of([2**62 - 1], [0], [0], [0])))
        assert len(list(source)) == 1
        lost = "0" if sys.platform.startswith("linux") else "unknown"
        expected = f"2 datagrams, 3 events (2 malformed, 1 of them time jumps, 0 out of order, datagrams lost: {lost})"
        assert source.summary() == expected
    assert source.summary() == expected  # closed: it stays


def test_a_sender_killed_in_the_middle():
    with listening(timeout_s=None) as source:
        argv = [sys.executable, "-m", "async_tnt.cli", "send", "samples", f"udp://127.0.0.1:{source.port}", "--loop"]
        sending = subprocess.Popen(argv)
        try:
            assert source.receive(60) is not None
        finally:
            sending.kill()
            sending.wait()
        source.timeout_s = SILENCE_S
        list(source)  # ends
        assert source.counts.malformed == 0 and source.counts.events > 0
        with UdpSender(port=source.port) as sender:  # the next sender is heard
            sender.send(EVENTS[:1])
            assert len(source.receive(1)) == 1


@pytest.mark.parametrize(
    "url, message",
    [
        ("http://127.0.0.1:1", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1", "expected udp://HOST:PORT"),
        ("udp://:3333", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:99999", "out of range"),
        ("udp://127.0.0.1:x", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:3333?format=aer", "`format` must be one of t64_x16_y16_on8.* got 'aer'"),
        ("udp://127.0.0.1:3333?speed=1", "unknown option 'speed', expected format or timeout_s"),
        ("udp://127.0.0.1:3333?timeout_s=-1", "`timeout_s` must be a positive number of seconds, got -1"),
    ],
)
def test_wrong_urls_say_what_is_wrong(url, message):
    with pytest.raises(ValueError, match=message) as caught:
        open_udp(url)
    assert str(caught.value).startswith(url)


def test_open_udp_takes_format_and_timeout():
    with open_udp("udp://127.0.0.1:0?format=spif&timeout_s=0.5", (34, 20)) as source:
        assert (source.format, source.timeout_s, source.sensor) == ("spif", 0.5, (34, 20))
        assert source.address == "127.0.0.1" and source.port > 0
        with pytest.raises(OSError, match=rf"udp://127.0.0.1:{source.port}"):
            open_udp(f"udp://127.0.0.1:{source.port}")  # taken
    with pytest.raises(OSError, match="no such host or port"):
        open_udp("udp://no.such.host.invalid:3333")


def test_any_source_by_name():
    """A URL, a path, an array; cameras are in tests/cameras."""
    with open_source("udp://127.0.0.1:0?format=spif", (34, 20)) as source:
        assert isinstance(source, UdpSource) and (source.format, source.sensor) == ("spif", (34, 20))
    path = sample_recordings()[3]
    recorded = open_recording(path).read().tobytes()
    for name in (path, str(path), open_recording(path).read()):
        assert b"".join(packet.tobytes() for packet in open_source(name)) == recorded
    assert open_source(path, (60, 48)).sensor == (60, 48)
    with pytest.raises(FileNotFoundError):
        open_source("gone.npy")


def test_nobody_listening_is_counted_not_raised():
    with listening() as source:
        port = source.port
    with UdpSender(port=port) as sender:
        sender.send(EVENTS[:500])
        assert 0 < sender.refused <= sender.datagrams == 5


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"packet_events": 0}, r"`packet_events` must be in \[1, 5039\]"),
        ({"port": 0}, r"`port` must be in \[1, 65535\]"),
    ],
)
def test_wrong_settings_of_a_sender(settings, message):
    with pytest.raises(ValueError, match=message):
        UdpSender(**settings)
