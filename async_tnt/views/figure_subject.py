"""What figures show about a recording: events and volumes, raw and transformed, and the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from async_tnt.kernels.volume.splat import BORDER_TOLERANCE
from async_tnt.networks.models.compiled import CompiledRegressor
from async_tnt.networks.models.model import Model
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.volume import TNTVolume


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording, with the configuration and the model by which it is drawn.

    Parameters
    ----------
    name : name of the recording, for titles.
    events : structured array of `EVENT_DTYPE`, in order of arrival, at least one.
    config : configuration of the events and volumes that are drawn. Its transform is "tnt".
    model : makes the decisions, with its own configuration. None: there are no decisions. If the
        landmark of `config` is "regressor", the model's landmark network computes the landmark.
    model_name : name of the model, for titles.
    start_us : start of the first window; by default the time of the first event.

    Raises
    ------
    ValueError : there are no events; or `config` needs a landmark network, and the model has none
        or one of another shape.
    """

    name: str
    events: np.ndarray
    config: TNTConfig
    model: Model | None = None
    model_name: str = ""
    start_us: int | None = None

    def __post_init__(self) -> None:
        if self.events.size == 0:
            raise ValueError(f"{self.name}: no events to draw")
        self.regressor()  # raises the errors about the landmark network

    @property
    def first_us(self) -> int:
        """Start of the first window."""
        return int(self.events["t"][0]) if self.start_us is None else self.start_us

    def since_start_ms(self, t_us: Any) -> Any:
        """Convert times to milliseconds since the first window's start.

        The times themselves say little, because a camera's clock may start at any value.
        """
        return (t_us - self.first_us) / 1e3

    def window(self, number: int) -> Window:
        """The window of this number, counted from 1. Windows follow each other as in a stream.

        Raises
        ------
        ValueError : the window has no events.
        """
        window_us = self.config.window_us
        start_us = self.first_us + (number - 1) * window_us
        t = self.events["t"]
        # An event that arrives after an event of a later window is late. It is left out here, just
        # as the stream drops it.
        is_in_time = np.maximum.accumulate(t) < start_us + window_us
        window_events = self.events[is_in_time & (t >= start_us)]
        if window_events.size:
            return Window(self, number, start_us, window_events)
        last_number = max(0, (int(t.max()) - self.first_us) // window_us + 1)
        raise ValueError(
            f"{self.name}: no events in window {number}, from {start_us} us on; the recording ends "
            f"in window {last_number}"
        )

    def filled_windows(self, window_us: int) -> np.ndarray:
        """Numbers of the windows that hold events, as `window` counts them: int64, ascending.

        window_us : length of the windows, in microseconds.
        """
        newest_us = np.maximum.accumulate(self.events["t"])
        numbers = np.unique((newest_us - self.first_us) // window_us + 1)
        return numbers[numbers >= 1]

    def regressor(self) -> CompiledRegressor | None:
        """The model's landmark network, for the volumes that are drawn; None if not needed."""
        if not self.config.needs_regressor:
            return None
        if self.model is None or not self.model.config.needs_regressor:
            problem = (
                "there is no model" if self.model is None else f"model {self.model_name} has none"
            )
            raise ValueError(
                f'landmark="regressor" needs a model with a landmark network, but {problem}'
            )
        return CompiledRegressor(replace(self.model, config=self.config))


@dataclass(frozen=True, eq=False)
class Window:
    """The events of one window of a recording, and the volumes and coordinates to draw."""

    subject: Subject
    number: int
    """Number of the window in the recording, counted from 1."""
    start_us: int
    events: np.ndarray

    @property
    def time_ms(self) -> np.ndarray:
        """Each event's time since the window's start, in milliseconds: float64, shape (N,)."""
        return (self.events["t"] - self.start_us) / 1e3

    def volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """The raw and the transformed volume of the window: float32, shape (C, H, W) each."""
        config = self.subject.config
        raw_config = config.replace(transform="none", landmark="center", remove_flow=False)
        return self._volume(raw_config).array, self._volume(config).array

    def coordinates(self) -> Coordinates:
        """The coordinates (u, v) to which the transform moves each event.

        u = (x - l) / tau + c, and v likewise. Here x is the event's column on the grid, and l is
        the landmark that the volume had for the event. tau is the time since the window's start,
        scaled so that the window's end is at t_max. c is the middle of the grid.
        """
        config = self.subject.config
        pixels = np.stack([self.events["x"], self.events["y"]], axis=1)  # (N, 2)
        grid_points = pixels * config.to_grid(1.0, 1.0)
        centre = np.subtract(config.grid, 1) / 2
        landmark = self._landmarks()
        tau = config.t_max * (self.events["t"] - self.start_us) / config.window_us
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = ((grid_points - landmark) / tau[:, np.newaxis] + centre).T
        kept = _on_grid(u, config.grid[0] - 1) & _on_grid(v, config.grid[1] - 1)
        return Coordinates(u, v, kept, landmark)

    def _landmarks(self) -> np.ndarray:
        """The point about which each event is transformed: float64, shape (N, 2)."""
        config = self.subject.config
        # a landmark that is only known when the volume is read is the same for all events
        if config.defers_landmark:
            return np.tile(self._volume(config).landmark, (self.events.size, 1))
        landmarks = np.empty((self.events.size, 2))
        # the landmark does not depend on the volume's cells, so the smallest volume will do
        volume = TNTVolume(config.replace(representation="volume", bins=1))
        volume.open(self.start_us)
        for i, event in enumerate(self.events.tolist()):
            volume.update_one(*event)
            landmarks[i] = volume.landmark
            if config.remove_flow:
                fraction = (event[0] - self.start_us) / config.window_us
                landmarks[i] += np.multiply(volume.flow, fraction)
        return landmarks

    def _volume(self, config: TNTConfig) -> TNTVolume:
        """The volume of all the window's events, with this configuration."""
        regressor = self.subject.regressor() if config.needs_regressor else None
        volume = TNTVolume(config, regressor=regressor)
        volume.open(self.start_us)
        volume.update(self.events)
        return volume


class Coordinates(NamedTuple):
    """The coordinates to which the transform moves N events of a window, in order of arrival."""

    u: np.ndarray
    """float64, shape (N,): column in the transformed grid. It is inf or nan for an event at the
    window's very start, where tau is 0."""
    v: np.ndarray
    """float64, shape (N,): row in the transformed grid. It may be inf or nan for the same events as
    `u`."""
    kept: np.ndarray
    """bool, shape (N,): whether the event is on the grid, and therefore in the volume."""
    landmark: np.ndarray
    """float64, shape (N, 2): the point (x, y) about which each event is transformed, in grid
    pixels. With `remove_flow`, it is the place of the fitted line at the event's time."""


def _on_grid(values: np.ndarray, upper: int) -> np.ndarray:
    """Whether each value is on the grid; nan and inf are not.

    `kernels.volume.splat.on_grid` has the same rule.
    """
    return (values >= -BORDER_TOLERANCE) & (values <= upper + BORDER_TOLERANCE)


def evenly_spread(n: int, most: int) -> np.ndarray:
    """At most `most` of the indices from 0 to n - 1, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)
