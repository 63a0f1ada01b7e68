"""What figures draw: a recording's events, where the transform puts each, its volumes, and the model that decides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.events import EventDecoder
from async_tnt.kernels.splat import BORDER_TOLERANCE
from async_tnt.networks.compiled import CompiledRegressor
from async_tnt.networks.model import Model
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

    def volumes(self) -> tuple[np.ndarray, np.ndarray]:
        """The raw and the transformed volume of the window: float32, shape (C, H, W) each."""
        return self._read(self.subject.raw_config)[0], self._read(self.subject.config)[0]

    def coordinates(self) -> Coordinates:
        """Where the transform puts each event."""
        config = self.subject.config
        return transformed(
            self.events, config, self.start_us, self._read(config)[1] if config.defers_landmark else None
        )

    def _read(self, config: TNTConfig) -> tuple[np.ndarray, tuple[float, float]]:
        """A configuration's volume after all events, and its landmark."""
        regressor = self.subject.regressor() if config.needs_regressor else None
        volume = TNTVolume(config, replay_events=max(1, self.events.size), regressor=regressor)
        volume.open(self.start_us)
        volume.update(self.events)
        return volume.array.copy(), volume.landmark


class Coordinates(NamedTuple):
    """Of N events of a window, in order of arrival."""

    u: np.ndarray
    """float64, shape (N,): column in the transformed grid; inf or nan at the window's very start, where tau is 0."""
    v: np.ndarray
    """float64, shape (N,): row."""
    kept: np.ndarray
    """bool, shape (N,): on the grid, and so in the volume."""
    landmark: np.ndarray
    """float64, shape (N, 2): the point (x, y) each event was centred on, in grid pixels. With `remove_flow`, the
    place of the fitted line at the event's time."""


def transformed(
    events: np.ndarray, config: TNTConfig, start_us: int, landmark: tuple[float, float] | None = None
) -> Coordinates:
    """The transform of one window's events: u = (x - l) / tau + c, where l is what the volume had for the event.

    Parameters
    ----------
    events : structured array of `EVENT_DTYPE`, all in `[start_us, start_us + window_us)`.
    config : TNTConfig. With transform "none", (u, v) is the pixel in the grid.
    start_us : the window's start.
    landmark : (x, y) in grid pixels to centre all events on, instead of `config.landmark`. Landmarks that are known
        only when the volume is read (`window`, `regressor`) must be given: `TNTVolume.landmark` has them.

    Raises
    ------
    ValueError : an event outside the window or off the sensor; a landmark that must be given is missing.

    Examples
    --------
    >>> events = np.array([(13_125, 18, 17, 1)], [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])
    >>> u, v, kept, landmark = transformed(events, TNTConfig(landmark="center", t_max=4.0), 0)
    >>> u, v, kept, landmark  # TNT time 1/2: distances from the centre are doubled
    (array([19.5]), array([17.5]), array([ True]), array([[16.5, 16.5]]))
    """
    if landmark is None and config.defers_landmark:
        raise ValueError(f"`landmark` must be given for {config.landmark!r}: it is known when the volume is read")
    t = events["t"]
    if events.size and not (start_us <= t.min() and t.max() < start_us + config.window_us):
        raise ValueError(
            f"`events` must lie in the window [{start_us}, {start_us + config.window_us}) us, "
            f"got {t.min()} to {t.max()}"
        )
    EventDecoder(config.sensor).decode(events)
    place = np.stack([events["x"], events["y"]], axis=1) * config.to_grid(1.0, 1.0)  # (N, 2)
    centre = np.subtract(config.grid, 1) / 2
    centred_on = np.empty_like(place)
    if landmark is None and config.transform == "none":
        centred_on[:] = centre
        return Coordinates(place[:, 0], place[:, 1], np.ones(events.size, bool), centred_on)
    fraction = (t - start_us) / config.window_us
    if landmark is not None:
        centred_on[:] = landmark
    else:
        volume = TNTVolume(config.replace(representation="volume", bins=1))  # landmarks do not depend on the cells
        volume.open(start_us)
        for i, event in enumerate(events.tolist()):
            volume.update_one(*event)
            centred_on[i] = volume.landmark
            if config.remove_flow:
                centred_on[i] += np.multiply(volume.flow, fraction[i])
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = ((place - centred_on) / (config.t_max * fraction)[:, None] + centre).T
    return Coordinates(u, v, _on_grid(u, config.grid[0] - 1) & _on_grid(v, config.grid[1] - 1), centred_on)


def _on_grid(values: np.ndarray, upper: int) -> np.ndarray:
    """As `kernels.splat.on_grid`: False for nan and inf."""
    return (values >= -BORDER_TOLERANCE) & (values <= upper + BORDER_TOLERANCE)


def shown_evenly(n: int, most: int) -> np.ndarray:
    """At most `most` indices of n things, evenly spread."""
    return np.arange(n) if n <= most else np.linspace(0, n - 1, most).astype(np.int64)
