"""Laws of every format.

What its writer writes is read back, event for event, however it is cut into packets.
"""

import os
import struct
import tracemalloc
from itertools import permutations

import numpy as np
import pytest
from sources.files.ros_written import Bag, unpacked
from sources.files.written import (
    FORMATS,
    SENSOR,
    aedat2,
    aedat3,
    dat,
    dsec,
    evt2,
    evt3,
    evt21,
    evt_header,
    made_events,
    written,
)

from async_tnt.sources.files import aedat, prophesee, text_files
from async_tnt.sources.files.recording import open_recording
from async_tnt.volume.events import EVENT_DTYPE
from experiments.digit_data.nmnist_files import write_nmnist


def sensor_for(name):
    return tuple(np.minimum(SENSOR, FORMATS[name].largest).tolist())


# (events, events of a packet)
CUTS = [(0, 1000), (140_000, 70_000)]
MORE_CUTS = [(150, 1), (150, 100)]


@pytest.mark.parametrize(
    ("name", "n", "packet_events"),
    [
        (name, *cut)
        for name in sorted(FORMATS)
        for cut in (CUTS if FORMATS[name].in_worker else CUTS + MORE_CUTS)
    ],
)
def test_events_are_read_back_in_any_packets_which_are_the_callers_own(
    tmp_path, name, n, packet_events
):
    sensor = sensor_for(name)
    events = made_events(140_000, sensor=sensor, step_us=4)[:n]  # two blocks and more
    events["t"][70_000:] += 3_000_000
    recording = open_recording(
        written(tmp_path / name, events, sensor), packet_events=packet_events
    )
    packets = list(recording)
    assert len(packets) == len(recording) == -(-n // packet_events)
    assert all(len(packet) == packet_events for packet in packets[:-1])
    got = np.concatenate([np.empty(0, EVENT_DTYPE), *packets])
    np.testing.assert_array_equal(got, events)
    assert recording.n_events == n and recording.format
    assert recording.duration_us == (events["t"][-1] - events["t"][0] if n else 0)
    assert recording.sensor == (sensor if FORMATS[name].states_sensor else None)
    for packet in packets:
        packet["t"] = -1
    if packet_events < 150:  # an array in memory may be read again
        np.testing.assert_array_equal(recording.read(), events)


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_every_bit_of_a_pixel_is_read(tmp_path, name):
    """Events in all corners of the largest sensor that the format can say.

    Other events have one bit alone.
    """
    width, height = FORMATS[name].largest
    events = made_events(300, sensor=(width, height))
    events["x"][:4] = [0, width - 1, 0, width - 1]
    events["y"][:4] = [0, 0, height - 1, height - 1]
    for i in range(16):
        events["x"][10 + i] = (1 << i) % width
        events["y"][40 + i] = (1 << i) % height
    path = written(tmp_path / name, events, (width, height))
    capitals = tmp_path / name.upper()
    if not capitals.exists():  # a file system may not tell them apart
        capitals.symlink_to(path)
    np.testing.assert_array_equal(open_recording(capitals).read(), events)


SMALL = (128, 128)
ORDERS = ["".join(order) for order in permutations("txyp")]


@pytest.mark.parametrize("name", ["a.csv", "a.tsv", "a.txt", "blanks.txt", "a.npy", "a.npz"])
def test_the_order_of_columns_without_names_can_be_stated(tmp_path, name):
    """This holds in every format that may have such columns.

    Times between blanks are seconds.
    """
    events = made_events(50)
    separator = {"a.csv": ",", "a.tsv": "\t", "a.txt": ";", "blanks.txt": " "}.get(name)
    for order in ORDERS:
        table = np.stack([events[field].astype(np.int64) for field in order], axis=1)
        path = tmp_path / name
        if separator is None:
            np.savez(path, table) if name.endswith("z") else np.save(path, table)
        else:
            rows = table.tolist()
            if name == "blanks.txt":
                rows = [
                    [n if f != "t" else f"{n / 1e6:.6f}" for f, n in zip(order, row, strict=True)]
                    for row in rows
                ]
            path.write_text("".join(separator.join(map(str, row)) + "\n" for row in rows))
        np.testing.assert_array_equal(
            open_recording(path, columns=order).read(), events, err_msg=order
        )
        # Nothing tells x from y.
        if order.index("x") > order.index("y"):
            continue
        if order != "txyp" and name != "blanks.txt":
            with pytest.raises(
                ValueError, match=f"{name}: .*the columns are not 'txyp'; they look like '{order}'"
            ):
                open_recording(path)
            with pytest.raises(
                ValueError, match=f"{name}: .*the columns are not 'txyp'; they look like '{order}'"
            ):
                open_recording(path, columns="txyp")


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"table.npz"}))
def test_options_that_a_format_does_not_need_change_nothing(tmp_path, name):
    """Its files name their columns, or have none, and have one topic or none."""
    events = made_events(20, sensor=(34, 34))
    path = written(tmp_path / name, events, (34, 34))
    topic = "/camera/events" if name.endswith((".bag", ".db3", ".mcap")) else "/any"
    columns = {"metavision.csv": "xypt", "uzh.txt": "txyp"}.get(name, "pyxt")
    np.testing.assert_array_equal(open_recording(path, columns=columns, topic=topic).read(), events)


DAVIS = [(346, 260), (240, 180), (208, 192), (640, 480)]


@pytest.mark.parametrize("size", DAVIS)
def test_the_stated_sensor_says_how_a_davis_that_the_header_does_not_name_counts(tmp_path, size):
    """v2e writes such files.

    The addresses are not those of a DVS128, and a DVS128's are taken as they are.
    """
    path = tmp_path / "v2e.aedat"
    events = made_events(500, sensor=size)
    path.write_bytes(aedat2(events, size, "", size))
    recording = open_recording(path, sensor=size)
    np.testing.assert_array_equal(recording.read(), events)
    assert (recording.sensor, recording.stated_sensor) == (size, None)
    for sensor in (None, (128, 128), (345, 260)):
        with pytest.raises(
            ValueError,
            match=r"those of a DVS128, .* a header line such as `# AEChip: DAVIS346` or i",
        ):
            open_recording(path, sensor=sensor).read()
    named = tmp_path / "named.aedat"
    named.write_bytes(
        path.read_bytes().replace(b"2.0\r\n", f"2.0\r\n# AEChip: DAVIS{size[0]}\r\n".encode(), 1)
    )
    np.testing.assert_array_equal(open_recording(named, sensor=(9, 9)).read(), events)
    dvs128 = written(tmp_path / "dvs128.aedat", made_events(50, sensor=SMALL), SMALL)
    np.testing.assert_array_equal(
        open_recording(dvs128, sensor=SMALL).read(), made_events(50, sensor=SMALL)
    )


def test_the_davis_by_which_addresses_are_read_is_named_where_they_do_not_fit(tmp_path):
    path = tmp_path / "a.aedat"
    path.write_bytes(aedat2(made_events(50, sensor=(640, 480)), (640, 480), "", (640, 480)))
    with pytest.raises(ValueError, match="addresses are read as those of a DAVIS346, as the heade"):
        open_recording(path, sensor=(346, 260)).read()


def test_addresses_of_cameras_by_hand(tmp_path):
    """The address (50, 20) is 50 from the right and 20 from the bottom.

    Where no camera is named, the address is taken as it is.
    """
    of_davis = 20 << 22 | 50 << 12 | 1 << 11
    of_dvs128 = 20 << 8 | 50 << 1
    for chip, address, pixel in (
        ("# AEChip: DAViS240C\r\n", of_davis, (189, 159)),
        # its bytes are #, two that are no text, and a line end
        ("# AEChip: DAViS240C\r\n", 0x23CEF80A, (0, 36)),
        ("# AEChip: eu.DVS128\r\n", of_dvs128, (77, 107)),
        # the first known
        (
            "# AEChip: eu.Foo\r\n# AEChip: eu.DVS128\r\n# AEChip: DAViS240C\r\n",
            of_dvs128,
            (77, 107),
        ),
        ("# AEChip: DAViS240C\r\n", of_davis | 1 << 10, None),  # an event from outside
        ("# AEChip: DAViS240C\r\n", of_davis | 1 << 31, None),  # a sample of a frame
        ("", of_dvs128 | 1 << 15, None),
        ("", of_dvs128, (50, 20)),
    ):
        (tmp_path / "a.aedat").write_bytes(
            f"#!AER-DAT2.0\r\n{chip}".encode() + struct.pack(">II", address, 7)
        )
        assert open_recording(tmp_path / "a.aedat").read().tolist() == (
            [(7, *pixel, 1)] if pixel else []
        )


def test_atis_events_of_changing_light_by_hand(tmp_path):
    """Rows count from the bottom; events may be exposures."""
    pytest.importorskip("faery", reason="ES needs faery")
    header = b"Event Stream\x02\x00\x00\x02" + np.array([320, 240], "<u2").tobytes()
    pixel = np.array([4, 0], "<u2").tobytes()  # y = 0 is the lowest row
    body = b"\xfd\xfe"  # time passes
    for passed_and_kind in (5 << 2 | 2, 1 << 2 | 1, 1 << 2):
        body += bytes([passed_and_kind]) + pixel
    (tmp_path / "a.es").write_bytes(header + body)
    recording = open_recording(tmp_path / "a.es")
    assert recording.read().tolist() == [(194, 4, 239, 1), (196, 4, 239, 0)]
    assert recording.sensor == (320, 240)


@pytest.mark.parametrize("suffix", [".h5", ".dat"])
def test_the_content_tells_the_format_where_suffixes_are_shared(tmp_path, suffix):
    renamed = written(tmp_path / "evt3.raw", made_events(50)).rename(tmp_path / f"renamed{suffix}")
    np.testing.assert_array_equal(open_recording(renamed).read(), made_events(50))


CLOCKS = [
    ("a.dat", dat, 1 << 32),
    ("a.raw", evt2, 1 << 34),
    ("a.raw", evt21, 1 << 34),
    ("a.raw", evt3, 1 << 24),
    ("a.aedat", lambda events: aedat2(events, SMALL, ""), 1 << 32),
    ("a.aedat", aedat3, 1 << 31),
]


@pytest.mark.parametrize(("name", "make", "period_us"), CLOCKS)
def test_times_go_on_through_wraps_pauses_and_disorder(tmp_path, name, make, period_us):
    wraps = made_events(1_000, sensor=SMALL, step_us=period_us // 200, start_us=period_us // 2)
    assert wraps["t"][-1] > 2 * period_us
    late = made_events(400, sensor=SMALL, step_us=10_000, start_us=period_us - 1_000_000)
    late["t"][::7] -= 40_000
    late = late[1:]
    assert late["t"][0] < period_us < late["t"][-1]
    pauses = []
    for start in (0.1, 0.3, 0.7):  # each pause is shorter than half a period
        pauses.append(made_events(100, sensor=SMALL, step_us=50, start_us=int(start * period_us)))
        pauses[-1]["t"][50:] += int(0.45 * period_us)
    path = tmp_path / name
    for events in (wraps, late, *pauses):
        path.write_bytes(make(events))
        np.testing.assert_array_equal(open_recording(path).read(), events)


@pytest.mark.parametrize(("name", "make", "period_us"), CLOCKS)
def test_the_clock_goes_on_from_one_block_to_the_next(tmp_path, monkeypatch, name, make, period_us):
    monkeypatch.setattr(aedat, "BLOCK_EVENTS", 32)
    monkeypatch.setattr(prophesee, "BLOCK_EVENTS", 40)
    monkeypatch.setattr(prophesee, "CHUNK_BYTES", 256)
    wraps = made_events(1_000, sensor=SMALL, step_us=period_us // 200, start_us=period_us // 2)
    (tmp_path / name).write_bytes(make(wraps))
    np.testing.assert_array_equal(open_recording(tmp_path / name).read(), wraps)


N_LONG = 1_000_000
N_BLOCK = 100_000
SLOW_OR_WHOLE = (".txt", ".csv", ".bin", ".npz")
# without those that are read as a whole; of those that take seconds, one of each kind
IN_BLOCKS = sorted(
    name
    for name, format in FORMATS.items()
    if name in ("plain.csv", "dsec.h5", "packets.bag")
    or not (format.in_worker or name.endswith(SLOW_OR_WHOLE))
)


@pytest.mark.parametrize("name", IN_BLOCKS)
def test_memory_does_not_grow_with_the_file(tmp_path, name):
    """The same events are repeated ten times.

    A million different ones take longer to write than to read.
    """
    path = tmp_path / name
    sensor = sensor_for(name)
    block = made_events(N_BLOCK, sensor=sensor, step_us=4)
    if name == "dsec.h5":
        dsec(path, np.repeat(block, N_LONG // N_BLOCK), chunks=(10_000,))
    elif name == "packets.bag":
        words = unpacked(evt3(block)[len(evt_header("3.0")) :])
        with Bag(path) as bag:
            for _ in range(N_LONG // N_BLOCK):
                bag.packet(words, sensor)
    elif name == "records.npy":
        np.save(path, np.repeat(block, N_LONG // N_BLOCK))
    else:
        head = len(written(path, block[:0], sensor).read_bytes())
        data = written(path, block, sensor).read_bytes()
        path.write_bytes(data[:head] + data[head:] * (N_LONG // N_BLOCK))
    next(iter(open_recording(path)))  # compiles and imports
    tracemalloc.start()
    try:
        n = sum(len(packet) for packet in open_recording(path))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert n == N_LONG
    assert peak < 9e6 < N_LONG * 13  # what all events would take


def test_a_part_between_two_times_is_half_open(tmp_path):
    events = made_events(140_000, step_us=1)
    events["t"] = np.arange(140_000)
    path = written(tmp_path / "records.npy", events)
    for start, end, times in (
        (3, 5, [3, 4]),
        (65_535, 65_537, [65_535, 65_536]),
        (200_000, 200_001, []),
    ):
        for pair in ((start, end), [start, end], np.array([start, end])):
            recording = open_recording(path, between_us=pair)
            assert recording.read()["t"].tolist() == times
            assert recording.between_us == (start, end)
            assert all(type(t_us) is int for t_us in recording.between_us)


def test_the_first_and_the_last_time_are_those_of_all_blocks(tmp_path):
    """Three blocks, each earlier than the one before."""
    events = made_events(140_000)
    events["t"] = 7 + np.arange(140_000)[::-1]
    recording = open_recording(written(tmp_path / "records.npy", events))
    assert (recording.earliest_us, recording.duration_us) == (7, 139_999)
    events["t"] = np.roll(events["t"], 70_000)
    recording = open_recording(written(tmp_path / "records.npy", events))
    assert (recording.earliest_us, recording.duration_us) == (7, 139_999)


def test_a_part_is_read_up_to_the_first_block_of_later_events(tmp_path, monkeypatch):
    """Blocks without an event do not end it, and damage behind it is not met."""
    monkeypatch.setattr(text_files, "CHUNK_BYTES", 20)
    rows = ["t,x,y,p", "1,1,2,0", *["# no event here"] * 9, "5,1,2,1", "3,1,2,1"]
    rows += ["10,1,2,0", "11,1,2,0", "12,1,2,0", "13,1,2,0", "what"]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    recording = open_recording(tmp_path / "a.csv", between_us=(0, 10), strict=True)
    assert recording.read()["t"].tolist() == [1, 5, 3]


@pytest.mark.parametrize("suffix", [".safetensors", ".ONNX", ".nir"])
def test_a_model_is_named_as_one_where_a_recording_is_expected(tmp_path, suffix):
    (tmp_path / f"a{suffix}").touch()
    with pytest.raises(ValueError, match=rf"a\{suffix}: a model, .* and no recording$"):
        open_recording(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_what_is_not_a_file_is_refused_at_opening(tmp_path, suffix):
    (tmp_path / f"gone{suffix}").symlink_to(tmp_path / "nowhere")
    for name in ("nowhere", "gone"):
        with pytest.raises(FileNotFoundError, match=name):
            open_recording(tmp_path / f"{name}{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(
        IsADirectoryError,
        match=r"is a folder, expected a recording; `async-tnt info` says what is in it$",
    ):
        open_recording(tmp_path / f"folder{suffix}")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / f"pipe{suffix}")
        with pytest.raises(
            ValueError,
            match=rf"pipe\{suffix}: a recording must be a file that can be read more than",
        ):
            open_recording(tmp_path / f"pipe{suffix}")


@pytest.mark.parametrize(
    ("name", "how", "message"),
    [
        (
            __file__,
            {},
            r"\.py: unknown suffix '\.py', expected one of \.aedat, \.aedat4, \.bag, .*\.txt$",
        ),
        ("a.bin", {"packet_events": 0}, "`packet_events` must be at least 1, got 0"),
        (
            "a.bin",
            {"sensor": (0, 5)},
            r"`sensor` must have sides in \[1, 32768\] pixels, got \(0, 5\)",
        ),
        (
            "a.bin",
            {"columns": "xyt"},
            "`columns` must have the letters t, x, y and p, each once, got 'xyt'",
        ),
        (
            "a.bin",
            {"columns": tuple("xypt")},
            "`columns` must have the letters t, x, y and p, each once, got ",
        ),
        ("a.bin", {"topic": ""}, "`topic` must be the name of a topic, got ''"),
        ("a.bin", {"topic": 7}, "`topic` must be the name of a topic, got 7"),
        *(
            (
                "a.bin",
                {"between_us": value},
                r"`between_us` must be \(start, end\), whole microseconds with start < end",
            )
            for value in ((5, 5), (6, 5), (1.5, 3), (1,), 7, (0, 1, 2), "12", (None, 4))
        ),
    ],
)
def test_wrong_arguments(name, how, message):
    with pytest.raises(ValueError, match=message):
        open_recording(name, **how)


def test_the_given_sensor_is_that_of_files_that_state_none(tmp_path):
    """N-Caltech101 has the format of N-MNIST and 304 x 240 pixels."""
    events = made_events(2, sensor=(1, 1))
    events["x"] = (239, 100)
    events["y"] = (179, 99)
    write_nmnist(tmp_path / "a.bin", events)
    for name in ("a.bin", "records.npy", "plain.csv"):
        path = tmp_path / name if name == "a.bin" else written(tmp_path / name, events)
        recording = open_recording(path, 1, sensor=(200, 200))
        assert (recording.sensor, recording.stated_sensor) == ((200, 200), None)
        np.testing.assert_array_equal(open_recording(path, sensor=(240, 180)).read(), events)
    stating = written(tmp_path / "packed.npz", events)
    assert open_recording(stating, sensor=(200, 200)).sensor == SENSOR
    for sensor in (None, (34, 34)):
        with pytest.raises(
            ValueError, match=r"x = 239, y = 179: .*another sensor.*unless `sensor` says another"
        ):
            open_recording(tmp_path / "a.bin", sensor=sensor).read()
