"""The options of `async-tnt train`."""

from __future__ import annotations

import argparse
from pathlib import Path

from async_tnt.cli.options import add_volume, number, positive_int, size_text, whole_number
from async_tnt.cli.pixel_options import add_selection

USAGE = "async-tnt train DATASET [--sensor WxH] [--out FILE] [options]"
DESCRIPTION = """\
Train a classifier on recordings of your own classes, and tell how good it is
on recordings that were held out. DATASET has one folder of recordings for each
class, from any camera and in any format that `async-tnt run` reads:

  async-tnt train gestures --out gestures.safetensors   # gestures/wave/*.npz ...
  async-tnt evaluate gestures.safetensors other         # on other recordings
  async-tnt run --model gestures.safetensors camera     # use it

Beside the model it writes gestures.json and, with the extra `plot`,
gestures.curves.png and gestures.confusion.png. Stop with Ctrl-C and give the same command again: it
resumes from runs/gestures, and on the same machine ends with the same weights.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `async-tnt train` to its parser."""
    parser.usage, parser.description = USAGE, DESCRIPTION
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "dataset",
        type=Path,
        metavar="DATASET",
        help="folder with <class name>/<recordings>, or with Train/<class name>/<recordings> (and Test/...)",
    )
    parser.add_argument(
        "--sensor",
        type=size_text,
        metavar="WxH",
        help="the camera's pixels, where recordings do not state them (a .bin is 34x34 without this option)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("model.safetensors"),
        metavar="FILE",
        help="the trained model (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON on stdout")
    held_out = parser.add_argument_group("what is held out")
    held_out.add_argument(
        "--validation",
        type=_share,
        default=0.2,
        metavar="SHARE",
        help="share of each class's recordings (default: 0.2)",
    )
    held_out.add_argument(
        "--groups",
        metavar="PATTERN",
        help=r"a regular expression on class/file, such as 'user\d+': recordings in whose names it finds the same text "
        "are all trained on or all held out (default: by DATASET/groups.csv, or the last of each class by number, or "
        "at random)",
    )
    held_out.add_argument("--test", action="store_true", help="at the end, classify the folder Test, after all choices")
    seen = parser.add_argument_group("what is learned from")
    add_selection(seen)
    seen.add_argument(
        "--mirror",
        action="store_true",
        help="mirror half of the windows from left to right; only if that never changes the class",
    )
    seen.add_argument(
        "--motions",
        choices=("recorded", "resynthesized"),
        default="recorded",
        help="resynthesized: also simulate what was seen on other paths, to recognize it in motions that were not "
        "recorded (default: recorded)",
    )
    network = parser.add_argument_group("volume and network")
    network.add_argument(
        "--window-us",
        type=positive_int,
        metavar="US",
        help="length of a window (default: 105000, or the longest recording)",
    )
    network.add_argument(
        "--grid", type=size_text, metavar="WxH", help="the volume's pixels (default: at most 120 along the longer side)"
    )
    add_volume(network, "ON and OFF counts, or 5 bins, by the data")
    network.add_argument(
        "--network",
        metavar="NAME",
        help="residual, conv4, separable, thesis, or FILE.py:FUNCTION, your own, of channels, (width, "
        "height), n_classes (default: residual)",
    )
    network.add_argument(
        "--start-from",
        metavar="MODEL",
        help="continue from a model; with its --seed the same recordings are held out",
    )
    network.add_argument(
        "--teacher",
        nargs="+",
        default=[],
        metavar="MODEL",
        help="learn half from the mean probabilities of these models",
    )
    network.add_argument(
        "--epochs",
        type=positive_int,
        metavar="N",
        help="passes over the windows (default: 20, or 4000 steps)",
    )
    network.add_argument(
        "--seed", type=whole_number, default=0, metavar="N", help="of weights, order and held-out groups (default: 0)"
    )


def _share(text: str) -> float:
    return number(text, lambda value: 0 <= value < 1, "a share in [0, 1)")
