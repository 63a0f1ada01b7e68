"""Recordings for a model of some sensor; above all `.bin`, which does not state its own."""

import numpy as np
import pytest
from made import random_events, random_model

from async_tnt import TNTConfig
from async_tnt.cli import main
from async_tnt.sources.files.fitting import check_sensor, open_for
from async_tnt.sources.files.nmnist import write_nmnist


def write(path, sensor):
    events = random_events(300, duration_us=50_000, sensor=sensor)
    write_nmnist(path, events, sensor=sensor)
    return events


def test_a_bin_is_of_the_models_sensor_if_its_events_need_it(tmp_path):
    large, small = tmp_path / "large.bin", tmp_path / "small.bin"
    events = write(large, (120, 90))
    write(small, (34, 34))
    recording = open_for(large, (120, 90))
    assert recording.sensor == (120, 90)
    for name in ("t", "x", "y", "p"):
        np.testing.assert_array_equal(recording.read()[name], events[name])
    assert open_for(small, (120, 90)).sensor == (34, 34)  # of N-MNIST: the model does not fit
    assert open_for(small, (34, 34)).sensor == open_for(small, None).sensor == (34, 34)


def test_one_larger_than_the_model_s_sensor_is_refused(tmp_path):
    write(tmp_path / "a.bin", (120, 90))
    with pytest.raises(ValueError, match=r"damaged N-MNIST recording"):
        open_for(tmp_path / "a.bin", (50, 50))


def test_other_formats_keep_what_they_state(tmp_path):
    np.save(tmp_path / "a.npy", random_events(10, sensor=(20, 20)))
    assert open_for(tmp_path / "a.npy", (120, 90)).sensor is None


def test_check_sensor():
    check_sensor("a", None, (3, 4))
    check_sensor("a", (3, 4), (3, 4))
    with pytest.raises(ValueError, match=r"^a: a sensor of 5x4 pixels, but the model is for 3x4; train one for"):
        check_sensor("a", (5, 4), (3, 4))
    with pytest.raises(ValueError, match=r"^a: a sensor of 5x4 pixels, but --sensor says 3x4$"):
        check_sensor("a", (5, 4), (3, 4), "--sensor says", "")


def test_run_takes_a_bin_of_the_model_s_camera(tmp_path, capsys):
    random_model(TNTConfig(sensor=(120, 90), window_us=20_000), classes=2).save(tmp_path / "m.safetensors")
    write(tmp_path / "a.bin", (120, 90))
    assert main(["run", "--model", str(tmp_path / "m.safetensors"), str(tmp_path / "a.bin")]) == 0
    assert "a.bin: " in capsys.readouterr().out
