"""What figures draw: the events of a recording, their volumes, and the model that decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.networks.compiled import CompiledRegressor
from async_tnt.networks.model import Model
from async_tnt.views.coordinates import Coordinates, transformed
from async_tnt.volume import TNTVolume


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording, and how it is drawn.

    Parameters
    ----------
    name : of the recording, for titles.
    events : structured array of `EVENT_DTYPE`, in order of arrival, at least one.
    config : how events and volumes are drawn; transform "tnt".
    model : makes the decisions, with its own configuration; None: no decisions. With landmark "regressor" its
        network computes the landmark.
    model_name : for titles.
    start_us : start of the first window; by default the first event.

    Raises
    ------
    ValueError : no events; or a landmark network is needed and the model has none, or one of another shape.
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
        self.regressor()

    @property
    def first_us(self) -> int:
        """Start of the first window."""
        return int(self.events["t"][0]) if self.start_us is None else self.start_us

    @property
    def time_unit(self) -> tuple[float, str]:
        """Microseconds in the unit of the recording's time axis, and its name."""
        t = self.events["t"]
        return (1e6, "s") if int(t.max()) - int(t.min()) > 20_000_000 else (1e3, "ms")

    def since_start(self, t_us: Any) -> Any:
        """Times since the first window's start, in `time_unit`: cameras' clocks may start at any value."""
        return (t_us - self.first_us) / self.time_unit[0]

    @property
    def raw_config(self) -> TNTConfig:
        """The same volume without the transform."""
        return self.config.replace(transform="none", landmark="center", remove_flow=False)

    def window(self, number: int) -> Window:
        """The `number`-th window, counted from 1; windows follow each other as in a stream.

        Raises
        ------
        ValueError : it has no events, or lies after the last window of the recording.
        """
        window_us = self.config.window_us
        start_us = self.first_us + (number - 1) * window_us
        t = self.events["t"]
        # an event that arrives after one of a later window is late; the stream drops it, too
        still_open = np.maximum.accumulate(t) < start_us + window_us
        inside = self.events[still_open & (t >= start_us)]
        if inside.size:
            return Window(self, number, start_us, inside)
        last = (int(t.max()) - self.first_us) // window_us + 1
        if last < 1:
            raise ValueError(f"{self.name}: no event at or after the first window's start, {self.first_us} us")
        if number > last:
            windows = "1 window" if last == 1 else f"{last} windows"
            raise ValueError(f"{self.name}: no window {number}; the recording has {windows} of {window_us} us")
        raise ValueError(f"{self.name}: no events in window {number}, from {start_us} us on")

    def regressor(self) -> CompiledRegressor | None:
        """The model's landmark network, for the volumes that are drawn; None if not needed."""
        if not self.config.needs_regressor:
            return None
        if self.model is None or not self.model.config.needs_regressor:
            who = "there is no model" if self.model is None else f"model {self.model_name} has none"
            raise ValueError(f'landmark="regressor" needs a model with a landmark network, but {who}')
        return CompiledRegressor(replace(self.model, config=self.config))


@dataclass(frozen=True, eq=False)
class Window:
    """The events of one window of a recording, and what is drawn of them."""

    subject: Subject
    number: int
    """Counted from 1."""
    start_us: int
    events: np.ndarray

    @property
    def time_ms(self) -> np.ndarray:
        """Each event's time since the window's start, in milliseconds: float64, shape (N,)."""
        return (self.events["t"] - self.start_us) / 1e3

    @property
    def grid_xy(self) -> np.ndarray:
        """Each event's pixel on the volume's grid: float64, shape (2, N)."""
        config = self.subject.config
        gain_x, gain_y = config.to_grid(1.0, 1.0)
        return np.stack([self.events["x"] * gain_x, self.events["y"] * gain_y])

    def volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """The raw and the transformed volume of the window: float32, shape (C, H, W) each."""
        return self._read(self.subject.raw_config)[0], self._read(self.subject.config)[0]

    def coordinates(self) -> Coordinates:
        """Where the transform puts each event."""
        config = self.subject.config
        return transformed(
            self.events, config, self.start_us, self._read(config)[1] if config.defers_landmark else None
        )

    def flow(self) -> tuple[float, float]:
        """The ridge line's slope (x, y), in grid pixels per window: the direction in which the events move."""
        line = self.subject.config.replace(landmark="line", remove_flow=False)
        volume = TNTVolume(line)
        volume.open(self.start_us)
        volume.update(self.events)
        return volume.flow

    def _read(self, config: TNTConfig) -> tuple[np.ndarray, tuple[float, float]]:
        """A configuration's volume after all events, and its landmark."""
        regressor = self.subject.regressor() if config.needs_regressor else None
        volume = TNTVolume(config, replay_events=max(1, self.events.size), regressor=regressor)
        volume.open(self.start_us)
        volume.update(self.events)
        return volume.array.copy(), volume.landmark


def shown_evenly(n: int, most: int) -> np.ndarray:
    """At most `most` indices of n things, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)
