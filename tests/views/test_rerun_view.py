"""RerunView: what is in the file is what the processor had."""

import numpy as np
import pytest
from made import events_of, random_events, random_model

from async_tnt import Processor, TNTConfig, TNTVolume, load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings

rrd_files = pytest.importorskip(
    "views.rrd_files", reason="rerun-sdk is not installed (extra `view`)"
)
Rrd = rrd_files.Rrd
from async_tnt.views import rerun_log as log  # noqa: E402
from async_tnt.views.rerun_view import RerunView, next_moment  # noqa: E402

CONFIG = TNTConfig(sensor=(40, 30), grid=(20, 24), window_us=50_000, bins=4)
MODEL = random_model(CONFIG)
EVENTS = random_events(3000, duration_us=170_000, sensor=(40, 30), start_us=7_000)
LATE = EVENTS[
    np.argsort(EVENTS["t"] + np.random.default_rng(3).integers(0, 30_000, 3000), kind="stable")
]


def view_of(folder, packets, model=MODEL, **settings):
    """Packets as a view, read back; with the decisions that came."""
    with RerunView(model, out=folder / "a.rrd", **settings) as view:
        decisions = [
            decision for packet in packets for decision in view.push(packet)
        ] + view.finish()
    return Rrd(folder / "a.rrd"), decisions


def truth_at(model, events, at_us, **settings):
    """A processor that saw the events before a moment, and what it has then.

    This is its decision, and the raw volume of its window.
    """
    processor = Processor(model, **settings)
    before = events[np.maximum.accumulate(events["t"]) < at_us]
    processor.push(before)
    now = processor.fire()
    raw_config = processor.config.replace(transform="none", landmark="center", remove_flow=False)
    raw = TNTVolume(raw_config, late=processor.late)
    raw.open(now.window_start_us)
    if now.events:
        raw.update(before[before["t"] >= now.window_start_us])
    assert (raw.start_us, raw.n_events) == (now.window_start_us, now.events)
    return processor, now, log.bin_sheet(raw.array)


def summary(decisions):
    return [(d.time_us, d.index, d.events, d.trigger) for d in decisions]


@pytest.mark.parametrize(
    "landmark, events, settings, ready",
    [
        ("line", EVENTS, {"every_us": 7_000}, False),
        ("window", EVENTS, {"every_events": 100}, False),
        ("regressor", EVENTS, {}, False),
        ("running", EVENTS, {"hop_us": 10_000}, False),
        ("running", LATE, {"late": "drop", "start_us": 0}, True),
    ],
)
def test_every_picture_shows_what_the_processor_has(tmp_path, landmark, events, settings, ready):
    model = random_model(CONFIG.replace(landmark=landmark))
    packets = np.array_split(events, 37)
    if ready:
        rrd, decisions = view_of(tmp_path, packets, Processor(model, **settings), picture_us=9_000)
    else:
        rrd, decisions = view_of(tmp_path, packets, model, picture_us=9_000, **settings)
    processor = Processor(model, **settings)
    expected = [decision for packet in packets for decision in processor.push(packet)]
    assert summary(decisions) == summary(expected + processor.finish())
    raws = rrd.images(log.RAW)
    tnts = rrd.images(log.TNT)
    landmarks = rrd.series(log.LANDMARK, "Points2D:positions")
    assert len(raws) > 18 and any(len(np.unique(sheet)) > 10 for _, sheet in tnts)
    for (t, raw), (t_tnt, tnt), (t_landmark, points) in zip(raws, tnts, landmarks, strict=True):
        truth, now, raw_truth = truth_at(model, events, t, **settings)
        assert t == t_tnt == t_landmark
        np.testing.assert_array_equal(raw, raw_truth)
        np.testing.assert_array_equal(tnt, log.bin_sheet(truth.volume()))
        if not now.events:
            assert points == []
            continue
        place = np.add(truth.config.to_sensor(*truth.landmark), 0.5)
        assert points == [pytest.approx(place, abs=1e-4)]


def test_pictures_fall_on_their_moments_however_the_stream_is_cut(tmp_path):
    seen = []
    for n_packets in (1, 13, 3000):
        rrd, _ = view_of(tmp_path, np.array_split(EVENTS, n_packets), picture_us=20_000)
        images = rrd.images(log.EVENTS, "SegmentationImage")
        seen.append([(t, image.tobytes()) for t, image in images])
        assert [t for t, _ in images] == rrd.times(log.RAW)
    assert seen[0] == seen[1] == seen[2]
    moments = [int(EVENTS["t"][0])]
    while moments[-1] <= EVENTS["t"][-1]:
        moments.append(next_moment(moments[-1], moments[0], 50_000, 20_000))
    assert [t for t, _ in images] == [*moments[1:-1], int(EVENTS["t"][-1]) + 1]
    for t, image in images:  # the events since the moment before
        expected = np.zeros((30, 40), np.uint8)
        for event in EVENTS[(EVENTS["t"] >= t - 20_000) & (EVENTS["t"] < t)]:
            expected[event["y"], event["x"]] = 2 if event["p"] else 1
        assert np.array_equal(image, expected) and image.any()


def test_probabilities_and_decisions_are_the_processors(tmp_path):
    model = load_model("digits")
    events = open_recording(sample_recordings()[7]).read()
    rrd, decisions = view_of(tmp_path, np.array_split(events, 9), model, every_us=50_000)
    series = rrd.series(log.PROBABILITIES, "Scalars:scalars")
    lines = rrd.series(log.DECISIONS, "TextLog:text")
    for d, (t, (text,)) in zip(decisions, lines, strict=True):
        assert t == d.time_us and (t, d.probabilities.tolist()) in series
        times = f"{d.window_start_us / 1e3:,.3f} to {d.time_us / 1e3:,.3f} ms"
        assert text == f"{d.label}  {d.probability:.3f}  {d.trigger}: {d.events:,} events, {times}"


def test_nothing_is_written_for_each_event_and_decisions_are_capped(tmp_path):
    rrd, decisions = view_of(tmp_path, [EVENTS], every_events=1, picture_us=20_000)
    lines = [text for _, (text,) in rrd.series(log.DECISIONS, "TextLog:text")]
    n_pictures = len(rrd.times(log.EVENTS))
    assert len(decisions) > 2900 and len(lines) <= 20 * (n_pictures + 1)
    assert sum("are not shown" in line for line in lines) >= n_pictures - 3
    assert len(rrd.times(log.PROBABILITIES)) <= 21 * (n_pictures + 1)


def test_times_beyond_reruns_clock(tmp_path):
    with RerunView(MODEL, out=tmp_path / "a.rrd") as view:
        with pytest.raises(ValueError, match="to be shown by Rerun"):
            view.push(([1 << 61], [0], [0], [1]))
        view.push(events_of([1_700_000_000_000_000], [0], [0], [1]))  # microseconds since 1970
    assert Rrd(tmp_path / "a.rrd").times(log.EVENTS) == [1_700_000_000_000_001]


def test_a_file_without_events_is_not_written(tmp_path):
    (tmp_path / "a.rrd").write_bytes(b"before")
    with RerunView(MODEL, out=tmp_path / "a.rrd") as view:
        pass
    view.close()  # again
    assert (tmp_path / "a.rrd").read_bytes() == b"before" and len(list(tmp_path.iterdir())) == 1


def test_after_an_error_the_file_holds_what_came_before(tmp_path):
    def fails_later(volume):
        if not volume.any():
            return [0.0]
        raise RuntimeError("no answer")

    with (
        pytest.raises(OSError, match="unplugged"),
        RerunView(MODEL, out=tmp_path / "a.rrd") as view,
    ):
        view.push(EVENTS)
        raise OSError("unplugged")
    assert len(Rrd(tmp_path / "a.rrd").times(log.RAW)) > 8
    with pytest.raises(RuntimeError, match="no answer"):
        view_of(tmp_path, [EVENTS], CONFIG, classifier=fails_later)
    assert not (tmp_path / "a.rrd.part").exists()
