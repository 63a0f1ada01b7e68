"""A model survives its file bit for bit, and says what it is.

Weights, classes and configuration that do not fit each other are refused, from Python and from a
file.
"""

import itertools
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from made import raw_model, thesis_model
from networks.random_networks import random_models
from networks.random_spiking import random_spiking_model
from networks.small import (
    CLASSES,
    SMALL,
    WITH_REGRESSOR,
    assert_same,
    changed,
    small_model,
    write_file,
)
from safetensors import safe_open
from torch import nn

from async_tnt import CompiledClassifier, Model, bundled_models, load_model
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.models.model_file import checksum, checksum_of


@given(random_models())
def test_a_saved_network_is_the_same(tmp_path_factory, model):
    path = model.save(tmp_path_factory.mktemp("model") / "m.safetensors")
    volume = np.random.default_rng(0).normal(size=model.config.shape).astype(np.float32)
    for loaded in (load_model(path), load_model(str(path))):
        assert_same(loaded, model)
        # What is made of the weights depends on their order.
        assert list(loaded.weights) == sorted(model.weights)
        assert loaded.network == model.network
        expected = CompiledClassifier(model)(volume).tobytes()
        assert CompiledClassifier(loaded)(volume).tobytes() == expected


def test_a_model_keeps_its_weights_whatever_becomes_of_the_arrays_it_was_made_of():
    given = {name: w.copy() for name, w in changed().items()}
    model = thesis_model(SMALL, given, CLASSES)
    expected = {name: w.copy() for name, w in given.items()}
    for w in given.values():
        w += 1
    assert all((model.weights[name] == w).all() for name, w in expected.items())


def test_extreme_weights_names_and_records_come_back_from_a_plain_safetensors_file(tmp_path):
    special = np.array([np.finfo("f4").max, np.finfo("f4").tiny, 1e-45, -0.0], np.float32)
    record = {"data": "N-MNIST", "Genauigkeit": [0.5, 1, None, True], "nested": {"猫": "\n\"'\\\0"}}
    assert thesis_model(SMALL, changed(), [0, 1, 2]).classes == ("0", "1", "2")
    model = thesis_model(SMALL, changed(fc1__bias=special), ["Ölbaum", "", "猫 🐈"], record)
    assert model.classes == ("Ölbaum", "", "猫 🐈")
    assert repr(model) == "Model(3 classes, 9x8 -> 2x6x5, 2 conv, 2 dense, 126 weights)"
    whole = small_model(config=WITH_REGRESSOR)
    n = sum(w.size for w in whole.weights.values())
    assert repr(whole) == f"Model(3 classes, 9x8 -> 2x6x5, 6 conv, 2 dense, {n} weights)"
    path = model.save(tmp_path / "ein Modell")
    assert path == tmp_path / "ein Modell" and os.listdir(tmp_path) == ["ein Modell"]
    assert_same(load_model(path), model)
    with safe_open(path, "numpy") as file:
        assert {name: file.get_tensor(name).tobytes() for name in file.keys()} == {  # noqa: SIM118
            name: w.tobytes() for name, w in model.weights.items()
        }
        metadata = file.metadata()
    assert metadata.keys() == {"format", "config", "classes", "record", "network", "sha256"}
    parts = [json.loads(metadata[name]) for name in ("config", "classes", "record")]
    assert parts == [SMALL.to_dict(), list(model.classes), record]
    exported = OnnxClassifier(to_onnx(model)).exported
    assert (exported.config, exported.classes, exported.record) == (SMALL, model.classes, record)


def test_the_multiplications_of_a_classifier_by_hand():
    """3 x 3 weights of 2 channels at 2 x 6 x 5 and at 3 x 3 x 2 numbers; then 3 to 4 to 3 units.

    Those of a landmark network do not count.
    """
    expected = 60 * 18 + 18 * 18 + 12 + 12
    assert small_model().multiplications == expected
    assert small_model(config=WITH_REGRESSOR).multiplications == expected


def test_only_convolutions_and_dense_layers_have_multiplications_that_count():
    """3 x 3 weights of one channel in each of two groups, at 2 x 4 x 3 places; 2 to 3 units."""
    net = nn.Sequential(
        nn.Conv2d(2, 2, 3, groups=2),
        nn.BatchNorm2d(2),
        nn.PReLU(2),
        nn.GroupNorm(1, 2),
        nn.AdaptiveAvgPool2d(1),
        nn.Flatten(),
        nn.Linear(2, 3),
    )
    model = Model.from_torch(net.eval(), SMALL, CLASSES)
    assert model.multiplications == 24 * 9 + 6


@pytest.mark.parametrize("dtype", ["f2", ">f4", "u1"])
def test_weights_of_any_numbers_in_any_memory_become_float32(dtype):
    weights = {name: np.asfortranarray(np.ceil(np.abs(w)), dtype) for name, w in changed().items()}
    weights["fc2.weight"] = np.repeat(weights["fc2.weight"], 2, axis=1)[:, ::2]
    weights["fc1.bias"].flags.writeable = False
    for name, values in thesis_model(SMALL, weights, CLASSES).weights.items():
        assert values.dtype == np.float32
        assert values.flags.c_contiguous
        assert not np.may_share_memory(values, weights[name])
        np.testing.assert_array_equal(values, weights[name])


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (small_model(), "async_tnt 2"),
        (raw_model(SMALL), "async_tnt 3"),
        (random_spiking_model(0), "async_tnt 4"),
        (random_spiking_model(0, raw=True), "async_tnt 4"),
    ],
)
def test_the_format_of_a_file_is_one_that_older_releases_refuse(model, expected, tmp_path):
    """Those that cannot run such a model; with statistics: see `teaching/test_taught_models.py`."""
    with safe_open(model.save(tmp_path / "m"), "numpy") as file:
        assert file.metadata()["format"] == expected


def test_a_checksum_is_of_names_types_shapes_and_bytes():
    """In any order, and however they lie in memory."""
    zeros = np.zeros((2, 3), np.float32)
    ones = np.ones((2, 2), np.float32)
    expected = checksum({"a": zeros, "b": ones}, "text")
    assert checksum({"b": np.asfortranarray(ones), "a": zeros[:, ::-1]}, "text") == expected
    others = [
        ({"a": zeros, "c": ones}, "text"),
        ({"a": zeros.view(np.int32), "b": ones}, "text"),
        ({"a": zeros.T, "b": ones}, "text"),
        ({"a": zeros, "b": 2 * ones}, "text"),
        ({"a": zeros, "b": ones}, "texts"),
    ]
    assert len({expected, *(checksum(*other) for other in others)}) == 6


def test_the_checksum_of_a_file_is_of_all_metadata_but_itself():
    metadata = small_model().description() | {"network": "[]", "statistics": "{}"}
    expected = checksum_of({}, metadata)
    assert checksum_of({}, metadata | {"sha256": "0"}) == expected
    for name in metadata:
        assert checksum_of({}, metadata | {name: "0"}) != expected


def test_what_cannot_be_saved_leaves_nothing(tmp_path):
    with pytest.raises(TypeError, match="float32 is not JSON serializable"):
        thesis_model(SMALL, changed(), CLASSES, {"accuracy": np.float32(0.5)}).save(tmp_path / "m")
    assert os.listdir(tmp_path) == []


def test_what_is_no_model_file_lists_the_bundled_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert list(bundled_models()) == sorted(set(bundled_models()))
    assert load_model("digits").classes[3] == "3"
    os.mkfifo("fifo")
    Path("link").symlink_to("fifo")
    known = f"and no bundled model of that name (bundled: {', '.join(bundled_models())})"
    for name in ("nonsense", "", "no\0name", tmp_path, "fifo", "link", "/dev/zero", "/dev/null"):
        with pytest.raises(
            FileNotFoundError, match=f"^{re.escape(f'no model file {Path(name)}, {known}')}$"
        ):
            load_model(name)


SHAPES = {name: w.shape for name, w in small_model(config=WITH_REGRESSOR).weights.items()}


def assert_refused(message, path, weights, config=WITH_REGRESSOR):
    """Check that Model and `load_model` refuse a model with a message.

    `load_model` reads it from a damaged file. `message` is a regular expression.
    """
    with pytest.raises(ValueError, match=f"^{message}$"):
        thesis_model(config, weights, CLASSES)
    with np.errstate(over="ignore"):
        write_file(path, {name: np.asarray(w, np.float32) for name, w in weights.items()}, config)
    with pytest.raises(
        ValueError, match=f"^{re.escape(f'{path} holds a damaged model: ')}{message}$"
    ):
        load_model(path)


# beyond float32
@pytest.mark.parametrize("name, value", [*zip(SHAPES, itertools.cycle([np.nan, np.inf, -1e39]))])
def test_each_array_has_its_shape_and_is_finite(name, value, tmp_path):
    """An array with one side more, one axis more or less, or without numbers is refused.

    The layer itself refuses it, or the next layer, which reads the layer's output.
    """
    shape = SHAPES[name]
    path = tmp_path / "m"
    wrong = [(*shape[:k], shape[k] + 1, *shape[k + 1 :]) for k in range(len(shape))]
    for other in [*wrong, (*shape, 1), shape[:-1], (0, *shape[1:])]:
        message = r"layer '\w+' \((conv|dense)\): .*"
        if (name, other) == ("regressor.heatmap.weight", (2, 7, 1, 1)):
            message = (
                r"layer 'landmark' \(heatmap_centroid\): its input must be a heatmap \(1, H, W\), "
                r"got \(2, 6, 5\)"
            )
        assert_refused(message, path, changed(WITH_REGRESSOR, **{name: np.zeros(other)}))
    values = np.zeros(shape)
    values.flat[-1] = value
    assert_refused(
        f"`{name}` must be finite numbers", path, changed(WITH_REGRESSOR, **{name: values})
    )


def test_a_file_holds_float32(tmp_path):
    """Numbers of another precision are no model's of this package."""
    weights = changed(fc1__bias=np.zeros(4, np.float64))
    path = write_file(tmp_path / "m", weights)
    with pytest.raises(ValueError, match=r"`fc1\.bias` must be float32, got float64$"):
        load_model(path)


@pytest.mark.parametrize(
    ("sha256", "message"),
    [(None, "no sha256 in its metadata"), ("0" * 64, "its checksum differs; copy or download")],
)
def test_a_missing_checksum_is_told_from_a_wrong_one(sha256, message, tmp_path):
    path = write_file(tmp_path / "m", changed(), sha256=sha256)
    with pytest.raises(ValueError, match=f"m holds a damaged model: {message}"):
        load_model(path)


def test_exactly_the_arrays_of_the_network(tmp_path):
    """The arrays of a landmark network are needed where the landmark needs one, and only there."""
    path = tmp_path / "m"
    whole = changed(WITH_REGRESSOR)
    plain = changed(SMALL)
    one_less = r"layer 'fc2' \(dense\): no tensor is named 'fc2.bias'"
    assert_refused(one_less, path, changed(WITH_REGRESSOR, fc2__bias=None))
    assert_refused("no layer has the weights fc3.bias", path, whole | {"fc3.bias": np.zeros(1)})
    assert_refused(
        r"layer 'conv1' \(conv\): no tensor is named 'regressor.conv1.weight'", path, plain
    )
    for changes in ({"landmark": "window"}, {"transform": "none"}):
        config = WITH_REGRESSOR.replace(**changes)
        names = ", ".join(sorted(name for name in SHAPES if name.startswith("regressor.")))
        assert_refused(f"no layer has the weights {names}", path, whole, config)
    without_transform = small_model(config=WITH_REGRESSOR.replace(transform="none"))
    assert without_transform.weights.keys() == plain.keys()


@pytest.mark.parametrize(
    "changes, error, message",
    [
        (
            {"classes": ("a", "b")},
            ValueError,
            "the network must compute 2 logits, one for each class, or a map",
        ),
        ({"classes": ()}, ValueError, "`classes` must hold at least one name"),
        (
            {"classes": ("a", "b", "a")},
            ValueError,
            "`classes` must have different names, got ('a', 'b', 'a')",
        ),
        ({"classes": "abc"}, TypeError, "`classes` must be a tuple or list of names, got 'abc'"),
        ({"record": None}, TypeError, "`record` must be a mapping, got None"),
        ({"record": [("a", 1)]}, TypeError, "`record` must be a mapping, got [('a', 1)]"),
        (
            {"weights": changed(fc1__bias=np.zeros(4, bool))},
            TypeError,
            "`fc1.bias` must be an array of numbers, got bool",
        ),
        (
            {"weights": changed(fc1__bias=np.zeros(4, complex))},
            TypeError,
            "`fc1.bias` must be an array of numbers, ",
        ),
    ],
)
def test_wrong_classes_records_and_weights(changes, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        thesis_model(**{"config": SMALL, "weights": changed(), "classes": CLASSES, **changes})
