"""async-tnt send: recordings over the network, at the recorded speed."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from async_tnt.cli.options import number, paths_of, positive_int, positive_number
from async_tnt.cli.output import complain, say
from async_tnt.sources.datagrams import EVENT_BYTES
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.playback import replay, wait_until
from async_tnt.sources.udp_sender import PACKET_EVENTS, UdpSender
from async_tnt.sources.udp_socket import parse_udp_url

DESCRIPTION = """Send recordings as UDP datagrams at the speed at which they were recorded. Several recordings are sent
one after the other with continued times, so that the receiver sees one stream.

  async-tnt send samples udp://127.0.0.1:3333                      the ten bundled samples
  async-tnt send a.bin b.npz udp://10.0.0.7:3333 --speed 2         twice as fast
  async-tnt send samples udp://127.0.0.1:3333 --align-us 105000    each starts with a new window of the receiver
  async-tnt send a.bin udp://127.0.0.1:3333 --loop                 again and again, until Ctrl-C
  async-tnt send a.bin udp://127.0.0.1:3333 --rate 1000000         a million events a second, regardless of their times
  async-tnt send a.bin 'udp://127.0.0.1:3333?format=spif'          in another format

UDP does not report lost datagrams: see the receiver's counts. A datagram is refused if no program listens.
"""
PACKET_US = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files", nargs="+", metavar="FILE", type=Path, help="recordings, or `samples` for the ten bundled ones"
    )
    parser.add_argument("url", metavar="udp://HOST:PORT", help="destination")
    parser.add_argument(
        "--format", choices=tuple(EVENT_BYTES), help="format of an event (default: that of the URL, or t64_x16_y16_on8)"
    )
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument(
        "--speed",
        type=positive_number,
        default=1.0,
        metavar="S",
        help="speed of playback; 2 is twice as fast, inf does not wait (default: 1)",
    )
    pace.add_argument(
        "--rate", type=_finite_rate, metavar="EVENTS_PER_S", help="an even rate instead of the recorded times"
    )
    parser.add_argument("--loop", action="store_true", help="start over at the end, until Ctrl-C")
    parser.add_argument(
        "--packet-events",
        type=positive_int,
        default=PACKET_EVENTS,
        metavar="N",
        help="largest number of events in a datagram (default: %(default)s)",
    )
    parser.add_argument(
        "--align-us",
        type=positive_int,
        default=1,
        metavar="US",
        help="start each recording at a multiple of this after the first",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object with the counts")


def _finite_rate(text: str) -> float:
    """An argparse type."""
    return number(text, lambda rate: 0 < rate < math.inf, "a positive number")


def main(args: argparse.Namespace) -> int:
    url = parse_udp_url(args.url)
    paths = paths_of(args)
    recordings = [open_recording(path).read() for path in paths]
    if not any(map(len, recordings)):
        raise ValueError(f"{', '.join(map(str, paths))}: no event to send")
    with UdpSender(url.host, url.port, args.format or url.format, packet_events=args.packet_events) as sender:
        stream = one_stream(recordings, args.loop, args.align_us)
        started = time.monotonic()
        try:
            for packet in replay(stream, args.speed) if args.rate is None else even(stream, args.rate):
                sender.send(packet)
        finally:  # also after Ctrl-C
            _report(sender, args, time.monotonic() - started)
    return 0


def one_stream(recordings: list[np.ndarray], loop: bool, align_us: int) -> Iterator[np.ndarray]:
    """The recordings one after the other with continued times; each starts a multiple of `align_us` after the first."""
    recordings = [events for events in recordings if len(events)]
    origin_us = start_us = int(recordings[0]["t"].min())
    while True:
        for events in recordings:
            moved = events.copy()
            moved["t"] += start_us - int(events["t"].min())
            yield moved
            start_us = origin_us + -(-(int(moved["t"].max()) + 1 - origin_us) // align_us) * align_us
        if not loop:
            return


def even(stream: Iterator[np.ndarray], rate: float) -> Iterator[np.ndarray]:
    """Packets of a millisecond each, `rate` events a second without drift."""
    n_packet = max(1, round(rate * PACKET_US / 1e6))
    n_sent, started_ns = 0, time.monotonic_ns()
    for events in stream:
        for first in range(0, len(events), n_packet):
            packet = events[first : first + n_packet]
            n_sent += len(packet)
            wait_until(started_ns + round(n_sent * 1e9 / rate))  # when the last of them is due
            yield packet


def _report(sender: UdpSender, args: argparse.Namespace, seconds: float) -> None:
    sent = {
        "url": args.url,
        "format": sender.format,
        "events": sender.events,
        "datagrams": sender.datagrams,
        "bytes": sender.bytes,
        "refused": sender.refused,
        "seconds": round(seconds, 6),
        "events_per_s": round(sender.events / max(seconds, 1e-9)),
    }
    if args.json:
        say(json.dumps(sent))
    else:
        say(
            f"sent {sender.events:,} events in {sender.datagrams:,} datagrams ({sender.bytes:,} bytes, "
            f"{sender.format}) in {seconds:.3f} s to {args.url}: {sent['events_per_s']:,} events/s"
        )
    if sender.refused:
        complain(f"{sender.refused:,} datagrams were refused or not sent; does a program listen at {args.url}?")
