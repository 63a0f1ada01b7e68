"""`describe` by hand, and the simulator against real N-MNIST recordings where the data is at hand."""

import numpy as np
import pytest

from async_tnt.events import EVENT_DTYPE
from async_tnt.simulation.digits import simulate_digit
from async_tnt.simulation.mnist import load_mnist
from async_tnt.simulation.statistics import describe, side_by_side
from async_tnt.sources.files.nmnist import read_nmnist

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
    expected = {
        "events per saccade": (4 + 2 + 0) / 3,
        "active pixels": 100 * (2 + 1 + 0) / 3 / 100,
        "events per active pixel": 6 / 3,
        "same-pixel interval, median": 4.0,  # of 2, 4 and 8 ms
        "same-pixel interval, 5 %": 2.2,
        "ON share": 100 * 3 / 6,
        "ON - OFF centroid, saccade 1, x": 1 - 3,
        "ON - OFF centroid, saccade 1, y": 1 - 5,
        "ON - OFF centroid, saccade 2, x": 0.0,
        "ON - OFF centroid, saccade 2, y": 0.0,
        "ON - OFF centroid, saccade 3, x": np.nan,
        "ON - OFF centroid, saccade 3, y": np.nan,
    }
    assert numbers == pytest.approx(expected, nan_ok=True)
    twice = describe([BY_HAND, BY_HAND], sensor=(10, 10))
    assert np.isnan(describe([])["ON share"])  # without a warning
    assert twice == pytest.approx(expected | {"same-pixel interval, 5 %": 2.0}, nan_ok=True)  # of 2, 2, 4, 4, 8, 8


def test_centroids_along_and_across_the_motion_by_hand():
    # saccade 1: ON - OFF = (-2, -4), 2: (0, 0). Along 90 degrees, downwards, is -4; across is 180 degrees, to the left
    # the same recording twice, the second time as if it had moved to the left (180 degrees)
    both = describe([BY_HAND, BY_HAND], cuts_us=(0, 105_000), directions_deg=[[90], [180]])
    assert both["ON - OFF centroid, along the motion"] == pytest.approx((-4 + 2) / 2)
    assert both["ON - OFF centroid, across the motion"] == pytest.approx((2 + 4) / 2)


def test_simulations_are_like_the_real_recordings_of_the_same_images(data, real_mnist):
    """Of N-MNIST's first 60: the same pixels, polarity and saccade, and far more so than of another image."""
    paths = sorted((data / "nmnist" / "Train").glob("*/00*.bin"), key=lambda path: path.stem)[:60]
    images, _ = load_mnist(real_mnist, "train")
    real = [read_nmnist(path) for path in paths]
    simulated = [simulate_digit(images[int(path.stem) - 1], np.random.default_rng(i)) for i, path in enumerate(paths)]
    expected, got = describe(real), describe(simulated)
    report = side_by_side({"real": expected, "simulated": got})
    for name in expected:
        close = {"abs": 0.65} if name.startswith("ON - OFF") else {"rel": 0.12}
        assert got[name] == pytest.approx(expected[name], **close), report

    def count_map(events):
        counts = np.zeros((3, 2, 34, 34))
        saccade = np.minimum(events["t"] // 105_000, 2)
        np.add.at(counts, (saccade, events["p"], events["y"], events["x"]), 1)
        return counts.ravel()

    likeness = np.corrcoef(list(map(count_map, real)), list(map(count_map, simulated)))[:60, 60:]
    assert np.diag(likeness).mean() > 0.85 and (likeness.argmax(axis=1) == np.arange(60)).all()
