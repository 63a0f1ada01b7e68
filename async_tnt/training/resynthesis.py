"""Other motions of the windows to train on: made once by several processes, kept in shards beside the run.

    <folder>/motions.json                    how they were made, and how well they match the recordings
    <folder>/training_000000_0.safetensors   windows from 0 on under one random motion each, a shard
    <folder>/training_000000.json            their own paths; written last: these windows are done

Held-out windows are moved once, for validation.
A window whose path was not found is used as it was recorded.
"""

from __future__ import annotations

import contextlib
import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.evaluation.processes import run_all
from async_tnt.events import EVENT_DTYPE
from async_tnt.files import write_text
from async_tnt.progress import Bar, no_progress
from async_tnt.resynthesis import Calibration, MotionPath, Reconstruction, calibrate
from async_tnt.resynthesis.pixels import measure_pixels
from async_tnt.resynthesis.reconstruction import N_PICTURES
from async_tnt.simulation.shards import write_shard
from async_tnt.training.moved_windows import Motions, MotionSettings, read_shards
from async_tnt.training.run_folder import other_run, windows_checksum
from async_tnt.training.windows import Windows

MANIFEST = "motions.json"
N_CALIBRATION, N_SHARED = 128, 200
"""Windows that pixels are calibrated on, and that a shared path is found from."""
MOST_WINDOWS, MOST_EVENTS = 500, 300_000
"""Of a shard, as recorded: their variations are in memory together."""
PARTS = ("training", "held-out")


def resynthesize(
    training: Windows,
    held_out: Windows,
    config: TNTConfig,
    settings: MotionSettings,
    folder: Path,
    *,
    masked: np.ndarray | None = None,
    workers: int = 1,
    progress: Callable[..., Bar] = no_progress,
) -> Motions:
    """Make other motions of all windows, or what is missing of them in the folder.

    The same windows and settings give the same files, for any number of workers.

    Parameters
    ----------
    training, held_out : windows as recorded; the latter may be empty.
    config : of which the sensor and the window's length are used.
    folder : for the shards; made if missing.
    masked : bool, (H, W): pixels whose events are left out, of the recordings already; None: no pixel.
    workers : processes.

    Raises
    ------
    ValueError : windows shorter than 104 us; the folder holds other motions, or a damaged shard; no window's motion
        was found.
    """
    if config.window_us < 2 * N_PICTURES:
        raise ValueError(f"`window_us` must be at least {2 * N_PICTURES} for re-synthesis, got {config.window_us}")
    folder.mkdir(parents=True, exist_ok=True)
    manifest = folder / MANIFEST
    made_from = {
        "sensor": list(config.sensor),
        "window_us": config.window_us,
        "windows": windows_checksum(training, held_out),
        "mask": None if masked is None else zlib.crc32(np.packbits(masked).tobytes()),
        **{name: value for name, value in asdict(settings).items() if name != "recorded"},
    }
    if manifest.exists():
        there = _entry(_read_json(manifest), "made_from", manifest)
        differ = [name for name, value in made_from.items() if there.get(name) != value]
        if differ:
            raise other_run(folder, f"motions ({', '.join(differ)})")
    chunks = _chunks("training", training, config, folder, settings.variations)
    chunks += _chunks("held-out", held_out, config, folder, 1)
    missing = [chunk for chunk in chunks if not chunk.is_done]
    if missing or not manifest.exists():
        reconstruction = Reconstruction(config.sensor, config.window_us)
        shared = _shared_paths(training, reconstruction, settings)
        some = np.sort(np.random.default_rng(settings.seed).permutation(len(training))[:N_CALIBRATION])
        columns = [training.events(i, config.window_us) for i in some]
        known = [shared.get(int(start)) for start in training.start_us[some]]
        calibration = calibrate(reconstruction, columns, settings.seed, known)
        content = {
            "made_from": made_from,
            "pixels": asdict(calibration.pixels),
            "length_px": calibration.length,
            "match": calibration.match,
            "shared_paths": {str(start): path.positions.tolist() for start, path in shared.items()},
        }
        write_text(manifest, json.dumps(content, indent=1) + "\n")
        job = partial(_move, config=config, calibration=calibration, shared=shared, masked=masked, seed=settings.seed)
        n_all, n_missing = (sum(len(chunk.windows) for chunk in some) for some in (chunks, missing))
        with (
            progress(n_all, "re-synthesizing motions", done=n_all - n_missing) as bar,
            contextlib.closing(run_all(job, missing, workers)) as done,
        ):
            for n in done:
                bar.update(n)
    return _open(folder, training, held_out, config, chunks, settings)


@dataclass(frozen=True)
class _Chunk:
    """Windows that one task moves."""

    part: str
    first: int
    windows: Windows
    starts_us: np.ndarray
    window_us: int
    variations: int
    folder: Path

    @property
    def paths_file(self) -> Path:
        return self.folder / f"{self.part}_{self.first:06}.json"

    @property
    def shards(self) -> list[Path]:
        return [self.folder / f"{self.paths_file.stem}_{v}.safetensors" for v in range(self.variations)]

    @property
    def is_done(self) -> bool:
        return all(path.exists() for path in (*self.shards, self.paths_file))

    def __getstate__(self) -> dict[str, Any]:
        """For another process: with the events of these windows instead of all."""
        return {**self.__dict__, "windows": self.windows.cut(self.window_us)}


def _chunks(part: str, windows: Windows, config: TNTConfig, folder: Path, variations: int) -> list[_Chunk]:
    """All windows of a part, those of one shard in each."""
    n_events = sum(len(windows.events(i, config.window_us)[0]) for i in range(len(windows)))
    step = int(np.clip(MOST_EVENTS * len(windows) / max(1, n_events), 1, MOST_WINDOWS))
    chunks = []
    for first in range(0, len(windows), step):
        some = windows[first : first + step]
        chunks.append(_Chunk(part, first, some, some.start_us, config.window_us, variations, folder))
    return chunks


def _shared_paths(windows: Windows, reconstruction: Reconstruction, settings: MotionSettings) -> dict[int, MotionPath]:
    """Start -> the path of the windows that start then; empty where each has its own."""
    if not settings.shared_path:
        return {}
    rng = np.random.default_rng(settings.seed)
    sensor, window_us = reconstruction.model.sensor, reconstruction.model.window_us
    paths = {}
    for start in np.unique(windows.start_us):
        some = rng.permutation(np.flatnonzero(windows.start_us == start))[:N_SHARED]
        columns = [windows.events(i, window_us) for i in some]
        paths[int(start)] = reconstruction.shared_path(columns, measure_pixels(columns, sensor, window_us))
    return paths


def _move(
    chunk: _Chunk,
    *,
    config: TNTConfig,
    calibration: Calibration,
    shared: dict[int, MotionPath],
    masked: np.ndarray | None,
    seed: int,
) -> int:
    """Find the paths and images of a chunk's windows, and write its shards. Returns how many windows it has."""
    windows = chunk.windows
    reconstruction = Reconstruction(config.sensor, config.window_us)
    columns = [windows.events(i, config.window_us) for i in range(len(windows))]
    known = [shared.get(int(start)) for start in chunk.starts_us]
    moved: list[list[np.ndarray]] = [[np.empty(0, EVENT_DTYPE)] * len(windows) for _ in range(chunk.variations)]
    motions = np.zeros((chunk.variations, len(windows), N_PICTURES, 2))
    paths = []
    for i, (path, image) in enumerate(reconstruction(columns, calibration.pixels.measured, known)):
        paths.append(path)
        if image is None:
            continue
        for v in range(chunk.variations):
            rng = generator(seed, chunk.part, chunk.first + i, v)
            one, motions[v, i] = image.moved(calibration.length, calibration.pixels, rng)
            moved[v][i] = one if masked is None else one[~masked[one["y"], one["x"]]]
    picture_us = config.window_us / (N_PICTURES - 1)
    for shard, events, displacement in zip(chunk.shards, moved, motions, strict=True):
        write_shard(
            shard,
            events,
            labels=np.zeros(len(windows), np.uint8),  # the windows have them; a shard holds 256 classes at most
            image=chunk.first + np.arange(len(windows)),
            flow=np.diff(displacement, axis=1) / (picture_us * 1e-6),
            flow_times_us=np.rint((np.arange(N_PICTURES - 1) + 0.5) * picture_us).astype(np.int64),
            sensor=config.sensor,
            duration_us=config.window_us,
        )
    rows = [
        {
            "found": path.found,
            "events": path.n_events,
            "explained": round(path.explained, 4),
            "margin": round(path.margin, 2),
            "evidence": round(path.evidence, 2),
            "positions": path.positions.round(3).tolist(),
        }
        for path in paths
    ]
    write_text(chunk.paths_file, json.dumps(rows))
    return len(windows)


def generator(seed: int, part: str, window: int, variation: int) -> np.random.Generator:
    """The source of all randomness of one window's variation."""
    return np.random.default_rng((seed, PARTS.index(part), variation, window))


def _open(
    folder: Path,
    training: Windows,
    held_out: Windows,
    config: TNTConfig,
    chunks: list[_Chunk],
    settings: MotionSettings,
) -> Motions:
    manifest = folder / MANIFEST
    content = _read_json(manifest)
    found = {part: _column(chunks, part, "found", bool) for part in PARTS}
    moving = np.flatnonzero(found["held-out"])
    moved = read_shards([chunk.shards[0] for chunk in chunks if chunk.part == "held-out"], held_out.labels)
    record = {
        **asdict(settings),
        "windows": len(training),
        "with_path": int(found["training"].sum()),
        "held_out_windows": len(held_out),
        "held_out_with_path": len(moving),
        **{name: _entry(content, name, manifest) for name in ("length_px", "pixels", "match")},
    }
    shards = [chunk.shards for chunk in chunks if chunk.part == "training"]
    return Motions(
        [list(some) for some in zip(*shards, strict=True)],
        training,
        found["training"],
        _column(chunks, "training", "positions", np.float64),
        Windows(moved, moving, np.zeros(len(moving), np.int64)),
        config.window_us,
        settings,
        record,
    )


def _column(chunks: list[_Chunk], part: str, name: str, dtype: Any) -> np.ndarray:
    """One entry of all windows of a part."""
    values = []
    for chunk in chunks:
        if chunk.part == part:
            rows = _read_json(chunk.paths_file)
            if not isinstance(rows, list) or len(rows) != len(chunk.windows):
                raise _damaged(chunk.paths_file, f"expected {len(chunk.windows)} windows")
            values += [_entry(row, name, chunk.paths_file) for row in rows]
    try:
        return np.array(values, dtype)
    except (ValueError, TypeError) as error:
        raise _damaged(chunks[0].folder / MANIFEST, f"{name}: {error}") from None


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise _damaged(path, error) from None


def _entry(content: Any, name: str, path: Path) -> Any:
    if not isinstance(content, dict) or name not in content:
        raise _damaged(path, f"no {name}")
    return content[name]


def _damaged(path: Path, what: object) -> ValueError:
    return ValueError(f"{path}: damaged ({what}). Remove the folder {path.parent} to start again")
