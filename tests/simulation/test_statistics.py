"""`describe`: numbers by hand, and the simulator against real N-MNIST where the data is at hand."""

import os
from pathlib import Path

import numpy as np
import pytest

from async_tnt.events import EVENT_DTYPE
from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist
from async_tnt.simulation.statistics import describe, side_by_side
from async_tnt.sources.files.nmnist import read_nmnist

DATA = Path(os.environ.get("TNT_DATA", Path(__file__).parents[2].parent / "shared" / "data"))

BY_HAND = np.array(
    [
        # saccade 1: pixel (1, 1) at 0, 2 and 6 ms; pixel (5, 9) once. ON at x = 1, 1 and OFF at x = 1, 5
        (0, 1, 1, 1),
        (2_000, 1, 1, 1),
        (3_000, 5, 9, 0),
        (6_000, 1, 1, 0),
        # saccade 2: pixel (1, 1) again, 8 ms apart; the interval across the cut does not count
        (105_000, 1, 1, 0),
        (113_000, 1, 1, 1),
        # saccade 3: nothing; and one event after it
        (315_000, 3, 3, 1),
    ],
    EVENT_DTYPE,
)


def test_numbers_by_hand():
    numbers = describe(BY_HAND, sensor=(10, 10))
    assert numbers["events per saccade"] == pytest.approx((4 + 2 + 0) / 3)
    assert numbers["active pixels"] == pytest.approx(100 * (2 + 1 + 0) / 3 / 100)
    assert numbers["events per active pixel"] == pytest.approx(6 / 3)
    assert numbers["same-pixel interval, median"] == pytest.approx(4.0)  # of 2, 4 and 8 ms
    assert numbers["same-pixel interval, 5 %"] == pytest.approx(2.2)
    assert numbers["ON share"] == pytest.approx(100 * 3 / 6)
    assert numbers["ON - OFF centroid, saccade 1, x"] == pytest.approx(1 - 3)
    assert numbers["ON - OFF centroid, saccade 1, y"] == pytest.approx(1 - 5)
    assert numbers["ON - OFF centroid, saccade 2, x"] == 0.0
    assert np.isnan(numbers["ON - OFF centroid, saccade 3, x"])


def test_centroids_along_and_across_the_motion_by_hand():
    # saccade 1: ON - OFF = (-2, -4), 2: (0, 0). Along 90 degrees, downwards, is -4; across is 180 degrees, to the left
    numbers = describe(BY_HAND, directions_deg=[90, 0, 0])
    assert numbers["ON - OFF centroid, along the motion"] == pytest.approx((-4 + 0) / 2)
    assert numbers["ON - OFF centroid, across the motion"] == pytest.approx((2 + 0) / 2)
    # the same recording twice, the second time as if it had moved to the left (180 degrees)
    both = describe([BY_HAND, BY_HAND], cuts_us=(0, 105_000), directions_deg=[[90], [180]])
    assert both["ON - OFF centroid, along the motion"] == pytest.approx((-4 + 2) / 2)
    assert both["ON - OFF centroid, across the motion"] == pytest.approx((2 + 4) / 2)
    assert "ON - OFF centroid, along the motion" not in describe(BY_HAND)


def test_several_recordings_are_averaged():
    twice = describe([BY_HAND, BY_HAND], sensor=(10, 10))
    expected = describe(BY_HAND, sensor=(10, 10))
    expected["same-pixel interval, 5 %"] = 2.0  # of 2, 2, 4, 4, 8, 8
    assert twice == pytest.approx(expected, nan_ok=True)
    with_an_empty_one = describe([BY_HAND, BY_HAND[:0]], sensor=(10, 10))
    assert with_an_empty_one["events per saccade"] == pytest.approx(1.0)
    assert with_an_empty_one["events per active pixel"] == pytest.approx(2.0)


@pytest.mark.parametrize("nothing", [[], BY_HAND[:0], [BY_HAND[:0]]])
def test_nothing_to_measure_is_nan_without_a_warning(nothing):
    numbers = describe(nothing)
    assert np.isnan(numbers["ON share"]) and np.isnan(numbers["same-pixel interval, median"])


def test_table_has_a_row_per_number_and_a_column_per_description():
    table = side_by_side({"real": {"ON share": 49.8, "active pixels": 26.0}, "simulated": {"ON share": 49.126}})
    head, on_share, active = table.splitlines()
    assert head.split() == ["real", "simulated"]
    assert on_share.split()[-2:] == ["49.80", "49.13"] and "[%]" in on_share
    assert active.split()[-2:] == ["26.00", "-"]


@pytest.mark.skipif(
    not ((DATA / "nmnist" / "Train").is_dir() and (DATA / "mnist").is_dir()),
    reason=f"needs nmnist/Train and mnist in {DATA} (set TNT_DATA)",
)
def test_simulations_are_like_the_real_recordings_of_the_same_images():
    """The first 60 recordings of N-MNIST that are here, and the MNIST images they show."""
    paths = sorted((DATA / "nmnist" / "Train").glob("*/00*.bin"), key=lambda path: path.stem)[:60]
    images, labels = load_mnist(DATA / "mnist", "train")
    assert all(labels[int(path.stem) - 1] == int(path.parent.name) for path in paths)
    real = [read_nmnist(path) for path in paths]
    simulated = [simulate_digit(images[int(path.stem) - 1], np.random.default_rng(i)) for i, path in enumerate(paths)]
    expected, got = describe(real), describe(simulated)
    report = side_by_side({"real": expected, "simulated": got})
    for name in (
        "events per saccade",
        "active pixels",
        "events per active pixel",
        "ON share",
        "same-pixel interval, 5 %",
        "same-pixel interval, median",
    ):
        assert got[name] == pytest.approx(expected[name], rel=0.12), report
    for name in (name for name in expected if name.startswith("ON - OFF")):
        assert got[name] == pytest.approx(expected[name], abs=0.65), report

    # the same pixels, polarity and saccade: the count maps agree, and far better than with another image's
    def maps(events):
        counts = np.zeros((3, 2, 34, 34))
        saccade = np.minimum(events["t"] // 105_000, 2)
        np.add.at(counts, (saccade, events["p"], events["y"], events["x"]), 1)
        return counts.ravel()

    likeness = np.corrcoef([maps(events) for events in real], [maps(events) for events in simulated])[:60, 60:]
    assert np.diag(likeness).mean() > 0.85
    assert (likeness.argmax(axis=1) == np.arange(60)).all()
