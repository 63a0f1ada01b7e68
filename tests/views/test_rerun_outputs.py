"""RerunView of a model of raw outputs: what is in the file is what the network computed."""

import numpy as np
import pytest

rrd_files = pytest.importorskip(
    "views.rrd_files", reason="rerun-sdk is not installed (extra `view`)"
)
Rrd = rrd_files.Rrd

from made import events_of, random_events  # noqa: E402
from views.raw_models import CONFIG, overflowing_model, raw_model  # noqa: E402

from async_tnt import Processor  # noqa: E402
from async_tnt.views import rerun_log as log  # noqa: E402
from async_tnt.views.output_pictures import (  # noqa: E402
    FIRST_COLOURS,
    NO_NUMBER,
    limits_of,
    picture_of,
)
from async_tnt.views.rerun_outputs import (  # noqa: E402
    ABOUT,
    WHEEL,
    OutputLog,
    _has_curves,
    _names_and_colours,
    channels_words,
    reduced,
)
from async_tnt.views.rerun_view import RerunView  # noqa: E402

MODEL = raw_model()
EVENTS = random_events(900, duration_us=170_000, sensor=(8, 6), start_us=7_000)
FLOW = "outputs/flow"
IMAGE = "outputs/image"
PARTS = r"outputs/parts\/of\ a"
TOTAL = "outputs/total"
MANY = "outputs/many"


def view_of(folder, packets, model=MODEL, **settings):
    """Packets as a view, read back; with copies of the answers that came."""
    answers = []
    with RerunView(model, out=folder / "a.rrd", **settings) as view:
        for packet in packets:
            answers += [answer.copy() for answer in view.push(packet)]
        answers += [answer.copy() for answer in view.finish()]
    return Rrd(folder / "a.rrd"), answers


def output_at(model, events, at_us):
    """What a processor has that saw the events before a moment."""
    processor = Processor(model)
    processor.push(events[events["t"] < at_us])
    return processor.fire()


def text_at_end(rrd):
    return rrd.series(ABOUT, "TextDocument:text")[-1][1][0].splitlines()


def test_every_picture_shows_what_the_network_computes(tmp_path):
    """Although the next answers change its arrays."""
    rrd, _ = view_of(tmp_path, np.array_split(EVENTS, 37), picture_us=9_000, every_us=3_000)
    flows = rrd.images(FLOW)
    images = rrd.images(IMAGE)
    parts = rrd.series(PARTS, "SegmentationImage:buffer")
    bars = rrd.series(MANY, "BarChart:values")
    times = rrd.times(log.EVENTS)
    assert len(times) > 18
    distinct = set()
    for at_us, (t_flow, flow), (t_image, image), (t_parts, (part,)), (t_bars, (bar,)) in zip(
        times, flows, images, parts, bars, strict=True
    ):
        assert at_us == t_flow == t_image == t_parts == t_bars
        truth = output_at(MODEL, EVENTS, at_us)
        np.testing.assert_array_equal(flow, picture_of(truth["flow"], limits_of([truth["flow"]])))
        np.testing.assert_array_equal(
            image, picture_of(truth["image"], limits_of([truth["image"]]))
        )
        places = np.frombuffer(bytes(part), np.uint16).reshape(6, 8)
        np.testing.assert_array_equal(places, truth["image"][0] > 0.5)
        np.testing.assert_array_equal(numbers_of(bar), truth["many"])
        distinct.add(image.tobytes())
    assert len(distinct) > 10


def numbers_of(values):
    """The numbers of a tensor, as the SDK's reader gives it."""
    return values["buffer"]


def test_one_event_by_hand(tmp_path):
    """Right and down; white; the second channel, beside the first."""
    rrd, _ = view_of(tmp_path, [events_of([5], [3], [2], [1])])
    ((_, flow),) = rrd.images(FLOW)
    assert tuple(flow[2, 3]) == (255, 191, 0)
    assert (np.delete(flow.reshape(48, 3), 2 * 8 + 3, axis=0) == 255).all()
    ((_, image),) = rrd.images(IMAGE)
    assert tuple(image[2, 3]) == (255, 255, 255) and image.sum() == 3 * 255
    assert rrd.series(TOTAL, "Scalars:scalars") == [(5, [1, -1]), (6, [1, -1])]
    assert text_at_end(rrd) == [
        "# 1 events in 0.0 ms",
        "",
        "- **flow**, 2x6x8, 0 to 1: full colour from 1.41 on",
        "- **image**, 1x6x8, 0 to 1: black 0, white 1",
        r"- **parts/of a**, 3x6x8, 0 to 1: 98 % channel 0, 2 % channel 1",
        "- **total**, 2, -1 to 1: 1, -1",
        "- **many**, 25, 0 to 24: 0, 1, 2, 3, 21 more",
    ]


def test_curves_have_every_answer_and_pictures_only_their_moments(tmp_path):
    rrd, answers = view_of(tmp_path, np.array_split(EVENTS, 9), every_us=7_000)
    totals = rrd.series(TOTAL, "Scalars:scalars")
    assert len(answers) > 20
    for answer in answers:
        assert (answer.time_us, answer["total"].tolist()) in totals
    times = rrd.times(log.EVENTS)
    assert len(totals) == len(answers) + len(times)
    assert rrd.times(FLOW) == rrd.times(ABOUT) == rrd.times(MANY) == times


def test_each_output_has_a_panel_and_there_is_nothing_of_classes(tmp_path):
    rrd, _ = view_of(tmp_path, [EVENTS])
    assert rrd.views == {
        "events": "2D",
        log.RAW: "2D",
        ABOUT: "TextDocument",
        WHEEL: "2D",
        FLOW: "2D",
        IMAGE: "2D",
        PARTS: "2D",
        TOTAL: "TimeSeries",
        MANY: "BarChart",
    }
    assert set(rrd.rows) == {log.EVENTS, log.RAW, ABOUT, WHEEL, FLOW, IMAGE, PARTS, TOTAL, MANY}
    assert rrd.static(TOTAL, "SeriesLines:names") == ["0", "1"]
    kinds = rrd.series(ABOUT, "TextDocument:media_type")
    assert {kind for _, (kind,) in kinds} == {"text/markdown"}
    annotations = rrd.rows[PARTS][0][1]["AnnotationContext:context"]
    names = [row["class_description"]["info"]["label"] for row in annotations[0]]
    colours = [row["class_description"]["info"]["color"] for row in annotations[0]]
    assert names == ["channel 0", "channel 1", "channel 2", "nan"]
    bytes_of = [tuple(colour.to_bytes(4, "big")[:3]) for colour in colours]
    assert bytes_of == [*FIRST_COLOURS[:3], NO_NUMBER]


def test_without_two_channels_there_is_no_legend_of_directions(tmp_path):
    from torch import nn

    from async_tnt import Model

    model = Model.from_torch(nn.Conv2d(1, 1, 3, padding=1), CONFIG)
    rrd, _ = view_of(tmp_path, [EVENTS], model)
    assert set(rrd.views) == {"events", log.RAW, ABOUT, "outputs/output"}
    assert WHEEL not in rrd.rows


@pytest.mark.parametrize("n_packets", [1, 13, 900])
def test_the_answers_that_a_view_returns_stay_as_they_are(tmp_path, n_packets):
    """Until its next call, as those of a Processor do, though it takes pictures in between."""
    with RerunView(MODEL, out=tmp_path / "a.rrd", every_us=3_000, picture_us=4_000) as view:
        found = []
        for packet in np.array_split(EVENTS, n_packets):
            found += [(answer.time_us, answer["image"].sum()) for answer in view.push(packet)]
        found += [(answer.time_us, answer["image"].sum()) for answer in view.finish()]
    processor = Processor(MODEL, every_us=3_000)
    expected = [(one.time_us, one["image"].sum()) for one in processor.push(EVENTS)]
    expected += [(one.time_us, one["image"].sum()) for one in processor.finish()]
    assert found == expected and len(set(found)) > 40


def test_outputs_that_are_no_numbers_are_shown(tmp_path):
    """inf is as far as can be, and nan has its own colour."""
    rrd, _ = view_of(tmp_path, [events_of([5], [3], [2], [1])], overflowing_model())
    ((_, flow),) = rrd.images(FLOW)
    ((_, image),) = rrd.images(IMAGE)
    assert tuple(flow[2, 3]) == (255, 191, 0) and tuple(flow[0, 0]) == (255, 255, 255)
    assert tuple(image[2, 3]) == NO_NUMBER and tuple(image[0, 0]) == (128, 128, 128)
    assert text_at_end(rrd)[2:] == [
        "- **flow**, 2x6x8, 0 to 0 (2 nan or inf): full colour above 0",
        "- **image**, 1x6x8, 0 to 0 (1 nan or inf): middle grey 0",
    ]


def test_an_empty_window_is_no_point_of_a_curve(tmp_path):
    """Its picture is that of no events: the first event is too late for the first window."""
    events = events_of([10_000, 130_000], [5, 6], [5, 5], [1, 1])
    rrd, answers = view_of(tmp_path, [events], start_us=100_000, picture_us=50_000)
    assert [answer.time_us for answer in answers] == [130_000]
    assert rrd.times(log.EVENTS) == rrd.times(IMAGE) == [50_000, 130_001]
    assert [t for t, _ in rrd.series(TOTAL, "Scalars:scalars")] == [130_000, 130_001]
    texts = [text for _, (text,) in rrd.series(ABOUT, "TextDocument:text")]
    assert texts[0].startswith("# no event\n") and texts[1].startswith("# 1 events in 30.0 ms\n")


def test_large_maps_have_every_second_place():
    array = np.arange(2 * 5 * 7.0).reshape(2, 5, 7)
    np.testing.assert_array_equal(reduced(array, 35), array)
    np.testing.assert_array_equal(reduced(array, 34), array[:, ::2, ::2])
    np.testing.assert_array_equal(reduced(array, 8), array[:, ::3, ::3])


def test_a_large_map_is_shown_smaller_in_the_range_of_all_of_it():
    """Every second row is bright, and not one of these is shown."""
    outputs = OutputLog(rrd_files.rerun, None, {})
    array = np.zeros((1, 400, 400), np.float32)
    array[:, 1::2] = 1.0
    picture, words = outputs._shown(array)
    shown = np.array(picture.buffer.as_arrow_array().to_pylist()[0], np.uint8)
    assert words == "black 0, white 1"
    assert len(shown) == 3 * 200 * 200 and not shown.any()


def test_channels_beyond_16_bits_are_shown_as_the_last_one():
    """The viewer is told names and colours of the first ones and of nan alone."""
    n = (1 << 16) + 4
    array = np.zeros((n, 1, 2), np.float32)
    array[n - 2, 0, 0] = array[9, 0, 1] = 1.0
    picture, words = OutputLog(rrd_files.rerun, None, {})._shown(array)
    shown = bytes(picture.buffer.as_arrow_array().to_pylist()[0])
    assert np.frombuffer(shown, np.uint16).tolist() == [65_535, 9]
    assert words == f"50 % channel 9, 50 % channel {n - 2}"
    named = _names_and_colours(n)
    assert [k for k, _, _ in named] == [*range(256), 65_535]
    assert [name for _, name, _ in named[-2:]] == ["channel 255", "nan"]


@pytest.mark.parametrize(
    ("shape", "curves"),
    [((20,), True), ((21,), False), ((20, 1, 1), True), ((21, 1, 1), False), ((1, 1, 2), False)],
)
def test_up_to_twenty_numbers_are_curves(shape, curves):
    assert _has_curves(shape) == curves


def test_channels_are_told_from_the_most_frequent_on():
    """Four of them; the number behind the last channel is nan."""
    largest = np.array([[2, 2, 2, 2, 3], [3, 3, 0, 0, 6], [4, 5, 2, 3, 0]])
    words = channels_words(largest, 6)
    assert words == "33 % channel 2, 27 % channel 3, 20 % channel 0, 7 % channel 4, 2 more"
    assert channels_words(np.full((2, 2), 3), 3) == "100 % nan"
