"""A model survives its file bit for bit, and a failed save leaves what was there."""

import json
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from made import random_model
from model.small import SMALL, assert_same, changed, small_model
from safetensors import safe_open
from safetensors.numpy import load_file

from async_tnt import CompiledClassifier, Model, TNTConfig, bundled_models, load_model
from async_tnt.networks.torch_modules import torch_classifier

SHAPES = [  # configuration, classes, widths
    (TNTConfig(), 10, (16, 32, 64)),
    (TNTConfig(polarity="split"), 10, (16, 32, 64)),
    (SMALL, 3, (2, 3, 4)),
    (TNTConfig(sensor=(346, 260), grid=(4, 4), bins=1), 1, (1, 1, 1)),
    (TNTConfig(sensor=(346, 260), grid=(35, 7), polarity="split", bins=3, landmark="window"), 2, (5, 7, 130)),
    (TNTConfig(grid=(6, 31), landmark="line", remove_flow=True, t_max=2.0, polarity="unsigned"), 11, (20, 3, 1)),
    (TNTConfig(transform="none", window_us=1, grid=(17, 4)), 4, (9, 33, 6)),
]


# -- there and back ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("config", "classes", "widths"), SHAPES)
def test_save_and_load(tmp_path, config, classes, widths):
    model = random_model(config, classes=classes, widths=widths)
    path = model.save(tmp_path / "some.safetensors")
    assert path == tmp_path / "some.safetensors"
    for came_back in (load_model(path), load_model(str(path))):
        assert_same(came_back, model)
        assert list(came_back.weights) == sorted(model.weights)  # as what is made of them depends on their order
    assert [p.name for p in tmp_path.iterdir()] == ["some.safetensors"]


@pytest.mark.parametrize(("config", "classes", "widths"), SHAPES)
def test_any_widths_and_grids_compute_what_torch_computes(tmp_path, config, classes, widths):
    model = load_model(random_model(config, classes=classes, widths=widths).save(tmp_path / "m"))
    volume = np.random.default_rng(0).normal(size=config.shape).astype(np.float32)
    with torch.no_grad():
        expected = torch_classifier(model)(torch.from_numpy(volume)[None])[0].numpy()
    logits = CompiledClassifier(model)(volume)
    assert np.ptp(expected) > 1e-3 or classes == 1
    np.testing.assert_allclose(logits, expected, atol=1e-4)  # summation order in float32


def test_weights_of_extreme_size_come_back_bit_by_bit(tmp_path):
    special = np.array([np.finfo("f4").max, np.finfo("f4").tiny, 1e-45, -0.0], np.float32)
    model = Model(SMALL, changed(fc1__bias=special), ("a", "b", "c"))
    assert_same(load_model(model.save(tmp_path / "m")), model)


def test_names_and_record_in_any_writing(tmp_path):
    record = {"data": "N-MNIST", "Genauigkeit": [0.5, 1, None, True], "nested": {"猫": "\n\"'\\\0"}}
    model = Model(SMALL, changed(), ["Ölbaum", "", "猫 🐈"], record)
    assert model.classes == ("Ölbaum", "", "猫 🐈")
    came_back = load_model(model.save(tmp_path / "ein Modell.safetensors"))
    assert_same(came_back, model)
    assert Model(SMALL, changed(), [0, 1, 2]).classes == ("0", "1", "2")
    assert Model(SMALL, changed(), ("a", "b", "c")).record == {}


@pytest.mark.parametrize("dtype", ["f2", "f8", ">f4", ">f8", "i4", "u1"])
def test_weights_of_other_types_become_float32(dtype):
    values = np.arange(4).astype(dtype)
    weights = Model(SMALL, changed(fc1__bias=values), ("a", "b", "c")).weights
    assert weights["fc1.bias"].dtype == np.float32
    np.testing.assert_array_equal(weights["fc1.bias"], [0, 1, 2, 3])


def test_the_file_is_plain_safetensors(tmp_path):
    model = small_model()
    path = model.save(tmp_path / "m")
    arrays = load_file(path)
    assert arrays.keys() == model.weights.keys()
    assert all(arrays[name].tobytes() == values.tobytes() for name, values in model.weights.items())
    with safe_open(path, "numpy") as file:
        assert set(file.metadata()) == {"format", "config", "classes", "record", "network", "sha256"}
        assert json.loads(file.metadata()["config"]) == SMALL.to_dict()
        assert json.loads(file.metadata()["classes"]) == list(model.classes)
        assert json.loads(file.metadata()["record"]) == {"made": True}


def test_weights_in_any_memory(tmp_path):
    weights = {name: np.asfortranarray(values) for name, values in changed().items()}
    weights["fc2.weight"] = np.repeat(weights["fc2.weight"], 2, axis=1)[:, ::2]
    weights["fc1.bias"].flags.writeable = False
    assert_same(
        load_model(Model(SMALL, weights, ("a", "b", "c")).save(tmp_path / "m")),
        Model(SMALL, changed(), ("a", "b", "c")),
    )


def test_a_model_is_equal_to_itself_only_and_can_be_a_key():
    one, other = small_model(), small_model()
    assert one == one and one != other
    assert len({one, other, one}) == 2
    with pytest.raises(AttributeError):
        one.classes = ("x",)


# -- an existing file ----------------------------------------------------------------------------------------


def broken_write(self, content):
    with open(self, "wb") as file:
        file.write(content[:100])
    raise OSError(28, "No space left on device")


def interrupted(self, target):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("method", "breaks", "error"),
    [("write_bytes", broken_write, OSError), ("replace", interrupted, KeyboardInterrupt)],
)
@pytest.mark.parametrize("existing", [False, True])
def test_a_failed_save_leaves_what_was_there(tmp_path, monkeypatch, method, breaks, error, existing):
    path = tmp_path / "m.safetensors"
    if existing:
        small_model(seed=1).save(path)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    with monkeypatch.context() as patch:
        patch.setattr(Path, method, breaks)
        with pytest.raises(error):
            small_model(seed=2).save(path)
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
    small_model(seed=2).save(path)
    assert_same(load_model(path), small_model(seed=2))
    assert [p.name for p in tmp_path.iterdir()] == ["m.safetensors"]


def test_places_that_cannot_hold_a_file(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        small_model().save(tmp_path / "folder")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        small_model().save(tmp_path / "nowhere" / "m.safetensors")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]
    assert list((tmp_path / "folder").iterdir()) == []


def test_a_record_that_json_cannot_hold(tmp_path):
    model = Model(SMALL, changed(), ("a", "b", "c"), {"accuracy": np.float32(0.5)})
    with pytest.raises(TypeError, match="float32 is not JSON serializable"):
        model.save(tmp_path / "m")
    assert list(tmp_path.iterdir()) == []


def test_who_reads_during_saves_sees_a_whole_model(tmp_path):
    path = small_model(seed=0).save(tmp_path / "m")
    whole = [small_model(seed=seed).weights["fc1.weight"].tobytes() for seed in (0, 1)]
    done = threading.Event()

    def save_again_and_again():
        models = small_model(seed=0), small_model(seed=1)
        try:
            for k in range(60):
                models[k % 2].save(path)
        finally:
            done.set()

    writer = threading.Thread(target=save_again_and_again)
    writer.start()
    while not done.is_set():
        assert load_model(path).weights["fc1.weight"].tobytes() in whole
    writer.join()
    assert load_model(path).weights["fc1.weight"].tobytes() == whole[1]


# -- not there -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nonsense", "digits.safetensors", "", "a/b/c", "no\0name", "DIGITS"])
def test_a_name_that_is_none_lists_the_bundled_ones(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
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


def test_bundled_names_are_sorted_and_load():
    assert list(bundled_models()) == sorted(set(bundled_models()))
    for name in bundled_models():
        assert isinstance(load_model(name), Model)
        assert not name.endswith(".safetensors")
