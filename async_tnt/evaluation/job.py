"""A Job says what is done with every recording; a Task is one recording.

Jobs and tasks are plain data and picklable, for processes of other machines.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from async_tnt.base.files import user_path
from async_tnt.base.package import __version__
from async_tnt.networks.loading import bundled_models
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.model_file import checksum
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels


@dataclass(frozen=True)
class Job:
    """What a record depends on, besides the recording.

    Parameters
    ----------
    model : a bundled name, or an absolute path.
    model_sha256 : checksum of the model's content, without its training record; see `sha256_of`.
    version : version of this package.
    pixels : the pixels whose events the model sees. It holds the mask itself, so that workers need
        no file of it.
    reading : how files are read that do not say it themselves; its sensor is that of `pixels`.
    """

    model: str
    model_sha256: str = ""
    version: str = __version__
    pixels: Pixels = field(default_factory=Pixels)
    reading: ReadOptions = field(default_factory=ReadOptions)

    @property
    def id(self) -> str:
        """12 hexadecimal digits that stand for everything that the records depend on."""
        reading = {name: value for name, value in asdict(self.reading).items() if value is not None}
        about = {
            "version": self.version,
            **self.pixels.about,
            **reading,
            "model_sha256": self.model_sha256,
        }
        return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Task:
    """One recording, and what is done with it.

    Parameters
    ----------
    recording : the recording's name in the results.
    path : its absolute path, because workers may have another working folder.
    job : what is done with it.
    bytes, modified_ns : the file's size, and the time of its last change; None if the file cannot
        be accessed.
    label : its class; None if that is not known.
    between_us : start and end of the part of the file that is the recording; None for all of it.
    """

    recording: str
    path: Path
    job: Job
    bytes: int | None = None
    modified_ns: int | None = None
    label: str | None = None
    between_us: tuple[int, int] | None = None


def job_of(
    name_or_path: str, model: Model, pixels: Pixels, reading: ReadOptions | None = None
) -> Job:
    """The job of a model that `load_model` has loaded under this name."""
    is_bundled = name_or_path in bundled_models()
    where = name_or_path if is_bundled else os.path.abspath(user_path(name_or_path))
    return Job(where, sha256_of(model), pixels=pixels, reading=reading or ReadOptions())


def task_of(
    recording: str,
    path: Path,
    job: Job,
    label: str | None = None,
    between_us: tuple[int, int] | None = None,
) -> Task:
    """The task of a file, or a part of it, with its current size and time."""
    # file names need not be valid text
    name = recording.encode("utf-8", "backslashreplace").decode()
    absolute = Path(os.path.abspath(path))
    try:
        status = path.stat()
    except OSError:  # opening it will raise the same error
        return Task(name, absolute, job, None, None, label, between_us)
    return Task(name, absolute, job, status.st_size, status.st_mtime_ns, label, between_us)


def sha256_of(model: Model) -> str:
    """The checksum of all that decisions depend on: configuration, classes, layers and weights."""
    about = [model.config.to_dict(), list(model.classes), model.network]
    return checksum(model.weights, json.dumps(about, sort_keys=True))
