"""Simulated recordings of a data set's pictures.

Several processes simulate the recordings, which are kept in files beside the run.

    <folder>/pictures.json          what the recordings are made of
    <folder>/training_000000.npz    recordings from number 0 on. The recordings of a picture follow
                                    each other

Each picture is recorded several times, each time by another camera and in another motion, see
`picture_scene`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from async_tnt.base.files import read_regular, replacing, write_text
from async_tnt.base.json_text import parse_json
from async_tnt.base.messages import one_line
from async_tnt.base.progress import Bar
from async_tnt.evaluation.processes import run_counted
from async_tnt.simulation.measured_pixels import MeasuredPixels, measure_pixels
from async_tnt.simulation.outlines import MOMENTS, POINTS
from async_tnt.simulation.picture_scene import (
    PictureRecording,
    SceneSettings,
    record_picture,
)
from async_tnt.simulation.pictures import SUFFIXES, read_picture
from async_tnt.sources.files.labelled_recordings import class_folders, find_recordings
from async_tnt.sources.files.recording import open_recording
from async_tnt.training.moved_windows import read_arrays
from async_tnt.training.recordings import COLUMNS, Recordings, RecordingsWriter
from async_tnt.training.run_folder import other_run
from async_tnt.training.work import Work
from async_tnt.volume.events import structured

MANIFEST = "pictures.json"
FORMAT = 5
"""Version of the recordings. It grows by 1 with each change of what is simulated."""

RECORDINGS = {"training": 24_000, "held-out": 2_400}
"""Number of recordings of all pictures together, for a sensor that stands still and has at most
`FULL_PIXELS`. A larger sensor, or one that follows the object, takes longer to simulate. So it has
fewer recordings."""
LEAST_TAKES = {"training": 2, "held-out": 1}
"""Least number of recordings of each picture."""
MOST_TAKES = 200
"""Largest number of recordings of each picture."""
FULL_PIXELS = 128 * 128
"""Most pixels of a sensor that has all of `RECORDINGS`. The number of recordings of a larger sensor
is in inverse proportion to its number of pixels."""
FOLLOWED = 6
"""Average factor by which a simulation takes longer if the sensor follows the object. Each pixel of
such a sensor counts this many times."""
CUT_OUT = 0.25
"""Average share of the pixels that are simulated, of a sensor that is cut out around objects of any
size."""
LEAST_SHARE = 0.1
"""Least share of `RECORDINGS` that a sensor has, however large it is."""
CHUNK = 200
"""Number of recordings in a file. A process has their events in memory together. So a large sensor,
which has fewer recordings than `RECORDINGS`, has fewer in a file, too."""

LONGEST_PAUSE = 100
"""Longest gap between events, in windows, in which the camera counts as switched on."""

N_EXAMPLES = 5
"""Number of classes that a figure shows."""
N_TAKES = 6
"""Number of recordings that a figure shows of each class."""


@dataclass(frozen=True)
class LabelledPicture:
    """A picture file of one class.

    Parameters
    ----------
    path : the file.
    label : index of its class.
    """

    path: Path
    label: int

    @property
    def name(self) -> str:
        """Class folder and file, for messages and reports."""
        return f"{self.path.parent.name}/{self.path.name}"


def find_pictures(folder: Path) -> dict[str, list[Path]]:
    """Find the pictures to train on: class name -> picture files, sorted by name.

    Classes without pictures are left out.

    Raises
    ------
    ValueError, OSError : as `find_recordings`; a class has pictures, and the folder has sessions.
    """
    recordings = find_recordings(folder, "Train")
    pictures_of_class = {}
    for class_folder in class_folders(folder):
        pictures = [path for path in sorted(class_folder.glob("[!.]*")) if _is_picture(path)]
        if pictures:
            pictures_of_class[class_folder.name] = pictures

    sessions = []
    for parts in recordings.values():
        sessions += [part.path.name for part in parts if part.between_us]
    if not sessions:
        return pictures_of_class
    # In a folder of sessions, a folder without the name of a class may hold figures. It is ignored.
    in_both = recordings.keys() & pictures_of_class
    if in_both:
        picture = pictures_of_class[min(in_both)][0].relative_to(folder)
        raise ValueError(
            f"{folder}: expected pictures or sessions, got both: {picture} and {sessions[0]}"
        )
    return {}


def _is_picture(path: Path) -> bool:
    """Whether the file has a picture's suffix. A broken link is reported later, when it is read."""
    return path.suffix.lower() in SUFFIXES and (path.is_file() or path.is_symlink())


def check_pictures(
    pictures_of_class: Mapping[str, Sequence[Path]],
    classes: Sequence[str],
    recording_labels: np.ndarray,
    progress: Callable[..., Bar] = Bar,
) -> tuple[list[LabelledPicture], list[str]]:
    """The pictures that can be read, and why the other pictures are left out, one line each.

    Of two copies of a picture, the second one is left out.

    Parameters
    ----------
    pictures_of_class : class name -> the picture files of this class.
    classes : names, in the order of the labels.
    recording_labels : labels of the recordings that the data set has, too.
    progress : makes the progress bar, which counts pictures.

    Raises
    ------
    ValueError : the same picture is in two classes; a class without recordings has no picture that
        can be read.
    """
    pictures = []
    for label, name in enumerate(classes):
        pictures += [LabelledPicture(path, label) for path in pictures_of_class.get(name, [])]
    good: list[LabelledPicture] = []
    left_out: list[str] = []
    if not pictures:
        return good, left_out
    known: dict[bytes, LabelledPicture] = {}
    with progress(len(pictures), "reading pictures") as bar:
        for picture in pictures:
            try:
                read_picture(picture.path)
                digest = hashlib.sha256(read_regular(picture.path)).digest()
            except (ValueError, OSError) as error:
                reason = f"{picture.name}: {error}."
                left_out.append(reason.replace(str(picture.path), picture.name))
                continue
            finally:
                bar.update()
            first = known.setdefault(digest, picture)
            if first.label != picture.label:
                raise ValueError(
                    f"{first.name} and {picture.name} are the same picture in two classes; remove "
                    "one"
                )
            if first is picture:  # this picture has not been read before
                good.append(picture)
            else:
                left_out.append(f"{picture.name}: the same picture as {first.name}.")
    labels = {*recording_labels.tolist(), *(picture.label for picture in good)}
    _check_no_class_empty(pictures_of_class, classes, labels, left_out)
    return good, left_out


def _check_no_class_empty(
    pictures_of_class: Mapping[str, Sequence[Path]],
    classes: Sequence[str],
    labels: set[int],
    left_out: Sequence[str],
) -> None:
    """Refuse a class that has only pictures, if none of them can be read.

    labels : the labels of the classes that have recordings, or pictures that can be read.
    """
    empty = [
        name for k, name in enumerate(classes) if name in pictures_of_class and k not in labels
    ]
    if not empty:
        return
    reasons = [line for line in left_out if line.startswith(f"{empty[0]}/")]
    raise ValueError(
        f"no picture of class {', '.join(empty)} is left ({reasons[0]}); add some, or remove the "
        "folder"
    )


def with_pictures(
    recordings: Recordings,
    pictures: Sequence[LabelledPicture],
    split: tuple[np.ndarray, np.ndarray],
    settings: SceneSettings,
    seed: int,
    work: Work,
) -> tuple[Recordings, np.ndarray, np.ndarray, dict[str, Any]]:
    """Simulate recordings of pictures, and append them to the other recordings.

    Parameters
    ----------
    recordings : the recordings of a camera.
    pictures : the pictures to record.
    split : two arrays of indices, of what is learned from and of what is held out. The indices
        number `recordings` first, and then `pictures`.
    settings : how pictures are recorded.
    seed : seed of the simulated recordings.
    work : where events and simulated recordings are kept, and how many processes simulate.

    Returns
    -------
    All recordings, the indices of those to learn from, the indices of those that are held out, and
    what the model's record says of the pictures.
    """
    n_real = len(recordings)
    # the indices to learn from, and those that are held out; without pictures so far
    sides = [indices[indices < n_real] for indices in split]
    record: dict[str, Any] = {"pictures": len(pictures)}
    with RecordingsWriter(work.store) as writer, TemporaryDirectory() as temporary:
        folder = (work.store or Path(temporary)) / "pictures"
        writer.extend(recordings)
        # the recordings of pictures follow: first those to learn from, then those held out
        first = n_real
        for k, part in enumerate(RECORDINGS):
            part_pictures = [pictures[i - n_real] for i in split[k] if i >= n_real]
            n_takes = simulate_pictures(
                writer,
                part,
                part_pictures,
                settings,
                folder,
                seed=seed,
                workers=work.workers,
                progress=work.progress,
            )
            if part == "training":
                record["takes"] = n_takes
            else:
                record["held_out"] = len(part_pictures)
            n_recordings = n_takes * len(part_pictures)
            sides[k] = np.concatenate([sides[k], first + np.arange(n_recordings)])
            first += n_recordings
        record["settings"] = asdict(settings)
        return writer.finish(), sides[0], sides[1], record


def simulate_pictures(
    writer: RecordingsWriter,
    part: str,
    pictures: Sequence[LabelledPicture],
    settings: SceneSettings,
    folder: Path,
    *,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[..., Bar] = Bar,
) -> int:
    """Simulate recordings of pictures, and append them to a writer, picture by picture.

    The same pictures, settings and seed give the same recordings, for any number of workers. A file
    that is already in the folder is not made again.

    Parameters
    ----------
    writer : gets the recordings.
    part : a key of `RECORDINGS`.
    pictures : the pictures to record.
    settings : how pictures are recorded.
    folder : the folder of the files; made if missing.
    seed : seed of the simulation.
    workers : number of processes.
    progress : makes the progress bar, which counts recordings.

    Returns
    -------
    The number of recordings of each picture.

    Raises
    ------
    ValueError : the folder holds recordings of other pictures or settings, or a damaged file.
    """
    share = _share_of_recordings(settings)
    wanted = round(share * RECORDINGS[part] / max(1, len(pictures)))
    n_takes = int(np.clip(wanted, LEAST_TAKES[part], MOST_TAKES))
    folder.mkdir(parents=True, exist_ok=True)
    made_from = {
        "format": FORMAT,
        "settings": asdict(settings),
        "seed": seed,
        f"{part} pictures": [len(pictures), n_takes, _checksum(pictures)],
    }
    # compared as it comes back from a file, with lists instead of tuples
    _check_manifest(folder / MANIFEST, json.loads(json.dumps(made_from)))

    chunks = _chunks(part, pictures, n_takes, folder, round(share * CHUNK))
    missing = [chunk for chunk in chunks if not chunk.file.exists()]
    n_all = n_takes * len(pictures)
    n_missing = sum(len(chunk.takes) for chunk in missing)
    job = partial(_record, settings=settings, seed=(seed, list(RECORDINGS).index(part)))
    bar = progress(n_all, "simulating pictures", done=n_all - n_missing)
    run_counted(job, missing, workers, bar)
    for chunk in chunks:
        for recording, (picture, _, take) in zip(_read(chunk), chunk.takes, strict=True):
            name = f"{picture.name}, take {take + 1}"
            writer.add(recording.events, picture.label, name, recording.outline, settings.window_us)
    return n_takes


def _share_of_recordings(settings: SceneSettings) -> float:
    """The share of `RECORDINGS` that a sensor has; see `FULL_PIXELS`."""
    width, height = settings.sensor
    factor = 1.0
    if settings.follow:
        factor = FOLLOWED
    if settings.cut_out:
        factor = CUT_OUT
    n_pixels = width * height * factor
    return float(np.clip(FULL_PIXELS / n_pixels, LEAST_SHARE, 1))


def _checksum(pictures: Sequence[LabelledPicture]) -> int:
    """A checksum of the names and the contents of pictures."""
    checksum = 0
    for picture in pictures:
        checksum = zlib.crc32(os.fsencode(picture.name), checksum)
        checksum = zlib.crc32(read_regular(picture.path), checksum)
    return checksum


def _chunks(
    part: str, pictures: Sequence[LabelledPicture], n_takes: int, folder: Path, size: int
) -> list[_Chunk]:
    """The tasks that make `n_takes` recordings of each picture, `size` recordings in a file."""
    takes = []
    for i, picture in enumerate(pictures):
        takes += [(picture, i, take) for take in range(n_takes)]
    return [
        _Chunk(folder / f"{part}_{first:06}.npz", takes[first : first + size])
        for first in range(0, len(takes), size)
    ]


@dataclass(frozen=True)
class _Chunk:
    """The recordings that one task makes.

    Parameters
    ----------
    file : the file that the recordings are written to.
    takes : a tuple for each recording: the picture, the number of the picture, and the number of
        the recording among those of this picture.
    """

    file: Path
    takes: list[tuple[LabelledPicture, int, int]]


def _record(chunk: _Chunk, *, settings: SceneSettings, seed: tuple[int, int]) -> int:
    """Simulate the recordings of a chunk, and write its file. Returns their number."""
    recordings = []
    for _, group in groupby(chunk.takes, key=itemgetter(1)):
        takes = list(group)
        picture = read_picture(takes[0][0].path)
        for _, i, take in takes:
            rng = np.random.default_rng((*seed, i, take))
            recordings.append(record_picture(picture, settings, rng))
    columns: dict[str, Any] = {
        name: np.concatenate([one.events[name].astype(dtype) for one in recordings])
        for name, dtype in COLUMNS.items()
    }
    columns["sizes"] = np.array([len(one.events) for one in recordings])
    columns["outlines"] = np.stack([one.outline for one in recordings])
    with replacing(chunk.file) as part, part.open("wb") as file:
        np.savez(file, **columns)
    return len(recordings)


def _read(chunk: _Chunk) -> list[PictureRecording]:
    """Read the recordings of a chunk's file."""
    *columns, sizes, outlines = read_arrays(chunk.file, *COLUMNS, "sizes", "outlines")
    has_types = [column.dtype for column in columns] == list(COLUMNS.values())
    is_whole = (
        has_types
        and sizes.shape == (len(chunk.takes),)
        and outlines.shape == (len(chunk.takes), MOMENTS, POINTS, 2)
        and all(column.shape == (sizes.sum(),) for column in columns)
    )
    if not is_whole:
        raise ValueError(
            f"{chunk.file}: not the {len(chunk.takes)} recordings that belong there; remove "
            f"{chunk.file.parent}"
        )
    events = np.split(structured(columns), np.cumsum(sizes)[:-1])
    return [PictureRecording(*one) for one in zip(events, outlines, strict=True)]


def _check_manifest(path: Path, made_from: dict[str, Any]) -> None:
    """Refuse a folder of other pictures. Write into its manifest what its recordings are made of.

    Parameters
    ----------
    path : the manifest.
    made_from : what the recordings are made of.
    """
    folder = path.parent
    stored: dict[str, Any] = {}
    if not path.exists() and any(folder.glob("*.npz")):
        raise ValueError(
            f"{folder}: recordings of pictures without their {path.name}; remove this folder"
        )
    if path.exists():
        try:
            stored = dict(parse_json(read_regular(path)))
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({one_line(error)}); remove {folder}") from None
    # each part of the data set, training and held-out, adds its own entries
    differ = [name for name, value in made_from.items() if stored.get(name, value) != value]
    if differ:
        raise other_run(folder, f"pictures ({', '.join(differ)})")
    write_text(path, json.dumps({**stored, **made_from}, indent=1) + "\n")


def example_recordings(
    pictures_of_class: Mapping[str, Sequence[Path]], settings: SceneSettings, seed: int
) -> list[tuple[str, np.ndarray, list[np.ndarray]]]:
    """Examples for a figure: a class, and the luminance and the recordings of one of its pictures.

    The picture is the first one of the class that can be read.
    """
    examples = []
    for row, (name, paths) in enumerate(list(pictures_of_class.items())[:N_EXAMPLES]):
        for path in paths:
            with contextlib.suppress(ValueError, OSError):
                picture = read_picture(path)
                takes = [
                    record_picture(picture, settings, np.random.default_rng((seed, row, k))).events
                    for k in range(N_TAKES)
                ]
                examples.append((name, picture.light, takes))
                break
    return examples


def measure_camera(
    path: Path, window_us: int, sensor: tuple[int, int], **reading: Any
) -> MeasuredPixels:
    """Measure the pixels of a camera on a recording.

    Parameters
    ----------
    path : a recording of about a minute.
    window_us : length of the windows in which the pixels are measured, in microseconds.
    sensor : (width, height) of the camera.
    reading : other options of `open_recording`.

    Raises
    ------
    ValueError : the file is not a recording, is of another sensor, or is no longer than a window.
    OSError : the file cannot be read.
    """
    recording = open_recording(path, sensor=sensor, **reading)
    if recording.stated_sensor not in (None, sensor):
        raise ValueError(f"{path}: a camera of {recording.stated_sensor} pixels, expected {sensor}")
    events = recording.read()
    events = events[np.argsort(events["t"], kind="stable")]
    t, x, y, p = [np.ascontiguousarray(events[name]) for name in "txyp"]
    gaps = np.diff(t, prepend=t[:1])
    # Remove the camera's pauses from the times. Otherwise a pause would count as a quiet scene.
    t = t - np.cumsum(np.where(gaps > LONGEST_PAUSE * window_us, gaps, 0))
    if not len(t) or t[-1] - t[0] <= window_us:
        raise ValueError(f"{path}: no longer than a window of {window_us} us; record a minute")
    cuts = np.searchsorted(t, np.arange(t[0] + window_us, t[-1], window_us))
    columns = [np.split(column, cuts) for column in (t.astype(np.int64), x, y, p)]
    windows = list(zip(*columns, strict=True))
    complete = windows[:-1]  # the last window may be cut short
    return measure_pixels(complete, sensor, window_us)
