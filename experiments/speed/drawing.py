"""The picture of `experiments/decisions.py`.

The picture shows microseconds per decision against the number of events since the previous
decision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from async_tnt.views.figure_style import (
    LARGE,
    NORMAL,
    OFF,
    ON,
    SMALL,
    TEXT,
    axes_at,
    headline,
    new_figure,
    note,
    write_at,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GREEN = "#009E73"
"""Green of Okabe and Ito's colours."""

PINK = "#B5548F"
"""Pink after Okabe and Ito. It is darker than theirs, because words are written in it."""

ORANGE = "#B87A00"
"""Orange after Okabe and Ito. It is darker than theirs, because words are written in it."""

ONNXRUNTIME = ("onnxruntime_run", "onnxruntime_binding")
"""Ways of calling onnxruntime. The faster one is drawn."""

NETWORKS = {
    "incremental": ("async_tnt,\nincremental", ON),
    "dense": ("async_tnt,\nfull forward pass", ORANGE),
    "onnxruntime_run": ("onnxruntime", OFF),
    "onnxruntime_binding": ("onnxruntime", OFF),
    "openvino": ("OpenVINO", GREEN),
    "torch": ("torch", PINK),
}
"""Engine -> its words and colour."""

WAYS = {
    "ours": ("async_tnt, push and fire", ON),
    "ours_onnxruntime": ("async_tnt's volume,\nonnxruntime's network", ORANGE),
    "torch": ("torch, volume and network\nof the whole window", PINK),
    "eventcv_onnxruntime": ("eventcv's grid of the whole\nwindow, onnxruntime", OFF),
}
"""Way from a packet to a decision -> its words and colour."""


def draw_decisions(report: dict[str, Any]) -> Figure:
    """Draw two panels with one logarithmic axis, for the network alone and for whole decisions.

    A whole decision takes the time from a packet to the decision. Lines show medians and quartiles
    in blocks, and have a name at their end. Hollow marks show medians from call to call.
    """
    figure = new_figure(4.8)
    left = axes_at(figure, 0.73, 0.82, 3.02, 3.07)
    right = axes_at(figure, 5.67, 0.82, 2.7, 3.07, sharey=left)
    slower = {name for name in ONNXRUNTIME if name != report["settings"]["onnxruntime_way"]}
    networks = {name: look for name, look in NETWORKS.items() if name not in slower}
    ends = [
        draw_lines(left, report["network"], networks),
        draw_lines(right, report["end_to_end"], WAYS),
    ]
    lay_axis(left)
    for axes, named in zip((left, right), ends, strict=True):
        _name_lines(axes, named)
    left.set_title("the network alone", loc="left", fontsize=LARGE)
    right.set_title("from a packet of events to the decision", loc="left", fontsize=LARGE)
    left.set_ylabel("microseconds per decision")
    name = report["model"]["name"]
    config = report["model"]["config"]
    size = f"{config['bins']} x {config['grid'][1]} x {config['grid'][0]}"
    headline(figure, f"Time per decision, model {name} ({size})")
    words = (
        f"filled: medians and quartiles in blocks of {report['settings']['decisions_a_block']} "
        "calls; hollow: medians when backends alternate from call to call.\n"
        f"{report['machine']['cpu']}, one thread."
    )
    write_at(figure, 0.73, 4.7, words, fontsize=SMALL, color=TEXT, va="bottom")
    return figure


def draw_lines(
    axes: Any, rows: dict[str, Any], looks: dict[str, tuple[str, str]]
) -> list[tuple[float, str, str]]:
    """Draw a line for each row of `looks` that was timed.

    Returns for each line the microseconds at its end, its words and its colour.
    """
    counts = list(rows)
    shown = [name for name in looks if name in rows[counts[0]]["in_blocks"]["us"]]
    ends = []
    for k, name in enumerate(shown):
        label, colour = looks[name]
        blocks = [rows[n]["in_blocks"]["us"][name] for n in counts]
        medians = [us["median"] for us in blocks]
        whiskers = [
            [us["median"] - us["q1"] for us in blocks],
            [us["q3"] - us["median"] for us in blocks],
        ]
        # moved a little, so that the bars of lines stand beside one another
        x = [place + 0.03 * (k - len(shown) / 2) for place in range(len(counts))]
        is_ours = name in ("incremental", "ours")
        look = {"ms": 6, "lw": 2.4, "zorder": 3} if is_ours else {"ms": 4.5, "lw": 1.4, "zorder": 2}
        axes.errorbar(
            x, medians, yerr=whiskers, color=colour, marker="o", elinewidth=1, capsize=2, **look
        )
        call_medians = [rows[n]["call_by_call"]["us"][name]["median"] for n in counts]
        axes.plot(
            x, call_medians, ls="", marker="o", ms=4.5, mfc="white", mec=colour, mew=1.1, zorder=1
        )
        ends.append((medians[-1], label, colour))
    axes.set_xlim(-0.3, len(counts) - 0.7)
    axes.set_xticks(range(len(counts)), [f"{int(n):,}" for n in counts])
    axes.set_xlabel("new events since the previous decision")
    axes.grid(axis="y", color="#e4e4e4", lw=0.7)
    axes.set_axisbelow(True)
    return ends


def lay_axis(axes: Any) -> None:
    """Make the vertical axis logarithmic, with ticks at 1, 2 and 5 times powers of ten."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    ticks = [
        step * 10**k for k in range(-1, 6) for step in (1, 2, 5) if low <= step * 10**k <= high
    ]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylim(low, high)


def _name_lines(axes: Any, ends: list[tuple[float, str, str]]) -> None:
    """Write the words at the ends of lines. Words that would overlap are moved apart."""
    low, high = axes.get_ylim()
    height_points = axes.get_position().height * axes.get_figure().get_figheight() * 72
    # factor on the logarithmic axis that is the height of a line of words
    line_factor = (high / low) ** (1.25 * NORMAL / height_points)
    lowest_free = 0.0
    for value, label, colour in sorted(ends):
        lines = label.count("\n") + 1
        middle = max(value, lowest_free * line_factor ** (lines / 2))
        lowest_free = middle * line_factor ** (lines / 2)
        look = {"xycoords": ("axes fraction", "data"), "fontsize": NORMAL, "annotation_clip": False}
        note(axes, label, (1, middle), (6, 0), va="center", color=colour, **look)
