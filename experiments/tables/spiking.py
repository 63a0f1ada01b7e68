"""The tables of spiking networks: accuracy, agreement with simulators, bins, cost, conversion."""

from __future__ import annotations

from typing import Any

from experiments.tables.parts import about_machine, of_report, percent, short, table


@of_report("spiking")
def spiking_accuracy(report: dict[str, Any]) -> str:
    """A table of the accuracy event by event, which was measured, and of the published ones."""
    part = report.get("accuracy")
    if part is None:
        return "not measured"
    n = f"{part['right']:,} of {part['recordings']:,} recordings"
    rows = [["async_tnt, event by event", "measured", percent(part["accuracy"]), n]]
    for name, share in part["published"].items():
        rows.append([name, "published", percent(share), "the official test"])
    return table(["", "", "right", "of"], rows)


@of_report("spiking")
def spiking_agreement(report: dict[str, Any]) -> str:
    """A table of the spikes that were compared, and of differences."""
    rows = []
    for name, row in report.get("agreement", {"rows": {}})["rows"].items():
        cells = [name, f"{row['recordings']:,}", f"{row['events']:,}"]
        cells.append(f"{sum(row['spikes'].values()):,}")
        cells += [str(row["deviations"]), str(row["deviations_near"])]
        cells += [f"{row['largest_difference']:.1g}", f"{row['nearest']:.1g}"]
        rows.append(cells)
    head = [
        "",
        "recordings",
        "events",
        "spikes",
        "recordings that differ",
        "that differ at a threshold",
        "largest difference of membranes",
        "nearest to a threshold",
    ]
    return table(head, rows)


@of_report("spiking")
def spiking_bins(report: dict[str, Any]) -> str:
    """A table of the accuracy of a simulator by the width of its time steps."""
    by_floor = report.get("bins", {"accuracy": {}})["accuracy"]
    if not by_floor:
        return "not measured"
    without, floor = by_floor["no floor"], by_floor["floor"]
    rows = []
    for ms, row in without.items():
        name = "an event a step" if ms == "event" else f"{ms} ms"
        cells = [name, f"{row['recordings']:,}", short(row["steps_a_recording"])]
        cells += [percent(row["accuracy"]), percent(floor[ms]["accuracy"])]
        rows.append(cells)
    head = [
        "a time step",
        "recordings",
        "steps of each",
        "right",
        "right, membranes of at least -1",
    ]
    return table(head, rows)


@of_report("spiking")
def spiking_work(report: dict[str, Any]) -> str:
    """A table of spikes and synaptic operations an event, by layer."""
    part = report.get("accuracy")
    if part is None:
        return "not measured"
    operations = part["operations_an_event"]
    spikes = part["spikes_an_event"]
    rows = [
        [str(k + 1), f"{operations[name]:.0f}", f"{spikes[name]:.2f}"]
        for k, name in enumerate(operations)
    ]
    totals = sum(operations.values()), sum(spikes.values())
    rows.append(["all layers", f"{totals[0]:,.0f}", f"{totals[1]:.2f}"])
    relus = report.get("cost", {}).get("relu_multiplications", {})
    words = {"1": "network of ReLUs, after an event", "whole": "network of ReLUs, a whole pass"}
    rows += [[words[name], f"{n:,.0f}", "-"] for name, n in relus.items()]
    head = ["layer", "synaptic operations or multiplications", "spikes an event"]
    return table(head, rows)


@of_report("spiking")
def spiking_times(report: dict[str, Any]) -> str:
    """A table of the times of an event or time step, and of a recording."""
    part = report.get("cost")
    if part is None:
        return "not measured"
    rows = []
    for unit, words in (("event_us", "us"), ("recording_ms", "ms")):
        for name, times in part[unit].items():
            quartiles = f"{short(times['q1'])} to {short(times['q3'])}"
            what = "an event" if unit == "event_us" else "a recording"
            rows.append([what, name, f"{short(times['median'])} {words}", quartiles])
    return table(["time of", "", "median", "quartiles"], rows)


@of_report("spiking")
def spiking_machine(report: dict[str, Any]) -> str:
    """A sentence on the machine of the times, and the versions of simulators."""
    part = report.get("cost")
    if part is None:
        return "not measured"
    versions = [
        f"{name} {part['machine'][name]}"
        for name in ("sinabs", "norse", "snntorch", "nir")
        if part["machine"].get(name)
    ]
    return f"{about_machine(part)} {', '.join(versions)}."


@of_report("spiking")
def spiking_conversion(report: dict[str, Any]) -> str:
    """A table of the accuracy of a network of ReLUs, and of spiking networks made of it."""
    part = report.get("conversion")
    if part is None:
        return "not measured"
    rows = []
    for name, counts in part["rows"].items():
        cells = [name]
        for unit in ("windows", "recordings"):
            right = counts[f"{unit}_right"]
            cells.append(f"{percent(right / counts[unit])} of {counts[unit]:,}")
        rows.append(cells)
    return table(["", "windows right", "recordings right"], rows)


@of_report("spiking_first_kernel")
def spiking_first_kernel(report: dict[str, Any]) -> str:
    """A table of the times of an event beside those of the first kernel."""
    rows = []
    for name, one in next(iter(report["figures"].values())).items():
        cells = [name, short(one["before"]), short(one["now"]), f"{one['ratio']:.2f}"]
        cells.append(f"{one['least']:.2f} to {one['most']:.2f}")
        rows.append(cells)
    return table(["", "first kernel", "now", "ratio", "smallest to largest"], rows)
