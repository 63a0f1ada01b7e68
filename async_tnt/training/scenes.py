"""Scenes to learn from and to be tested on: windows of several recordings on one large sensor.

Without the transform a volume is a sum over events, so that a scene's volume is the sum of its
recordings' volumes, each at its place, and of noise. Of each scene:

    objects   `OBJECTS` in the mean, the middle of each anywhere on the sensor, so that some are cut
              off at its border, half of them beside another one, at least `APART` from it
    starts    half of them begin later, by up to half a window
    end       as augmentation draws it, the same for all
    nothing   as augmentation draws it: what shows nothing is no object
    noise     `NOISE_HZ` from each pixel, in a third of the scenes also a hot pixel

An object of fewer than `FEWEST` events by then is none yet.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.training.augment import Draws
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.recordings import Recordings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.events import EVENT_DTYPE

SIDES = 3
"""Of a scene, by those of a recording."""
OBJECTS, FEWEST = 2.5, 10
APART = 0.4
"""Of a recording's shorter side: between two objects, at least. One for which `TRIES` places are
nearer is dropped."""
BESIDE = 0.5
"""So many objects are placed beside another one, at most a recording's shorter side away: some
cover each other."""
TRIES = 20
NOISE_HZ, HOT_EVENTS = (0.1, 0.9), (20, 300)
MOST_NOISE = 100_000
"""Events of a scene: a large sensor's would take longer than all else."""
OUTER = 2, 98
"""Percentiles of an object's events until the scene's end: its middle is halfway between them,
whatever noise is farther out."""


@dataclass(frozen=True)
class Scenes:
    """M scenes with K objects.

    Parameters
    ----------
    volumes : float32, (M, C, H, W).
    scene, label : int64, (K,). Of each object.
    position : float64, (K, 2). Of its middle, (x, y) in sensor pixels.
    """

    volumes: np.ndarray
    scene: np.ndarray
    label: np.ndarray
    position: np.ndarray


class SceneMaker:
    """Makes scenes of windows.

    Parameters
    ----------
    config : of the recordings' volumes.

    Attributes
    ----------
    config, crops : of the scenes' volumes, and of the recordings'.

    Raises
    ------
    ValueError : `config` has a transform, or volumes that are no sums over events.
    """

    def __init__(self, config: TNTConfig) -> None:
        if config.transform != "none" or config.representation not in ("volume", "count"):
            raise ValueError(
                "a scene is a sum of volumes: `representation` must be volume or count, and "
                "`transform` none; got "
                f"{config.representation} and {config.transform}"
            )
        larger = {
            name: tuple(SIDES * side for side in getattr(config, name))
            for name in ("sensor", "grid")
        }
        self.config = config.replace(**larger)
        self.crops = config
        self._crops, self._scenes = BatchVolumes(config), BatchVolumes(self.config)
        self._shorter = min(config.sensor)

    def __call__(self, windows: Windows, draws: Draws, rng: np.random.Generator) -> Scenes:
        """Scenes of all these windows, as `rng` draws them."""
        n = len(windows)
        # on recordings of their own: what begins later must not show what came before
        windows = Windows(windows.recordings, windows.recording, windows.start_us + draws.start_us)
        windows = windows.cut(self.config.window_us)
        scene = rng.integers(max(1, round(n / OBJECTS)), size=n)
        n_scenes = int(scene.max()) + 1
        until_us = draws.until_us[rng.integers(n, size=n_scenes)]
        later_us = np.where(
            rng.random(n) < 0.5, rng.integers(0, max(1, self.config.window_us // 2), n), 0
        )
        draws = replace(draws, until_us=until_us[scene], start_us=-later_us)
        own = self._crops(windows, draws)
        is_object = (draws.nothing == SHOWN) & (np.abs(own).sum((1, 2, 3)) >= FEWEST)

        fine = (draws.sensor[0] - 1) / (self.crops.sensor[0] - 1)
        middles = np.einsum(
            "nij,nj->ni", draws.matrix[:, :, :2], _middles(windows, until_us[scene] - later_us)
        )
        middles = (middles + draws.matrix[:, :, 2]) / fine
        volumes = self._noise(n_scenes, until_us, rng)
        position, end = np.full((n, 2), np.inf), np.array(self.config.sensor) - 1.0
        for i in range(n):
            there = position[(scene == scene[i]) & np.isfinite(position[:, 0])]
            is_beside = len(there) > 0 and rng.random() < BESIDE
            for _ in range(TRIES):
                place = rng.uniform(0, end)
                if is_beside:
                    place = there[rng.integers(len(there))] + rng.uniform(-1, 1, 2) * self._shorter
                on_sensor = (place >= 0).all() and (place <= end).all()
                if on_sensor and (np.hypot(*(there - place).T) >= APART * self._shorter).all():
                    position[i] = self._add(volumes[scene[i]], own[i], middles[i], place)
                    break
        is_object &= np.isfinite(position[:, 0])
        return Scenes(volumes, scene[is_object], windows.labels[is_object], position[is_object])

    def _add(
        self, volume: np.ndarray, own: np.ndarray, middle: np.ndarray, place: np.ndarray
    ) -> np.ndarray:
        """Add a recording's volume to a scene's, its middle where a place is, in whole cells.
        Returns that place."""
        scale, in_cells = np.array(self.config.to_grid(1, 1)), middle * self.crops.to_grid(1, 1)
        left, top = np.rint(place * scale - in_cells).astype(int)
        (_, height, width), (_, rows, columns) = volume.shape, own.shape
        y0, y1, x0, x1 = (
            max(0, top),
            min(height, top + rows),
            max(0, left),
            min(width, left + columns),
        )
        if y0 < y1 and x0 < x1:
            volume[:, y0:y1, x0:x1] += own[:, y0 - top : y1 - top, x0 - left : x1 - left]
        found: np.ndarray = (in_cells + np.array([left, top])) / scale
        return found

    def _noise(self, n_scenes: int, until_us: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        width, height = self.config.sensor
        recordings = []
        for until in until_us:
            n = min(rng.poisson(rng.uniform(*NOISE_HZ) * width * height * until / 1e6), MOST_NOISE)
            n_hot = int(rng.integers(*HOT_EVENTS)) if rng.random() < 1 / 3 else 0
            events = np.zeros(n + n_hot, EVENT_DTYPE)
            events["x"], events["y"] = (
                rng.integers(width, size=len(events)),
                rng.integers(height, size=len(events)),
            )
            events["x"][n:], events["y"][n:] = rng.integers(width), rng.integers(height)
            events["p"] = rng.integers(2, size=len(events))
            events["t"] = rng.integers(until, size=len(events))
            recordings.append(events[np.argsort(events["t"], kind="stable")])
        noise = Recordings.from_events(recordings, [0] * n_scenes)
        windows = Windows(noise, np.arange(n_scenes), np.zeros(n_scenes, np.int64))
        return self._scenes(windows).copy()


def _middles(windows: Windows, until_us: np.ndarray) -> np.ndarray:
    """(x, y) of each window's object, of its events before that time, float64, (N, 2); without any,
    of nothing."""
    middles = np.zeros((len(windows), 2))
    for i, (first, end) in enumerate(itertools.pairwise(windows.recordings.offsets)):
        last = first + np.searchsorted(windows.recordings.t[first:end], until_us[i])
        if first < last:
            both = windows.recordings.x[first:last], windows.recordings.y[first:last]
            middles[i] = np.percentile(both, OUTER, axis=1).mean(axis=0)
    return middles
