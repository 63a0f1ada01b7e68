"""Which camera the recordings of one's own classes are of, where some are of another."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence

from async_tnt.sources.files.source import Sensor
from async_tnt.sources.sizes import by
from async_tnt.training.dataset_recording import OwnRecording

FEW = 10  # of so many recordings, one may be of another sensor: a stray


def camera_of(folder: str | os.PathLike[str], recordings: Sequence[OwnRecording]) -> Sensor | None:
    """The sensor of all recordings that state one, but for strays: at most one in ten. None where none states one.

    Nobody wants half of a set to be left out without a word, and which half only its owner knows.

    Raises
    ------
    ValueError : more strays; names one recording of each sensor.
    """
    stating = [one for one in recordings if one.recorded and one.sensor is not None]
    counts = Counter(one.sensor for one in stating).most_common()
    if not counts:
        return None
    camera, n = counts[0]
    if FEW * (len(stating) - n) > len(stating):
        raise ValueError(
            f"{folder}: all recordings must be of one sensor, got {_said(stating)}; take those of one camera out, or "
            "give --sensor WxH to leave out all others"
        )
    return camera


def check_named(folder: str | os.PathLike[str], recordings: Sequence[OwnRecording], camera: Sensor, who: str) -> None:
    """Refuse a camera (width, height) that is named, but that no recording states, where many state another.

    The others are left out; but a mistyped size would leave only those that state none, taken for what they are not.

    Raises
    ------
    ValueError : more than one in ten recordings state another sensor, and none this one.
    """
    others = [one for one in recordings if one.recorded and one.sensor not in (None, camera)]
    is_stated = any(one.sensor == camera for one in recordings)
    if not is_stated and FEW * len(others) > sum(1 for one in recordings if one.recorded):
        said = _said(others)
        raise ValueError(f"{folder}: {who} {by(camera)}, but the recordings that state their sensor say {said}")


def _said(recordings: Sequence[OwnRecording]) -> str:
    """Each sensor, most frequent first, with a recording that states it and the number of all that do."""
    told = []
    for size, n in Counter(one.sensor for one in recordings if one.sensor is not None).most_common():
        first = next(one.name for one in recordings if one.sensor == size)
        told.append(f"{by(size)} ({first}{f' and {n - 1} more' if n > 1 else ''})")
    return ", ".join(told)
