"""A Job says what is done with every recording; a Task is one recording.

Jobs and tasks are plain data. They can be pickled, and so be sent to processes on other machines.
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
    """Everything that a record depends on, except for the recording.

    Parameters
    ----------
    model : the name of a bundled model, or the absolute path of a model.
    model_sha256 : checksum of the model's content, without its training record; see `sha256_of`.
    version : version of this package.
    pixels : the pixels whose events the model sees. It holds the mask itself, so that workers do
        not need the mask's file.
    reading : what the files do not state about themselves. Its sensor is not used, because `pixels`
        has the sensor.
    """

    model: str
    model_sha256: str = ""
    version: str = __version__
    pixels: Pixels = field(default_factory=Pixels)
    reading: ReadOptions = field(default_factory=ReadOptions)

    @property
    def id(self) -> str:
        """A checksum of everything that the records depend on: 12 hexadecimal digits."""
        reading = {name: value for name, value in asdict(self.reading).items() if value is not None}
        content = {
            "version": self.version,
            **self.pixels.about,
            **reading,
            "model_sha256": self.model_sha256,
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Task:
    """One recording, and what is done with it.

    Parameters
    ----------
    recording : the recording's name in the results.
    path : absolute path of the recording's file. A relative path would depend on the working folder
        of the worker.
    job : what is done with the recording.
    bytes, modified_ns : the file's size, and the time of its last change; None if the file cannot
        be accessed.
    label : the recording's class; None if it is not known.
    between_us : start and end of the part of the file that is the recording; None if the whole file
        is the recording.
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
    """The job for a model that `load_model` has loaded by this name or path."""
    is_bundled = name_or_path in bundled_models()
    location = name_or_path if is_bundled else os.path.abspath(user_path(name_or_path))
    return Job(location, sha256_of(model), pixels=pixels, reading=reading or ReadOptions())


def task_of(
    recording: str,
    path: Path,
    job: Job,
    label: str | None = None,
    between_us: tuple[int, int] | None = None,
) -> Task:
    """The task for a file, or for a part of it, with the file's current size and time."""
    # file names need not be valid text
    name = recording.encode("utf-8", "backslashreplace").decode()
    absolute = Path(os.path.abspath(path))
    try:
        status = path.stat()
    except OSError:  # the same error will be raised when the file is opened
        return Task(name, absolute, job, None, None, label, between_us)
    return Task(name, absolute, job, status.st_size, status.st_mtime_ns, label, between_us)


def sha256_of(model: Model) -> str:
    """The checksum of all that decisions depend on: configuration, classes, layers and weights."""
    content = [model.config.to_dict(), list(model.classes), model.network]
    return checksum(model.weights, json.dumps(content, sort_keys=True))
