"""Make windows under other motions, from the windows to train on and from the held-out windows.

Several processes make them once. They are kept in files beside the run.

    <folder>/motions.json          how they were made, and how well they match the recordings
    <folder>/training_000000.npz   windows from number 0 on under other motions, see `moved_windows`
    <folder>/held-out_000000.npz   held-out windows from number 0 on, each under one other motion

A training window whose path was not found is used as it was recorded.
"""

from __future__ import annotations

import json
import math
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError, real_number, whole_number
from async_tnt.base.files import read_regular, write_text
from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line, short
from async_tnt.base.progress import Bar
from async_tnt.evaluation.processes import run_counted
from async_tnt.resynthesis.calibration import Calibration, calibrate
from async_tnt.resynthesis.moving_image import N_FRAMES, cell_for
from async_tnt.resynthesis.paths import MotionPath
from async_tnt.resynthesis.reconstruction import (
    N_PICTURES,
    Reconstruction,
    SimulatedPixels,
    shares,
)
from async_tnt.simulation.measured_pixels import MeasuredPixels, part_of
from async_tnt.training.moved_windows import (
    Motions,
    MotionSettings,
    damaged,
    moved_recordings,
    read_arrays,
    write_moved,
)
from async_tnt.training.run_folder import other_run, windows_checksum
from async_tnt.training.windows import Windows
from async_tnt.views.figure_resynthesis import RefusedWindow, ResynthesizedWindow
from async_tnt.volume.config import MAX_SIDE, TNTConfig
from async_tnt.volume.events import EVENT_DTYPE, structured

MANIFEST = "motions.json"
"""The file that says how motions were made."""
N_CALIBRATION = 128
"""Number of windows on which pixels are calibrated."""
MOST_WINDOWS = 500
"""Most windows of a file. All variations of these windows are in memory together."""
MOST_EVENTS = 300_000
"""Most recorded events of a file's windows, about. It limits the memory, too."""
PARTS = ("training", "held-out")
"""Names of the windows to train on, and of the windows to validate on."""

N_EXAMPLES = 5
"""Number of windows that a figure shows."""
N_OTHERS = 4
"""Number of other motions that a figure shows of each window."""
N_REFUSED = 2
"""Number of reasons, each with a window without a path, that a figure shows."""


def resynthesize(
    training: Windows,
    held_out: Windows,
    config: TNTConfig,
    settings: MotionSettings,
    folder: Path,
    *,
    masked: np.ndarray | None = None,
    workers: int = 1,
    progress: Callable[..., Bar] = Bar,
) -> Motions:
    """Make other motions of all windows. Files that are already in the folder are not made again.

    The same windows and settings give the same files, for any number of workers.

    Parameters
    ----------
    training, held_out : windows as recorded; `held_out` may be empty.
    config : how events become volumes; only its sensor and the window's length are used.
    settings : how many motions are made.
    folder : the folder of the files; made if missing.
    masked : bool, (H, W): pixels whose events are left out, as they were left out of the
        recordings; None: no pixel is left out.
    workers : number of processes.
    progress : makes the progress bar, which counts windows.

    Raises
    ------
    ValueError : windows are shorter than 104 us, or slide; the folder holds other motions, or a
        damaged file; no window's motion was found.
    """
    if config.slides:
        raise ParameterValueError("config", "must have windows with a start for re-synthesis")
    if config.window_us < 2 * N_PICTURES:
        raise ParameterValueError(
            "window_us", f"must be at least {2 * N_PICTURES} for re-synthesis", config.window_us
        )
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
        stored = _read_manifest(manifest)["made_from"]
        differ = [name for name, value in made_from.items() if stored.get(name) != value]
        if differ:
            raise other_run(folder, f"motions ({', '.join(differ)})")
    chunks = _chunks("training", training, config, folder, settings.variations)
    chunks += _chunks("held-out", held_out, config, folder, 1)
    missing = [chunk for chunk in chunks if not chunk.file.exists()]
    if missing or not manifest.exists():
        cell, calibration = _calibrated(training, config, settings.seed)
        content = {
            "made_from": made_from,
            "pixels": asdict(calibration.pixels),
            "cell": cell,
            "length_px": calibration.length,
            "match": calibration.match,
        }
        write_text(manifest, json.dumps(content, indent=1) + "\n")
        job = partial(
            _move,
            config=config,
            cell=cell,
            calibration=calibration,
            masked=masked,
            seed=settings.seed,
        )
        n_all = sum(len(chunk.windows) for chunk in chunks)
        n_missing = sum(len(chunk.windows) for chunk in missing)
        bar = progress(n_all, "re-synthesizing motions", done=n_all - n_missing)
        run_counted(job, missing, workers, bar)
    return _open(folder, training, held_out, config, chunks, settings)


def _calibrated(training: Windows, config: TNTConfig, seed: int) -> tuple[int, Calibration]:
    """Choose the side of a cell, in pixels, and calibrate re-synthesis. Both use some windows."""
    order = np.random.default_rng(seed).permutation(len(training))
    chosen = np.sort(order[:N_CALIBRATION])
    around_us = config.window_us * training.neighbours(config.window_us)
    columns = [training.events(i, config.window_us, around_us[i]) for i in chosen]
    cell = cell_for(columns, config.sensor)
    reconstruction = Reconstruction(config.sensor, config.window_us, cell)
    return cell, calibrate(reconstruction, columns, seed)


@dataclass(frozen=True)
class _Chunk:
    """The windows that one task re-synthesizes under other motions.

    Parameters
    ----------
    part : one of `PARTS`.
    first : number of the first window in its part.
    windows : the windows, as recorded.
    around_us : int64, (N, 2): the durations before and after each window, in microseconds, from
        which events may be used, too.
    window_us : length of a window.
    variations : number of other motions of each window.
    file : the file that the moved windows are written to.
    """

    part: str
    first: int
    windows: Windows
    around_us: np.ndarray
    window_us: int
    variations: int
    file: Path

    def __getstate__(self) -> dict[str, Any]:
        """The state that is sent to another process.

        It holds the events of these windows and their neighbours, not the events of all recordings.
        """
        margin_us = int(self.around_us.max(initial=0))
        return {**self.__dict__, "windows": self.windows.cut(self.window_us, margin_us)}


def _chunks(
    part: str, windows: Windows, config: TNTConfig, folder: Path, variations: int
) -> list[_Chunk]:
    """Divide the windows of a part into chunks, one for each file."""
    n_events = sum(len(windows.events(i, config.window_us)[0]) for i in range(len(windows)))
    # the number of windows that have about `MOST_EVENTS` events
    size = int(np.clip(MOST_EVENTS * len(windows) / max(1, n_events), 1, MOST_WINDOWS))
    around_us = config.window_us * windows.neighbours(config.window_us)
    chunks = []
    for first in range(0, len(windows), size):
        part_of_windows = slice(first, first + size)
        chunk = _Chunk(
            part=part,
            first=first,
            windows=windows[part_of_windows],
            around_us=around_us[part_of_windows],
            window_us=config.window_us,
            variations=variations,
            file=folder / f"{part}_{first:06}.npz",
        )
        chunks.append(chunk)
    return chunks


def _move(
    chunk: _Chunk,
    *,
    config: TNTConfig,
    cell: int,
    calibration: Calibration,
    masked: np.ndarray | None,
    seed: int,
) -> int:
    """Find the paths and images of a chunk's windows, move the images, and write the chunk's file.

    Returns the number of windows in the chunk.
    """
    windows = chunk.windows
    reconstruction = Reconstruction(config.sensor, config.window_us, cell)
    columns = [
        windows.events(i, config.window_us, around_us)
        for i, around_us in enumerate(chunk.around_us)
    ]
    # the events of each variation of each window; none if the window's path was not found
    variations: list[list[np.ndarray]] = [
        [np.empty(0, EVENT_DTYPE)] * len(windows) for _ in range(chunk.variations)
    ]
    paths = []
    for i, (path, image) in enumerate(reconstruction(columns, calibration.pixels.measured)):
        paths.append(path)
        if image is None:
            continue
        for v in range(chunk.variations):
            rng = _generator(seed, chunk.part, chunk.first + i, v)
            events, _ = image.moved(calibration.length, calibration.pixels, rng)
            if masked is not None:
                events = events[~masked[events["y"], events["x"]]]
            variations[v][i] = events
    write_moved(chunk.file, variations, paths, config.window_us)
    return len(windows)


def _generator(seed: int, part: str, window: int, variation: int) -> np.random.Generator:
    """The random generator for one variation of one window."""
    return np.random.default_rng((seed, PARTS.index(part), variation, window))


def _open(
    folder: Path,
    training: Windows,
    held_out: Windows,
    config: TNTConfig,
    chunks: list[_Chunk],
    settings: MotionSettings,
) -> Motions:
    """Read the motions that a folder holds."""
    manifest = _read_manifest(folder / MANIFEST)
    files = {part: [chunk.file for chunk in chunks if chunk.part == part] for part in PARTS}
    refused, spans, paths = _paths(files["training"])
    _, held_out_spans, _ = _paths(files["held-out"])
    with_path = np.flatnonzero(held_out_spans)
    held_out_recordings = moved_recordings(files["held-out"], 0, held_out.labels, config)
    record = {
        **asdict(settings),
        "windows": len(training),
        "with_path": int((spans > 0).sum()),
        "with_neighbours": int((spans > 1).sum()),
        "without_path": dict(Counter(refused[spans == 0].tolist()).most_common()),
        "held_out_windows": len(held_out),
        "held_out_with_path": len(with_path),
        **{name: manifest[name] for name in ("cell", "length_px", "pixels", "match")},
    }
    validation = Windows(held_out_recordings, with_path, np.zeros(len(with_path), np.int64))
    return Motions(
        files["training"], training, refused, spans, paths, validation, config, settings, record
    )


def _paths(files: list[Path]) -> tuple[np.ndarray, ...]:
    """Read `refused`, `spans` and `positions` of all windows from files, see `moved_windows`."""
    # an empty part first, because there may be no file
    parts = [(np.empty(0, "<U1"), np.empty(0, np.int64), np.empty((0, N_FRAMES, 2)))]
    for path in files:
        refused, spans, positions = read_arrays(path, "refused", "spans", "positions")
        n = refused.size
        shapes = refused.shape, spans.shape, positions.shape
        has_types = refused.dtype.kind == "U" and spans.dtype == np.int64
        if not has_types or shapes != ((n,), (n,), (n, N_FRAMES, 2)):
            raise damaged(path, f"`refused`, `spans` and `positions` have shapes {shapes}")
        parts.append((refused, spans, positions))
    return tuple(map(np.concatenate, zip(*parts, strict=True)))


def _read_manifest(path: Path) -> dict[str, Any]:
    """Read how motions were made. A damaged file is a ValueError."""
    names = ("made_from", "cell", "length_px", "pixels", "match")
    try:
        content = parse_json(read_regular(path))
        manifest = {name: content[name] for name in names}
        _check_manifest(manifest)
        return {**manifest, "made_from": dict(manifest["made_from"])}
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise damaged(path, one_line(error)) from None


def _check_manifest(manifest: Mapping[str, Any]) -> None:
    """Refuse a manifest with values of a wrong type, or outside of their range.

    Raises
    ------
    ValueError, LookupError, TypeError, AttributeError : a value is wrong or missing.
    """
    whole_number("cell", manifest["cell"], 1, MAX_SIDE + 1)
    if not 0 <= real_number("length_px", manifest["length_px"]) < math.inf:
        raise ValueError(
            f"`length_px` must be finite and at least 0, got {short(manifest['length_px'])}"
        )
    pixels = manifest["pixels"]
    numbers = {name: real_number(name, value) for name, value in pixels["measured"].items()}
    simulated = SimulatedPixels(MeasuredPixels(**numbers), real_number("scale", pixels["scale"]))
    simulated.draw(np.random.default_rng(0))  # refuses pixels that no sensor has
    recorded = manifest["match"]["recorded"]
    resynthesized = manifest["match"]["resynthesized"]
    if recorded.keys() != resynthesized.keys():
        raise ValueError("`recorded` and `resynthesized` in `match` must have the same names")
    for name in recorded:
        real_number(name, recorded[name])
        real_number(name, resynthesized[name])


def examples(
    motions: Motions, classes: tuple[str, ...]
) -> tuple[list[ResynthesizedWindow], list[RefusedWindow]]:
    """Choose windows for a figure.

    Returns
    -------
    shown : windows of different classes, at most `N_EXAMPLES`, with their first variations. The
        variations are simulated again.
    refused : for each of the most frequent reasons why a path was not found, a window.
    """
    training = motions.training
    window_us = motions.config.window_us
    with_path = np.flatnonzero(motions.spans)  # a window without a path has span 0
    labels, firsts = np.unique(training.labels[with_path], return_index=True)
    # Choose classes that are spread evenly over all classes, and of each its first window with a
    # path.
    spread = np.linspace(0, len(labels) - 1, N_EXAMPLES).round().astype(int)
    chosen = with_path[firsts[np.unique(spread)]]
    reconstruction = Reconstruction(motions.config.sensor, window_us, motions.record["cell"])
    # Events are also taken from the window before and from the window after, where these are among
    # our windows: `neighbours` is 0 or 1 for each side.
    around_us = window_us * training.neighbours(window_us)
    shown = [
        _example(motions, reconstruction, int(i), around_us[i].tolist(), classes) for i in chosen
    ]
    refused = []
    # the reasons are in the order of their frequency
    for reason in list(motions.record["without_path"])[:N_REFUSED]:
        i = int(np.flatnonzero(motions.refused == reason)[0])
        events = structured(training.events(i, window_us))
        refused.append(RefusedWindow(classes[training.labels[i]], events, reason))
    return shown, refused


def _example(
    motions: Motions,
    reconstruction: Reconstruction,
    i: int,
    around_us: Sequence[int],
    classes: tuple[str, ...],
) -> ResynthesizedWindow:
    """Window `i`, as recorded, and under at most `N_OTHERS` other motions, the first ones."""
    measured = MeasuredPixels(**motions.record["pixels"]["measured"])
    pixels = SimulatedPixels(measured, motions.record["pixels"]["scale"])
    columns = motions.training.events(i, motions.config.window_us, around_us)
    path = MotionPath(motions.paths[i], span=int(motions.spans[i]))
    image = reconstruction.image(columns, measured, path)
    displacement = path.at(shares())
    # the image's displacement at about half time, since the path's start: (1, 2)
    middle = len(displacement) // 2
    halfway = path.window_start + displacement[middle : middle + 1]
    seed = motions.settings.seed
    other_paths = []
    other_events = []
    for v in range(min(N_OTHERS, motions.settings.variations)):
        rng = _generator(seed, "training", i, v)
        events, motion = image.moved(motions.record["length_px"], pixels, rng)
        other_events.append(events)
        other_paths.append(motion)
    return ResynthesizedWindow(
        classes[motions.training.labels[i]],
        structured(part_of(columns, motions.config.window_us)),
        image.picture.frames(halfway)[0],
        image.as_recorded(pixels, np.random.default_rng(seed)),
        [displacement, *other_paths],
        other_events,
    )
