"""The picture of `datasets.py`: how soon, and after how few events, the networks of one recipe are right."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.views.figure_style import GREY, OFF, ON, PALE, axes_at, headline, new_figure, note

HEIGHT, TOP, SIDE, LEFT, STEP = 3.4, 0.6, 2.2, 0.75, 3.35


def draw(report: dict[str, Any]) -> Any:
    """Accuracy against time, against the number of events, and against what a confidence costs."""
    tests = next(iter(report["recipes"].values()))["tests"]
    end_ms = max(float(ms) for ms in tests[0]["against_time_ms"])
    figure = new_figure(HEIGHT)
    headline(figure, f"{report['title']}, test part, {len(tests)} networks")
    time, events, levels = (axes_at(figure, LEFT + STEP * k, TOP, 2.75, SIDE) for k in range(3))
    for k, test in enumerate(tests):
        look = {"color": OFF, "linewidth": 1, "alpha": 0.6, "label": "each network" if not k else None}
        time.plot([float(ms) for ms in test["against_time_ms"]], list(test["against_time_ms"].values()), **look)
        rows = [row for row in test["accuracy_against_events"] if row["reached"]]
        events.plot([row["events"] for row in rows], [row["accuracy"] for row in rows], **look)
    for name, share in report["others"].items():
        time.plot(end_ms, share, marker="o", markersize=4, color=ON, clip_on=False)
        note(time, name, (end_ms, share), (-6, -3 if share < 0.94 else 3), ha="right", color=ON)
    found = [list(rows) for rows in zip(*(test["confidence"] for test in tests), strict=True)]
    found = [rows for rows in found if all(row["median_ms"] is not None for row in rows)]  # that windows reach
    ms = [np.mean([row["median_ms"] for row in rows]) for rows in found]
    for name, colour, words in (("accuracy", OFF, "right of these"), ("decided", GREY, "windows that reach it")):
        levels.plot(ms, [np.mean([row[name] for row in rows]) for rows in found], "o-", color=colour, ms=3, label=words)
    for rows, x in zip(found, ms, strict=True):
        if rows[0]["level"] >= 0.9:
            note(levels, f"{rows[0]['level']:g}", (x, np.mean([row["accuracy"] for row in rows])), (3, -11))
    time.set(xlabel="ms since the first event", ylabel="right", xlim=(0, 1.02 * end_ms))
    events.set(xlabel="first events of the window", xscale="log")
    events.xaxis.set_major_formatter(lambda count, _: f"{count:,.0f}")
    levels.set(xlabel="median ms until a confidence is reached", xlim=(0, None))
    for axes in (time, events, levels):
        axes.set_ylim(0.5, 1.02)
        axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
        axes.grid(color=PALE, linewidth=0.5)
    time.legend(loc="lower right")
    levels.legend(loc="lower right")
    return figure
