"""A model survives its file bit for bit, and a failed save leaves what was there."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from made import random_model
from model.small import CLASSES, SMALL, WITH_REGRESSOR, assert_same, changed, small_model
from safetensors import safe_open
from safetensors.numpy import load_file

from async_tnt import CompiledClassifier, CompiledRegressor, Model, TNTConfig, bundled_models, load_model

MODELS = [
    random_model(),
    small_model(config=WITH_REGRESSOR),
    random_model(TNTConfig(grid=(35, 7), polarity="split", bins=3, landmark="window"), classes=2, widths=(5, 7, 130)),
    random_model(TNTConfig(transform="none", window_us=1, grid=(17, 4)), classes=4, widths=(9, 33, 6)),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: str(model.config.grid))
def test_save_and_load(tmp_path, model):
    path = model.save(tmp_path / "some.safetensors")
    assert path == tmp_path / "some.safetensors" and os.listdir(tmp_path) == ["some.safetensors"]
    volume = np.random.default_rng(0).normal(size=model.config.shape).astype(np.float32)
    for came_back in (load_model(path), load_model(str(path))):
        assert_same(came_back, model)
        assert list(came_back.weights) == sorted(model.weights)  # as what is made of them depends on their order
        assert CompiledClassifier(came_back)(volume).tobytes() == CompiledClassifier(model)(volume).tobytes()
        if model.config.needs_regressor:
            assert CompiledRegressor(came_back)(volume) == CompiledRegressor(model)(volume)


def test_extreme_weights_names_and_records_come_back(tmp_path):
    special = np.array([np.finfo("f4").max, np.finfo("f4").tiny, 1e-45, -0.0], np.float32)
    record = {"data": "N-MNIST", "Genauigkeit": [0.5, 1, None, True], "nested": {"猫": "\n\"'\\\0"}}
    model = Model(SMALL, changed(fc1__bias=special), ["Ölbaum", "", "猫 🐈"], record)
    assert model.classes == ("Ölbaum", "", "猫 🐈")
    assert_same(load_model(model.save(tmp_path / "ein Modell.safetensors")), model)
    assert Model(SMALL, changed(), [0, 1, 2]).classes == ("0", "1", "2")
    assert Model(SMALL, changed(), CLASSES).record == {}


@pytest.mark.parametrize("dtype", ["f2", ">f4", "u1"])
def test_weights_of_any_numbers_in_any_memory_become_float32(dtype):
    weights = {name: np.asfortranarray(np.ceil(np.abs(w)), dtype) for name, w in changed().items()}
    weights["fc2.weight"] = np.repeat(weights["fc2.weight"], 2, axis=1)[:, ::2]
    weights["fc1.bias"].flags.writeable = False
    for name, values in Model(SMALL, weights, CLASSES).weights.items():
        assert (
            values.dtype == np.float32 and values.flags.c_contiguous and not np.may_share_memory(values, weights[name])
        )
        np.testing.assert_array_equal(values, weights[name])


def test_the_file_is_plain_safetensors(tmp_path):
    model = small_model()
    path = model.save(tmp_path / "m")
    arrays = load_file(path)
    assert {name: w.tobytes() for name, w in arrays.items()} == {name: w.tobytes() for name, w in model.weights.items()}
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    assert metadata.keys() == {"format", "config", "classes", "record", "network", "sha256"}
    parts = [json.loads(metadata[name]) for name in ("config", "classes", "record")]
    assert parts == [SMALL.to_dict(), list(model.classes), {"made": True}]


# -- an existing file ----------------------------------------------------------------------------------------


def broken_write(self, content):
    with open(self, "wb") as file:
        file.write(content[:100])
    raise OSError(28, "No space left on device")


def interrupted(self, target):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "method, breaks, error", [("write_bytes", broken_write, OSError), ("replace", interrupted, KeyboardInterrupt)]
)
def test_a_failed_save_leaves_what_was_there(tmp_path, monkeypatch, method, breaks, error):
    path = small_model(seed=1).save(tmp_path / "m.safetensors")
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    with monkeypatch.context() as patch, pytest.raises(error):
        patch.setattr(Path, method, breaks)
        small_model(seed=2).save(path)
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert_same(load_model(small_model(seed=2).save(path)), small_model(seed=2))
    assert os.listdir(tmp_path) == ["m.safetensors"]


def test_what_cannot_be_saved_leaves_nothing(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        small_model().save(tmp_path / "folder")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        small_model().save(tmp_path / "nowhere" / "m.safetensors")
    with pytest.raises(TypeError, match="float32 is not JSON serializable"):
        Model(SMALL, changed(), CLASSES, {"accuracy": np.float32(0.5)}).save(tmp_path / "m")
    assert os.listdir(tmp_path) == ["folder"] and os.listdir(tmp_path / "folder") == []


# -- not there -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nonsense", "", "no\0name"])
def test_an_unknown_name_lists_the_bundled_ones(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert list(bundled_models()) == sorted(set(bundled_models())) and load_model("digits").classes[3] == "3"
    names = ", ".join(bundled_models())
    message = rf"^no model file {re.escape(str(Path(name)))}, and no bundled model of that name \(bundled: {names}\)$"
    with pytest.raises(FileNotFoundError, match=message):
        load_model(name)


def test_only_a_regular_file_is_a_model(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "link").symlink_to(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "fifo", tmp_path / "link", "/dev/zero", "/dev/null"):
        with pytest.raises(FileNotFoundError, match=f"^no model file {path}, "):
            load_model(path)
