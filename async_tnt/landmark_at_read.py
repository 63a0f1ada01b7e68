"""Landmarks that are known only at the moment of reading: the window's mean, a network's answer.

A `window_replay.Replay` asks one of them where to replay a window's events about.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import Columns
from async_tnt.kernels import state as S

if TYPE_CHECKING:
    from async_tnt.volume import TNTVolume

Regressor = Callable[[np.ndarray], Any]


class LandmarkAtRead(Protocol):
    """Finds the landmark of a window whose events have been stored."""

    def open(self, start_us: int) -> None:
        """A window begins, empty."""

    def see(self, columns: Columns, first: int, last: int) -> None:
        """The events `first <= i < last` were stored: those that the replay will read, and no others."""

    def find(self, buffer: np.ndarray) -> tuple[float, float]:
        """The landmark (x, y), in grid pixels, of the window as it stands; it holds at least one event.

        Parameters
        ----------
        buffer : the volume's, see `kernels.state`.
        """


class WindowMean:
    """Landmark `window`: the centroid of all events so far, of those that could not be stored, too."""

    def __init__(self, config: TNTConfig) -> None:
        self._config = config

    def open(self, start_us: int) -> None:
        pass

    def see(self, columns: Columns, first: int, last: int) -> None:
        pass

    def find(self, buffer: np.ndarray) -> tuple[float, float]:
        ints = buffer.view(np.int64)
        n = int(ints[S.N])
        return self._config.to_grid(int(ints[S.SUM_X]) / n, int(ints[S.SUM_Y]) / n)


class RegressedLandmark:
    """Landmark `regressor`: what a network makes of the raw volume.

    The raw volume is kept up to date in O(1) per event. It holds the events that are stored, and only those: so
    the network sees what the replay splats, whatever became of the rest, and both are functions of the same
    events, as in the batch reference.

    Parameters
    ----------
    raw : TNTVolume without the transform.
    regressor : see `TNTVolume`.
    """

    def __init__(self, raw: TNTVolume, regressor: Regressor) -> None:
        self._raw = raw
        self._regressor = regressor

    def open(self, start_us: int) -> None:
        self._raw.open(start_us)

    def see(self, columns: Columns, first: int, last: int) -> None:
        self._raw.take(columns, first, last)

    def find(self, buffer: np.ndarray) -> tuple[float, float]:
        return checked_landmark(self._regressor(self._raw.array))


def checked_landmark(answer: Any) -> tuple[float, float]:
    """A regressor's answer as two floats.

    Raises
    ------
    ValueError : it is something else, or not finite.
    """
    try:
        x, y = (float(value) for value in answer)
    except (TypeError, ValueError, OverflowError):
        got = " ".join(reprlib.repr(answer).split())  # short, and on one line
        raise ValueError(f"`regressor` must return two numbers (x, y) in grid pixels, got {got}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"`regressor` must return a finite landmark, got {(x, y)}")
    return x, y


def check_regressor(config: TNTConfig, regressor: Any) -> None:
    """Raise unless there is a regressor exactly where the configuration needs one."""
    here = f"landmark={config.landmark!r}, transform={config.transform!r}"
    if regressor is None:
        if config.needs_regressor:
            raise ValueError(
                f"`regressor` is missing: {here} needs a callable from a raw volume to (x, y); "
                "a Model brings its own, CompiledRegressor(model)"
            )
    elif not callable(regressor):
        raise TypeError(f"`regressor` must be callable, got {type(regressor).__name__}")
    elif not config.needs_regressor:
        raise ValueError(f'`regressor` needs landmark="regressor" and transform="tnt", got {here}')
