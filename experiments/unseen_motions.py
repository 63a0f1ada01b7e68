"""Recognizing objects in motions that were not recorded: with and without motion re-synthesis, on made data.

    python -m experiments.unseen_motions [--seeds N] [--json FILE]

Six classes, each a pair of dark shapes in two greys on a sensor of 64x48 pixels, by a renderer of this folder's own
(`made_objects.py`). All training recordings move to the right; they are tested moving to the right, and in seven other
directions. The two commands differ by one option:

    async-tnt train OBJECTS --sensor 64x48 --window-us 50000
    async-tnt train OBJECTS --sensor 64x48 --window-us 50000 --motions resynthesized
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt.progress import progress
from experiments.bench_timing import machine
from experiments.made_objects import CLASSES, SENSOR, WINDOW_US, write
from experiments.script_options import exit_with, script_parser, write_outputs

N_TRAIN, N_TEST = 200, 56
RIGHT, OTHERS = (0.0,), tuple(np.pi / 4 * np.arange(1, 8))
MODES = ("recorded", "resynthesized")


def measure(seeds: int, n_train: int, n_test: int, extra: tuple[str, ...] = ()) -> dict[str, Any]:
    """Accuracy of both ways, tested in the recorded and in other motions."""
    results: dict[str, list[dict[str, float]]] = {mode: [] for mode in MODES}
    records = []
    with TemporaryDirectory() as name, progress(2 * seeds, "training") as bar:
        folder = Path(name)
        for seed in range(seeds):
            objects = write(folder / f"objects{seed}", n_train, RIGHT, 3 * seed)
            tests = {
                "recorded motion": write(folder / f"same{seed}", n_test, RIGHT, 3 * seed + 1),
                "other motions": write(folder / f"other{seed}", n_test, OTHERS, 3 * seed + 2),
            }
            for mode in MODES:
                model = folder / f"{mode}{seed}.safetensors"
                size = f"{SENSOR[0]}x{SENSOR[1]}"
                words = ["train", objects, "--sensor", size, "--window-us", WINDOW_US, "--motions", mode]
                words += ["--seed", seed, "--out", model, "--json", *extra]
                summary = command(*words)
                records.append(summary.get("motions"))
                results[mode].append(
                    {test: command("evaluate", model, where, "--json")["accuracy"] for test, where in tests.items()}
                )
                bar.update()
    return {
        "classes": CLASSES,
        "recordings": {"training": n_train * len(CLASSES), "test, each": n_test * len(CLASSES)},
        "seeds": list(range(seeds)),
        "accuracy": {
            mode: {test: {"mean": float(np.mean(values)), "seeds": values} for test, values in _columns(rows).items()}
            for mode, rows in results.items()
        },
        "gap": _mean(results["recorded"], "recorded motion") - _mean(results["recorded"], "other motions"),
        "gained": _mean(results["resynthesized"], "other motions") - _mean(results["recorded"], "other motions"),
        "motions": [record for record in records if record],
        "machine": machine("torch"),
    }


def command(*words: object) -> dict[str, Any]:
    """What `async-tnt` prints as JSON."""
    done = subprocess.run([sys.executable, "-m", "async_tnt", *map(str, words)], stdout=subprocess.PIPE, check=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _columns(rows: list[dict[str, float]]) -> dict[str, list[float]]:
    return {test: [row[test] for row in rows] for test in rows[0]}


def _mean(rows: list[dict[str, float]], test: str) -> float:
    return float(np.mean([row[test] for row in rows]))


def main(argv: list[str] | None = None) -> int:
    """Measure, print and write."""
    parser = script_parser("unseen_motions", __doc__, "one seed, few recordings and epochs")
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="data and networks (default: 3)")
    args = parser.parse_args(argv)
    report = measure(1, 10, 7, ("--epochs", "3")) if args.quick else measure(args.seeds, N_TRAIN, N_TEST)
    for mode, tests in report["accuracy"].items():
        print(f"{mode:16}" + "".join(f"{test}: {found['mean']:.3f}   " for test, found in tests.items()))
    print(f"gap {report['gap']:.3f}, gained {report['gained']:.3f}")
    write_outputs(args, report)
    return 0


if __name__ == "__main__":
    exit_with(main)
