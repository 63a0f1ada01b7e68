"""Read recordings of events from files: N-MNIST's `.bin`, NumPy's `.npy` and `.npz`, and the bundled samples.

A further format is one more entry in `READERS`: its suffix, and a function from a path to the events and the
sensor's `(width, height)`, or None where the file does not say it.
"""

from async_tnt.recordings.nmnist import read_nmnist, write_nmnist
from async_tnt.recordings.recording import READERS, Recording, open_recording, sample_recordings

__all__ = ["READERS", "Recording", "open_recording", "read_nmnist", "sample_recordings", "write_nmnist"]
