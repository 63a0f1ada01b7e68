"""Pictures of a data set as recordings: simulated by several processes, kept in files beside the
run.

    <folder>/pictures.json          what they are made of
    <folder>/training_000000.npz    recordings from 0 on, those of a picture one after the other

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

from async_tnt.base.checks import one_line, parse_json
from async_tnt.base.files import read_regular, replacing, write_text
from async_tnt.base.progress import Bar
from async_tnt.evaluation.processes import run_counted
from async_tnt.simulation.measured_pixels import MeasuredPixels, measure_pixels
from async_tnt.simulation.picture_scene import SceneSettings, record_picture
from async_tnt.simulation.pictures import SUFFIXES, read_picture
from async_tnt.sources.files.labelled_recordings import class_folders, find_recordings
from async_tnt.sources.files.recording import open_recording
from async_tnt.training.moved_windows import read_arrays
from async_tnt.training.recordings import COLUMNS, Recordings, RecordingsWriter
from async_tnt.training.run_folder import other_run
from async_tnt.volume.events import structured

# of the recordings: a change of what is simulated counts it up
MANIFEST, FORMAT = "pictures.json", 4
RECORDINGS = {"training": 24_000, "held-out": 2_400}
"""Of all pictures together, about; of each at least `LEAST_TAKES`, and at most `MOST_TAKES`."""
LEAST_TAKES, MOST_TAKES = {"training": 2, "held-out": 1}, 200
FULL_PIXELS, FOLLOWED, FEWEST = 128 * 128, 6, 0.1
"""Of a larger sensor fewer, as they take longer, and of one that follows, in the mean so many
times; but at least this share."""
CHUNK = 200
"""Recordings of a file; of a larger sensor fewer, likewise, as a process has all of a file in
memory."""
PAUSE = 100  # windows without any event
N_EXAMPLES, N_TAKES = 5, 6
"""Classes of a figure, and recordings of each."""


@dataclass(frozen=True)
class LabelledPicture:
    """A picture file of one class; `name` for messages and reports."""

    path: Path
    label: int

    @property
    def name(self) -> str:
        """Class folder and file."""
        return f"{self.path.parent.name}/{self.path.name}"


def find_pictures(folder: Path) -> dict[str, list[Path]]:
    """Class name -> its pictures to train on, sorted by name, of the classes that have any.

    Raises
    ------
    ValueError, OSError : as `find_recordings`; pictures of a class beside sessions.
    """
    recordings = find_recordings(folder, "Train")
    found = {}
    for c in class_folders(folder):
        paths = [path for path in sorted(c.glob("[!.]*")) if path.suffix.lower() in SUFFIXES]
        # broken links are told later
        if pictures := [path for path in paths if path.is_file() or path.is_symlink()]:
            found[c.name] = pictures
    sessions = [one.path.name for some in recordings.values() for one in some if one.between_us]
    if sessions and (both := recordings.keys() & found):  # folders of other names may hold figures
        picture = found[min(both)][0].relative_to(folder)
        raise ValueError(
            f"{folder}: expected pictures or sessions, got both: {picture} and {sessions[0]}"
        )
    return {} if sessions else found


def check_pictures(
    found: Mapping[str, Sequence[Path]],
    classes: Sequence[str],
    others: np.ndarray,
    progress: Callable[..., Bar] = Bar,
) -> tuple[list[LabelledPicture], list[str]]:
    """The pictures that can be read, and why the others are left out, one line each.

    Parameters
    ----------
    found : class name -> its pictures.
    classes : names, in the order of the labels.
    others : labels of what there is beside pictures.

    Raises
    ------
    ValueError : the same picture in two classes; a class with nothing else has no picture that can
        be read.
    """
    pictures = [
        LabelledPicture(path, k) for k, name in enumerate(classes) for path in found.get(name, [])
    ]
    good: list[LabelledPicture] = []
    left_out: list[str] = []
    known: dict[bytes, LabelledPicture] = {}
    if not pictures:
        return good, left_out
    with progress(len(pictures), "reading pictures") as bar:
        for picture in pictures:
            try:
                read_picture(picture.path)
                same = known.setdefault(
                    hashlib.sha256(read_regular(picture.path)).digest(), picture
                )
            except (ValueError, OSError) as error:
                left_out.append(
                    f"{picture.name}: {error}.".replace(str(picture.path), picture.name)
                )
                continue
            finally:
                bar.update()
            if same.label != picture.label:
                raise ValueError(
                    f"{same.name} and {picture.name} are the same picture in two classes; remove "
                    "one"
                )
            if same is picture:
                good.append(picture)
            else:
                left_out.append(f"{picture.name}: the same picture as {same.name}.")
    left = {*others.tolist(), *(picture.label for picture in good)}
    if empty := [name for k, name in enumerate(classes) if name in found and k not in left]:
        why = next(line for line in left_out if line.startswith(f"{empty[0]}/"))
        raise ValueError(
            f"no picture of class {', '.join(empty)} is left ({why}); add some, or remove the "
            "folder"
        )
    return good, left_out


def with_pictures(
    recordings: Recordings,
    pictures: Sequence[LabelledPicture],
    split: tuple[np.ndarray, np.ndarray],
    settings: SceneSettings,
    store: Path | None,
    *,
    seed: int,
    workers: int,
    progress: Callable[..., Bar],
) -> tuple[Recordings, np.ndarray, np.ndarray, dict[str, Any]]:
    """The recordings, and those of the pictures.

    Parameters
    ----------
    split : what is learned and what is held out, as indices of `recordings` and of `pictures` after
        them.
    store : a folder for all events, see `RecordingsWriter`, and for what was simulated; None: kept
        in memory.

    Returns
    -------
    All recordings, which of them are learned, which are held out, and the record of the pictures.
    """
    which = [of[of < len(recordings)] for of in split]
    about: dict[str, Any] = {"pictures": len(pictures)}
    with RecordingsWriter(store) as writer, TemporaryDirectory() as temporary:
        writer.extend(recordings)
        first = len(recordings)
        for k, part in enumerate(RECORDINGS):
            some = [pictures[i - len(recordings)] for i in split[k] if i >= len(recordings)]
            folder = (store or Path(temporary)) / "pictures"
            takes = simulate_pictures(
                writer, part, some, settings, folder, seed=seed, workers=workers, progress=progress
            )
            about |= {"takes": takes} if part == "training" else {"held_out": len(some)}
            which[k] = np.concatenate([which[k], first + np.arange(takes * len(some))])
            first += takes * len(some)
        about["settings"] = asdict(settings)
        return writer.finish(), which[0], which[1], about


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
    """Append the recordings of pictures to a writer, those of a picture one after the other.

    The same pictures, settings and seed give the same recordings, for any number of workers; what
    of them is in the folder is not made again.

    Parameters
    ----------
    part : of `RECORDINGS`. folder : for the files; made if missing.

    Returns
    -------
    How often each picture is recorded.

    Raises
    ------
    ValueError : the folder holds recordings of other pictures or settings, or a damaged file.
    """
    pixels = settings.sensor[0] * settings.sensor[1] * (FOLLOWED if settings.follow else 1)
    share = float(np.clip(FULL_PIXELS / pixels, FEWEST, 1))
    takes = int(
        np.clip(
            round(share * RECORDINGS[part] / max(1, len(pictures))), LEAST_TAKES[part], MOST_TAKES
        )
    )
    folder.mkdir(parents=True, exist_ok=True)
    checksum = 0
    for picture in pictures:
        checksum = zlib.crc32(
            read_regular(picture.path), zlib.crc32(os.fsencode(picture.name), checksum)
        )
    made_from = {
        "format": FORMAT,
        "settings": asdict(settings),
        "seed": seed,
        f"{part} pictures": [len(pictures), takes, checksum],
    }
    _check_manifest(folder / MANIFEST, json.loads(json.dumps(made_from)))
    n_all, size = takes * len(pictures), round(share * CHUNK)
    chunks = [
        _Chunk(
            folder / f"{part}_{first:06}.npz",
            [
                (pictures[i // takes], i // takes, i % takes)
                for i in range(first, min(first + size, n_all))
            ],
        )
        for first in range(0, n_all, size)
    ]
    missing = [chunk for chunk in chunks if not chunk.file.exists()]
    job = partial(_record, settings=settings, seed=(seed, list(RECORDINGS).index(part)))
    n_missing = sum(len(chunk.takes) for chunk in missing)
    run_counted(
        job, missing, workers, progress(n_all, "simulating pictures", done=n_all - n_missing)
    )
    for chunk in chunks:
        *columns, sizes = read_arrays(chunk.file, *COLUMNS, "sizes")
        whole = [column.dtype for column in columns] == list(COLUMNS.values()) and sizes.shape == (
            len(chunk.takes),
        )
        if not whole or any(column.shape != (sizes.sum(),) for column in columns):
            raise ValueError(
                f"{chunk.file}: not the {len(chunk.takes)} recordings that belong there; remove "
                f"{folder}"
            )
        recordings = np.split(structured(columns), np.cumsum(sizes)[:-1])
        for one, (picture, _, take) in zip(recordings, chunk.takes, strict=True):
            writer.add(one, picture.label, f"{picture.name}, take {take + 1}")
    return takes


@dataclass(frozen=True)
class _Chunk:
    """What one task records: the picture, its number, and the number of the recording of it."""

    file: Path
    takes: list[tuple[LabelledPicture, int, int]]


def _record(chunk: _Chunk, *, settings: SceneSettings, seed: tuple[int, int]) -> int:
    """Write a chunk's file. Returns how many recordings it has."""
    recordings = []
    for _, of_one in groupby(chunk.takes, key=itemgetter(1)):
        takes = list(of_one)
        picture = read_picture(takes[0][0].path)
        recordings += [
            record_picture(picture, settings, np.random.default_rng((*seed, i, k)))
            for _, i, k in takes
        ]
    columns: dict[str, Any] = {
        name: np.concatenate([one[name].astype(dtype) for one in recordings])
        for name, dtype in COLUMNS.items()
    }
    with replacing(chunk.file) as part, part.open("wb") as file:
        np.savez(file, sizes=np.array([len(one) for one in recordings]), **columns)
    return len(recordings)


def _check_manifest(path: Path, made_from: dict[str, Any]) -> None:
    """Refuse a folder of other pictures; note what is made."""
    there: dict[str, Any] = {}
    if not path.exists() and any(path.parent.glob("*.npz")):
        raise ValueError(
            f"{path.parent}: recordings of pictures without their {path.name}; remove this folder"
        )
    if path.exists():
        try:
            there = dict(parse_json(read_regular(path)))
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({one_line(error)}); remove {path.parent}") from None
    if differ := [name for name, value in made_from.items() if there.get(name, value) != value]:
        raise other_run(path.parent, f"pictures ({', '.join(differ)})")
    write_text(path, json.dumps({**there, **made_from}, indent=1) + "\n")


def example_recordings(
    found: Mapping[str, Sequence[Path]], settings: SceneSettings, seed: int
) -> list[tuple[str, np.ndarray, list[np.ndarray]]]:
    """For a figure: of some classes the first picture that can be read, its luminance, and
    recordings of it."""
    shown = []
    for row, (name, paths) in enumerate(list(found.items())[:N_EXAMPLES]):
        for path in paths:
            with contextlib.suppress(ValueError, OSError):
                picture, draws = (
                    read_picture(path),
                    [np.random.default_rng((seed, row, k)) for k in range(N_TAKES)],
                )
                shown.append(
                    (name, picture.light, [record_picture(picture, settings, rng) for rng in draws])
                )
                break
    return shown


def measure_camera(
    path: Path, window_us: int, sensor: tuple[int, int], **reading: Any
) -> MeasuredPixels:
    """What a recording tells about the pixels of its camera; `reading` are other options of
    `open_recording`.

    Raises
    ------
    ValueError : not a recording, of another sensor, or without a window of events. OSError : it
        cannot be read.
    """
    recording = open_recording(path, sensor=sensor, **reading)
    if recording.stated_sensor not in (None, sensor):
        raise ValueError(f"{path}: a camera of {recording.stated_sensor} pixels, expected {sensor}")
    events = recording.read()
    events = events[np.argsort(events["t"], kind="stable")]
    t, x, y, p = (np.ascontiguousarray(events[name]) for name in "txyp")
    gaps = np.diff(t, prepend=t[:1])
    # a pause of the camera is not a quiet scene
    t = t - np.cumsum(np.where(gaps > PAUSE * window_us, gaps, 0))
    if not len(t) or t[-1] - t[0] <= window_us:
        raise ValueError(f"{path}: no longer than a window of {window_us} us; record a minute")
    cuts = np.searchsorted(t, np.arange(t[0] + window_us, t[-1], window_us))
    windows = zip(
        *(np.split(column, cuts) for column in (t.astype(np.int64), x, y, p)), strict=True
    )
    return measure_pixels(list(windows)[:-1], sensor, window_us)
