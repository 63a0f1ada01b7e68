"""The page of a model of raw outputs: its outputs at the ends of windows, with their legends."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")

from hypothesis import given
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events
from made import raw_model as other_raw_model
from torch import nn
from views.raw_models import CONFIG, overflowing_model, raw_model

from async_tnt import Model, Processor, TNTConfig
from async_tnt.views import figure_outputs
from async_tnt.views.figure_outputs import draw_outputs, last_outputs, shown_windows
from async_tnt.views.figure_overview import draw_overview
from async_tnt.views.figure_style import new_figure
from async_tnt.views.figure_subject import Subject
from async_tnt.views.output_pictures import (
    FIRST_COLOURS,
    NO_NUMBER,
    channel_colours,
    limits_of,
    picture_of,
)

# the events and volumes of the page are drawn with the transform, the outputs without it
DRAWN = CONFIG.replace(transform="tnt", t_max=8.0)
MODEL = raw_model()
EVENTS = random_events(2_000, duration_us=480_000, sensor=CONFIG.sensor, start_us=3_000)


def subject_of(events, model=MODEL, config=DRAWN, start_us=None):
    return Subject("a.npz", events, config, model, "net.safetensors", start_us)


def drawn(events, number=1, model=MODEL, **settings):
    """The part of the page with the outputs, alone in a figure."""
    figure = new_figure(20.0)
    draw_outputs(figure, subject_of(events, model, **settings).window(number), model, top=0.5)
    return figure


def texts_of(figure):
    return [text.get_text() for text in figure.texts]


def pictures_of(figure):
    """The pictures and legends, from the top, each row from the left."""
    return [np.asarray(image.get_array()) for axes in figure.axes for image in axes.images]


def bars_of(figure):
    """The heights of the bars of each plot of numbers."""
    return [heights_of(axes) for axes in figure.axes if axes.patches]


def heights_of(axes):
    if len(axes.patches) == 1:  # an outline
        return axes.patches[0].get_data().values.tolist()
    return [bar.get_height() for bar in axes.patches]


def outputs_of(events, model=MODEL, **settings):
    """Copies of the outputs at the ends of all windows."""
    processor = Processor(model, **settings)
    return [output.copy() for output in processor.push(events)] + [
        output.copy() for output in processor.finish()
    ]


def test_outputs_are_those_at_the_ends_of_windows():
    """The first, the last and three more of ten windows are shown. A row has one range."""
    figure = drawn(EVENTS)
    outputs = outputs_of(EVENTS)
    shown = [outputs[k] for k in (0, 2, 4, 6, 9)]
    assert len(outputs) == 10
    times = [f"{(one.time_us - EVENTS['t'][0]) / 1e3:,.1f} ms" for one in shown]
    windows = [f"window {k}" for k in (1, 3, 5, 7, 10)]
    texts = texts_of(figure)
    assert texts[0] == "outputs of net.safetensors at the ends of windows"
    assert texts[1:11] == [text for pair in zip(windows, times, strict=True) for text in pair]
    found = pictures_of(figure)
    for name, first in (("flow", 0), ("image", 6), ("parts/of a", 12)):
        arrays = [one[name] for one in shown]
        limits = limits_of(arrays)
        for picture, array in zip(found[first : first + 5], arrays, strict=True):
            np.testing.assert_array_equal(picture, picture_of(array, limits))
    bars = bars_of(figure)
    assert bars[:5] == [one["total"].tolist() for one in shown]
    assert bars[5:] == [one["many"].tolist() for one in shown]
    # the numbers of an axis stand left of a row only
    labelled = [axes.yaxis.get_tick_params()["labelleft"] for axes in figure.axes if axes.patches]
    assert labelled == [True, *[False] * 4] * 2


def test_rows_have_names_and_legends_by_hand():
    """An event, then two at a place in the next window, then three at another."""
    events = events_of(
        [0, 60_000, 60_001, 100_000, 100_001, 100_002],
        [3, 4, 4, 5, 5, 5],
        [2] * 6,
        [1, 0, 1, 1, 0, 1],
    )
    figure = drawn(events)
    texts = texts_of(figure)
    assert texts[1:7] == ["window 1", "0.0 ms", "window 2", "60.0 ms", "window 3", "100.0 ms"]
    names = [text for text in texts if ": " in text and " (" in text]
    assert names == [
        "flow (2x6x8): two channels as directions",
        "image (1x6x8): one channel as grey",
        "parts/of a (3x6x8): the largest channel",
        "total (2): numbers",
        "many (25): numbers",
    ]
    # 3 events are at the rim, where the arrow is (3, 3)
    assert texts[8:11] == ["right: channel 0", "down: channel 1", "rim: 4.24 and more"]
    assert [text for text in texts if text.startswith("channel ")] == ["channel 0", "channel 1"]
    found = pictures_of(figure)
    assert [tuple(found[k][2, 3 + k]) for k in range(3)] == [
        (255, 234, 170),
        (255, 212, 85),
        (255, 191, 0),
    ]
    assert tuple(found[3][100, 200]) == (255, 0, 0) and tuple(found[3][0, 0]) == (255, 255, 255)
    assert [tuple(found[4 + k][2, 3 + k]) for k in range(3)] == [
        (85, 85, 85),
        (170, 170, 170),
        (255, 255, 255),
    ]
    (scale,) = [axes for axes in figure.axes if axes.images and axes.get_ylim() == (0, 3)]
    assert scale.yaxis.get_ticks_position() == "right"
    assert (found[7][0], found[7][-1]) == (1, 0)  # white at the top
    assert [tuple(found[8 + k][2, 3 + k]) for k in range(3)] == [FIRST_COLOURS[1]] * 3
    assert bars_of(figure)[:3] == [[1, -1], [2, -2], [3, -3]]
    limits = [axes.get_ylim() for axes in figure.axes if len(axes.patches) == 2]
    assert limits == [pytest.approx((-3.3, 3.3))] * 3


def test_outputs_of_a_window_that_slides_are_those_of_one_that_is_as_long():
    config = TNTConfig(sensor=(8, 6), grid=(8, 6), representation="count", window_us=30_000)
    fixed = other_raw_model(config)
    slid = replace(fixed, config=config.replace(last_us=30_000))
    subject = Subject("a.npz", random_events(900, sensor=(8, 6)), config, fixed, "net")
    numbers = np.array([1, 2, 3])
    expected = last_outputs(subject, fixed, numbers)
    found = last_outputs(subject, slid, numbers)
    assert len(found) == len(expected) == 3
    for one, other in zip(found, expected, strict=True):
        assert [a.tobytes() for a in one.arrays] == [a.tobytes() for a in other.arrays]


def test_the_window_that_the_page_shows_is_among_those_of_the_outputs():
    for number in (1, 2, 4, 10):
        subject = subject_of(EVENTS)
        numbers = shown_windows(subject.window(number), MODEL).tolist()
        assert number in numbers and len(numbers) == 5 and numbers == sorted(set(numbers))
    # the page's windows may have another length: its fourth begins in the model's second
    other = subject_of(EVENTS, config=DRAWN.replace(window_us=20_000)).window(4)
    assert shown_windows(other, MODEL).tolist() == [2, 3, 5, 7, 10]
    # and may begin in a window of the model without events, which has no output
    events = events_of([0, 160_000], [3, 3], [2, 2], [1, 1])
    longer = subject_of(events, config=DRAWN.replace(window_us=100_000)).window(2)
    assert shown_windows(longer, MODEL).tolist() == [1, 4]


@given(st.data())
def test_windows_with_events_are_those_of_the_stream(data):
    events = data.draw(nasty_streams(CONFIG.sensor, CONFIG.window_us, 1_000).filter(len))
    for start_us in (None, 0, 30_000):
        subject = subject_of(events, start_us=start_us)
        outputs = outputs_of(events, start_us=start_us, on_restart="warn")
        starts = [output.window_start_us for output in outputs]
        numbers = subject.filled_windows(CONFIG.window_us)
        assert starts == [subject.first_us + (n - 1) * CONFIG.window_us for n in numbers.tolist()]


def test_outputs_begin_with_the_windows_that_are_drawn():
    figure = drawn(EVENTS, start_us=23_000)
    outputs = outputs_of(EVENTS, start_us=23_000)
    limits = limits_of([outputs[k]["flow"] for k in (0, 2, 4, 6, 9)])
    expected = picture_of(outputs[2]["flow"], limits)
    np.testing.assert_array_equal(pictures_of(figure)[1], expected)


@pytest.mark.filterwarnings("error")
def test_outputs_that_are_no_numbers_are_drawn():
    figure = drawn(events_of([5], [3], [2], [1]), model=overflowing_model())
    flow, _, image = pictures_of(figure)
    assert tuple(flow[2, 3]) == (255, 191, 0) and tuple(image[2, 3]) == NO_NUMBER
    texts = texts_of(figure)
    assert "rim: above 0" in texts and "middle grey 0" in texts
    assert "image (1x6x8): one channel as grey; nan is dark red" in texts
    assert "flow (2x6x8): two channels as directions" in texts


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n_more", [0, 8, 9, 30])
def test_numbers_that_are_none_are_cut_or_left_out(n_more):
    """Up to twelve numbers have bars of their own."""
    figure = new_figure(2.0)
    axes = figure.subplots()
    numbers = np.array([np.inf, -1, np.nan, -np.inf, *[0] * n_more])
    figure_outputs._draw_bars(axes, numbers, (-1.0, 2.0), is_first=True)
    np.testing.assert_array_equal(heights_of(axes), [2, -1, np.nan, -1, *[0] * n_more])
    assert len(axes.patches) == (len(numbers) if len(numbers) <= 12 else 1)
    assert len(axes.get_xticks()) == (len(numbers) if len(numbers) <= 12 else 0)
    assert axes.get_ylim() == pytest.approx((-1.15, 2.15))
    assert figure_outputs._span([np.array([np.inf, -1]), np.array([2, np.nan])]) == (-1, 2)
    figure.draw_without_rendering()


@pytest.mark.filterwarnings("error")
def test_zero_is_among_the_numbers_of_an_axis():
    for sign, expected in ((1, (0, 5)), (-1, (-5, 0))):
        assert figure_outputs._span([sign * np.array([3.0, 5.0])]) == expected
    axes = new_figure(2.0).subplots()
    figure_outputs._draw_bars(axes, np.zeros(3), (0.0, 0.0), is_first=True)
    assert axes.get_ylim() == (-1, 1)


def test_a_row_tells_how_nan_is_shown():
    arrays = {"numbers": np.array([1, np.nan]), "grey": np.array([[[1, np.nan]]])}
    ends = []
    for kind, array in arrays.items():
        figure = new_figure(4.0)
        row = figure_outputs._Row("a", kind, 1.0, 1.0)
        figure_outputs._draw_row(figure, row, [array], 1.2, 0.5)
        ends.append(texts_of(figure)[0].split("; ")[1])
    assert ends == ["nan is left out", "nan is dark red"]


def test_pictures_have_the_shape_of_the_output_within_bounds():
    """At most four times as wide as high, or as high as wide."""
    shapes = {"wide": (1, 2, 64), "high": (1, 64, 2), "usual": (1, 30, 40)}
    rows = figure_outputs._rows_of(SimpleNamespace(output_shapes=shapes), 5)
    assert [row.height / row.width for row in rows] == pytest.approx([1 / 4, 4, 3 / 4])
    assert max(row.height for row in rows) <= figure_outputs.TALLEST


def test_the_titles_of_narrow_pictures_have_room():
    config = CONFIG.replace(sensor=(2, 40), grid=(2, 40))
    model = Model.from_torch(Heads(1, 1), config)
    events = random_events(200, duration_us=480_000, sensor=(2, 40))
    figure = drawn(events, model=model, config=config.replace(transform="tnt", t_max=8.0))
    lefts = [
        figure.get_figwidth() * text.get_position()[0]
        for text in figure.texts
        if text.get_text().startswith("window ")
    ]
    assert len(lefts) == 5 and np.diff(lefts).min() > figure_outputs.NARROWEST


class Heads(nn.Module):
    def __init__(self, n, channels):
        super().__init__()
        self.heads = nn.ModuleList(nn.Conv2d(1, channels, 1) for _ in range(n))

    def forward(self, volume):
        return tuple(head(volume) for head in self.heads)


def test_of_many_outputs_the_first_are_drawn():
    model = Model.from_torch(Heads(14, 1), CONFIG)
    texts = texts_of(drawn(EVENTS[:10], model=model))
    assert texts[0] == ("outputs of net.safetensors at the ends of windows (the first 12 of 14)")
    names = [text.split()[0] for text in texts if "as grey" in text]
    assert names == [f"output.{k}" for k in range(12)]


def test_of_many_channels_the_most_frequent_are_named():
    """In the order of their numbers."""
    largest = np.repeat([8, 0, 1, 2, 3, 4, 5, 6, 9], [12, 1, 2, 3, 4, 5, 6, 7, 8]).reshape(6, 8)
    array = (largest == np.arange(10)[:, None, None]).astype(np.float32)
    figure = new_figure(4.0)
    figure_outputs._channel_legend(figure, [array, array[:, ::-1]], 1.0, 1.0)
    named = [1, 2, 3, 4, 5, 6, 8, 9]
    assert texts_of(figure) == [*[f"channel {k}" for k in named], "1 more"]
    colours = [np.rint(255 * np.array(axes.get_facecolor()[:3])) for axes in figure.axes]
    np.testing.assert_array_equal(colours, channel_colours(10)[named])


@pytest.mark.parametrize("n_events", [20, 2_000])
def test_a_page_has_room_for_all_of_it(n_events):
    """Nothing lies outside the page, and no picture, plot or text on another one.

    The sensor is wide, so that legends are higher than pictures.
    """
    config = CONFIG.replace(sensor=(40, 8), grid=(40, 8))
    model = raw_model(config)
    drawn_config = config.replace(transform="tnt", t_max=8.0)
    subject = Subject("a.npz", EVENTS[:n_events], drawn_config, model, "net.safetensors")
    figure = draw_overview(subject)
    figure.draw_without_rendering()
    # of the part with the outputs
    top = max(text.get_window_extent().y1 for text in figure.texts if "outputs" in text.get_text())
    axes = [each for each in figure.axes if each.get_position().y1 * figure.bbox.y1 < top]
    boxes = [each.get_tightbbox() for each in axes]
    boxes += [text.get_window_extent() for text in figure.texts]
    boxes = [box for box in boxes if box.y1 <= top]
    assert len(boxes) > 20
    for k, box in enumerate(boxes):
        assert box.y0 > 0 and box.x0 > 0 and box.x1 < figure.bbox.x1
        for other in boxes[k + 1 :]:
            overlap_x = min(box.x1, other.x1) - max(box.x0, other.x0)
            overlap_y = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert overlap_x < 2 or overlap_y < 2
    assert not [each for each in axes if each.get_ylabel() == "class probability"]
    assert "a.npz" in texts_of(figure)
