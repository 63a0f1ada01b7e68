"""What the figures draw is what the package computes."""

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")

from made import events_of, opened

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.views import figure_resynthesis, figure_window
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_style import OFF, ON, new_figure, save
from async_tnt.views.figure_subject import Subject

DIGITS = async_tnt.load_model("digits")


def sample(digit=3):
    return open_recording(sample_recordings()[digit]).read()


def subject(digit=3, **changes):
    """A bundled recording as the bundled model sees it, or with a changed configuration."""
    return Subject(
        f"{digit}.bin", sample(digit), DIGITS.config.replace(**changes), DIGITS, "digits"
    )


def dots(axes):
    """The cloud of dots in axes: (time, x, y, is ON), or (time, place, is ON)."""
    from matplotlib.colors import to_rgba

    (cloud,) = axes.collections
    columns = (
        cloud._offsets3d if hasattr(cloud, "_offsets3d") else np.asarray(cloud.get_offsets()).T
    )
    # in the order of the dots; the getter's is that of the last drawing
    colours = np.array(cloud._facecolors)
    assert {tuple(colour) for colour in colours} == {to_rgba(ON), to_rgba(OFF)}
    is_on = (colours == to_rgba(ON)).all(axis=1)
    return *[np.asarray(column, np.float64) for column in columns], is_on


def pictures(axes):
    return [np.asarray(image.get_array()) for each in axes for image in each.images]


def assert_equal(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other)


def test_resynthesis_shows_counts_the_image_and_paths():
    """ON minus OFF of each pixel, the image as it is, and each path with its own direction."""
    one = events_of([0, 1, 2], [1, 1, 4], [2, 2, 0], [1, 1, 0])
    image = np.arange(15.0).reshape(3, 5)
    way = np.linspace(0, 2, 5)[:, None]
    right = way * np.array((1, 0))
    down = way * np.array((0, 1))
    window = figure_resynthesis.ResynthesizedWindow(
        "cup", one, image, one[:1], [right, down], [one[2:]]
    )
    refused = figure_resynthesis.RefusedWindow("pen", one, "several objects")
    figure = figure_resynthesis.draw_resynthesis([window, window], [refused])
    axes = figure.axes
    found = pictures([*axes[:4], axes[8]])
    np.testing.assert_array_equal(found[4], found[0])
    assert {"cup", "pen", "no path: several objects"} <= {text.get_text() for text in figure.texts}
    assert found[0][2, 1] == 2 and found[0][0, 4] == -1 and np.abs(found[0]).sum() == 3
    np.testing.assert_array_equal(found[1], image)
    assert found[2].sum() == 1 and found[3].sum() == -1 and len(axes) == 9
    paths = [each.lines[0].get_xydata() for each in axes[1:4]]
    net = [path[-1] - path[0] for path in paths]
    np.testing.assert_allclose(net, [(2, 0), (2, 0), (0, 2)])


def test_events_are_drawn_where_they_are_and_where_the_transform_puts_them():
    shown = subject(4)
    window = shown.window(3)
    figure = new_figure(4.9)
    figure_window.draw_both(figure, window, height=4.2)
    raw, tnt = figure.axes
    events = window.events
    u, v, kept, _ = window.coordinates()
    time_ms = (events["t"] - window.start_us) / 1e3
    on = events["p"] == 1
    assert_equal(dots(raw), (time_ms, events["x"], events["y"], on))
    assert_equal(dots(tnt), (time_ms[kept], u[kept], v[kept], on[kept]))


@pytest.mark.parametrize("polarity", ["signed", "split"])
def test_slices_are_the_bins_of_the_volumes(polarity):
    shown = subject(5, polarity=polarity, bins=5)
    raw, tnt = shown.window(2).volumes()
    drawn = pictures(draw_overview(shown, 2).axes)
    assert_equal([cells for cells in drawn if cells.shape == raw[0].shape], [*raw, *tnt])
    assert np.abs(raw).max() > 1 and np.abs(tnt).max() > 1


@pytest.mark.parametrize("bins", [1, 2, 5, 9])
def test_the_time_of_a_bin_is_that_of_the_events_that_it_holds_alone(bins):
    config = async_tnt.TNTConfig(window_us=8_000, bins=bins, transform="none")
    for k in range(max(1, bins - 1)):
        time_ms = float(figure_window.bin_ms(config, k).removesuffix(" ms"))
        volume = opened(config, events_of([round(1e3 * time_ms)], [5], [4], [1]))
        assert np.flatnonzero(volume.array[:, 4, 5]).tolist() == [k]
    assert bins == 1 or figure_window.bin_ms(config, bins - 1) == "8 ms"  # the window's end


def test_probabilities_are_those_of_the_streams_decisions():
    every_us = 2_500
    shown = subject(8)
    decisions = list(async_tnt.stream([sample(8)], "digits", every_us=every_us))
    drawn = draw_overview(shown).axes
    (axes,) = [each for each in drawn if each.get_ylabel() == "class probability"]
    ends = np.flatnonzero(np.diff([d.window_start_us for d in decisions]))
    assert len(ends) == 2
    for k in range(10):
        (line,) = [line for line in axes.lines if line.get_gid() == f"class {k}"]
        drawn = ~np.isnan(line.get_ydata())
        times_ms = [(d.time_us - shown.first_us) / 1e3 for d in decisions]
        np.testing.assert_allclose(line.get_xdata()[drawn], times_ms)
        np.testing.assert_allclose(line.get_ydata()[drawn], [d.probabilities[k] for d in decisions])
        # a line ends with its window
        assert np.flatnonzero(~drawn).tolist() == [ends[0] + 1, ends[1] + 2]


@pytest.mark.filterwarnings("error")
def test_a_recording_of_one_event_is_drawn(tmp_path):
    shown = Subject("odd $x", events_of([7], [3], [4], [1]), DIGITS.config, DIGITS, "digits")
    save(draw_overview(shown), tmp_path / "one.png", 30)


def test_windows_are_those_of_the_stream():
    shown = subject(6)
    windows = [shown.window(number) for number in (1, 2, 3)]
    assert [w.start_us for w in windows] == [
        d.window_start_us for d in async_tnt.stream([sample(6)], "digits")
    ]
    assert sum(w.events.size for w in windows) == shown.events.size
    # the last two: their windows are closed
    late = events_of([0, 330_000, 10, 210_000], [1] * 4, [1] * 4, [1] * 4)
    shown = Subject("late", late, shown.config)
    assert shown.window(1).events.size == 1 and shown.window(4).events.size == 1
    with pytest.raises(
        ValueError, match="late: no events in window 2, from 105000 us on; the recording ends in"
    ):
        shown.window(2)
