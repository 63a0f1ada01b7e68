"""The tables of streams: event volumes, map models, threads, memory, network and loads."""

from __future__ import annotations

from functools import partial
from typing import Any

from experiments.tables.parts import about_machine, of_report, percent, results, short, table

WAYS = {
    "plain_socket": "plain blocking socket, `recv`",
    "packet": "`UdpSource`, a packet",
    "decision": "`UdpSource`, `Processor`, a decision of `digits`",
}
"""Way of receiving datagrams -> its title."""

map_machine = of_report("map_times")(about_machine)
threads_machine = of_report("threads")(partial(about_machine, threads="two threads"))
udp_machine = of_report("network")(partial(about_machine, threads="two processes"))


def udp_latency() -> str:
    """A table of the time from just before `send` to the bytes, the packet or the decision."""
    latency_us = results("network")["latency_us"]
    rows = []
    for name, title in WAYS.items():
        added_us = latency_us.get(f"{name}_adds")
        added_text = "" if added_us is None else f"{added_us['median']:.1f}"
        rows.append(
            [
                title,
                f"{latency_us[name]['median']:.0f}",
                f"{latency_us[name]['p99']:.0f}",
                added_text,
            ]
        )
    return table(["microseconds", "median", "99 %", "added by async_tnt, median"], rows)


def udp_load() -> str:
    """A table of counts and delays of decisions, for a minute of events over UDP."""
    run = results("network")["load"]
    late_us = run["delay_us"]
    counts = {
        "events sent": run["sent"]["events"],
        "received": run["received"]["events"],
        "lost by the system": run["datagrams_missing"] * run["datagram_events"],
        "decisions": run["decisions"],
    }
    delays_us = {
        "delay, ms: median": late_us["median"],
        "99 %": late_us["p99"],
        "at most": late_us["max"],
    }
    row = [
        *(f"{n:,}" for n in counts.values()),
        *(f"{delay_us / 1e3:.1f}" for delay_us in delays_us.values()),
    ]
    return table([*counts, *delays_us], [row])


@of_report("bench")
def volumes(report: dict[str, Any]) -> str:
    """A table of the nanoseconds per event by the size of a packet.

    A sentence on a whole window follows the table.
    """
    ways = {
        "single": "`update_one`",
        "packet_10_columns": "packets of 10, columns",
        "packet_1300_columns": "packets of 1300, columns",
        "packet_1300_structured": "packets of 1300, structured",
    }
    grids = report["volume"]
    rows = []
    for way, title in ways.items():
        medians = [grid["ns_per_event"][way]["median"] for grid in grids]
        rows.append([f"ns per event, {title}", *map(short, medians)])
    whole = report["whole_window"]
    sentence = (
        f"A window of {whole['events']:,} events on 1280 x 720, opened, filled and read: "
        f"{short(whole['ns_per_event']['median'])} ns per event."
    )
    sizes = [" x ".join(map(str, grid["grid"])) for grid in grids]
    return f"{table(['', *sizes], rows)}\n\n{sentence} {about_machine(report)}"


def memory() -> str:
    """A sentence on the growth of memory in a long stream."""
    report = results("memory")
    return (
        f"After {report['events'] / 1e6:.0f} million events and {report['decisions']:,} decisions "
        f"the process has grown by {report['grown_mb']:.1f} MB since the first million."
    )


@of_report("map_times")
def map_times(report: dict[str, Any]) -> str:
    """A table of medians and 99th percentiles of the times of map models, by sensor."""
    models = report["models"]
    cases = {
        "one event": "one more event",
        "1,000 events": "1,000 more",
        "new window": "the first event of a window",
        "dense": "the whole map",
        "onnxruntime_run": "onnxruntime, the whole map",
    }
    rows = []
    for name, model in models.items():
        for sensor, times in model["times_us"].items():
            row = [f"{name}, {sensor}"]
            for case in cases:
                us = times.get(case)
                row.append("" if us is None else f"{short(us['median'])} ({short(us['p99'])})")
            rows.append(row)
    return table(["microseconds", *cases.values()], rows)


@of_report("map_times")
def map_load(report: dict[str, Any]) -> str:
    """A table of processor seconds for each second of a stream, by number of objects."""
    models = report["models"]
    numbers = next(iter(models.values()))["load"]
    rows = [
        [name, *(f"{row['load'][n]:.2f}" for n in numbers)]
        for name, row in models.items()
        if row["load"]
    ]
    return table(["", *(f"{n} objects" if n != "1" else "one object" for n in numbers)], rows)


@of_report("threads")
def threads(report: dict[str, Any]) -> str:
    """A table of how much faster two streams are in two threads than one after the other.

    Sentences follow on the spread of the ratios, and on the time to wake a thread.
    """
    titles = {
        "volume": "`TNTVolume`",
        "windows": "`Processor`",
        "every_us": "`Processor`, a decision every millisecond",
    }
    head = ["packets of", *(f"{int(n):,}" for n in report["volume"])]
    rows = []
    distances = []
    for case, title in titles.items():
        ratios = list(report[case].values())
        rows.append([title, *(f"{ratio['median']:.2f}" for ratio in ratios)])
        distances += [abs(ratio[q] - ratio["median"]) for ratio in ratios for q in ("q1", "q3")]
    sentence = (
        f"Quartiles lie up to {max(distances):.2f} from the medians. "
        f"A thread that waits for Python's lock runs on {report['wake_us']:.0f} us after it is "
        "released."
    )
    return f"{table(head, rows)}\n\n{sentence}"


@of_report("sustained")
def sustained(report: dict[str, Any]) -> str:
    """A table of delays and counts by load, with sentences on the sustained rate and machine."""
    seconds = report["seconds"]
    rows = []
    for load, stream in report["streams"].items():
        delays = (f"{ms:.2f}" for ms in (*stream["delay_ms"].values(), stream["worst_ms"]))
        rarer = "" if stream["slowest"] == 1 else f"up to {stream['slowest']} times rarer"
        counts = (
            f"{stream['decisions']:,}",
            rarer,
            percent(stream["skipped"] / stream["received"]),
            f"{stream['grown_mb']:.1f}",
        )
        rows.append([load, f"{stream['received'] / seconds:,.0f}", *delays, *counts])
    every = "event" if report["every_events"] == 1 else f"{report['every_events']} events"
    head = ["load", "events a second", "delay, ms: median", "99 %", "99.9 %", "worst"]
    rates = ", ".join(f"{int(rate):,}" for rate in report["share_of_core"])
    sentence = (
        f"`{report['model']}`, a decision after every {every}, if need be rarer; {seconds} seconds "
        f"for each load; `KeepUp` skips what is older than {report['max_delay_us'] / 1e3:.0f} ms. "
        f"{report['sustained']:,.0f} events a second take one core, {report['event_us']:.1f} us "
        f"each, by a line through the processor times at {rates} events a second."
    )
    loads = table([*head, "decisions", "rarer", "skipped", "MB more"], rows)
    return f"{sentence}\n\n{loads}\n\n{about_machine(report, threads='two threads')}"
