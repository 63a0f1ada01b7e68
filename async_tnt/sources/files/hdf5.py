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

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from async_tnt.sources.files.child import ChildSource
from async_tnt.sources.files.source import Source, packed


class Hdf5Source(ChildSource):
    """The events of an HDF5 file in DSEC's or Metavision's layout.

    Raises
    ------
    ImportError : h5py is not installed.
    ValueError : no HDF5 file, another layout, or a filter that is not installed.
    """

    event_bytes = 0  # known when the file is open

    def __init__(self, path: Path) -> None:
        if find_spec("h5py") is None:
            raise ImportError(f"{path}: HDF5 files are read by h5py, which is missing: pip install '.[hdf5]'")
        super().__init__(path, "hdf5_child.py")
        self._types = [np.dtype(name) for name in self.said["types"]]
        self._offset_us = int(self.said["offset"])
        self.event_bytes = sum(dtype.itemsize for dtype in self._types)

    def decoded(self, data: bytes) -> tuple[np.ndarray, str | None]:
        """Four columns, one after the other."""
        n = len(data) // self.event_bytes
        columns, at = [], 0
        for dtype in self._types:
            columns.append(np.frombuffer(data, dtype, n, at))
            at += n * dtype.itemsize
        t = columns[0].astype(np.int64)
        if columns[0].dtype.kind == "u" and (t < 0).any():  # beyond int64
            t = np.where(t < 0, -1 - abs(self._offset_us), t)
        return packed(t + self._offset_us, *columns[1:])


def open_hdf5(path: Path) -> Source:
    """Open an HDF5 file of events."""
    return Hdf5Source(path)
