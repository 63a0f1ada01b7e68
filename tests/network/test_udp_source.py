"""UdpSource and UdpSender on loopback: packets, the ways to iterate, limits, names."""

import asyncio
import itertools
import socket

import numpy as np
import pytest
from made import random_events

from async_tnt import Processor, TNTConfig, astream, stream
from async_tnt.sources import EVENT_BYTES, Decoder, UdpSender, UdpSource, encode, open_udp

EVENTS = random_events(2500, duration_us=50_000)
SILENCE_S = 0.15


def listening(**settings):
    return UdpSource(port=0, **{"timeout_s": SILENCE_S, **settings})


@pytest.mark.parametrize(
    ("format", "packet_events"), [("t64_x16_y16_on8", 1), ("t32_x16_y15_on1", 100), ("spif_t32", 4000)]
)
def test_what_is_sent_arrives_in_order(format, packet_events):
    events = random_events(300 if packet_events == 1 else 2500, sensor=(1 << 15, 1 << 15))
    with (
        listening(format=format) as source,
        UdpSender("127.0.0.1", source.port, format, packet_events=packet_events) as sender,
    ):
        sender.send(events)
        assert np.concatenate(list(source)).tobytes() == events.tobytes()
        assert source.counts.datagrams == sender.datagrams == -(-len(events) // packet_events)
        assert (source.counts.events, source.counts.bytes) == (len(events), sender.bytes)
        assert (source.counts.malformed, source.counts.late) == (0, 0)


@pytest.mark.parametrize("format", EVENT_BYTES)
def test_what_comes_is_what_a_decoder_makes_of_the_datagrams(format):
    """Random bytes, good events with one wrong bit, cut ones, and more than any good datagram holds."""
    rng = np.random.default_rng(1)
    datagrams = [rng.bytes(int(rng.integers(0, 300))) for _ in range(100)]
    for k in range(100):
        good = bytearray(encode(EVENTS[k : k + 9], format))
        good[int(rng.integers(len(good)))] ^= 1 << int(rng.integers(8))
        datagrams.append(bytes(good[: len(good) - k % 3]))
    datagrams = [b"\xff" * 65_507, *(datagrams[k] for k in rng.permutation(200))]
    decoder, got = Decoder(format, (34, 34)), []
    with (
        listening(format=format, sensor=(34, 34), max_datagrams=8, max_jump_s=None) as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        for k, datagram in enumerate(datagrams):
            sock.sendto(datagram, ("127.0.0.1", source.port))
            while k % 20 == 0 and source.counts.datagrams <= k:
                got.append(source.receive(0))
        counts = source.counts
    got = np.concatenate([packet for packet in got if packet is not None])
    expected = np.concatenate([decoder.decode(datagram).events for datagram in datagrams])
    fields = ["x", "y", "p"] if format == "spif" else ["t", "x", "y", "p"]  # `spif` has the time of arrival
    assert got[fields].tolist() == expected[fields].tolist() and len(got) > 100
    assert (counts.datagrams, counts.bytes, counts.events) == (201, sum(map(len, datagrams)), len(got))
    assert (counts.malformed, counts.off_sensor) == (decoder.malformed, decoder.off_sensor)
    assert format == "spif" or counts.late == decoder.clock.late


def test_many_datagrams_become_one_packet_up_to_the_limit():
    with listening(max_datagrams=8) as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS[:2000])
        packets = list(source)
    assert [len(packet) for packet in packets] == [800, 800, 400]
    assert np.concatenate(packets).tobytes() == EVENTS[:2000].tobytes()  # none was overwritten by the next


def by_for(source, **settings):
    return list(stream(source, **settings))


def by_async_for(source, **settings):
    async def run():
        async with source:
            return [decision async for decision in astream(source, **settings)]

    return asyncio.run(run())


@pytest.mark.parametrize("way", [by_for, by_async_for])
def test_decisions_are_those_of_the_events(way):
    def processor():
        return Processor(TNTConfig(window_us=10_000), classifier=lambda volume: [float(volume.sum()), 1.0])

    with listening() as source, UdpSender(port=source.port) as sender:
        sender.send(EVENTS)
        decisions = way(source, model=processor())
    expected = list(stream([EVENTS], processor()))
    assert [(d.window_start_us, d.events, d.logits.tobytes()) for d in decisions] == [
        (d.window_start_us, d.events, d.logits.tobytes()) for d in expected
    ]
    assert len(expected) == 5


def test_datagrams_that_nobody_receives_are_counted_by_the_sender():
    with listening() as source:
        port = source.port
    with UdpSender(port=port) as sender:
        sender.send(EVENTS[:500])
        assert 0 < sender.refused <= sender.datagrams == 5


# -- names and settings ----------------------------------------------------------------------------------


def test_a_url_has_a_format_and_a_timeout(monkeypatch):
    with open_udp("udp://127.0.0.1:0?format=spif&timeout_s=0.5", (34, 20)) as source:
        assert (source.format, source.timeout_s, source.sensor) == ("spif", 0.5, (34, 20))
        assert source.address == "127.0.0.1" and source.port > 0
        with pytest.raises(OSError, match=rf"udp://127.0.0.1:{source.port}"):
            open_udp(f"udp://127.0.0.1:{source.port}")  # taken
    with UdpSource(port=source.port) as again:  # the port is free; by default for this machine only
        assert again.address == "127.0.0.1"

    def unknown(*_, **__):
        raise socket.gaierror

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(OSError, match="no such host or port"):
        open_udp("udp://no.such.host.invalid:3333")


@pytest.mark.parametrize(
    "url, message",
    [
        ("udp://127.0.0.1", "expected udp://HOST:PORT"),
        ("udp://127.0.0.1:99999", "out of range"),
        ("udp://127.0.0.1:3333?format=aer", "`format` must be one of t64_x16_y16_on8.* got 'aer'"),
        ("udp://127.0.0.1:3333?speed=1", "unknown option 'speed', expected format or timeout_s"),
    ],
)
def test_wrong_urls_say_what_is_wrong(url, message):
    with pytest.raises(ValueError, match=message) as caught:
        open_udp(url)
    assert str(caught.value).startswith(url)


@pytest.mark.parametrize(
    "made, settings, message",
    [
        (UdpSource, {"buffer_bytes": 0}, r"`buffer_bytes` must be in \[1, 2\*\*30\), got 0"),
        (UdpSource, {"max_datagrams": 0}, "`max_datagrams` must be at least 1, got 0"),
        (UdpSource, {"timeout_s": float("nan")}, "`timeout_s` must be a positive number of seconds, got nan"),
        (UdpSource, {"spin_us": 1e7}, r"`spin_us` must be in \[0, 1,000,000\] microseconds"),
        (UdpSender, {"packet_events": 0}, r"`packet_events` must be in \[1, 5039\]"),
        (UdpSender, {"port": 0}, r"`port` must be in \[1, 65535\]"),
    ],
)
def test_wrong_settings(made, settings, message):
    with pytest.raises(ValueError, match=message):
        made(**settings)


def test_other_tasks_run_while_datagrams_never_pause():
    turns = itertools.count()

    async def other():
        while True:
            next(turns)
            await asyncio.sleep(0)

    async def run():
        with listening(max_datagrams=1) as source, UdpSender(port=source.port) as sender:
            sender.send(EVENTS)
            task = asyncio.ensure_future(other())
            packets = aiter(source)
            for _ in range(25):
                await anext(packets)
            task.cancel()

    asyncio.run(run())
    assert next(turns) >= 20
