"""The filter that drops events by pixel: outside a region of interest, or at masked pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError, is_whole
from async_tnt.base.messages import short
from async_tnt.base.running import Running, one_at_a_time
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.sources.pixels import KEEP, MASKED, OUTSIDE, keep_events
from async_tnt.sources.pixels.pixel_masks import checked_mask, load_mask
from async_tnt.volume.events import EVENT_DTYPE, EventDecoder
from async_tnt.volume.sensor import checked_sensor, format_size


@dataclass(frozen=True, slots=True)
class PixelCounts:
    """What became of the events so far: received = kept + dropped_masked + dropped_outside."""

    received: int = 0
    """Events in total."""
    kept: int = 0
    """Events that are handed on."""
    dropped_masked: int = 0
    """Events at masked pixels inside the region of interest."""
    dropped_outside: int = 0
    """Events outside the region of interest, at masked pixels or not."""


class PixelFilter:
    """Keeps the events of a region of interest whose pixels are not masked, in their order.

    Parameters
    ----------
    sensor : (width, height) of the camera.
    roi : region of interest (x, y, width, height), its upper left pixel and its size; None: the
        whole sensor.
    mask : bool array of shape (H, W), of the whole sensor, True where a pixel's events are dropped;
        or the path of such a `.npy` file; None: no pixel is masked.
    crop : shift coordinates to the region's upper left corner.

    Attributes
    ----------
    sensor : (width, height) of the filtered packets: the region's size with `crop`, else the
        camera's.

    Raises
    ------
    ValueError : the region lies off the sensor, the mask has another type or shape, or its file is
        damaged.
    OSError : the mask file is missing or not readable.

    Example
    -------
    >>> right_half = PixelFilter((34, 34), roi=(17, 0, 17, 34), crop=True)
    >>> right_half(([10, 11], [5, 20], [3, 4], [1, 0])).tolist()  # t, x, y, p
    [(11, 3, 4, 0)]
    >>> right_half.sensor, right_half.counts.dropped_outside
    ((17, 34), 1)
    """

    def __init__(
        self,
        sensor: tuple[int, int],
        roi: tuple[int, int, int, int] | None = None,
        mask: np.ndarray | str | os.PathLike[str] | None = None,
        *,
        crop: bool = False,
    ) -> None:
        prepare(keep_events)
        width, height = checked_sensor(sensor)
        check_crop(crop, roi)
        whole_sensor = (0, 0, width, height)
        self.roi = checked_region(whole_sensor if roi is None else roi, (width, height))
        if isinstance(mask, (str, os.PathLike)):
            mask = load_mask(mask, (width, height))
        elif mask is not None:
            mask = checked_mask(mask, (width, height))

        left, top, roi_width, roi_height = self.roi
        self.crop = bool(crop)
        self.sensor = (roi_width, roi_height) if crop else (width, height)
        inside = np.s_[top : top + roi_height, left : left + roi_width]
        self._verdicts = np.full((height, width), OUTSIDE, np.uint8)
        # a pixel whose mask is False gets 0, which is KEEP
        self._verdicts[inside] = KEEP if mask is None else mask[inside] * np.uint8(MASKED)
        self._corner = (left, top) if crop else (0, 0)
        self._decoder = EventDecoder((width, height))
        self._running = Running("PixelFilter")
        self.reset()

    @one_at_a_time
    def __call__(self, events: Any) -> np.ndarray:
        """The events of a packet to keep, as a new array of `EVENT_DTYPE`.

        Parameters
        ----------
        events : a packet in any form that `async_tnt.volume.event_forms` lists.

        Raises
        ------
        ValueError, TypeError : events are invalid, as for `Processor.push`. Their packet is not
            counted.
        """
        t, x, y, p, n = self._decoder.decode(events)
        records = np.empty(n * EVENT_DTYPE.itemsize, np.uint8)
        n_kept, n_masked = keep_events.call(t, x, y, p, n, self._verdicts, *self._corner, records)
        self._received += n
        self._kept += n_kept
        self._masked += n_masked
        return records[: n_kept * EVENT_DTYPE.itemsize].view(EVENT_DTYPE)

    @property
    def counts(self) -> PixelCounts:
        """The number of events so far, and what became of them."""
        outside = self._received - self._kept - self._masked
        return PixelCounts(self._received, self._kept, self._masked, outside)

    def reset(self) -> None:
        """Set the counts to zero."""
        self._received = 0
        self._kept = 0
        self._masked = 0

    def __repr__(self) -> str:
        return f"PixelFilter(roi={self.roi}, crop={self.crop}, {self.counts})"


def check_crop(crop: bool, roi: Any) -> None:
    """Refuse `crop` without a region."""
    if crop and roi is None:
        rule = "belongs to {roi}: the region that becomes the sensor"
        raise ParameterValueError("crop", rule)


def checked_region(roi: Any, sensor: tuple[int, int] | None = None) -> tuple[int, int, int, int]:
    """The region (x, y, width, height) as four Python integers.

    Parameters
    ----------
    sensor : (width, height) that the region must lie on; None: any.

    Raises
    ------
    ParameterValueError : `roi` is not four whole numbers, or lies off the sensor.
    """
    try:
        numbers = tuple(roi)
    except TypeError:
        numbers = ()
    if len(numbers) != 4 or not all(map(is_whole, numbers)):
        rule = "must be (x, y, width, height) in whole pixels"
        raise ParameterValueError("roi", rule, short(roi))
    left, top, width, height = map(int, numbers)
    region = (left, top, width, height)
    is_beyond = False
    if sensor is not None:
        is_beyond = left + width > sensor[0] or top + height > sensor[1]
    if min(left, top) < 0 or min(width, height) < 1 or is_beyond:
        pixels = "" if sensor is None else f" of {format_size(sensor)} pixels"
        rule = (
            f"(x, y, width, height) must lie on the sensor{pixels}, x and y at least 0, and hold "
            "at least one pixel"
        )
        raise ParameterValueError("roi", rule, region)
    return region
