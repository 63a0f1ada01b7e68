"""Writes recordings in N-MNIST's five-byte format, which `async_tnt.sources.read_nmnist` reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_nmnist(path: Path, events: np.ndarray) -> None:
    """Write events, without timer overflows.

    Parameters
    ----------
    events : structured array, in order of time: t in [0, 2**23) us, x and y below 256, y not 240.
        Not checked here.
    """
    t_us = events["t"]
    rows = np.empty((len(events), 5), np.uint8)
    rows[:, 0] = events["x"]
    rows[:, 1] = events["y"]
    rows[:, 2] = t_us >> 16 | events["p"].astype(np.int64) << 7
    rows[:, 3] = t_us >> 8 & 0xFF
    rows[:, 4] = t_us & 0xFF
    path.write_bytes(rows.tobytes())
