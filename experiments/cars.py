"""N-CARS: accuracy against time on its test part, by the bare command and by other recipes.

    python -m experiments.cars N-CARS [--seeds N] [--recipes NAME ...] [--out FOLDER] [--json FILE]
                               [--picture FILE]

N-CARS is the folder as it is distributed, unpacked. A recipe is one command, `async-tnt train` with
options; `bare` has no option but the sensor's size. Finished trainings in --out are kept, and
interrupted trainings resume. Recipes that are not named keep their entry in FILE.

The test part is read when all networks of a recipe are trained. Each network is tested on it once.
The test part also gives the accuracy by the size of the crops alone, and some recordings on which
times are measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt import CompiledRegressor, TNTVolume, load_model
from async_tnt.base.progress import progress
from async_tnt.sources import open_recording
from async_tnt.views.figure_style import GREY, OFF, ON, PALE, axes_at, headline, new_figure, note
from async_tnt.volume.config import LANDMARKS
from async_tnt.volume.sensor import format_size
from experiments.objects.pairs import SENSOR, write
from experiments.scripts.options import (
    add_count,
    earlier_parts,
    exit_with,
    run_script,
    script_parser,
    write_part,
)
from experiments.scripts.processes import command
from experiments.speed.every_event import bench_every_event
from experiments.speed.timing import interleave, machine, spread, work_clock
from experiments.speed.touched import bench_touched
from experiments.tables.datasets import SIZES, recipes_of

TUNED = "--mirror --epochs 40 --validation 0.05"
"""Options of `train` in the recipe that was found on held-out training recordings."""

EQUAL = "--mirror --epochs 6 --validation 0.05"
"""Options of `train` that all recipes of the comparison of inputs share."""

VOLUMES = {"volume": "transform=none"} | {
    name: f"transform=tnt,landmark={name},t_max=3" for name in LANDMARKS
}
"""Name of an input -> its settings in `--volume`, besides representation and bins."""

HEIGHT = 3.4
"""Height of the picture, in inches."""

TOP = 0.6
"""Distance from the top of the picture to its axes, in inches."""

SIDE = 2.2
"""Height of the axes, in inches."""

WIDTH = 4.2
"""Width of the axes, in inches."""

LEFT = 0.75
"""Distance from the left of the picture to the first axes, in inches."""

STEP = 5.0
"""Distance from the left of the first axes to the left of the second axes, in inches."""

IMAGES = ("count", "count_time", "mean_time", "time_surface")
"""Inputs that are images. A window has no bins: each pixel has one value."""

TRAIN = "n-cars_train"
"""Folder of the training part."""

TEST = "n-cars_test"
"""Folder of the test part."""

SENSOR_SIZE = "--sensor 120x100"
"""Option of every recipe."""

RECIPES = {
    "tuned": TUNED,
    "bare": "",
    **{
        f"equal_{name}": f"--volume representation=volume,bins=9,{volume} {EQUAL}"
        for name, volume in VOLUMES.items()
    },
    **{f"equal_{name}": f"--volume representation={name} {EQUAL}" for name in IMAGES},
}
"""Name of a recipe -> its options besides the sensor's size. The first recipe is drawn."""

OTHERS = {"HOTS": 0.624, "HATS": 0.902, "AEGNN": 0.945}
"""Accuracy of other methods on complete recordings of N-CARS. docs/results.md names the sources."""

TIMED = 12
"""Largest number of recordings of the test part on which times are measured."""

MOMENTS = 400
"""Number of moments at which the multiplications after an event are counted."""

SMOOTHED = 2.0
"""Standard deviation, in pixels, of the Gaussian that spreads the votes over sizes of crops."""


def measure(
    folder: Path, out: Path, recipe: str, seeds: int, common: str = SENSOR_SIZE
) -> dict[str, Any]:
    """The numbers of one recipe, with a trained and tested network for each seed.

    common : options of every recipe.
    """
    out.mkdir(parents=True, exist_ok=True)
    options = f"{common} {RECIPES[recipe]}".strip()
    models = []
    with progress(seeds, f"training {recipe}") as bar:
        for seed in range(seeds):
            models.append(out / f"{recipe}{seed}.safetensors")
            arguments = [*options.split(), "--seed", seed, "--out", models[-1]]
            command("train", folder / TRAIN, *arguments, "--json")
            bar.update()
    return {
        "command": f"async-tnt train {TRAIN} {options}",
        "tests": [_tested(path, folder / TEST) for path in models],
        **_costs(models[0], folder / TEST),
        "machine": machine("torch"),
    }


def _tested(path: Path, test: Path) -> dict[str, Any]:
    """Accuracies of a model on the test part: at the ends of recordings, by time, by confidence."""
    report = command("evaluate", path, test, "--json")
    counts = ("accuracy", "recordings", "window_accuracy", "windows")
    names = (*counts, "calibration_error", "confidence")
    against_time = {
        f"{row['time_us'] / 1e3:g}": row["accuracy"] for row in report["accuracy_against_time"]
    }
    return {"against_time_ms": against_time, **{name: report[name] for name in names}}


def by_crop_size(train: Path, test: Path) -> float:
    """The test accuracy that the width and the height of recordings alone give.

    Each training recording votes for its class, at its own size and at sizes near it. A test
    recording gets the class with most votes at its size. A network could reach this accuracy by
    the size of the crops, without looking at any object.
    """
    training_sizes = _sizes(train)
    test_sizes = _sizes(test)
    all_sizes = [*training_sizes.values(), *test_sizes.values()]
    side = 1 + max(int(sizes.max()) for sizes in all_sizes)
    distance = np.arange(side)[:, None] - np.arange(side)
    weight = np.exp(-0.5 * (distance / SMOOTHED) ** 2)
    votes = {}
    for name, sizes in training_sizes.items():
        table = np.zeros((side, side))
        np.add.at(table, (sizes[:, 0], sizes[:, 1]), 1 / len(sizes))
        votes[name] = weight @ table @ weight
    classes = list(votes)
    n_right = 0
    n_total = 0
    for name, sizes in test_sizes.items():
        votes_at_size = np.stack(
            [votes[class_name][sizes[:, 0], sizes[:, 1]] for class_name in classes]
        )
        elected = votes_at_size.argmax(0)
        n_right += int((elected == classes.index(name)).sum())
        n_total += len(sizes)
    return n_right / n_total


def _sizes(part: Path) -> dict[str, np.ndarray]:
    """Class -> width and height of its recordings, shape (N, 2), up to the outermost events.

    Recordings without events are left out.
    """
    sizes_by_class = {}
    for folder in sorted(path for path in part.iterdir() if path.is_dir()):
        sizes = []
        for file in sorted(folder.iterdir()):
            events = open_recording(file).read()
            if len(events):
                sizes.append((events["x"].max() + 1, events["y"].max() + 1))
        sizes_by_class[folder.name] = np.array(sizes)
    return sizes_by_class


def _costs(path: Path, test: Path) -> dict[str, Any]:
    """Times of a model, measured on the first windows of some recordings, and its work.

    `event_ns` is the time that an event takes in the volume. `every_event` is the time of a
    decision after every event, see `bench_every_event`. `multiplications` is what the network
    computes after one event, as a mean over many moments, and `whole` what it has at all.
    """
    model = load_model(str(path))
    files = sorted(file for file in test.glob("*/*") if file.is_file())
    step = -(-len(files) // TIMED)  # rounded up
    windows = []
    for file in files[::step]:
        events = open_recording(file, sensor=model.config.sensor).read()
        events["t"] -= events["t"][0]
        windows.append(events[events["t"] < model.config.window_us])
    regressor = CompiledRegressor(model) if model.config.needs_regressor else None
    volume = TNTVolume(model.config, regressor=regressor)

    def ns_per_event() -> float:
        nanoseconds = 0.0
        for events in windows:
            volume.open(0)
            started = work_clock()
            volume.update(events)
            nanoseconds += 1e9 * (work_clock() - started)
        return nanoseconds / sum(map(len, windows))

    event_ns = interleave({"ours": ns_per_event}, 20)["ours"]
    touched = bench_touched(model, windows, moments=MOMENTS)
    return {
        "multiplications": touched["1"]["multiplications"],
        "whole": touched["whole"]["multiplications"],
        "event_ns": spread(event_ns),
        "every_event": bench_every_event(model, {}, windows, rounds=2 * len(windows))["ours"],
    }


def draw(report: dict[str, Any]) -> Any:
    """Draw accuracy against time, and against the time until a confidence is reached."""
    tests = next(iter(recipes_of(report).values()))["tests"]
    end_ms = max(float(ms) for ms in tests[0]["against_time_ms"])
    figure = new_figure(HEIGHT)
    headline(figure, f"Test part, {len(tests)} {'network' if len(tests) == 1 else 'networks'}")
    time_axes = axes_at(figure, LEFT, TOP, WIDTH, SIDE)
    level_axes = axes_at(figure, LEFT + STEP, TOP, WIDTH, SIDE)
    # others are known for N-CARS, not for a made set, which has no table of crops
    _draw_time(time_axes, tests, OTHERS if SIZES in report else {}, end_ms)
    _draw_levels(level_axes, tests)
    for axes in (time_axes, level_axes):
        axes.set_ylim(0.5, 1.02)
        axes.yaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
        axes.grid(color=PALE, linewidth=0.5)
    time_axes.legend(loc="lower right")
    level_axes.legend(loc="lower right")
    return figure


def _draw_time(
    axes: Any, tests: Sequence[dict[str, Any]], others: Mapping[str, float], end_ms: float
) -> None:
    """Draw the accuracy of each network against time.

    The accuracies of other methods, which see the whole recording, stand at the end of the time
    axis.
    """
    for k, test in enumerate(tests):
        axes.plot(
            [float(ms) for ms in test["against_time_ms"]],
            list(test["against_time_ms"].values()),
            color=OFF,
            linewidth=1,
            alpha=0.6,
            label="each network" if k == 0 else None,
        )
    for name, share in others.items():
        axes.plot(end_ms, share, marker="o", markersize=4, color=ON, clip_on=False)
        down = -3 if share < 0.94 else 9
        note(axes, name, (end_ms, share), (-6, down), ha="right", color=ON)
    axes.set(xlabel="ms since the first event", ylabel="right", xlim=(0, 1.02 * end_ms))


def _draw_levels(axes: Any, tests: Sequence[dict[str, Any]]) -> None:
    """Draw accuracy and reach of each level of confidence against the time until it is reached.

    The reach is the share of windows that reach the level. All numbers are means over the networks.
    """
    # a list for each level, which has a row for each network
    by_level = [list(rows) for rows in zip(*(test["confidence"] for test in tests), strict=True)]
    # only levels that windows reach are drawn
    by_level = [rows for rows in by_level if all(row["median_ms"] is not None for row in rows)]
    ms = [np.mean([row["median_ms"] for row in rows]) for rows in by_level]
    for name, colour, label in (
        ("accuracy", OFF, "right of these"),
        ("decided", GREY, "windows that reach it"),
    ):
        shares = [np.mean([row[name] for row in rows]) for rows in by_level]
        axes.plot(ms, shares, "o-", color=colour, ms=3, label=label)
    for rows, x in zip(by_level, ms, strict=True):
        level = rows[0]["level"]
        if level >= 0.9:
            accuracy = np.mean([row["accuracy"] for row in rows])
            offset_points, align = (-3, "right") if x > ms[-1] / 2 else (4, "left")
            note(axes, f"{level:g}", (x, accuracy), (offset_points, -12), ha=align)
    axes.set(xlabel="median ms until a confidence is reached", xlim=(0, None))


def main(argv: list[str] | None = None) -> int:
    """Train and test the networks, print the tables, and write the report."""
    parser = script_parser("cars", __doc__, "a made set and one epoch", draws=True)
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        metavar="N-CARS",
        help="its folder; not with --quick or --from",
    )
    add_count(parser, "--seeds", 5, "networks")
    parser.add_argument(
        "--recipes",
        nargs="+",
        choices=RECIPES,
        default=list(RECIPES),
        metavar="NAME",
        help="default: all",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("cars"), metavar="FOLDER", help="models (default: cars)"
    )
    args = parser.parse_args(argv)
    if [args.folder is not None, args.quick, args.source is not None].count(True) != 1:
        parser.error("give N-CARS, --quick, or --from")

    def measure_recipes(quick: bool) -> dict[str, Any]:
        if quick:
            return _quick()
        report = earlier_parts(args)
        share = by_crop_size(args.folder / TRAIN, args.folder / TEST)
        report[SIZES] = {"accuracy": share, "machine": machine()}
        write_part(args, SIZES, report[SIZES])
        for name in args.recipes:
            report[name] = measure(args.folder, args.out, name, args.seeds)
            write_part(args, name, report[name])  # before the next recipe's hours
        return report

    return run_script(parser, argv, measure_recipes, "cars", draw, is_written=True)


def _quick() -> dict[str, Any]:
    """The report of one recipe on a small made set."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for part, n, seed in ((TRAIN, 6, 0), (TEST, 3, 1)):
            write(folder / part, n, (0.0,), seed)
        options = f"--sensor {format_size(SENSOR)} --epochs 1"
        return {"bare": measure(folder, folder / "models", "bare", 1, options)}


if __name__ == "__main__":
    exit_with(main)
