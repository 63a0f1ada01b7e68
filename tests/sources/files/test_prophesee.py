"""Prophesee's formats: words by hand, and words of other kinds."""

import numpy as np
import pytest
from sources.files.written import dat, evt2, evt3, evt21, evt_header, made_events

from async_tnt.kernels.sources.evt import decode_evt2, decode_evt3, decode_evt21
from async_tnt.sources.files import prophesee
from async_tnt.sources.files.recording import open_recording

MAKE = {"2.0": (evt2, "<u4", 28), "2.1": (evt21, "<u8", 60), "3.0": (evt3, "<u2", 12)}
KNOWN = {"2.0": (0, 1, 8), "2.1": (0, 1, 8), "3.0": (0, 2, 3, 4, 5, 6, 8)}
LITTLE = ";endianness=little"
EVENTS = made_events(1_000, step_us=300)


def read(path, data):
    path.write_bytes(data)
    return open_recording(path).read()


@pytest.fixture
def decoded(tmp_path):
    """The events of words by hand, as tuples."""

    def decode(version, words):
        header = evt_header(version, (1 << 16, 1 << 16), LITTLE if version == "2.1" else "")
        return read(
            tmp_path / "a.raw", header + np.array(words, MAKE[version][1]).tobytes()
        ).tolist()

    return decode


@pytest.mark.parametrize("version", MAKE)
def test_other_words_change_nothing(tmp_path, version):
    make, dtype, shift = MAKE[version]
    start = len(evt_header(version, more=LITTLE if version == "2.1" else ""))
    data = make(EVENTS)
    words = np.frombuffer(data[start:], dtype)
    rng = np.random.default_rng(3)
    for kind in sorted(set(range(16)) - set(KNOWN[version])):
        others = rng.integers(0, 1 << shift, 200, dtype=np.uint64) | np.uint64(kind << shift)
        mixed = np.insert(
            words, np.sort(rng.integers(0, len(words) + 1, 200)), others.astype(dtype)
        )
        got = read(tmp_path / "a.raw", data[:start] + mixed.astype(dtype).tobytes())
        np.testing.assert_array_equal(got, EVENTS, err_msg=f"kind {kind}")


@pytest.mark.parametrize("size", [100, 1 << 16])
def test_t0_is_added_in_every_block(tmp_path, monkeypatch, size):
    monkeypatch.setattr(prophesee, "BLOCK_EVENTS", size)
    for name, make in (("a.raw", evt3), ("a.dat", dat)):
        events = read(tmp_path / name, b"% t0 7000000\n" + make(EVENTS))
        np.testing.assert_array_equal(events["t"], EVENTS["t"] + 7_000_000)


# words of EVT3: their kind in the upper four bits
HIGH = 0x8001
LOW = 0x6005
ROW = 0x0009
X5 = 0x2005
BASE7 = 0x3007
VECTOR12 = 0x4001
VECTOR8 = 0x5001


@pytest.mark.parametrize(
    ("words", "events"),
    [
        # before their row, time or base, events are left out
        ([HIGH, X5, ROW, X5], [(4096, 5, 9, 0)]),
        ([HIGH, ROW, VECTOR12, VECTOR8, BASE7, VECTOR12], [(4096, 7, 9, 0)]),
        # The first vector has no row. It is left out, but it moves the base on.
        ([HIGH, BASE7, VECTOR12, ROW, VECTOR12], [(4096, 19, 9, 0)]),
        ([ROW, BASE7 | 0x800, VECTOR8, HIGH, VECTOR12], [(4096, 15, 9, 1)]),
        ([HIGH, 0x0809, X5], [(4096, 5, 9, 0)]),  # bit 11 of a row says which of two cameras
        # cameras repeat TIME_HIGH, which keeps the lower half
        ([HIGH, LOW, ROW, HIGH, X5], [(4101, 5, 9, 0)]),
        (
            [HIGH, 0x6FFF, ROW, X5, 0x8002, X5, 0x6003, X5],
            [(t, 5, 9, 0) for t in (8191, 8192, 8195)],
        ),
        # back
        (
            [0x8005, 0x6001, ROW, X5, 0x8004, 0x6002, X5],
            [(5 << 12 | 1, 5, 9, 0), (4 << 12 | 2, 5, 9, 0)],
        ),
        # The time goes back to the beginning.
        ([0x8005, ROW, X5, 0x8000, X5], [(5 << 12, 5, 9, 0), (0, 5, 9, 0)]),
        # a long pause
        ([HIGH, ROW, X5, 0x8000 | 3000, X5], [(4096, 5, 9, 0), (3000 << 12, 5, 9, 0)]),
        # half a period
        ([0x8000 | 3000, ROW, X5, 0x8000 | 952, X5], [(3000 << 12, 5, 9, 0), (952 << 12, 5, 9, 0)]),
        (
            [HIGH, LOW, ROW, 0x3000 | 100, 0x4801, 0x5081],
            [(4101, x, 9, 0) for x in (100, 111, 112, 119)],
        ),
        # polarity is the base's
        ([HIGH, ROW, BASE7 | 0x800, X5, VECTOR12], [(4096, 5, 9, 0), (4096, 7, 9, 1)]),
        ([HIGH, ROW, 0x3000 | 2036, 0x4800], [(4096, 2047, 9, 0)]),  # the last column
        ([HIGH, ROW, 0x3000 | 2037, 0x4800], [(4096, 2048, 9, 0)]),  # beyond it
        # The columns do not start again at 0.
        ([HIGH, ROW, 0x3000 | 2047, *(5_400 * [0x4000]), 0x4001], [(4096, 65_535, 9, 0)]),
    ],
)
def test_evt3_by_hand(decoded, words, events):
    assert decoded("3.0", words) == events


def test_evt2_by_hand(decoded):
    """A word is an event: polarity, six bits of time, x, y; those before a time are left out."""
    on = 1 << 28 | 5 << 22 | 64 << 11 | 9
    off = 63 << 22 | 2047 << 11 | 2047
    high = 8 << 28 | 1
    assert decoded("2.0", [on, off, high, on, off]) == [(69, 64, 9, 1), (127, 2047, 2047, 0)]
    period = 1 << 28
    last = 8 << 28 | period - 1
    times = [t for t, *_ in decoded("2.0", [last, on, high, on])]
    assert times == [(period - 1) << 6 | 5, (period + 1) << 6 | 5]


def test_evt21_by_hand(decoded):
    """A word has 32 pixels.

    Here it has bits 0, 2 and 31 from x = 64 on, and pixels up to the last column. There is no
    event before the first time.
    """
    high = 0x80000001 << 32
    pixels = (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 1 << 31 | 0b101
    assert decoded("2.1", [pixels, high, pixels]) == [(69, x, 9, 1) for x in (64, 66, 95)]
    last = (1 << 28 | 2016 << 11 | 9) << 32 | 1 << 31
    assert decoded("2.1", [high, last]) == [(64, 2047, 9, 1)]
    assert decoded("2.1", [high, last + (1 << 43)]) == [(64, 2048, 9, 1)]


def test_evt21_without_endianness_is_legacy_only_without_a_format_line(tmp_path):
    little = (0x8 << 60 | 1 << 32, (1 << 28 | 5 << 22 | 64 << 11 | 9) << 32 | 1)
    swapped = [word >> 32 | (word & 0xFFFFFFFF) << 32 for word in little]
    for header, words in (
        (b"% format EVT21;height=720;width=1280\n", little),
        (b"% evt 2.1\n", swapped),
    ):
        assert read(tmp_path / "a.raw", header + np.array(words, "<u8").tobytes()).tolist() == [
            (69, 64, 9, 1)
        ]


@pytest.mark.parametrize(
    ("decode", "words", "most"),
    [
        (decode_evt2, np.full(200, 1 << 28 | 7, np.uint32), 1),
        (decode_evt21, np.tile(np.array([1 << 28 | 7, 0xFFFFFFFF], np.uint32), 100), 32),
        (decode_evt3, np.tile(np.array([0x3000, 0x4FFF], np.uint16), 100), 12),
    ],
)
def test_a_kernel_stops_while_there_is_room_for_a_whole_word(decode, words, most):
    """Numba does not check bounds: a write beyond the columns would change other memory."""
    words.flags.writeable = False
    for size in range(most, most + 70):
        whole = [
            np.full(size + 40, 77, dtype) for dtype in (np.int64, np.uint16, np.uint16, np.uint8)
        ]
        state = np.array([5, 0, 9, -1, 0, 0], np.int64)
        n, done = decode(words, 0, state, *(column[:size] for column in whole))
        assert n == size // most * most and done > 0
        assert all((column[size:] == 77).all() for column in whole)


def test_dat_version_1_by_hand(tmp_path):
    word = np.array([70, 1 << 17 | 200 << 9 | 300], "<u4").tobytes()
    data = b"% Version 1\n% Width 304\n% Height 240\n\x00\x08" + word
    assert read(tmp_path / "a.dat", data).tolist() == [(70, 300, 200, 1)]


def test_a_header_may_be_in_capitals(tmp_path):
    header = evt_header("3.0")
    data = header.upper() + evt3(EVENTS)[len(header) :]
    np.testing.assert_array_equal(read(tmp_path / "a.raw", data), EVENTS)


def test_what_follows_the_end_of_a_header_is_no_line_of_it(tmp_path):
    """Words whose bytes are `% ab` and a line end: of another kind, a time and an event."""
    words = np.array([0x62612025, 8 << 28 | 10, 1 << 28 | 5 << 22 | 64 << 11 | 9], "<u4")
    data = evt_header("2.0") + words.tobytes()
    assert read(tmp_path / "a.raw", data).tolist() == [(645, 64, 9, 1)]


@pytest.mark.parametrize(
    ("lines", "sensor"),
    [
        (["geometry 640x480", "format EVT3;height=240;width=320", "Width 34"], (640, 480)),
        (["format EVT3;height=240;width=320", "Width 34", "Height 34"], (320, 240)),
        (["format EVT3;height=240", "Width 60", "Height 48"], (60, 48)),
        (["format EVT3", "Width 60"], None),
    ],
)
def test_the_sensor_is_that_of_geometry_then_of_the_format_then_of_sides(tmp_path, lines, sensor):
    header = "".join(f"% {line}\n" for line in ["evt 3.0", *lines])
    (tmp_path / "a.raw").write_bytes(header.encode())
    assert open_recording(tmp_path / "a.raw").sensor == sensor


def test_a_dat_file_without_a_version_is_of_the_second(tmp_path):
    data = dat(EVENTS).replace(b"% Version 2\n", b"")
    np.testing.assert_array_equal(read(tmp_path / "a.dat", data), EVENTS)


@pytest.mark.parametrize(("kind", "size"), [(0x0E, 8), (0x0C, 16), (0x01, 8)])
def test_a_dat_file_of_other_events_is_refused(tmp_path, kind, size):
    data = dat(EVENTS).replace(b"\x0c\x08", bytes([kind, size]), 1)
    with pytest.raises(ValueError, match=rf"events, 0 or 12, .* 8; got \[{kind}, {size}\]$"):
        read(tmp_path / "a.dat", data)


def test_a_header_may_name_its_format_late_and_end_its_lines_with_a_return(tmp_path):
    header = evt_header("3.0")
    notes = b"".join(b"%% note %d\n" % k for k in range(100))
    data = (notes + header).replace(b"\n", b"\r\n") + evt3(EVENTS)[len(header) :]
    np.testing.assert_array_equal(read(tmp_path / "a.raw", data), EVENTS)


@pytest.mark.parametrize(
    ("line", "is_text"),
    [
        (b"% \xe9\xe9" + b"a" * 12, True),  # two bytes of sixteen: text in some other encoding
        (b"% \xe9\xe9\xe9" + b"a" * 11, False),
        ("% ééé".encode(), True),  # any number of them, where they are UTF-8
        ("% 9\xa0V".encode(), True),
        (b"% \x07" + b"a" * 13, False),
    ],
)
def test_a_line_of_a_header_is_text_in_any_encoding(tmp_path, line, is_text):
    data = line + b"\n" + dat(EVENTS)
    if is_text:
        np.testing.assert_array_equal(read(tmp_path / "a.dat", data), EVENTS)
        return
    with pytest.raises(ValueError, match="after the header there must be a type of events"):
        read(tmp_path / "a.dat", data)


def test_a_line_that_is_longer_than_any_header_is_no_line_of_it(tmp_path):
    """Its bytes are words: an event before the first time, then times."""
    data = b"% evt 3.0\n% " + b"a" * prophesee.MAX_HEADER_BYTES
    with pytest.raises(ValueError, match="1 words of events have no time or no row"):
        read(tmp_path / "a.raw", data)
