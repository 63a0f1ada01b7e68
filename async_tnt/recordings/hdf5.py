"""HDF5 files of events (`.h5`, `.hdf5`), by h5py (extra `hdf5`), in one of two layouts.

DSEC         events/t, x, y, p: a data set each; t_offset: microseconds to add to t. `ms_to_idx` is not needed here.
Metavision   CD/events: records of x, y, p, t; the sensor as an attribute, `geometry` = "1280x720".

Both are compressed by filters that HDF5 does not bring along: DSEC by Blosc (`pip install hdf5plugin`),
Metavision by ECF (the plugin of Prophesee's hdf5_ecf, which HDF5_PLUGIN_PATH has to name).

h5py runs in a process of its own: of a damaged file, Blosc's decoder can crash it, and HDF5 itself read for ever.

References
----------
Gehrig, Aarents, Gehrig, Scaramuzza 2021, DSEC: A Stereo Event Camera Dataset for Driving Scenarios, RA-L.
Prophesee, Metavision documentation: HDF5 event file format.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from async_tnt.recordings.child import child_process
from async_tnt.recordings.damage import Damage
from async_tnt.recordings.source import Source, packed

SCRIPT = "hdf5_child.py"


class Hdf5Source(Source):
    """The events of an HDF5 file in DSEC's or Metavision's layout.

    Raises
    ------
    ImportError : h5py is not installed.
    ValueError : no HDF5 file, another layout, or a filter that is not installed.
    """

    def __init__(self, path: Path) -> None:
        if find_spec("h5py") is None:
            raise ImportError(f"{path}: HDF5 files are read by h5py, which is missing: pip install '.[hdf5]'")
        self.path = path
        path.open("rb").close()  # so that a missing file is an OSError
        with child_process(SCRIPT, str(path)) as child:
            said = child.said()
        if "error" in said:
            raise ValueError(f"{path}: {said['error']}")
        self.sensor = None if said["sensor"] is None else (said["sensor"][0], said["sensor"][1])
        self._types = [np.dtype(name) for name in said["types"]]
        self._offset_us = int(said["offset"])

    def blocks(self) -> Iterator[np.ndarray]:
        sizes = [dtype.itemsize for dtype in self._types]
        n_read = 0
        with child_process(SCRIPT, str(self.path)) as child:
            said = child.said()
            if "error" in said:
                raise Damage(f"after event 0: {said['error']}")
            for data in child.packets(sum(sizes)):
                if isinstance(data, str):
                    raise Damage(f"after event {n_read}: {data}")
                n = len(data) // sum(sizes)
                starts = [n * sum(sizes[:i]) for i in range(len(sizes))]
                columns = [np.frombuffer(data, dtype, n, at) for dtype, at in zip(self._types, starts, strict=True)]
                t = columns[0].astype(np.int64)
                if columns[0].dtype.kind == "u" and (t < 0).any():  # beyond int64
                    t = np.where(t < 0, -1 - abs(self._offset_us), t)
                events, problem = packed(t + self._offset_us, *columns[1:])
                yield events
                n_read += len(events)
                if problem is not None:
                    raise Damage(f"event {n_read}: {problem}")


def open_hdf5(path: Path) -> Source:
    """Open an HDF5 file of events."""
    return Hdf5Source(path)
