"""The tables of network streams and of archives."""

from __future__ import annotations

from typing import Any

from experiments.page_parts import about_machine, percent, results, short, table

WAYS = {
    "plain_socket": "plain blocking socket, `recv`",
    "packet": "`UdpSource`, a packet",
    "decision": "`UdpSource`, `Processor`, a decision of `digits`",
}


def udp_machine() -> str:
    return about_machine(results("network"))


def udp_latency() -> str:
    """From just before `send` to something in hand."""
    found = results("network")["latency_us"]
    rows = []
    for name, words in WAYS.items():
        adds = found.get(f"{name}_adds")
        added = "" if adds is None else f"{adds['median']:.1f}"
        rows.append([words, f"{found[name]['median']:.0f}", f"{found[name]['p99']:.0f}", added])
    return table(["microseconds", "median", "99 %", "added by async_tnt, median"], rows)


def udp_load() -> str:
    return table(_HEAD, [["steady", *_row(results("network")["load"])]])


def udp_overload() -> str:
    rows = []
    for run in results("network")["overload"]:
        words = f"datagrams of {run['datagram_events']:,} events"
        if run["slow_s"]:
            words += f", and a consumer that sleeps {run['slow_s'] * 1e3:.0f} ms after each packet"
        rows.append([words, *_row(run)])
    return table(_HEAD, rows)


_HEAD = [
    "",
    "events sent",
    "received",
    "lost by the system",
    "skipped",
    "decisions",
    "delay, ms: median",
    "99 %",
    "at most",
]


def _row(run: dict[str, Any]) -> list[str]:
    late = run["delay_us"]
    events, received = run["sent"]["events"], run["received"]["events"]
    lost = run["datagrams_missing"] * run["datagram_events"]
    skipped = run["events_skipped"] / received
    share = f"{100 * skipped:.3f} %" if 0 < skipped < 1e-3 else percent(skipped)
    return [
        f"{events:,}",
        f"{received:,}",
        f"{lost:,}",
        share if skipped else "0",
        f"{run['decisions']:,}",
        *(f"{late[name] / 1e3:.1f}" for name in ("median", "p99", "max")),
    ]


def archive() -> str:
    """Evaluations of the same recordings."""
    rows = []
    for name, run in results("archive")["ways"].items():
        speedup, steady = run["speedup"], run["steady_speedup"]
        quartiles = f"{speedup['median']:.2f} ({speedup['p25']:.2f}-{speedup['p75']:.2f})"
        rates = short(run["seconds"]["median"]), short(run["recordings_per_s"])
        rows.append([name, *rates, quartiles, f"{steady['median']:.2f}"])
    return table(["", "seconds", "recordings a second", "speed-up (quartiles)", "after the first record"], rows)
