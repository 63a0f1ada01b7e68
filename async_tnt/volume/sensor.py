"""The size of a camera's sensor, (width, height) in pixels: checks, and text for messages."""

from __future__ import annotations

from typing import Any

from async_tnt.base.checks import ParameterValueError, is_whole
from async_tnt.base.messages import short
from async_tnt.volume.config import MAX_SIDE

Sensor = tuple[int, int]


def format_size(size: Sensor) -> str:
    """A size as text, such as `346x260` for (346, 260)."""
    return f"{size[0]}x{size[1]}"


def checked_sensor(sensor: Any) -> Sensor:
    """The parameter `sensor`, (width, height), as two Python integers.

    Raises
    ------
    ParameterValueError : `sensor` is not two whole numbers in [1, 2**15].
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
    """Refuse a source whose sensor has another size than the wanted one.

    Parameters
    ----------
    name : name of the source, for the message.
    found : (width, height) of the source's sensor; None if the source does not state it.
    wanted : (width, height) that the sensor should have; None if any size will do.
    origin : where `wanted` comes from, for the message.
    advice : what to do about another sensor, for the message.

    Raises
    ------
    ValueError : `found` and `wanted` are both known, and differ.
    """
    if found is None or wanted is None or tuple(found) == wanted:
        return
    raise ValueError(
        f"{name}: a sensor of {format_size(found)} pixels, but {origin} "
        f"{format_size(wanted)}{advice}"
    )
