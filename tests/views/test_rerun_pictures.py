"""What a view draws, without a viewer.

These are images of events and of volumes, colours of classes, moments and text.
"""

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from made import events_of

from async_tnt import Processor, TNTConfig
from async_tnt.views import rerun_log as log
from async_tnt.views.rerun_decisions import class_text
from async_tnt.views.rerun_log import (
    GAP_COLOUR,
    NOTHING_COLOUR,
    OFF_COLOUR,
    ON_COLOUR,
    bin_sheet,
    plain,
)
from async_tnt.views.rerun_view import next_moment


def test_an_event_image_has_the_newest_polarity_of_each_pixel():
    nothing = log.NOTHING
    events = events_of([1, 2, 3, 4, 5], [0, 3, 3, 1, 1], [0, 1, 1, 0, 0], [1, 1, 0, 0, 1])
    assert log.event_image(events, (4, 2)).tolist() == [
        [log.ON, log.ON, nothing, nothing],
        [nothing, nothing, nothing, log.OFF],
    ]
    assert not log.event_image(events[:0], (4, 2)).any()


def test_a_sheet_has_the_bins_row_by_row():
    volume = np.zeros((5, 2, 3), np.float32)
    volume[0, 0, 0] = 4.0
    volume[1, 1, 2] = -4.0
    volume[4, 0, 1] = 1.0
    sheet = bin_sheet(volume)
    assert sheet.shape == (2 * 3 - 1, 3 * 4 - 1, 3) and sheet.dtype == np.uint8
    assert tuple(sheet[0, 0]) == ON_COLOUR and tuple(sheet[1, 4 + 2]) == OFF_COLOUR
    # the root of a quarter
    half = np.array(NOTHING_COLOUR) + 0.5 * (np.array(ON_COLOUR) - np.array(NOTHING_COLOUR))
    assert np.abs(sheet[3, 4 + 1] - half).max() <= 1
    assert tuple(sheet[1, 1]) == NOTHING_COLOUR
    for gap in (sheet[2], sheet[:, 3], sheet[3:, 8:]):
        assert (gap == GAP_COLOUR).all()
    assert (bin_sheet(np.zeros((1, 4, 4), np.float32)) == NOTHING_COLOUR).all()


def test_a_large_sheet_is_reduced_and_loses_no_single_cell():
    volume = np.zeros((1, 10, 11), np.float32)
    volume[0, 9, 10] = 2.0
    volume[0, 1, 1] = -2.0
    volume[0, 0, 0] = 1.0
    sheet = bin_sheet(volume, most_pixels=30)
    assert sheet.shape == (5, 6, 3)
    assert tuple(sheet[4, 5]) == ON_COLOUR and tuple(sheet[0, 0]) == OFF_COLOUR
    assert (np.delete(sheet.reshape(-1, 3), [0, 29], axis=0) == NOTHING_COLOUR).all()


@given(st.integers(-500, 2000), st.integers(0, 500), st.integers(1, 200), st.integers(1, 200))
def test_pictures_are_bounded_in_number_and_taken_at_every_long_window_end(t, origin, window, step):
    moment = next_moment(t, origin, window, step)
    short = window < step
    long = window * -(-step // window) if short else window
    end = origin + ((t - origin) // long + 1) * long
    assert t < moment <= min(end, t + (long if short else step))
    assert next_moment(end - 1, origin, window, step) == end
    offset = (moment - origin) % long
    assert offset == 0 or (not short and offset % step == 0)
    two_later = next_moment(next_moment(moment, origin, window, step), origin, window, step)
    assert two_later - moment >= min(step, long)  # at most two in a step


# -- text ------------------------------------------------------------------------------------------

CONFIG = TNTConfig(sensor=(40, 30), grid=(40, 30), transform="none", landmark="center")


def decision_of(logits, classes, times=(1_000, 3_500)):
    """What a classifier of these logits says at the last of some events."""
    processor = Processor(CONFIG, classifier=lambda volume: logits, classes=classes)
    if times:
        n = len(times)
        processor.push(events_of(times, [1] * n, [1] * n, [1] * n))
    return processor.fire()


def test_the_text_of_a_class_names_the_likeliest():
    """Twelve of them; markdown in their names is no markdown."""
    classes = [f"class_{k}" for k in range(14)]
    now = decision_of(np.arange(14.0)[::-1].copy(), classes)
    lines = class_text(now, classes).splitlines()
    p = now.probabilities
    assert lines[0] == "# class\\_0"
    assert lines[2] == f"with probability {p[0]:.3f}, from 2 events in 2.5 ms"
    assert lines[4:6] == ["| class | probability |", "|---|---|"]
    assert lines[6:] == [f"| class\\_{k} | {p[k]:.3f} |" for k in range(12)]

    likeliest_last = decision_of(np.arange(3.0), ["a", "b", "c"])
    lines = class_text(likeliest_last, ["a", "b", "c"]).splitlines()
    assert [line.split()[1] for line in lines[6:]] == ["c", "b", "a"]


def test_a_name_is_neither_markup_nor_a_column():
    assert plain("a|b\n c*\td") == r"a\|b c\* d"
    for letter in r"\`*_{}[]<>()#+-.!|~&$":
        assert plain(f"1{letter}2") == f"1\\{letter}2"


def test_the_text_of_a_window_without_events():
    now = decision_of(np.arange(3.0), ["a", "b", "c"], times=())
    assert class_text(now, ["a", "b", "c"]).startswith("# no event\n")


def test_the_text_of_objects():
    """Places of 10 x 10 pixels; the likelier object first."""
    logits = np.zeros((3, 3, 4), np.float32)
    logits[2] = 2.0  # nothing
    logits[0, 0, 3] = 4.0
    logits[1, 2, 0] = 5.0
    now = decision_of(logits, ["a_1", "b"])
    now = dataclasses.replace(
        now, objects=tuple(dataclasses.replace(one, id=7 + one.index) for one in now.objects)
    )
    b, a = now.objects
    lines = class_text(now, ["a_1", "b"]).splitlines()
    assert lines[0] == "# 2 objects"
    assert lines[2:4] == ["| number | class | probability | place |", "|---|---|---|---|"]
    assert lines[4:] == [
        f"| 8 | b | {b.probability:.3f} | 4, 24 |",
        f"| 7 | a\\_1 | {a.probability:.3f} | 34, 4 |",
    ]
