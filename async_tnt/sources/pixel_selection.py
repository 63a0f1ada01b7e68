"""Which pixels a model sees, as plain values that can be compared, sent and stored."""

from __future__ import annotations

import os
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
    TypeError : a mask of another type.
    OSError : its file is missing or not readable.

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
                f"{format_size(self.sensor)} (`sensor`)"
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

        Results have it so that those of different selections are not mixed, and the record of a trained model has it.

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
