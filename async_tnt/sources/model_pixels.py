"""The pixels that a model was trained with, by its record, and those that it is given now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.sizes import by


def difference(record: Mapping[str, Any], selection: PixelSelection) -> str:
    """What a model's training record says of its pixels, and what is given now, where they differ.

    Parameters
    ----------
    record : `Model.record`; what `async-tnt train` writes of its pixels is in `record["data"]["pixels"]`.
    selection : what the model is to see now.

    Returns
    -------
    One line; "" where nothing differs, or the record knows of no selection. Cameras are compared where this selection
    names its own.

    Example
    -------
    >>> record = {"data": {"pixels": {"roi": [10, 4, 40, 40], "crop": True, "camera": [60, 48]}}}
    >>> difference(record, PixelSelection((0, 0, 40, 40), crop=True))
    'trained with --roi 10,4,40,40 --crop, but now it is --roi 0,0,40,40 --crop'
    >>> difference(record, PixelSelection((10, 4, 40, 40), crop=True))
    ''
    """
    data = record.get("data")
    before = data.get("pixels") if isinstance(data, Mapping) else None
    if not isinstance(before, Mapping):
        return ""
    then, now = _options(before), _options(selection.record)
    camera = _numbers(before.get("camera"))
    if len(camera) == 2 and selection.camera is not None and selection.camera != tuple(camera):
        then.append(f"of a {camera[0]}x{camera[1]} camera")
        now.append(f"of a {by(selection.camera)} camera")
    if then == now:
        return ""
    return f"trained with {' '.join(then) or 'all pixels'}, but now it is {' '.join(now) or 'all pixels'}"


def _options(pixels: Mapping[str, Any]) -> list[str]:
    """As they are given. A record comes from a file, and may hold anything."""
    told = []
    roi = _numbers(pixels.get("roi"))
    if roi:
        told.append("--roi " + ",".join(map(str, roi)))
        if pixels.get("crop") is True:
            told.append("--crop")
    if pixels.get("mask_sha256") is not None:
        told.append(f"--mask of {pixels.get('masked_pixels')} pixels ({str(pixels['mask_sha256'])[:16]})")
    return told


def _numbers(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else []
