"""The options that leave out events by their pixels, before anything else sees them."""

from __future__ import annotations

import argparse
import contextlib

from async_tnt.base.files import user_path
from async_tnt.cli.options import paths_of, reading_of, size_of
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixels.pixel_masks import PackedMask, load_mask
from async_tnt.sources.pixels.pixel_selection import PixelSelection, PixelSelector, Region
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor


def add_pixels(parser: argparse.ArgumentParser) -> None:
    """--roi, --crop, --mask and --sensor, for commands that load a model."""
    add_selection(parser)
    parser.add_argument(
        "--sensor",
        type=size_of,
        metavar="WxH",
        help="the camera's pixels, if the recording does not state them. Without --crop, they are those of the model; "
        "with it, a .bin has 34x34 by default",
    )


def add_selection(parser: argparse._ActionsContainer) -> None:
    """--roi, --crop and --mask."""
    parser.add_argument(
        "--roi",
        type=_region,
        metavar="X,Y,W,H",
        help="region of interest: leave out the events outside of W x H pixels, X,Y being the upper left one",
    )
    parser.add_argument(
        "--crop",
        action="store_true",
        help="with --roi: the region becomes the sensor, so that a large camera fits a model for W x H pixels",
    )
    parser.add_argument(
        "--mask",
        type=user_path,
        metavar="FILE",
        help="leave out hot pixels, found by `async-tnt mask`",
    )


def selector_of(selection: PixelSelection, model: Model | TNTConfig) -> PixelSelector:
    """The pixels that a model sees.

    Raises
    ------
    ValueError : a region, a mask or a camera of another size than the model's sensor.
    """
    if isinstance(model, TNTConfig):
        return PixelSelector(selection, model.sensor)
    return PixelSelector(selection, model.config.sensor, any_size=model.places is not None)


def selection_of(args: argparse.Namespace) -> PixelSelection:
    """The selection of the options; reads the mask.

    Raises
    ------
    ValueError, OSError : options that exclude each other; a mask file that is missing, damaged or
        not a mask.
    """
    mask = None if args.mask is None else PackedMask.of(load_mask(args.mask), str(args.mask))
    return PixelSelection(args.roi, args.crop, mask, args.sensor)


def sensor_to_read(selection: PixelSelection, args: argparse.Namespace) -> Sensor | None:
    """The pixels that a map model is to read: of a region with --crop, of --sensor, of the mask, or
    of the first file, if it states them."""
    if (given := selection.region or selection.camera) is not None:
        return given
    for path in paths_of(args)[:1]:
        with contextlib.suppress(OSError, ValueError, ImportError):  # which is told when it is read
            return (
                None if isinstance(path, str) else open_recording(path, **reading_of(args)).sensor
            )
    return None


def _region(text: str) -> Region:
    """`100,80,34,34` as (100, 80, 34, 34). An argparse type."""
    try:
        left, top, width, height = (int(number) for number in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be four whole numbers X,Y,WIDTH,HEIGHT, such as 100,80,34,34, got {text!r}"
        ) from None
    return left, top, width, height
