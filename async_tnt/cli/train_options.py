"""The options of `async-tnt train`."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.cli.data_options import add_folder, add_precision
from async_tnt.cli.options import positive_int, positive_number, size_text, whole_number
from async_tnt.cli.pixel_options import add_selection
from async_tnt.config import LANDMARKS, POLARITIES, REPRESENTATIONS, TRANSFORMS, Landmark
from async_tnt.training.augment import Augmentation
from async_tnt.training.settings import STREAMED
from async_tnt.worker import available_cores

DESCRIPTION = """\
Train a classifier on volumes of events: the thesis' network, others that suit small machines, or your own (--network).

With DATASET, on your own classes. What no option gives is chosen first: a few volumes (--transform, --polarity), grids
and networks are trained for a short time each, compared on the held-out recordings, and listed; the best is trained.
--quick leaves that out. DATASET is a folder with one folder of recordings for each class, named like the class, from
any camera and in any format that `async-tnt run` reads. Windows follow each other from each recording's first event; a
shorter recording is one partial window. Every epoch shows each class equally often, however many recordings it has.
Beside the model (m.safetensors) it writes m.json, m.confusion.png and m.curves.png, with the accuracy on held-out
recordings. With --roi and --mask it learns from some of the camera's pixels, which the model's record names.

With --nmnist, on N-MNIST's digits and, with --simulated, on recordings simulated from MNIST's images.

Each epoch shifts, rotates and thins every window at random, so no two epochs are alike. Some of the real recordings are
held out: they choose volume and network, calibrate the probabilities, and tell the accuracy after each epoch.
Checkpoints go into the run folder: stop with Ctrl-C, give the same command again, and the training resumes; on the same
machine it ends with exactly the same weights.
"""
EPILOG = """\
examples:
  async-tnt train gestures --out gestures.safetensors          gestures/wave/*.npz, gestures/clap/*.npz, ...
  async-tnt train gestures --sensor 346x260 --grid 44x33 --window-us 200000 --landmark center
  async-tnt train gestures --roi 100,80,64,64 --crop --mask hot.npy    a part of the camera, without hot pixels
  async-tnt train gestures --groups 'user\\d+'                 held-out people: what new ones will give
  async-tnt train gestures --motions resynthesized             recognize them in other motions as well
  async-tnt train gestures --network mine.py:build             a network of your own
  async-tnt evaluate gestures.safetensors held_out             accuracy on other recordings
  async-tnt train --smoke                          does everything work? seconds, no data needed
  async-tnt train --nmnist N-MNIST --out mine.safetensors
  async-tnt train --nmnist N-MNIST --mnist MNIST --simulated 20000 --landmark line --t-max 2 --epochs 40
  async-tnt train --nmnist N-MNIST --saccades 1 --landmark regressor --translate 4 --t-max 2 --iterations 60000
  async-tnt run --model mine.safetensors my.bin     use it
"""


LANDMARK: Landmark = "running"  # where nothing is chosen
T_MAX, NETWORK = 3.0, "thesis"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `async-tnt train` to its parser."""
    parser.description, parser.epilog = DESCRIPTION, EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    data = parser.add_argument_group("data")
    data.add_argument(
        "dataset",
        nargs="?",
        type=Path,
        metavar="DATASET",
        help="folder with <class name>/<recordings>, or with Train/<class name>/<recordings> (and Test/...)",
    )
    add_folder(data, "--nmnist", "N-MNIST: the folder with Train/<digit>/*.bin (default: $TNT_DATA/nmnist)")
    add_folder(data, "--mnist", "MNIST's IDX files, gzipped or not, for --simulated (default: $TNT_DATA/mnist)")
    data.add_argument(
        "--simulated",
        type=int,
        default=0,
        metavar="N",
        help="add N simulated recordings of other MNIST images (default: 0; about 5 ms each)",
    )
    data.add_argument(
        "--saccades",
        type=int,
        nargs="+",
        choices=(1, 2, 3),
        default=[1, 2, 3],
        help="train and validate on these of a recording's three saccades (default: 1 2 3)",
    )
    data.add_argument(
        "--validation",
        type=float,
        metavar="SHARE",
        help="share of each class's real recordings held out for validation (default: 0.1; with DATASET 0.2, and at "
        "least one)",
    )
    data.add_argument(
        "--groups",
        metavar="PATTERN",
        help=r"with DATASET: a regular expression on class/file, such as 'user\d+'; recordings in whose names it finds "
        "the same text are never on both sides of the split (default: the file DATASET/groups.csv or "
        "DATASET/Train/groups.csv, with columns recording and group; without it, the last ones are held out where "
        "recordings are numbered)",
    )
    data.add_argument(
        "--skip-damaged",
        action="store_true",
        help="of N-MNIST: leave damaged recordings out, with a warning each, instead of stopping (of DATASET they are "
        "always left out, and named at the end)",
    )
    data.add_argument(
        "--test",
        action="store_true",
        help="at the end, also classify the folder Test and write the accuracy into the model's record; do this once, "
        "after all choices are made",
    )
    add_selection(
        parser.add_argument_group(
            "pixels of DATASET (other events are ignored; give the same options where the model is used)"
        )
    )
    motions = parser.add_argument_group(
        "motions (re-synthesis: what was recorded in one motion, shown in others; for one object that moves as a whole)"
    )
    motions.add_argument(
        "--motions",
        choices=("recorded", "resynthesized"),
        default="recorded",
        help="recorded: as they are. resynthesized: also find each window's path and image, move the image otherwise "
        "and simulate its events; what was found and made is drawn in RUN/motions/motions.png (default: recorded)",
    )
    motions.add_argument(
        "--shared-path",
        action="store_true",
        help="windows that start at the same time of their recordings moved alike: find one path for them",
    )
    motions.add_argument(
        "--variations",
        type=positive_int,
        metavar="N",
        help="other motions of each window, at most one an epoch (default: 32)",
    )
    motions.add_argument(
        "--recorded",
        type=float,
        metavar="SHARE",
        help="share of an epoch's windows that are shown as recorded; 0 where each class moved in its own way "
        "(default: 0.25)",
    )
    motions.add_argument(
        "--workers",
        type=positive_int,
        metavar="N",
        help=f"processes that re-synthesize (default: all cores, here {available_cores()})",
    )
    volume = parser.add_argument_group(
        "volume (what the network sees)",
        "With DATASET, representation, transform, polarity, grid, --network and --mirror are chosen where no option "
        "gives them; the defaults below are those of --quick and of --nmnist.",
    )
    volume.add_argument(
        "--representation",
        choices=REPRESENTATIONS,
        help="the event volume, or an image: events per pixel, with the time of the newest, the mean time, or a "
        "time surface (default: volume)",
    )
    volume.add_argument(
        "--transform", choices=TRANSFORMS, help="tnt, or none: the plain event volume (default: tnt; none for an image)"
    )
    volume.add_argument(
        "--landmark",
        choices=LANDMARKS,
        help="the point events are normalized about; `window` and `regressor` (a second network, trained jointly) "
        "cost a replay at each decision (default: running)",
    )
    volume.add_argument(
        "--t-max",
        type=float,
        metavar="T",
        help="TNT time at the window's end: a smaller one shrinks late events less, but loses more of the early ones "
        "at the border (default: 3)",
    )
    volume.add_argument(
        "--polarity",
        choices=POLARITIES,
        help="ON minus OFF events, both counted alike, or in separate bins (default: signed; split for an image)",
    )
    volume.add_argument("--remove-flow", action="store_true", help="subtract the fitted flow (with --landmark line)")
    volume.add_argument("--bins", type=int, metavar="B", help="time bins of the event volume (default: 9)")
    volume.add_argument(
        "--sensor",
        type=size_text,
        metavar="WxH",
        help="with DATASET: the camera's pixels, where recordings do not state them (a .bin is 34x34 without this "
        "option); recordings of another sensor are an error. The model is for this sensor, or with --crop for the "
        "region",
    )
    volume.add_argument(
        "--grid", type=size_text, metavar="WxH", help="with DATASET: the volume's pixels (default: 34x34)"
    )
    volume.add_argument(
        "--window-us",
        type=positive_int,
        metavar="US",
        help="with DATASET: length of a window, in microseconds (default: 105000)",
    )
    learning = parser.add_argument_group("training")
    learning.add_argument(
        "--quick",
        action="store_true",
        help="with DATASET: leave the choice out, and take the defaults for what no option gives",
    )
    learning.add_argument(
        "--network",
        metavar="NAME",
        help="thesis: two convolutions, two dense layers; conv4: four with batch norm; residual; separable: few "
        "multiplications; or FILE.py:FUNCTION, your own: called with channels, (width, height) and the number of "
        "classes, it returns a torch module (default: thesis)",
    )
    learning.add_argument(
        "--epochs",
        type=positive_int,
        metavar="N",
        help="passes over the training windows (default: 20; with DATASET at least 30, and 1500 steps, or 6000 with "
        "other motions)",
    )
    learning.add_argument(
        "--patience",
        type=whole_number,
        metavar="N",
        help="stop when the validation loss has not fallen for this many epochs; 0: never (default: 0; with other "
        "motions of DATASET a fifth of the epochs)",
    )
    learning.add_argument(
        "--iterations",
        type=positive_int,
        metavar="N",
        help="optimizer steps, instead of --epochs (the thesis: 60000 of 64 windows each)",
    )
    learning.add_argument(
        "--batch",
        type=positive_int,
        metavar="N",
        help="windows per step (default: 64; with DATASET fewer, down to 8, for a small data set)",
    )
    learning.add_argument(
        "--rate",
        type=positive_number,
        default=2e-3,
        metavar="R",
        help="highest learning rate of AdamW; it falls along a cosine (default: 0.002)",
    )
    learning.add_argument(
        "--seed",
        type=whole_number,
        default=0,
        metavar="N",
        help="for weights, order, augmentation, split and simulation (default: 0)",
    )
    add_precision(learning)
    learning.add_argument(
        "--translate",
        type=int,
        default=0,
        metavar="PX",
        help="also move each window by a whole number of pixels, up to PX (default: 0; the thesis: 4, with "
        "--landmark regressor)",
    )
    learning.add_argument(
        "--partial",
        type=float,
        metavar="SHARE",
        help="of the windows, those that end early, at a random moment: more of them make early decisions better "
        f"(default: {Augmentation.partial:g}; with DATASET {STREAMED['partial']:g})",
    )
    learning.add_argument(
        "--nothing",
        type=float,
        metavar="SHARE",
        help="of the windows, those whose events are put anywhere on the sensor, so that no class is decided with "
        f"confidence where nothing is there (default: {Augmentation.nothing:g}; with DATASET {STREAMED['nothing']:g})",
    )
    learning.add_argument(
        "--mirror",
        action=argparse.BooleanOptionalAction,
        help="also show windows mirrored from left to right; not where a class would become another one (default: "
        "no; with DATASET what does better)",
    )
    learning.add_argument("--no-augmentation", action="store_true", help="train on the windows as they are")
    learning.add_argument(
        "--keep",
        choices=("last", "best"),
        help="weights to write: after the last epoch, or after the best one (default: last; with patience, best); both "
        "are in the run folder",
    )
    learning.add_argument(
        "--threads",
        type=positive_int,
        metavar="N",
        help="torch's threads; another number gives slightly different weights",
    )
    learning.add_argument(
        "--smoke", action="store_true", help="try everything in seconds: two epochs on the ten bundled samples"
    )
    files = parser.add_argument_group("files")
    files.add_argument(
        "--start-from",
        metavar="MODEL",
        help="continue from a model file or a bundled model, instead of random weights; the volume is that model's. "
        "Keep --seed, and with it the recordings that are held out",
    )
    files.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="the trained model, a .safetensors file (default: model.safetensors; with --smoke: smoke.safetensors)",
    )
    files.add_argument(
        "--run",
        type=Path,
        metavar="FOLDER",
        help="checkpoints and learning curves of one run, which resumes from there (default: runs/<name of --out>)",
    )
    files.add_argument("--json", action="store_true", help="print the results as JSON on stdout")
