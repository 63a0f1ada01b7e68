"""async-tnt mask: find the hot pixels of recordings."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.files import check_writable, user_path
from async_tnt.base.progress import progress
from async_tnt.cli.options import SUFFIXES_TEXT, add_reading, reading_of, sample_or_path, size_of
from async_tnt.cli.output import say
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixels.hot_pixels import count_pixels, hot_pixels, listed_pixels
from async_tnt.sources.pixels.pixel_masks import save_mask
from async_tnt.volume.sensor import check_sensor, format_size

DESCRIPTION = """\
Find the hot pixels of a camera: those with far more events than their neighbours and
the whole sensor would explain. Several recordings of one camera count as one.

  async-tnt mask desk.npz --out mask.npy               find them in a recording
  async-tnt mask a.npy b.npy --sensor 346x260 --out mask.npy

The second command is for files that do not state their sensor. Record something that
moves across the whole image, or a still scene, for some seconds.

The mask is a .npy file, bool, of shape (height, width), True where a pixel is hot:

  pixel_filter = async_tnt.sources.PixelFilter((346, 260), mask="mask.npy")
  async_tnt.stream(map(pixel_filter, camera), model)

A pixel is hot if it has 5 times more events than the 4th busiest of the 24 pixels
around it and than the mean pixel, and if chance would not do that in one of a hundred
sensors. A sensor may have up to 2^24 pixels. Exit code 0 also if no pixel is hot: the
mask then leaves nothing out.
"""
MOST_LISTED = 10
"""Number of hot pixels that are printed, at most. They are the busiest ones."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="RECORDING",
        type=user_path,
        help=f"recordings ({SUFFIXES_TEXT}), or digits of bundled ones",
    )
    parser.add_argument(
        "--out",
        type=user_path,
        metavar="FILE",
        required=True,
        help="the mask, a .npy file, overwritten if it exists",
    )
    parser.add_argument(
        "--sensor",
        type=size_of,
        metavar="WxH",
        help="the camera's pixels, if the recordings do not state them; a .bin has 34x34 unless "
        "given here",
    )
    add_reading(parser)
    parser.add_argument(
        "--json", action="store_true", help="one JSON object: the pixels and their events"
    )


def main(args: argparse.Namespace) -> int:
    """Run `async-tnt mask`. Returns the exit code."""
    check_writable(args.out, (".npy",))
    if args.out.exists() and any(path.exists() and path.samefile(args.out) for path in args.files):
        raise ValueError(f"--out is one of the recordings, {args.out}")
    counts = _count([sample_or_path(path) for path in args.files], args.sensor, reading_of(args))
    n_events = int(counts.sum())
    if n_events == 0:
        raise ValueError(
            f"{', '.join(map(str, args.files))}: no events, no hot pixels can be found"
        )
    hot = hot_pixels(counts)
    save_mask(args.out, hot)
    _report(counts, hot, args)
    return 0


def _count(
    paths: list[Path], sensor: tuple[int, int] | None, reading: Mapping[str, Any]
) -> np.ndarray:
    """The number of events of each pixel over all recordings: int64, shape (H, W).

    Parameters
    ----------
    sensor : (width, height) of --sensor; None without this option.
    reading : arguments of `open_recording`, see `reading_of`.

    Raises
    ------
    ValueError, OSError : a recording does not state its sensor, and neither do --sensor and the
        recordings before it; two recordings have different sensors; or a recording cannot be read.
    """
    counts = np.zeros((), np.int64)  # the first sum below has shape (H, W)
    camera = sensor  # or the sensor of the first recording that states one
    with progress(len(paths), "counting events") as bar:
        for path in paths:
            recording = open_recording(path, sensor=sensor, **reading)
            # a recording that does not state its sensor is taken to have that of an earlier one
            recording.sensor = recording.sensor or camera
            if recording.sensor is None:
                raise ValueError(
                    f"{path}: the file does not state the camera's sensor; give --sensor WxH"
                )
            camera = camera or recording.sensor
            check_sensor(path, recording.sensor, camera, "--sensor or an earlier recording has")
            try:
                counts = counts + count_pixels(recording, camera)
            except ValueError as error:
                if str(path) in str(error):  # the error names the recording already
                    raise
                raise ValueError(f"{path}: {error}") from None
            bar.update()
    return counts


def _report(counts: np.ndarray, hot: np.ndarray, args: argparse.Namespace) -> None:
    """Print the hot pixels and their numbers of events.

    Parameters
    ----------
    counts : int64, (H, W): the number of events of each pixel.
    hot : bool, (H, W): whether a pixel is hot.
    """
    pixels = listed_pixels(counts, hot)
    n_events = int(counts.sum())
    share = float(counts[hot].sum() / counts.sum())
    height, width = counts.shape
    if args.json:
        result = {
            "sensor": [width, height],
            "events": n_events,
            "hot_pixels": pixels,
            "share": share,
            "out": str(args.out),
        }
        say(json.dumps(result))
        return
    size = format_size((width, height))
    if not pixels:
        say(
            f"no hot pixels: none of {size} stands out in {n_events} events; wrote {args.out}, "
            "which masks nothing"
        )
        return
    for pixel in pixels[:MOST_LISTED]:
        say(
            f"x {pixel['x']:>5}  y {pixel['y']:>5}  {pixel['events']:>9} events  "
            f"{pixel['events'] / n_events:6.2%}"
        )
    if len(pixels) > MOST_LISTED:
        say(f"... and {len(pixels) - MOST_LISTED} more")
    number_of_pixels = "1 hot pixel" if len(pixels) == 1 else f"{len(pixels)} hot pixels"
    say(f"{number_of_pixels} of {size} made {share:.2%} of {n_events} events; wrote {args.out}")
