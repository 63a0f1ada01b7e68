"""Compare the stream with the batch reference on one recording: the volumes agree to about the last
float32 digit.

The stream processes one event after another. The reference (package `tnt_reference`, torch)
computes the equations as they are written, from all events of a window at once. `async-tnt check`
does this for every landmark, at prefixes of each window, and for the network.
"""

import numpy as np
import tnt_reference

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

config = async_tnt.TNTConfig(landmark="line", t_max=2.0)
events = open_recording(sample_recordings()[5]).read()
start_us = int(events["t"][0])
window = events[events["t"] < start_us + config.window_us]

volume = async_tnt.TNTVolume(config)
volume.open(start_us)
for t, x, y, p in window.tolist():
    volume.update_one(t, x, y, p)
stream = volume.array

batch = tnt_reference.tnt_volume(
    window["t"],
    window["x"],
    window["y"],
    window["p"],
    start_us=start_us,
    window_us=config.window_us,
    sensor=config.sensor,
    grid=config.grid,
    bins=config.bins,
    t_max=config.t_max,
    landmark=config.landmark,
).numpy()

largest = np.abs(batch).max()
difference = np.abs(stream - batch).max()
print(f"{len(window)} events, one by one and at once: volumes of shape {stream.shape}")
print(
    f"largest cell {largest:.4f}, largest difference {difference:.1e}, {np.count_nonzero(batch)} "
    "cells in use"
)
assert largest > 0
assert difference <= 1e-6 * largest
