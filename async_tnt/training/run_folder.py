"""What a run folder says of the run in it, so that another one is refused before its data is read."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from async_tnt.files import write_text
from async_tnt.sources.class_folders import find_recordings, name_of

RECORDINGS = "recordings.json"
CHECKPOINT, HISTORY, CURVES = "checkpoint.pt", "history.json", "curves.png"
LAST, BEST = "last.safetensors", "best.safetensors"
RUN_FILES = (RECORDINGS, CHECKPOINT, HISTORY, CURVES, LAST, BEST)
SHOWN = 3  # recordings that a refusal names


def other_run(run_folder: Path, what: str) -> ValueError:
    """The refusal to go on with a run that differs in `what`."""
    return ValueError(
        f"{run_folder} holds a run with other {what}; give another run folder (train --run OTHER), or delete the "
        f"folder {run_folder} to start anew"
    )


def sizes_of(dataset: Path) -> dict[str, int]:
    """Recording -> bytes, of all that `DATASET` or `DATASET/Train` holds; -1 where it cannot be asked."""
    return {name_of(path): _size(path) for paths in find_recordings(dataset, "Train").values() for path in paths}


def check_recordings(run_folder: Path, sizes: Mapping[str, int], share: float) -> None:
    """Refuse recordings that are not those of the run in the folder, as far as names and sizes tell.

    Parameters
    ----------
    sizes : as of `sizes_of`, now.
    share : of recordings held out.

    Raises
    ------
    ValueError : a recording is new, of another size, or gone though the run trains on it; or another share is held
        out. A run that noted nothing is not refused: `train` compares the events.
    """
    noted = _noted(run_folder)
    if noted is None:
        return
    then, used, share_then, _ = noted
    differ = [f"{name} is new" for name in sizes if name not in then]
    differ += [f"{name} has changed" for name in sizes if name in then and then[name] != sizes[name]]
    differ += [f"{name} is gone" for name in then if name in used and name not in sizes]
    if differ:
        more = f", and {len(differ) - SHOWN} more" if len(differ) > SHOWN else ""
        raise other_run(run_folder, f"recordings ({', '.join(differ[:SHOWN])}{more})")
    if share != share_then:
        raise other_run(run_folder, f"validation ({share_then:g}, now {share:g})")


def other_pixels(run_folder: Path, record: Mapping[str, Any]) -> list[str]:
    """Which of roi, crop and mask are not those of the run in the folder; of one that noted nothing, none.

    record : `PixelSelection.record`, of what the network is to see of the recordings.
    """
    noted = _noted(run_folder)
    if noted is None:
        return []
    then = noted[-1]
    others = [name for name in {**then, **record} if (then.get(name) or None) != (record.get(name) or None)]
    return list(dict.fromkeys("mask" if name in ("masked_pixels", "mask_sha256") else name for name in others))


def note_recordings(
    run_folder: Path, sizes: Mapping[str, int], share: float, used: Collection[str], record: Mapping[str, Any]
) -> None:
    """Write what `check_recordings` and `other_pixels` read; `used`: names of recordings that were not left out."""
    run_folder.mkdir(parents=True, exist_ok=True)
    note = {"validation": share, "sizes": dict(sizes), "used": sorted(used), "pixels": dict(record)}
    write_text(run_folder / RECORDINGS, json.dumps(note, indent=1))


def _noted(run_folder: Path) -> tuple[dict[str, int], set[str], float, dict[str, Any]] | None:
    """Sizes, used recordings, the share held out, and the record of pixels; None of an older run or a damaged note."""
    try:
        noted = json.loads((run_folder / RECORDINGS).read_text(encoding="utf-8"))
        record = dict(noted.get("pixels", {}))  # older runs knew of none
        return dict(noted["sizes"]), set(noted["used"]), float(noted["validation"]), record
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # a link to nothing: left out where it is read
        return -1
