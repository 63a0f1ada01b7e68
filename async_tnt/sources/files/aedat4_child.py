"""Reads an AEDAT4 file with faery, in the process of `child_end.py`; see `aedat4.py`.

It says `sensor`: [width, height], or null. A packet is its events, as `DTYPE`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

DTYPE = np.dtype([("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("p", "u1")])


def write_events(path: str, out: Any) -> None:
    """Tell an `Out` what the file holds, and then the error if there is one."""
    from faery.extension import aedat

    try:
        decoder = aedat.Decoder(path)
        tracks = decoder.tracks()
    except BaseException as error:  # pyo3's PanicException derives from BaseException alone
        return out.end(f"not a readable AEDAT4 file: {_told(error)}")
    track = next((track for track in tracks if track.data_type == "events"), None)
    if track is None:
        kinds = ", ".join(track.data_type for track in tracks) or "none"
        return out.end(f"the file must have a stream of events; its streams are: {kinds}")
    out.open(sensor=None if track.dimensions is None else [int(side) for side in track.dimensions])
    try:
        for found, packet in decoder:
            if found.id != track.id or found.data_type != "events" or len(packet) == 0:
                continue
            events = np.empty(len(packet), DTYPE)
            for ours, theirs in (("t", "t"), ("x", "x"), ("y", "y"), ("p", "on")):
                events[ours] = packet[theirs]
            out.packet(len(events), events.tobytes())
    except BrokenPipeError:
        raise
    except BaseException as error:
        return out.end(_told(error))
    return out.end()


def _told(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
