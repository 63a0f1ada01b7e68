"""Events over loopback, from another process: how late are datagrams, and are any lost?

    python -m experiments.network [--seconds 60] [--rate 1000000] [--pings 2000]

Latency. The other process sends one datagram of 100 events per millisecond. The receivers take
turns: a plain blocking socket, a `UdpSource`, and a `UdpSource` whose `Processor` decides on each
datagram. The time is taken from just before `send` until the bytes, the packet or the decision are
there. The plain socket shows how long the system takes to wake a process. The rest is our time.

Load. The other process sends events at an even rate for `--seconds`, in datagrams that fit
Ethernet, to a `UdpSource` and a `Processor` that decides every 5 ms. Each event has the time at
which it was due, on the clock that both processes share. A decision's delay is counted from its
newest event, so it includes delays by the sender and in the system's buffer.

The command prints one JSON object. Its exit code is 1 if a datagram is missing, or if the sender
fell short of the rate by more than 1 %. `experiments.sustained` measures what happens to more
events than a machine can decide on.
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from async_tnt import EVENT_DTYPE, Processor, load_model, warmup
from async_tnt.sources import UdpSource
from async_tnt.sources.files.playback import wait_until
from async_tnt.sources.live.datagrams import encode
from async_tnt.volume.events import structured
from experiments.scripts.options import add_count, add_json, exit_with, plain_parser, write_outputs
from experiments.speed.moments import made_columns
from experiments.speed.timing import latency, machine

EVERY_US = 5_000
"""Time between two decisions under load, in microseconds."""

SILENCE_S = 2.0
"""Seconds without a datagram after which the stream has ended."""

DATAGRAM_EVENTS = 100
"""Number of events of a datagram. Its 1300 bytes fit Ethernet."""

WAYS = ("plain_socket", "packet", "decision")
"""Ways of receiving that are compared."""

SHARE_S = 1e-4
"""Seconds of the load whose events the sender sends at once, see `send_load`."""

BUFFER_BYTES = 1 << 22
"""Size of the system's buffer for datagrams that wait, in bytes."""


# -- the other process -----------------------------------------------------------------------------


def random_events(n: int) -> np.ndarray:
    """`n` events on 34x34 pixels. The sender sets their times."""
    return structured(made_columns(np.random.default_rng(0), (34, 34), n, n))


def send_pings(ports: list[int], n: int) -> None:
    """Send `n` datagrams to each port: one datagram a millisecond, to the ports in turn.

    All events of a datagram have the time of sending.
    """
    events = random_events(DATAGRAM_EVENTS)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(n * len(ports)):
            time.sleep(0.001)
            events["t"] = time.monotonic_ns() // 1000
            sender.sendto(encode(events), ("127.0.0.1", ports[k % len(ports)]))


def send_load(port: int, seconds: float, rate: float) -> dict[str, Any]:
    """Send events at an even rate, and return counts of what was sent.

    The load is sent in shares. A share has the events of `SHARE_S` seconds, and is sent at once, at
    the end of these seconds. If that would be less than one datagram of `DATAGRAM_EVENTS` events, a
    share is one datagram. If the load has fewer than `DATAGRAM_EVENTS` events a second, a share has
    the events of one second.
    """
    # number of events of a share
    n = max(1, round(rate * SHARE_S), min(DATAGRAM_EVENTS, round(rate)))
    events = random_events(n)
    # Times at which events are due, relative to the end of their share, and so negative. The first
    # event is due at the beginning of the share. The last event is due one period before its end.
    offset_us = (np.arange(n) * (1e6 / rate)).astype(np.int64) - round(n * 1e6 / rate)
    n_shares = max(1, round(seconds * rate / n))
    n_datagrams = 0
    n_bytes = 0
    n_refused = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))  # only a connected socket reports refused datagrams
        started_ns = time.monotonic_ns()
        for k in range(1, n_shares + 1):
            due_ns = started_ns + round(k * n * 1e9 / rate)
            events["t"] = offset_us + due_ns // 1000
            wait_until(due_ns)
            for first in range(0, n, DATAGRAM_EVENTS):
                data = encode(events[first : first + DATAGRAM_EVENTS])
                try:
                    n_bytes += sender.send(data)
                    n_datagrams += 1
                except OSError:  # nobody listens, or the system's queue is full
                    n_refused += 1
        took_s = (time.monotonic_ns() - started_ns) / 1e9
    n_events = n_bytes // EVENT_DTYPE.itemsize
    return {
        "events": n_events,
        "datagrams": n_datagrams,
        "bytes": n_bytes,
        "refused": n_refused,
        "seconds": round(took_s, 3),
        "events_per_s": round(n_events / took_s),
    }


def other_process(*task: Any) -> subprocess.Popen[str]:
    """A new process of this script, which does a task.

    task : a key of `tasks` in `main`, and the arguments of that function.
    """
    words = [sys.executable, "-m", "experiments.network", "--task", json.dumps(task)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


# -- this process ----------------------------------------------------------------------------------


def measure_latency(model: Any, n: int) -> dict[str, Any]:
    """Statistics of the latency from `send` on, for each of `WAYS`, in microseconds.

    `packet_adds` is the latency of a packet minus the latency of the plain socket.
    """
    late_us: dict[str, list[float]] = {way: [] for way in WAYS}
    sensor = model.config.sensor
    processor = Processor(model, every_events=DATAGRAM_EVENTS)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain_socket,
        UdpSource(port=0, sensor=sensor) as packet_source,
        UdpSource(port=0, sensor=sensor) as decision_source,
    ):
        plain_socket.bind(("127.0.0.1", 0))
        plain_socket.settimeout(30)  # the sender may have died
        ports = [plain_socket.getsockname()[1], packet_source.port, decision_source.port]
        sender_process = other_process("pings", ports, n)
        try:
            n_events = dict.fromkeys(WAYS, 0)
            for k in range(n):
                sent_us = int.from_bytes(plain_socket.recv(1 << 16)[:8], "little")
                late_us["plain_socket"].append(time.monotonic_ns() / 1e3 - sent_us)
                for way, source in (("packet", packet_source), ("decision", decision_source)):
                    # This process was late: the datagram came in one packet with the previous one.
                    if n_events[way] > k * DATAGRAM_EVENTS:
                        continue
                    packet = source.receive(30)
                    if packet is None:
                        raise RuntimeError("the sender sent nothing for 30 seconds")
                    n_events[way] += len(packet)
                    n_decided = len(processor.push(packet)) if way == "decision" else 1
                    now_us = time.monotonic_ns() / 1e3
                    if n_decided:
                        late_us[way].append(now_us - int(packet["t"][0]))
        finally:
            sender_process.kill()
            sender_process.wait()
    result: dict[str, Any] = {way: latency(np.array(values)) for way, values in late_us.items()}
    result["packet_adds"] = {
        key: result["packet"][key] - result["plain_socket"][key] for key in ("median", "p99")
    }
    return result


def measure_load(model: Any, seconds: float, rate: float) -> dict[str, Any]:
    """The report of the load. Receives and decides until the sender is silent."""
    processor = Processor(model, every_us=EVERY_US)
    delays_us: list[float] = []
    with UdpSource(
        port=0, sensor=model.config.sensor, timeout_s=30, buffer_bytes=BUFFER_BYTES
    ) as source:
        sender_process = other_process("load", source.port, seconds, rate)
        try:
            for packet in source:
                # only the first packet may take long, because the sender starts
                source.timeout_s = SILENCE_S
                for decision in processor.push(packet):
                    delays_us.append(time.monotonic_ns() / 1e3 - decision.time_us)
            sent = json.loads(sender_process.communicate(timeout=30)[0])
        finally:
            sender_process.kill()
        counts = source.counts
    return {
        "rate_wanted": rate,
        "datagram_events": DATAGRAM_EVENTS,
        "sent": sent,
        "received": {
            "datagrams": counts.datagrams,
            "events": counts.events,
            "malformed": counts.malformed,
            "late": counts.late,
        },
        "datagrams_missing": sent["datagrams"] - counts.datagrams,
        "decisions": len(delays_us),
        "delay_us": latency(np.array(delays_us)),
        "buffer_bytes": source.buffer_bytes,
    }


def wrong_with_load(result: dict[str, Any]) -> list[str]:
    """Problems under load: missing or malformed datagrams, or a sender that was too slow."""
    problems = []
    if result["datagrams_missing"]:
        problems.append(f"{result['datagrams_missing']} datagrams missing")
    if result["sent"]["events_per_s"] < 0.99 * result["rate_wanted"]:
        problems.append(f"only {result['sent']['events_per_s']:,} events/s sent")
    if result["received"]["malformed"]:
        problems.append(f"{result['received']['malformed']} malformed")
    return problems


def main(argv: list[str] | None = None) -> int:
    """Measure latency and load, and print the result. Returns 1 if something was wrong."""
    parser = plain_parser("network", __doc__)
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        metavar="N",
        help="duration of the load (default: 60)",
    )
    parser.add_argument(
        "--rate", type=float, default=1e6, metavar="R", help="events a second (default: a million)"
    )
    add_count(parser, "--pings", 2_000, "single datagrams")
    add_json(parser)
    parser.add_argument("--task", type=json.loads, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.task:
        task_name, *arguments = args.task
        tasks: dict[str, Callable[..., Any]] = {"pings": send_pings, "load": send_load}
        print(json.dumps(tasks[task_name](*arguments)), flush=True)
        return 0
    if not (0 < args.seconds < math.inf and 1 <= args.rate < math.inf):
        parser.error("--seconds must be above 0, --rate at least 1")

    model = load_model("digits")
    warmup(model)
    result: dict[str, Any] = {
        "machine": machine(),
        "latency_us": measure_latency(model, args.pings),
    }
    result["load"] = measure_load(model, args.seconds, args.rate)
    result["wrong"] = wrong_with_load(result["load"])
    write_outputs(args, result)
    print(json.dumps(result))
    for problem in result["wrong"]:
        print(f"WRONG: {problem}", file=sys.stderr)
    return int(bool(result["wrong"]))


if __name__ == "__main__":
    exit_with(main)
