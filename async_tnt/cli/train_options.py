"""The options of `async-tnt train`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from async_tnt.base.files import user_path
from async_tnt.cli.options import (
    add_reading,
    add_volume,
    number,
    positive_int,
    size_of,
    whole_number,
)
from async_tnt.cli.pixel_options import add_selection
from async_tnt.simulation.picture_scene import SceneSettings

USAGE = "async-tnt train DATASET [--sensor WxH] [--out FILE] [options]"
DESCRIPTION = """\
Train a classifier on recordings of your own classes, and tell how good it is
on recordings that were held out. DATASET has one folder for each class, of
recordings from any camera and in any format that `async-tnt run` reads, or of
pictures, which simulated cameras record in many motions, or of both:

  async-tnt train gestures --out gestures.safetensors   # gestures/wave/*.npz ...
  async-tnt train pictures --sensor 640x480             # pictures/cup/*.jpg ...
  async-tnt train gen1 --everywhere                     # recordings with tables of boxes
  async-tnt train pictures --everywhere --scales 0.08-0.33 --sensor 240x180
  async-tnt evaluate gestures.safetensors other         # on other recordings
  async-tnt run --model gestures.safetensors camera     # use it
  async-tnt teach gestures.safetensors --class point point/*.npz --out more.safetensors

Beside the model it writes gestures.json and, with the extra `plot`, a picture of
its curves. Stop with Ctrl-C and give the same command again: it resumes from
runs/gestures, and on the same machine ends with the same weights. To begin
again, remove runs/gestures.
"""


REMOVED = {
    "--teacher": "in Python, give `teachers` to async_tnt.training.fit",
    "--follow": "in Python, give scenes={'follow': True} to async_tnt.training.dataset_data",
    "--light": "in Python, give scenes={'light': 'positive'} to async_tnt.training.dataset_data",
    "--restart": "remove the folder of the run, runs/NAME beside the model",
}
"""Option of the previous version -> what to do instead."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `async-tnt train` to its parser."""
    parser.usage = USAGE
    parser.add_argument(
        "dataset",
        type=user_path,
        metavar="DATASET",
        help="<class name>/<recordings or pictures>, or Train/<class name>/... (and Test/...), "
        "or recordings with tables",
    )
    parser.add_argument(
        "--sensor",
        type=size_of,
        metavar="WxH",
        help="the camera's pixels, if the recordings do not state them",
    )
    add_reading(parser, single=False)
    parser.add_argument(
        "--out",
        type=user_path,
        default=Path("model.safetensors"),
        metavar="FILE",
        help="the trained model (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the results as JSON on stdout")
    parser.add_argument(
        "--no-statistics",
        dest="statistics",
        action="store_false",
        help="leave out what `teach` needs, up to 3 MB",
    )
    _add_held_out(parser.add_argument_group("what is held out"))
    _add_training_data(parser.add_argument_group("what is learned from"))
    _add_pictures(parser.add_argument_group("how pictures are recorded"))
    _add_network(parser.add_argument_group("volume and network"))


def _add_held_out(group: argparse._ActionsContainer) -> None:
    """Add the options that say what is held out."""
    group.add_argument(
        "--validation",
        type=_share,
        default=0.2,
        metavar="SHARE",
        help="held-out share of each class (default: 0.2)",
    )
    group.add_argument(
        "--groups",
        metavar="PATTERN",
        help=r"a regular expression, such as 'user\d+': files in whose names it finds the same "
        "text stay together (default: the last of each class by number, or at random)",
    )
    group.add_argument("--test", action="store_true", help="at the end, classify the folder Test")


def _add_training_data(group: argparse._ActionsContainer) -> None:
    """Add the options that say what is learned from."""
    add_selection(group)
    group.add_argument(
        "--mirror", action="store_true", help="mirror half of the windows, if that keeps the class"
    )
    group.add_argument(
        "--motions",
        choices=("recorded", "resynthesized"),
        default="recorded",
        help="resynthesized: also show what was recorded in other motions, which are simulated "
        "(default: recorded)",
    )


def _add_pictures(group: argparse._ActionsContainer) -> None:
    """Add the options that say how pictures are recorded."""
    group.add_argument(
        "--size",
        type=_range,
        default=SceneSettings.size,
        metavar="MIN-MAX",
        help="the picture's longer side, as a share of the sensor's shorter side "
        "(default: 0.4-0.8)",
    )
    group.add_argument(
        "--scales",
        type=_range,
        metavar="MIN-MAX",
        help="with --everywhere, for pictures only: objects of many sizes in scenes of the sensor, "
        "measured as by --size, in its place. `for_sensor` fits the model to sensors of other "
        "resolution",
    )
    group.add_argument(
        "--camera",
        type=user_path,
        metavar="RECORDING",
        help="a minute of anything from your camera, to measure its noise and refractory time",
    )


def _add_network(group: argparse._ActionsContainer) -> None:
    """Add the options that choose the volume and the network."""
    length = group.add_mutually_exclusive_group()
    length.add_argument(
        "--window-us",
        type=positive_int,
        metavar="US",
        help="length of a window (default: 105000, or the longest recording)",
    )
    length.add_argument(
        "--last-us",
        type=positive_int,
        metavar="US",
        help="a window that slides: always the last US microseconds",
    )
    length.add_argument(
        "--last-events",
        type=positive_int,
        metavar="N",
        help="a window that slides: always the last N events",
    )
    group.add_argument(
        "--grid",
        type=size_of,
        metavar="WxH",
        help="size of the volume (default: the sensor's, at most 120 on its longer side)",
    )
    add_volume(group, "ON and OFF counts, or 5 bins, by the data")
    group.add_argument(
        "--everywhere",
        action="store_true",
        help="a model that finds objects anywhere; it learns from scenes of several recordings, "
        "or from tables of boxes",
    )
    group.add_argument(
        "--network",
        metavar="NAME",
        help="residual (default), wide, conv4, separable, thesis, map or boxes (--everywhere), "
        "or FILE.py:FUNCTION, of channels, (width, height) and n_classes",
    )
    group.add_argument(
        "--epochs",
        type=positive_int,
        metavar="N",
        help="number of epochs (default: 20, or as many as make 4000 steps; fewer if all "
        "that is held out stays right)",
    )
    group.add_argument(
        "--seed",
        type=whole_number,
        default=0,
        metavar="N",
        help="seed of weights, order and groups (default: 0)",
    )


def _range(text: str) -> tuple[float, float]:
    """Read `0.4-0.8` as two numbers, and `0.5` as that number twice. This is an argparse type."""
    low, _, high = text.partition("-")
    try:
        least = float(low)
        most = float(high or low)
    except ValueError:
        # nan does not pass the check below
        least = math.nan
        most = math.nan
    if not 0 < least <= most <= 1:
        raise argparse.ArgumentTypeError(
            f"expected a range such as 0.4-0.8, within 0 and 1, got {text!r}"
        )
    return least, most


def _share(text: str) -> float:
    """Read a number in [0, 1). This is an argparse type."""
    return number(text, lambda value: 0 <= value < 1, "a share in [0, 1)")
