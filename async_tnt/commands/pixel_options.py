"""The options that leave out events by their pixels, before anything else sees them."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..datasets.sizes import parse_size, size_text
from ..pixels import PixelFilter
from ..recordings.fitting import TRAIN_ONE, check_sensor
from .files import Sensor


def add_pixels(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--roi", type=_roi, metavar="X,Y,W,H",
        help="region of interest: leave out the events outside of W x H pixels, of which X,Y is the upper left one",
    )  # fmt: skip
    parser.add_argument(
        "--crop", action="store_true",
        help="of --roi: the region is the sensor, so that a large camera fits a model for W x H pixels",
    )  # fmt: skip
    parser.add_argument(
        "--mask", type=Path, metavar="FILE", help="leave out the events of hot pixels, as `async-tnt mask` found them"
    )
    parser.add_argument(
        "--sensor", type=size_text, metavar="WxH",
        help="of --crop: the camera's pixels, where neither recording nor camera says",
    )  # fmt: skip


class PixelOptions:
    """What of a source the model is to see.

    Parameters
    ----------
    args : with the options of `add_pixels`.
    sensor : (width, height) in pixels that the model is for.

    Raises
    ------
    ValueError : options that do not go together, or a region of another size than the model's sensor.
    """

    def __init__(self, args: argparse.Namespace, sensor: Sensor) -> None:
        if args.crop and args.roi is None:
            raise ValueError("--crop belongs to --roi: the region that is to be the sensor")
        if args.sensor is not None and not args.crop:
            raise ValueError(f"--sensor belongs to --crop; without it the model says: {sensor[0]}x{sensor[1]} pixels")
        if args.crop and args.roi[2:] != sensor:
            raise ValueError(
                f"--crop: the model is for {sensor[0]}x{sensor[1]} pixels, got a region of "
                f"{args.roi[2]}x{args.roi[3]}; give --roi X,Y,{sensor[0]},{sensor[1]}"
            )
        self._roi, self._crop, self._mask = args.roi, args.crop, args.mask
        self._given = None if args.sensor is None else parse_size(args.sensor)
        self._sensor = sensor
        self._filters: dict[Sensor, PixelFilter] = {}
        if args.mask is not None or args.roi is not None:
            known = self._given if args.crop else sensor
            if known is not None:
                self._filter(known)  # now, so that mistakes show before the first event

    @property
    def expected(self) -> Sensor | None:
        """The pixels of a source's events, before any is left out; None: the source must say."""
        return self._given if self._crop else self._sensor

    @property
    def advice(self) -> str:
        """What to do with a camera of another size."""
        return f"{TRAIN_ONE}, or cut out a part: --roi X,Y,{self._sensor[0]},{self._sensor[1]} --crop"

    def sensor_of(self, name: Any, found: Sensor | None) -> Sensor:
        """The pixels of a source's events, before any is left out.

        Parameters
        ----------
        name : of the source, for messages.
        found : (width, height) as the source says; None where it does not.

        Raises
        ------
        ValueError : not those that the model is for, or unknown where they are needed.
        """
        wanted = self.expected
        if found is None and wanted is None:
            raise ValueError(f"{name}: does not say the camera's pixels, which --crop needs: give --sensor WxH")
        if wanted is not None:
            if self._crop:
                check_sensor(name, found, wanted, "--sensor says", "")
            else:
                check_sensor(name, found, wanted, advice=f"; {self.advice}")
            return wanted
        assert found is not None
        return found[0], found[1]

    def select(self, packets: Iterable[Any], sensor: Sensor) -> Iterator[Any]:
        """The packets of a source with such a sensor, without the events that are to be left out."""
        if self._roi is None and self._mask is None:
            return iter(packets)
        return map(self._filter(sensor), packets)

    def summary(self) -> str:
        """What was left out so far, in words; "" where nothing came, or nothing could be."""
        counts = [pixel_filter.counts for pixel_filter in self._filters.values()]
        if not any(c.received for c in counts):
            return ""
        told = []
        if self._roi is not None:
            told.append(f"{sum(c.dropped_outside for c in counts):,} outside of the region")
        if self._mask is not None:
            told.append(f"{sum(c.dropped_masked for c in counts):,} of masked pixels")
        return ", ".join(told)

    def _filter(self, sensor: Sensor) -> PixelFilter:
        if sensor not in self._filters:
            self._filters[sensor] = PixelFilter(sensor, self._roi, self._mask, crop=self._crop)
        return self._filters[sensor]


def _roi(text: str) -> tuple[int, int, int, int]:
    try:
        left, top, width, height = (int(number) for number in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be four whole numbers X,Y,WIDTH,HEIGHT, such as 100,80,34,34, got {text!r}"
        ) from None
    return left, top, width, height
