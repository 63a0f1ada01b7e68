"""Words of Prophesee's formats that are no event and no time, anywhere between the others: passed over."""

import numpy as np
import pytest
from recordings.written import evt2, evt3, evt21, evt_header, made_events

from async_tnt.kernels.evt import FINE, decode_evt2, decode_evt3, decode_evt21
from async_tnt.sources.files.recording import open_recording

MAKE = {"2.0": (evt2, "<u4", 28), "2.1": (evt21, "<u8", 60), "3.0": (evt3, "<u2", 12)}
KNOWN = {"2.0": (0, 1, 8), "2.1": (0, 1, 8), "3.0": (0, 2, 3, 4, 5, 6, 8)}
EVENTS = made_events(1_000, step_us=300)


@pytest.mark.parametrize("version", MAKE)
def test_other_words_change_nothing(tmp_path, version):
    make, dtype, shift = MAKE[version]
    more = ";endianness=little" if version == "2.1" else ""
    start = len(evt_header(version, more=more))
    data = make(EVENTS)
    words = np.frombuffer(data[start:], dtype)
    rng = np.random.default_rng(3)
    for kind in sorted(set(range(16)) - set(KNOWN[version])):
        others = rng.integers(0, 1 << shift, 200, dtype=np.uint64) | np.uint64(kind << shift)
        mixed = np.insert(words, np.sort(rng.integers(0, len(words) + 1, 200)), others.astype(dtype))
        (tmp_path / "a.raw").write_bytes(data[:start] + mixed.astype(dtype).tobytes())
        np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read(), EVENTS, err_msg=f"kind {kind}")


def written(path, version, words, more=""):
    path.write_bytes(evt_header(version, (2048, 2048), more) + np.array(words, MAKE[version][1]).tobytes())
    return open_recording(path).read().tolist()


def test_evt3_words_before_their_row_time_or_base_are_left_out(tmp_path):
    path = tmp_path / "a.raw"
    event, vector12, vector8, row, high = 0x2005, 0x4001, 0x5001, 0x0009, 0x8001
    assert written(path, "3.0", [high, event, row, event]) == [(4096, 5, 9, 0)]  # no row
    assert written(path, "3.0", [row, event, high, event]) == [(4096, 5, 9, 0)]  # no time
    assert written(path, "3.0", [high, row, vector12, vector8, 0x3007, vector12]) == [(4096, 7, 9, 0)]  # no base
    assert written(path, "3.0", [high, 0x3007, vector12, row, vector12]) == [(4096, 19, 9, 0)]  # base moves on
    assert written(path, "3.0", [row, 0x3807, vector8, high, vector12]) == [(4096, 15, 9, 1)]


def test_evt21_pixels_before_the_first_time_are_left_out(tmp_path):
    pixels, high = (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 0b11, 0x80000001 << 32
    got = written(tmp_path / "a.raw", "2.1", [pixels, high, pixels], ";endianness=little")
    assert got == [(69, 64, 9, 1), (69, 65, 9, 1)]


@pytest.mark.parametrize("version", MAKE)
def test_t0_is_added(tmp_path, version):
    make = MAKE[version][0]
    data = make(EVENTS).replace(b"% end\n", b"% t0 7000000\n% end\n")
    (tmp_path / "a.raw").write_bytes(data)
    np.testing.assert_array_equal(open_recording(tmp_path / "a.raw").read()["t"], EVENTS["t"] + 7_000_000)


def test_vectors_reach_the_last_column_and_not_beyond(tmp_path):
    path = tmp_path / "a.raw"
    assert written(path, "3.0", [0x8001, 0x0009, 0x3000 | 2036, 0x4800]) == [(4096, 2047, 9, 0)]
    word = (1 << 28 | 2016 << 11 | 9) << 32 | 1 << 31
    assert written(path, "2.1", [0x80000001 << 32, word], ";endianness=little") == [(64, 2047, 9, 1)]
    with pytest.warns(UserWarning, match="reaches beyond x = 2047"):
        assert written(path, "2.1", [0x80000001 << 32, word + (1 << 43)], ";endianness=little") == []
    with pytest.warns(UserWarning, match="reaches beyond x = 2047"):
        assert written(path, "3.0", [0x8001, 0x0009, 0x3000 | 2037, 0x4800]) == []


def test_evt21_without_endianness_is_legacy_only_without_a_format_line(tmp_path):
    little = (0x8 << 60 | 1 << 32, (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 1)
    swapped = [word >> 32 | (word & 0xFFFFFFFF) << 32 for word in little]
    for header, words in ((b"% format EVT21;height=720;width=1280\n", little), (b"% evt 2.1\n", swapped)):
        (tmp_path / "a.raw").write_bytes(header + np.array(words, "<u8").tobytes())
        assert open_recording(tmp_path / "a.raw").read().tolist() == [(69, 64, 9, 1)]


@pytest.mark.parametrize(("decode", "most"), [(decode_evt2, 1), (decode_evt21, 32), (decode_evt3, 12)])
def test_a_kernel_stops_while_there_is_room_for_a_whole_word(decode, most):
    """Numba does not check bounds: what were written beyond the columns would be somebody else's."""
    if decode is decode_evt2:
        words = np.full(200, 1 << 28 | 7, np.uint32)
    elif decode is decode_evt21:
        words = np.tile(np.array([1 << 28 | 7, 0xFFFFFFFF], np.uint32), 100)
    else:
        words = np.tile(np.array([0x3000, 0x4FFF], np.uint16), 100)
    words.flags.writeable = False
    for size in range(most, most + 70):
        whole = [np.full(size + 40, 77, dtype) for dtype in (np.int64, np.uint16, np.uint16, np.uint8)]
        state = np.array([5, 0, 9, -1, 0, 0], np.int64)
        n, done, status = decode(words, 0, state, *(column[:size] for column in whole))
        assert (n, status) == (size // most * most, FINE) and done > 0
        assert all((column[size:] == 77).all() for column in whole)


def test_evt3_rows_are_of_whichever_camera(tmp_path):
    """Bit 11 of a row says master or slave of two cameras."""
    assert written(tmp_path / "a.raw", "3.0", [0x8001, 0x0809, 0x2005]) == [(4096, 5, 9, 0)]


def test_evt3_a_time_high_said_again_changes_nothing(tmp_path):
    """Cameras repeat it; the lower half stays as it was."""
    assert written(tmp_path / "a.raw", "3.0", [0x8001, 0x6005, 0x0009, 0x8001, 0x2005]) == [(4101, 5, 9, 0)]
