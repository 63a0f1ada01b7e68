"""Events off the sensor are left out and counted, in every format.

Many of them mean another sensor.
"""

import struct
import warnings

import numpy as np
import pytest
from made import events_of
from sources.files.written import FORMATS, SENSOR, aedat2, made_events, written

from async_tnt.sources.files.off_sensor import EventsOffSensor, likely_side
from async_tnt.sources.files.recording import RecordingCounts, open_recording
from async_tnt.sources.files.source import DamagedRecording
from async_tnt.sources.recording_summary import summarize

STRAYS = np.arange(40, 1_200, 200)  # places of six events among 1,200
# the smallest sensor that can hold the events of each test; a DVS128's address cannot say a pixel
# beyond 127
SMALL = {"dvs128.aedat": (90, 90), "davis.aedat": (240, 180), "plain.bin": (34, 34)}


# faery writes no .aedat4 with such events, and a DAVIS counts pixels from the other side: see below
EVERY_FORMAT = sorted(FORMATS.keys() - {"davis.aedat", "dv.aedat4"})


def with_strays(name):
    """Events, which of them are strays, and the sensor that the file states or the caller gives."""
    sensor = SMALL.get(name, tuple(np.minimum(SENSOR, FORMATS[name].largest).tolist()))
    events = made_events(1_200, sensor=sensor)
    is_stray = np.zeros(len(events), bool)
    is_stray[STRAYS] = True
    events["x"][is_stray] = sensor[0] + np.arange(len(STRAYS))
    return events, is_stray, sensor


def opened(path, name, sensor, **how):
    """A file that states its sensor, or is given one."""
    return open_recording(path, 10, sensor=None if FORMATS[name].states_sensor else sensor, **how)


@pytest.mark.parametrize("name", EVERY_FORMAT)
def test_every_format_leaves_out_events_off_the_sensor_and_counts_them(tmp_path, name):
    events, is_stray, sensor = with_strays(name)
    path = written(tmp_path / name, events, sensor)
    recording = opened(path, name, sensor)
    with pytest.warns(EventsOffSensor) as caught:
        packets = list(recording)
        np.testing.assert_array_equal(np.concatenate(packets), events[~is_stray])
        np.testing.assert_array_equal(recording.read(), events[~is_stray])
    (warning,) = caught
    width, height = sensor
    words = (
        f"6 of 1,200 events lie off the {width} x {height} sensor; the first is event 40 at "
        f"x = {width}"
    )
    assert str(warning.message).startswith(f"{path}: {words}, y = ")
    counts = recording.counts
    assert counts == RecordingCounts(received=1_200, kept=1_194, off_sensor=6)
    assert recording.n_events == 1_194

    strict = iter(opened(path, name, sensor, strict=True))
    assert sum(len(next(strict)) for _ in range(4)) == 40
    with pytest.raises(ValueError, match=f"{name}: .*; the first is event 40 at x"):
        next(strict)

    counted = opened(path, name, sensor, strict=True, off_sensor="count")
    assert len(counted.read()) == 1_194 and counted.counts == counts


@pytest.mark.parametrize(
    "name", sorted(name for name in FORMATS if not FORMATS[name].states_sensor)
)
def test_nothing_is_left_out_where_no_sensor_is_known(tmp_path, name):
    events, _, sensor = with_strays(name)
    recording = open_recording(written(tmp_path / name, events, sensor))
    np.testing.assert_array_equal(recording.read(), events)
    assert recording.counts.off_sensor == 0


def test_an_address_off_the_sensor_of_a_davis(tmp_path):
    """Addresses count from the right and from the bottom: 10 and 9 bits can say 1,023 and 511."""
    events = made_events(300, sensor=(240, 180))
    data = aedat2(events, (240, 180), "DAVIS240C")
    stray = struct.pack(">II", 1023 << 12, 20_000) + struct.pack(">II", 511 << 22, 20_000)
    (tmp_path / "a.aedat").write_bytes(data + stray)
    recording = open_recording(tmp_path / "a.aedat")
    with pytest.warns(
        EventsOffSensor,
        match="2 of 302 events lie off .*; the first is event 300 at x = -784, y = 179",
    ):
        np.testing.assert_array_equal(recording.read(), events)


@pytest.mark.parametrize("pixel", [-1, -(1 << 40), 1 << 16, 1 << 40])
def test_a_pixel_that_no_sensor_has_is_left_out_wherever_a_file_can_say_it(tmp_path, pixel):
    table = np.array([[t, 1, 2, 1] for t in range(10)])
    table[7, 1] = pixel
    np.save(tmp_path / "a.npy", table)
    np.savez(tmp_path / "a.npz", events=table)
    (tmp_path / "a.csv").write_text(
        "t,x,y,p\n" + "".join(f"{t},{x},{y},{p}\n" for t, x, y, p in table.tolist())
    )
    for name in ("a.npy", "a.npz", "a.csv"):
        for sensor in (None, (34, 34)):
            recording = open_recording(tmp_path / name, sensor=sensor)
            with pytest.warns(
                EventsOffSensor,
                match=f"1 of 10 events lies .*; it is event 7 at x = {pixel}, y = 2",
            ):
                assert recording.read()["t"].tolist() == [0, 1, 2, 3, 4, 5, 6, 8, 9]
        # no sensor is given, which could be the wrong one
        with pytest.raises(ValueError, match=f"it is event 7 at x = {pixel}, y = 2$"):
            open_recording(tmp_path / name, off_sensor="raise").read()


@pytest.mark.parametrize(
    ("n", "n_off", "is_another"),
    [
        (10_000, 100, False),
        (10_099, 100, False),
        (10_101, 101, False),  # exactly more than 100, not more than 1 %
        (10_099, 101, True),
        (100, 50, False),
        (99, 50, True),
        (1, 1, True),
    ],
)
def test_many_events_off_the_sensor_are_another_sensor(tmp_path, n, n_off, is_another):
    events = made_events(n, sensor=(34, 34))
    events["y"][np.random.default_rng(n).permutation(n)[:n_off]] = 40
    np.save(tmp_path / "a.npy", events)
    for off_sensor in ("warn", "count"):
        recording = open_recording(tmp_path / "a.npy", sensor=(34, 34), off_sensor=off_sensor)
        if is_another:
            message = (
                rf"{n_off} of {n:,} events lies? off the 34 x 34 sensor.*of another sensor.*"
                "the file states none"
            )
            with pytest.raises(ValueError, match=message):
                next(iter(recording))
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", EventsOffSensor)
                assert len(recording.read()) == n - n_off


def test_a_burst_of_strays_at_the_start_is_judged_by_all_events_and_a_later_flood_is_damage(
    tmp_path,
):
    """The first 65,536 events are judged together, before any of them is handed on.

    This also holds in a format of small blocks.
    """
    events = made_events(150_000, sensor=(34, 34), step_us=4)
    events["x"][:300] = 34
    for name in ("caer.aedat", "records.npy"):
        recording = open_recording(written(tmp_path / name, events), sensor=(34, 34))
        recording.sensor = (34, 34)
        with pytest.warns(EventsOffSensor, match="300 of 150,000"):
            np.testing.assert_array_equal(recording.read(), events[300:])
    events["x"][140_000:] = 34
    np.save(tmp_path / "a.npy", events)
    recording = open_recording(tmp_path / "a.npy", sensor=(34, 34), off_sensor="count")
    with pytest.warns(
        DamagedRecording, match=r"damaged recording: 10,300 of 150,000 events lie off"
    ):
        read = recording.read()
    np.testing.assert_array_equal(read, events[300 : 2 << 16])
    assert recording.counts.kept == len(read)


def test_events_off_the_sensor_of_other_parts_do_not_count(tmp_path):
    events = made_events(1_000, sensor=(34, 34))
    events["x"][500:] = 34
    np.save(tmp_path / "a.npy", events)
    until = int(events["t"][500])
    recording = open_recording(tmp_path / "a.npy", sensor=(34, 34), between_us=(0, until))
    np.testing.assert_array_equal(recording.read(), events[events["t"] < until])
    assert recording.counts.off_sensor == 0


def test_one_stray_does_not_make_the_sensor_large(tmp_path):
    t = np.arange(100_000)
    events = events_of(t, t % 34, t % 33, t % 2)
    events["y"][50_000] = 33_014
    np.save(tmp_path / "stray.npy", events)
    found = summarize(tmp_path / "stray.npy")
    assert (found.extent, found.reach, found.events) == ((34, 33), (34, 33_015), 100_000)
    found = summarize(tmp_path / "stray.npy", (34, 34))
    assert (found.extent, found.events, found.off_sensor) == ((34, 33), 99_999, 1)


@pytest.mark.parametrize(
    ("columns", "side"),
    [
        ([], 0),
        ([0], 1),
        ([0, 5, 30], 31),  # few events: any may be the only one there
        ([0] * 1000 + [1] * 10, 2),
        ([3] * 1000 + [8] * 10, 4),  # beyond twice all others, and a hundredth of them
        ([3] * 1000 + [7] * 10, 8),
        ([3] * 1000 + [8] * 11, 9),
        ([3] * 1000 + [500, 501, 60_000], 4),
    ],
)
def test_the_likely_side_by_hand(columns, side):
    assert likely_side(np.bincount(columns)) == side


def test_a_word_of_the_row_beyond_the_sensor_costs_its_own_events_alone(tmp_path):
    """EVT3 on 1280 x 720: row 752, which a flipped bit makes of row 240, for one of 2,000 rows."""
    words = [0x8001, 0x6002]
    rows = np.arange(2_000) % 720
    rows[1_000] = 752
    for i, row in enumerate(rows.tolist()):
        words += [row, 0x2000 | i % 1280]
    header = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% end\n"
    (tmp_path / "a.raw").write_bytes(header + struct.pack(f"<{len(words)}H", *words))
    with pytest.warns(
        EventsOffSensor,
        match="1 of 2,000 events lies off the 1280 x 720 sensor; it is event 1000 at",
    ):
        kept = open_recording(tmp_path / "a.raw").read()
        assert kept["y"].tolist() == np.delete(rows, 1_000).tolist()


def test_an_unknown_policy_is_refused():
    with pytest.raises(
        ValueError, match="`off_sensor` must be one of warn, raise, count, got 'drop'"
    ):
        open_recording("a.npy", off_sensor="drop")
