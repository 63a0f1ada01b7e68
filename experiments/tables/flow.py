"""The tables of optical flow after every event."""

from __future__ import annotations

from typing import Any

from experiments.tables.parts import about_machine, of_report, percent, short, table

flow_machine = of_report("flow")(about_machine)


@of_report("flow")
def flow_errors(report: dict[str, Any]) -> str:
    """A table of endpoint errors by way to flow and test set."""
    tests = report["tests"]
    n = report["settings"]["sequences"]
    rows = []
    for way in next(iter(tests.values()))["ways"]:
        row = [way]
        for test in tests.values():
            errors = test["ways"][way]
            seeds = errors.get("seeds", [])
            others = f" ({', '.join(f'{error:.1f}' for error in seeds[1:])})" if seeds[1:] else ""
            row.append(f"{errors['mean']:.1f} ± {errors['sd']:.1f}{others}")
            row.append(str(errors["better"]))
        rows.append(row)
    head = ["px/s"]
    for name in tests:
        head += [f"scenes {name}", f"network better in, of {n}"]
    return table(head, rows)


@of_report("flow")
def flow_by_age(report: dict[str, Any]) -> str:
    """A table of endpoint errors by the age of the network's window."""
    ages = report["tests"]["as trained"]["by_age_ms"]
    ways = list(next(iter(ages.values())))
    rows = [[way, *(f"{errors[way]:.1f}" for errors in ages.values())] for way in ways]
    return table(["px/s", *(f"{age} ms" for age in ages)], rows)


@of_report("flow")
def flow_along(report: dict[str, Any]) -> str:
    """A table of errors where the plane fit finds a plane, and of their part along its normal."""
    rows = []
    for name, test in report["tests"].items():
        found = test["found"]
        for way, error in found["error"].items():
            numbers = (error, found["along"][way])
            cells = ["-" if number is None else f"{number:.1f}" for number in numbers]
            rows.append([f"{way}, scenes {name}", percent(found["share"]), *cells])
    return table(["px/s", "events with a plane", "error there", "along the normal"], rows)


@of_report("flow")
def flow_planes(report: dict[str, Any]) -> str:
    """A table of the settings of the plane fits, with their errors on the sequences that chose."""
    planes = report["planes"]
    names = [name for name in next(iter(planes.values()))["settings"]]
    rows = [
        [way, *(f"{plane['settings'][name]:g}" for name in names), f"{plane['error']:.1f}"]
        for way, plane in planes.items()
    ]
    return table(["", *names, "error, px/s"], rows)


@of_report("flow")
def flow_times(report: dict[str, Any]) -> str:
    """A table of the times from an event to the flow, and of whole passes."""
    times = report["times"]
    rows = []
    for name, us in times["us"].items():
        ratio = times["ratio"].get(name)
        quartiles = f"{short(us['q1'])} to {short(us['q3'])}"
        cells = [short(us["median"]), quartiles, short(us["p99"])]
        rows.append([name, *cells, "" if ratio is None else f"{ratio:.0f}"])
    return table(["microseconds", "median", "quartiles", "99 %", "times an event"], rows)
