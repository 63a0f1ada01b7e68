"""The options that choose pixels. Events of other pixels are left out before anything else."""

from __future__ import annotations

import argparse
import contextlib

from async_tnt.base.files import user_path
from async_tnt.cli.options import paths_of, reading_of, size_of
from async_tnt.networks.models.model import Model
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixels.model_pixels import ModelPixels
from async_tnt.sources.pixels.pixels import Pixels, Region
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.sensor import Sensor


def add_pixels(parser: argparse.ArgumentParser) -> None:
    """Add --roi, --crop, --mask and --sensor, for commands that load a model."""
    add_selection(parser)
    parser.add_argument(
        "--sensor",
        type=size_of,
        metavar="WxH",
        help="the camera's pixels, if the recording does not state them. Without --crop, they are "
        "those of the model; with it, a .bin has 34x34 by default",
    )


def add_selection(parser: argparse._ActionsContainer) -> None:
    """Add --roi, --crop and --mask."""
    parser.add_argument(
        "--roi",
        type=_region,
        metavar="X,Y,W,H",
        help="region of interest: leave out the events outside of W x H pixels, X,Y being the "
        "upper left one",
    )
    parser.add_argument(
        "--crop",
        action="store_true",
        help="with --roi: the region becomes the sensor, so that a large camera fits a model for "
        "W x H pixels",
    )
    parser.add_argument(
        "--mask",
        type=user_path,
        metavar="FILE",
        help="leave out hot pixels, found by `async-tnt mask`",
    )


def pixels_of(args: argparse.Namespace) -> Pixels:
    """The pixels that the options choose. The file of --mask is read here.

    Raises
    ------
    ValueError, OSError : the options exclude each other; or the file of --mask is missing, damaged
        or not a mask.
    """
    return Pixels(args.roi, args.crop, args.mask, args.sensor)


def model_pixels_of(pixels: Pixels, model: Model | TNTConfig) -> ModelPixels:
    """The pixels that a model sees.

    Raises
    ------
    ValueError : the region, the mask or the camera has another size than the model's sensor.
    """
    if isinstance(model, TNTConfig):
        return ModelPixels(pixels, model.sensor)
    return ModelPixels(pixels, model.config.sensor, any_size=model.places is not None)


def map_model_sensor(pixels: Pixels, args: argparse.Namespace) -> Sensor | None:
    """The (width, height) of the sensor for which a map model is loaded; None if not known yet.

    The options come first: the region with --crop, else the camera's size from --sensor or from the
    mask. Without them it is the sensor that the first recording states.
    """
    size_from_options = pixels.region or pixels.camera
    if size_from_options is not None:
        return size_from_options
    paths = paths_of(args)
    if not paths or isinstance(paths[0], str):  # a camera or the network
        return None
    # an error of the recording is reported later, when its events are read
    with contextlib.suppress(OSError, ValueError, ImportError, MemoryError):
        return open_recording(paths[0], **reading_of(args)).sensor
    return None


def _region(text: str) -> Region:
    """Read `100,80,34,34` as (100, 80, 34, 34). This is an argparse type."""
    try:
        left, top, width, height = [int(number) for number in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be four whole numbers X,Y,WIDTH,HEIGHT, such as 100,80,34,34, got {text!r}"
        ) from None
    return left, top, width, height
