"""The motions of N-MOVING-MNIST, seen by the pixels of v2e, a simulator that is not ours.

What the sensor looks at is the same as in our sets: the same images, motions and scene (`Scene`).
Only the pixels are other ones: those of v2e (Y. Hu, S. C. Liu and T. Delbruck 2021,
arXiv:2006.07722), with the settings that its command line has by default. None of them was fitted
to a recording of ours. v2e is not part of this repository: its checkout is given as a folder.

Pixels of v2e do not influence each other, so all images stand side by side on one large sensor.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import itertools
import logging
import math
import subprocess
import sys
import types
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.volume.events import structured
from experiments.digit_data.mnist import load_mnist
from experiments.motions.kinds import NMNIST_SENSOR, Motion, flow_of, motions_of
from experiments.motions.scene import Scene, render
from experiments.moving_set.manifest import MovingMnist, shard_names, write_manifest
from experiments.moving_set.shards import write_shard

SETTINGS = {
    "pos_thres": 0.2,
    "neg_thres": 0.2,
    "sigma_thres": 0.03,
    "cutoff_hz": 300.0,
    "leak_rate_hz": 0.01,
    "shot_noise_rate_hz": 0.001,
    "refractory_period_s": 0.0005,
    "leak_jitter_fraction": 0.1,
    "noise_rate_cov_decades": 0.1,
}
"""Settings of v2e's pixels: the defaults of its command line."""

FRAME_US = 150.0
"""Time between two frames that v2e sees, in microseconds.

v2e warns of frames that are apart by more than .3 of the time constant of its low-pass, 531 us."""

WHITE = 255.0
"""Value of the brightest pixel in v2e's frames."""

UNUSED = (
    "cv2",
    "h5py",
    "screeninfo",
    "easygui",
    "tkinter",
    "tkinter.filedialog",
    "engineering_notation",
    "dv_processing",
)
"""Modules that v2e's emulator imports for windows and files, which no simulation needs."""

USED_NAMES = {
    "screeninfo": ("get_monitors",),
    "tkinter": ("filedialog",),
    "engineering_notation": ("EngNumber",),
}
"""Module of `UNUSED` -> names that are imported from it."""


@contextlib.contextmanager
def _v2e(folder: Path) -> Iterator[Any]:
    """The class `EventEmulator` of the checkout of v2e in `folder`.

    Raises
    ------
    FileNotFoundError : the folder has no emulator.
    """
    if not (folder / "v2ecore" / "emulator.py").is_file():
        raise FileNotFoundError(
            f"{folder}: no v2ecore/emulator.py in it; expected a checkout of "
            "https://github.com/SensorsINI/v2e"
        )
    before = {name: sys.modules.get(name) for name in UNUSED}
    for name in UNUSED:
        stand_in = types.ModuleType(name)
        for used_name in USED_NAMES.get(name, ()):
            setattr(stand_in, used_name, None)
        sys.modules[name] = stand_in
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("v2ecore.emulator").EventEmulator
    finally:
        sys.path.remove(str(folder))
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def build_foreign(
    v2e: Path,
    mnist_folder: Path,
    out_folder: Path,
    *,
    which: Sequence[int],
    kind: str = "constant",
    scene: Scene | None = None,
    seed: int = 0,
) -> MovingMnist:
    """Simulate test images of MNIST under the motions of a kind, with the pixels of v2e.

    Shards that exist are kept, so an interrupted build resumes when it is called again.

    Parameters
    ----------
    v2e : a checkout of v2e.
    mnist_folder : folder with MNIST's IDX files.
    out_folder : made if missing.
    which : indices of test images.

    Raises
    ------
    FileNotFoundError : the checkout or MNIST is missing.
    ValueError : the folder holds another set.
    """
    scene = scene or Scene()
    motions = motions_of(kind)
    images, labels = load_mnist(mnist_folder, "test")
    images = images[list(which)]
    labels = labels[list(which)]
    shared = {
        "split": "test",
        "seed": seed,
        "sensor": list(NMNIST_SENSOR),
        "simulator": {
            "v2e": _commit(v2e),
            "pixels": SETTINGS,
            "scene": dataclasses.asdict(scene),
            "frame_us": FRAME_US,
        },
    }
    parameters = {
        "kind": kind,
        "images": [int(i) for i in which],
        **shared,
        "recordings_per_shard": len(images),
        "mnist_sha256": hashlib.sha256(images.tobytes() + labels.tobytes()).hexdigest(),
    }
    names = shard_names(motions, len(images), len(images))
    shards = tuple(out_folder / name for name in names)
    moving_set = MovingMnist(out_folder, shards, motions, parameters)
    out_folder.mkdir(parents=True, exist_ok=True)
    write_manifest(moving_set)
    # it warns of every frame without events
    logging.getLogger("v2ecore").setLevel(logging.ERROR)
    with _v2e(v2e) as emulator_class, progress(len(motions), "simulating with v2e") as bar:
        for motion, path in zip(motions, shards, strict=True):
            if not path.exists():
                # v2e seeds its random generators only if the seed is not 0
                emulator = emulator_class(**SETTINGS, seed=1 + seed + motion.index, device="cpu")
                recordings, flow = _simulated(emulator, motion, images, scene)
                write_shard(
                    path,
                    recordings,
                    labels=labels,
                    image=np.array(which),
                    flow=flow,
                    flow_times_us=motion.flow_times_us,
                    sensor=NMNIST_SENSOR,
                    duration_us=motion.duration_us,
                    metadata={"motion": dataclasses.asdict(motion), **shared},
                )
            bar.update()
    return moving_set


def _commit(folder: Path) -> str:
    """The commit of a checkout; "unknown" without git."""
    try:
        process = subprocess.run(
            ["git", "-C", str(folder), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return process.stdout.strip()


def _simulated(
    emulator: Any, motion: Motion, images: np.ndarray, scene: Scene
) -> tuple[list[np.ndarray], np.ndarray]:
    """The events of each image under a motion, and its optical flow at `motion.flow_times_us`."""
    width, height = NMNIST_SENSOR
    n_columns = math.ceil(math.sqrt(len(images)))
    n_rows = math.ceil(len(images) / n_columns)
    times_us = np.arange(0.0, motion.duration_us + FRAME_US / 2, FRAME_US)
    # all images side by side, with a luminance of `WHITE` where none is
    frames = np.full((len(times_us), n_rows * height, n_columns * width), WHITE, np.float32)
    flow = np.empty((len(images), len(motion.flow_times_us), 2))
    for i, image in enumerate(images):
        # the generator has no influence: only the delays of N-MNIST's own saccades are drawn
        trajectory = motion.trajectory(np.random.default_rng(0), image=image.shape[::-1])
        flow[i] = flow_of(trajectory, motion.flow_times_us)
        luminance = np.exp(render(image, *trajectory.position(times_us), scene=scene))
        row, column = divmod(i, n_columns)
        y = slice(row * height, (row + 1) * height)
        x = slice(column * width, (column + 1) * width)
        frames[:, y, x] = WHITE * luminance
    parts = [np.empty((0, 4))]
    for time_us, frame in zip(times_us, frames, strict=True):
        events = emulator.generate_events(frame, time_us / 1e6)
        if events is not None:
            parts.append(events)
    return _by_image(np.concatenate(parts), motion.duration_us, n_columns, len(images)), flow


def _by_image(
    events: np.ndarray, duration_us: int, n_columns: int, n_images: int
) -> list[np.ndarray]:
    """The events of each image, in order of time.

    events : rows (t in seconds, x, y, +1 or -1) on the large sensor.
    """
    width, height = NMNIST_SENSOR
    t = np.rint(1e6 * events[:, 0]).astype(np.int64)
    x = events[:, 1].astype(np.int64)
    y = events[:, 2].astype(np.int64)
    image = y // height * n_columns + x // width
    columns = (t, x % width, y % height, events[:, 3] > 0)
    is_inside = (t >= 0) & (t < duration_us)  # the last frame is at the end, which is outside
    order = np.lexsort((t, image))
    order = order[is_inside[order]]
    ends = np.searchsorted(image[order], np.arange(n_images + 1))
    recordings = []
    for first, last in itertools.pairwise(ends):
        recordings.append(structured([column[order[first:last]] for column in columns]))
    return recordings
