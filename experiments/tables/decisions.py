"""The tables of the time of decisions and starts, and of the work in four networks."""

from __future__ import annotations

from typing import Any

from experiments.tables.parts import about_machine, of_report, results, short, table

NETWORKS = {
    "incremental": "async_tnt, incremental: `refresh`",
    "dense": "async_tnt, full forward pass",
    "onnxruntime_run": "onnxruntime, `run`",
    "onnxruntime_binding": "onnxruntime, I/O binding",
    "openvino": "OpenVINO",
    "torch": "torch, eager",
}
"""Engine -> its title."""

WAYS = {
    "ours": "async_tnt: `push`, `fire`",
    "ours_onnxruntime": "async_tnt's volume, onnxruntime's network",
    "torch": "torch: the whole window's volume, its network",
    "eventcv_onnxruntime": "eventcv's voxel grid of all events, onnxruntime",
}
"""Way from a packet to a decision -> its title."""

MAPS = ("maps", "places", "program")
"""Arrays of a network that count as memory of its maps, not of its weights."""

decisions_machine = of_report("decisions")(about_machine)
starts_machine = of_report("starts")(about_machine)
incremental_machine = of_report("incremental")(about_machine)


def speed() -> str:
    """README's table of speed.

    Times in one process have two numbers: decisions in a row, and engines that alternate.
    """
    report = results("decisions")
    names = {
        "incremental": "async_tnt",
        "onnxruntime_binding": "onnxruntime",
        "openvino": "OpenVINO",
        "torch": "torch",
    }
    row_of_network = {
        "incremental": "ours",
        "onnxruntime_binding": "ours_onnxruntime",
        "torch": "torch",
    }
    rows = []
    for n in ("1", "100", "1300"):
        events = f"{int(n):,} new event{'s' * (n != '1')}"
        cells = (_both_modes(report["network"][n], name) for name in names)
        rows.append([f"network, {events}: us", *cells])
    cells = (
        _both_modes(report["end_to_end"]["1"], row_of_network[name])
        if name in row_of_network
        else ""
        for name in names
    )
    rows.append(["packet of 1 event to decision: us", *cells])
    every_event_rows = report["every_event"]
    rates = [
        every_event_rows["ours" if name == "incremental" else name]["a_second"] for name in names
    ]
    rows.append(
        ["decisions a second, one after every event", *(f"{a_second:,.0f}" for a_second in rates)]
    )
    return table(["", *names.values()], rows)


def _both_modes(times: dict[str, Any], name: str) -> str:
    """The medians of decisions in a row, and of decisions between those of other engines."""
    medians = (times[mode]["us"][name]["median"] for mode in ("in_blocks", "call_by_call"))
    return " / ".join(map(short, medians))


def _turns(rows: dict[str, Any], mode: str, names: dict[str, str]) -> str:
    """A table of times by number of new events.

    mode : "in_blocks" or "call_by_call".
    names : what was timed -> its title.
    """
    counts = list(rows)
    head = ["", *(f"{int(n):,} new event{'s' * (n != '1')}" for n in counts)]
    body = []
    for name, words in names.items():
        cells = [_cell(rows[n][mode], name) for n in counts]
        if any(cells):
            body.append([words, *cells])
    return table(head, body)


def _cell(times: dict[str, Any], name: str) -> str:
    """A cell with median, 99th percentile, and ratio to the first network.

    The cell is empty if `name` was not timed.
    """
    us = times["us"].get(name)
    if us is None:
        return ""
    text = f"{short(us['median'])} ({short(us['p99'])})"
    ratio = times["ratio"].get(name)
    return f"{text} {ratio['median']:.1f}x" if ratio else text


network_in_blocks = of_report("decisions")(
    lambda report: _turns(report["network"], "in_blocks", NETWORKS)
)
network_call_by_call = of_report("decisions")(
    lambda report: _turns(report["network"], "call_by_call", NETWORKS)
)
end_to_end_call_by_call = of_report("decisions")(
    lambda report: _turns(report["end_to_end"], "call_by_call", WAYS)
)


@of_report("decisions")
def end_to_end_in_blocks(report: dict[str, Any]) -> str:
    """A table of the times from a packet to the decision, in blocks."""
    return _turns(report["end_to_end"], "in_blocks", WAYS)


@of_report("decisions")
def every_event(report: dict[str, Any]) -> str:
    """A table of decisions a second, with a decision after every event."""
    names = NETWORKS | {"ours": "async_tnt: `Processor(model, every_events=1)`"}
    body = [
        [
            names[name],
            f"{row['a_second']:,.0f}",
            short(row["us"]["median"]),
            f"{row['ratio']['median']:.1f}" if "ratio" in row else "",
        ]
        for name, row in report["every_event"].items()
    ]
    return table(["", "decisions a second", "us each", "ratio"], body)


@of_report("starts")
def starts(report: dict[str, Any]) -> str:
    """A table of the seconds to a first decision, by step."""
    names = {
        "ours_cold": "async_tnt, with an empty cache",
        "ours_warm": "async_tnt, with a full cache",
        "onnxruntime": "onnxruntime",
        "torch": "torch",
    }
    steps = {
        "import": "import",
        "load": "load the model",
        "processor": "`Processor`",
        "decision": "first decision",
        "first_decision": "total",
    }
    body = [
        [names[name], *(f"{row[step]['median']:.3f}" if step in row else "" for step in steps)]
        for name, row in report["starts"].items()
    ]
    return table(["seconds", *steps.values()], body)


@of_report("incremental")
def incremental_times(report: dict[str, Any]) -> str:
    """A table of the microseconds of a decision, in blocks, by network and new events."""
    body = []
    for network, row in report["networks"].items():
        volume = " x ".join(map(str, row["volume"]))
        for n_new, times in row["network"].items():
            us = times["in_blocks"]["us"]
            cells = [_cell(times["in_blocks"], name) for name in NETWORKS if name in us]
            body.append(
                [f"`{network}`, {volume}" if n_new == "1" else "", f"{int(n_new):,}", *cells]
            )
    names = [words for name, words in NETWORKS.items() if name in us]
    return table(["network", "new events", *names], body)


@of_report("incremental")
def incremental_work(report: dict[str, Any]) -> str:
    """A table of the multiplications of a decision, of memory, and of decisions a second."""
    body = []
    for network, row in report["networks"].items():
        counts = [
            row["touched"][n]["multiplications"] / 1e6 for n in ("1", "10", "100", "1300", "whole")
        ]
        n_bytes = row["bytes"]
        n_bytes_maps = sum(n_bytes[part] for part in MAPS)
        memory = [f"{n / 1e3:,.0f}" for n in (n_bytes["weights"], n_bytes_maps)]
        rates = row["every_event"]
        fastest_onnx = max(
            (rates[name]["a_second"] for name in rates if name != "ours"), default=None
        )
        others = "" if fastest_onnx is None else f"{fastest_onnx:,.0f}"
        rates_cells = [f"{rates['ours']['a_second']:,.0f}", others]
        body.append([f"`{network}`", *(f"{n:.2f}" for n in counts), *memory, *rates_cells])
    head = [
        "million multiplications",
        "1 new event",
        "10",
        "100",
        "1,300",
        "the whole network",
        "weights, kB",
        "maps, kB",
        "decisions a second, one after every event",
        "onnxruntime",
    ]
    return table(
        head,
        body,
    )


layer_machine = of_report("layer_times")(about_machine)


@of_report("layer_times")
def layer_peak(report: dict[str, Any]) -> str:
    """A sentence on what the core can do at most."""
    peak = report["peak"]["max"]
    lanes = report["settings"]["lanes"]
    return (
        f"At most {peak:.0f} billion multiplications a second, each with an addition, in registers "
        f"of {lanes} numbers."
    )


@of_report("layer_times")
def layer_times(report: dict[str, Any]) -> str:
    """A table of the time and the multiplications of each part of a decision, by new events."""
    models = report["models"]
    numbers = list(next(iter(models.values())))
    peak = report["peak"]["max"]
    body = []
    for name, of_numbers in models.items():
        parts = [row["part"] for row in of_numbers[numbers[0]]]
        for k, part in enumerate(parts):
            cells = [_layer_cell(of_numbers[n_new][k], peak) for n_new in numbers]
            body.append([f"`{name}`" if k == 0 else "", part, *cells])
        totals = []
        for n_new in numbers:
            rows = of_numbers[n_new]
            total = {one: sum(row[one] for row in rows) for one in ("us", "multiplications")}
            totals.append(_layer_cell(total, peak))
        body.append(["", "total", *totals])
    head = [f"{int(n_new):,} new" for n_new in numbers]
    return table(["", "", *head], body)


def _layer_cell(row: dict[str, float], peak: float) -> str:
    """Microseconds, thousands of multiplications, and what share of the peak they are."""
    text = f"{row['us']:.1f}"
    n = row["multiplications"]
    if n <= 0 or row["us"] <= 0:
        return text
    share = 1e-3 * n / row["us"] / peak
    return f"{text} / {1e-3 * n:,.0f} / {share:.0%}".replace("%", " %")


@of_report("box_cost")
def box_cost(report: dict[str, Any]) -> str:
    """A table of a decision with boxes after one event, beside one with points."""
    rows = []
    for sensor, numbers in report["sensors"].items():
        for name, us in numbers["us"].items():
            quartiles = f"{short(us['q1'])} to {short(us['q3'])}"
            cells = [sensor, name, f"{numbers['objects']:.1f}"]
            cells += [short(us["median"]), quartiles, short(us["p99"])]
            cells.append(f"{numbers['ratio']:.2f}" if name == "boxes" else "1")
            rows.append(cells)
    head = ["sensor", "", "objects found", "us a decision", "quartiles", "99 %", "of points"]
    return table(head, rows)
