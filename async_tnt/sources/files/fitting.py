"""Recordings for a model: opened with its sensor, and refused if they are of another one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.events import as_events
from async_tnt.sources.files.nmnist import SENSOR as NMNIST_SENSOR
from async_tnt.sources.files.recording import Recording, open_recording
from async_tnt.sources.files.source import Sensor, events_on_sensor

TRAIN_ONE = "train one for this camera (async-tnt train --help)"
ANY_BIN = (256, 256)  # every pixel that a `.bin` can hold


def open_for(path: Path, sensor: Sensor | None, **settings: Any) -> Recording:
    """`open_recording` for a model of this sensor, (width, height).

    A `.bin` does not state its sensor. It is assumed to be of this one if any of its events lies off N-MNIST's.
    """
    if path.suffix.lower() == ".bin" and sensor is not None and (np.array(sensor) > NMNIST_SENSOR).any():
        recording = open_recording(path, **settings, sensor=sensor)
        if events_on_sensor(recording.read(), NMNIST_SENSOR)[1]:
            return recording
    return open_recording(path, **settings)


def open_of_known(path: Path, **settings: Any) -> Recording:
    """`open_recording` where the user states the sensor: a `.bin`, too, has none of its own then.

    So an event off the stated sensor is not damage of the file; `check_events` finds it.
    """
    if path.suffix.lower() != ".bin":
        return open_recording(path, **settings)
    recording = open_recording(path, **settings, sensor=ANY_BIN)
    recording.sensor = None
    return recording


def check_sensor(
    name: Any, found: Sensor | None, wanted: Sensor, who: str = "the model is for", advice: str = "; " + TRAIN_ONE
) -> None:
    """Refuse a source whose sensor, if it states one, is not the wanted (width, height)."""
    if found is not None and tuple(found) != wanted:
        raise ValueError(f"{name}: a sensor of {found[0]}x{found[1]} pixels, but {who} {wanted[0]}x{wanted[1]}{advice}")


def check_events(
    packets: Iterable[Any],
    sensor: Sensor,
    name: Any,
    who: str = "the model is for",
    advice: str = "; " + TRAIN_ONE,
) -> None:
    """Refuse packets of a source that does not state its sensor, if any event is off this one.

    Raises
    ------
    ValueError : with the source's name, and who states the sensor.
    """
    try:
        for packet in packets:  # one by one: a file may be larger than the memory
            as_events(packet, sensor)
    except (TypeError, ValueError) as error:
        message = str(error) if str(error).startswith(str(name)) else f"{name}: {error}"
        if isinstance(error, ValueError) and message != str(error):
            message += f"; {who} {sensor[0]}x{sensor[1]} pixels{advice}"
        raise ValueError(message) from None
