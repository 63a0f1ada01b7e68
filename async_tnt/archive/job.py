"""Job and Task: what is done with every recording of an archive, and one recording to do it with.

Both are plain and picklable, so that a process of another machine can take them.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import warnings
from dataclasses import asdict, dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

from async_tnt import __version__
from async_tnt.compile_ahead import warmup
from async_tnt.networks.engines import Engine, choose_engine, is_onnx, regressor_path
from async_tnt.networks.model import Model, UncheckedModelWarning, bundled_models
from async_tnt.processor import Processor
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.sources.pixel_selector import PixelSelector


@dataclass(frozen=True)
class Job:
    """What a record depends on, besides the recording.

    Parameters
    ----------
    kind : "evaluate" or "run".
    model : a bundled name, or an absolute path.
    engine : as for `choose_engine`.
    settings : those of `Processor`.
    model_sha256 : of the model's content; the training record does not count.
    version : of this package.
    pixels : what of a recording the model is to see; with the mask itself, so that a worker needs no file of it.
    """

    kind: str
    model: str
    engine: str
    settings: dict[str, Any] = field(default_factory=dict)
    model_sha256: str = ""
    version: str = __version__
    pixels: PixelSelection = field(default_factory=PixelSelection)

    @property
    def about(self) -> dict[str, Any]:
        """Name -> value of everything that the records depend on, as JSON takes it."""
        settings = {name: asdict(v) if is_dataclass(v) else v for name, v in sorted(self.settings.items())}  # type: ignore[arg-type]
        return {
            "command": self.kind,
            "version": self.version,
            "engine": self.engine,
            **settings,
            **self.pixels.about,  # {} where all events are seen: older results, which know of none, go on
            "model_sha256": self.model_sha256,
        }

    @property
    def id(self) -> str:
        """12 hexadecimal digits that differ where `about` does."""
        return hashlib.sha256(json.dumps(self.about, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Task:
    """One recording.

    Parameters
    ----------
    recording : its name in the results.
    path : where it lies; absolute, as the folder may differ from worker to worker.
    job : what is done.
    settings : `job.id`.
    bytes, modified_ns : size, and time of the last change; None where the file cannot be seen.
    """

    recording: str
    path: Path
    job: Job
    settings: str
    bytes: int | None = None
    modified_ns: int | None = None


def job_of(kind: str, name_or_path: str, engine: Engine, pixels: PixelSelection | None = None, **settings: Any) -> Job:
    """The job of a model as `choose_engine` has loaded it; `settings` : those of `Processor`."""
    model = name_or_path if name_or_path in bundled_models() else os.path.abspath(name_or_path)
    seen = PixelSelection() if pixels is None else pixels
    return Job(kind, model, engine.name, settings, sha256_of(engine, model), pixels=seen)


def task_of(recording: str, path: Path, job: Job) -> Task:
    """The task of a file, with its size and time as they are now."""
    name = recording.encode("utf-8", "backslashreplace").decode()  # file names need not be valid text
    absolute = Path(os.path.abspath(path))
    try:
        seen = path.stat()
    except OSError:  # whoever opens it will say why
        return Task(name, absolute, job, job.id)
    return Task(name, absolute, job, job.id, seen.st_size, seen.st_mtime_ns)


def sha256_of(engine: Engine, path: str) -> str:
    """Of what the decisions depend on: configuration, classes and weights; of an .onnx model, its files."""
    found = hashlib.sha256()
    if isinstance(engine.model, Model):
        found.update(json.dumps([engine.config.to_dict(), list(engine.classes)], sort_keys=True).encode())
        for name, weights in sorted(engine.model.weights.items()):
            found.update(f"{name} {weights.shape} {weights.dtype}".encode())
            found.update(weights.tobytes())
        return found.hexdigest()
    found.update(Path(path).read_bytes())
    if is_onnx(path) and engine.config.needs_regressor:
        found.update(regressor_path(Path(path)).read_bytes())
    return found.hexdigest()


_of_thread = threading.local()  # a Processor is one stream's; workers of a cluster may have several threads


def processor_of(job: Job) -> tuple[Processor, Engine, PixelSelector]:
    """The Processor of a job, and what selects its pixels: for all recordings that a thread streams.

    The Processor is compiled, and reset. The selector is not: its counts go on, and a mask is unpacked once.

    Raises
    ------
    ValueError : the model or this package are not those that the job was made for, or its pixels do not suit the model.
    """
    kept: tuple[Job, Processor, Engine, PixelSelector] | None = getattr(_of_thread, "kept", None)
    if kept is None or kept[0] != job:
        if job.version != __version__:
            raise ValueError(
                f"a worker has async_tnt {__version__}, but this program is {job.version}: install the same"
            )
        with warnings.catch_warnings():  # whoever made the job has seen it, and each worker would repeat it
            warnings.simplefilter("ignore", UncheckedModelWarning)
            engine = choose_engine(job.model, job.engine)
        if sha256_of(engine, job.model) != job.model_sha256:
            raise ValueError(
                f"{job.model}: not the model that the work was begun with; it has changed, or a worker sees another"
            )
        processor = engine.processor(**job.settings)
        warmup(engine.model)
        processor.fire()  # of the empty window: changes nothing, but an engine's first call takes longer
        kept = _of_thread.kept = job, processor, engine, PixelSelector(job.pixels, engine.config.sensor)
    _, processor, engine, pixels = kept
    processor.reset()
    return processor, engine, pixels
