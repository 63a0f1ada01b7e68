"""The options that leave out events by their pixels, before anything else sees them."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..datasets.sizes import parse_size, size_text
from ..pixels.selection import PixelSelection, Region
from ..pixels.selector import PixelSelector
from .files import Sensor


def add_pixels(parser: argparse.ArgumentParser) -> None:
    """--roi, --crop, --mask, and --sensor: for a model that there is."""
    add_selection(parser)
    parser.add_argument(
        "--sensor", type=size_text, metavar="WxH",
        help="of --crop: the camera's pixels, where neither recording nor camera says, nor a mask by its size",
    )  # fmt: skip


def add_selection(parser: argparse._ActionsContainer) -> None:
    """--roi, --crop and --mask."""
    parser.add_argument(
        "--roi", type=_roi_text, metavar="X,Y,W,H",
        help="region of interest: leave out the events outside of W x H pixels, of which X,Y is the upper left one",
    )  # fmt: skip
    parser.add_argument(
        "--crop", action="store_true",
        help="of --roi: the region is the sensor, so that a large camera fits a model for W x H pixels",
    )  # fmt: skip
    parser.add_argument(
        "--mask", type=Path, metavar="FILE", help="leave out the events of hot pixels, as `async-tnt mask` found them"
    )


def selector_of(args: argparse.Namespace, sensor: Sensor) -> PixelSelector:
    """What a model for (width, height) pixels is to see, by the options of `add_pixels`.

    Raises
    ------
    ValueError, OSError : options that do not go together, a region of another size than the model's sensor, or a mask
        that is missing, damaged, or of another sensor.
    """
    if args.sensor is not None and not args.crop:
        raise ValueError(f"--sensor belongs to --crop; without it the model says: {sensor[0]}x{sensor[1]} pixels")
    return PixelSelector(selection_of(args), sensor)


def selection_of(args: argparse.Namespace) -> PixelSelection:
    """As the options say; the mask is read.

    Raises
    ------
    ValueError, OSError : options that do not go together; a mask that is missing, damaged or none.
    """
    roi = None if args.roi is None else parse_roi(args.roi)
    return PixelSelection.read(roi, args.crop, args.mask, None if args.sensor is None else parse_size(args.sensor))


def parse_roi(text: str) -> Region:
    """`100,80,34,34` as (100, 80, 34, 34).

    Raises
    ------
    ValueError : not four whole numbers.
    """
    try:
        left, top, width, height = (int(number) for number in text.split(","))
    except ValueError:
        raise ValueError(f"must be four whole numbers X,Y,WIDTH,HEIGHT, such as 100,80,34,34, got {text!r}") from None
    return left, top, width, height


def _roi_text(text: str) -> str:
    """An argparse type: the region as text, checked; so a command keeps it as it was given."""
    try:
        return ",".join(map(str, parse_roi(text)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
