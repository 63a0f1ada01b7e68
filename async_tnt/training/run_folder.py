"""What a run folder says of the run in it, so that another one is refused before its data is read."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from async_tnt.datasets.class_folders import find_recordings, name_of
from async_tnt.whole_files import replacing

RECORDINGS = "recordings.json"
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


def check_recordings(run_folder: Path, sizes: Mapping[str, int], share: float, pixels: Mapping[str, Any]) -> None:
    """Refuse recordings that are not those of the run in the folder, as far as names and sizes tell, or other pixels.

    Parameters
    ----------
    sizes : as of `sizes_of`, now.
    share : of recordings held out.
    pixels : `PixelSelection.record`, of what the network sees of the recordings.

    Raises
    ------
    ValueError : a recording is new, of another size, or gone though the run trains on it; another share is held out;
        or other pixels are left out. A run that noted nothing is not refused: `train` compares the events.
    """
    try:
        noted = json.loads((run_folder / RECORDINGS).read_text(encoding="utf-8"))
        then, used, share_then = dict(noted["sizes"]), set(noted["used"]), float(noted["validation"])
        pixels_then = dict(noted.get("pixels", {}))  # older runs knew of none
    except (OSError, ValueError, TypeError, KeyError):  # an older run, or a damaged note
        return
    differ = [f"{name} is new" for name in sizes if name not in then]
    differ += [f"{name} has changed" for name in sizes if name in then and then[name] != sizes[name]]
    differ += [f"{name} is gone" for name in then if name in used and name not in sizes]
    if differ:
        more = f", and {len(differ) - SHOWN} more" if len(differ) > SHOWN else ""
        raise other_run(run_folder, f"recordings ({', '.join(differ[:SHOWN])}{more})")
    if share != share_then:
        raise other_run(run_folder, f"validation ({share_then:g}, now {share:g})")
    others = [
        name for name in {**pixels_then, **pixels} if (pixels_then.get(name) or None) != (pixels.get(name) or None)
    ]
    if others:
        what = dict.fromkeys("mask" if name in ("masked_pixels", "mask_sha256") else name for name in others)
        raise other_run(run_folder, ", ".join(what))


def note_recordings(
    run_folder: Path, sizes: Mapping[str, int], share: float, used: Collection[str], pixels: Mapping[str, Any]
) -> None:
    """Write what `check_recordings` reads; `used`: the names of recordings that were not left out."""
    run_folder.mkdir(parents=True, exist_ok=True)
    note = {"validation": share, "sizes": dict(sizes), "used": sorted(used), "pixels": dict(pixels)}
    text = json.dumps(note, indent=1)
    with replacing(run_folder / RECORDINGS) as part:
        part.write_text(text, encoding="utf-8")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # a link to nothing: left out where it is read
        return -1
