"""What the page of a map model shows: at three moments of a window, its events and objects."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need matplotlib (extra: plot)")

import torch
from made import events_of

from async_tnt import Model, Processor, TNTConfig
from async_tnt.views.figure_objects import draw_objects, draw_window_objects
from async_tnt.views.figure_style import OFF, ON
from async_tnt.views.figure_subject import Subject

CONFIG = TNTConfig(
    sensor=(40, 20),
    grid=(40, 20),
    bins=1,
    polarity="unsigned",
    transform="none",
    landmark="center",
    window_us=9_000,
)


def dot_finder(sensor=CONFIG.sensor):
    """An object of class "pair" stands where two events are, with probability 1 / (1 + 1/e); one
    event alone is nothing."""
    net = torch.nn.Conv2d(1, 2, 1)
    with torch.no_grad():
        net.weight[:, 0, 0, 0] = torch.tensor([2.0, 0.0])
        net.bias[:] = torch.tensor([0.0, 3.0])
    return Model.from_torch(net, CONFIG, ["pair"]).for_sensor(sensor)


FIRST = [(5, 4), (5, 4)]
SECOND = [(30, 12), (30, 12)]
ONE_MORE = [(20, 3)]


def two_windows(start_us):
    """Pairs of events, one after the other; then the same in the next window, a column further."""
    rows = []
    for number in (0, 1):
        began_us = start_us + 9_000 * number
        for after_us, places in ((1_000, FIRST), (4_000, SECOND), (8_000, ONE_MORE)):
            for k, (x, y) in enumerate(places):
                rows.append((began_us + after_us + k, x + number, y, 1 - k))
    rows.insert(0, (start_us, 0, 0, 1))  # with which the first window begins
    return events_of(*np.array(rows).T)


def panels(figure):
    """Title, ON and OFF events, circles, and the words beside them, for each panel."""
    found = []
    for axes in figure.axes:
        lines = {"on": [], "off": [], "objects": []}
        for line in axes.lines:
            places = [(int(x), int(y)) for x, y in line.get_xydata()]
            colours = {ON: "on", OFF: "off"}
            kind = "objects" if line.get_marker() == "o" else colours[line.get_color()]
            lines[kind] += places
        words = [text.get_text() for text in axes.texts]
        title = axes.get_title(loc="left")
        found.append((title, lines["on"], lines["off"], lines["objects"], words))
    return found


@pytest.mark.parametrize("arrives", ["in order", "backwards"])
@pytest.mark.parametrize("number", [1, 2])
def test_panels_show_what_was_there_until_then(number, arrives):
    """After 3, 6 and 9 ms, in whatever order the events of a window arrive."""
    events = two_windows(50)
    if arrives == "backwards":
        events = np.concatenate([events[:6][::-1], events[6:][::-1]])
    subject = Subject("a.npz", events, CONFIG, dot_finder(), "finder", start_us=50)
    figure = draw_window_objects(subject.window(number), subject.model)
    for axes in figure.axes:
        assert axes.get_xlim() == (-0.5, 39.5) and axes.get_ylim() == (19.5, -0.5)
    assert [text.get_text() for text in figure.texts] == [
        f"a.npz, window {number}: objects that finder finds"
    ]
    first, second, third = panels(figure)
    moved = number - 1
    begin = [(0, 0)] if number == 1 else []
    a, b, c = (5 + moved, 4), (30 + moved, 12), (20 + moved, 3)
    sure = f"{1 / (1 + np.exp(-1)):.2f}"
    assert first == ("3 ms", [*begin, a], [a], [a], ["pair", f"id 0, {sure}"])
    two = ["pair", f"id 0, {sure}", "pair", f"id 1, {sure}"]
    title, on, off, objects, words = second
    assert (title, on, off) == ("6 ms", [*begin, a, b], [a, b])
    assert sorted(objects) == [a, b]
    assert words == two
    title, on, off, objects, words = third
    assert (title, on, off) == ("9 ms", [*begin, a, b, c], [a, b])
    assert sorted(objects) == [a, b]
    assert words == two


def test_a_window_that_slides_still_holds_events_from_before():
    """The window is 9 ms: 3 ms into the second stretch, the first one's events are 6 ms old."""
    model = dot_finder()
    slid = CONFIG.replace(
        representation="count", transform="none", polarity="unsigned", last_us=9_000
    )
    model = replace(model, config=slid)
    subject = Subject("a.npz", two_windows(50), CONFIG, model, "finder")
    first, second, third = panels(draw_window_objects(subject.window(2), model))
    title, on, off, objects, _ = first
    assert (
        title == "3 ms"
        and set(on) == {(6, 4), (30, 12), (20, 3)}
        and set(off) == {(6, 4), (30, 12)}
    )
    assert sorted(objects) == [(6, 4), (30, 12)]
    assert sorted(second[3]) == [(6, 4), (31, 12)]
    assert set(third[1]) == {(6, 4), (31, 12), (21, 3)}


def test_a_panel_has_no_events_of_earlier_windows():
    """Its window began behind them, in the middle of the recording."""
    events = two_windows(50)
    processor = Processor(dot_finder(), start_us=50)
    processor.push(events[events["t"] <= 50 + 9_000 + 2_000])
    figure = draw_objects([processor.fire()], ["11 ms"], events, CONFIG.sensor, "a.npz")
    assert panels(figure)[0][:4] == ("11 ms", [(6, 4)], [(6, 4)], [(6, 4)])


@pytest.mark.parametrize("slides", [False, True])
def test_an_object_keeps_its_id_from_panel_to_panel(slides):
    """The id is not the object's place in the list: the likelier one stands first there."""
    model = dot_finder()
    if slides:
        slid = CONFIG.replace(
            representation="count", transform="none", polarity="unsigned", last_us=9_000
        )
        model = replace(model, config=slid)
    rows = [(20, 30, 12, p) for p in (0, 1)]
    rows += [(4_000 + k, 5, 4, k % 2) for k in range(3)]  # three events: likelier than two
    events = events_of(*np.array(rows).T)
    subject = Subject("a.npz", events, CONFIG, model, "finder")
    ids = []
    for axes in draw_window_objects(subject.window(1), subject.model).axes:
        seconds = [text for text in axes.texts if text.get_text().startswith("id ")]
        ids.append({text.xy[0]: text.get_text().split(",")[0] for text in seconds})
    assert ids == [{30: "id 0"}, {5: "id 1", 30: "id 0"}, {5: "id 1", 30: "id 0"}]


def test_an_object_with_a_size_has_a_box():
    net = torch.nn.Conv2d(1, 4, 1)
    with torch.no_grad():
        net.weight[:, 0, 0, 0] = torch.tensor([2.0, 0.0, 0.0, 0.0])
        net.bias[:] = torch.tensor([0.0, 3.0, np.log(6.0), np.log(2.0)])
    model = Model.from_torch(net, CONFIG, ["pair"])
    subject = Subject("a.npz", two_windows(50), CONFIG, model, "finder")
    axes = draw_window_objects(subject.window(1), subject.model).axes[0]
    (box,) = [line for line in axes.lines if len(line.get_xdata()) == 5 and line.get_ls() == "-"]
    np.testing.assert_allclose(box.get_xydata(), [(2, 3), (8, 3), (8, 5), (2, 5), (2, 3)])


def test_words_of_an_object_at_the_right_stand_left_of_it():
    """So that they stay inside."""
    events = events_of([0, 1, 2, 3], [3, 3, 38, 38], [4, 4, 12, 12], [1, 0, 1, 0])
    subject = Subject("a.npz", events, CONFIG, dot_finder(), "finder")
    axes = draw_window_objects(subject.window(1), subject.model).axes[0]
    sides = {text.xy[0]: (text.get_ha(), np.sign(text.get_position()[0])) for text in axes.texts}
    assert sides == {3: ("left", 1), 38: ("right", -1)}


# -- the command -----------------------------------------------------------------------------------


@pytest.fixture
def plot(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dot_finder().save("finder.safetensors")
    return lambda *words: program("plot", "a.npz", "--model", "finder.safetensors", *words)


def test_the_window_that_is_asked_for_is_drawn(plot, tmp_path):
    np.savez("a.npz", events=two_windows(50), sensor=(40, 20))
    for number in (1, 2):
        code, _, err = plot("--window", number, "--out", "a.svg")
        assert (code, err) == (0, "")
        words = f"a.npz, window {number}: objects that finder.safetensors finds"
        assert words in (tmp_path / "a.svg").read_text()
    code, _, err = plot("--window", 3, "--out", "b.svg")
    assert code == 2 and "no events in window 3" in err


def test_a_map_model_is_drawn_on_the_recordings_sensor(plot, monkeypatch):
    """As the same network for that sensor."""
    seen = []
    draw = draw_window_objects
    monkeypatch.setattr(
        "async_tnt.cli.plot.draw_window_objects",
        lambda window, model: seen.append(model.config.sensor) or draw(window, model),
    )
    np.savez("a.npz", events=two_windows(50), sensor=(60, 24))
    assert plot("--out", "a.svg")[0] == 0
    assert seen == [(60, 24)]


@pytest.mark.parametrize("words", [("--volume", "bins=3"), ("--window-us", "5000")])
def test_a_map_model_has_its_own_volume(plot, words):
    np.savez("a.npz", events=two_windows(50), sensor=(40, 20))
    code, _, err = plot(*words)
    assert code == 2 and err.count("\n") == 1
    assert "--volume and --window-us cannot be used with it" in err
