"""How `digits` was trained: its recordings and its steps.

Each step continues the one before.
"""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from experiments.digit_data.small_sets import idx_bytes

pytest.importorskip("torch", reason="training needs torch (extra `train`)")

from async_tnt.base.progress import Bar
from experiments.digit_data.recordings import (
    FIRST_INDEX,
    digits_data,
    read_nmnist_folder,
    recording_numbers,
    simulate_recordings,
)
from experiments.digits import CONFIG, STEPS, train_digits


def test_a_folder_is_read_in_order_with_its_labels(nmnist):
    recordings = read_nmnist_folder(nmnist / "Train")
    assert recordings.names[:5] == (
        "0/60006.bin",
        "0/60016.bin",
        "0/60026.bin",
        "0/60036.bin",
        "1/60007.bin",
    )
    np.testing.assert_array_equal(recordings.labels, np.repeat(np.arange(10), 4))
    assert len(recordings.offsets) == 41 and recordings.offsets[-1] == len(recordings.t)
    assert read_nmnist_folder(nmnist / "Train", per_digit=1).names == recordings.names[::4]


def test_simulated_recordings_show_images_beyond_the_samples_by_their_seed(tmp_path):
    """Images with one bar each, only beyond FIRST_INDEX; the label is the bar's place."""
    images = np.zeros((FIRST_INDEX + 4, 28, 28), np.uint8)
    labels = np.zeros(len(images), np.uint8)
    for k in range(4):
        images[FIRST_INDEX + k, 6:22, 5 + 5 * k : 8 + 5 * k] = 255
        labels[FIRST_INDEX + k] = k + 1
    for name, array in (("images-idx3", images), ("labels-idx1", labels)):
        (tmp_path / f"train-{name}-ubyte.gz").write_bytes(gzip.compress(idx_bytes(array), 1))
    recordings = simulate_recordings(tmp_path, 4, 0)
    fewer = simulate_recordings(tmp_path, 2, 0)
    # none of the empty ones
    np.testing.assert_array_equal(np.sort(recordings.labels), [1, 2, 3, 4])
    for r, label in enumerate(recordings.labels):
        events = slice(recordings.offsets[r], recordings.offsets[r + 1])
        # its centre in the image, and the image's place on the sensor
        bar = 3 + 5 * label - 2.5 + 3.5
        assert np.median(recordings.x[events]) == pytest.approx(bar, abs=4)
    np.testing.assert_array_equal(recordings.t[: len(fewer.t)], fewer.t)  # the first of more
    assert recordings.names[:2] == fewer.names
    held_out = [n - 1 for n in recording_numbers([f"1/{FIRST_INDEX + 2:05d}.bin", "1/other.bin"])]
    np.testing.assert_array_equal(
        simulate_recordings(tmp_path, 3, 0, leave_out=held_out).labels.sum(), 1 + 3 + 4
    )


def test_each_step_continues_the_one_before_and_the_last_is_tested(
    nmnist, mnist, tmp_path, monkeypatch
):
    monkeypatch.setattr("experiments.digit_data.recordings.FIRST_INDEX", 10)
    monkeypatch.setattr("experiments.digits.available_cores", lambda: 1)
    monkeypatch.setattr("async_tnt.training.resynthesis.N_CALIBRATION", 12)
    data = digits_data(nmnist, mnist, CONFIG, simulated=5, progress=Bar)
    assert (data.record["real_recordings"], data.record["simulated_recordings"]) == (40, 5)
    assert len(data.training) == 135 and len(data.tests["test"][0]) == 30
    steps = {name: replace(step, epochs=1, variations=1) for name, step in list(STEPS.items())[3:]}
    model = train_digits(data, steps, tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.safetensors")) == [
        "digits.safetensors",
        "fourth.safetensors",
    ]
    assert model.record["started_from"]["seed"] == 0 and model.record["test"]["recordings"] == 10
