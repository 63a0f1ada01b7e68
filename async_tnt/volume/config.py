"""TNTConfig: everything that decides what a volume holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

import numpy as np

from async_tnt.base.checks import is_whole, real_number, short, whole_number

Landmark = Literal["center", "running", "line", "window", "regressor"]
Polarity = Literal["signed", "unsigned", "split"]
Transform = Literal["tnt", "none"]
Representation = Literal["volume", "count", "count_time", "mean_time", "time_surface"]
LANDMARKS, POLARITIES, TRANSFORMS, REPRESENTATIONS = map(
    get_args, (Landmark, Polarity, Transform, Representation)
)
# channels of one polarity
IMAGE_BINS = {"count": 1, "count_time": 2, "mean_time": 1, "time_surface": 1}
TIME_IMAGES = ("count_time", "mean_time", "time_surface")
BINS = 9
MAX_SIDE = 1 << 15
WINDOW_US = 105_000
MAX_WINDOW_US = 3600 * 1_000_000  # an hour: sums of times then hold a billion events
MAX_WINDOW_EVENTS = 1 << 30
MAX_CELLS = 1 << 28
"""Of a volume, float64: 2 GB. 1280 x 720 pixels with 256 bins have 2**27.8. A program may set
`async_tnt.volume.config.MAX_CELLS = 1 << 30`, before it makes or loads a configuration."""


@dataclass(frozen=True)
class TNTConfig:
    """How events become a volume. Checks itself when built; sizes are (width, height).

    Parameters
    ----------
    sensor : the camera's pixels.
    grid : the volume's pixels; a sensor of another size is mapped onto it corner to corner.
    bins : B, time bins of the volume, by default 9; of an image, its channels of one polarity.
    window_us : length of a window in microseconds; by default 105,000, one saccade of N-MNIST.
    window_events : windows of so many events instead. Such a window begins with an event, and times
        are scaled by its newest one, as in the thesis, which is known only when the volume is read:
        the events are stored, and replayed then. `window_us` is the longest that it may last, by
        default an hour.
    t_max : TNT time, by which positions are divided, at the end of a window. An object shrinks by
        this factor until then; a smaller value loses fewer events over the border early in the
        window.
    landmark : the point that events are normalized about: `center` of the grid, `running` centroid
        of the window's events so far, `line`: the intercept of their running regression line,
        `window`: the centroid of all the window's events when it is read (they are stored, and
        replayed then), `regressor`: a network's estimate from the raw event volume when it is read
        (replayed, too).
    polarity : `signed` (ON adds, OFF subtracts), `unsigned` (both add), `split` (ON bins, then OFF
        bins); by default `signed` for a volume and `split` for an image.
    transform : `tnt`, or `none` for the plain event volume; by default `tnt` for a volume and
        `none` for an image.
    remove_flow : subtract the flow that the running line has found (landmark `line` only).
    representation : `volume`, the event volume; or an image: `count` (events per pixel),
        `count_time` (the same, and the time of the newest, as a fraction of the window),
        `mean_time` (the mean time), or `time_surface` (exp(-age / tau) of the newest event at the
        window's end, tau half a window). With `split` polarity the channels of ON come first, then
        those of OFF. Images of times (all but `count`) take no transform, and no `signed` polarity.

    Raises
    ------
    ValueError, TypeError : an invalid value; the message names its rule.

    Examples
    --------
    >>> TNTConfig(bins=9).shape
    (9, 34, 34)
    >>> TNTConfig(grid=(34, 1))
    Traceback (most recent call last):
    ...
    ValueError: `grid` must have sides of 2 to 32768 pixels, got (34, 1)
    """

    sensor: tuple[int, int] = (34, 34)
    grid: tuple[int, int] = (34, 34)
    bins: int = None  # type: ignore[assignment]  # set below, as are the other three: never None from then on
    window_us: int = None  # type: ignore[assignment]
    t_max: float = 8.0
    landmark: Landmark = "running"
    polarity: Polarity = None  # type: ignore[assignment]
    transform: Transform = None  # type: ignore[assignment]
    remove_flow: bool = False
    window_events: int | None = None
    representation: Representation = "volume"

    def __post_init__(self) -> None:
        self._set(
            "representation", _FIELDS["representation"]("representation", self.representation)
        )
        is_image = self.representation != "volume"
        for name, default in (
            ("bins", IMAGE_BINS.get(self.representation, BINS)),
            ("polarity", "split" if is_image else "signed"),
            ("transform", "none" if is_image else "tnt"),
            ("window_us", WINDOW_US if self.window_events is None else MAX_WINDOW_US),
        ):
            if getattr(self, name) is None:
                self._set(name, default)
        for name, check in _FIELDS.items():
            self._set(name, check(name, getattr(self, name)))
        for holds, rule, names in _RELATIONS:
            if not holds(self):
                raise ValueError(
                    f"{rule}, got {', '.join(f'{name}={getattr(self, name)!r}' for name in names)}"
                )
        cells = (self.channels + second_bin(self)) * (self.grid[0] + 1) * (self.grid[1] + 1)
        if cells > MAX_CELLS:
            raise ValueError(
                f"`grid` and `bins` must give at most {MAX_CELLS:_} cells, got {cells:_} (a "
                "program may raise "
                "async_tnt.volume.config.MAX_CELLS)"
            )

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def channels(self) -> int:
        """C: B, or 2 B with `split` polarity."""
        return self.bins * (2 if self.polarity == "split" else 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(C, H, W), the shape of `TNTVolume.array`."""
        return self.channels, self.grid[1], self.grid[0]

    @property
    def needs_regressor(self) -> bool:
        """Whether a landmark network is used: without the transform, landmarks are ignored."""
        return self.landmark == "regressor" and self.transform == "tnt"

    @property
    def defers_landmark(self) -> bool:
        """Whether the landmark is known only when the volume is read."""
        return self.landmark in ("window", "regressor") and self.transform == "tnt"

    @property
    def needs_replay(self) -> bool:
        """Whether the landmark or the window's duration is known only when the volume is read, so
        that events are stored until then."""
        return self.defers_landmark or self.window_events is not None

    def to_grid(self, x: float, y: float) -> tuple[float, float]:
        """Sensor pixels (`x`, `y`) to grid pixels, corner to corner; also displacements and
        flows."""
        gain_x, gain_y = self._gains
        return x * gain_x, y * gain_y

    def to_sensor(self, x: float, y: float) -> tuple[float, float]:
        """Grid pixels (`x`, `y`) to sensor pixels, the inverse of `to_grid`."""
        gain_x, gain_y = self._gains
        return x / gain_x, y / gain_y

    @property
    def _gains(self) -> tuple[float, float]:
        """Grid pixels per sensor pixel: exactly 1 if both have the same size."""
        (sensor_w, sensor_h), (width, height) = self.sensor, self.grid
        return (width - 1) / (sensor_w - 1), (height - 1) / (sensor_h - 1)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TNTConfig:
        """The inverse of `to_dict`: a configuration of the `values` of its fields; an unknown name
        is a ValueError."""
        if not isinstance(values, Mapping):
            raise TypeError(
                f"a configuration must be a mapping of names to values, got {short(values)}"
            )
        known = {field.name for field in fields(cls)}
        if unknown := sorted(str(name) for name in set(values) - known):
            raise ValueError(
                f"unknown configuration {', '.join(unknown)}; known: {', '.join(sorted(known))}"
            )
        arguments: dict[str, Any] = {
            name: tuple(v) if isinstance(v, list) else v for name, v in values.items()
        }
        return cls(**arguments)

    def replace(self, **changes: Any) -> TNTConfig:
        """A copy with other values in the fields that `changes` names. With another representation,
        or with windows of another kind, the values whose defaults depend on that are its
        defaults."""
        if changes.get("representation", self.representation) != self.representation:
            changes = dict.fromkeys(("bins", "polarity", "transform")) | changes
        if (changes.get("window_events", self.window_events) is None) != (
            self.window_events is None
        ):
            changes = {"window_us": None} | changes
        return replace(self, **changes)


def second_bin(config: TNTConfig) -> int:
    """Planes of cells from an event's first bin to its second, see `kernels.state`; so many lie
    behind those that are read."""
    return config.channels if config.bins == 1 else 1


# -- the constraints: of each field, and between fields --------------------------------------------


def _one_of(allowed: Sequence[str]) -> Callable[[str, Any], str]:
    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in allowed:
            raise ValueError(f"`{name}` must be one of {', '.join(allowed)}, got {short(value)}")
        return value

    return check


def _whole(low: int, high: int) -> Callable[[str, Any], int]:
    return lambda name, value: whole_number(name, value, low, high + 1)


def _size(name: str, value: Any) -> tuple[int, int]:
    if not (
        isinstance(value, (tuple, list))
        and len(value) == 2
        and all(is_whole(side) for side in value)
    ):
        raise TypeError(f"`{name}` must be two whole numbers (width, height), got {short(value)}")
    size = int(value[0]), int(value[1])
    if not all(2 <= side <= MAX_SIDE for side in size):
        raise ValueError(f"`{name}` must have sides of 2 to {MAX_SIDE} pixels, got {short(size)}")
    return size


def _window_events(name: str, value: Any) -> int | None:
    return None if value is None else whole_number(name, value, 1, MAX_WINDOW_EVENTS + 1)


def _t_max(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not 1e-6 <= number <= 1e6:
        raise ValueError(f"`{name}` must be in [1e-6, 1e6], got {number}")
    return number


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"`{name}` must be True or False, got {short(value)}")
    return bool(value)


_FIELDS: dict[str, Callable[[str, Any], object]] = {
    "sensor": _size,
    "grid": _size,
    "bins": _whole(1, 1024),
    "window_us": _whole(1, MAX_WINDOW_US),
    "t_max": _t_max,
    "landmark": _one_of(LANDMARKS),
    "polarity": _one_of(POLARITIES),
    "transform": _one_of(TRANSFORMS),
    "remove_flow": _flag,
    "window_events": _window_events,
    "representation": _one_of(REPRESENTATIONS),
}
"""Name -> check(name, value), which returns the value as it is kept."""

_RELATIONS: tuple[tuple[Callable[[TNTConfig], bool], str, tuple[str, ...]], ...] = (
    (
        lambda c: not c.remove_flow or (c.landmark == "line" and c.transform == "tnt"),
        '`remove_flow` needs landmark="line" and transform="tnt"',
        ("landmark", "transform"),
    ),
    (
        lambda c: c.bins == IMAGE_BINS.get(c.representation, c.bins),
        f"`bins` of an image must be "
        f"{', '.join(f'{n} ({name})' for name, n in IMAGE_BINS.items())}",
        ("representation", "bins"),
    ),
    (
        lambda c: (
            c.representation not in TIME_IMAGES
            or (c.transform == "none" and c.polarity != "signed")
        ),
        'an image of times needs transform="none" and polarity "split" or "unsigned"',
        ("representation", "transform", "polarity"),
    ),
)
"""What must hold, the rule in words, and the fields that the message shows."""
