"""The checkpoint of a training run: what it holds, and whether it is the run's that is to go on."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from async_tnt.config import TNTConfig
from async_tnt.files import replacing, write_text
from async_tnt.networks.model import Model
from async_tnt.training.run_folder import CHECKPOINT, HISTORY, other_run
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import CLASSES, Windows

FORMAT = 2


def save_checkpoint(run_folder: Path, state: Mapping[str, Any]) -> None:
    """Write it, and the history once more for people to read.

    state : `identity` as `identity_of` says it, `history`, and whatever else is needed to go on.
    """
    with replacing(run_folder / CHECKPOINT) as part:
        torch.save(dict(state), part)
    text = json.dumps({"settings": json.loads(state["identity"]), "history": state["history"]}, indent=1)
    write_text(run_folder / HISTORY, text)


def identity_of(
    config: TNTConfig,
    settings: TrainSettings,
    training: Windows,
    validation: Windows,
    start: Model | None,
    classes: tuple[str, ...],
) -> str:
    """All that decides the weights, as JSON: a checkpoint goes on only where it is the same."""
    data = zlib.crc32(training.recordings.offsets.tobytes())
    for windows in (training, validation):
        for column in (windows.recording, windows.start_us, windows.labels):
            data = zlib.crc32(column.tobytes(), data)
    for name in "txyp":
        data = zlib.crc32(np.ascontiguousarray(getattr(training.recordings, name)[::997]).tobytes(), data)
    return json.dumps(
        {
            "format": FORMAT,
            "config": config.to_dict(),
            # without what older runs had no name for, so that they go on
            "settings": {n: v for n, v in asdict(settings).items() if v or n not in ("balance", "patience")},
            "training_windows": len(training),
            "validation_windows": len(validation),
            "data": data,
            "classes": zlib.crc32(json.dumps(classes).encode()) if classes != CLASSES else 0,
            "start": 0 if start is None else zlib.crc32(b"".join(w.tobytes() for w in start.weights.values())),
        }
    )


def check_run(run_folder: Path, config: Mapping[str, Any], settings: Mapping[str, Any]) -> bool:
    """Whether the folder holds a run already; refuses one of others than these, before any data is read.

    Raises
    ------
    ValueError : the run's differ; names them. Or its checkpoint is damaged.
    """
    differ = differing_settings(run_folder, config, settings)
    if differ:
        raise other_run(run_folder, ", ".join(differ))
    return differ is not None


def differing_settings(run_folder: Path, config: Mapping[str, Any], settings: Mapping[str, Any]) -> list[str] | None:
    """The names of those that are not the ones of the run in the folder; None where there is no run.

    Parameters
    ----------
    config, settings : fields of `TNTConfig` and `TrainSettings` and their values; not all need be known yet.

    Raises
    ------
    ValueError : its checkpoint is damaged.
    """
    state = _read(run_folder / CHECKPOINT)
    if state is None:
        return None
    found = json.loads(state["identity"])
    wanted = json.loads(json.dumps({"config": dict(config), "settings": dict(settings)}))
    return sorted(
        name
        for part, values in wanted.items()
        for name, value in values.items()
        if (found[part].get(name) or None)
        != (value or None)  # older runs lack names whose value was then False or None
    )


def load_checkpoint(run_folder: Path, identity: str) -> dict[str, Any] | None:
    """What `save_checkpoint` wrote into the folder; None where there is nothing yet.

    Raises
    ------
    ValueError : it is of a run of another identity, or damaged.
    """
    state = _read(run_folder / CHECKPOINT)
    if state is None:
        return None
    found = json.loads(state["identity"])
    wanted = json.loads(identity)
    differ = sorted(
        name
        for part in ("config", "settings")
        for name in {**found[part], **wanted[part]}
        if found[part].get(name) != wanted[part].get(name)
    )
    differ += [
        name
        for name in ("format", "training_windows", "validation_windows", "data", "classes", "start")
        if found.get(name, 0) != wanted[name]
    ]
    if differ:
        raise other_run(run_folder, ", ".join(differ))
    return state


def _read(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.testzip() is not None:  # torch.load does not compare checksums
                raise zipfile.BadZipFile
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        json.loads(state["identity"])
        return state
    except Exception as error:  # a damaged archive surfaces as any of a dozen types
        kind = type(error).__name__  # not its text: torch's advises loading the file unsafely
        raise ValueError(f"{path} is not a readable checkpoint ({kind}); remove it to start anew") from error
