"""What new events touch: counted as by hand."""

from __future__ import annotations

import numpy as np
import pytest
from bench.scripts import load_benchmark
from made import events_of, random_model

from async_tnt import TNTConfig, load_model
from async_tnt.checking.moments import Moment, bench_recordings, windows_of

touched = load_benchmark("measure_touched")

CONFIG = TNTConfig(sensor=(18, 14), grid=(18, 14), bins=4, window_us=1000, transform="none")


@pytest.mark.parametrize("shape", [(14, 18), (15, 17), (8, 9)])
def test_reached_cells_are_those_whose_taps_see_the_changed_one(shape):
    height, width = shape
    rows, columns = height // 2, width // 2
    for y in range(height):
        for x in range(width):
            changed = np.zeros(shape, bool)
            changed[y, x] = True
            expected = np.zeros((rows, columns), bool)
            for row in range(rows):
                for column in range(columns):
                    seen_y, seen_x = range(2 * row - 1, 2 * row + 3), range(2 * column - 1, 2 * column + 3)
                    expected[row, column] = y in seen_y and x in seen_x
            assert np.array_equal(touched._reached(changed, (rows, columns)), expected), (y, x)


def test_one_event_changes_eight_cells_and_reaches_few_places():
    model = random_model(CONFIG, widths=(4, 6, 8))
    events = events_of([100, 450], [9, 9], [6, 6], [1, 1])  # whole pixels: one of the four in space
    (count,) = touched._count(model, [Moment(0, events, 1, False)])
    assert count["changed"]["input"] == 2  # two time bins
    assert count["reached"]["input"] == 8
    assert count["reached"]["pooled_1"] == 2 * 2  # rows (6 - 1) // 2 and (6 + 1) // 2, columns 4 and 5
    assert count["reached"]["pooled_2"] == 3 * 3  # of rows 2 and 3 the rows 0..2, of columns 4 and 5 the columns 1..3
    assert count["reached"]["partial"] == count["changed"]["pooled_2"] <= 9


def test_nothing_follows_from_an_event_off_the_grid():
    model = random_model(CONFIG.replace(transform="tnt", landmark="center", t_max=8.0), widths=(4, 6, 8))
    events = events_of([100, 101], [9, 17], [6, 13], [1, 1])  # early: (17 - 8.5) / .8 lies outside
    (count,) = touched._count(model, [Moment(0, events, 1, False)])
    assert set(count["changed"].values()) == {0.0}


def test_the_whole_network_by_hand():
    whole = touched.bench_touched(load_model("digits"), [], moments=20)["whole"]
    assert whole["multiplications"] == 4 * 289 * 9 * 9 * 16 + 4 * 64 * 9 * 16 * 32 + 64 * 32 * 64 + 64 * 10
    assert whole["weight_bytes"] == 4 * (9 * 9 * 16 + 9 * 16 * 32 + 64 * 32 * 64 + 64 * 10)


def test_more_new_events_touch_more():
    model = load_model("digits")
    windows = [w for events in bench_recordings(model)[:3] for w in windows_of(events, model.config.window_us)]
    found = touched.bench_touched(model, windows, moments=40)
    rows = [found[n] for n in ("1", "10", "100", "1300", "whole")]
    assert [r["multiplications"] for r in rows] == sorted(r["multiplications"] for r in rows)
    assert found["1"]["multiplications"] < found["whole"]["multiplications"] / 5
    for n in ("1", "10", "100", "1300"):
        for layer in ("pooled_1", "pooled_2"):
            assert 0 < found[n]["changed"][layer] <= found[n]["reached"][layer]
