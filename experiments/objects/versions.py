"""A folder of recordings with versions of them, see `motions/versions.py`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.motions.versions import FLIPPED, Columns, backwards, flipped, turned

N_DRAWN = 7
"""Number of versions of a recording, if they are drawn at random."""

GROUPS = r"\d+(?=_)"
"""Pattern for `async-tnt train --groups`, which keeps the versions of a recording together."""


def write_versions(
    source: Path,
    folder: Path,
    names: Sequence[str],
    sensor: tuple[int, int],
    window_us: int,
    seed: int,
) -> int:
    """Write the recordings of a folder with versions, as `folder/<class>/<number>_<version>.npz`.

    Without "turned", each recording is there in all versions. With it, there are `N_DRAWN` versions
    of each, which are drawn: each is turned by any angle, and half of them are reversed, and
    flipped in x, in y, in both or not, if `names` has these.

    Returns the number of versions of a recording, itself included.
    """
    n_versions = 0
    for path in sorted(source.glob("*/*.npz")):
        with np.load(path) as recording:
            t, x, y, p = (recording[name] for name in "txyp")
        columns = (t, x, y, p.astype(np.uint8))
        number = f"{path.parent.name}-{path.stem}".encode()
        rng = np.random.default_rng((seed, *number))
        versions = _versions_of(columns, names, sensor, window_us, rng)
        n_versions = len(versions)
        (folder / path.parent.name).mkdir(parents=True, exist_ok=True)
        for k, version in enumerate(versions):
            to = folder / path.parent.name / f"{path.stem}_{k}.npz"
            named: dict[str, Any] = dict(zip("txyp", version, strict=True))
            np.savez(to, **named)
    return n_versions


def _versions_of(
    columns: Columns,
    names: Sequence[str],
    sensor: tuple[int, int],
    window_us: int,
    rng: np.random.Generator,
) -> list[Columns]:
    """The recording as it is, and its versions."""
    flips = ["", *(name for name in names if name in FLIPPED)]
    directions_of_time = [False, True] if "reversed" in names else [False]
    if "turned" not in names:
        versions = []
        for flip in flips:
            for is_reversed in directions_of_time:
                version = flipped(columns, flip, sensor)
                versions.append(backwards(version, window_us) if is_reversed else version)
        return versions
    versions = [columns]
    for _ in range(N_DRAWN):
        version = flipped(columns, flips[rng.integers(len(flips))], sensor)
        if directions_of_time[rng.integers(len(directions_of_time))]:
            version = backwards(version, window_us)
        versions.append(turned(version, rng.uniform(0, 2 * np.pi), sensor))
    return versions
