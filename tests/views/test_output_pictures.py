"""Pictures of raw outputs, by hand: colours of directions, grey, channels, and of nan."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from async_tnt.views.output_pictures import (
    FIRST_COLOURS,
    MOST_COLOURS,
    NO_NUMBER,
    Limits,
    channel_colours,
    kind_of,
    largest_channel,
    limits_of,
    limits_words,
    picture_of,
    span_words,
    wheel_picture,
)

NAN, INF = np.nan, np.inf


def maps(*channels):
    """Channels of one row each, as a map (C, 1, W)."""
    return np.array(channels, np.float32)[:, np.newaxis]


def row_of(array, limits=None):
    """The colours of a map of one row."""
    picture = picture_of(array, limits_of([array]) if limits is None else limits)
    assert picture.dtype == np.uint8 and picture.shape == (1, array.shape[2], 3)
    return [tuple(colour) for colour in picture[0].tolist()]


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ((5,), "numbers"),
        ((1,), "numbers"),
        ((2, 1, 1), "numbers"),
        ((1, 1, 2), "grey"),
        ((2, 3, 1), "directions"),
        ((3, 2, 2), "channels"),
        ((11, 4, 4), "channels"),
    ],
)
def test_the_shape_says_how_an_output_is_shown(shape, kind):
    assert kind_of(shape) == kind


# -- directions ------------------------------------------------------------------------------------


def test_directions_have_hues_and_zero_is_white():
    """Right, down, left, up; nothing; right with half the length; right and down."""
    right = [2, 0, -2, 0, 0, 1, 2]
    down = [0, 2, 0, -2, 0, 0, 2]
    assert row_of(maps(right, down), Limits(0.0, 2.0)) == [
        (255, 0, 0),
        (128, 255, 0),
        (0, 255, 255),
        (128, 0, 255),
        (255, 255, 255),
        (255, 128, 128),
        (255, 191, 0),
    ]


def test_the_longest_arrow_has_the_full_colour_and_longer_ones_too():
    arrows = maps([3, 0, 1], [4, 0, 0])
    limits = limits_of([arrows])
    assert limits == (0, 5)
    assert row_of(maps([50, 5], [0, 0]), limits) == [(255, 0, 0)] * 2
    assert limits_words("directions", limits) == "full colour from 5 on"


def test_arrows_that_are_all_zero():
    arrows = maps([0, 0], [0, 0])
    limits = limits_of([arrows])
    assert limits == (0, 0) and limits_words("directions", limits) == "full colour above 0"
    assert row_of(arrows, limits) == [(255, 255, 255)] * 2


def test_few_long_arrows_do_not_leave_the_others_pale():
    """One of 150; zeros do not count."""
    right = np.zeros(20_000, np.float32)
    right[:150] = 1
    right[0] = 900
    assert limits_of([maps(right, np.zeros(20_000))]) == (0, 1)


def test_arrows_without_a_number():
    """inf has a direction, and nan has none."""
    arrows = maps([INF, -INF, NAN, 1, INF, 1], [0, 0, 1, NAN, NAN, 0])
    assert limits_of([arrows]) == (0, 1)
    red, cyan = (255, 0, 0), (0, 255, 255)
    assert row_of(arrows) == [red, cyan, NO_NUMBER, NO_NUMBER, NO_NUMBER, red]
    # no finite length at all
    assert row_of(arrows[:, :, :3]) == [red, cyan, NO_NUMBER]


def test_the_wheel_has_the_direction_from_its_middle():
    background = (1, 2, 3)
    wheel = wheel_picture(5, background)
    assert tuple(wheel[2, 2]) == (255, 255, 255)
    assert tuple(wheel[2, 4]) == (255, 0, 0) and tuple(wheel[2, 3]) == (255, 128, 128)
    assert tuple(wheel[4, 2]) == (128, 255, 0) and tuple(wheel[0, 2]) == (128, 0, 255)
    assert tuple(wheel[0, 0]) == tuple(wheel[4, 4]) == background


# -- grey ------------------------------------------------------------------------------------------


def test_grey_is_between_the_least_and_the_largest_number():
    image = maps([-1, 0, 4, 1.5])
    assert limits_of([image]) == (-1, 4)
    assert row_of(image) == [(0, 0, 0), (51, 51, 51), (255, 255, 255), (128, 128, 128)]
    assert limits_words("grey", Limits(-1.0, 4.0)) == "black -1, white 4"


def test_pictures_that_are_compared_have_one_range():
    first, second = maps([0, 1]), maps([3, 2])
    limits = limits_of([first, second])
    assert limits == (0, 3)
    assert row_of(first, limits) == [(0, 0, 0), (85, 85, 85)]


def test_a_constant_image_is_a_middle_grey():
    image = maps([0.25, 0.25])
    assert row_of(image) == [(128, 128, 128)] * 2
    assert limits_words("grey", limits_of([image])) == "middle grey 0.25"


def test_an_image_without_numbers():
    image = maps([NAN, INF, 1, 3, -INF])
    white, black = (255, 255, 255), (0, 0, 0)
    assert limits_of([image]) == (1, 3)
    assert row_of(image) == [NO_NUMBER, white, black, white, black]
    assert row_of(image[:, :, :1]) == [NO_NUMBER]
    assert row_of(image[:, :, :2]) == [NO_NUMBER, white]


def test_the_range_of_grey_leaves_out_the_extremes_unless_all_others_are_equal():
    values = np.linspace(0, 1, 1001)
    values[0] = -100
    values[-1] = 100
    assert limits_of([maps(values)]) == pytest.approx((0.005, 0.995))
    values = np.full(1001, 7.0)
    values[3] = 9
    assert limits_of([maps(values)]) == (7, 9)


def test_the_largest_numbers_of_float32_have_a_range():
    largest = float(np.finfo(np.float32).max)
    assert row_of(maps([-largest, 0, largest])) == [(0, 0, 0), (128, 128, 128), (255, 255, 255)]
    assert row_of(maps([largest, 0], [largest, 0])) == [(255, 191, 0), (255, 255, 255)]


# -- channels --------------------------------------------------------------------------------------


def test_a_place_has_the_colour_of_its_largest_channel():
    """The first of equal ones; nan is left out."""
    array = maps([1, 5, 2, NAN, NAN, -INF], [3, 0, 2, -1, NAN, -INF], [2, 0, 2, -2, NAN, NAN])
    assert largest_channel(array).tolist() == [[1, 0, 0, 1, 3, 0]]
    a, b, c = FIRST_COLOURS[:3]
    assert row_of(array) == [b, a, a, b, NO_NUMBER, a]
    assert row_of(maps([0], [0], [1])) == [c]


def test_channels_have_different_colours():
    colours = [tuple(colour) for colour in channel_colours(MOST_COLOURS + 1).tolist()]
    assert len(set(colours[:MOST_COLOURS])) == MOST_COLOURS
    assert colours[MOST_COLOURS] == colours[0] and colours[-1] == NO_NUMBER
    assert NO_NUMBER not in colours[:-1]


def test_the_numbers_of_an_output_are_told():
    assert span_words(maps([1, -2.34567], [0, 4])) == "-2.346 to 4"
    assert span_words(maps([1, NAN], [INF, 4])) == "1 to 4 (2 nan or inf)"
    assert span_words(maps([NAN], [INF])) == "no finite number (2 nan or inf)"


# -- all -------------------------------------------------------------------------------------------


@given(
    arrays(
        np.float32,
        array_shapes(min_dims=3, max_dims=3, max_side=4),
        elements=st.floats(width=32),
    )
)
def test_any_map_has_a_picture(array):
    """Without a warning, and without a change of the array. Only nan has the colour of nan."""
    before = array.copy()
    if kind_of(array.shape) == "numbers":
        return
    picture = picture_of(array, limits_of([array]))
    assert picture.shape == (*array.shape[1:], 3)
    np.testing.assert_array_equal(array, before)
    is_nan = np.isnan(array).all(axis=0) if len(array) > 2 else np.isnan(array).any(axis=0)
    np.testing.assert_array_equal((picture == NO_NUMBER).all(axis=2), is_nan)
