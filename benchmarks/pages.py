"""Write the tables of the pages from the JSON files in benchmarks/results.

    python benchmarks/pages.py [--check]

A table stands between `<!-- NAME -->` and `<!-- end -->`, and NAME is one of `TABLES` here. `--check` changes nothing,
and fails with exit code 1 where a page says something else than the results; a test does that, too.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from typing import Any

from accuracy_tables import (
    accuracy,
    digits_against_time,
    digits_confusion,
    digits_tried,
    motions_1_all,
    motions_1_sim,
    motions_all_sim,
    thesis,
    unseen_motion,
)
from page_parts import ROOT, about_machine, percent, results, short, table
from stream_tables import archive, udp_latency, udp_load, udp_machine, udp_overload

from async_tnt.files import write_text

PAGES = ("README.md", "docs/results.md")
BLOCK = re.compile(r"(<!-- (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

NETWORKS = {
    "incremental": "ours, what has changed: `refresh`",
    "dense": "ours, the whole network",
    "onnxruntime_run": "onnxruntime, `run`",
    "onnxruntime_binding": "onnxruntime, io binding",
    "openvino": "OpenVINO",
    "torch": "torch, eager",
}
WAYS = {
    "ours": "ours: `push`, `fire`",
    "ours_onnxruntime": "our volume, onnxruntime's network",
    "torch": "torch: the whole window's volume, its network",
    "eventcv_onnxruntime": "eventcv's voxel grid of all events, onnxruntime",
}
LAYERS = {
    "pooled_1": "places of the first pooled map",
    "pooled_2": "places of the second",
    "partial": "partial sums of the dense layer",
}


def speed() -> str:
    """The short version, for README."""
    found = results("decisions")
    names = {"incremental": "async_tnt", "onnxruntime_binding": "onnxruntime", "openvino": "OpenVINO", "torch": "torch"}
    same = {"incremental": "ours", "onnxruntime_binding": "ours_onnxruntime", "torch": "torch"}
    rows = []
    for n in ("1", "100", "1300"):
        us = found["network"][n]["in_blocks"]["us"]
        events = f"{int(n):,} new event{'s' * (n != '1')}"
        rows.append([f"network, {events}: us", *(short(us[name]["median"]) for name in names)])
    us = found["end_to_end"]["1"]["in_blocks"]["us"]
    rows.append(
        [
            "packet of 1 event to decision: us",
            *(short(us[same[name]]["median"]) if name in same else "" for name in names),
        ]
    )
    packets = found["every_event"]["packets"]
    every = [packets["ours" if name == "incremental" else name]["a_second"] for name in names]
    rows.append(["decisions a second, one after every event", *(f"{a_second:,.0f}" for a_second in every)])
    return table(["", *names.values()], rows)


def decisions_machine() -> str:
    return about_machine(results("decisions"))


def _turns(part: str, mode: str, names: dict[str, str]) -> str:
    rows = results("decisions")[part]
    counts = list(rows)
    head = ["", *("random numbers" if n == "random" else f"{int(n):,} new event{'s' * (n != '1')}" for n in counts)]
    body = []
    for name, words in names.items():
        cells = [words]
        for n in counts:
            us = rows[n][mode]["us"].get(name)
            ratio = rows[n][mode]["ratio"].get(name)
            cells.append(
                ""
                if us is None
                else f"{short(us['median'])} ({short(us['p99'])})" + (f" {ratio['median']:.1f}x" if ratio else "")
            )
        if any(cells[1:]):
            body.append(cells)
    return table(head, body)


def network_in_blocks() -> str:
    return _turns("network", "in_blocks", NETWORKS)


def network_call_by_call() -> str:
    return _turns("network", "call_by_call", NETWORKS)


def end_to_end_in_blocks() -> str:
    return _turns("end_to_end", "in_blocks", WAYS)


def end_to_end_call_by_call() -> str:
    return _turns("end_to_end", "call_by_call", WAYS)


def touched() -> str:
    """What new events change, and what is computed for it."""
    found = results("decisions")["touched"]
    columns = [*(n for n in found if n != "whole"), "whole"]
    head = [
        "means",
        *("the whole network" if n == "whole" else f"{int(n):,} new event{'s' * (n != '1')}" for n in columns),
    ]
    rows = [["cells of the volume that change", *(_count(found[n]["changed"]["input"]) for n in columns)]]
    for layer, words in LAYERS.items():
        rows.append([f"{words} computed", *(_count(found[n]["reached"][layer]) for n in columns)])
    rows.append(["multiplications, thousands", *(f"{found[n]['multiplications'] / 1e3:,.0f}" for n in columns)])
    rows.append(["weights read, kB", *(f"{found[n]['weight_bytes'] / 1e3:,.0f}" for n in columns)])
    return table(head, rows)


def _count(value: float) -> str:
    return f"{value:,.0f}" if value == int(value) else short(value)


def every_event() -> str:
    """Decisions a second."""
    names = NETWORKS | {"ours": "ours: `Processor(model, every_events=1)`"}
    rows = results("decisions")["every_event"]["packets"]
    words = {name: names[name] for name in rows}
    body = [
        [
            words[name],
            f"{row['a_second']:,.0f}",
            short(row["us"]["median"]),
            f"{row['ratio']['median']:.1f}" if "ratio" in row else "",
        ]
        for name, row in rows.items()
    ]
    return table(["", "decisions a second", "us each", "times ours"], body)


def singles() -> str:
    """The tail of single decisions."""
    names = {
        "collector": "garbage collector as users have it",
        "no_collector": "without it",
        "machine": "additions in Python that take as long",
    }
    rows = results("decisions")["every_event"]["singles"]
    body = [
        [
            names[name],
            *(short(row[key]) for key in ("median", "p99", "p999")),
            f"{row['max']:,.0f}",
            f"{row['p99_over_median']:.1f}",
        ]
        for name, row in rows.items()
    ]
    first = f"us, {rows['collector']['n']:,} decisions each"
    return table([first, "median", "p99", "p99.9", "max", "p99 / median"], body)


def starts() -> str:
    """Seconds to a first decision."""
    names = {
        "ours_cold": "ours, nothing compiled yet",
        "ours_warm": "ours, compiled before",
        "onnxruntime": "onnxruntime",
        "torch": "torch",
    }
    steps = {
        "import": "import",
        "load": "load the model",
        "warmup": "`warmup`",
        "decision": "first decision",
        "first_decision": "all of it",
    }
    body = [
        [names[name], *(f"{row[step]['median']:.3f}" if step in row else "" for step in steps)]
        for name, row in results("decisions")["starts"].items()
    ]
    return table(["seconds", *steps.values()], body)


def early() -> str:
    """A choice of settings."""
    found = results("early")
    moments = {r["settings"].get("every_us", found["window_us"]): r for r in found["results"]["moment"]}
    chosen = [(f"at {us / 1000:g} ms", moments[us]) for us in (20_000, 30_000, 40_000, 50_000, found["window_us"])]
    for group, words in (
        ("confidence", ""),
        ("confidence_every_10_events", ", looked for every 10 events"),
        ("confidence_every_ms", ", looked for every 1 ms"),
    ):
        for r in found["results"][group]:
            if r["settings"]["confidence"] in (0.5, 0.8, 0.9, 0.95, 0.98):
                chosen.append((f"confidence {r['settings']['confidence']:g}{words}", r))
    head = [
        "decided",
        "right",
        "mean ms",
        "median ms",
        "a fixed moment as often right, ms",
        "evaluations up to it",
        "decisions a window",
        "not before the end",
    ]
    rows = []
    for words, r in chosen:
        moment = same_moment_ms(found, r["accuracy"]) if words.startswith("confidence") else ""
        rows.append(
            [
                words,
                percent(r["accuracy"]),
                short(r["mean_ms"]),
                short(r["median_ms"]),
                moment,
                short(r["evaluations_until"]),
                short(r["emitted"]),
                percent(r["at_end"]),
            ]
        )
    return table(head, rows)


def same_moment_ms(found: dict[str, Any], accuracy: float) -> str:
    """The first fixed moment at which so many are right, on straight lines between those measured; "" where none is."""
    last_ms, last = 0.0, 0.0
    for r in found["results"]["moment"]:
        ms = r["settings"].get("every_us", found["window_us"]) / 1000
        if r["accuracy"] >= accuracy:
            return short(last_ms + (ms - last_ms) * (accuracy - last) / (r["accuracy"] - last))
        last_ms, last = ms, r["accuracy"]
    return ""


def of_nothing() -> str:
    """A sentence."""
    share = results("early")["of_nothing"]
    return f"Of an empty volume it says nothing for sure: the likeliest class has a probability of {share:.2f}."


def soon() -> str:
    """Whether confidence alone falls for a window's first events."""
    found = results("early")
    rows = [
        [
            f"{r['settings']['confidence']:g}",
            str(r["fewest_events"]),
            percent(r["soon"]),
            "" if r["soon_accuracy"] is None else percent(r["soon_accuracy"]),
            percent(noise["closed_early"]),
        ]
        for r, noise in zip(found["results"]["confidence"], found["noise"], strict=True)
    ]
    return table(
        [
            "confidence, looked for at every event",
            "fewest events of a decision",
            f"decided by fewer than {found['soon_events']} events",
            "of these right",
            "windows of noise decided",
        ],
        rows,
    )


PEERS = {
    "eventcv": "eventcv",
    "tonic": "tonic",
    "dsec_torch": "DSEC's method in torch",
    "torch_scatter": "torch with the transform, one `scatter_add_`",
}


def memory() -> str:
    """A sentence."""
    found = results("memory")
    return (
        f"After {found['events'] / 1e6:.0f} million events and {found['decisions']:,} decisions the process has grown "
        f"by {found['grown_mb']:.1f} MB since the first million. `benchmarks/memory.py` exits with 1 above "
        f"{found['limit_mb']:g} MB."
    )


def volumes() -> str:
    """Nanoseconds per event, and peers."""
    ways = {
        "single": "`update_one`",
        "packet_10_columns": "packets of 10, columns",
        "packet_1300_columns": "packets of 1300, columns",
        "packet_1300_structured": "packets of 1300, structured",
    }
    grids = results("bench")["volume"]
    rows = [
        [f"ns per event, {words}", *(short(v["ns_per_event"][way]["median"]) for v in grids)]
        for way, words in ways.items()
    ]
    return table(_grids(), rows + _peers("packets of 1300, volume read after each: {} / ours"))


def _grids() -> list[str]:
    return ["", *("{} x {}".format(*v["grid"]) for v in results("bench")["volume"])]


def _peers(words: str) -> list[list[str]]:
    small = [r for r in results("peers")["results"] if r["events_a_packet"] == 1300]
    return [
        [words.format(peer), *(short(r["rows"][name]["times_ours_update_read"]) for r in small)]
        for name, peer in PEERS.items()
        if name in small[0]["rows"]
    ]


def large_packets() -> str:
    """A volume of one large packet: peers over ours."""
    large = [r for r in results("peers")["results"] if r["events_a_packet"] != 1300]
    head = ["one packet", *("{} x {}, ".format(*r["grid"]) + f"{r['events_a_packet']:,} events" for r in large)]
    rows = [
        [f"{peer} / ours, window {words}", *(short(r["rows"][name][ratio]) for r in large)]
        for ratio, words in (("times_ours_update_read", "open"), ("times_ours_fresh", "new"))
        for name, peer in PEERS.items()
        if name in large[0]["rows"]
    ]
    return table(head, rows)


def splat() -> str:
    """Events into a volume: ours and the peers', packets of 1300 and whole windows."""
    found = _by_packet()
    head = ["", *found]
    ours = {"ours_update": "ours", "ours_update_read": "ours, volume read after each packet"}
    rows = [
        [f"{words}, ns an event", *(short(rows[name]["ns_per_event"]["median"]) for rows in found.values())]
        for name, words in ours.items()
    ]
    for name, words in PEERS.items():
        cells = []
        for peers in found.values():
            theirs = peers[name]["ns_per_event"]["median"]
            cells.append(" / ".join(short(theirs / peers[row]["ns_per_event"]["median"]) for row in ours))
        rows.append([f"{words}: times ours / ours read", *cells])
    return table(head, rows)


def _by_packet() -> dict[str, dict[str, Any]]:
    return {
        "{} x {}".format(*r["grid"]) + f", packets of {r['events_a_packet']:,}": r["rows"]
        for r in results("peers")["results"]
    }


TABLES: dict[str, Callable[[], str]] = {
    f.__name__: f
    for f in (
        accuracy,
        speed,
        digits_against_time,
        digits_confusion,
        digits_tried,
        thesis,
        unseen_motion,
        motions_1_all,
        motions_all_sim,
        motions_1_sim,
        decisions_machine,
        network_in_blocks,
        network_call_by_call,
        end_to_end_in_blocks,
        end_to_end_call_by_call,
        touched,
        every_event,
        singles,
        starts,
        early,
        of_nothing,
        soon,
        volumes,
        splat,
        large_packets,
        udp_machine,
        udp_latency,
        udp_load,
        udp_overload,
        archive,
        memory,
    )
}


def written(page: str) -> str:
    """A page with its tables as the results have them.

    Raises
    ------
    ValueError : it asks for a table that is not in `TABLES`.
    """

    def replaced(block: re.Match[str]) -> str:
        if block[2] not in TABLES:
            raise ValueError(f"no table {block[2]!r}; there are {', '.join(TABLES)}")
        return f"{block[1]}{TABLES[block[2]]()}\n{block[3]}"

    return BLOCK.sub(replaced, page)


def main(argv: list[str] | None = None) -> int:
    """Write the pages, or see whether they are right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 if something would change")
    args = parser.parse_args(argv)
    stale = False
    for page in PAGES:
        path = ROOT / page
        before = path.read_text(encoding="utf-8")
        after = written(before)
        if after == before:
            continue
        stale = True
        print(f"{page}: {'is not what the results say' if args.check else 'written'}")
        if not args.check:
            write_text(path, after)
    return int(stale and args.check)


if __name__ == "__main__":
    sys.exit(main())
