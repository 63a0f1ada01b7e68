"""Pixels: one frozen value that says which pixels count, and can be compared, sent and stored."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.sources.files.source_error import SourceError
from async_tnt.sources.pixels.pixel_filter import PixelFilter, check_crop, checked_region
from async_tnt.sources.pixels.pixel_masks import PackedMask, load_mask
from async_tnt.volume.sensor import Sensor, checked_sensor, format_size

Region = tuple[int, int, int, int]


@dataclass(frozen=True, init=False)
class Pixels:
    """The pixels whose events count: frozen, picklable and without state.

    `filter_of` gives the `PixelFilter` that leaves out the events of the other pixels.

    Parameters
    ----------
    roi : region of interest (x, y, width, height); None: the whole sensor.
    crop : whether the region becomes the sensor: coordinates are shifted to its upper left corner.
    mask : the pixels whose events are left out: a bool array of shape (H, W) of the whole camera,
        or the path of a `.npy` file with one. It is kept packed. None: no pixel.
    sensor : (width, height) of the camera, for sources that do not state it.

    Raises
    ------
    ValueError : `crop` is set without `roi`; the region or the sensor is impossible; or the mask is
        damaged, or has another size than `sensor`.
    OSError : the mask file is missing or not readable.

    Example
    -------
    >>> Pixels(roi=(40, 20, 34, 34), crop=True).about
    {'roi': '40,20,34,34', 'crop': True}
    >>> Pixels().about
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
        packed = _packed(mask)
        check_crop(crop, roi)
        if roi is not None:
            roi = checked_region(roi)
        if sensor is not None:
            sensor = checked_sensor(sensor)
        if packed is not None and sensor is not None and sensor != packed.size:
            raise SourceError(
                packed.name,
                f"a mask of {format_size(packed.size)} pixels, but the camera's are given as "
                f"{format_size(sensor)} ({{sensor}})",
            )
        object.__setattr__(self, "roi", roi)
        object.__setattr__(self, "crop", crop)
        object.__setattr__(self, "mask", packed)
        object.__setattr__(self, "sensor", sensor)

    @property
    def camera(self) -> Sensor | None:
        """The size of the camera, (width, height), from `sensor` or from the mask.

        None if neither is given. Then the source must state its size.
        """
        return self.sensor if self.mask is None else self.mask.size

    @property
    def region(self) -> Sensor | None:
        """The size (width, height) of the region that becomes the sensor; None without `crop`."""
        if self.roi is None or not self.crop:
            return None
        return self.roi[2], self.roi[3]

    @property
    def origin(self) -> str:
        """Where `camera` is from: the words of a `SourceError` before the camera's size."""
        if self.mask is None or self.sensor is not None:
            return "{sensor} says"
        return f"{self.mask.name} is a mask of"

    @property
    def leaves_out(self) -> bool:
        """Whether any event could be dropped."""
        return self.roi is not None or self.mask is not None

    @property
    def about(self) -> dict[str, Any]:
        """The options that decide which events count, by name, with short values for JSON.

        The dict is empty if all events count. The results of an evaluation contain it, so that
        results of different pixels are not mixed. The record of a trained model contains it, too.

        `sensor` is included only without a mask, because a recording of another camera than
        `sensor` has an error instead of a result. With a mask, `sensor` could only repeat the
        mask's size.
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

    def mask_of(self, camera: Sensor) -> np.ndarray | None:
        """The mask: bool, shape (H, W); None if no pixel is masked.

        Raises
        ------
        ValueError : the mask is not of this `camera` (width, height).
        """
        return None if self.mask is None else self.mask.unpacked(camera)

    def filter_of(self, camera: Sensor) -> PixelFilter | None:
        """The filter for packets of a `camera` (width, height); None if every event counts.

        Raises
        ------
        ValueError : the region or the mask does not fit the camera.
        """
        if not self.leaves_out:
            return None
        return PixelFilter(camera, self.roi, self.mask_of(camera), crop=self.crop)


def _packed(mask: PackedMask | np.ndarray | str | os.PathLike[str] | None) -> PackedMask | None:
    """The packed form of a mask that is an array, a file's path, or packed already."""
    if mask is None or isinstance(mask, PackedMask):
        return mask
    if isinstance(mask, (str, os.PathLike)):
        return PackedMask.of(load_mask(mask), str(mask))
    return PackedMask.of(mask)
