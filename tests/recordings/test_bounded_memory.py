"""Reading a long file takes no more memory than reading a short one."""

import tracemalloc

import numpy as np
import pytest
from numba import config
from recordings.written import WRITERS, made_events

from async_tnt.sources.files.recording import open_recording

N_EVENTS = 1_000_000
BLOCK = made_events(100_000, step_us=4)


def long_file(path):
    """The same events ten times over: writing text of two million different ones takes longer than reading it."""
    if path.suffix in (".txt", ".csv"):
        WRITERS[path.name](path, BLOCK)
        head, rows = path.read_bytes().split(b"\n", 1)
        path.write_bytes(head + b"\n" + rows * (N_EVENTS // len(BLOCK)))
    else:
        events = np.tile(BLOCK, N_EVENTS // len(BLOCK))
        events["t"] = np.sort(events["t"])
        how = {"chunks": (10_000,)} if path.suffix in (".h5", ".hdf5") else {}
        WRITERS[path.name](path, events, **how)


@pytest.mark.skipif(config.DISABLE_JIT, reason="a million events in Python take minutes")
@pytest.mark.parametrize(
    "name", ["uzh.txt", "plain.csv", "v2.dat", "evt3.raw", "dv.aedat4", "dsec.h5", "metavision.hdf5"]
)
def test_memory_does_not_grow_with_the_file(tmp_path, name):
    path = tmp_path / name
    long_file(path)
    next(iter(open_recording(path)))  # compiles and imports
    tracemalloc.start()
    try:
        n = sum(len(packet) for packet in open_recording(path))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert n == N_EVENTS
    assert peak < 8e6 < N_EVENTS * 13  # what all events would take
