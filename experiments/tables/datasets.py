"""The tables of accuracies on the field's data sets, and of map models in scenes of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.volume.config import LANDMARKS
from experiments.tables.parts import about_machine, of_report, percent, results, short, table
from experiments.tables.thesis import commands as thesis_commands
from experiments.thesis.numbers import cell, summary
from experiments.thesis.numbers import short as three_digits
from experiments.thesis.rows import IMAGES
from experiments.thesis.table import recorded_table

SHOWN_MS = ("5", "10", "20", "30", "50", "100")
"""Times of `cars`, in milliseconds. Times at which networks were not tested are left out."""

SHORT_MS = ("10", "30", "100")
"""Times of `cars_in_short`, in milliseconds since a recording's first event."""

EQUAL_MS = ("10", "30", "50", "100")
"""Times of `representations`, in milliseconds."""

SIZES = "crop sizes"
"""Name of the result of `by_crop_size` among those of the recipes of N-CARS."""

REPRESENTATIONS = {
    "volume": ("event volume", "raw-translated"),
    **{name: (f"TNT, `{name}`", f"{name}-translated") for name in LANDMARKS},
    **{name: (title.partition(",")[0], f"{name}-translated") for name, title in IMAGES.items()},
}
"""Recipe of N-CARS, without `equal_` -> its title, and its row of the thesis' table."""


def recipes_of(report: dict[str, Any]) -> dict[str, Any]:
    """The results of N-CARS that belong to a recipe. The first one is drawn."""
    return {name: result for name, result in report.items() if name != SIZES}


@of_report("cars")
def cars(report: dict[str, Any]) -> str:
    """A table of the accuracy on N-CARS' test part against time, by recipe.

    It has the mean over the networks and their standard deviation.
    """
    recipes = recipes_of(report)
    tested_ms = next(iter(recipes.values()))["tests"][0]["against_time_ms"]
    shown = [ms for ms in SHOWN_MS if ms in tested_ms]
    rows = []
    for name, recipe in recipes.items():
        if name.startswith("equal_"):
            continue
        curves = [test["against_time_ms"] for test in recipe["tests"]]
        shares = [[curve[ms] for curve in curves] for ms in shown]
        cells = [cell(summary(values)) for values in shares]
        options = recipe["command"].partition("--sensor 120x100")[2].strip()
        rate = recipe["every_event"]["a_second"]
        rows.append(
            [f"`{options}`" if options else "none", str(len(curves)), *cells, f"{rate:,.0f}"]
        )
    if SIZES in report:
        by_size = ["-"] * (len(shown) - 1) + [three_digits(report[SIZES]["accuracy"])]
        rows.append(["none: width and height of the crop alone", "-", *by_size, "-"])
    times = [f"{ms} ms" for ms in shown]
    return table(
        ["other options", "networks", *times, "decisions a second, one after every event"], rows
    )


def cars_command() -> str:
    """The command that trains the recorded networks of N-CARS, but for those of `representations`.

    It also draws the picture.
    """
    recipes = recipes_of(results("cars"))
    names = [name for name in recipes if not name.startswith("equal_")]
    return f"{_cars_command(recipes, names)} --picture docs/images/cars.png"


def inputs_commands() -> str:
    """The commands that train the recorded networks of `representations`, a line each."""
    recipes = recipes_of(results("cars"))
    names = [name for name in recipes if name.startswith("equal_")]
    groups = ("comparison", "representations")
    return f"{thesis_commands(groups)}\n{_cars_command(recipes, names)}"


def _cars_command(recipes: dict[str, Any], names: Sequence[str]) -> str:
    """The command that trains the networks of some recipes of N-CARS."""
    n = max(len(recipes[name]["tests"]) for name in names)
    words = ["experiments.cars N-CARS --recipes", *names, f"--seeds {n}"]
    return " ".join([*words, "--json experiments/results/cars.json"])


PUBLISHED_WORK = {
    "AsyNet (N. Messikommer et al. 2020)": (21.5, 0.944),
    "AEGNN (S. Schaefer et al. 2022)": (0.47, 0.945),
}
"""Method -> millions of floating point operations after an event on N-CARS, and accuracy.

Both are from table 1 of Schaefer et al., [arXiv:2203.17149](https://arxiv.org/abs/2203.17149)."""


@of_report("cars")
def cars_work(report: dict[str, Any]) -> str:
    """A table of the work after an event on N-CARS, beside published numbers.

    The operations of a network are two for each multiplication: it is added, too. They are those
    of the first network of a recipe; the accuracy is a mean over its networks.
    """
    rows = [
        [name, f"{operations:g}", three_digits(accuracy)]
        for name, (operations, accuracy) in PUBLISHED_WORK.items()
    ]
    for name, recipe in recipes_of(report).items():
        if "multiplications" in recipe and not name.startswith("equal_"):
            operations = 2 * recipe["multiplications"] / 1e6
            whole = 2 * recipe["whole"] / 1e6
            accuracies = [test["accuracy"] for test in recipe["tests"]]
            title = f"`{name}`, of {whole:.1f} for the whole network"
            rows.append([title, f"{operations:.2f}", _mean(accuracies)])
    return table(["", "million operations after an event", "accuracy"], rows)


@of_report("cars")
def cars_confidence(report: dict[str, Any]) -> str:
    """A table of accuracies and times on N-CARS, by the confidence at which windows are decided.

    The numbers are means over the networks of the first recipe.
    """
    tests = next(iter(recipes_of(report).values()))["tests"]
    rows = []
    for levels in zip(*(test["confidence"] for test in tests), strict=True):
        # a level that no window of a network reaches is left out
        if any(level["median_ms"] is None for level in levels):
            continue
        names = ("decided", "accuracy", "window_accuracy", "median_ms", "p90_ms")
        means = {name: float(np.mean([level[name] for level in levels])) for name in names}
        row = [f"{levels[0]['level']:g}"]
        row += [percent(means[name]) for name in ("decided", "accuracy", "window_accuracy")]
        row += [f"{means[name]:.0f}" for name in ("median_ms", "p90_ms")]
        rows.append(row)
    head = [
        "confidence",
        "windows that reach it",
        "right of these",
        "right of all",
        "median, ms",
        "90th percentile, ms",
    ]
    error = _mean([test["calibration_error"] for test in tests])
    sentence = "Expected calibration error at the tenths of a window, mean of the networks"
    return f"{table(head, rows)}\n\n{sentence}: {error}."


def cars_in_short() -> str:
    """README's table of N-CARS: accuracies of the recipe `tuned`, and its decisions a second."""
    recipe = results("cars")["tuned"]
    tests = recipe["tests"]
    shares = [_mean([test["against_time_ms"][ms] for test in tests]) for ms in SHORT_MS]
    rate = f"{recipe['every_event']['a_second']:,.0f}"
    head = [f"right after {ms} ms" for ms in SHORT_MS]
    sentence = (
        "On N-CARS' official test part, cars or background: networks on images of counts, without "
        f"the transform, {'one network' if len(tests) == 1 else f'mean of {len(tests)}'}."
    )
    one_row = table([*head, "decisions a second, one after every event"], [[*shares, rate]])
    return f"{sentence}\n\n{one_row}"


def _mean(accuracies: Sequence[float]) -> str:
    """The text of a mean, such as .957."""
    return three_digits(float(np.mean(accuracies)))


def representations() -> str:
    """A table of accuracies on N-MNIST and N-CARS and of times, by the input of the network.

    Accuracies are means over the networks, with their standard deviation. Inputs of which nothing
    was measured are left out.
    """
    nmnist = recorded_table()["table"]
    recipes = results("cars")
    rows = []
    measured = [recipes[f"equal_{name}"] for name in REPRESENTATIONS if f"equal_{name}" in recipes]
    for name, (title, row) in REPRESENTATIONS.items():
        accuracies = nmnist.get(row, {})
        recipe = recipes.get(f"equal_{name}")
        if not accuracies and recipe is None:
            continue
        n_nmnist = str(len(accuracies["1/all"]["seeds"])) if accuracies else "-"
        cells = [n_nmnist, *(cell(accuracies.get(column)) for column in ("1/all", "1/sim"))]
        if recipe is None:
            rows.append([title, *cells, *["-"] * (len(EQUAL_MS) + 3)])
            continue
        shares = [[test["against_time_ms"][ms] for test in recipe["tests"]] for ms in EQUAL_MS]
        costs = [short(recipe["event_ns"]["median"]), short(recipe["every_event"]["us"]["median"])]
        cells += [str(len(recipe["tests"])), *(cell(summary(values)) for values in shares)]
        rows.append([title, *cells, *costs])
    times = [f"{ms} ms" for ms in EQUAL_MS]
    head = ["", "networks, N-MNIST", "1/all", "1/sim", "networks, N-CARS", *times]
    head += ["ns an event", "µs a decision"]
    return f"{table(head, rows)}\n\nCosts: {about_machine(*measured)}"


@of_report("bare")
def bare(report: dict[str, Any]) -> str:
    """A table of the accuracy of `train` without options: means and standard deviations."""
    rows = []
    for entry in report.values():
        rows.append([entry["title"], *_tested(entry)])
    return table(["data set", "networks", "windows", "recordings"], rows)


def bare_command() -> str:
    """The command that trains the recorded networks of `bare`."""
    n = max(len(entry["networks"]) for entry in results("bare").values())
    return (
        "experiments.bare --nmnist N-MNIST --poker POKER-DVS --characters characters "
        f"--seeds {n} --json experiments/results/bare.json"
    )


@of_report("from_pictures")
def from_pictures(report: dict[str, Any]) -> str:
    """A table of the accuracy of `train` on pictures alone: means and standard deviations."""
    rows = []
    for entry in report.values():
        options = entry["command"].partition("PICTURES ")[2]
        rows.append(
            [entry["title"], f"`{options}`", f"{entry['pictures']['pictures']:,}", *_tested(entry)]
        )
    return table(
        ["recordings of", "options", "pictures", "networks", "windows", "recordings"], rows
    )


@of_report("few_recordings")
def few_recordings(report: dict[str, Any]) -> str:
    """A table of windows and recordings right, with and without pictures.

    It has a row for each number of real recordings of a class.
    """
    texts_by_number: dict[int, dict[str, str]] = {}
    for way, networks_by_number in report["ways"].items():
        for row in networks_by_number:
            windows = [network["window_accuracy"] for network in row["networks"]]
            recordings = [network["accuracy"] for network in row["networks"]]
            text = f"{cell(summary(windows))} / {cell(summary(recordings))}"
            texts_by_number.setdefault(row["per_class"], {})[way] = text
    ways = list(report["ways"])
    rows = []
    for n, texts in texts_by_number.items():
        rows.append([f"{n:,}", *(texts.get(way, "-") for way in ways)])
    return table(["recordings of each class", *ways], rows)


def _tested(entry: dict[str, Any]) -> list[str]:
    """Three cells: the number of networks, the windows right, and the recordings right."""
    networks = entry["networks"]
    shares = (
        cell(summary([row[key] for row in networks])) for key in ("window_accuracy", "accuracy")
    )
    sizes = (f"{networks[0][key]:,}" for key in ("windows", "recordings"))
    return [
        str(len(networks)),
        *(f"{share} of {n}" for share, n in zip(shares, sizes, strict=True)),
    ]


@of_report("from_pictures")
def moved_digits(report: dict[str, Any]) -> str:
    """A table of accuracies on digits in simulated motions that N-MNIST does not have.

    The numbers are means over the networks.
    """
    rows = []
    for test, cases in report.get("nmnist", {}).get("simulated", {}).items():
        means = {case: float(np.mean(shares)) for case, shares in cases.items()}
        worst = min(means, key=lambda case: means[case])
        rows.append(
            [
                test,
                str(len(means)),
                _mean(list(means.values())),
                f"{three_digits(means[worst])} ({worst})",
            ]
        )
    return table(["1,000 test images", "motions or speeds", "mean", "worst"], rows)


@of_report("recipes")
def recipes(report: dict[str, Any]) -> str:
    """A table of the candidates for the default volume.

    It has the share of held-out windows right, at their ends and as a mean over ten moments.
    """
    sets = list(dict.fromkeys(part["set"] for part in report.values()))
    candidates = list(dict.fromkeys(part["candidate"] for part in report.values()))
    rows = []
    for candidate in candidates:
        cells = []
        for name in sets:
            networks = [
                part
                for part in report.values()
                if (part["set"], part["candidate"]) == (name, candidate)
            ]
            means = (
                [network[key] for network in networks] for key in ("per_window", "mean_over_time")
            )
            cells.append(" / ".join(_mean(values) if values else "-" for values in means))
        rows.append([candidate, *cells])
    return table(["", *sets], rows)


@of_report("simulated")
def simulated(report: dict[str, Any]) -> str:
    """A table of statistics of N-MNIST's recordings, and of simulated recordings."""
    first = next(iter(report.values()))["statistics"]
    columns = {name: first[name] for name in ("N-MNIST", "simulated")}
    columns |= {motions: entry["statistics"]["this set"] for motions, entry in report.items()}
    rows = [
        [name, *(_statistic(column[name]) for column in columns.values())]
        for name in columns["N-MNIST"]
    ]
    return table(["", *columns], rows)


def _statistic(value: float | None) -> str:
    """The text of a statistic: three digits of large numbers, two decimals of small ones."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2f}"


SCENES = {
    "three": "three on 128x96, 30 pixels and more apart",
    "close": "the same, 16 pixels and more apart",
    "overlapping": "the same, each 16 to 24 pixels from another one",
    "eight": "eight on 640x480",
}
"""Kind of scenes of digits -> its title."""


SCORES = {
    "end": "F1 at the end",
    "early": "30 ms after the last start",
    "map": "mAP",
    "map_50": "mAP .5",
    "map_75": "mAP .75",
}
"""Score of a model in scenes of digits -> its title. Models without sizes have the first two."""


def everywhere() -> str:
    """A table of F1 of the bundled map model, in scenes of real recordings."""
    return _scenes("everywhere")


def box_scenes() -> str:
    """A table of F1 and COCO's scores of a model with boxes, in scenes of real recordings."""
    return _scenes("box_scenes")


def _scenes(name: str) -> str:
    """A table of the scores of the only model in the result `name`."""
    (model,) = results(name)["models"]
    scores = [score for score in SCORES if score in model["three"]]
    rows = [
        [title, *(f"{model[kind][score]:.3f}" for score in scores)]
        for kind, title in SCENES.items()
    ]
    return table(["digits", *(SCORES[score] for score in scores)], rows)
