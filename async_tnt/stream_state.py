"""What a stream leaves in a processor, as bytes, and back: windows, triggers and door."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from async_tnt.events import EventDoor
from async_tnt.kernels.records import MAX_TIME_US
from async_tnt.snapshot import MAX_EVENTS, Arrays, from_bytes, part, taken, to_bytes, under
from async_tnt.triggers import LeakyIntegrator, Triggers
from async_tnt.windows import OpenWindows

TRIGGERS = ("every_us", "every_events", "confidence", "activity")


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
    try:
        theirs, settings = about["fixed"], {name: about["triggers"][name] for name in TRIGGERS}
        wrong = [f"{name} = {reprlib.repr(theirs.get(name))}" for name in fixed if theirs.get(name) != fixed[name]]
        if settings["activity"] is not None:
            settings["activity"] = LeakyIntegrator(**settings["activity"])
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"`state` does not say its settings: {error!r}") from None
    if wrong:
        raise ValueError(f"`state` is of another processor, with {', '.join(wrong)}; here {fixed}")
    return arrays, settings


def restore_stream(
    arrays: Arrays, settings: dict[str, Any], windows: OpenWindows, triggers: Triggers, door: EventDoor
) -> None:
    """Put it back.

    Raises
    ------
    TypeError, ValueError : it does not fit; some of it is put back then.
    """
    windows.restore(arrays)
    triggers.set(**settings)
    triggers.restore(part("triggers", arrays))
    if len(windows):
        windows.limit(triggers.due_us)
    newest_us, n_dropped = taken(arrays, "door", np.int64, (2,)).tolist()
    if not (-1 <= newest_us < MAX_TIME_US and 0 <= n_dropped <= MAX_EVENTS):
        raise ValueError(f"its newest event cannot be at {newest_us} us, after {n_dropped} dropped ones")
    door.newest_us, door.n_dropped = newest_us, n_dropped
