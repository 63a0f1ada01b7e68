"""Scenes to learn from and to be tested on: windows of several recordings on one large sensor.

Without the transform a volume is a sum over events. So the volume of a scene is a sum, too. Its
terms are the volumes of the scene's recordings, each at its place, and the volume of noise. A scene
has:

    objects   On average a scene has `OBJECTS` objects. The middle of each object is anywhere on the
              sensor, so that some objects are cut off at the sensor's border. Half of the objects
              are placed beside another object. Two objects are at least `APART` from each other
    starts    half of the objects begin later than the scene, by up to half a window
    end       augmentation draws when the scene ends. All of its objects end then
    nothing   augmentation makes some windows show nothing. They are in the scene, but are no
              objects
    boxes     The box of an object of a picture is that of its outline when the scene ends. The box
              of an object of a camera's recording reaches from the 2nd to the 98th percentile of
              the x and of the y of its events until then
    noise     each pixel has noise events, at a rate within `NOISE_HZ`. A third of the scenes also
              have a hot pixel

An object with fewer than `FEWEST` events by the scene's end does not count as an object.

Scenes of objects of many sizes (`Scales`) have a sensor of a stated size. Each recording shows an
object of another size, cut out of such a sensor. So these scenes have more objects,
`OBJECTS_OF_SIZES`, and distances between objects are in shares of their own sizes. An object counts
if its box has more events than the noise around it, by `FEWEST_A_PX` for each pixel of the box's
border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.networks.models.model import in_grid_steps
from async_tnt.training.augment import Draws
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EVENT_DTYPE
from async_tnt.volume.sensor import Sensor

SIDES = 3
"""Width and height of a scene, as multiples of a recording's width and height."""
OBJECTS = 2.5
"""Average number of objects in a scene."""
FEWEST = 10
"""Fewest events of a recording that counts as an object."""
FEWEST_A_PX = 0.2
"""Fewest events of an object of any size that counts as one, for each pixel of its box's border."""
APART = 0.4
"""Least distance between two objects, as a share of a recording's shorter side."""
OBJECTS_OF_SIZES = 4.5
"""Average number of objects in a scene of objects of many sizes."""
OF_RECORDING = 0.8
"""Longer side of an object of any size, as a share of what stands for its recording's shorter
side."""
LARGEST_SENSOR = 2.4
"""Side of the sensor that is cut out around an object of any size, as a multiple of the largest
object's longer side."""
SMALLEST_CELLS = 10
"""Least longer side of an object in cells of a default grid."""
TRIES = 20
"""Number of places that are tried for an object. If none of them fits, the object is dropped."""
BESIDE = 0.5
"""Share of objects that are placed beside another object, so that some overlap. The distance is at
most a recording's shorter side, in x and in y."""
AT_ONCE = 64
"""Number of windows that are made to scenes at a time when a model is scored."""
NOISE_HZ = (0.1, 0.9)
"""Range of the noise, in events per pixel and second."""
HOT_EVENTS = (20, 300)
"""Range of the number of events of a hot pixel."""
MOST_NOISE = 100_000
"""Most noise events of a scene. On a large sensor, more of them would take longer than all else."""
OUTER = (2, 98)
"""Percentiles of the x and of the y of an object's events. They are the sides of the object's box,
so that noise farther out does not change it. The middle of the object is halfway between them."""


@dataclass(frozen=True)
class Scales:
    """Sizes of the objects in scenes.

    Parameters
    ----------
    least, most : longer side of an object, as a share of the sensor's shorter side.

    Raises
    ------
    ValueError : no shares, or the least one is the larger.
    """

    least: float
    most: float

    def __post_init__(self) -> None:
        if not 0 < self.least <= self.most <= 1:
            rule = "must be a range of shares within (0, 1]"
            raise ParameterValueError("scales", rule, (self.least, self.most))

    def grid(self, sensor: Sensor) -> Sensor:
        """The default grid of a sensor: the smallest objects have about `SMALLEST_CELLS` cells.

        Both sides are multiples of `GRID_STEP`.

        Examples
        --------
        >>> Scales(1 / 12, 1 / 3).grid((240, 180)), Scales(0.4, 0.9).grid((34, 34))
        ((160, 120), (24, 24))
        """
        share = min(1.0, SMALLEST_CELLS / (self.least * min(sensor)))
        return in_grid_steps(share * sensor[0]), in_grid_steps(share * sensor[1])

    def cut_out(self, scenes: TNTConfig) -> TNTConfig:
        """How the events of recordings become volumes, for scenes with these volumes.

        The sensor of recordings has `LARGEST_SENSOR` times the side of the largest object.
        """
        shorter = min(scenes.sensor)
        side = max(2, math.ceil(LARGEST_SENSOR * self.most * shorter))
        cells = max(2, round(side * min(scenes.grid) / shorter))
        return scenes.replace(sensor=(side, side), grid=(cells, cells))

    def on_cut_out(self, scenes: TNTConfig) -> tuple[float, float]:
        """The sizes of objects as shares of the sensor of `cut_out`."""
        ratio = min(scenes.sensor) / self.cut_out(scenes).sensor[0]
        return self.least * ratio, self.most * ratio


@dataclass(frozen=True)
class Scenes:
    """M scenes with K objects.

    Parameters
    ----------
    volumes : float32, (M, C, H, W).
    scene, label : int64, (K,). The number of each object's scene, and the object's class.
    position : float64, (K, 2). The middle of each object, (x, y) in sensor pixels.
    size : float64, (K, 2). The width and height of each object's box, in sensor pixels.
    """

    volumes: np.ndarray
    scene: np.ndarray
    label: np.ndarray
    position: np.ndarray
    size: np.ndarray


class EventsOfCells:
    """How many events each cell of windows has, about.

    Parameters
    ----------
    config : how events become volumes.
    """

    def __init__(self, config: TNTConfig) -> None:
        self._unsigned = None
        if config.polarity == "signed":  # ON and OFF of a cell take each other away
            self._unsigned = BatchVolumes(config.replace(polarity="unsigned"))

    def __call__(self, volumes: np.ndarray, windows: Windows, draws: Draws) -> np.ndarray:
        """The numbers of events: float32, (N, H, W).

        volumes : those of `windows` and `draws`, see `BatchVolumes`.
        """
        if self._unsigned is not None:
            volumes = self._unsigned(windows, draws)
        # an event adds 1 to all bins together
        events: np.ndarray = volumes.sum(1)
        return events


class SceneMaker:
    """Makes scenes of windows.

    Parameters
    ----------
    config : how the recordings' events become volumes.
    scenes : how the scenes' events become volumes, with objects of many sizes. None: a scene is
        `SIDES` times as wide and high as a recording.

    Attributes
    ----------
    config : how the scenes' events become volumes.
    crops : how the recordings' events become volumes.
    n_windows : average number of windows that a scene is made of: its objects.
    at_once : number of windows that are made to scenes at a time when a model is scored.

    Raises
    ------
    ValueError : as `check_volume`.
    """

    at_once = AT_ONCE

    def __init__(self, config: TNTConfig, scenes: TNTConfig | None = None) -> None:
        check_volume(config)
        self.crops = config
        self.config = scenes_of(config) if scenes is None else scenes
        self._has_sizes = scenes is not None
        self.n_windows = OBJECTS if scenes is None else OBJECTS_OF_SIZES
        self._crop_volumes = BatchVolumes(config)
        self._events_of_cells = EventsOfCells(config)
        self._scene_volumes = BatchVolumes(self.config)
        self._shorter = min(config.sensor)

    def __call__(self, windows: Windows, draws: Draws, rng: np.random.Generator) -> Scenes:
        """Scenes made of all `windows`, at places that `rng` draws."""
        n = len(windows)
        # the times of outlines count from the recording's start
        since_us = windows.start_us + draws.start_us
        recorded = windows
        # An object that begins later must not show the events before its window. So each window
        # becomes a recording of its own, without these events.
        windows = Windows(windows.recordings, windows.recording, windows.start_us + draws.start_us)
        windows = windows.cut(self.config.window_us)
        scene = rng.integers(max(1, round(n / self.n_windows)), size=n)  # each window's scene
        n_scenes = int(scene.max()) + 1
        # each scene ends when a window drawn at random would end
        until_us = draws.until_us[rng.integers(n, size=n_scenes)]
        is_late = rng.random(n) < 0.5
        later_us = rng.integers(0, max(1, self.config.window_us // 2), n)
        later_us[~is_late] = 0
        draws = replace(draws, until_us=until_us[scene], start_us=-later_us)
        crops = self._crop_volumes(windows, draws)
        events_of_cells = self._events_of_cells(crops, windows, draws)
        has_events = events_of_cells.sum((1, 2)) >= FEWEST

        ends_us = until_us[scene] - later_us
        middles, sizes = self._boxes(recorded, windows, since_us, ends_us, draws)
        extents = np.full(n, float(self._shorter))
        if self._has_sizes:
            extents = sizes.max(axis=1) / OF_RECORDING
            cells = np.array(self.crops.to_grid(1, 1))
            more = _more_than_around(events_of_cells, middles * cells, sizes * cells)
            has_events &= more >= FEWEST_A_PX * 2 * sizes.sum(axis=1)
        is_object = (draws.content == SHOWN) & has_events

        volumes = self._noise(n_scenes, until_us, rng)
        position = np.full((n, 2), np.inf)  # inf: the window is not in a scene
        for i in range(n):
            is_taken = (scene == scene[i]) & np.isfinite(position[:, 0])
            # as far from each object as the mean of both extents
            apart = (extents[is_taken] + extents[i]) / 2
            place = self._place(position[is_taken], apart, rng)
            if place is not None:
                position[i] = self._add(volumes[scene[i]], crops[i], middles[i], place)
        is_object &= np.isfinite(position[:, 0])
        return Scenes(
            volumes,
            scene[is_object],
            windows.labels[is_object],
            position[is_object],
            sizes[is_object],
        )

    def _boxes(
        self,
        recorded: Windows,
        cut: Windows,
        since_us: np.ndarray,
        ends_us: np.ndarray,
        draws: Draws,
    ) -> np.ndarray:
        """The boxes of N objects on the sensor of recordings: float64, (2, N, 2).

        Middles (x, y) stand first, then sizes.

        Parameters
        ----------
        recorded, cut : the objects' windows, and the same from `Windows.cut`.
        since_us : int64, (N,), the beginning of each window in its recording.
        ends_us : int64, (N,), the moment of each box, in microseconds since the window's beginning.
        draws : the augmentation, which moves boxes as it moves events.
        """
        boxes = _boxes_of_outlines(recorded, since_us + ends_us, draws.matrix)
        is_unknown = np.isnan(boxes).any(axis=(0, 2))
        if is_unknown.any():
            boxes[:, is_unknown] = _boxes_of_events(
                cut[is_unknown], ends_us[is_unknown], draws.matrix[is_unknown]
            )
        # augmented events are on a sensor that is `fine` times finer than the recordings'
        fine = 1.0
        if draws.sensor != self.crops.sensor:
            fine = (draws.sensor[0] - 1) / (self.crops.sensor[0] - 1)
        return boxes / fine

    def _place(
        self, taken: np.ndarray, extents: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray | None:
        """A place for one more object, (x, y) in sensor pixels; None if `TRIES` places do not fit.

        Parameters
        ----------
        taken : (K, 2), the places of the objects that are already in the scene.
        extents : (K,), for each of these objects, what stands for a recording's shorter side.
        rng : draws the place.
        """
        end = np.array(self.config.sensor) - 1.0
        is_beside = len(taken) > 0 and rng.random() < BESIDE
        for _ in range(TRIES):
            place = rng.uniform(0, end)
            if is_beside:
                k = rng.integers(len(taken))
                place = taken[k] + rng.uniform(-1, 1, 2) * extents[k]
            is_on_sensor = (place >= 0).all() and (place <= end).all()
            if not is_on_sensor:
                continue
            distances = np.hypot(*(taken - place).T)
            if (distances >= APART * extents).all():
                return place
        return None

    def _add(
        self, volume: np.ndarray, crop: np.ndarray, middle: np.ndarray, place: np.ndarray
    ) -> np.ndarray:
        """Add a recording's volume to a scene's volume, moved by whole cells.

        Parameters
        ----------
        volume : the scene's volume. Updated in place.
        crop : the recording's volume.
        middle : the middle of the object, (x, y) in pixels of the recording.
        place : the wanted place of the middle, (x, y) in pixels of the scene.

        Returns
        -------
        The place that the middle got, (x, y) in pixels of the scene.
        """
        scale = np.array(self.config.to_grid(1, 1))
        in_cells = middle * self.crops.to_grid(1, 1)
        left, top = np.rint(place * scale - in_cells).astype(int)
        _, height, width = volume.shape
        _, rows, columns = crop.shape
        y0 = max(0, top)
        y1 = min(height, top + rows)
        x0 = max(0, left)
        x1 = min(width, left + columns)
        if y0 < y1 and x0 < x1:
            volume[:, y0:y1, x0:x1] += crop[:, y0 - top : y1 - top, x0 - left : x1 - left]
        position: np.ndarray = (in_cells + np.array([left, top])) / scale
        return position

    def _noise(self, n_scenes: int, until_us: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The volumes of the scenes' noise, (M, C, H, W).

        until_us : int64, (M,), the time at which each scene ends.
        """
        width, height = self.config.sensor
        recordings = []
        for until in until_us:
            mean = rng.uniform(*NOISE_HZ) * width * height * until / 1e6
            n = min(rng.poisson(mean), MOST_NOISE)
            n_hot = int(rng.integers(*HOT_EVENTS)) if rng.random() < 1 / 3 else 0
            events = np.zeros(n + n_hot, EVENT_DTYPE)
            events["x"] = rng.integers(width, size=len(events))
            events["y"] = rng.integers(height, size=len(events))
            # the last events are those of one hot pixel
            events["x"][n:] = rng.integers(width)
            events["y"][n:] = rng.integers(height)
            events["p"] = rng.integers(2, size=len(events))
            events["t"] = rng.integers(until, size=len(events))
            recordings.append(events[np.argsort(events["t"], kind="stable")])
        noise = Recordings.from_events(recordings, [0] * n_scenes)
        windows = Windows(noise, np.arange(n_scenes), np.zeros(n_scenes, np.int64))
        return self._scene_volumes(windows).copy()


def check_volume(config: TNTConfig) -> None:
    """Refuse volumes of which no scenes can be made.

    Raises
    ------
    ValueError : `config` has a transform, volumes that are no sums over events, or windows of a
        number of events.
    """
    if config.last_events is not None:
        rule = "must have windows of a duration, as a scene holds those of several objects"
        raise ParameterValueError("config", rule, f"last_events={config.last_events}")
    if config.transform != "none" or config.representation not in ("volume", "count"):
        raise ValueError(
            "a scene is a sum of volumes: `representation` must be volume or count, and "
            f"`transform` none; got {config.representation} and {config.transform}"
        )


def scenes_of(config: TNTConfig) -> TNTConfig:
    """How the events of scenes become volumes: `SIDES` times as wide and high as recordings."""
    width, height = config.sensor
    columns, rows = config.grid
    return config.replace(
        sensor=(SIDES * width, SIDES * height), grid=(SIDES * columns, SIDES * rows)
    )


def _more_than_around(events: np.ndarray, middles: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """How many more events are in boxes than as many cells around them have: float64, (N,).

    The cells around a box are those of a box that is twice as wide and high.

    Parameters
    ----------
    events : (N, H, W), the number of events of each cell of N volumes.
    middles, sizes : float64, (N, 2) each: a box in each volume, in cells.
    """
    end = np.array(events.shape[:0:-1])  # width and height
    inner_and_outer = []
    for scale in (0.5, 1.0):
        low = np.clip(np.rint(middles - scale * sizes), 0, end).astype(int)
        high = np.clip(np.rint(middles + scale * sizes) + 1, 0, end).astype(int)
        inside = np.array(
            [
                of_cells[y0:y1, x0:x1].sum()
                for of_cells, (x0, y0), (x1, y1) in zip(events, low, high, strict=True)
            ],
            np.float64,
        )
        inner_and_outer.append((inside, np.maximum(high - low, 0).prod(axis=1)))
    (inside, area), (with_border, larger_area) = inner_and_outer
    around = (with_border - inside) / np.maximum(larger_area - area, 1)
    more: np.ndarray = inside - around * area
    return more


def _boxes_of_outlines(windows: Windows, times_us: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The boxes around the outlines of windows' objects: float64, (2, N, 2).

    Middles (x, y) stand first, then sizes. nan: the outline is not known.

    Parameters
    ----------
    windows : N windows.
    times_us : int64, (N,), the moment of each box, in microseconds since its recording's start. An
        object stays where it is before its recording and after it.
    matrix : float64, (N, 2, 3), moves each outline, see `Draws.matrix`.
    """
    outlines = windows.recordings.outlines
    outlined_us = windows.recordings.outlined_us
    if outlines is None or outlined_us is None:
        return np.full((2, len(windows), 2), np.nan)
    recording = windows.recording
    n_steps = outlines.shape[1] - 1
    lasts_us = np.maximum(outlined_us[recording], 1)  # 0 where the outline is not known
    at = np.clip(times_us / lasts_us, 0, 1) * n_steps
    before = np.minimum(at.astype(np.int64), n_steps - 1)
    share = (at - before)[:, None, None]
    points = (1 - share) * outlines[recording, before] + share * outlines[recording, before + 1]
    moved = np.einsum("nij,npj->npi", matrix[:, :, :2], points) + matrix[:, None, :, 2]
    low = moved.min(axis=1)
    high = moved.max(axis=1)
    return np.stack([(low + high) / 2, high - low])


def _boxes_of_events(windows: Windows, until_us: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The boxes around the events of windows' objects: float64, (2, N, 2).

    Middles (x, y) stand first, then sizes. A box around a single pixel has the size (1, 1). So has
    the box of a window without any event; its middle is (0, 0). Then boxes are moved.

    Parameters
    ----------
    windows : N windows, each on a whole recording, from `Windows.cut`.
    until_us : int64, (N,), in microseconds since a window's start. Only earlier events count.
    matrix : float64, (N, 2, 3), moves each box, see `Draws.matrix`. If a box is turned, the box
        around it counts.
    """
    middles = np.zeros((len(windows), 2))
    sizes = np.ones((len(windows), 2))
    recordings = windows.recordings
    for i, recording in enumerate(windows.recording):
        first, end = recordings.offsets[recording : recording + 2]
        last = first + np.searchsorted(recordings.t[first:end], until_us[i])
        if first < last:
            x_and_y = recordings.x[first:last], recordings.y[first:last]
            sides = np.percentile(x_and_y, OUTER, axis=1)  # (2, 2): lower and upper x and y
            middles[i] = sides.mean(axis=0)
            sizes[i] += sides[1] - sides[0]
    moved = np.einsum("nij,nj->ni", matrix[:, :, :2], middles) + matrix[:, :, 2]
    return np.stack([moved, np.einsum("nij,nj->ni", np.abs(matrix[:, :, :2]), sizes)])
