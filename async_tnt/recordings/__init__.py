"""Read recordings of events from files, of any camera: see docs/formats.md for which, and `READERS` for suffixes.

A further format is one more entry in `READERS`: its suffix, and a function from a path to a `Source`, or to the
events and the sensor's `(width, height)`, or None where the file does not say it.
"""

from async_tnt.recordings.damage import Damage, DamagedRecording
from async_tnt.recordings.fitting import check_sensor, open_for
from async_tnt.recordings.formats import READERS
from async_tnt.recordings.nmnist import read_nmnist, write_nmnist
from async_tnt.recordings.recording import Recording, open_recording, sample_recordings
from async_tnt.recordings.source import Source

__all__ = [
    "READERS",
    "Damage",
    "DamagedRecording",
    "Recording",
    "Source",
    "check_sensor",
    "open_for",
    "open_recording",
    "read_nmnist",
    "sample_recordings",
    "write_nmnist",
]
