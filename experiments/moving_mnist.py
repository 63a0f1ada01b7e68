"""`python -m experiments.moving_mnist`: make N-MOVING-MNIST, and show how like N-MNIST it is."""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Mapping
from pathlib import Path

from async_tnt.base.files import check_folder
from async_tnt.base.package import available_cores
from async_tnt.base.progress import progress
from async_tnt.cli.options import positive_int, whole_number
from async_tnt.cli.output import note, say
from async_tnt.resynthesis.calibration import side_by_side
from experiments.digit_data.nmnist_files import write_nmnist
from experiments.motions.kinds import KINDS
from experiments.motions.scene import Scene
from experiments.moving_set.build import build
from experiments.moving_set.comparison import compare, recordings_by_image
from experiments.moving_set.manifest import MANIFEST, MovingMnist
from experiments.records.files import add_result, result_of
from experiments.records.run import command_line
from experiments.scripts.options import (
    add_folder,
    data_folder,
    exit_with,
    plain_parser,
    writable_file,
)
from experiments.speed.timing import machine

Columns = Mapping[str, dict[str, float]]
"""Title of a column of statistics -> name of a number -> the number."""

DESCRIPTION = """\
Simulate N-MOVING-MNIST: every digit of MNIST in front of an event camera of 34 x 34 pixels, under
each of 30 motions (10 directions x 3, 5 and 8 pixels) in one window of 105 ms. The folder gets one
.safetensors file per motion and 1,000 images, with the simulated optical flow, and set.json, which
records how they were made.

The 10,000 test images give 300,000 recordings: some 3 GB, in minutes. Stop with Ctrl-C, give the
same command again, and it resumes. The same seed gives the same files, for any number of workers.

At the end it prints statistics of real N-MNIST recordings, of simulations of the same images under
N-MNIST's own motion, and of this set, side by side.
"""
EPILOG = """\
examples:
  a first look, in seconds:
    python -m experiments.moving_mnist --mnist MNIST --out moving --digits 20
  the whole test set:
    python -m experiments.moving_mnist --mnist MNIST --out moving-test
  the same paths, with a saccade's speed:
    python -m experiments.moving_mnist --mnist MNIST --out bells --motions bell
  as the thesis seems to have moved its digits:
    python -m experiments.moving_mnist --mnist MNIST --out thesis --motions constant-from-centre \\
        --bright-on-dark
  also in N-MNIST's format:
    python -m experiments.moving_mnist --mnist MNIST --out moving --digits 20 --bin as-nmnist
    async-tnt run as-nmnist/000deg-5px/7/00001.bin
MNIST is the folder with train-images-idx3-ubyte.gz, t10k-images-idx3-ubyte.gz and their labels.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_folder(parser, "--mnist", "MNIST's IDX files, gzipped or not (default: $TNT_DATA/mnist)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        required=True,
        help="folder of the set; made if missing",
    )
    parser.add_argument(
        "--split", choices=("train", "test"), default="test", help="of MNIST (default: %(default)s)"
    )
    parser.add_argument(
        "--motions",
        choices=KINDS,
        default="constant",
        help="constant: 30 constant velocities; bell: the same 30 paths with the speed of a "
        "saccade; both pass the sensor's centre at half time, or start there (-from-centre); "
        "beyond: 14 px, 5 px and back, or round a loop; nmnist: N-MNIST's three saccades, 308 ms "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--bright-on-dark",
        action="store_true",
        help="bright strokes on a dark background; without it dark on bright, as N-MNIST",
    )
    parser.add_argument(
        "--digits", type=positive_int, metavar="N", help="the first N images (default: all)"
    )
    parser.add_argument(
        "--seed", type=whole_number, default=0, help="of all randomness (default: 0)"
    )
    parser.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help=f"processes (default: all cores, here {available_cores()})",
    )
    add_folder(
        parser,
        "--bin",
        "also write each recording in N-MNIST's own format: "
        "FOLDER/<motion>/<digit>/<image, from 1>.bin",
    )
    add_folder(
        parser,
        "--nmnist",
        "N-MNIST, with Train/<digit>/*.bin or Test/<digit>/*.bin, to compare with (default: "
        "$TNT_DATA/nmnist where it exists)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument(
        "--result",
        type=writable_file,
        metavar="FILE",
        help="also put the comparison there, beside those of other motions: "
        "experiments/results/simulated.json",
    )


def main(argv: list[str] | None = None) -> int:
    """Make the set, compare it with N-MNIST, and print its size and the comparison.

    Returns the exit code 0.
    """
    parser = plain_parser("moving_mnist", DESCRIPTION, EPILOG)
    add_arguments(parser)
    args = parser.parse_args(argv)
    mnist = data_folder(args.mnist, "mnist", "--mnist")
    nmnist = _nmnist_folder(args.nmnist)
    for folder in (args.out, args.bin):
        if folder is not None:
            check_folder(folder, (MANIFEST,))
    if nmnist is not None:
        # a folder without recordings is refused here, before the long work
        recordings_by_image(nmnist, args.split)

    started = time.monotonic()
    try:
        moving_set = build(
            mnist,
            args.out,
            split=args.split,
            kind=args.motions,
            which=None if args.digits is None else range(args.digits),
            seed=args.seed,
            workers=args.workers,
            scene=Scene(dark_on_bright=not args.bright_on_dark),
        )
        seconds = time.monotonic() - started
        if args.bin is not None:
            export(moving_set, args.bin)
        columns = compare(moving_set, mnist, nmnist)
    except KeyboardInterrupt:
        advice = f"finished shards are kept in {args.out}. Give the same command again to resume."
        raise KeyboardInterrupt(f"interrupted; {advice}") from None

    answer = _as_json(moving_set, columns, args.motions, seconds)
    if args.result is not None:
        numbers = {"statistics": answer["statistics"], "machine": machine()}
        result = result_of(numbers, command_line(args.module))
        add_result(args.result, args.motions, result)
    if args.json:
        say(json.dumps(answer))
    else:
        _print(moving_set, columns, seconds, exported=args.bin, compared=nmnist is not None)
    return 0


def _nmnist_folder(given: Path | None) -> Path | None:
    """The folder of N-MNIST: the one that is given, or that in $TNT_DATA; None without either."""
    root = os.environ.get("TNT_DATA")
    if given is None and not (root and (Path(root) / "nmnist").is_dir()):
        return None
    return data_folder(given, "nmnist", "--nmnist")


def _size(moving_set: MovingMnist) -> int:
    """The size of all shards together, in bytes."""
    return sum(path.stat().st_size for path in moving_set.shards)


def _as_json(
    moving_set: MovingMnist, columns: Columns, motions: str, seconds: float
) -> dict[str, object]:
    """The object that --json prints. A number that is not finite is null."""
    statistics = {
        title: {name: value if math.isfinite(value) else None for name, value in column.items()}
        for title, column in columns.items()
    }
    return {
        "out": str(moving_set.folder),
        "recordings": len(moving_set),
        "shards": len(moving_set.shards),
        "bytes": _size(moving_set),
        "seconds": round(seconds, 3),
        "motions": motions,
        "statistics": statistics,
    }


def _print(
    moving_set: MovingMnist,
    columns: Columns,
    seconds: float,
    *,
    exported: Path | None,
    compared: bool,
) -> None:
    """Print what was made, and the statistics side by side."""
    say(
        f"{moving_set.folder}: {len(moving_set)} recordings "
        f"({len(moving_set.parameters['images'])} images, {len(moving_set.motions)} motions) in "
        f"{len(moving_set.shards)} files, {_size(moving_set) / 1e6:.1f} MB; {seconds:.1f} s"
    )
    if exported is not None:
        say(f"{exported}: the same in N-MNIST's format")
    say(*side_by_side(columns).splitlines())
    shown = "the images of the first column" if compared else "the set's first images"
    say(f"simulated: {shown} under N-MNIST's own motion")
    if not compared:
        note("no N-MNIST to compare with; give --nmnist FOLDER")


def export(moving_set: MovingMnist, folder: Path) -> None:
    """Write every recording as `<folder>/<motion>/<digit>/<number>.bin`.

    The number is the image's index + 1.
    """
    with progress(len(moving_set), "exporting") as bar:
        for shard in moving_set:
            motion = folder / shard.metadata["motion"]["name"]
            for label in set(shard.labels.tolist()):
                (motion / str(label)).mkdir(parents=True, exist_ok=True)
            for i in range(len(shard)):
                path = motion / str(int(shard.labels[i])) / f"{int(shard.image[i]) + 1:05}.bin"
                write_nmnist(path, shard.recording(i))
                bar.update()


if __name__ == "__main__":
    exit_with(main)
