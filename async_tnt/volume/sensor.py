"""A camera's sensor, (width, height) in pixels: checked, compared with the one that is expected,
and in messages."""

from __future__ import annotations

from typing import Any

from async_tnt.base.checks import is_whole, short
from async_tnt.volume.config import MAX_SIDE

Sensor = tuple[int, int]


def format_size(size: Sensor) -> str:
    """(346, 260) as `346x260`."""
    return f"{size[0]}x{size[1]}"


def checked_sensor(sensor: Any) -> Sensor:
    """(width, height) as two Python integers.

    Raises
    ------
    ValueError : not two whole numbers in [1, 2**15].
    """
    try:
        width, height = sensor
    except (TypeError, ValueError):
        width = height = None
    if not (is_whole(width) and is_whole(height)):
        raise ValueError(f"`sensor` must be (width, height) in whole pixels, got {short(sensor)}")
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ValueError(f"`sensor` must have sides in [1, {MAX_SIDE}] pixels, got {short(sensor)}")
    return int(width), int(height)


def check_sensor(
    name: Any,
    found: Sensor | None,
    wanted: Sensor | None,
    origin: str = "the model is for",
    advice: str = "",
) -> None:
    """Refuse a source that states another sensor than the wanted one.

    Parameters
    ----------
    name : of the source, for messages.
    found, wanted : (width, height); None: it states none, and any is wanted.
    origin : where `wanted` comes from, and `advice`: what to do about another one, for messages.
    """
    if found is not None and wanted is not None and tuple(found) != wanted:
        raise ValueError(
            f"{name}: a sensor of {format_size(found)} pixels, but {origin} "
            f"{format_size(wanted)}{advice}"
        )
