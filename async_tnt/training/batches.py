"""Volumes of many windows at once, through the kernels that also serve a stream.

Without augmentation a window's volume is bit for bit what `TNTVolume.array` holds after the same events.
"""

from __future__ import annotations

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.volume import TNTVolume

from .augment import Draws, unchanged
from .gather import window_volumes
from .windows import Windows


class BatchVolumes:
    """Makes the volumes of windows, into memory that it reuses.

    Parameters
    ----------
    config : TNTConfig.
    """

    def __init__(self, config: TNTConfig) -> None:
        self.config = config
        self._volumes: dict[tuple[int, int], TNTVolume] = {}
        self._scratch = _empty_columns(1 << 12)
        self._out = np.empty((0, *config.shape), np.float32)

    def __call__(self, windows: Windows, draws: Draws | None = None) -> np.ndarray:
        """The volumes of N windows.

        Parameters
        ----------
        windows : the windows.
        draws : what augmentation drew for them; None: as they are.

        Returns
        -------
        float32, shape (N, C, H, W). Overwritten by the next call.
        """
        n = len(windows)
        draws = unchanged(n, self.config) if draws is None else draws
        volume = self._volume(draws.sensor)
        recordings = windows.recordings
        first, last = recordings.offsets[windows.recording], recordings.offsets[windows.recording + 1]
        longest = int((last - first).max(initial=0))
        if longest > self._scratch[0].size:
            self._scratch = _empty_columns(2 * longest)
        scratch = self._scratch
        if n > len(self._out):
            self._out = np.empty((n, *self.config.shape), np.float32)
        out = self._out[:n]
        start_us = windows.start_us + draws.start_us
        limit_us = start_us + np.minimum(draws.until_us, self.config.window_us)
        about_mean = self.config.transform == "tnt" and self.config.landmark == "window"
        window_volumes(
            volume._buffer, scratch[0], scratch[1], scratch[2], scratch[3],
            recordings.t, recordings.x, recordings.y, recordings.p, first, last, start_us, limit_us,
            draws.matrix, draws.keep, draws.seed, about_mean, self.config.bins, out,
        )  # fmt: skip
        return out

    def _volume(self, sensor: tuple[int, int]) -> TNTVolume:
        """The state that the kernels work in, with the parameters for events of this sensor."""
        if sensor not in self._volumes:
            self._volumes[sensor] = TNTVolume(self.config.replace(sensor=sensor))
        return self._volumes[sensor]


def _empty_columns(n: int) -> tuple[np.ndarray, ...]:
    """t, x, y, p in the types that the kernels take."""
    return np.empty(n, np.int64), np.empty(n, np.uint16), np.empty(n, np.uint16), np.empty(n, np.uint8)
