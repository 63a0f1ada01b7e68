"""The tables of four networks that are computed where they changed, from incremental.json."""

from __future__ import annotations

from decision_tables import NETWORKS
from page_parts import about_machine, results, short, table


def incremental_machine() -> str:
    return about_machine(results("incremental"))


def incremental_times() -> str:
    """Microseconds of a decision, in blocks, by network and new events."""
    body = []
    for network, row in results("incremental")["networks"].items():
        volume = " x ".join(map(str, row["volume"]))
        for n_new, found in row["network"].items():
            us, ratio = found["in_blocks"]["us"], found["in_blocks"]["ratio"]
            cells = [f"{short(us['incremental']['median'])} ({short(us['incremental']['p99'])})"]
            cells += [
                f"{short(us[name]['median'])} ({short(us[name]['p99'])}) {ratio[name]['median']:.1f}x"
                for name in NETWORKS
                if name in ratio
            ]
            body.append([f"`{network}`, {volume}" if n_new == "1" else "", f"{int(n_new):,}", *cells])
    names = [words for name, words in NETWORKS.items() if name in us]
    return table(["network", "new events", *names], body)


def incremental_work() -> str:
    """Multiplications of a decision, memory, and decisions a second."""
    body = []
    for network, row in results("incremental")["networks"].items():
        counts = [row["touched"][n]["multiplications"] / 1e6 for n in ("1", "10", "100", "1300", "whole")]
        memory = [f"{sum(row['bytes'][part] for part in parts) / 1e3:,.0f}" for parts in (("weights",), MAPS)]
        rates = row["every_event"]
        onnx = max((rates[name]["a_second"] for name in rates if name != "ours"), default=None)
        second = [f"{rates['ours']['a_second']:,.0f}", "" if onnx is None else f"{onnx:,.0f}"]
        body.append([f"`{network}`", *(f"{n:.2f}" for n in counts), *memory, *second])
    head = ["1 new event", "10", "100", "1,300", "the whole network", "weights, kB", "maps, kB"]
    return table(["million multiplications", *head, "decisions a second, one after every event", "onnxruntime"], body)


MAPS = "maps", "places", "program"
TABLES = (incremental_machine, incremental_times, incremental_work)
