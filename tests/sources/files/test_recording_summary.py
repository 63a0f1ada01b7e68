"""A summary says what all events together say.

This holds for any format, and however long the recording is.
"""

import numpy as np
import pytest
from made import events_of, random_events
from sources.files.written import FORMATS, SENSOR, made_events, written

from async_tnt.sources import recording_summary
from async_tnt.sources.pixels.hot_pixels import hot_pixels
from async_tnt.sources.recording_summary import summarize


@pytest.mark.parametrize("name", ["plain.csv", "evt3.raw", "metavision.hdf5"])
def test_a_file_that_states_its_sensor_or_not_is_summarized(tmp_path, name):
    states_sensor = FORMATS[name].states_sensor
    sensor = tuple(np.minimum(SENSOR, FORMATS[name].largest).tolist())
    events = made_events(3_000, sensor=sensor, step_us=40)
    found = summarize(written(tmp_path / name, events, sensor))
    assert found.bytes == (tmp_path / name).stat().st_size
    assert found.sensor == (sensor if states_sensor else None)
    assert found.sensor_stated == states_sensor
    assert (found.events, found.on, found.unsorted) == (3_000, int((events["p"] > 0).sum()), 0)
    assert (found.first_us, found.last_us) == (events["t"][0], events["t"][-1])
    assert found.extent == (events["x"].max() + 1, events["y"].max() + 1)
    length_s = (found.last_us - found.first_us + 1) * 1e-6
    assert np.mean(found.events_a_second) * length_s == pytest.approx(3_000)


def test_the_parts_of_a_long_recording_are_of_equal_length(tmp_path):
    """Two hours with a burst in the middle, in packets of 65,536 events."""
    t = np.sort(
        np.concatenate(
            [
                np.linspace(10**12, 10**12 + 7_200_000_000, 150_000),
                10**12 + 3.6e9 + np.arange(50_000),
            ]
        )
    )
    rng = np.random.default_rng(0)
    events = events_of(
        t.astype(np.int64),
        rng.integers(0, 34, t.size),
        rng.integers(0, 34, t.size),
        t.astype(np.int64) % 2,
    )
    np.save(tmp_path / "long.npy", events)
    found = summarize(tmp_path / "long.npy", (34, 34))
    assert np.mean(found.events_a_second) * 7_200 == pytest.approx(t.size)
    assert len(found.events_a_second) == 60
    assert np.argmax(found.events_a_second) == 30
    assert np.median(found.events_a_second) == pytest.approx(150_000 / 7_200, rel=0.1)


@pytest.mark.parametrize("n", [1, 3])
def test_a_few_events_with_times_since_1970(tmp_path, n):
    np.save(
        tmp_path / "now.npy",
        events_of(1_700_000_000_000_000 + np.arange(n), [1] * n, [2] * n, [1] * n),
    )
    found = summarize(tmp_path / "now.npy", (34, 34))
    assert np.isfinite(found.events_a_second).all()
    assert np.mean(found.events_a_second) == pytest.approx(1e6, rel=0.01)


def test_unsorted_events_and_hot_pixels_are_counted(tmp_path):
    hot = events_of(np.arange(500) * 100, [3] * 500, [4] * 500, [1] * 500)
    events = np.concatenate([random_events(5_000), hot])
    np.save(tmp_path / "a.npy", events)
    found = summarize(tmp_path / "a.npy", (34, 34))
    assert found.unsorted == (np.diff(events["t"]) < 0).sum() == 1
    counts = np.zeros((34, 34), np.int64)
    np.add.at(counts, (events["y"], events["x"]), 1)
    assert found.hot_pixels == [{"x": 3, "y": 4, "events": counts[4, 3]}]
    assert hot_pixels(counts).sum() == 1
    assert summarize(tmp_path / "a.npy").hot_pixels == []
    with pytest.raises(
        ValueError, match=r"a\.npy: .* events lie off the 20 x 34 sensor; .*another sensor"
    ):
        summarize(tmp_path / "a.npy", (20, 34))


@pytest.mark.parametrize("size", [1, 2, 3, 100])
def test_unsorted_events_are_counted_wherever_packets_end(tmp_path, monkeypatch, size):
    """Earlier than the event before, not than the newest: 5, 4, 0 and 2."""
    monkeypatch.setattr(recording_summary, "PACKET_EVENTS", size)
    events = events_of([7, 5, 6, 4, 0, 3, 2, 9], [1] * 8, [2] * 8, [0, 0, 0, 1] * 2)
    np.save(tmp_path / "a.npy", events)
    found = summarize(tmp_path / "a.npy", (34, 34))
    assert (found.unsorted, found.on, found.first_us, found.last_us) == (4, 2, 0, 9)


def test_a_recording_without_events_is_summarized(tmp_path):
    np.save(tmp_path / "none.npy", random_events(0))
    found = summarize(tmp_path / "none.npy", (34, 34))
    assert (found.events, found.first_us, found.last_us, found.extent, found.hot_pixels) == (
        0,
        0,
        0,
        (0, 0),
        [],
    )


def test_hot_pixels_of_a_sensor_of_too_many_pixels_are_not_looked_for(tmp_path):
    """Their counts would take more memory than the file."""
    hot = events_of(np.arange(500) * 100, [3] * 500, [4] * 500, [1] * 500)
    for sensor, n_hot in (((4_096, 4_096), 1), ((4_097, 4_096), 0)):
        np.savez(tmp_path / "a.npz", events=hot, sensor=np.array(sensor))
        found = summarize(tmp_path / "a.npz")
        assert (found.sensor, found.events, len(found.hot_pixels)) == (sensor, 500, n_hot)
