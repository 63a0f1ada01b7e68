"""RerunView: what is in the file equals what the processor had, bit for bit."""

import numpy as np
import pytest
from made import events_of, random_events, random_model

from async_tnt import Model, Processor, TNTConfig, TNTVolume, load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings

rrd_files = pytest.importorskip("views.rrd_files", reason="rerun-sdk is not installed (extra `view`)")
Rrd = rrd_files.Rrd
from async_tnt.views import rerun_layout as layout  # noqa: E402
from async_tnt.views.rerun_pictures import newest_text  # noqa: E402
from async_tnt.views.rerun_view import RerunView, next_moment  # noqa: E402

CONFIG = TNTConfig(sensor=(40, 30), grid=(20, 24), window_us=50_000, bins=4)
EVENTS = random_events(3000, duration_us=170_000, sensor=(40, 30), start_us=7_000)


def view_of(tmp_path, model, packets, name="a.rrd", **settings):
    """Shown from packets, and read back; with the decisions that came."""
    decisions = []
    with RerunView(model, out=tmp_path / name, **settings) as view:
        for packet in packets:
            decisions += view.push(packet)
        decisions += view.finish()
    return Rrd(tmp_path / name), decisions


def sure(model):
    """The same network with probabilities that differ."""
    weights = model.weights | {"fc2.weight": model.weights["fc2.weight"] * 300}
    return Model(model.config, weights, model.classes, {"made": True})


def truth_at(model, events, at_us, **settings):
    """A processor that saw the events before a moment, and the raw volume of its window."""
    processor = Processor(model, **settings)
    before = events[np.maximum.accumulate(events["t"]) < at_us]
    processor.push(before)
    now = processor.fire()
    raw = TNTVolume(processor.config.replace(transform="none", landmark="center", remove_flow=False))
    raw.open(now.window_start_us)
    end_us = now.window_start_us + processor.config.window_us
    inside = before[(before["t"] >= now.window_start_us) & (before["t"] < end_us)]
    raw.update(inside if now.events else inside[:0])
    assert raw.n_events == now.events
    return processor, now, raw


@pytest.mark.parametrize(
    "landmark, settings",
    [
        ("running", {}),
        ("line", {"every_us": 7_000}),
        ("window", {"every_events": 100}),
        ("regressor", {}),
        ("center", {"confidence": 0.8}),
        ("running", {"start_us": 1_234}),
    ],
)
def test_volumes_and_landmarks_equal_the_processors_at_every_picture(tmp_path, landmark, settings):
    model = random_model(CONFIG.replace(landmark=landmark))
    if "confidence" in settings:
        model = sure(model)
    packets = np.array_split(EVENTS, 37)
    rrd, decisions = view_of(tmp_path, model, packets, picture_us=9_000, **settings)
    processor = Processor(model, **settings)
    expected = [d for packet in packets for d in processor.push(packet)] + processor.finish()
    assert [(d.time_us, d.index, d.events, d.trigger) for d in decisions] == [
        (d.time_us, d.index, d.events, d.trigger) for d in expected
    ]
    if "confidence" in settings:
        assert {d.trigger for d in decisions} >= {"confidence"} and decisions[0].events > 20
    raws, tnts = rrd.tensors(layout.RAW_VOLUME), rrd.tensors(layout.TNT_VOLUME)
    landmarks = rrd.series(layout.LANDMARK, "Points2D:positions")
    crosses = [arms for _, arms in rrd.series(layout.LANDMARK_CROSS, "LineStrips2D:strips")]
    assert len(raws) > 18 and any(tnt.any() for _, tnt in tnts)
    for (t, raw), (t_tnt, tnt), (t_landmark, points), cross in zip(raws, tnts, landmarks, crosses, strict=True):
        truth, now, raw_truth = truth_at(model, EVENTS, t, **settings)
        assert t == t_tnt == t_landmark
        assert raw.tobytes() == raw_truth.array.tobytes()
        assert tnt.tobytes() == truth.volume().tobytes()
        if now.events:
            x, y = truth.config.to_sensor(*truth.landmark)
            assert points == [pytest.approx([x + 0.5, y + 0.5], abs=1e-4)]
            assert [np.mean(arm, axis=0).tolist() for arm in cross] == [pytest.approx(points[0], abs=1e-4)] * 2
        else:
            assert points == cross == []


def test_pictures_fall_on_their_moments_however_the_stream_is_cut(tmp_path):
    model = random_model(CONFIG)
    seen = []
    for k, n_packets in enumerate((1, 13, 3000)):
        rrd, _ = view_of(tmp_path, model, np.array_split(EVENTS, n_packets), f"{k}.rrd", picture_us=20_000)
        images = rrd.images(layout.EVENTS, "SegmentationImage")
        seen.append([(t, image.tobytes()) for t, image in images] + rrd.series(layout.RATES, "Scalars:scalars"))
        assert [t for t, _ in images] == rrd.times(layout.RAW_VOLUME)
    assert seen[0] == seen[1] == seen[2]
    first_us = int(EVENTS["t"][0])
    moments = [first_us]
    while moments[-1] <= EVENTS["t"][-1]:
        moments.append(next_moment(moments[-1], first_us, 50_000, 20_000))
    assert [t for t, _ in images] == [*moments[1:-1], int(EVENTS["t"][-1]) + 1]
    assert first_us + 50_000 in moments and first_us + 100_000 in moments


def test_event_images_show_the_last_moments(tmp_path):
    rrd, _ = view_of(tmp_path, random_model(CONFIG), [EVENTS], picture_us=20_000)
    for t, image in rrd.images(layout.EVENTS, "SegmentationImage"):
        expected = np.zeros((30, 40), np.uint8)
        for event in EVENTS[(EVENTS["t"] >= t - 20_000) & (EVENTS["t"] < t)]:
            expected[event["y"], event["x"]] = 2 if event["p"] else 1
        assert np.array_equal(image, expected)
        assert image.any()
    classes = rrd.static(layout.EVENTS, "AnnotationContext:context")[0]
    infos = [c["class_description"]["info"] for c in classes]
    assert [(info["id"], info["label"]) for info in infos] == [
        (0, "no event"),
        (1, "OFF (darker)"),
        (2, "ON (brighter)"),
    ]
    assert all(info["color"] for info in infos)  # the viewer gives one without a colour any, and that fills the picture


def test_probabilities_decisions_and_numbers(tmp_path):
    model = load_model("digits")
    recording = open_recording(sample_recordings()[7])
    rrd, decisions = view_of(tmp_path, model, recording, every_us=50_000)
    assert rrd.static(layout.PROBABILITIES, "SeriesLines:names") == list(model.classes)
    assert len(set(rrd.static(layout.PROBABILITIES, "SeriesLines:colors"))) == len(model.classes)
    series = rrd.series(layout.PROBABILITIES, "Scalars:scalars")
    for decision in decisions:
        assert (decision.time_us, decision.probabilities.tolist()) in series
    lines = rrd.series(layout.DECISIONS, "TextLog:text")
    assert [t for t, _ in lines] == [d.time_us for d in decisions]
    for decision, (_, (text,)) in zip(decisions, lines, strict=True):
        assert text.startswith(
            f"{decision.label}  {decision.probability:.3f}  {decision.trigger}: {decision.events:,} "
        )
        assert text.endswith(f", {decision.window_start_us / 1e3:,.3f} to {decision.time_us / 1e3:,.3f} ms")
    rates = rrd.series(layout.RATES, "Scalars:scalars")
    events = recording.read()
    times = [int(events["t"][0]), *(t for t, _ in rates)]
    received = sum(rate[0] * (b - a) / 1e6 for a, b, (_, rate) in zip(times, times[1:], rates, strict=False))
    assert received == pytest.approx(len(events))
    processor = Processor(model)
    processor.push(events)
    processor.finish()
    dropped = sum(rate[1] * (b - a) / 1e6 for a, b, (_, rate) in zip(times, times[1:], rates, strict=False))
    assert dropped == pytest.approx(processor.counts.received - processor.counts.kept)
    assert all(0 < mean <= longest for _, (mean, longest) in rrd.series(layout.LATENCY, "Scalars:scalars"))


def test_the_class_of_the_moment_is_written_below_the_events_and_beside_them(tmp_path):
    model = load_model("digits")
    events = open_recording(sample_recordings()[7]).read()
    rrd, _ = view_of(tmp_path, model, [events])
    labels = rrd.series(layout.CLASS, "Points2D:labels")
    texts = rrd.series(layout.NEWEST, "TextDocument:text")
    places = rrd.series(layout.CLASS, "Points2D:positions")
    assert len(texts) == len(places) == len(rrd.times(layout.EVENTS)) > 15
    n_named = 0
    for (t, (text,)), (t_place, place) in zip(texts, places, strict=True):
        _, now, _ = truth_at(model, events, t)
        assert t_place == t and text == newest_text(now, model.classes)
        if now.events:
            assert place == [[17.0, 34.0]] and labels[n_named] == (t, [f"{now.label} {now.probability:.2f}"])
            n_named += 1
        else:
            assert place == []
    assert n_named > 12 and labels[-2][1][0].startswith("7 ")


@pytest.mark.parametrize("transform", ["tnt", "none"])
def test_every_view_of_the_layout_shows_something_and_everything_is_shown(tmp_path, transform):
    rrd, _ = view_of(tmp_path, random_model(CONFIG.replace(transform=transform)), [EVENTS])
    expected = {
        "events": "2D",
        layout.RAW_SHEET: "2D",
        layout.RAW_VOLUME: "Tensor",
        layout.NEWEST: "TextDocument",
        layout.PROBABILITIES: "TimeSeries",
        layout.RATES: "TimeSeries",
        layout.LATENCY: "TimeSeries",
        layout.DECISIONS: "TextLog",
    }
    if transform == "tnt":
        expected |= {layout.TNT_SHEET: "2D", layout.TNT_VOLUME: "Tensor"}
    assert rrd.views == expected
    shown = {entity: [view for view in rrd.views if f"{entity}/".startswith(f"{view}/")] for entity in rrd.rows}
    assert all(len(views) == 1 for views in shown.values())
    assert {view for views in shown.values() for view in views} == set(expected)


def test_every_line_has_a_colour_of_its_own(tmp_path):
    """The viewer shows lines with none in the colours of others, and then those in wrong ones, too."""
    model = load_model("digits")
    with RerunView(model, out=tmp_path / "a.rrd", name="seven and three") as view:
        for digit in (7, 3):
            view.start(f"{digit}.bin")
            view.push(open_recording(sample_recordings()[digit]).read())
    rrd = Rrd(tmp_path / "a.rrd")
    colours = dict(zip(model.classes, rrd.static(layout.PROBABILITIES, "SeriesLines:colors"), strict=True))
    lines = [row for t, row in rrd.rows[layout.DECISIONS] if t is not None]
    begins = [row["TextLog:color"] for row in lines if "begins" in row["TextLog:text"][0]]
    assert len(begins) == 2 and begins[0] == begins[1] and begins[0][0] not in colours.values()
    decided = [row for row in lines if "begins" not in row["TextLog:text"][0]]
    assert len({row["TextLog:text"][0].split()[0] for row in decided}) > 1
    assert all(row["TextLog:color"] == [colours[row["TextLog:text"][0].split()[0]]] for row in decided)
    assert rrd.name == "seven and three"


def test_sources_follow_each_other_in_time(tmp_path):
    model = random_model(CONFIG)
    early = events_of(EVENTS["t"] - 7_000, EVENTS["x"], EVENTS["y"], EVENTS["p"])
    with RerunView(model, out=tmp_path / "a.rrd") as view:
        view.start("one.bin")
        view.push(EVENTS)
        view.start("two.bin")
        view.push(early)
    rrd = Rrd(tmp_path / "a.rrd")
    offset_us = int(EVENTS["t"][-1]) + 20_000 - int(early["t"][0])
    begins = [(t, text) for t, (text,) in rrd.series(layout.DECISIONS, "TextLog:text") if "begins" in text]
    assert begins == [
        (int(EVENTS["t"][0]), "one.bin begins"),
        (int(EVENTS["t"][-1]) + 20_000, f"two.bin begins, its times moved by {offset_us:+,} us"),
    ]
    tensors = rrd.tensors(layout.TNT_VOLUME)
    n = len(tensors) // 2
    for (t, first), (t_second, second) in zip(tensors[:n], tensors[n:], strict=True):
        assert t_second - t == offset_us - 7_000 and first.tobytes() == second.tobytes()


def test_a_silence_is_shown_by_its_beginning_alone(tmp_path):
    events = EVENTS[:200].copy()
    events["t"][100:] += 3_600_000_000
    rrd, _ = view_of(tmp_path, random_model(CONFIG), [events], picture_us=20_000)
    images = rrd.images(layout.EVENTS, "SegmentationImage")
    dark = [t for t, image in images if not image.any()]
    assert len(dark) == 1 and events["t"][99] < dark[0] < events["t"][99] + 60_000
    assert len(images) < 10


def test_nothing_per_event_is_written_and_decisions_are_capped(tmp_path):
    rrd, decisions = view_of(tmp_path, random_model(CONFIG), [EVENTS], every_events=1, picture_us=20_000)
    lines = [text for _, (text,) in rrd.series(layout.DECISIONS, "TextLog:text")]
    n_pictures = len(rrd.times(layout.EVENTS))
    assert len(decisions) > 2900 and len(lines) <= 20 * (n_pictures + 1)
    assert sum("are not shown" in line for line in lines) >= n_pictures - 3
    assert len(rrd.times(layout.PROBABILITIES)) <= 21 * (n_pictures + 1)


def test_pictures_are_capped_on_the_clock(tmp_path):
    model = random_model(CONFIG)
    rrd, _ = view_of(tmp_path, model, [EVENTS], picture_us=1_000, most_pictures_per_s=0.001)
    assert len(rrd.times(layout.RAW_VOLUME)) == 2  # the first and the last
    t, raw = rrd.tensors(layout.RAW_VOLUME)[-1]
    assert raw.tobytes() == truth_at(model, EVENTS, t)[2].array.tobytes()


def test_a_large_volume_is_written_whole_at_window_ends_alone(tmp_path, monkeypatch):
    monkeypatch.setattr("async_tnt.views.rerun_log.MOST_TENSOR_BYTES", 100)
    rrd, _ = view_of(tmp_path, random_model(CONFIG), [EVENTS], picture_us=20_000)
    first_us = int(EVENTS["t"][0])
    ends = [first_us + k * 50_000 for k in (1, 2, 3)]
    assert rrd.times(layout.RAW_VOLUME) == [*ends, int(EVENTS["t"][-1]) + 1] == rrd.times(layout.TNT_VOLUME)
    assert len(rrd.times(layout.RAW_SHEET)) > 8


def test_of_many_classes_the_likeliest_is_drawn(tmp_path):
    rrd, decisions = view_of(tmp_path, random_model(CONFIG, classes=70), [EVENTS])
    assert rrd.static(layout.PROBABILITIES, "SeriesLines:names") == ["likeliest class"]
    assert (decisions[0].time_us, [decisions[0].probability]) in rrd.series(layout.PROBABILITIES, "Scalars:scalars")


def test_without_a_transform_there_is_no_second_volume(tmp_path):
    rrd, _ = view_of(tmp_path, random_model(CONFIG.replace(transform="none")), [EVENTS])
    assert layout.RAW_VOLUME in rrd.rows
    transformed = {layout.TNT_VOLUME, layout.TNT_SHEET, layout.LANDMARK, layout.LANDMARK_CROSS}
    assert not transformed & rrd.rows.keys()


def test_any_processor_and_any_form_of_events(tmp_path):
    processor = Processor(CONFIG, classifier=lambda volume: [volume.max(), 1.0], start_us=1_234)
    with RerunView(processor, out=tmp_path / "a.rrd") as view:
        view.push(None)
        view.push(tuple(EVENTS[name] for name in "txyp"))
    rrd = Rrd(tmp_path / "a.rrd")
    assert rrd.static(layout.PROBABILITIES, "SeriesLines:names") == ["0", "1"]
    assert 51_234 in rrd.times(layout.RAW_VOLUME)


def test_mistakes():
    model = random_model(CONFIG)
    with pytest.raises(ValueError, match="`hop_us` makes windows overlap"):
        RerunView(model, out="a.rrd", hop_us=10_000)
    with pytest.raises(ValueError, match="give one of them"):
        RerunView(model, out="a.rrd", connect="rerun+http://127.0.0.1:9876/proxy")
    with pytest.raises(ValueError, match="`picture_us` must be at least 1, got 0"):
        RerunView(model, out="a.rrd", picture_us=0)
    with pytest.raises(ValueError, match="`most_pictures_per_s` must be above 0, got -1"):
        RerunView(model, out="a.rrd", most_pictures_per_s=-1)


def test_windows_that_overlap_are_refused_where_they_show(tmp_path):
    processor = Processor(random_model(CONFIG), hop_us=10_000)
    with (
        pytest.raises(ValueError, match=r"a view can only follow windows without overlap \(no `hop_us`\)"),
        RerunView(processor, out=tmp_path / "a.rrd") as view,
    ):
        view.push(EVENTS)


def test_times_beyond_reruns_clock(tmp_path):
    with RerunView(random_model(CONFIG), out=tmp_path / "a.rrd") as view:
        with pytest.raises(ValueError, match="to be shown by Rerun"):
            view.push(([1 << 61], [0], [0], [1]))
        view.push(([1_700_000_000_000_000], [0], [0], [1]))  # microseconds since 1970
    assert Rrd(tmp_path / "a.rrd").times(layout.EVENTS) == [1_700_000_000_000_001]


def test_late_events_are_taken_as_the_processor_takes_them(tmp_path):
    model = random_model(CONFIG)
    rng = np.random.default_rng(3)
    events = EVENTS[np.argsort(EVENTS["t"] + rng.integers(0, 30_000, len(EVENTS)), kind="stable")]
    rrd, _ = view_of(tmp_path, model, [events], start_us=7_000)
    for t, raw in rrd.tensors(layout.RAW_VOLUME):
        assert raw.tobytes() == truth_at(model, events, t, start_us=7_000)[2].array.tobytes()


@pytest.mark.parametrize("settings", [{"late": "drop"}, {"start_us": 0}, {"late": "drop", "start_us": 0}])
def test_a_processor_is_followed_as_its_settings_are(tmp_path, settings):
    """Given ready, it has them itself: pictures and raw volumes are those of a view that was given them."""
    model = random_model(CONFIG)
    rng = np.random.default_rng(3)
    events = EVENTS[np.argsort(EVENTS["t"] + rng.integers(0, 30_000, len(EVENTS)), kind="stable")]
    given, _ = view_of(tmp_path, model, [events], "given.rrd", **settings)
    ready, _ = view_of(tmp_path, Processor(model, **settings), [events], "ready.rrd")
    seen = [[(t, a.tobytes()) for t, a in rrd.tensors(layout.RAW_VOLUME)] for rrd in (given, ready)]
    assert seen[0] == seen[1] and len(seen[0]) > 8
    if "start_us" in settings:
        assert 50_000 in ready.times(layout.RAW_VOLUME)  # the end of the first window


# -- the file ------------------------------------------------------------------------------------------------


def test_a_file_without_events_is_not_written(tmp_path):
    (tmp_path / "a.rrd").write_bytes(b"before")
    with RerunView(random_model(CONFIG), out=tmp_path / "a.rrd"):
        pass
    assert (tmp_path / "a.rrd").read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_after_an_error_the_file_holds_what_came_before(tmp_path):
    with pytest.raises(OSError, match="unplugged"), RerunView(random_model(CONFIG), out=tmp_path / "a.rrd") as view:
        view.push(EVENTS)
        raise OSError("unplugged")
    assert len(Rrd(tmp_path / "a.rrd").times(layout.RAW_VOLUME)) > 8


def test_closing_twice_and_a_classifier_that_fails(tmp_path):
    def fails(volume):
        raise RuntimeError("no answer")

    with (
        pytest.raises(RuntimeError, match="no answer"),
        RerunView(CONFIG, classifier=fails, out=tmp_path / "a.rrd") as view,
    ):
        view.push(EVENTS)
    view.close()
    assert not (tmp_path / "a.rrd.part").exists()
