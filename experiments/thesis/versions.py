"""Windows with their versions, see `motions/versions.py`.

Turning by any angle is an augmentation of training, and leaving out polarity is a setting of the
volume, so neither is a version here.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from async_tnt.training.recordings import COLUMNS, Recordings
from async_tnt.training.windows import Windows
from experiments.motions.versions import FLIPPED, backwards, flipped


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
    directions_of_time = [False, True] if "reversed" in names else [False]
    # each begins with an empty part, because there may be no windows
    columns = {name: [np.empty(0, dtype)] for name, dtype in COLUMNS.items()}
    recorded = [windows.events(i, window_us) for i in range(len(windows))]
    for flip, is_reversed in itertools.product(flips, directions_of_time):
        for window in recorded:
            version = flipped(window, flip, sensor)
            if is_reversed:
                version = backwards(version, window_us)
            for name, values in zip(COLUMNS, version, strict=True):
                columns[name].append(values.astype(COLUMNS[name]))
    n_versions = len(flips) * len(directions_of_time)
    recordings = Recordings(
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        offsets=np.cumsum([len(part) for part in columns["t"]]),
        labels=np.tile(windows.labels, n_versions),
        names=tuple(windows.recordings.names[r] for r in windows.recording) * n_versions,
    )
    n = n_versions * len(windows)
    return Windows(recordings, np.arange(n), np.zeros(n, np.int64))
