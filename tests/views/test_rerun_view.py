"""RerunView: what is in the file is what the processor had."""

from types import SimpleNamespace

import numpy as np
import pytest
from made import events_of, random_events, random_model

from async_tnt import Processor, TNTConfig, TNTVolume, load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings

rrd_files = pytest.importorskip(
    "views.rrd_files", reason="rerun-sdk is not installed (extra `view`)"
)
Rrd = rrd_files.Rrd
from async_tnt.views import rerun_decisions as decisions_log  # noqa: E402
from async_tnt.views import rerun_log as log  # noqa: E402
from async_tnt.views import rerun_view  # noqa: E402
from async_tnt.views.rerun_view import LAST_US, RerunView, next_moment  # noqa: E402

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


@pytest.mark.parametrize(
    "settings",
    [
        {},
        # each window is decided at its first event: the next one begins after the pictures of it
        {"confidence": 1e-9},
        {"hop_us": 10_000},
    ],
    ids=["windows", "confidence", "overlapping"],
)
def test_pictures_fall_on_their_moments_however_the_stream_is_cut(tmp_path, settings):
    seen = []
    for n_packets in (1, 13, 3000):
        packets = np.array_split(EVENTS, n_packets)
        rrd, _ = view_of(tmp_path, packets, picture_us=20_000, **settings)
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


def test_the_colours_of_an_event_image_have_names(tmp_path):
    rrd, _ = view_of(tmp_path, [EVENTS[:9]])
    (context,) = rrd.static(log.EVENTS, "AnnotationContext:context")
    infos = [row["class_description"]["info"] for row in context]
    found = [(one["id"], one["label"], tuple(one["color"].to_bytes(4, "big")[:3])) for one in infos]
    assert found == [
        (log.NOTHING, "no event", log.NOTHING_COLOUR),
        (log.OFF, "OFF (darker)", log.OFF_COLOUR),
        (log.ON, "ON", log.ON_COLOUR),
    ]


@pytest.mark.parametrize(
    "slides",
    [
        {"representation": "count", "last_events": 50},
        {"representation": "count", "last_us": 30_000},
        # its slices of time count from the stream's start
        {"representation": "volume", "last_us": 30_000, "bins": 4, "transform": "none"},
    ],
    ids=str,
)
def test_a_window_that_slides_is_shown_with_the_events_that_it_holds(tmp_path, slides):
    """Here of several events at the time of its oldest one, only some are still in it."""
    config = TNTConfig(sensor=(40, 30), grid=(40, 30), **slides)
    model = random_model(config)
    events = EVENTS[:600].copy()
    events["t"] = events["t"] // 2_000 * 2_000
    rrd, _ = view_of(tmp_path, np.array_split(events, 7), model, picture_us=5_000)
    raws = rrd.images(log.RAW)
    assert len(raws) > 5
    for at_us, raw in raws:
        processor = Processor(model)
        processor.push(events[events["t"] < at_us])
        processor.fire()
        np.testing.assert_array_equal(raw, log.bin_sheet(processor.volume()))


def test_an_empty_packet_changes_nothing(tmp_path):
    rrd, _ = view_of(tmp_path, [EVENTS[:0], EVENTS[:900], EVENTS[:0], EVENTS[900:], EVENTS[:0]])
    whole, _ = view_of(tmp_path, [EVENTS])
    assert rrd.times(log.EVENTS) == whole.times(log.EVENTS)


def test_a_late_packet_does_not_turn_time_back(tmp_path):
    packets = [events_of([0, 30_000], [1, 2], [3, 3], [1, 1]), events_of([10_000], [3], [3], [1])]
    rrd, _ = view_of(tmp_path, packets, late="drop", picture_us=20_000)
    assert rrd.times(log.EVENTS) == [20_000, 30_001]


def test_pictures_are_taken_from_the_start_that_is_given(tmp_path):
    """Not from the first event, at 7 ms."""
    rrd, _ = view_of(tmp_path, [EVENTS], start_us=0, picture_us=20_000)
    assert rrd.times(log.EVENTS)[:5] == [20_000, 40_000, 50_000, 70_000, 90_000]


def test_probabilities_and_decisions_are_the_processors(tmp_path):
    model = load_model("digits")
    events = open_recording(sample_recordings()[7]).read()
    rrd, decisions = view_of(tmp_path, np.array_split(events, 9), model, every_us=50_000)
    series = rrd.series(decisions_log.PROBABILITIES, "Scalars:scalars")
    lines = rrd.series(decisions_log.DECISIONS, "TextLog:text")
    for d, (t, (text,)) in zip(decisions, lines, strict=True):
        assert t == d.time_us and (t, d.probabilities.tolist()) in series
        times = f"{d.window_start_us / 1e3:,.3f} to {d.time_us / 1e3:,.3f} ms"
        assert text == f"{d.label}  {d.probability:.3f}  {d.trigger}: {d.events:,} events, {times}"
    assert rrd.static(decisions_log.PROBABILITIES, "SeriesLines:names") == list(model.classes)
    kinds = rrd.series(decisions_log.CLASS, "TextDocument:media_type")
    assert {kind for _, (kind,) in kinds} == {"text/markdown"}


def test_nothing_is_written_for_each_event_and_decisions_are_capped(tmp_path):
    rrd, decisions = view_of(tmp_path, [EVENTS], every_events=1, picture_us=20_000)
    lines = [text for _, (text,) in rrd.series(decisions_log.DECISIONS, "TextLog:text")]
    n_pictures = len(rrd.times(log.EVENTS))
    assert len(decisions) > 2900 and len(lines) <= 20 * (n_pictures + 1)
    assert sum("are not shown" in line for line in lines) >= n_pictures - 3
    assert len(rrd.times(decisions_log.PROBABILITIES)) <= 21 * (n_pictures + 1)


@pytest.mark.parametrize("late_us", [-1, 0])
def test_the_last_time_of_reruns_clock(tmp_path, late_us):
    """It is that of the last picture, a microsecond after the newest event."""
    t = LAST_US + late_us
    with RerunView(MODEL, out=tmp_path / "a.rrd") as view:
        if late_us < 0:
            view.push(events_of([t], [0], [0], [1]))
        else:
            message = f"`t` must be below {LAST_US} us to be shown by Rerun, got {t}$"
            with pytest.raises(ValueError, match=message):
                view.push(events_of([t], [0], [0], [1]))
    if late_us < 0:
        assert Rrd(tmp_path / "a.rrd").times(log.EVENTS) == [LAST_US]


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("rerun+http://127.0.0.1:9999/proxy", ("127.0.0.1", 9999)),
        ("rerun+http://localhost/proxy", ("localhost", 9876)),
        ("rerun+http://127.0.0.1:9999", None),
        ("rerun+http:///proxy", None),
    ],
)
def test_the_address_of_a_viewer(url, address, monkeypatch):
    """Without a port it is the one where viewers listen."""
    asked = []

    def nobody(address, timeout):
        asked.append(address)
        raise OSError

    monkeypatch.setattr("async_tnt.views.rerun_view.socket.create_connection", nobody)
    with pytest.raises((OSError, ValueError)) as raised:
        RerunView(MODEL, connect=url)
    expected = "a viewer's URL is rerun+http://HOST:9876/proxy, got "
    if address is not None:
        expected = f"{url}: no Rerun viewer listens there"
    assert str(raised.value).startswith(expected)
    assert asked == ([] if address is None else [address])


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


def test_a_view_may_be_closed_again(tmp_path):
    """Whatever has become of its file."""
    with RerunView(MODEL, out=tmp_path / "a.rrd") as view:
        view.push(EVENTS)
    (tmp_path / "a.rrd").unlink()
    view.close()
    assert list(tmp_path.iterdir()) == []


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


def test_decisions_that_are_left_out_are_counted_once(tmp_path):
    """Before the first of the twenty that are written. Only those that close a window are
    information for everyone; the others are details."""
    events = events_of(range(1_000, 1_100), [5] * 100, [5] * 100, [1] * 100)
    rrd, decisions = view_of(tmp_path, [events], every_events=1)
    lines = [text for _, (text,) in rrd.series(decisions_log.DECISIONS, "TextLog:text")]
    levels = [level for _, (level,) in rrd.series(decisions_log.DECISIONS, "TextLog:level")]
    # the last one, of the stream's end, comes after the last picture
    assert len(decisions) == 101 and len(lines) == 21
    assert [line.endswith("(80 decisions before it are not shown)") for line in lines] == [
        True,
        *[False] * 20,
    ]
    assert levels == ["TRACE"] * 20 + ["INFO"]


def test_the_decision_that_closes_a_window_is_information(tmp_path):
    events = events_of([0, 10, 60_000], [5, 6, 7], [5, 5, 5], [1, 0, 1])
    rrd, decisions = view_of(tmp_path, [events], every_events=2)
    levels = [level for _, (level,) in rrd.series(decisions_log.DECISIONS, "TextLog:level")]
    assert [d.trigger for d in decisions] == ["every_events", "window", "end"]
    assert levels == ["TRACE", "INFO", "INFO"]


OBJECTS = CONFIG.replace(
    grid=(40, 30), transform="none", landmark="center", polarity="unsigned", bins=1
)


def show_objects(tmp_path, maps, classes=("a", "b")):
    """A view of one event every 20 ms, at each of which the next of these maps is answered."""
    shown = iter(maps)
    current = []

    def classifier(volume):
        if volume.sum() > len(current):
            current.append(next(shown))
        return current[-1] if current else np.zeros_like(maps[0])

    n = len(maps)
    events = events_of([1 + 9_000 * k for k in range(n)], [5] * n, [5] * n, [1] * n)
    settings = {"classifier": classifier, "classes": list(classes), "start_us": 0}
    rrd, _ = view_of(tmp_path, [events], OBJECTS, picture_us=9_000, **settings)
    return rrd


def test_objects_are_shown_where_they_are_until_they_are_gone(tmp_path):
    """Places of 10 x 10 pixels. The plot has the likeliest object of each class, and 0 for a class
    without one."""
    one = np.zeros((3, 3, 4), np.float32)
    one[2] = 1.0  # nothing
    one[0, 0, 3] = 4.0
    one[0, 2, 0] = 3.0
    none = np.zeros((3, 3, 4), np.float32)
    none[2] = 1.0
    rrd = show_objects(tmp_path, [one, none])
    (_, first), (_, last) = (
        rrd.series(decisions_log.OBJECTS, "Points2D:positions")[0],
        rrd.series(decisions_log.OBJECTS, "Points2D:positions")[-1],
    )
    e = np.exp
    likelier = e(4) / (e(4) + e(1) + 1)
    other = e(3) / (e(3) + e(1) + 1)
    assert first == [pytest.approx([35, 5]), pytest.approx([5, 25])]
    assert last == []
    (_, labels) = rrd.series(decisions_log.OBJECTS, "Points2D:labels")[0]
    assert labels == [f"0: a {likelier:.2f}", f"1: a {other:.2f}"]
    plotted = [values for _, values in rrd.series(decisions_log.PROBABILITIES, "Scalars:scalars")]
    assert plotted[0] == pytest.approx([likelier, 0])
    assert plotted[-1] == [0, 0]
    lines = [text for _, (text,) in rrd.series(decisions_log.DECISIONS, "TextLog:text")]
    assert lines[-1].startswith("nothing  0.000  end: 2 events, ")


def test_objects_with_sizes_are_boxes_until_they_are_gone(tmp_path):
    one = np.zeros((5, 3, 4), np.float32)
    one[2] = 1.0  # nothing
    one[0, 0, 3] = 4.0
    one[3] = np.log(0.8)  # 8 pixels wide
    one[4] = np.log(0.4)
    none = np.zeros((5, 3, 4), np.float32)
    none[2] = 1.0
    rrd = show_objects(tmp_path, [one, none])
    centres = rrd.series(decisions_log.OBJECTS, "Boxes2D:centers")
    half_sizes = rrd.series(decisions_log.OBJECTS, "Boxes2D:half_sizes")
    (_, labels) = rrd.series(decisions_log.OBJECTS, "Boxes2D:labels")[0]
    assert centres[0][1] == [pytest.approx([35, 5])]
    assert half_sizes[0][1] == [pytest.approx([4, 2])]
    assert [label[:4] for label in labels] == ["0: a"]
    assert centres[-1][1] == []
    assert rrd.series(decisions_log.OBJECTS, "Points2D:positions") == []
    texts = [text for _, (text,) in rrd.series(decisions_log.CLASS, "TextDocument:text")]
    assert any("8 x 4" in text for text in texts)


def test_a_window_without_events_has_neither_landmark_nor_probabilities(tmp_path):
    """After the first event, which is enough for a decision, the next window begins."""
    events = events_of([0, 30_000], [5, 6], [5, 5], [1, 0])
    rrd, decisions = view_of(tmp_path, [events], confidence=1e-9, picture_us=20_000)
    assert [d.trigger for d in decisions] == ["confidence"]
    assert rrd.series(log.LANDMARK, "Points2D:positions") == [(20_000, []), (30_001, [])]
    assert rrd.times(decisions_log.PROBABILITIES) == [0]  # of the decision itself
    empty = log.bin_sheet(np.zeros(CONFIG.shape, np.float32))
    for _, sheet in rrd.images(log.RAW):
        np.testing.assert_array_equal(sheet, empty)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"connect": "rerun+http://127.0.0.1:1/proxy"}, "`out` writes a file and .* give one of"),
        ({"picture_us": 0}, "`picture_us` must be at least 1, got 0"),
    ],
)
def test_settings_that_cannot_be_shown(tmp_path, settings, message):
    with pytest.raises(ValueError, match=message):
        RerunView(MODEL, out=tmp_path / "a.rrd", **settings)
    assert list(tmp_path.iterdir()) == []


def test_windows_of_events_cannot_be_shown(tmp_path):
    config = TNTConfig(sensor=(40, 30), grid=(20, 24), window_events=500, bins=4)
    with pytest.raises(ValueError, match=r"can be viewed, but not of 500 events$"):
        RerunView(random_model(config), out=tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_packet_with_a_late_event_is_refused_as_a_whole(tmp_path):
    """Also its first part, which a picture would separate from the second."""
    late = events_of([30_000, 60_000, 5], [5, 6, 7], [5, 5, 5], [1, 0, 1])
    with RerunView(MODEL, out=tmp_path / "a.rrd", late="raise", picture_us=20_000) as view:
        view.push(events_of([10], [3], [3], [1]))
        with pytest.raises(ValueError, match=r"`t`|late"):
            view.push(late)
        assert view.processor.counts.received == 1
        assert len(view.push(late[:2])) == 1


def test_the_events_of_closed_windows_are_forgotten(tmp_path):
    """However long the stream is."""
    with RerunView(MODEL, out=tmp_path / "a.rrd", picture_us=10_000) as view:
        for start_us in range(0, 1_000_000, 50_000):
            view.push(random_events(200, duration_us=50_000, sensor=(40, 30), start_us=start_us))
            held = sum(len(part) for part in view._recent)
            assert held <= 2 * 200


@pytest.mark.parametrize(("live", "spans"), [(False, []), (True, [(-10 * 10**9, 0)])])
def test_the_plots_of_a_live_stream_show_its_last_ten_seconds(tmp_path, live, spans):
    rrd, _ = view_of(tmp_path, [EVENTS[:10]], live=live)
    assert rrd.spans == spans


def test_the_last_picture_of_a_live_stream_is_drawn(tmp_path):
    """Though pictures before it are left out, as they come faster than they can be drawn."""
    rrd, _ = view_of(tmp_path, np.array_split(EVENTS, 40), picture_us=500, live=True)
    times = rrd.times(log.EVENTS)
    whole, _ = view_of(tmp_path, np.array_split(EVENTS, 40), picture_us=500)
    assert times[-1] == int(EVENTS["t"][-1]) + 1
    assert len(times) < len(whole.times(log.EVENTS)) > 300


@pytest.mark.parametrize(("took_s", "pictures"), [(1.0, [0, 2, 4, 6, 8]), (0.0, [*range(10)])])
def test_a_live_stream_is_drawn_in_at_most_half_of_the_time(
    tmp_path, monkeypatch, took_s, pictures
):
    """By a clock that moves by half a second from event to event, and by what drawing takes. What
    was logged is flushed once a second."""
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(rerun_view, "time", SimpleNamespace(perf_counter=lambda: clock.now_s))
    with RerunView(MODEL, out=tmp_path / "a.rrd", picture_us=100, live=True) as view:
        seen = []
        flushed = []
        write = view.log.write

        def writing(at_us, *given):
            seen.append(at_us)
            clock.now_s += took_s
            write(at_us, *given)

        monkeypatch.setattr(view.log, "write", writing)
        monkeypatch.setattr(view, "_flush", lambda: flushed.append(clock.now_s))
        for k in range(11):
            view.push(events_of([100 * k], [5], [5], [1]))
            clock.now_s += 0.5
        monkeypatch.undo()
    # the picture that an event brings shows what came before it
    assert seen == [100 * (k + 1) for k in pictures]
    assert len(flushed) > 3 and np.diff(flushed).min() >= 1
