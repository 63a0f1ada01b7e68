"""TNTConfig: everything that decides what a volume holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from async_tnt.base.checks import (
    ParameterTypeError,
    ParameterValueError,
    is_whole,
    real_number,
    whole_number,
)
from async_tnt.base.messages import short

Landmark = Literal["center", "running", "line", "window", "regressor"]
Polarity = Literal["signed", "unsigned", "split"]
Transform = Literal["tnt", "none"]
Representation = Literal["volume", "count", "count_time", "mean_time", "time_surface"]

LANDMARKS = get_args(Landmark)
POLARITIES = get_args(Polarity)
TRANSFORMS = get_args(Transform)
REPRESENTATIONS = get_args(Representation)

IMAGE_BINS: dict[str, int] = {
    "count": 1,
    "count_time": 2,
    "mean_time": 1,
    "time_surface": 1,
}
"""Representation -> how many channels the image has for one polarity."""
TIME_IMAGES: tuple[str, ...] = ("count_time", "mean_time", "time_surface")
"""Images that hold times of events."""

BINS = 9
"""Time bins of a volume, by default."""
MAX_BINS = 1024
"""The most time bins of a volume."""
MAX_SIDE = 1 << 15
"""The most pixels along one side of a sensor or a grid."""
WINDOW_US = 105_000
"""Length of a window in microseconds, by default: one saccade of N-MNIST."""
MAX_WINDOW_US = 3600 * 1_000_000
"""Longest window in microseconds, an hour: an int64 then holds the sum of a billion times."""
MAX_WINDOW_EVENTS = 1 << 30
"""The most events of a window of `window_events`."""
MAX_LAST_EVENTS = 1 << 20
"""The most events of a window that slides. They take 16 MB. In a window of `last_us`, the oldest
event leaves early where more would be in it, and `TNTVolume.n_left_early` counts it."""
MIN_T_MAX = 1e-6
"""Smallest TNT time at the end of a window."""
MAX_T_MAX = 1e6
"""Largest TNT time at the end of a window."""
MAX_CELLS = 1 << 28
"""The most cells of a volume: 2 GB, as each is a float64. A volume of 1280 x 720 pixels with 256
bins has 2**27.8. A program may set `async_tnt.volume.config.MAX_CELLS = 1 << 30`, before it makes
or loads a configuration."""


@dataclass(frozen=True, init=False)
class TNTConfig:
    """The settings by which events become a volume, checked when they are made.

    All sizes are (width, height).

    Parameters
    ----------
    sensor : the camera's pixels. A line of pixels, (width, 1), has no plane to transform: it needs
        transform "none" and its own grid.
    grid : the volume's pixels; a sensor of another size is mapped onto it corner to corner.
    bins : B, time bins of the volume, by default 9; for an image, its channels of one polarity.
    window_us : length of a window in microseconds; by default 105,000, one saccade of N-MNIST.
    window_events : number of events in a window; by default windows have a duration instead. Such a
        window begins with an event, and times are scaled by its newest event, as in the thesis.
        As the newest event is known only when the volume is read, the events are stored, and
        replayed then. `window_us` is the longest duration of such a window, by default an hour.
    last_events : the window slides: at any moment it holds the last so many events, instead of
        those since a start. There is no end of a window.
    last_us : the window slides: at any moment it holds the events that are younger than this many
        microseconds, seen from the newest event. Both need representation "count", without the
        transform and on the sensor's own grid, because counts of events can be taken back exactly.
        With `last_us`, representation "volume" counts events in slices of time: `bins` slices of
        `last_us / bins`, counted from the stream's start. The last one has begun, and the window
        advances when the next one begins. Each event is in one slice: it is not shared by two.
    t_max : TNT time at the end of a window. Positions are divided by TNT time, so an object shrinks
        by this factor until the window's end. A smaller value loses fewer events over the border
        early in the window.
    landmark : the point that events are normalized about. `center`: the centre of the grid;
        `running`: the centroid of the window's events so far; `line`: the intercept of the running
        regression line of these events; `window`: the centroid of all the window's events when the
        volume is read; `regressor`: a network's estimate from the raw event volume when the volume
        is read. For the landmarks `window` and `regressor` the events are stored, and replayed when
        the volume is read.
    polarity : `signed` (ON adds, OFF subtracts), `unsigned` (both add) or `split` (ON bins, then
        OFF bins); by default `signed` for a volume and `split` for an image.
    transform : `tnt`, or `none` for the plain event volume; by default `tnt` for a volume and
        `none` for an image.
    remove_flow : subtract the flow that the running line has found (landmark `line` only).
    representation : `volume`, the event volume; or an image: `count` (events per pixel),
        `count_time` (events per pixel, and the newest event's time as a fraction of the window),
        `mean_time` (the mean time), or `time_surface` (exp(-age / tau) of the newest event at the
        window's end, where tau is half a window). With `split` polarity the channels of ON come
        first, then the channels of OFF. Images of times (all but `count`) take no transform, and no
        `signed` polarity.

    Raises
    ------
    ValueError, TypeError : a value is invalid; the message names the rule that it breaks.

    Examples
    --------
    >>> TNTConfig(bins=9).shape
    (9, 34, 34)
    >>> TNTConfig(grid=(34, 0))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    async_tnt.base.checks.ParameterValueError: `grid` must have sides of 1 to ..., got (34, 0)
    """

    sensor: tuple[int, int]
    grid: tuple[int, int]
    bins: int
    window_us: int
    t_max: float
    landmark: Landmark
    polarity: Polarity
    transform: Transform
    remove_flow: bool
    window_events: int | None
    representation: Representation
    last_events: int | None
    last_us: int | None

    def __init__(
        self,
        sensor: tuple[int, int] = (34, 34),
        grid: tuple[int, int] = (34, 34),
        bins: int | None = None,
        window_us: int | None = None,
        t_max: float = 8.0,
        landmark: Landmark = "running",
        polarity: Polarity | None = None,
        transform: Transform | None = None,
        remove_flow: bool = False,
        window_events: int | None = None,
        representation: Representation = "volume",
        last_events: int | None = None,
        last_us: int | None = None,
    ) -> None:
        # `dataclass` cannot write this method, because four arguments may be None, and their fields
        # may not.
        _one_of("representation", representation, REPRESENTATIONS)
        is_image = representation != "volume"
        if bins is None:
            bins = IMAGE_BINS.get(representation, BINS)
        if polarity is None:
            polarity = "split" if is_image else "signed"
        if transform is None:
            transform = "none" if is_image else "tnt"
        _check_one_kind(
            {
                "window_us": window_us,
                "window_events": window_events,
                "last_events": last_events,
                "last_us": last_us,
            }
        )
        if last_events is not None:
            last_events = whole_number("last_events", last_events, 1, MAX_LAST_EVENTS + 1)
        if last_us is not None:
            last_us = whole_number("last_us", last_us, 1, MAX_WINDOW_US + 1)
        if window_us is None:
            has_end = window_events is None and last_events is None
            window_us = (last_us or WINDOW_US) if has_end else MAX_WINDOW_US
        if window_events is not None:
            window_events = whole_number("window_events", window_events, 1, MAX_WINDOW_EVENTS + 1)

        checked = {
            "sensor": _size("sensor", sensor),
            "grid": _size("grid", grid),
            "bins": whole_number("bins", bins, 1, MAX_BINS + 1),
            "window_us": whole_number("window_us", window_us, 1, MAX_WINDOW_US + 1),
            "t_max": _t_max("t_max", t_max),
            "landmark": _one_of("landmark", landmark, LANDMARKS),
            "polarity": _one_of("polarity", polarity, POLARITIES),
            "transform": _one_of("transform", transform, TRANSFORMS),
            "remove_flow": _flag("remove_flow", remove_flow),
            "window_events": window_events,
            "representation": representation,
            "last_events": last_events,
            "last_us": last_us,
        }
        for name, value in checked.items():
            # The dataclass is frozen, so a plain assignment is refused.
            object.__setattr__(self, name, value)
        self._check_line_of_pixels()
        self._check_flow()
        self._check_image()
        self._check_sliding()
        self._check_cells()

    def _check_line_of_pixels(self) -> None:
        """Refuse a side of one pixel where events are transformed or mapped onto another grid."""
        for name, size in (("sensor", self.sensor), ("grid", self.grid)):
            if min(size) > 1 or (self.transform == "none" and self.grid == self.sensor):
                continue
            rule = (
                'must have sides of at least 2 pixels, unless transform="none" and grid and sensor '
                "are the same"
            )
            raise ParameterValueError(name, rule, size)

    def _check_flow(self) -> None:
        """Refuse `remove_flow` for a landmark that finds no flow."""
        if not self.remove_flow:
            return
        if self.landmark != "line" or self.transform != "tnt":
            rule = 'needs landmark="line" and transform="tnt"'
            got = f"landmark={self.landmark!r}, transform={self.transform!r}"
            raise ParameterValueError("remove_flow", rule, got)

    def _check_image(self) -> None:
        """Refuse settings of an image that do not fit it.

        An image has its own number of channels. An image of times takes no transform and no sign.
        """
        if self.bins != IMAGE_BINS.get(self.representation, self.bins):
            allowed = ", ".join(f"{n} ({name})" for name, n in IMAGE_BINS.items())
            got = f"representation={self.representation!r}, bins={self.bins!r}"
            raise ParameterValueError("bins", f"of an image must be {allowed}", got)
        if self.representation not in TIME_IMAGES:
            return
        if self.transform != "none" or self.polarity == "signed":
            raise ValueError(
                'an image of times needs transform="none" and polarity "split" or "unsigned", got '
                f"representation={self.representation!r}, transform={self.transform!r}, "
                f"polarity={self.polarity!r}"
            )

    def _check_sliding(self) -> None:
        """Refuse a sliding window whose events cannot be taken back exactly."""
        if not self.slides:
            return
        has_counts = self.representation == "count" or (
            self.representation == "volume" and self.last_us is not None
        )
        if not has_counts or self.transform != "none" or self.grid != self.sensor:
            name = "last_us" if self.last_events is None else "last_events"
            kinds = 'representation="count"'
            if self.last_us is not None:
                kinds += ' or "volume"'
            rule = (
                f'needs {kinds}, transform="none" and the sensor\'s own grid, as only counts of '
                "events can be taken back exactly"
            )
            if self.representation == "time_surface":
                rule = f"needs {kinds}: all pixels of a time surface decay with every event"
            got = (
                f"representation={self.representation!r}, transform={self.transform!r}, "
                f"grid={self.grid}, sensor={self.sensor}"
            )
            raise ParameterValueError(name, rule, got)
        if self.representation == "volume" and self.last_us % self.bins:  # type: ignore[operator]
            rule = (
                f"must be a multiple of {{bins}}, {self.bins}, as bins are slices of equal length"
            )
            raise ParameterValueError("last_us", rule, self.last_us)

    def _check_cells(self) -> None:
        """Refuse a volume with more cells than `MAX_CELLS`."""
        planes = self.channels + second_bin(self)
        cells = planes * (self.grid[0] + 1) * (self.grid[1] + 1)
        if cells > MAX_CELLS:
            hint = "a program may raise async_tnt.volume.config.MAX_CELLS"
            rule = f"and {{bins}} must give at most {MAX_CELLS:_} cells"
            raise ParameterValueError("grid", rule, f"{cells:_} ({hint})")

    @property
    def channels(self) -> int:
        """C, the number of channels: B, or 2 B with `split` polarity."""
        return self.bins * (2 if self.polarity == "split" else 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """The shape (C, H, W) of `TNTVolume.array`."""
        return self.channels, self.grid[1], self.grid[0]

    @property
    def slides(self) -> bool:
        """Whether the window slides: it has no end, and old events leave it."""
        return self.last_events is not None or self.last_us is not None

    @property
    def slice_us(self) -> int | None:
        """The length of a slice, in a window that slides in slices; None in any other."""
        if self.last_us is None or self.representation != "volume":
            return None
        return self.last_us // self.bins

    @property
    def needs_regressor(self) -> bool:
        """Whether a landmark network is used. Without the transform, landmarks are ignored."""
        return self.landmark == "regressor" and self.transform == "tnt"

    @property
    def defers_landmark(self) -> bool:
        """Whether the landmark is known only when the volume is read."""
        return self.landmark in ("window", "regressor") and self.transform == "tnt"

    @property
    def needs_replay(self) -> bool:
        """Whether events are stored until the volume is read.

        They are stored if the landmark or the window's duration is known only when it is read.
        """
        return self.defers_landmark or self.window_events is not None

    def to_grid(self, x: float, y: float) -> tuple[float, float]:
        """Sensor pixels (`x`, `y`) as grid pixels, corner to corner.

        Displacements and flows are converted in the same way.
        """
        gain_x, gain_y = self._gains
        return x * gain_x, y * gain_y

    def to_sensor(self, x: float, y: float) -> tuple[float, float]:
        """Grid pixels (`x`, `y`) as sensor pixels: the inverse of `to_grid`."""
        gain_x, gain_y = self._gains
        return x / gain_x, y / gain_y

    @property
    def _gains(self) -> tuple[float, float]:
        """Grid pixels per sensor pixel, in x and y: exactly 1 if both have the same size."""
        gain_x, gain_y = (
            1.0 if side == sensor_side else (side - 1) / (sensor_side - 1)
            for side, sensor_side in zip(self.grid, self.sensor, strict=True)
        )
        return gain_x, gain_y

    def to_dict(self) -> dict[str, Any]:
        """The fields as a dictionary of plain values, for JSON."""
        values = asdict(self)
        for name in ("sensor", "grid"):
            values[name] = list(values[name])
        if self.slides:
            del values["window_us"]
        for name in ("last_events", "last_us"):
            # earlier releases, which read files of other windows, do not know these names
            if values[name] is None:
                del values[name]
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TNTConfig:
        """The configuration whose fields have these `values`: the inverse of `to_dict`.

        Raises
        ------
        ValueError, TypeError : a name is unknown, or a value is invalid. The values usually come
            from a file and not from a caller, so the error is never a ParameterError.
        """
        if not isinstance(values, Mapping):
            raise TypeError(
                f"a configuration must be a mapping of names to values, got {short(values)}"
            )
        known = {field.name for field in fields(cls)}
        unknown = sorted(str(name) for name in set(values) - known)
        if unknown:
            raise ValueError(
                f"unknown configuration {', '.join(unknown)}; known: {', '.join(sorted(known))}"
            )
        arguments: dict[str, Any] = {}
        for name, value in values.items():
            arguments[name] = tuple(value) if isinstance(value, list) else value
        try:
            return cls(**arguments)
        except ParameterValueError as error:
            raise ValueError(str(error)) from None
        except ParameterTypeError as error:
            raise TypeError(str(error)) from None

    def replace(self, **changes: Any) -> TNTConfig:
        """A copy with other values in the fields that `changes` names.

        The defaults of some fields depend on the representation. The default of `window_us` depends
        on the kind of the windows (of a duration, or of a number of events). Where `changes` sets
        another representation or kind, these fields get their defaults, unless `changes` names
        them.
        """
        representation = changes.get("representation", self.representation)
        if representation != self.representation:
            changes = {"bins": None, "polarity": None, "transform": None} | changes
        kinds = ("window_events", "last_events", "last_us")
        before = [getattr(self, name) is not None for name in kinds]
        after = [changes.get(name, getattr(self, name)) is not None for name in kinds]
        if before != after or self.slides:
            changes = {"window_us": None} | changes
        return replace(self, **changes)


def with_an_end(config: TNTConfig) -> TNTConfig:
    """The configuration of a window that does not slide, and is as long.

    Given the events of a window that slides, its volume is the same, unless that has slices.
    """
    if not config.slides:
        return config
    return config.replace(last_us=None, last_events=None, window_us=config.window_us)


def second_bin(config: TNTConfig) -> int:
    """The number of planes of cells between an event's first bin and its second bin.

    The same number of planes lies behind the planes that are read, see `kernels.volume.state`.
    """
    return config.channels if config.bins == 1 else 1


# -- checks of single fields -----------------------------------------------------------------------


def _one_of(name: str, value: Any, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        raise ParameterValueError(name, f"must be one of {', '.join(allowed)}", short(value))
    return value


def _check_one_kind(lengths: Mapping[str, Any]) -> None:
    """Refuse a window that slides and has another length, too. Only two lengths go together."""
    given = [name for name, value in lengths.items() if value is not None]
    if len(given) > 1 and given != ["window_us", "window_events"]:
        rule = f"must not be given with {{{given[0]}}}: a window has one length"
        raise ParameterValueError(given[1], rule)


def _size(name: str, value: Any) -> tuple[int, int]:
    is_pair = isinstance(value, (tuple, list)) and len(value) == 2
    if not is_pair or not all(is_whole(side) for side in value):
        rule = "must be two whole numbers (width, height)"
        raise ParameterTypeError(name, rule, short(value))
    size = int(value[0]), int(value[1])
    if not all(1 <= side <= MAX_SIDE for side in size):
        rule = f"must have sides of 1 to {MAX_SIDE} pixels"
        raise ParameterValueError(name, rule, short(size))
    return size


def _t_max(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not MIN_T_MAX <= number <= MAX_T_MAX:
        raise ParameterValueError(name, "must be in [1e-6, 1e6]", number)
    return number


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise ParameterTypeError(name, "must be True or False", short(value))
    return bool(value)
