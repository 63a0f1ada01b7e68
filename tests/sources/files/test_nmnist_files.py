"""N-MNIST's five-byte format: bytes by hand, round trips, overflow rows, damage."""

import numpy as np
import pytest

from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.volume.events import EVENT_DTYPE
from experiments.digit_data.nmnist_files import write_nmnist

EVENT = bytes([1, 2, 0x80, 0, 100])
"""An ON event at x = 1, y = 2, 100 us."""

OVERFLOW = bytes([49, 240, 0, 0, 100])
"""A row that marks an overflow of the timer."""


def test_bytes_by_hand(tmp_path):
    """The first event is at 0x012345 = 74565 us, OFF.

    The second one is at 0x7FFFFF us, the last time there is, ON. Its bits 7 and 6-0 are all
    set.
    """
    data = bytes([3, 33, 0x01, 0x23, 0x45, 33, 0, 0xFF, 0xFF, 0xFF])
    events = np.array([(74565, 3, 33, 0), (8_388_607, 33, 0, 1)], EVENT_DTYPE)
    write_nmnist(tmp_path / "a.bin", events)
    assert (tmp_path / "a.bin").read_bytes() == data
    assert read_nmnist(tmp_path / "a.bin").tolist() == events.tolist()


def test_overflow_rows_add_8192_us_to_all_that_follows_and_vanish(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(EVENT + OVERFLOW + EVENT + EVENT + OVERFLOW * 2 + EVENT)
    assert read_nmnist(path).tolist() == [(100 + 8192 * k, 1, 2, 1) for k in (0, 1, 1, 3)]
    path.write_bytes(OVERFLOW * 3)
    assert len(read_nmnist(path)) == 0
    path.write_bytes(OVERFLOW * 600_000 + EVENT)  # past 2^32
    assert read_nmnist(path)["t"].tolist() == [600_000 * 8192 + 100]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            EVENT * 3 + EVENT[:2],
            r"the size must be a multiple of 5 bytes .* got 17: .* 2 bytes into row 3",
        ),
        (
            EVENT * 2 + bytes([1, 1, 0, 0, 99]) + EVENT,
            r"event 2: `t` must .*, got 99 us after 100 us \(byte 10\)",
        ),
    ],
)
def test_damage_names_its_place(tmp_path, data, message):
    (tmp_path / "a.bin").write_bytes(data)
    line = rf"a\.bin: damaged N-MNIST recording of {len(data)} bytes: .*{message}\. Fetch the file"
    with pytest.raises(ValueError, match=line):
        read_nmnist(tmp_path / "a.bin")
