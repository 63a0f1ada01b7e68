"""N-MOVING-MNIST's simulator beside N-MNIST.

The tests have numbers by hand, and real recordings where the data is at hand.
"""

import numpy as np
import pytest

from async_tnt.resynthesis.calibration import side_by_side
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.volume.events import EVENT_DTYPE
from experiments.digit_data.mnist import load_mnist
from experiments.motions.simulated_digits import simulate_digit
from experiments.moving_set.comparison import SACCADE_CUTS_US, describe_motions, nmnist_directions

ALONG = "ON - OFF centroid, along the motion"
ACROSS = "ON - OFF centroid, across the motion"


def test_centroids_along_and_across_the_motion_by_hand():
    """ON - OFF is (-2, -4).

    For a motion downwards, at 90 degrees, this is -4 along and 2 across. At 180 degrees it is 2
    along and 4 across.
    """
    rows = [(0, 1, 1, 1), (2_000, 1, 1, 1), (3_000, 5, 9, 0), (6_000, 1, 1, 0), (9_000, 9, 9, 1)]
    events = np.array(rows, EVENT_DTYPE)
    both = describe_motions([events, events], (0, 9_000), [90, 180])
    assert both["events per window"] == 4  # the last event is after the cut
    assert both[ALONG] == pytest.approx((-4 + 2) / 2) and both[ACROSS] == pytest.approx((2 + 4) / 2)
    assert np.isnan(describe_motions([], (0, 9_000), [90])[ALONG])


def test_simulations_are_like_the_real_recordings_of_the_same_images(data):
    """The first 60 recordings of N-MNIST are like their simulations.

    They have the same pixels, polarity and saccade, and are far more alike than recordings of
    different images.
    """
    if not (data / "mnist").is_dir():
        pytest.skip(f"no mnist in {data}")
    paths = sorted((data / "nmnist" / "Train").glob("*/00*.bin"), key=lambda path: path.stem)[:60]
    images, _ = load_mnist(data / "mnist", "train")
    real = [read_nmnist(path) for path in paths]
    simulated = [
        simulate_digit(images[int(path.stem) - 1], np.random.default_rng(i))
        for i, path in enumerate(paths)
    ]
    expected = describe_motions(real, SACCADE_CUTS_US, nmnist_directions())
    got = describe_motions(simulated, SACCADE_CUTS_US, nmnist_directions())
    both = side_by_side({"real": expected, "simulated": got})
    for name in expected:
        close = {"abs": 0.65} if name.startswith("ON - OFF") else {"rel": 0.12}
        assert got[name] == pytest.approx(expected[name], **close), both

    def count_map(events):
        counts = np.zeros((3, 2, 34, 34))
        saccade = np.minimum(events["t"] // 105_000, 2)
        np.add.at(counts, (saccade, events["p"], events["y"], events["x"]), 1)
        return counts.ravel()

    likeness = np.corrcoef(list(map(count_map, real)), list(map(count_map, simulated)))[:60, 60:]
    assert np.diag(likeness).mean() > 0.85 and (likeness.argmax(axis=1) == np.arange(60)).all()
