"""The run folder of a training: its checkpoint, its history and its learning curves.

A training resumes from a run folder only if everything that decides the weights is the same.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.files import open_regular, read_regular, replacing, write_text
from async_tnt.evaluation.job import sha256_of
from async_tnt.networks.models.model import Model
from async_tnt.training.moved_windows import MotionSettings
from async_tnt.training.recordings import COLUMNS
from async_tnt.training.settings import TrainSettings
from async_tnt.training.training_data import TrainingData
from async_tnt.training.windows import Windows

CHECKPOINT = "checkpoint.pt"
HISTORY = "history.json"
RUN_FILES = (CHECKPOINT, HISTORY)
FORMAT = 10
"""Version of the checkpoint."""
CHUNK = 1 << 24
"""Number of events that a checksum takes at once. Ctrl-C takes effect only between two chunks."""


def save_checkpoint(run_folder: Path, state: Mapping[str, Any]) -> None:
    """Write the checkpoint, and the history once more as a file that people can read.

    Parameters
    ----------
    run_folder : the folder in which the checkpoint and the history are written.
    state : `identity` from `identity_of`, `history`, and what else is needed to resume.
    """
    import torch

    # torch raises a RuntimeError if it cannot write a file, for example on a full disk. So torch
    # writes into memory, and the file is written here, where a full disk is an OSError.
    content = io.BytesIO()
    torch.save(dict(state), content)
    with replacing(run_folder / CHECKPOINT) as part:
        part.write_bytes(content.getbuffer())
    text = json.dumps({"settings": state["identity"], "history": state["history"]}, indent=1)
    write_text(run_folder / HISTORY, text)


def load_checkpoint(run_folder: Path, known: Mapping[str, Any]) -> dict[str, Any] | None:
    """The state that `save_checkpoint` wrote into the folder; None if there is none yet.

    Parameters
    ----------
    run_folder : the folder of the checkpoint.
    known : the description of the run to be started: what `identity_of` returns, or the part of it
        that is known before the data set is read.

    Raises
    ------
    ValueError : the folder holds another run (the message says what differs); the checkpoint is
        damaged, or of another release.
    OSError : the checkpoint is no regular file, or cannot be read.
    """
    path = run_folder / CHECKPOINT
    if not path.exists():
        return None
    import torch

    with open_regular(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                if archive.testzip() is not None:  # torch.load does not compare checksums
                    raise zipfile.BadZipFile
            file.seek(0)
            state: dict[str, Any] = torch.load(file, weights_only=True, map_location="cpu")
            written = state["identity"]["format"]
        except Exception as error:  # a damaged archive raises one of a dozen types of errors
            # The error's text is left out, because in it torch advises to load the file unsafely.
            kind = type(error).__name__
            raise ValueError(
                f"{path} is not a readable checkpoint ({kind}); remove it to start again"
            ) from error
    if written != FORMAT:
        raise ValueError(
            f"{path} was written by another release of async_tnt; remove it to start again"
        )
    identity = state["identity"]
    differ = [name for name, value in _plain(known).items() if identity.get(name) != value]
    if differ:
        raise other_run(run_folder, ", ".join(sorted(differ)))
    return state


def identity_of(
    data: TrainingData,
    settings: TrainSettings,
    start: Model | None = None,
    motions: MotionSettings | None = None,
    teachers: Sequence[Model] = (),
) -> dict[str, Any]:
    """A description of everything that decides the weights, for JSON.

    A training resumes from a checkpoint only if its description is the same.
    """
    own_file = settings.network.rpartition(":")[0]  # of "module.py:build"; otherwise empty
    return _plain(
        {
            **data.config.to_dict(),
            **asdict(settings),
            "format": FORMAT,
            "training_windows": len(data.training),
            "validation_windows": len(data.validation),
            "data": windows_checksum(data.training, data.validation),
            "scenes": None if data.scenes is None else data.scenes.to_dict(),
            "classes": data.classes,
            "motions": None if motions is None else asdict(motions),
            "network_file": zlib.crc32(read_regular(own_file)) if own_file else None,
            "start": 0 if start is None else sha256_of(start),  # 0: random weights
            "teachers": [sha256_of(teacher) for teacher in teachers],
        }
    )


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values as they come back from JSON, with lists instead of tuples."""
    plain: dict[str, Any] = json.loads(json.dumps(dict(values)))
    return plain


def windows_checksum(training: Windows, validation: Windows) -> int:
    """A checksum of windows and of all events of their recordings.

    The events may be larger than the memory.
    """
    checksum = 0
    for windows in (training, validation):
        for column in (windows.recording, windows.start_us, windows.labels):
            checksum = zlib.crc32(column.tobytes(), checksum)
    recordings = [training.recordings]
    if validation.recordings is not training.recordings:
        recordings.append(validation.recordings)
    for columns in recordings:
        for name in ("offsets", *COLUMNS, "outlines", "boxes"):
            column = getattr(columns, name)
            if column is None:
                continue
            for first in range(0, len(column), CHUNK):
                part = np.ascontiguousarray(column[first : first + CHUNK])
                checksum = zlib.crc32(part.data, checksum)
    return checksum


def other_run(folder: Path, differences: str) -> ValueError:
    """The error to raise for a folder whose content was made with other values of `differences`."""
    return ValueError(
        f"{folder}: the folder holds a run with other {differences}; remove it to start again, or "
        "train into another file"
    )


def plot_curves(history: Sequence[dict[str, float]], path: Path) -> bool:
    """Plot loss and accuracy against epochs into a PNG file.

    Returns False, and writes nothing, if matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return False
    losses = {"loss": "training (smoothed labels)", "validation_loss": "validation"}
    accuracies = {
        "training": "training (augmented)",
        "per_window": "validation, by window",
        "per_recording": "validation, by recording",
        "f1": "validation, F1 of scenes",
    }
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    epochs = [row["epoch"] for row in history]
    for axes, quantity, labels in (
        (left, "cross entropy", losses),
        (right, "accuracy", accuracies),
    ):
        for name, label in labels.items():
            if all(name in row for row in history):  # a map model has other measurements
                axes.plot(epochs, [row[name] for row in history], marker=".", label=label)
        axes.set(xlabel="epoch", ylabel=quantity)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    with replacing(path) as part:
        figure.savefig(part, format="png", dpi=120)
    return True
