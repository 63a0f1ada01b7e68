"""Volumes of many windows at once, computed by the kernels that also process streams.

Without augmentation a window's volume is bit for bit the `TNTVolume.array` after the same events.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.kernels.training.window_batches import (
    GIVEN,
    MEAN,
    OWN,
    landmark_gradients,
    window_volumes,
)
from async_tnt.training.augment import Draws, during_slice, unchanged
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig, with_an_end
from async_tnt.volume.events import empty_columns
from async_tnt.volume.state import new_state


class BatchVolumes:
    """Computes the volumes of windows. Each call overwrites the volumes of the call before.

    Parameters
    ----------
    config : how events become volumes.

    Raises
    ------
    ValueError : the configuration has `window_events`.
    """

    def __init__(self, config: TNTConfig) -> None:
        if config.window_events is not None:
            raise ValueError(
                f"windows of a duration can be trained on, but not of {config.window_events} events"
            )
        self.config = config
        # All events of a window that slides are given at once, so it is like any other window.
        # Slices are windows of counts.
        self._of_windows = with_an_end(config)
        if config.slice_us is not None:
            self._of_windows = config.replace(
                representation="count",
                last_us=None,
                window_us=config.slice_us,
                polarity=config.polarity,
                landmark="center",
            )
        self._landmark_kind = OWN
        if config.defers_landmark:
            self._landmark_kind = {"window": MEAN, "regressor": GIVEN}[config.landmark]
        self._states: dict[tuple[int, int], np.ndarray] = {}
        self._scratch = empty_columns(1 << 12)[:4]  # t, x, y, p
        self._out = np.empty((0, *config.shape), np.float32)

    def __call__(
        self, windows: Windows, draws: Draws | None = None, landmarks: np.ndarray | None = None
    ) -> np.ndarray:
        """The volumes of N windows.

        Parameters
        ----------
        windows : the windows.
        draws : the windows' augmentation; None: the windows stay as they are.
        landmarks : float64, shape (N, 2), (x, y) in grid pixels. Only given with landmark
            `regressor`.

        Returns
        -------
        float32, shape (N, C, H, W). Overwritten by the next call.
        """
        n = len(windows)
        draws = unchanged(n, self.config) if draws is None else draws
        if (landmarks is not None) != (self._landmark_kind == GIVEN):
            raise ParameterValueError(
                "landmarks", "must be given with landmark 'regressor', and with no other"
            )
        if n > len(self._out):
            self._out = np.empty((n, *self.config.shape), np.float32)
        out = self._out[:n]
        if self.config.slice_us is not None:
            self._fill_slices(windows, draws, out)
            return out
        on_sensor = self._to_sensor(landmarks, n, draws)
        window_volumes(*self._arguments(windows, draws), self._landmark_kind, on_sensor, out)
        return out

    def _fill_slices(self, windows: Windows, draws: Draws, out: np.ndarray) -> None:
        """Fill the volumes of windows in slices, one slice after the other."""
        slice_us = self.config.slice_us
        assert slice_us is not None
        on_sensor = np.zeros((len(windows), 2))
        counts = np.empty((len(windows), *self._of_windows.shape), np.float32)
        n = self.config.bins
        by_polarity = out.reshape(len(windows), counts.shape[1], n, *out.shape[2:])
        for b in range(n):
            of_slice = replace(
                during_slice(draws, b, n),
                start_us=draws.start_us + b * slice_us,
                until_us=np.clip(draws.until_us - b * slice_us, 0, slice_us),
            )
            arguments = self._arguments(windows, of_slice)
            window_volumes(*arguments, self._landmark_kind, on_sensor, counts)
            by_polarity[:, :, b] = counts

    def landmark_gradient(
        self, windows: Windows, draws: Draws | None, landmarks: np.ndarray, gradient: np.ndarray
    ) -> np.ndarray:
        """The gradient dL/dl of a loss L by the landmarks, from the gradient dL/dV by the volumes.

        V are the volumes that `__call__` computes from `windows`, `draws` and the landmarks l.

        Parameters
        ----------
        windows, draws : see `__call__`.
        landmarks : float64, shape (N, 2), (x, y) in grid pixels.
        gradient : float32, shape (N, C, H, W): dL/dV.

        Returns
        -------
        float64, shape (N, 2), per grid pixel.
        """
        n = len(windows)
        draws = unchanged(n, self.config) if draws is None else draws
        out = np.empty((n, 2))
        gradient = np.ascontiguousarray(gradient, np.float32)
        on_sensor = self._to_sensor(landmarks, n, draws)
        landmark_gradients(*self._arguments(windows, draws), on_sensor, gradient, out)
        return out

    def _arguments(self, windows: Windows, draws: Draws) -> tuple[Any, ...]:
        """The first arguments of both `window_volumes` and `landmark_gradients`."""
        recordings = windows.recordings
        first, end = windows.bounds
        longest = int((end - first).max(initial=0))
        if longest > self._scratch[0].size:
            self._scratch = empty_columns(2 * longest)[:4]
        start_us = windows.start_us + draws.start_us
        limit_us = start_us + np.minimum(draws.until_us, self.config.window_us)
        return (
            self._state(draws.sensor),
            self._scratch,
            (recordings.t, recordings.x, recordings.y, recordings.p),
            (
                first,
                end,
                start_us,
                limit_us,
                draws.matrix,
                draws.keep,
                draws.seed,
                draws.content,
                draws.place,
            ),
        )

    def _to_sensor(self, landmarks: np.ndarray | None, n: int, draws: Draws) -> np.ndarray:
        """Landmarks in pixels of the events' sensor; zeros if `landmarks` is None."""
        if landmarks is None:
            return np.zeros((n, 2))
        # sensor and grid have the same corners: their first and last pixels coincide
        last_pixel = np.array(draws.sensor) - 1
        last_cell = np.array(self.config.grid) - 1
        return np.ascontiguousarray(landmarks * last_pixel / last_cell)

    def _state(self, sensor: tuple[int, int]) -> np.ndarray:
        """The state that the kernels work on, for events of this sensor."""
        if sensor not in self._states:
            # With MEAN and GIVEN, the kernels write each window's landmark over a fixed one.
            landmark = self.config.landmark if self._landmark_kind == OWN else "center"
            config = self._of_windows.replace(sensor=sensor, landmark=landmark)
            self._states[sensor] = new_state(config)
        return self._states[sensor]
