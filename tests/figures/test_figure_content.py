"""What stands in the figures is what the package computes."""

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")

from figures.drawing import sample, subject
from made import events_of, random_model

import async_tnt
from async_tnt.views import figure_events as events3d
from async_tnt.views import figure_motions as motions
from async_tnt.views import figure_overview as overview
from async_tnt.views import figure_pipeline as pipeline
from async_tnt.views import figure_probabilities as probabilities
from async_tnt.views import figure_slices as slices
from async_tnt.views.figure_style import OFF, ON
from async_tnt.views.figure_subject import Subject


def dots(axes):
    """The cloud of dots in 3-D axes: (time, x, y, is ON)."""
    (cloud,) = axes.collections
    time, x, y = (np.asarray(values, np.float64) for values in cloud._offsets3d)
    return time, x, y, is_on(cloud)


def is_on(cloud):
    from matplotlib.colors import to_rgba

    colours = np.array(cloud._facecolors)  # in the order of the dots; the getter's is that of the last drawing
    assert {tuple(colour) for colour in colours} == {to_rgba(ON), to_rgba(OFF)}
    return (colours == to_rgba(ON)).all(axis=1)


def words(figure):
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def pictures(figure):
    return [np.asarray(image.get_array()) for axes in figure.axes for image in axes.images]


@pytest.mark.parametrize("number", [1, 3])
def test_events_are_drawn_where_they_are_and_where_the_transform_puts_them(number):
    shown = subject(4)
    window = shown.window(number)
    raw, tnt = events3d.draw_events(shown, number).axes
    time, x, y, on = dots(raw)
    events = window.events
    np.testing.assert_allclose(time, (events["t"] - window.start_us) / 1e3)
    np.testing.assert_array_equal(x, events["x"])
    np.testing.assert_array_equal(y, events["y"])
    np.testing.assert_array_equal(on, events["p"] == 1)
    coordinates = window.coordinates()
    time, u, v, on = dots(tnt)
    np.testing.assert_allclose(time, window.time_ms[coordinates.kept])
    np.testing.assert_array_equal(u, coordinates.u[coordinates.kept])
    np.testing.assert_array_equal(v, coordinates.v[coordinates.kept])
    np.testing.assert_array_equal(on, events["p"][coordinates.kept] == 1)


def test_more_events_than_can_be_seen_are_thinned_evenly_and_that_is_reported(monkeypatch):
    monkeypatch.setattr(events3d, "MOST_DOTS", 100)
    shown = subject(4)
    figure = events3d.draw_events(shown)
    time, *_ = dots(figure.axes[0])
    assert time.size == 100
    assert time[[0, -1]].tolist() == shown.window(1).time_ms[[0, -1]].tolist()
    assert sum("100 of them drawn" in text for text in words(figure)) == 2


@pytest.mark.parametrize("polarity", ["signed", "unsigned", "split"])
def test_slices_are_the_bins_of_the_volumes(polarity):
    shown = subject(5, polarity=polarity, bins=5)
    window = shown.window(2)
    raw, tnt = window.volumes()
    drawn = pictures(slices.draw_slices(shown, 2, [1, 4]))
    bins = [1, 4, 6, 9] if polarity == "split" else [1, 4]
    expected = [*raw[bins], *tnt[bins]]
    drawn = [picture for picture in drawn if picture.shape == raw[0].shape]
    assert len(drawn) == len(expected)
    for picture, cells in zip(drawn, expected, strict=True):
        np.testing.assert_array_equal(picture, cells)
    assert np.abs(raw).max() > 1 and np.abs(tnt).max() > 1


def test_all_bins_are_drawn_unless_they_are_too_many():
    assert slices.shown_bins(subject().config) == list(range(9))
    assert slices.shown_bins(subject(bins=40).config)[::11] == [0, 39]
    with pytest.raises(ValueError, match=r"--slices must be in \[0, 9\), the volume's bins, got 9"):
        slices.shown_bins(subject().config, [0, 9])


@pytest.mark.parametrize("every_us", [None, 7_000])
def test_probabilities_are_those_of_the_streams_decisions(every_us):
    shown = subject(8)
    decisions = list(async_tnt.stream([sample(8)], "digits", every_us=every_us or probabilities.EVERY_US))
    axes = probabilities.draw_probabilities(shown, every_us).axes[0]
    starts = np.array([d.window_start_us for d in decisions])
    assert np.unique(starts).size == 3
    for k in range(10):
        (line,) = [line for line in axes.lines if line.get_gid() == f"class {k}"]
        drawn = ~np.isnan(line.get_ydata())
        np.testing.assert_allclose(line.get_xdata()[drawn], [(d.time_us - shown.first_us) / 1e3 for d in decisions])
        np.testing.assert_array_equal(line.get_ydata()[drawn], [d.probabilities[k] for d in decisions])
        # a line ends with its window
        np.testing.assert_array_equal(np.flatnonzero(~drawn), np.add(np.flatnonzero(np.diff(starts)), [1, 2]))


def test_windows_of_one_decision_are_joined_and_a_few_points_are_seen():
    figure = probabilities.draw_probabilities(subject(8), 1_000_000)
    assert any(text.endswith("decisions of digits (running, t_max 3) at each window's end") for text in words(figure))
    axes = figure.axes[0]
    (line,) = [line for line in axes.lines if line.get_gid() == "class 8"]
    assert line.get_ydata().size == 3 and not np.isnan(line.get_ydata()).any() and line.get_marker() == "."


def test_the_verdict_is_that_of_the_program(capsys):
    from async_tnt.cli import main
    from async_tnt.sources.files.recording import sample_recordings

    assert main(["run", str(sample_recordings()[7])]) == 0
    *_, verdict = capsys.readouterr().out.splitlines()
    shown = subject(7)
    answer = probabilities.verdict(shown, probabilities.decisions_of(shown))
    assert verdict == "7.bin: " + answer.replace("“7”,", "7 (").replace("( ", "(") + ")"


def test_the_rate_counts_every_event():
    from matplotlib.figure import Figure

    shown = subject(2)
    axes = Figure().subplots()
    probabilities.draw_rate(axes, shown)
    total = [0.0, 0.0]
    for patch, sign in zip(axes.patches, (1, -1), strict=True):
        values, edges, _ = patch.get_data()
        total[sign < 0] = sign * float((values * np.diff(edges)).sum())
    on = int((shown.events["p"] == 1).sum())
    assert total == pytest.approx([on, shown.events.size - on])


def test_two_motions_are_drawn_along_the_axis_in_which_they_differ():
    shown = subject(3)
    first, second = shown.window(1), shown.window(2)
    figure = motions.draw_motions(first, second)
    assert {"window 1: moving down", "window 2: moving up"} <= set(words(figure))
    for axes, window in zip(figure.axes[1:2] + figure.axes[11:12], (first, second), strict=True):
        (cloud,) = axes.collections
        time, v = np.asarray(cloud.get_offsets()).T
        coordinates = window.coordinates()
        np.testing.assert_allclose(time, window.time_ms[coordinates.kept])
        np.testing.assert_allclose(v, coordinates.v[coordinates.kept])
        np.testing.assert_array_equal(is_on(cloud), window.events["p"][coordinates.kept] == 1)
    expected = [volume[k] for window in (first, second) for volume in window.volumes() for k in (2, 3, 4, 5)]
    for picture, cells in zip(pictures(figure), expected, strict=True):
        np.testing.assert_array_equal(picture, cells)


def test_motions_of_other_directions_and_none():
    assert motions.direction(np.array([3.0, -1.0]), 0) == "moving right"
    assert motions.direction(np.array([-3.0, -1.0]), 0) == "moving left"
    assert motions.direction(np.array([3.0, -1.0]), 1) == "moving up"
    assert motions.direction(np.array([3.0, 0.4]), 1) == "at rest along y"


def test_the_busiest_bins():
    volumes = np.zeros((2, 9, 3, 3))
    volumes[:, 5:8] = 1.0
    assert motions.busiest_bins(volumes, 9) in ([4, 5, 6, 7], [5, 6, 7, 8])
    assert motions.busiest_bins(volumes, 9, 3) == [5, 6, 7]
    split = np.zeros((2, 4, 3, 3))
    split[0, 3] = 1.0  # OFF events in bin 1 of 2
    assert motions.busiest_bins(split, 2, 1) == [1]
    assert motions.busiest_bins(np.ones((1, 33, 2, 2)), 33) == [0, 4, 8, 12]


def test_the_pipeline_shows_what_the_network_sees_and_says():
    shown = subject(9)
    window = shown.window(1)
    figure = pipeline.draw_pipeline(shown)
    decision = pipeline.decision_of(window, shown.model)
    first = next(d for d in async_tnt.stream([sample(9)], "digits") if d.trigger == "window")
    np.testing.assert_array_equal(decision.probabilities, first.probabilities)
    bars = figure.axes[-1].patches
    np.testing.assert_array_equal([bar.get_width() for bar in bars], first.probabilities)
    assert "9.bin, window 1: from events to “9”" in words(figure)
    stages = [
        "recording",
        "raw events",
        "landmark: running",
        "transformed events",
        "event volume",
        "network",
        "class probabilities",
    ]
    numbered = [text for text in words(figure) if text[:1].isdigit() and "  " in text]
    assert numbered == [f"{k}  {name}" for k, name in enumerate(stages, start=1)]
    (path,) = [line for line in figure.axes[2].lines if len(line.get_xdata()) > 1]
    centroid = window.coordinates().landmark
    np.testing.assert_array_equal(path.get_xydata()[[0, -1]], centroid[[0, -1]])
    volume = figure.axes[4]
    stacked = sorted(volume.images, key=lambda image: -image.get_zorder())
    np.testing.assert_array_equal([np.asarray(image.get_array()) for image in stacked], window.volumes()[1])


def test_layers_are_read_from_the_weights():
    model = random_model(classes=4, widths=(5, 6, 7))
    assert pipeline.layer_words(model) == [
        "5 convolutions 3x3, ReLU,\naverage of 2x2",
        "6 convolutions 3x3, ReLU,\naverage of 2x2",
        "384 to 7 fully connected, ReLU",
        "7 to 4 fully connected",
    ]


def test_the_pipeline_of_a_network_on_raw_volumes_has_no_transform():
    model = random_model(async_tnt.TNTConfig(transform="none"))
    shown = Subject("3.bin", sample(), model.config, model, "raw")
    figure = pipeline.draw_pipeline(shown)
    assert "3  event volume" in words(figure) and "5  class probabilities" in words(figure)
    stacked = sorted(figure.axes[2].images, key=lambda image: -image.get_zorder())
    np.testing.assert_array_equal([np.asarray(image.get_array()) for image in stacked], shown.window(1).volumes()[0])


def test_the_landmark_network_is_the_models():
    model = random_model(async_tnt.TNTConfig(landmark="regressor"))
    shown = Subject("3.bin", sample(), model.config, model, "mine")
    figure = pipeline.draw_pipeline(shown)
    processor = async_tnt.Processor(model)
    processor.push(shown.window(1).events)
    (cross,) = figure.axes[2].lines
    np.testing.assert_allclose(cross.get_xydata(), [processor.landmark], atol=1e-12)
    with pytest.raises(ValueError, match="needs a model with a landmark network, but model digits has none"):
        subject(landmark="regressor")
    with pytest.raises(ValueError, match="but there is no model"):
        Subject("3.bin", sample(), model.config)


def test_the_pipeline_refuses_another_configuration():
    with pytest.raises(ValueError, match="drawn with the configuration of model digits"):
        pipeline.draw_pipeline(subject(t_max=2.0))


def test_an_overview_without_a_model_has_no_decisions():
    shown = Subject("3.bin", sample(), subject().config)
    assert "class probability" in {axes.get_ylabel() for axes in overview.draw_overview(subject()).axes}
    assert "class probability" not in {axes.get_ylabel() for axes in overview.draw_overview(shown).axes}
    with pytest.raises(ValueError, match="no model to make decisions"):
        probabilities.decisions_of(shown)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "events",
    [
        events_of([7], [3], [4], [1]),
        events_of([7, 7, 7], [3, 3, 33], [4, 4, 0], [1, 0, 0]),
        events_of([1 << 40, (1 << 40) + 104_999, (1 << 40) + 300_000_000], [3, 9, 9], [4, 5, 6], [0, 0, 0]),
        events_of([200_000, 100, 250_000], [3, 9, 9], [4, 5, 6], [1, 1, 1]),
    ],
)
def test_odd_recordings_are_drawn(events):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    model = async_tnt.load_model("digits")
    shown = Subject("odd $x", events, model.config, model, "digits")
    figures = [
        overview.draw_overview(shown),
        pipeline.draw_pipeline(shown),
        motions.draw_motions(shown.window(1), shown.window(1)),
    ]
    for figure in figures:
        figure.set_dpi(30)
        FigureCanvasAgg(figure).draw()


def test_windows_are_those_of_the_stream():
    shown = subject(6)
    starts = [d.window_start_us for d in async_tnt.stream([sample(6)], "digits")]
    assert [shown.window(k).start_us for k in (1, 2, 3)] == starts
    assert sum(shown.window(k).events.size for k in (1, 2, 3)) == shown.events.size
    with pytest.raises(ValueError, match=r"6.bin: no window 4; the recording has 3 windows of 105000 us"):
        shown.window(4)
    late = events_of([0, 330_000, 10, 210_000], [1] * 4, [1] * 4, [1] * 4)  # the last two: their windows are closed
    shown = Subject("late", late, shown.config)
    assert shown.window(1).events.size == 1 and shown.window(4).events.size == 1
    with pytest.raises(ValueError, match="late: no events in window 2, from 105000 us on"):
        shown.window(2)
    with pytest.raises(ValueError, match="no event at or after the first window's start, 400000 us"):
        Subject("late", late, shown.config, start_us=400_000).window(1)
    with pytest.raises(ValueError, match="late: no events to draw"):
        Subject("late", late[:0], shown.config)
