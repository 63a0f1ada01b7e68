"""The tables of windows that slide."""

from __future__ import annotations

from typing import Any

from experiments.tables.parts import about_machine, of_report, short, table

sliding_machine = of_report("sliding")(about_machine)


@of_report("sliding")
def sliding_events(report: dict[str, Any]) -> str:
    """A table of nanoseconds an event, by sensor and kind of window."""
    rows = []
    for sensor, numbers in report["events"].items():
        for name, ns in numbers["ns"].items():
            ratio = numbers["ratio"][name]
            cells = [f"{ns['median']:.1f}", f"{ns['q1']:.1f} to {ns['q3']:.1f}"]
            rows.append([sensor, name, *cells, f"{ratio['median']:.2f}"])
    head = ["sensor", "window", "ns an event", "quartiles", "of a growing one with these bins"]
    return table(head, rows)


@of_report("sliding")
def sliding_decisions(report: dict[str, Any]) -> str:
    """A table of microseconds a decision, by kind of window."""
    rows = []
    for name, us in report["decisions"]["us"].items():
        quartiles = f"{short(us['q1'])} to {short(us['q3'])}"
        n = report["decisions"]["multiplications"][name]
        rate = 1e-3 * n / us["median"]
        cells = [short(us["median"]), quartiles, short(us["p99"])]
        rows.append([name, *cells, f"{1e-6 * n:.2f}", f"{rate:.0f}"])
    head = ["window", "us a decision", "quartiles", "99 %", "10^6 multiplications", "10^9 a second"]
    return table(head, rows)
