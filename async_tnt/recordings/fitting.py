"""Recordings that are to fit a model: of its sensor, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from async_tnt.recordings.nmnist import SENSOR as NMNIST_SENSOR
from async_tnt.recordings.recording import Recording, open_recording
from async_tnt.recordings.source import Sensor

TRAIN_ONE = "train one for this camera (async-tnt train --help)"


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


def check_sensor(
    name: Any, found: Sensor | None, wanted: Sensor, who: str = "the model is for", advice: str = "; " + TRAIN_ONE
) -> None:
    """Refuse a source whose sensor has another size (width, height) than wanted."""
    if found is not None and tuple(found) != wanted:
        raise ValueError(f"{name}: a sensor of {found[0]}x{found[1]} pixels, but {who} {wanted[0]}x{wanted[1]}{advice}")
