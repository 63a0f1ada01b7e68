"""Every bit of a place that a format has is read: events in all corners of the largest sensor it can say."""

import numpy as np
import pytest
from recordings.damaging import EVERY_WRITER
from recordings.written import made_events

from async_tnt.sources.files.recording import open_recording

LARGEST = {
    "evt2.raw": (2048, 2048),
    "evt21.raw": (2048, 2048),
    "legacy.raw": (2048, 2048),
    "evt3.raw": (2048, 2048),
    "v2.dat": (1 << 14, 1 << 14),
    "v1.dat": (512, 256),
    "dvs.es": (65535, 65535),
    "atis.es": (65535, 65535),
    "uzh.txt": (65536, 65536),
    "plain.csv": (65536, 65536),
    "records.npy": (65536, 65536),
    "columns.npy": (65536, 65536),
    "plain.npz": (65536, 65536),
    "dsec.h5": (65536, 65536),
    "metavision.hdf5": (65536, 65536),
    "dv.aedat4": (32767, 32767),  # its places are of 16 bits, signed
}


@pytest.mark.parametrize("name", LARGEST)
def test_every_bit_of_a_place_is_read(tmp_path, name):
    width, height = LARGEST[name]
    events = made_events(300, sensor=(width, height))
    corners = events[:4]
    corners["x"], corners["y"] = [0, width - 1, 0, width - 1], [0, 0, height - 1, height - 1]
    for i in range(16):  # one bit alone
        events["x"][10 + i], events["y"][40 + i] = (1 << i) % width, (1 << i) % height
    EVERY_WRITER[name](tmp_path / name, events, (width, height))
    np.testing.assert_array_equal(open_recording(tmp_path / name).read(), events)
