"""Simulated training data, from a small folder in MNIST's format; and the learning curves' picture."""

import struct
import sys

import numpy as np
import pytest

from async_tnt.simulation.digits import FIRST_SAMPLE
from async_tnt.training.digits import FIRST_INDEX, simulate_recordings
from async_tnt.training.run_files import plot_curves
from async_tnt.training.windows import make_windows

N_IMAGES = FIRST_INDEX + 4


@pytest.fixture(scope="module")
def mnist(tmp_path_factory):
    """Images with one bar each, only beyond FIRST_INDEX; the label is the bar's place."""
    folder = tmp_path_factory.mktemp("mnist")
    images, labels = np.zeros((N_IMAGES, 28, 28), np.uint8), np.zeros(N_IMAGES, np.uint8)
    for k in range(4):
        images[FIRST_INDEX + k, 6:22, 5 + 5 * k : 8 + 5 * k] = 255
        labels[FIRST_INDEX + k] = k + 1
    header = struct.pack(">4B3I", 0, 0, 8, 3, N_IMAGES, 28, 28)
    (folder / "train-images-idx3-ubyte").write_bytes(header + images.tobytes())
    (folder / "train-labels-idx1-ubyte").write_bytes(struct.pack(">4BI", 0, 0, 8, 1, N_IMAGES) + labels.tobytes())
    return folder


def test_each_recording_shows_another_image_beyond_the_samples(mnist):
    recordings = simulate_recordings(mnist, 4, seed=0)
    np.testing.assert_array_equal(np.sort(recordings.labels), [1, 2, 3, 4])  # none of the empty ones
    assert FIRST_INDEX > FIRST_SAMPLE + 1_000  # the samples are the first of each digit from there
    assert len(make_windows(recordings, 105_000)) == 12
    for r, label in enumerate(recordings.labels):
        events = slice(recordings.offsets[r], recordings.offsets[r + 1])
        bar = 3 + 5 * label - 2.5 + 3.5  # its centre in the image, and the image's place on the sensor
        assert np.median(recordings.x[events]) == pytest.approx(bar, abs=4)
        assert recordings.t[events].max() > 250_000


def test_the_seed_decides(mnist):
    first, again, other = (simulate_recordings(mnist, 2, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.t, again.t)
    assert first.names == again.names and first.names[0].startswith("simulated 500")
    assert not np.array_equal(first.t, other.t)


def test_fewer_are_the_first_of_more(mnist):
    more, fewer = simulate_recordings(mnist, 4, 0), simulate_recordings(mnist, 2, 0)
    assert more.names[:2] == fewer.names
    np.testing.assert_array_equal(more.t[: len(fewer.t)], fewer.t)


def test_more_than_there_are_images_is_refused(mnist):
    with pytest.raises(ValueError, match=r"must be in \[0, 4\], got 5"):
        simulate_recordings(mnist, 5, 0)


def test_curves_are_a_picture_where_matplotlib_is(tmp_path, monkeypatch):
    history = [{"epoch": 1, "loss": 2.0, "training": 0.3}, {"epoch": 2, "loss": 1.0, "training": 0.6}]
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert not plot_curves(history, tmp_path / "none.png") and not (tmp_path / "none.png").exists()
    monkeypatch.undo()
    pytest.importorskip("matplotlib")
    assert plot_curves(history, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["curves.png"]
