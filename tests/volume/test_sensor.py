"""The size of a sensor, as every class takes it that has no configuration."""

import re

import numpy as np
import pytest

from async_tnt import PixelFilter
from async_tnt.volume.sensor import check_sensor

PAIR = "`sensor` must be (width, height) in whole pixels, got {}"
SIDES = "`sensor` must have sides in [1, 32768] pixels, got {}"


@pytest.mark.parametrize("sensor", [(1, 1), (32_768, 1), [1, 32_768], np.array([346, 260])])
def test_sides_from_one_pixel_on_are_taken(sensor):
    width, height = sensor
    chosen = PixelFilter(sensor)
    assert chosen(([5], [width - 1], [height - 1], [1]))["x"].tolist() == [width - 1]
    with pytest.raises(ValueError, match=rf"^`y` must be in \[0, {height}\), got {height} at"):
        chosen(([5], [0], [height], [1]))


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ((0, 5), SIDES),
        ((5, 0), SIDES),
        ((5, 32_769), SIDES),
        ((32_769, 5), SIDES),
        ((5,), PAIR),
        ("ab", PAIR),
        (5, PAIR),
        ((True, 5), PAIR),
        ((5, 5.0), PAIR),
    ],
)
def test_other_sizes_are_refused(sensor, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message.format(repr(sensor)))}$"):
        PixelFilter(sensor)


def test_a_source_of_another_sensor_is_named_with_both_sizes():
    for found, wanted in ((None, (3, 4)), ((3, 4), None), ([3, 4], (3, 4))):
        check_sensor("a.dat", found, wanted)
    with pytest.raises(
        ValueError, match=r"^a\.dat: a sensor of 3x4 pixels, but the model is for 4x3; for it$"
    ):
        check_sensor("a.dat", (3, 4), (4, 3), advice="; for it")
