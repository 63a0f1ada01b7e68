"""Event Stream files, which faery reads: rows count from the bottom there, and ATIS events may be exposures."""

import numpy as np
import pytest

from async_tnt.sources.files.recording import open_recording

pytest.importorskip("faery", reason="ES needs faery")


def test_atis_events_of_changing_light_by_hand(tmp_path):
    header = b"Event Stream\x02\x00\x00\x02" + np.array([320, 240], "<u2").tobytes()
    pixel = np.array([4, 0], "<u2").tobytes()  # y = 0 is the lowest row
    body = b"\xfd\xfe" + bytes([5 << 2 | 2]) + pixel + bytes([1 << 2 | 1]) + pixel + bytes([1 << 2]) + pixel
    (tmp_path / "a.es").write_bytes(header + body)
    recording = open_recording(tmp_path / "a.es")
    assert recording.read().tolist() == [(194, 4, 239, 1), (196, 4, 239, 0)] and recording.sensor == (320, 240)


def test_events_that_are_neither_dvs_nor_atis_are_refused(tmp_path):
    (tmp_path / "a.es").write_bytes(b"Event Stream\x02\x00\x00\x00")
    with pytest.raises(ValueError, match=r"a\.es: not a readable ES file: expected DVS or ATIS events, got generic"):
        open_recording(tmp_path / "a.es")
