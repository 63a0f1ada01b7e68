"""Accuracies of models on simulated windows of MNIST's test images.

The windows have motions, lights and speeds that N-MNIST does not have:

motions   the 30 motions of N-MOVING-MNIST, with dark digits and with bright digits
speeds    N-MNIST's own three saccades at a quarter to four times their speed; the windows are as
          much shorter as the speed is higher
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from async_tnt import Model
from async_tnt.base.progress import progress
from async_tnt.training.evaluation import class_probabilities
from async_tnt.training.pipeline import pipeline_of
from async_tnt.training.recordings import RecordingsWriter
from async_tnt.training.windows import Windows, make_windows
from experiments.digit_data.recordings import SACCADE_US
from experiments.motions.kinds import motions_of
from experiments.motions.scene import Scene
from experiments.motions.simulated_digits import simulate_digit
from experiments.motions.trajectories import Saccades, Trajectory, nmnist_saccades

SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Speeds of saccades, as factors of the speed of N-MNIST's saccades."""


@dataclass(frozen=True)
class Faster:
    """The motion along `path` at `speed` times its speed."""

    path: Saccades
    speed: float

    @property
    def duration_us(self) -> int:
        return round(self.path.duration_us / self.speed)

    def position(self, t_us: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        return self.path.position(self.speed * np.asarray(t_us, np.float64))


def accuracies(
    models: Sequence[Model], images: np.ndarray, labels: np.ndarray
) -> dict[str, dict[str, list[float]]]:
    """Test -> motion or speed -> share of windows that each model has right.

    Parameters
    ----------
    images, labels : the test images of MNIST and their labels.
    """
    shares_by_test: dict[str, dict[str, list[float]]] = {}
    with progress(2 * len(motions_of()) + len(SPEEDS), "digits in other motions") as bar:
        for test, case, windows, window_us in _windows(images, labels):
            shares_right = []
            for model in models:
                config = model.config.replace(window_us=window_us)
                pipeline = pipeline_of(replace(model, config=config))
                decided_classes = class_probabilities(pipeline, windows).argmax(1)
                shares_right.append(float((decided_classes == windows.labels).mean()))
            shares_by_test.setdefault(test, {})[case] = shares_right
            bar.update()
    return shares_by_test


def _windows(images: np.ndarray, labels: np.ndarray) -> Iterator[tuple[str, str, Windows, int]]:
    """All cases as (test, case, windows, length of a window in us).

    A case is a motion or a speed.
    """
    for test, scene in (
        ("dark on bright", Scene()),
        ("bright on dark", Scene(dark_on_bright=False)),
    ):
        for motion in motions_of():
            rngs = [np.random.default_rng((motion.index, i)) for i in range(len(images))]
            paths = [motion.trajectory(rng) for rng in rngs]
            yield test, motion.name, _simulated(images, labels, rngs, paths, scene, 1.0), SACCADE_US
    for k, speed in enumerate(SPEEDS):
        rngs = [np.random.default_rng((1_000 + k, i)) for i in range(len(images))]
        faster = [Faster(nmnist_saccades(rng), speed) for rng in rngs]
        windows = _simulated(images, labels, rngs, faster, Scene(), speed)
        yield "speeds", f"{speed:g}", windows, round(SACCADE_US / speed)


def _simulated(
    images: np.ndarray,
    labels: np.ndarray,
    rngs: Sequence[np.random.Generator],
    paths: Sequence[Trajectory],
    scene: Scene,
    speed: float,
) -> Windows:
    """The windows of simulated recordings: one image along each path, with its generator."""
    with RecordingsWriter() as writer:
        for i, (image, rng, path) in enumerate(zip(images, rngs, paths, strict=True)):
            events = simulate_digit(
                image, rng, trajectory=path, scene=scene, frame_us=1_000 / speed
            )
            writer.add(events[events["t"] < path.duration_us], int(labels[i]), str(i))
        recordings = writer.finish()
    window_us = round(SACCADE_US / speed)
    n_windows = max(1, round(paths[0].duration_us / window_us))
    return make_windows(recordings, window_us, duration_us=n_windows * window_us)
