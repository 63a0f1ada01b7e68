"""Which pixels a model sees, as plain values that can be compared, sent and stored."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.sources.pixel_filter import check_crop, checked_region
from async_tnt.sources.pixel_masks import PackedMask
from async_tnt.sources.sensor import Sensor, checked_sensor, format_size

Region = tuple[int, int, int, int]


@dataclass(frozen=True, init=False)
class PixelSelection:
    """The pixels that a model sees: frozen, picklable and without state; `PixelSelector` applies it.

    Parameters
    ----------
    roi : region of interest (x, y, width, height); None: the whole sensor.
    crop : the region is the model's sensor: coordinates are shifted to its upper left corner.
    mask : pixels of the whole camera whose events are dropped: whatever `PackedMask.of` accepts; None: no pixel.
    sensor : (width, height) of the camera, for sources that do not state it.

    Raises
    ------
    ValueError : `crop` without `roi`; an impossible region or sensor; a mask that is empty, damaged, or of another size
        than `sensor`.
    TypeError : a mask of another type. OSError : its file is missing or not readable.

    Example
    -------
    >>> PixelSelection(roi=(40, 20, 34, 34), crop=True).about
    {'roi': '40,20,34,34', 'crop': True}
    >>> PixelSelection().about
    {}
    """

    roi: Region | None
    crop: bool
    mask: PackedMask | None
    sensor: Sensor | None

    def __init__(
        self,
        roi: Region | None = None,
        crop: bool = False,
        mask: PackedMask | np.ndarray | str | os.PathLike[str] | None = None,
        sensor: Sensor | None = None,
    ) -> None:
        check_crop(crop, roi)
        # As tuples of integers, so that equal ones are equal. The mask comes last: it may be a large file.
        values = {
            "roi": None if roi is None else checked_region(roi),
            "crop": bool(crop),
            "sensor": None if sensor is None else checked_sensor(sensor),
            "mask": None if mask is None else PackedMask.of(mask),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.mask is not None and self.sensor is not None and self.sensor != self.mask.size:
            raise ValueError(
                f"{self.mask.name}: a mask of {format_size(self.mask.size)} pixels, but the camera's are given as "
                f"{format_size(self.sensor)} (--sensor)"
            )

    @property
    def camera(self) -> Sensor | None:
        """(width, height) of the camera, from `sensor` or the mask's size; None if the source must state it."""
        return self.sensor if self.mask is None else self.mask.size

    @property
    def region(self) -> Sensor | None:
        """(width, height) of what the model sees with `crop`; None without."""
        return (self.roi[2], self.roi[3]) if self.crop and self.roi is not None else None

    @property
    def leaves_out(self) -> bool:
        """Whether any event could be dropped."""
        return self.roi is not None or self.mask is not None

    @property
    def about(self) -> dict[str, Any]:
        """Option -> value, short and for JSON, of all that decides which events are seen; {} for all events.

        With a mask, `sensor` could only repeat its size. Without one, it decides which recordings are of this camera,
        and so which have results and which errors: results of different sensors must not be mixed.
        """
        options: dict[str, Any] = {}
        if self.roi is not None:
            options["roi"] = ",".join(map(str, self.roi))
        if self.crop:
            options["crop"] = True
        if self.mask is not None:
            options["mask"] = f"{format_size(self.mask.size)} {self.mask.sha256[:16]}"
        elif self.sensor is not None:
            options["sensor"] = format_size(self.sensor)
        return options

    @property
    def record(self) -> dict[str, Any]:
        """For a model's training record: which events it learned from; {} for all events."""
        record: dict[str, Any] = {}
        if self.roi is not None:
            record |= {"roi": list(self.roi), "crop": self.crop}
        if self.mask is not None:
            record |= {"masked_pixels": self.mask.n_pixels, "mask_sha256": self.mask.sha256}
        return record


def difference(record: Mapping[str, Any], selection: PixelSelection) -> str:
    """How a selection differs from the one that a model was trained with, in one line; "" if it does not.

    Parameters
    ----------
    record : `Model.record`; `async-tnt train` stores its selection in `record["data"]["pixels"]`. Without one, nothing
        differs.
    selection : what the model sees now. Cameras are compared if it names one.

    Example
    -------
    >>> record = {"data": {"pixels": {"roi": [10, 4, 40, 40], "crop": True, "camera": [60, 48]}}}
    >>> difference(record, PixelSelection((0, 0, 40, 40), crop=True))
    'trained with --roi 10,4,40,40 --crop, but now it is --roi 0,0,40,40 --crop'
    >>> difference(record, PixelSelection((10, 4, 40, 40), crop=True))
    ''
    """
    data = record.get("data")
    pixels = data.get("pixels") if isinstance(data, Mapping) else None
    if not isinstance(pixels, Mapping):
        return ""
    then, now = _options(pixels), _options(selection.record)
    camera = _numbers(pixels.get("camera"))
    if len(camera) == 2 and selection.camera is not None and selection.camera != tuple(camera):
        then.append(f"of a {camera[0]}x{camera[1]} camera")
        now.append(f"of a {format_size(selection.camera)} camera")
    if then == now:
        return ""
    return f"trained with {' '.join(then) or 'all pixels'}, but now it is {' '.join(now) or 'all pixels'}"


def _options(pixels: Mapping[str, Any]) -> list[str]:
    """As on the command line. A record comes from a file, and may hold anything."""
    options = []
    roi = _numbers(pixels.get("roi"))
    if roi:
        options.append("--roi " + ",".join(map(str, roi)))
        if pixels.get("crop") is True:
            options.append("--crop")
    if pixels.get("mask_sha256") is not None:
        options.append(f"--mask of {pixels.get('masked_pixels')} pixels ({str(pixels['mask_sha256'])[:16]})")
    return options


def _numbers(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else []
