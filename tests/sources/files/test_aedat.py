"""AEDAT 3.1: packets that are longer than what is read together, and headers that cannot be."""

import struct

import numpy as np
import pytest
from sources.files.written import aedat3, made_events

from async_tnt.sources.files import aedat
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording

EVENTS = made_events(60, sensor=(240, 180))


@pytest.mark.parametrize("size", [1, 4, 5, 6, 7, 100])
def test_a_packet_may_be_longer_than_a_block(tmp_path, monkeypatch, size):
    """Packets of seven events; the last one is cut within its fourth."""
    monkeypatch.setattr(aedat, "BLOCK_EVENTS", size)
    data = aedat3(EVENTS)
    path = tmp_path / "a.aedat"
    path.write_bytes(data)
    np.testing.assert_array_equal(open_recording(path).read(), EVENTS)
    path.write_bytes(data[: -36 - 8 * 3 - 2])
    with pytest.warns(DamagedRecording, match="ends within a packet, which has 4 more events"):
        np.testing.assert_array_equal(open_recording(path).read(), EVENTS[:-3])


@pytest.mark.parametrize(
    ("header", "problem"),
    [
        ((-1, 1, 8, 4, 0, 1, 1, 1), "type -1, 1 events of 8 bytes, time at byte 4, 0 overflows"),
        ((2, 1, -8, 4, 0, 1, 1, 1), "type 2, 1 events of -8 bytes"),
        ((1, 1, 8, 4, -1, 1, 1, 1), "time at byte 4, -1 overflows"),
        ((2, 1, 8, 4, 0, 1, -1, 1), "type 2, -1 events"),
        ((1, 1, 12, 4, 0, 1, 1, 1), "type 1, 1 events of 12 bytes"),
        ((1, 1, 8, 0, 0, 1, 1, 1), "time at byte 0"),
    ],
)
def test_a_packet_with_an_impossible_header_is_damage(tmp_path, header, problem):
    data = aedat3(EVENTS)
    (tmp_path / "a.aedat").write_bytes(data + struct.pack("<hhiiiiii", *header) + bytes(100))
    message = rf"the packet at byte {len(data)} has no valid header: .*{problem}"
    with pytest.warns(DamagedRecording, match=message):
        np.testing.assert_array_equal(open_recording(tmp_path / "a.aedat").read(), EVENTS)
