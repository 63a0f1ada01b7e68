"""What a stream leaves in a processor, as bytes, and back: windows, triggers and door."""

from __future__ import annotations

from typing import Any

import numpy as np

from .events import EventDoor
from .open_windows import OpenWindows
from .snapshot import Arrays, from_bytes, part, to_bytes, under
from .triggers import LeakyIntegrator, Triggers


def save_stream(fixed: dict[str, Any], windows: OpenWindows, triggers: Triggers, door: EventDoor) -> bytes:
    """All of it. `fixed`: settings that must be the same where the stream goes on."""
    arrays = windows.snapshot() | under("triggers", triggers.snapshot())
    arrays["door"] = np.array((door.newest_us, door.n_dropped), np.int64)
    return to_bytes(arrays, {"fixed": fixed, "triggers": triggers.settings()})


def read_stream(state: bytes, fixed: dict[str, Any]) -> tuple[Arrays, dict[str, Any]]:
    """The arrays, and the triggers' settings.

    Raises
    ------
    ValueError : no such state, damaged, or with other fixed settings; the message names them.
    """
    arrays, about = from_bytes(state)
    theirs = about["fixed"]
    wrong = [f"{name} = {theirs.get(name)}" for name in fixed if theirs.get(name) != fixed[name]]
    if wrong:
        raise ValueError(f"`state` is of another processor, with {', '.join(wrong)}; here {fixed}")
    activity = about["triggers"]["activity"]
    return arrays, about["triggers"] | {"activity": None if activity is None else LeakyIntegrator(**activity)}


def restore_stream(
    arrays: Arrays, settings: dict[str, Any], windows: OpenWindows, triggers: Triggers, door: EventDoor
) -> None:
    """Put it back.

    Raises
    ------
    KeyError, ValueError : it does not fit; some of it is put back then.
    """
    windows.restore(arrays)
    triggers.set(**settings)
    triggers.restore(part("triggers", arrays))
    door.newest_us, door.n_dropped = arrays["door"].tolist()
