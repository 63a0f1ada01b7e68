"""The tables of published networks: which became models, and what an event costs there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from statistics import median
from typing import Any

from experiments.tables.parts import of_report, table

SOURCES = {
    "events": "papers on event cameras",
    "torchvision": "torchvision",
    "timm": "timm",
    "segmentation": "segmentation-models-pytorch",
}
"""Source of networks in the list -> its name."""


def counts(report: Mapping[str, Any]) -> str:
    """A sentence that counts the networks that were accepted, and wrong ones."""
    accepted = Counter(
        way for numbers in report.values() for way in ("torch", "onnx") if not numbers[way]
    )
    both = sum(not numbers["torch"] and not numbers["onnx"] for numbers in report.values())
    wrong = sum(numbers.get("wrong_bits", 0) > 0 for numbers in report.values())
    return (
        f"{len(report)} networks: {accepted['torch']} accepted from torch, {accepted['onnx']} from "
        f"ONNX, {both} from both; {wrong} with bits that differ from a whole pass."
    )


zoo_counts = of_report("zoo")(counts)


@of_report("zoo")
def zoo_in_short(report: Mapping[str, Any]) -> str:
    """A table of the networks of each source: how many became models, and what an event costs."""
    rows = []
    for source, title in SOURCES.items():
        networks = [numbers for numbers in report.values() if numbers["source"] == source]
        if not networks:
            continue
        taken = [numbers for numbers in networks if not numbers["torch"]]
        both = sum(not numbers["onnx"] for numbers in taken)
        speeds = [numbers["speed"] for numbers in taken if "speed" in numbers]
        cells = [title, str(len(networks)), str(len(taken)), str(both)]
        if speeds:
            ratios = sorted(speed["ratio"] for speed in speeds)
            cells.append(f"{median(speed['share'] for speed in speeds):.0%}")
            cells.append(f"{median(ratios):.2g} ({ratios[0]:.2g} to {ratios[-1]:.2g})")
        else:
            cells += ["-", "-"]
        rows.append(cells)
    head = ["source", "networks", "from torch", "from both", "an event reaches", "times faster"]
    return table(head, rows)


@of_report("zoo")
def zoo_accepted(report: Mapping[str, Any]) -> str:
    """A table of the networks that became models from torch."""
    rows = []
    for name, numbers in report.items():
        if numbers["torch"]:
            continue
        speed = numbers.get("speed")
        cells = [name, "yes" if not numbers["onnx"] else "no", str(numbers["wrong_bits"])]
        cells += [f"{numbers['deviation']:.1g}", f"{numbers['own_deviation']:.1g}"]
        if speed:
            cells += [f"{speed['share']:.1%}", f"{speed['event_us']:,.0f}", f"{speed['ratio']:.2g}"]
        else:
            cells += ["-", "-", "-"]
        rows.append(cells)
    head = [
        "network",
        "from ONNX",
        "bits that differ",
        "deviation from torch",
        "torch's own",
        "an event reaches",
        "us an event",
        "times faster than ONNX Runtime",
    ]
    return table(head, rows)


@of_report("pixel_outputs")
def pixel_outputs(report: Mapping[str, Any]) -> str:
    """A table of the work after an event, and its time beside a whole pass, by sensor."""
    rows = []
    for sensor, numbers in report["sensors"].items():
        cells = [sensor, str(numbers["wrong_bits"])]
        speed = numbers.get("speed")
        if speed:
            cells += [f"{speed['share']:.2%}", f"{speed['event_us']:,.0f}"]
            cells += [f"{speed['onnxruntime_us']:,.0f}", f"{speed['ratio']:,.0f}"]
        else:
            cells += ["-"] * 4
        rows.append(cells)
    head = ["sensor", "bits that differ", "an event reaches", "us an event"]
    return table([*head, "us a pass of ONNX Runtime", "times faster"], rows)


@of_report("zoo")
def zoo_refused(report: Mapping[str, Any]) -> str:
    """A table of the networks that torch or ONNX does not give, with the reason."""
    rows = []
    for name, numbers in report.items():
        for way in ("torch", "onnx"):
            reason = _without_paths(numbers[way])
            if reason and not (way == "onnx" and numbers["torch"]):
                rows.append([name, way, reason])
    return table(["network", "from", "reason"], rows)


def _without_paths(reason: str) -> str:
    """A reason without the name of a temporary file and the advice at its end."""
    reason = reason.partition("; volumes(source, config)")[0]
    if "network.onnx" in reason:
        reason = reason.partition("network.onnx")[2].removeprefix(": ").strip()
    return reason.replace("|", "\\|")
