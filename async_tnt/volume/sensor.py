"""The size of a camera's sensor, (width, height) in pixels: checks, and text for messages."""

from __future__ import annotations

from typing import Any

from async_tnt.base.checks import ParameterValueError, is_whole
from async_tnt.base.messages import short
from async_tnt.volume.config import MAX_SIDE

Sensor = tuple[int, int]


def format_size(size: Sensor) -> str:
    """The text of a size, such as `346x260` for (346, 260)."""
    return f"{size[0]}x{size[1]}"


def checked_sensor(sensor: Any) -> Sensor:
    """The parameter `sensor`, (width, height), as two Python integers.

    Raises
    ------
    ParameterValueError : not two whole numbers in [1, 2**15].
    """
    not_a_pair = ParameterValueError(
        "sensor", "must be (width, height) in whole pixels", short(sensor)
    )
    try:
        width, height = sensor
    except (TypeError, ValueError):
        raise not_a_pair from None
    if not (is_whole(width) and is_whole(height)):
        raise not_a_pair
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        rule = f"must have sides in [1, {MAX_SIDE}] pixels"
        raise ParameterValueError("sensor", rule, short(sensor))
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
    name : name of the source, for the message.
    found : (width, height) of the source; None: it states no sensor.
    wanted : (width, height) that it should have; None: any.
    origin : where `wanted` comes from, for the message.
    advice : what to do about another sensor, for the message.

    Raises
    ------
    ValueError : both are known, and differ.
    """
    if found is None or wanted is None or tuple(found) == wanted:
        return
    raise ValueError(
        f"{name}: a sensor of {format_size(found)} pixels, but {origin} "
        f"{format_size(wanted)}{advice}"
    )
