"""The run folder of a training: its checkpoint, history and learning curves, and which training may
resume there."""

from __future__ import annotations

import io
import json
import shutil
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
from async_tnt.training.recordings import COLUMNS
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig

CHECKPOINT, HISTORY = "checkpoint.pt", "history.json"
RUN_FILES = (CHECKPOINT, HISTORY)
FORMAT = 9  # of the checkpoint
CHUNK = 1 << 24  # events that a checksum takes at once: Ctrl-C waits for it


def save_checkpoint(run_folder: Path, state: Mapping[str, Any]) -> None:
    """Write the checkpoint, and its history once more for people to read.

    Parameters
    ----------
    state : `identity` from `identity_of`, `history`, and what else is needed to resume.
    """
    import torch

    # as an error of writing the file itself, such as a full disk, torch raises a RuntimeError
    content = io.BytesIO()
    torch.save(dict(state), content)
    with replacing(run_folder / CHECKPOINT) as part:
        part.write_bytes(content.getbuffer())
    text = json.dumps({"settings": state["identity"], "history": state["history"]}, indent=1)
    write_text(run_folder / HISTORY, text)


def begin_again(run_folder: Path) -> None:
    """Delete what was learned there so far, and the motions that were made."""
    for name in RUN_FILES:
        (run_folder / name).unlink(missing_ok=True)
    discard_made(run_folder, "motions")


def discard_made(run_folder: Path, name: str) -> None:
    """Delete what was made from the data for a training.

    name : of its folder, "motions" or "pictures"; motions.json or pictures.json in it says what it
        was made from.
    """
    if (run_folder / name / f"{name}.json").is_file():
        shutil.rmtree(run_folder / name)


def load_checkpoint(run_folder: Path, known: Mapping[str, Any]) -> dict[str, Any] | None:
    """The state that `save_checkpoint` wrote into the folder; None if there is none yet.

    Parameters
    ----------
    known : of the run to be started: all of `identity_of`, or what is known of it before the data
        is read.

    Raises
    ------
    ValueError : the folder holds another run, and what differs; the checkpoint is damaged, or of
        another release.
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
        except Exception as error:  # a damaged archive surfaces as any of a dozen types
            kind = type(error).__name__  # not its text: torch's advises loading the file unsafely
            raise ValueError(
                f"{path} is not a readable checkpoint ({kind}); remove it to start again"
            ) from error
    if written != FORMAT:
        raise ValueError(
            f"{path} was written by another release of async_tnt; remove it to start again"
        )
    if differ := [
        name for name, value in _plain(known).items() if state["identity"].get(name) != value
    ]:
        raise other_run(run_folder, ", ".join(sorted(differ)))
    return state


def identity_of(
    config: TNTConfig,
    settings: TrainSettings,
    training: Windows,
    validation: Windows,
    start: Model | None,
    classes: tuple[str, ...],
    motions: Any = None,
    teachers: Sequence[Model] = (),
) -> dict[str, Any]:
    """Everything that decides the weights, for JSON: training resumes from a checkpoint only if it
    is the same."""
    own_file = settings.network.rpartition(":")[0]  # "module.py:build"
    return _plain(
        {
            **config.to_dict(),
            **asdict(settings),
            "format": FORMAT,
            "training_windows": len(training),
            "validation_windows": len(validation),
            "data": windows_checksum(training, validation),
            "classes": classes,
            "motions": None if motions is None else asdict(motions),
            "network_file": zlib.crc32(read_regular(own_file)) if own_file else None,
            "start": 0 if start is None else sha256_of(start),
            "teachers": [sha256_of(teacher) for teacher in teachers],
        }
    )


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON gives them back: tuples are lists."""
    plain: dict[str, Any] = json.loads(json.dumps(dict(values)))
    return plain


def windows_checksum(training: Windows, validation: Windows) -> int:
    """A checksum of windows and of all events of their recordings, which may be larger than the
    memory."""
    data = 0
    for windows in (training, validation):
        for column in (windows.recording, windows.start_us, windows.labels):
            data = zlib.crc32(column.tobytes(), data)
    recordings = [training.recordings] + [validation.recordings] * (
        validation.recordings is not training.recordings
    )
    for column in (getattr(one, name) for one in recordings for name in ("offsets", *COLUMNS)):
        for first in range(0, len(column), CHUNK):
            data = zlib.crc32(np.ascontiguousarray(column[first : first + CHUNK]).data, data)
    return data


def other_run(run_folder: Path, what: str) -> ValueError:
    """The error about a run folder whose run differs in `what`."""
    return ValueError(
        f"{run_folder}: the folder holds a run with other {what}; delete it (`restart`) to start "
        "again, or train "
        "into another file (`out`)"
    )


def plot_curves(history: Sequence[dict[str, float]], path: Path) -> bool:
    """Loss and accuracy against epochs, as PNG. Returns False, and writes nothing, without
    matplotlib."""
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
    panels = zip(
        figure.subplots(1, 2), ("cross entropy", "accuracy"), (losses, accuracies), strict=True
    )
    for axes, quantity, labels in panels:
        for name, label in labels.items():
            if all(name in row for row in history):
                axes.plot(
                    [row["epoch"] for row in history],
                    [row[name] for row in history],
                    marker=".",
                    label=label,
                )
        axes.set(xlabel="epoch", ylabel=quantity)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    with replacing(path) as part:
        figure.savefig(part, format="png", dpi=120)
    return True
