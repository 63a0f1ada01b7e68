"""Volumes of many windows at once, through the kernels that also serve a stream.

Without augmentation a window's volume is bit for bit what `TNTVolume.array` holds after the same events.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from async_tnt.config import TNTConfig
from async_tnt.kernels import state as S
from async_tnt.kernels.read import copy_cells, empty_volume
from async_tnt.kernels.update import absorb
from async_tnt.volume import TNTVolume

from .augment import Draws, unchanged
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
        _window_volumes(
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


@njit(error_model="numpy")  # not cached: Numba would serve it stale after a change in the kernels it calls
def _window_volumes(
    buffer, scratch_t, scratch_x, scratch_y, scratch_p,
    t, x, y, p, first, last, start_us, limit_us, matrix, keep, seed, about_mean, n_bins, out,
):  # fmt: skip
    """The volume of each window into `out`.

    Parameters
    ----------
    buffer : float64, the volume's `kernels.state`. Updated in place, as are the scratch columns.
    scratch_t, scratch_x, scratch_y, scratch_p : as long as the longest recording.
    t, x, y, p : the recordings' columns, see `windows.Recordings`.
    first, last : int64, (N,). Each window's recording: its events `first <= i < last`.
    start_us, limit_us : int64, (N,). Each window.
    matrix, keep, seed : see `augment.Draws`.
    about_mean : the landmark is the centroid of the window's events.
    n_bins : B.
    out : float32, (N, C, H, W). Updated in place.
    """
    floats = buffer[: S.N_FLOATS]
    ints = buffer[S.N_FLOATS : S.CELLS].view(np.int64)
    for i in range(out.shape[0]):
        n = _take_events(
            scratch_t, scratch_x, scratch_y, scratch_p, t, x, y, p,
            first[i], last[i], start_us[i], limit_us[i], matrix[i], keep[i], seed[i], ints[S.SENSOR_W], ints[S.SENSOR_H],
        )  # fmt: skip
        empty_volume(buffer, start_us[i], limit_us[i], n_bins, out.shape[2])
        if about_mean and n > 0:
            sum_x = 0
            sum_y = 0
            for k in range(n):
                sum_x += np.int64(scratch_x[k])
                sum_y += np.int64(scratch_y[k])
            floats[S.FIXED_X] = sum_x / n
            floats[S.FIXED_Y] = sum_y / n
        absorb(buffer, scratch_t, scratch_x, scratch_y, scratch_p, 0, n)
        copy_cells(buffer, out[i], n_bins)


@njit(cache=True, error_model="numpy")
def _take_events(
    scratch_t, scratch_x, scratch_y, scratch_p, t, x, y, p, first, last, start_us, limit_us,
    matrix, keep, seed, width, height,
):  # fmt: skip
    """One window's events, moved and thinned, into the scratch columns; returns how many."""
    i = first + np.searchsorted(t[first:last], start_us)
    n = 0
    while i < last and t[i] < limit_us:
        if keep >= 1.0 or _uniform(seed, i) < keep:
            x_moved = np.floor(matrix[0, 0] * x[i] + matrix[0, 1] * y[i] + matrix[0, 2] + 0.5)
            y_moved = np.floor(matrix[1, 0] * x[i] + matrix[1, 1] * y[i] + matrix[1, 2] + 0.5)
            if 0 <= x_moved < width and 0 <= y_moved < height:
                scratch_t[n] = t[i]
                scratch_x[n] = np.uint16(x_moved)
                scratch_y[n] = np.uint16(y_moved)
                scratch_p[n] = p[i]
                n += 1
        i += 1
    return n


@njit(cache=True, error_model="numpy")
def _uniform(seed, i):
    """A number in [0, 1) that belongs to (seed, i): the i-th of the generator SplitMix64.

    Steele, Lea, Flood 2014, Fast Splittable Pseudorandom Number Generators, with their constants. Any order of the events, and any number of them, gives each the same number.
    """
    z = seed + np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53
