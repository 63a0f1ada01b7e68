"""Model files of format 1, which have no checksum, load with one warning that says what to do."""

import re
import subprocess
import sys

import numpy as np
import pytest
from made import random_events
from model.small import SMALL, assert_same, changed, small_model, write_format_1

from async_tnt import Model, load_model
from async_tnt.networks.model import UncheckedModelWarning


def test_it_loads_with_one_warning_that_a_save_ends(tmp_path):
    path = write_format_1(tmp_path / "m", changed(), classes='["class 0", "class 1", "class 2"]', record=None)
    with pytest.warns(UncheckedModelWarning) as caught:
        model = load_model(path)
    assert [str(w.message) for w in caught] == [
        f"{path} has no checksum, so damage to it would go unnoticed; load_model(path).save(path) adds one"
    ]
    assert caught[0].filename == __file__
    small = small_model()
    assert_same(model, Model(small.config, small.weights, small.classes))  # without a record
    assert_same(load_model(model.save(path)), model)  # without a warning, which would be an error here


@pytest.mark.parametrize("workers", [1, 2])
def test_a_command_says_so_once(tmp_path, workers):
    path = write_format_1(tmp_path / "m", changed(), classes='["a", "b", "c"]')
    for name in ("a", "b"):
        (tmp_path / "set" / name).mkdir(parents=True)
        for k in range(2):
            np.save(tmp_path / "set" / name / f"{k}.npy", random_events(50, seed=k, sensor=SMALL.sensor))
    words = ["evaluate", path, tmp_path / "set", "--workers", workers]
    done = subprocess.run(
        [sys.executable, "-m", "async_tnt.cli", *map(str, words)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert re.findall(".*checksum.*", done.stderr) == [
        f"async-tnt: warning: {path} has no checksum, so damage to it would go unnoticed; "
        "load_model(path).save(path) adds one"
    ]
    assert "UncheckedModelWarning" not in done.stderr
