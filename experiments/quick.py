"""Run every command of RESULTS.md once, with --quick or with small made data: does it all run?

    python -m experiments.quick [NAME ...]

A name is that of a module, such as `decisions`; by default all commands run. What a command writes
goes to a temporary folder. Commands that need N-MNIST or MNIST get small made sets in their
layouts. Commands for which no set can be made are left out, and named with their reason. The exit
code is 1 if a command fails.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from async_tnt.base.progress import progress
from experiments.digit_data.small_sets import write_small_mnist, write_small_nmnist
from experiments.records.run import ROOT
from experiments.scripts.options import exit_with, plain_parser

DATA = {"--nmnist": "nmnist", "--mnist": "mnist"}
"""Option for a data set -> folder of the made set."""

QUICK = {
    "bare": "--quick --json {out}/x.json",
    "box_cost": "--quick --json {out}/x.json",
    "cars": "--quick --json {out}/x.json",
    "decisions": "--quick --json {out}/x.json",
    "early": "--nmnist {nmnist} --json {out}/x.json",
    "edges": "--quick --nmnist {nmnist} --mnist {mnist}",
    "everywhere": "digits-everywhere --quick --nmnist {nmnist}",
    "few_recordings": "--quick --nmnist {nmnist} --mnist {mnist}",
    "figure_equivariance": "--json {out}/x.json",
    "flow": "--quick --seeds 1 --json {out}/x.json",
    "found_paths": "--quick --nmnist {nmnist}",
    "from_pictures": "--quick --made --out {out}",
    "incremental": "--quick --json {out}/x.json",
    "layer_times": "--quick --json {out}/x.json",
    "map_times": "--quick --json {out}/x.json",
    "memory": "--events 1_500_000",
    "moving_mnist": "--mnist {mnist} --out {out}/moving --digits 2 --nmnist {nmnist}",
    "network": "--seconds 1 --pings 50",
    "nothing": "--quick",
    "object_scales": "--quick --json {out}/x.json --out {out}/scales",
    "pixel_outputs": "--quick --json {out}/x.json",
    "recipes": "--nmnist {nmnist} --sets nmnist --candidates counts --out {out}",
    "spiking": "--quick --nmnist {nmnist} --json {out}/x.json",
    "starts": "--quick",
    "sliding": "--quick --json {out}/x.json",
    "sliding_training": "--quick --json {out}/x.json --out {out}/sliding",
    "sustained": "--quick",
    "teaching": "--quick --json {out}/x.json",
    "thesis_table": "--smoke --nmnist {nmnist} --mnist {mnist} --images 2 --out {out}",
    "threads": "--quick",
    "unseen_motions": "--quick",
    "volumes": "--quick",
    "zoo": "nir_nmnist --json {out}/x.json",
}
"""Name of a command -> options with which it takes seconds. {out} is a folder for its files."""

FIRST_NUMBER = 60_001
"""Number of the first made recording: it shows the first of MNIST's test images."""


def commands() -> list[tuple[str, str]]:
    """Pairs (name, options) of the commands on the page of results, in its order."""
    page = (ROOT / "experiments" / "RESULTS.md").read_text(encoding="utf-8")
    return re.findall(r"python -m experiments\.(\w+) ?([^\n`]*)", page)


def run(name: str, folder: Path) -> tuple[str, float]:
    """Run a command. Returns the end of what it printed if it failed, and its seconds.

    folder : holds the made sets.
    """
    out = folder / name
    out.mkdir()
    words = QUICK[name].format(out=out, **{path: folder / path for path in DATA.values()}).split()
    started = time.monotonic()
    process = subprocess.run(
        [sys.executable, "-m", f"experiments.{name}", *words],
        capture_output=True,
        text=True,
        errors="replace",
    )
    failure = "" if process.returncode == 0 else (process.stderr or process.stdout)[-2_000:]
    if process.returncode and not failure:
        failure = f"exit code {process.returncode}"
    return failure, time.monotonic() - started


def main(argv: list[str] | None = None) -> int:
    """Run the commands. Returns the exit code."""
    parser = plain_parser("quick", __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="commands (default: all)")
    args = parser.parse_args(argv)
    unknown = [name for name in args.names if name not in QUICK]
    if unknown:
        parser.error(f"no command {unknown[0]!r}; there are {', '.join(QUICK)}")
    failed = []
    chosen = args.names or list(dict.fromkeys(name for name, _ in commands() if name in QUICK))
    with TemporaryDirectory() as name, progress(len(chosen), "commands") as bar:
        folder = Path(name)
        (folder / "mnist").mkdir()
        write_small_mnist(folder / "mnist", 60)
        write_small_nmnist(folder / "nmnist", n_train=4, first_number=FIRST_NUMBER)
        for command in chosen:
            failure, seconds = run(command, folder)
            print(f"{command:<20} {seconds:5.0f} s  {'failed' if failure else 'runs'}", flush=True)
            if failure:
                failed.append(command)
                print(failure, flush=True)
            bar.update()
    return int(bool(failed))


if __name__ == "__main__":
    exit_with(main)
