"""The tables of accuracy: of the model `digits`, its early decisions, and unseen motions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from async_tnt import load_model
from experiments.tables.parts import of_report, percent, results, table
from experiments.thesis.numbers import with_range

WINDOWS = {"test": "from 0", "test_windows_from_first_event": "from the first event"}
"""Part of the record of `digits` -> words for where its windows begin."""

SHORT_US = (31_500, 52_500, 105_000)
"""Times since the window's start, in microseconds, that `accuracy` shows."""

LEAST_CONFIDENCE = 0.9
"""The lowest level of confidence that `accuracy` shows."""

HARDLY = 0.03
"""Difference of two accuracies below which there is no gap to close."""


def accuracy() -> str:
    """A short table of `digits`: how often it is right, and how soon."""
    report = results("early")
    rows = []
    for row in report["accuracy_against_time"]:
        if row["time_us"] in SHORT_US:
            decided = f"a window, after {row['time_us'] / 1000:g} ms"
            rows.append([decided, "", percent(row["accuracy"])])
    for row in report["confidence"]:
        if row["level"] >= LEAST_CONFIDENCE:
            decided = f"a window, once a class has {row['level']:g}"
            rows.append([decided, f"{row['median_ms']:.0f} ms", percent(row["window_accuracy"])])
    rows.append(["a recording, by the mean of its windows", "", percent(report["accuracy"])])
    return table(["decided", "median time", "right"], rows)


def digits_against_time() -> str:
    """A table of the share of test windows that `digits` has right, by the time shown of them."""
    times = list(_record()["test"]["against_time_ms"])
    rows = []
    for part, title in WINDOWS.items():
        test = _record()[part]
        shares = [test["against_time_ms"][ms] for ms in times]
        rows.append([title, *map(percent, (*shares, test["per_recording"]))])
    return table(["windows", *(f"{ms} ms" for ms in times), "recordings"], rows)


def digits_confusion() -> str:
    """A table of the number of windows by their class and by the class that `digits` decides."""
    classes = load_model("digits").classes
    counts = _record()["test"]["confusion"]
    rows = [[name, *(str(n or "") for n in row)] for name, row in zip(classes, counts, strict=True)]
    return table(["true \\ decided", *classes], rows)


def digits_tried() -> str:
    """A table of the settings that were compared before `digits` was trained."""
    rows = []
    for run in _record()["tried"]:
        validation = run["validation"]
        landmark = run["landmark"] or "none (untransformed volume)"
        if run["remove_flow"]:
            landmark += ", flow removed"
        t_max = "" if run["t_max"] is None else f"{run['t_max']:g}"
        rows.append(
            [
                landmark,
                t_max,
                run["polarity"],
                f"{run['simulated_recordings']:,}",
                "yes" if run["augmentation"] else "no",
                str(run["seed"]),
                *(f"{100 * validation[name]:.1f}" for name in ("per_window", "per_recording")),
                *(f"{100 * validation['against_time_ms'][ms]:.1f}" for ms in ("20", "30", "50")),
            ]
        )
    head = [
        "landmark",
        "t_max",
        "polarity",
        "simulated",
        "augmentation",
        "seed",
        "window",
        "recording",
    ]
    return table([*head, "20 ms", "30 ms", "50 ms"], rows)


def digits_tried_motions() -> str:
    """A table of the trainings with motion re-synthesis, and of the model bundled before them."""
    rows = []
    for number, run in enumerate(_record()["tried_with_motions"]):
        validation = run["validation"]
        start = run["started_from"]
        rows.append(
            [
                str(number),
                "" if start is None else str(start),
                f"{run['t_max']:g}",
                f"{run['simulated_recordings']:,}",
                f"{100 * (1 - run['recorded']):g} %",
                f"{100 * run['partial']:g} %",
                f"{100 * run['nothing']:g} %",
                str(run["epochs"]),
                *(f"{100 * validation[name]:.1f}" for name in ("per_window", "per_recording")),
                *(f"{100 * validation['against_time_ms'][ms]:.1f}" for ms in ("20", "30", "40")),
                f"{100 * run['validation_motions']:.1f}",
            ]
        )
    head = [
        "",
        "continues",
        "t_max",
        "simulated",
        "other motions",
        "cut early",
        "noise",
        "epochs",
        "window",
    ]
    return table([*head, "recording", "20 ms", "30 ms", "40 ms", "in other motions"], rows)


@of_report("edges")
def edges(report: dict[str, Any]) -> str:
    """A table of the number of events, by the angle between gradient and motion."""
    angles = report["angles_deg"]
    rows = [
        [
            f"{low}-{high}°",
            f"{report['events_per_gradient'][k] / report['events_per_gradient'][0]:.2f}",
            f"{report['cosine'][k] / report['cosine'][0]:.2f}",
            f"{100 * report['polarity_as_expected'][k]:.0f} %",
        ]
        for k, (low, high) in enumerate(pairwise(angles))
    ]
    return table(
        ["between gradient and motion", "events", "cosine", "of the expected polarity"], rows
    )


@of_report("edges")
def polarity(report: dict[str, Any]) -> str:
    """A table of the correlations between the images of two saccades, signed and unsigned."""
    rows = []
    for pair, row in report["between_saccades"].items():
        correlations = [row[name] for name in ("signed", "expected", "unsigned")]
        cells = [f"{value:+.2f}".replace("0.", ".", 1) for value in correlations]
        rows.append([pair.replace("-", " and "), f"{row['angle_deg']:.0f}°", *cells])
    return table(["saccades", "angle", "signed", "of -v · grad L", "unsigned"], rows)


@of_report("published_weights")
def published_weights(report: dict[str, Any]) -> str:
    """A table of the accuracies of others' networks, from their weights, beside published ones."""
    rows = []
    for name, row in report.items():
        shares = [
            f"{row[share]:.3f} of {row[number]:,}".replace("0.", ".", 1)
            for share, number in (("window_accuracy", "windows"), ("accuracy", "recordings"))
        ]
        rows.append([f"`{name}`", *shares, row["published"]])
    return table(["weights", "windows right", "recordings right", "published"], rows)


def share_closed(accuracy: Mapping[str, Any]) -> dict[str, float]:
    """Test of other motions -> the share of the gap that re-synthesis closes.

    The gap is between the accuracy of training on one direction and that of training on all. A test
    with a gap of at most `HARDLY` is left out. Without training on all directions there are no
    gaps.
    """
    if "all directions" not in accuracy:
        return {}
    closed = {}
    for test in accuracy["recorded"]:
        means = {mode: tests[test]["mean"] for mode, tests in accuracy.items()}
        gap = means["all directions"] - means["recorded"]
        if test != "recorded motion" and gap > HARDLY:
            closed[test] = (means["resynthesized"] - means["recorded"]) / gap
    return closed


def _unseen(report: dict[str, Any]) -> str:
    """A table of accuracies, with a row for each way to train and a column for each test.

    Cells have the mean over the networks, and the range if there are several networks.
    """
    accuracy = report["accuracy"]
    tests = list(next(iter(accuracy.values())))
    rows = [
        [
            mode,
            str(len(results_by_test[tests[0]]["seeds"])),
            *(with_range(results_by_test[test]["seeds"]) for test in tests),
        ]
        for mode, results_by_test in accuracy.items()
    ]
    closed = share_closed(accuracy)
    if closed:
        rows.append(
            [
                "*of the gap, closed by re-synthesis*",
                "",
                *(percent(closed[test]) if test in closed else "" for test in tests),
            ]
        )
    return table(["trained on", "networks", *(f"tested in {test}" for test in tests)], rows)


unseen_hands = of_report("unseen_hands")(_unseen)
unseen_saccades = of_report("unseen_saccades")(_unseen)
unseen_volumes = of_report("unseen_volumes")(_unseen)
unseen_whole = of_report("unseen_whole")(_unseen)


def unseen_commands() -> str:
    """The commands that train the recorded networks of unseen motions, a line each."""
    lines = []
    for name in ("saccades", "whole", "hands", "volumes"):
        n = len(results(f"unseen_{name}")["seeds"])
        json = f"experiments/results/unseen_{name}.json"
        lines.append(f"experiments.unseen_motions --set {name} --seeds {n} --json {json}")
    return "\n".join(lines)


@of_report("found_paths")
def found_paths(report: dict[str, Any]) -> str:
    """A table of the shares of windows in which a path is found, and in which it is right."""
    rows = []
    for name, row in report["rows"].items():
        shares = (
            percent(row[key]) if row.get(key) is not None else ""
            for key in ("found", "right", "opposite")
        )
        rows.append([name, str(row["windows"]), *shares])
    return table(["", "windows", "path found", "right of these", "opposite"], rows)


def _record() -> dict[str, Any]:
    """The record of `digits`."""
    return dict(load_model("digits").record)


@of_report("nothing")
def nothing(report: dict[str, Any]) -> str:
    """A table of how often windows are decided that show none of the classes."""
    rows = []
    for name, row in report["rows"].items():
        # some sets were measured by a version that did not report moments
        moments = row.get("at_some_moment", {})
        shares = (percent(moments[level]) if level in moments else "-" for level in ("0.9", "0.99"))
        rows.append([name, f"{row['windows']:,}", percent(row["decided"]), *shares])
    head = [
        "in the window",
        "windows",
        f"decided by {report['model']}",
        "at some moment",
        ".99 at some moment",
    ]
    return table(head, rows)


@of_report("early")
def early(report: dict[str, Any]) -> str:
    """A table of early decisions, by time and by confidence."""
    rows = [
        [f"after {row['time_us'] / 1000:g} ms", percent(row["accuracy"])]
        for row in report["accuracy_against_time"]
    ]
    for row in report["confidence"]:
        shares = (percent(row[name]) for name in ("window_accuracy", "decided", "accuracy"))
        rows.append(
            [
                f"once a class has {row['level']:g}",
                *shares,
                f"{row['median_ms']:.0f}",
                f"{row['p90_ms']:.0f}",
            ]
        )
    head = [
        "decided",
        "windows right",
        "that reach it",
        "of these right",
        "median ms",
        "90 % by, ms",
    ]
    return table(head, [row + [""] * (len(head) - len(row)) for row in rows])
