"""The tables of one network for objects of many sizes."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np

from experiments.records.files import RESULTS, read_json
from experiments.tables.decisions import box_cost
from experiments.tables.parts import of_report, percent, results, table

COCO = {"map_50": "mAP .5", "map": "mAP", "map_75": "mAP .75"}
"""Name of a score -> its title."""

AREAS = {"map_small": "below 32x32", "map_medium": "up to 96x96", "map_large": "above"}
"""Name of the mean average precision of boxes of some areas -> the areas, in pixels."""


def _three(values: list[float | None]) -> str:
    """The mean of values with three digits, and their range if there are several; "" without."""
    known = [value for value in values if value is not None]
    if not known:
        return ""
    mean = f"{np.mean(known):.3f}"
    return mean if len(known) == 1 else f"{mean} ({min(known):.3f} to {max(known):.3f})"


@of_report("object_scales")
def object_scales(report: dict[str, Any]) -> str:
    """A table of the scores in made scenes, by sensor and time."""
    rows = []
    models = report["models"]
    for sensor in report["scenes"]:
        scores = [model["scores"][sensor] for model in models]
        for ms in (key for key in scores[0] if key.isdigit()):
            of_time = [one[ms] for one in scores]
            names = ("f1", *COCO, *AREAS)
            cells = [_three([one[name] for one in of_time]) for name in names]
            rows.append([sensor, ms, *cells])
    areas = [f"mAP, {area}" for area in AREAS.values()]
    return table(["sensor", "ms", "F1", *COCO.values(), *areas], rows)


MOMENTS = {
    "10": "10 ms",
    "30": "30 ms",
    "50": "50 ms, the end of the first window",
    "100": "100 ms, the end of the second window",
}
"""Time of a score, in milliseconds -> its title."""


@of_report("object_scales")
def object_scales_in_short(report: dict[str, Any]) -> str:
    """A table of the main scores in made scenes, by time, the sensors side by side."""
    names = ("map_50", "map", "f1")
    rows = []
    for ms, title in MOMENTS.items():
        cells = [title]
        for sensor in report["scenes"]:
            of_models = [model["scores"][sensor][ms] for model in report["models"]]
            cells += [_three([scores[name] for scores in of_models]) for name in names]
        rows.append(cells)
    head = ["after"]
    for sensor in report["scenes"]:
        head += [f"{sensor}: {COCO['map_50']}", COCO["map"], "F1"]
    return table(head, rows)


@of_report("object_scales")
def object_kinds(report: dict[str, Any]) -> str:
    """A table of F1 by kind at the end of the scenes."""
    models = report["models"]
    kinds = list(models[0]["scores"][next(iter(report["scenes"]))]["f1_of_kinds"])
    rows = []
    for sensor in report["scenes"]:
        of_kinds = [model["scores"][sensor]["f1_of_kinds"] for model in models]
        rows.append([sensor, *(_three([one[kind] for one in of_kinds]) for kind in kinds)])
    return table(["sensor", *kinds], rows)


@of_report("object_scales")
def object_mistakes(report: dict[str, Any]) -> str:
    """A table of the objects that are found, and found as their kind, by size."""
    rows = []
    for sensor in report["scenes"]:
        shorter = int(sensor.split("x")[1])
        of_models = [model["scores"][sensor]["mistakes"] for model in report["models"]]
        counts = {
            name: np.sum([one[name] for one in of_models], axis=0)
            for name in ("objects", "found", "right")
        }
        limits = [f"{edge * shorter:.0f}" for edge in of_models[0]["edges"]]
        parts = [f"below {limits[0]} px"]
        parts += [f"{low} to {high} px" for low, high in pairwise(limits)]
        parts.append(f"{limits[-1]} px and more")
        for k, part in enumerate(parts):
            n = counts["objects"][k]
            shares = [percent(counts[name][k] / n) for name in ("found", "right")]
            rows.append([sensor, part, f"{n / len(of_models):.0f}", *shares])
    return table(["sensor", "longer side", "objects", "a box of any kind", "of its kind"], rows)


@of_report("object_scales")
def object_mistaken(report: dict[str, Any]) -> str:
    """A table of the kinds that are taken for others most often, on the first sensor.

    The report has the pairs that each network mistakes most often. Others count as 0, so that the
    means are lower bounds.
    """
    sensor = next(iter(report["scenes"]))
    totals: Counter[tuple[str, str]] = Counter()
    for model in report["models"]:
        for pair in model["scores"][sensor]["mistakes"]["mistaken"]:
            totals[pair["kind"], pair["taken_for"]] += pair["objects"]
    rows = [
        [kind, other, f"{n / len(report['models']):.1f}"]
        for (kind, other), n in totals.most_common(6)
    ]
    return table(["kind", "taken for", "objects, a network, at least"], rows)


def object_cost() -> str:
    """A table of what a decision after one event costs, with boxes and with points."""
    return box_cost(results("box_cost_scales"))


def object_networks() -> str:
    """A table of networks between which was chosen, in scenes of the tuning seed."""
    names = {
        "`boxes`, boxes weigh .3": "object_scales_tuning",
        "`map`, which says no middles of boxes": "object_scales_map",
        "as `boxes`, boxes weigh a tenth of classes": "object_scales_a_tenth",
        "as `boxes`, boxes weigh as much as classes": "object_scales_equal_weights",
        "two levels, boxes weigh as much as classes": "object_scales_two_levels",
    }
    rows = []
    for title, name in names.items():
        report = results(name)
        models = report["models"]
        cells = [title, _made_by(name), str(len(models))]
        cells.append(f"{report['multiplications'] / 1e6:.0f}")
        for sensor in report["scenes"]:
            ends = [model["scores"][sensor]["100"] for model in models]
            cells += [_three([one[name] for one in ends]) for name in ("map_50", "map")]
        rows.append(cells)
    head = ["network", "commit and options", "networks", "million multiplications a pass"]
    for sensor, n in report["scenes"].items():
        head += [f"{n} scenes on {sensor}: {COCO['map_50']}", COCO["map"]]
    return table(head, rows)


def _made_by(name: str) -> str:
    """The commit of a recorded run, and the options of its command but for its files."""
    run = read_json(RESULTS / f"{name}.json")["run"]
    words = run["command"].split()[3:]
    for option in ("--out", "--json"):
        place = words.index(option)
        del words[place : place + 2]
    return f"{run['commit'][:8]} `{' '.join(words)}`" if words else str(run["commit"][:8])


def object_curve() -> str:
    """A table of the learning curve in scenes of the tuning seed."""
    (model, *_) = results("object_scales_tuning")["models"]
    rows = [
        [
            str(row["epoch"]),
            f"{row['windows']:,}",
            f"{row['loss']:.3f}",
            f"{row['held_out_f1']:.3f}",
            f"{row['map_50']:.3f}",
            f"{row['map']:.3f}",
        ]
        for row in model["curve"]
    ]
    head = ["epoch", "objects shown", "loss", "F1 in scenes of held-out pictures"]
    return table([*head, "mAP .5", "mAP"], rows)
