"""What the figures draw is what the package computes."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")

from made import events_of, opened, random_events, random_model

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.views import figure_overview, figure_resynthesis, figure_window
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_style import OFF, ON, new_figure, save, shortened
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
    for each, path in zip(axes[1:4], paths, strict=True):
        # a path lies around the picture's middle, with an arrow at its end
        np.testing.assert_allclose((path.min(axis=0) + path.max(axis=0)) / 2, (2, 1))
        (arrow,) = each.texts
        np.testing.assert_allclose([arrow.xyann, arrow.xy], path[-2:])
    counts = [each.images[0].get_clim() for each in (axes[0], *axes[2:4])]
    assert counts == [(-4, 4)] * 3
    for each in axes:
        assert shape_of(each) == pytest.approx(3 / 5)
    titles = [text.get_text() for text in figure.texts][1:5]
    assert titles == ["as recorded", "image, path found", "the same path", "other path 1"]


def test_a_path_that_stays_where_it_is_has_no_arrow():
    axes = new_figure(2.0).subplots()
    figure_resynthesis._draw_path(axes, np.full((5, 2), 3.0), (5, 3))
    assert axes.lines[0].get_xydata().tolist() == [[2, 1]] * 5
    assert list(axes.texts) == []


def shape_of(axes):
    """Height of axes by their width, on the page."""
    width, height = axes.get_position(original=True).size * axes.figure.get_size_inches()
    return height / width


def test_pictures_are_shown_as_they_look_beside_their_recordings():
    """Light as the eye sees it, about its root; then ON minus OFF of each recording."""
    light = np.array([[0.01, 0.25, 0.64], [0.81, 0.04, 0.49]])
    events = events_of([0, 1, 2], [1, 1, 4], [2, 2, 0], [1, 1, 0])
    figure = figure_resynthesis.draw_recorded_pictures(
        [("cup", light, [events, events[:1]])], (5, 3)
    )
    shown, first, second = pictures(figure.axes)
    np.testing.assert_allclose(shown, [[0.1, 0.5, 0.8], [0.9, 0.2, 0.7]])
    assert (first[2, 1], first[0, 4], np.abs(first).sum()) == (2, -1, 3)
    assert (second[2, 1], np.abs(second).sum()) == (1, 1)
    # the picture keeps its shape, within the place of a recording
    assert [shape_of(axes) for axes in figure.axes] == pytest.approx([2 / 3, 3 / 5, 3 / 5])
    sizes = [axes.get_position().size for axes in figure.axes]
    assert (sizes[0] <= sizes[1] + 1e-9).all()
    assert figure.axes[0].images[0].get_clim() == (0, 1)
    assert "cup" in [text.get_text() for text in figure.texts]


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
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    colours = [handle.get_color() for handle in legend.legend_handles]
    assert list(zip(words, colours, strict=True)) == [("ON (brighter)", ON), ("OFF (darker)", OFF)]


def test_space_time_has_the_sides_of_the_sensor_and_of_the_grid():
    """Rows go downwards. Many dots are so small that they cover as much as 3,000 of full size."""
    config = async_tnt.TNTConfig(sensor=(60, 20), grid=(30, 20), bins=1, window_us=100_000)
    for n, size in ((300, 3.0), (12_000, 1.5)):
        events = random_events(n, duration_us=100_000, sensor=(60, 20))
        shown = Subject("a", events, config)
        figure = new_figure(4.9)
        figure_window.draw_both(figure, shown.window(1), height=4.2)
        raw, tnt = figure.axes
        assert raw.get_xlim() == tnt.get_xlim() == (0, 100)
        assert (raw.get_ylim(), raw.get_zlim()) == ((0, 59), (19, 0))
        assert (tnt.get_ylim(), tnt.get_zlim()) == ((0, 29), (19, 0))
        assert [raw.get_ylabel(), raw.get_zlabel()] == ["x (px)", "y (px)"]
        assert [tnt.get_ylabel(), tnt.get_zlabel()] == ["u (px)", "v (px)"]
        assert raw.collections[0].get_sizes() == pytest.approx([size])
    pictures_of_bins = [axes for axes in draw_overview(shown).axes if axes.get_title()]
    assert [shape_of(axes) for axes in pictures_of_bins] == pytest.approx([20 / 30])


def test_the_full_colour_begins_at_the_98th_of_100_cells_that_are_not_zero():
    cells = np.zeros((2, 30, 20), np.float32)
    cells[0].flat[:100] = -np.arange(1, 101)
    layers = [figure_window.Layer(volume, "a", "signed") for volume in (cells, 0 * cells)]
    figure = new_figure(4.0)
    images = figure_window.draw_rows(figure, layers, [0, 1], ["0", "1"], (1, 1), (1, 1))
    limits = [axes.images[0].get_clim() for axes in figure.axes]
    assert limits[:2] == [pytest.approx((-98.02, 98.02))] * 2 and limits[2:] == [(-1, 1)] * 2
    assert [image.axes for image in images] == [figure.axes[1], figure.axes[3]]


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
        time_ms = float(figure_window.bin_time(config, k).removesuffix(" ms"))
        volume = opened(config, events_of([round(1e3 * time_ms)], [5], [4], [1]))
        assert np.flatnonzero(volume.array[:, 4, 5]).tolist() == [k]
    assert bins == 1 or figure_window.bin_time(config, bins - 1) == "8 ms"  # the window's end


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


def probabilities_of(figure):
    (axes,) = [each for each in figure.axes if each.get_ylabel() == "class probability"]
    return axes


def test_each_windows_decision_stands_above_its_start(monkeypatch):
    """In a recording of as many windows as may have a name. The likeliest classes of all decisions
    are named, the likeliest first. Names are cut to ten letters."""
    monkeypatch.setattr(figure_overview, "MOST_NAMED", 3)
    names = [f"{k} is the digit" for k in range(10)]
    model = replace(DIGITS, classes=names, statistics=None)  # these are of the classes
    shown = Subject("8.bin", sample(8), DIGITS.config, model, "digits")
    decisions = list(async_tnt.stream([sample(8)], "digits", every_us=2_500))
    last = [d for d in decisions if d.trigger in ("window", "end")]
    figure = draw_overview(shown)
    axes = probabilities_of(figure)
    assert len(last) == 3
    starts_ms = [(d.window_start_us - shown.first_us) / 1e3 for d in last]
    notes = [(text.get_text(), *text.xy) for text in axes.texts]
    assert notes == [
        (f"“{d.label} is the …” {d.probability:.2f}", start_ms, 1.0)
        for d, start_ms in zip(last, starts_ms, strict=True)
    ]
    upright = [line.get_xdata() for line in axes.lines if line.get_gid() is None]
    assert [list(x) for x in upright] == [[x, x] for x in starts_ms]
    assert axes.get_xlim() == pytest.approx((0, starts_ms[-1] + 105)) and axes.get_ylim() == (0, 1)
    likeliest = np.argsort(-np.mean([d.probabilities for d in decisions], axis=0), kind="stable")
    named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert named == [f"“{k} is the …”" for k in likeliest[:4]]
    assert figure.texts[-1].get_text().startswith("8.bin: “8 is the digit”, ")


def test_a_long_recording_has_fewer_decisions_and_no_names(monkeypatch):
    """Here of three windows: from 30 ms on, one more would be too many."""
    shown = subject(8)
    monkeypatch.setattr(figure_overview, "MOST_DECISIONS", 10)
    monkeypatch.setattr(figure_overview, "MOST_NAMED", 2)
    axes = probabilities_of(draw_overview(shown))
    t = sample(8)["t"]
    every_us = int(t.max() - t.min()) // 10 // 500 * 500
    assert every_us > 2_500
    assert f"every {every_us / 1e3:g} ms" in axes.get_xlabel()
    expected = list(async_tnt.stream([sample(8)], "digits", every_us=every_us))
    (line,) = [line for line in axes.lines if line.get_gid() == "class 0"]
    assert (~np.isnan(line.get_ydata())).sum() == len(expected)
    assert list(axes.texts) == []


def test_the_lines_of_a_window_that_slides_have_no_gaps():
    config = async_tnt.TNTConfig(representation="count", last_us=50_000)
    shown = Subject("5.bin", sample(5), DIGITS.config, random_model(config), "slides")
    axes = probabilities_of(draw_overview(shown))
    y = np.array([line.get_ydata() for line in axes.lines if line.get_gid() is not None])
    assert y.shape[1] > 50 and np.isfinite(y).all()
    np.testing.assert_allclose(y.sum(axis=0), 1, rtol=1e-5)


def test_decisions_begin_with_the_windows_that_are_drawn():
    events = sample(8)
    start_us = int(events["t"][0]) + 40_000
    shown = Subject("8.bin", events, DIGITS.config, DIGITS, "digits", start_us)
    axes = probabilities_of(draw_overview(shown))
    decisions = list(async_tnt.stream([events], "digits", every_us=2_500, start_us=start_us))
    (line,) = [line for line in axes.lines if line.get_gid() == "class 8"]
    drawn = ~np.isnan(line.get_ydata())
    np.testing.assert_allclose(
        line.get_xdata()[drawn], [(d.time_us - start_us) / 1e3 for d in decisions]
    )


@pytest.mark.parametrize("polarity", ["signed", "split", "unsigned"])
def test_rows_have_names_colours_and_room(polarity, monkeypatch):
    """Three of nine bins, evenly spread; what has a sign is white at zero."""
    from matplotlib.colors import to_hex

    monkeypatch.setattr(figure_overview, "MOST_SLICES", 3)
    figure = draw_overview(subject(5, polarity=polarity, bins=9))
    for axes in figure.axes:
        place = axes.get_position()
        assert place.y0 > 0 and place.y1 <= 1
    names = {"split": ["raw, ON", "raw, OFF", "TNT, ON", "TNT, OFF"]}.get(polarity, ["raw", "TNT"])
    with_images = [axes for axes in figure.axes if axes.images and axes.get_label() == ""]
    assert len(with_images) == 3 * len(names)
    titles = [axes.get_title().splitlines()[0] for axes in with_images[:3]]
    assert titles == ["bin 0", "bin 4", "bin 8"]
    assert not any(axes.get_title() for axes in with_images[3:])
    firsts = with_images[::3]
    assert not any(axes.get_ylabel() for axes in with_images if axes not in firsts)
    assert [axes.get_ylabel() for axes in firsts] == names
    for axes, name in zip(firsts, names, strict=True):
        (picture,) = axes.images
        least, most = picture.get_clim()
        assert least == (-most if polarity == "signed" else 0)
        strongest = {"split": OFF if name.endswith("OFF") else ON, "signed": ON}
        assert to_hex(picture.cmap(1.0)) == strongest.get(polarity, "#222222").lower()


def test_dots_that_are_left_out_are_left_out_everywhere(monkeypatch):
    """Not at the end of the window. The titles count all events."""
    shown = subject(4)
    window = shown.window(1)
    monkeypatch.setattr(figure_window, "MOST_DOTS", 10)
    figure = new_figure(4.9)
    figure_window.draw_both(figure, window, height=4.2)
    raw, tnt = figure.axes
    time_ms, *_ = dots(raw)
    assert len(time_ms) == 10
    assert time_ms[-1] == window.time_ms[-1]
    assert len(dots(tnt)[0]) == 10
    kept = int(window.coordinates().kept.sum())
    words = [text.get_text() for text in figure.texts]
    assert words[0] == f"raw: {window.events.size:,} events in window 1"
    assert words[1].endswith(f": {kept:,} events kept")
    assert 0 < kept < window.events.size


def test_a_landmark_network_is_asked_for_at_once():
    """One of the volumes that are drawn."""
    regressed = DIGITS.config.replace(landmark="regressor")
    message = "needs a model with a landmark network, but "
    for model, who in ((None, "there is no model"), (DIGITS, "model digits has none")):
        with pytest.raises(ValueError, match=f"{message}{who}$"):
            Subject("a", sample(), regressed, model, "digits")
    other = random_model(regressed.replace(bins=3))
    with pytest.raises(ValueError, match="must have shape"):
        Subject("a", sample(), regressed, other, "other")


def test_a_start_behind_all_events():
    shown = Subject("a", sample(), DIGITS.config, start_us=10**9)
    with pytest.raises(ValueError, match=r"no events in window 1, .* ends in window 0$"):
        shown.window(1)


def test_names_are_cut_to_fit():
    assert [shortened("abcdef", n) for n in (7, 6, 5)] == ["abcdef", "abcdef", "abcd…"]


@pytest.mark.filterwarnings("error")
def test_a_recording_of_one_event_is_drawn(tmp_path):
    """Whatever its name is."""
    name = "odd $x\n\x1b[31m"
    shown = Subject(name, events_of([7], [3], [4], [1]), DIGITS.config, DIGITS, "digits")
    figure = draw_overview(shown)
    assert all(text.get_text().isprintable() for text in figure.texts)
    save(figure, tmp_path / "one.PNG", 30)
    assert (tmp_path / "one.PNG").read_bytes().startswith(b"\x89PNG")


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
