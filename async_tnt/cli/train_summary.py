"""What `async-tnt train` prints at its end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from async_tnt.cli.output import say

if TYPE_CHECKING:
    from async_tnt.training.fitting import Fitted

FEW_RECORDINGS = 20
"""If every class has fewer held-out recordings, the windows of each class are reported, too."""
TITLES = {
    "validation": "held out",
    "validation_motions": "held out, in other motions",
    "test": "Test",
}
"""Part of a model's record -> the title under which it is printed."""


def print_summary(fitted: Fitted, out: Path, paths: list[Path], *, as_json: bool) -> None:
    """Print how good a model is, and the files that were written.

    Parameters
    ----------
    fitted : the model, and its scores on what was held out.
    out : the model's file.
    paths : all files that were written.
    as_json : whether to print the model's record instead, as JSON.
    """
    record = fitted.model.record
    if as_json:
        say(json.dumps({"out": str(out), **record}))
        return
    for name, title in TITLES.items():
        if name in record:
            # only the validation part has simulated recordings of pictures
            pictures = record["data"].get("pictures") if name == "validation" else None
            say(f"{title}: {_accuracy(record[name], pictures)}")
    say(
        f"network {record['network']}, {record['multiplications']:,} multiplications a complete "
        f"window; temperature {record.get('temperature', 1):.3f}"
    )
    if fitted.scores is not None:
        _print_classes(fitted.scores)
    if fitted.model.statistics is not None:
        megabytes = fitted.model.statistics.n_bytes / 1e6
        say(f"statistics for `async-tnt teach` are {megabytes:.1f} MB of it (--no-statistics)")
    if "held_out_in_time" in record["data"]:
        say(
            "held out in time: of the sessions that were learned from; only another session tells "
            "how well it works"
        )
    say(f"wrote {', '.join(map(str, paths))}")


def _accuracy(scores: Mapping[str, Any], pictures: Mapping[str, Any] | None) -> str:
    """The accuracy in one part of a model's record, as text.

    Parameters
    ----------
    scores : the part of the record.
    pictures : the record of the pictures, if this part has simulated recordings of pictures.
    """
    if "f1" in scores:
        early_scores = [
            f"{f1:.4f} after {ms} ms" for ms, f1 in scores["f1_against_time_ms"].items()
        ]
        f1_text = f"F1 {scores['f1']:.4f} of {scores['objects']} objects in scenes"
        return f"{f1_text} ({', '.join(early_scores)})" if early_scores else f1_text
    text = f"{scores['per_window']:.4f} of {scores['windows']} windows"
    if "recordings" in scores:
        text += f", {scores['per_recording']:.4f} of {scores['recordings']} recordings"
    if pictures:
        text += f" (simulated ones: of {pictures['held_out']} pictures)"
    return f"{text} right"


def _print_classes(scores: Mapping[str, Any]) -> None:
    """Print how many windows of each class are right, if few recordings of each are held out."""
    n_recordings = [sum(row) for row in scores["confusion"]]
    if max(n_recordings) >= FEW_RECORDINGS:
        return
    for k, name in enumerate(scores["classes"]):
        windows = scores["window_confusion"][k]
        say(
            f"  {name}: {windows[k]} of {sum(windows)} windows of {n_recordings[k]} held-out "
            "recordings right"
        )
