"""N-MOVING-MNIST: MNIST's digits, each simulated under every motion.

The thesis' set is not published, and the thesis does not name its motions. Ours are in
`motions/kinds.py`. A set is a folder of shards and `set.json`. A shard has up to
`recordings_per_shard` images under one motion. `set.json` records how the shards were made, and is
written first. Every recording has its own random generator, seeded by (seed, index of the motion,
index of the image). So neither the number of workers nor an interruption changes a set.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.files import locked_folder
from async_tnt.base.messages import short
from async_tnt.base.package import __version__, available_cores
from async_tnt.base.progress import progress
from async_tnt.evaluation.processes import run_counted
from async_tnt.simulation.simulator import PixelModel
from experiments.digit_data.mnist import load_mnist
from experiments.motions.kinds import NMNIST_SENSOR, Motion, flow_of, motions_of
from experiments.motions.scene import Scene
from experiments.motions.simulated_digits import simulate_digit
from experiments.moving_set.manifest import MovingMnist, read_manifest, shard_names, write_manifest
from experiments.moving_set.shards import open_shard, write_shard


@dataclass(frozen=True)
class _Job:
    """One shard to make: some images under one motion."""

    path: Path
    motion: Motion
    which: list[int]
    images: np.ndarray
    labels: np.ndarray
    seed: int
    settings: dict[str, Any]  # parameters of `simulate_digit`
    metadata: dict[str, Any]


def build(
    mnist_folder: str | os.PathLike[str],
    out_folder: str | os.PathLike[str],
    *,
    split: str = "test",
    kind: str = "constant",
    which: Sequence[int] | None = None,
    seed: int = 0,
    workers: int | None = None,
    recordings_per_shard: int = 1_000,
    scene: Scene | None = None,
    frame_us: float = 1_000.0,
) -> MovingMnist:
    """Simulate the shards of a set that are missing, and show a progress bar.

    Existing shards are kept, and damaged ones are made again. So an interrupted build resumes when
    it is called again. The same arguments give the same files, for any number of workers.

    Parameters
    ----------
    mnist_folder : folder with MNIST's IDX files.
    out_folder : made if missing.
    split : "train" or "test".
    which : indices of images; all by default.
    kind : kind of motion: "constant", "bell", "constant-from-centre", "bell-from-centre", "beyond"
        (30 motions), or "nmnist" (1).
    workers : number of processes; one per core by default. A script that uses several processes
        needs `if __name__ == "__main__":`.
    scene, frame_us : see `simulate_digit`.

    Raises
    ------
    ValueError : an argument is out of its range, MNIST files are damaged, or the folder holds
        another set.
    OSError : MNIST is missing, the folder cannot be written, or another process makes a set there.
    """
    _check_least("seed", seed, 0)
    _check_least("workers", workers, 1)
    _check_least("recordings_per_shard", recordings_per_shard, 1)
    scene = scene or Scene()
    motions = motions_of(kind)
    images, labels = load_mnist(mnist_folder, split)
    which = list(range(len(images))) if which is None else [int(i) for i in which]
    if not which or not 0 <= min(which) <= max(which) < len(images):
        raise ValueError(
            f"`which` must be indices of the {len(images)} images of split {split!r}, got "
            f"{short(which)}"
        )
    images = images[which]
    labels = labels[which]

    # `shared` stands in every shard, `parameters` in the manifest
    shared = {
        "split": split,
        "seed": int(seed),
        "sensor": list(NMNIST_SENSOR),
        "simulator": {
            "pixels": dataclasses.asdict(PixelModel()),
            "scene": dataclasses.asdict(scene),
            "frame_us": float(frame_us),
        },
        "package_version": __version__,
    }
    parameters = {
        "kind": kind,
        "images": which,
        **shared,
        "recordings_per_shard": int(recordings_per_shard),
        "mnist_sha256": hashlib.sha256(images.tobytes() + labels.tobytes()).hexdigest(),
    }

    folder = Path(out_folder)
    names = shard_names(motions, len(which), recordings_per_shard)
    firsts = range(0, len(which), recordings_per_shard)
    jobs = []
    for name, (motion, first) in zip(names, itertools.product(motions, firsts), strict=True):
        in_shard = slice(first, first + recordings_per_shard)
        jobs.append(
            _Job(
                path=folder / name,
                motion=motion,
                which=which[in_shard],
                images=images[in_shard],
                labels=labels[in_shard],
                seed=seed,
                settings={"scene": scene, "frame_us": frame_us},
                metadata={"motion": dataclasses.asdict(motion), **shared},
            )
        )
    moving_set = MovingMnist(folder, tuple(job.path for job in jobs), motions, parameters)
    _make_missing(moving_set, jobs, workers or available_cores())
    return moving_set


def _check_least(name: str, n: int | None, least: int) -> None:
    if n is not None and n < least:
        raise ValueError(f"`{name}` must be at least {least}, got {n}")


def _make_missing(moving_set: MovingMnist, jobs: list[_Job], workers: int) -> None:
    """Write the manifest, and the shards that are missing or damaged."""
    with locked_folder(moving_set.folder, "set.lock"):
        write_manifest(moving_set)
        to_do = [job for job in jobs if not _is_done(job.path)]
        n_done = len(moving_set) - sum(len(job.images) for job in to_do)
        bar = progress(len(moving_set), "simulating", done=n_done)
        run_counted(_make_shard, to_do, workers, bar)


def open_set(folder: str | os.PathLike[str]) -> MovingMnist:
    """Open a set that `build` made: a folder with `set.json` and the shards.

    Raises
    ------
    ValueError : shards are missing (the message has the command to resume), the folder holds no
        set, or `set.json` is damaged.
    OSError : the folder or `set.json` is missing or not readable.
    """
    folder = Path(folder)
    moving_set = read_manifest(folder)
    missing = sum(not path.is_file() for path in moving_set.shards)
    if missing:
        parameters = moving_set.parameters
        bright_option = (
            "" if parameters["simulator"]["scene"]["dark_on_bright"] else " --bright-on-dark"
        )
        raise ValueError(
            f"{folder}: {missing} of {len(moving_set.shards)} shards are missing. Resume with: "
            f"python -m experiments.moving_mnist --mnist MNIST --out {folder} "
            f"--split {parameters['split']} --motions {parameters['kind']} "
            f"--digits {len(parameters['images'])} --seed {parameters['seed']}{bright_option}, "
            "or by `build` with the parameters in set.json"
        )
    return moving_set


def _make_shard(job: _Job) -> int:
    """Simulate and write one shard; returns its number of recordings."""
    duration_us = job.motion.duration_us
    times_us = job.motion.flow_times_us
    recordings = []
    flow = np.empty((len(job.images), len(times_us), 2))
    height, width = job.images.shape[1:]
    for i, (index, image) in enumerate(zip(job.which, job.images, strict=True)):
        rng = np.random.default_rng((job.seed, job.motion.index, index))
        trajectory = job.motion.trajectory(rng, image=(width, height), sensor=NMNIST_SENSOR)
        flow[i] = flow_of(trajectory, times_us)
        events = simulate_digit(image, rng, trajectory=trajectory, **job.settings)
        # Events of the last half microsecond are rounded up to `duration_us`, which is outside.
        recordings.append(events[events["t"] < duration_us])
    write_shard(
        job.path,
        recordings,
        labels=job.labels,
        image=np.array(job.which),
        flow=flow,
        flow_times_us=times_us,
        sensor=NMNIST_SENSOR,
        duration_us=duration_us,
        metadata=job.metadata,
    )
    return len(recordings)


def _is_done(path: Path) -> bool:
    """Whether the shard exists and is not damaged."""
    try:
        open_shard(path)
    except (FileNotFoundError, ValueError):
        return False
    return True
