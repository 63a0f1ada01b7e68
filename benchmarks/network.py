"""Events over loopback, from another process, while a Processor decides every 5 ms: is anything lost, how late is it?

    python benchmarks/network.py [--seconds 60] [--rate 1000000] [--pings 2000] [--json]

First single datagrams, one a millisecond, in turns to a `UdpSource` and to a plain blocking socket: from just before
`send` to the packet in hand. What both take is the system's waking of a process; the difference is ours. Then the load:
events at an even rate, each with the time at which it was due, so that the packet's age holds the sender's pacing, too.
Exit code 1 if a datagram is missing or counted as lost, or if the sender fell short of the rate by more than 1 %.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import time

import numpy as np

from async_tnt import EVENT_DTYPE, Processor, load_model, warmup
from async_tnt.bench.timing import latency, machine
from async_tnt.commands.send import even
from async_tnt.network import UdpSender, UdpSource

EVERY_US = 5_000
SILENCE_S = 2.0


def send(port: int, plain_port: int, seconds: float, rate: float, pings: int) -> None:
    """The other process: pings, a pause, the load; prints what it sent."""
    with UdpSender(port=port) as sender, UdpSender(port=plain_port) as plain_sender:
        ping = np.zeros(1, EVENT_DTYPE)
        for _ in range(pings):
            for to in (sender, plain_sender):
                time.sleep(0.001)
                ping["t"] = time.monotonic_ns()
                to.send(ping)
        time.sleep(0.2)
        rng = np.random.default_rng(0)
        n = int(rate * min(seconds, 1.0))
        events = np.empty(n, EVENT_DTYPE)
        due_us = (np.arange(n) * (1e6 / rate)).astype(np.int64)
        events["x"], events["y"], events["p"] = rng.integers(0, 34, n), rng.integers(0, 34, n), rng.integers(0, 2, n)
        period_us = round(n * 1e6 / rate)
        started_us = time.monotonic_ns() // 1000
        n_rounds = max(1, round(seconds * 1e6 / period_us))

        def rounds():
            for k in range(n_rounds):
                events["t"] = due_us + (started_us + k * period_us)
                yield events

        before = sender.events, sender.datagrams
        for packet in even(rounds(), rate):
            sender.send(packet)
        took = time.monotonic_ns() / 1e3 - started_us
        print(json.dumps({"events": sender.events - before[0], "datagrams": sender.datagrams - before[1],
                          "seconds": took / 1e6}))  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Receive, decide, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, metavar="N", help="of load (default: 60)")
    parser.add_argument("--rate", type=float, default=1e6, metavar="R", help="events a second (default: a million)")
    parser.add_argument("--pings", type=int, default=2000, metavar="N", help="single datagrams (default: 2000)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    parser.add_argument("--send-to", type=int, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.seconds <= 0 or args.rate < 1 or args.pings < 1:
        parser.error("--seconds, --rate and --pings must be above 0")
    if args.send_to is not None:
        send(*args.send_to, args.seconds, args.rate, args.pings)
        return 0

    model = load_model("digits")
    warmup(model)
    processor = Processor(model, every_us=EVERY_US)
    pings_us, plain_us, ages_us, n_decisions, cpu_s = [], [], [], 0, 0.0
    with (
        UdpSource(port=0, sensor=model.config.sensor) as source,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain,
    ):
        plain.bind(("127.0.0.1", 0))
        plain.settimeout(60)
        command = [sys.executable, __file__, "--send-to", str(source.port), str(plain.getsockname()[1])]
        command += ["--seconds", str(args.seconds), "--rate", str(args.rate), "--pings", str(args.pings)]
        sender = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            while source.counts.events < args.pings and (packet := source.receive(60)) is not None:
                pings_us += ((time.monotonic_ns() - packet["t"]) / 1e3).tolist()
                for _ in packet:  # one to each in turn
                    sent_ns = int.from_bytes(plain.recv(64)[:8], "little")
                    plain_us.append((time.monotonic_ns() - sent_ns) / 1e3)
            pings = source.counts
            while (packet := source.receive(SILENCE_S)) is not None:
                now_us = time.monotonic_ns() / 1e3
                if not ages_us:
                    cpu_s = -time.process_time()
                ages_us.append(now_us - int(packet["t"][-1]))
                n_decisions += len(processor.push(packet))
            cpu_s += time.process_time()
            sent = json.loads(sender.communicate(timeout=60)[0])
        finally:
            sender.kill()
        counts = source.counts
    got = counts.events - pings.events
    missing = sent["datagrams"] - (counts.datagrams - pings.datagrams)
    result = {
        "machine": machine(), "sent": sent, "received_events": got, "datagrams_missing": missing,
        "lost": counts.lost, "malformed": counts.malformed, "packets": len(ages_us), "decisions": n_decisions,
        "events_per_s": round(sent["events"] / sent["seconds"]),
        "receiver_cpu_share": round(cpu_s / sent["seconds"], 3), "buffer_bytes": source.buffer_bytes,
        "ping_us": latency(np.array(pings_us)), "plain_socket_us": latency(np.array(plain_us)),
        "age_us": latency(np.array(ages_us)),
    }  # fmt: skip
    if args.json:
        print(json.dumps(result))
    else:
        ping, age = result["ping_us"], result["age_us"]
        print(
            f"one datagram: {ping['median']:.0f} us from send to packet in hand (median of {ping['n']}; "
            f"99 %: {ping['p99']:.0f}); a plain socket's recv {result['plain_socket_us']['median']:.0f}\n"
            f"load: {sent['events']:,} events sent in {sent['seconds']:.1f} s ({result['events_per_s']:,}/s), {got:,} "
            f"received in {len(ages_us):,} packets, {n_decisions:,} decisions, "
            f"{cpu_s / sent['seconds']:.0%} of a core\n"
            f"a packet's newest event is {age['median']:.0f} us old (median; 99 %: {age['p99']:.0f})\n"
            f"datagrams missing {missing}, counted as lost {counts.lost}, malformed {counts.malformed}"
        )
    return int(missing != 0 or counts.lost not in (0, None) or result["events_per_s"] < 0.99 * args.rate)


if __name__ == "__main__":
    sys.exit(main())
