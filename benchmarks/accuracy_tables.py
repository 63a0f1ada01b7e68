"""The tables of accuracy: of the bundled model, from its record, and of the thesis' experiment, from table.json."""

from __future__ import annotations

from typing import Any

from page_parts import percent, results, table

from async_tnt import load_model
from async_tnt.training.table_report import markdown_table, motions_table

WINDOWS = {"test": "from 0", "test_windows_from_first_event": "from the first event"}


def accuracy() -> str:
    """`digits` in short: how often it is right, and how soon."""
    found = results("early")["results"]
    rows = []
    for group, key, values, words in (
        ("moment", "every_us", (30_000, 50_000), "at {:.0f} ms"),
        ("confidence", "confidence", (0.8, 0.9, 0.95), "once its probability reaches {:g}"),
    ):
        for r in found[group]:
            value = r["settings"].get(key)
            if value in values:
                shown = words.format(value / 1000 if key == "every_us" else value)
                rows.append([f"a window, {shown}", f"{r['mean_ms']:.0f} ms", percent(r["accuracy"])])
    end = found["moment"][-1]
    rows.append(["a window, at its end", f"{end['mean_ms']:.0f} ms", percent(end["accuracy"])])
    rows.append(["a recording, by the mean of its three windows", "", percent(_record()["test"]["per_recording"])])
    return table(["decided", "mean time", "right"], rows)


def digits_against_time() -> str:
    """Share of test windows that `digits` decides correctly from their first milliseconds."""
    times = list(_record()["test"]["against_time_ms"])
    rows = []
    for part, words in WINDOWS.items():
        found = _record()[part]
        shares = [found["against_time_ms"][ms] for ms in times]
        rows.append([words, *map(percent, (*shares, found["per_window"], found["per_recording"]))])
    return table(["windows", *(f"{ms} ms" for ms in times), "complete", "recordings"], rows)


def digits_confusion() -> str:
    classes = load_model("digits").classes
    counts = _record()["test"]["confusion"]
    rows = [[name, *(str(n or "") for n in row)] for name, row in zip(classes, counts, strict=True)]
    return table(["true \\ decided", *classes], rows)


def digits_tried() -> str:
    """The settings that were compared before `digits` was trained."""
    rows = []
    for run in _record()["tried"]:
        found = run["validation"]
        landmark = run["landmark"] or "none (untransformed volume)"
        rows.append(
            [
                landmark + (", flow removed" if run["remove_flow"] else ""),
                "" if run["t_max"] is None else f"{run['t_max']:g}",
                run["polarity"],
                f"{run['simulated_recordings']:,}",
                "yes" if run["augmentation"] else "no",
                str(run["seed"]),
                *(f"{100 * found[name]:.1f}" for name in ("per_window", "per_recording")),
                *(f"{100 * found['against_time_ms'][ms]:.1f}" for ms in ("20", "30", "50")),
            ]
        )
    head = ["landmark", "t_max", "polarity", "simulated", "augmentation", "seed", "window", "recording"]
    return table([*head, "20 ms", "30 ms", "50 ms"], rows)


def thesis() -> str:
    return markdown_table(results("table")["table"])


def unseen_motion() -> str:
    """A sentence."""
    found = {name: f"{columns['1/all']['mean']:.2f}".lstrip("0") for name, columns in results("table")["table"].items()}
    return (
        f"Trained on one saccade and tested on all three, the accuracy is {found['baseline']} untransformed, "
        f"{found['running']} with `running`, and {found['line']} with `line` and its flow removed."
    )


def motions_1_all() -> str:
    return motions_table(results("table")["table"], "1/all")


def motions_all_sim() -> str:
    return motions_table(results("table")["table"], "all/sim")


def motions_1_sim() -> str:
    return motions_table(results("table")["table"], "1/sim")


def _record() -> dict[str, Any]:
    return load_model("digits").record
