"""Versions of recorded windows that show other directions of motion, without any simulation.

A network that has seen one direction can be shown others by cheap means. They are the controls of
motion re-synthesis:

    reversed             time runs backwards and polarities are swapped: a brightness that rose
                         falls. The object moves back on its path
    flipped x, y         the sensor is mirrored, from left to right or from top to bottom. The
                         motion is mirrored, and so is the object
    flipped x and y      both, which turns by 180 degrees

Turning by any angle is an augmentation, and leaving out polarity is a setting of the volume, so
both need no version.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows

FLIPPED = ("flipped x", "flipped y", "flipped x and y")
"""Versions that are mirrored."""

VERSIONS = (*FLIPPED, "reversed")
"""Names of all versions."""


def with_versions(
    windows: Windows, names: Sequence[str], sensor: tuple[int, int], window_us: int
) -> Windows:
    """The windows, and each of their versions, in recordings of their own.

    With "reversed", all other versions are also there reversed. The windows of one version stand
    together; those as they were recorded come first.

    Parameters
    ----------
    names : names of `VERSIONS`.
    sensor : width and height, in pixels.
    window_us : length of the windows.
    """
    flips = ["", *(name for name in names if name in FLIPPED)]
    backwards = [False, True] if "reversed" in names else [False]
    # each begins with an empty part, because there may be no windows
    columns = {name: [np.empty(0, dtype)] for name, dtype in COLUMNS.items()}
    lengths = []
    recorded = [windows.events(i, window_us) for i in range(len(windows))]
    for flip, is_reversed in itertools.product(flips, backwards):
        for t, x, y, p in recorded:
            if "x" in flip.split():
                x = sensor[0] - 1 - x
            if "y" in flip.split():
                y = sensor[1] - 1 - y
            if is_reversed:
                t, x, y, p = window_us - 1 - t[::-1], x[::-1], y[::-1], 1 - p[::-1]
            for name, values in zip(COLUMNS, (t, x, y, p), strict=True):
                columns[name].append(values.astype(COLUMNS[name]))
            lengths.append(len(t))
    n_versions = len(flips) * len(backwards)
    recordings = Recordings(
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        offsets=np.cumsum([0, *lengths]),
        labels=np.tile(windows.labels, n_versions),
        names=tuple(windows.recordings.names[r] for r in windows.recording) * n_versions,
    )
    return Windows(recordings, np.arange(len(lengths)), np.zeros(len(lengths), np.int64))
