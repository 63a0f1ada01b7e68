"""Recordings that are to fit a model: of its sensor, or refused."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from async_tnt.events import as_events
from async_tnt.sources.files.nmnist import SENSOR as NMNIST_SENSOR
from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.files.source import Sensor

TRAIN_ONE = "train one for this camera (async-tnt train --help)"
ANY_BIN = (256, 256)  # every pixel that the format can hold


def open_for(path: Path, sensor: Sensor | None, **settings: Any) -> Recording:
    """`open_recording` for a model of this sensor, (width, height).

    A `.bin` does not say its sensor. It is taken for one of this sensor if any of its events lies off N-MNIST's.
    """
    is_larger = sensor is not None and max(sensor[0] - NMNIST_SENSOR[0], sensor[1] - NMNIST_SENSOR[1]) > 0
    if path.suffix.lower() == ".bin" and is_larger:
        recording = open_recording(path, **settings, sensor=sensor)
        events = recording.read()  # all in memory, as this format is always read
        if events.size and (events["x"].max() >= NMNIST_SENSOR[0] or events["y"].max() >= NMNIST_SENSOR[1]):
            return recording
    return open_recording(path, **settings)


def open_of_known(path: Path, **settings: Any) -> Recording:
    """`open_recording` where somebody names the camera: a `.bin` then says nothing, as any other silent format.

    So it is not of N-MNIST's sensor, wherever its events lie. One off the camera is no damage of the file, but an
    event off what somebody said, which `check_events` can name.
    """
    if path.suffix.lower() != ".bin":
        return open_recording(path, **settings)
    recording = open_recording(path, **settings, sensor=ANY_BIN)
    recording.sensor = None
    return recording


def check_sensor(
    name: Any, found: Sensor | None, wanted: Sensor, who: str = "the model is for", advice: str = "; " + TRAIN_ONE
) -> None:
    """Refuse a source whose sensor has another size (width, height) than wanted."""
    if found is not None and tuple(found) != wanted:
        raise ValueError(f"{name}: a sensor of {found[0]}x{found[1]} pixels, but {who} {wanted[0]}x{wanted[1]}{advice}")


def check_events(
    packets: Iterable[Any],
    sensor: Sensor,
    name: Any,
    who: str = "the model is for",
    advice: str = "; " + TRAIN_ONE,
) -> None:
    """Refuse packets of a source that does not say its sensor, if any event is off this one.

    Raises
    ------
    ValueError, TypeError : with the source's name, and who says the sensor.
    """
    try:
        for packet in packets:  # one after the other: a file may be larger than the memory
            as_events(packet, sensor)
    except (TypeError, ValueError) as error:
        message = str(error)
        if isinstance(error, ValueError) and not message.startswith(str(name)):
            message += f"; {who} {sensor[0]}x{sensor[1]} pixels{advice}"
        raise ValueError(message if message.startswith(str(name)) else f"{name}: {message}") from None
