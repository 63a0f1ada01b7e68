"""Times that a cable garbled: left out and counted; what a camera may send stays."""

from itertools import islice

import numpy as np
import pytest
from cameras.made_devices import RECORD, PlayedDevice, drivers, found, made_events
from hypothesis import given, settings
from hypothesis import strategies as st

import async_tnt
from async_tnt.cameras import open_camera
from async_tnt.cameras.continuous_time import RESTART_US
from async_tnt.cameras.garbled_times import LATEST_US, SILENCE_US, without_garbled_times
from async_tnt.recordings import open_recording, sample_recordings

SIGNED = np.dtype({"names": ["timestamp", "x"], "formats": ["<i8", "<i2"], "offsets": [0, 8], "itemsize": 16})
S = 1_000_000


def kept_of(times, newest_us=None, dtype=RECORD):
    events = np.zeros(len(times), dtype)
    events[dtype.names[0]] = times
    kept = without_garbled_times(events, dtype.names[0], newest_us)
    return kept[dtype.names[0]].tolist(), kept is events


@pytest.mark.parametrize("place", [0, 10, 100, -1])
@pytest.mark.parametrize("number", [0, 3, 19])
@pytest.mark.parametrize("bit", [21, 30, 40, 52, 53, 61, 62, 63])
def test_one_garbled_time_changes_no_decision(number, place, bit):
    """Wherever it is, and whichever bit flipped; the event itself is lost."""
    if (place, bit) in ((-1, 21), (-1, 30)):
        pytest.skip("below, as a jump at a packet's end")
    events = open_recording(sample_recordings()[3]).read()
    packets = []
    for part in np.array_split(events, 20):
        packets.append(np.empty(len(part), RECORD))
        for field, ours in (("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")):
            packets[-1][field] = part[ours]
    packets[number]["t"][place] |= np.uint64(1 << bit)
    labels, n_last = [], []
    for played in (packets, list(np.array_split(np.delete(np.concatenate(packets), np.concatenate(packets)["t"].argmax()), 20))):
        device = PlayedDevice([packet.copy() for packet in played])
        with open_camera(drivers=drivers(found(device))) as camera:
            processor = async_tnt.Processor(async_tnt.load_model("digits"))
            decisions = [decision for packet in islice(camera, 20) for decision in processor.push(packet)]
            decisions += processor.finish()
        labels.append([(decision.label, decision.time_us, decision.logits.tobytes()) for decision in decisions])
        n_last.append((camera.counts.garbled_times, camera.counts.clock_restarts, processor.counts.received))
    assert labels[0] == labels[1] and len(labels[0]) == 3
    assert n_last == [(1, 0, len(events) - 1), (0, 0, len(events) - 1)]
