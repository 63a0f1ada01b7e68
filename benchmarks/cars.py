"""Cars and background, N-CARS: accuracy against time on its official test part, with several networks each.

    python benchmarks/cars.py N-CARS [--seeds N] [--recipes NAME ...] [--out FOLDER] [--json FILE] [--picture FILE]

N-CARS is a folder with n-cars_train and n-cars_test. Each recipe is one command, `async-tnt train`. Finished trainings
in FOLDER are kept, interrupted ones resume, and recipes that are not named keep their entry in FILE. The test part is
read when all networks of a recipe are trained.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from draw_cars import draw
from made_objects import SENSOR, write
from script_options import run_script, script_parser
from unseen_motions import command

from async_tnt.checking.bench_every_event import bench_every_event
from async_tnt.checking.timing import interleave, machine, spread, work_clock
from async_tnt.networks.loading import load_model
from async_tnt.progress import progress
from async_tnt.sources import open_recording
from async_tnt.sources.sensor import format_size
from async_tnt.volume import TNTVolume

TRAIN, TEST = "n-cars_train", "n-cars_test"
TUNED = "--grid 60x50 --network residual --mirror --epochs 30 --patience 0 --validation 0.05"
EQUAL = "--network residual --mirror --epochs 10 --patience 0 --validation 0.05 --polarity split"
VOLUMES = {
    "volume": "--transform none",
    **{landmark: f"--landmark {landmark}" for landmark in ("center", "running", "line", "window", "regressor")},
}
IMAGES = "count", "count_time", "mean_time", "time_surface"
RECIPES = {
    "tuned": f"--representation count --polarity split {TUNED}",
    "bare": "",
    **{f"equal_{name}": f"{options} --grid 60x50 {EQUAL}" for name, options in VOLUMES.items()},
    **{f"equal_{name}": f"--representation {name} --grid 60x50 {EQUAL}" for name in IMAGES},
    "equal_hats": f"--representation hats --grid 12x10 {EQUAL}",
}
SHOWN_MS = "10", "20", "30", "50", "100"
TIMED = 12  # recordings of the test part
QUICK = "--epochs 1 --quick"


def measure(n_cars: Path, out: Path, recipes: Sequence[str], seeds: int, sensor: str, more: str = "") -> dict[str, Any]:
    """Train and test each recipe, with each seed.

    Parameters
    ----------
    more : options for all recipes.
    """
    found = {}
    with progress(len(recipes) * seeds, "training") as bar:
        for name in recipes:
            options = f"--sensor {sensor} {RECIPES[name]} {more}".strip()
            models = []
            for seed in range(seeds):
                models.append(out / f"{name}{seed}.safetensors")
                words = [*options.split(), "--seed", seed, "--out", models[-1], "--run", out / "runs" / f"{name}{seed}"]
                command("train", n_cars / TRAIN, *words, "--json")
                bar.update()
            found[name] = {
                "command": f"async-tnt train {TRAIN} {options}",
                "networks": [_about(path) for path in models],
                "tests": [_tested(path, n_cars / TEST) for path in models],
                **_costs(models[0], n_cars / TEST),
            }
    return {"recipes": found, "machine": machine("torch")}


def _about(path: Path) -> dict[str, Any]:
    model = load_model(str(path))
    trials = model.record["data"].get("choice", [])
    return {
        "network": model.record["network"],
        "weights": sum(w.size for w in model.weights.values()),
        "trained_on": model.record["data"]["real_recordings"],
        "chosen": trials[-1]["tried"] if trials else None,
        "temperature": model.record.get("temperature"),
        "sure_of_nothing": model.record["validation"]["sure_of_nothing"],
    }


def _tested(path: Path, test: Path) -> dict[str, Any]:
    report = command("evaluate", path, test, "--json")
    names = ("accuracy", "recordings", "calibration_error", "accuracy_against_events", "confidence")
    against_time = {f"{row['time_us'] / 1e3:g}": row["accuracy"] for row in report["accuracy_against_time"]}
    return {"against_time_ms": against_time, **{name: report[name] for name in names}}


def _costs(path: Path, test: Path) -> dict[str, Any]:
    """On some test recordings: nanoseconds an event in the volume, and a decision after every event."""
    model = load_model(str(path))
    files = sorted(file for file in test.glob("*/*") if file.is_file())
    some = [open_recording(file, sensor=model.config.sensor).read() for file in files[:: -(-len(files) // TIMED)]]
    for events in some:
        events["t"] -= events["t"][0]
    volume = TNTVolume(model.config)

    def absorbed() -> float:
        nanoseconds = 0.0
        for events in some:
            volume.open(0)
            started = work_clock()
            volume.update(events)
            nanoseconds += 1e9 * (work_clock() - started)
        return nanoseconds / sum(map(len, some))

    per_event = interleave({"ours": absorbed}, 20)["ours"]
    return {
        "event_ns": spread(per_event),
        "every_event": bench_every_event(model, {}, some, rounds=2 * len(some))["ours"],
    }


def lines(report: dict[str, Any]) -> list[str]:
    """For people."""
    printed = [f"{'':10}" + "".join(f"{ms + ' ms':>14}" for ms in SHOWN_MS)]
    for name, found in report["recipes"].items():
        courses = [test["against_time_ms"] for test in found["tests"]]
        values = [[course[ms] for course in courses if ms in course] for ms in SHOWN_MS]
        cells = [f"{np.mean(v):.4f} ± {np.std(v):.4f}" if v else "-" for v in values]
        printed.append(f"{name:10}" + "".join(f"{cell:>18}" for cell in cells))
        printed.append(f"{'':10}{found['every_event']['a_second']:,.0f} decisions a second, one after every event")
    return printed


def main(argv: list[str] | None = None) -> int:
    """Train, test, print and write."""
    parser = script_parser(__doc__, "a made set and one epoch", draws=True)
    parser.add_argument("n_cars", nargs="?", type=Path, metavar="N-CARS", help="not with --quick")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="networks (default: 5)")
    parser.add_argument("--recipes", nargs="+", choices=RECIPES, default=list(RECIPES), help="default: all")
    parser.add_argument("--out", type=Path, default=Path("cars"), metavar="FOLDER", help="models (default: cars)")
    args = parser.parse_args(argv)
    if [args.n_cars is not None, args.quick, args.source is not None].count(True) != 1:
        parser.error("give the folder N-CARS, --quick, or --from")

    def measured(quick: bool) -> dict[str, Any]:
        report = _quick() if quick else measure(args.n_cars, args.out, args.recipes, args.seeds, "120x100")
        if args.json and args.json.exists():
            before = json.loads(args.json.read_text(encoding="utf-8"))["recipes"]
            report["recipes"] = before | report["recipes"]
        return report

    return run_script(parser, argv, measured, lines, draw)


def _quick() -> dict[str, Any]:
    with TemporaryDirectory() as name:
        folder = Path(name)
        for part, n, seed in ((TRAIN, 6, 0), (TEST, 3, 1)):
            write(folder / part, n, (0.0,), seed)
        return measure(folder, folder, list(RECIPES), 1, format_size(SENSOR), QUICK)


if __name__ == "__main__":
    sys.exit(main())
