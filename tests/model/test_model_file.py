"""A model survives its file bit for bit; a damaged or foreign file is refused, and said to be so."""

import json
import os
import re
import threading
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made import random_model
from safetensors.numpy import load_file, save_file
from safetensors.torch import save_file as save_tensors

from async_tnt import CompiledClassifier, Model, TNTConfig, bundled_models, load_model
from async_tnt.model import FORMAT
from async_tnt.training.networks import network_of

SMALL = TNTConfig(sensor=(9, 8), grid=(5, 6), bins=2)
SHAPES = [  # configuration, classes, widths
    (TNTConfig(), 10, (16, 32, 64)),
    (TNTConfig(polarity="split"), 10, (16, 32, 64)),
    (SMALL, 3, (2, 3, 4)),
    (TNTConfig(sensor=(346, 260), grid=(4, 4), bins=1), 1, (1, 1, 1)),
    (TNTConfig(sensor=(346, 260), grid=(35, 7), polarity="split", bins=3, landmark="window"), 2, (5, 7, 130)),
    (TNTConfig(grid=(6, 31), landmark="line", remove_flow=True, t_max=2.0, polarity="unsigned"), 11, (20, 3, 1)),
    (TNTConfig(transform="none", window_us=1, grid=(17, 4)), 4, (9, 33, 6)),
]


def small_model(seed=0):
    return random_model(SMALL, classes=3, widths=(2, 3, 4), seed=seed)


def changed(**weights):
    """The small model's weights with some replaced, or left out (None)."""
    weights = {name.replace("__", "."): values for name, values in weights.items()}
    weights = {**small_model().weights, **weights}
    return {name: values for name, values in weights.items() if values is not None}


def assert_same(one, other):
    assert one.config == other.config
    assert one.classes == other.classes
    assert one.record == other.record
    assert one.weights.keys() == other.weights.keys()
    for name, values in one.weights.items():
        assert values.dtype == other.weights[name].dtype == np.float32
        assert values.shape == other.weights[name].shape
        assert values.tobytes() == other.weights[name].tobytes()


# -- there and back ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("config", "classes", "widths"), SHAPES)
def test_save_and_load(tmp_path, config, classes, widths):
    model = random_model(config, classes=classes, widths=widths)
    path = model.save(tmp_path / "some.safetensors")
    assert path == tmp_path / "some.safetensors"
    for came_back in (load_model(path), load_model(str(path))):
        assert_same(came_back, model)
    assert [p.name for p in tmp_path.iterdir()] == ["some.safetensors"]


@pytest.mark.parametrize(("config", "classes", "widths"), SHAPES)
def test_any_widths_and_grids_compute_what_torch_computes(tmp_path, config, classes, widths):
    model = load_model(random_model(config, classes=classes, widths=widths).save(tmp_path / "m"))
    volume = np.random.default_rng(0).normal(size=config.shape).astype(np.float32)
    with torch.no_grad():
        expected = network_of(model)(torch.from_numpy(volume)[None])[0].numpy()
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


def test_a_file_without_a_record_is_a_model(tmp_path):
    save_file(changed(), tmp_path / "m", {k: v for k, v in metadata().items() if k != "record"})
    assert load_model(tmp_path / "m").record == {}


@pytest.mark.parametrize("dtype", ["f2", "f8", ">f4", ">f8", "i4", "u1"])
def test_weights_of_other_types_become_float32(dtype):
    values = np.arange(4).astype(dtype)
    weights = Model(SMALL, changed(fc1__bias=values), ("a", "b", "c")).weights
    assert weights["fc1.bias"].dtype == np.float32
    np.testing.assert_array_equal(weights["fc1.bias"], [0, 1, 2, 3])


def test_weights_in_any_memory(tmp_path):
    weights = {name: np.asfortranarray(values) for name, values in changed().items()}
    weights["fc2.weight"] = np.repeat(weights["fc2.weight"], 2, axis=1)[:, ::2]
    weights["fc1.bias"].flags.writeable = False
    assert_same(load_model(Model(SMALL, weights, ("a", "b", "c")).save(tmp_path / "m")),
                Model(SMALL, changed(), ("a", "b", "c")))  # fmt: skip


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
        for k in range(60):
            models[k % 2].save(path)
        done.set()

    writer = threading.Thread(target=save_again_and_again)
    writer.start()
    n_read = 0
    while not done.is_set():
        assert load_model(path).weights["fc1.weight"].tobytes() in whole
        n_read += 1
    writer.join()
    assert n_read > 0


# -- not there -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nonsense", "digits.safetensors", "", "a/b/c", "no\0name", "DIGITS"])
def test_a_name_that_is_none_lists_the_bundled_ones(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = ", ".join(bundled_models())
    message = rf"^no model file {re.escape(str(Path(name)))}, and no bundled model of that name \(bundled: {names}\)$"
    with pytest.raises(FileNotFoundError, match=message):
        load_model(name)


def test_a_folder_is_no_model(tmp_path):
    with pytest.raises(FileNotFoundError, match="no model file"):
        load_model(tmp_path)


def test_bundled_names_are_sorted_and_load():
    assert list(bundled_models()) == sorted(set(bundled_models()))
    for name in bundled_models():
        assert isinstance(load_model(name), Model)
        assert not name.endswith(".safetensors")


# -- weights that fit neither each other nor the configuration -------------------------------------------------

ALL = "conv1.bias, conv1.weight, conv2.bias, conv2.weight, fc1.bias, fc1.weight, fc2.bias, fc2.weight"
WRONG = [
    ({"fc2__bias": None}, ValueError, f"`weights` must hold {ALL}, got {ALL.replace('fc2.bias, ', '')}"),
    ({"fc3__bias": np.zeros(1)}, ValueError, f"`weights` must hold {ALL}, got {ALL}, fc3.bias"),
    ({"conv1__weight": np.zeros((2, 3, 3, 3))}, ValueError,
     "`conv1.weight` must have shape (2, 2, 3, 3) here, got (2, 3, 3, 3)"),
    ({"conv1__weight": np.zeros((2, 2, 5, 5))}, ValueError,
     "`conv1.weight` must have shape (2, 2, 3, 3) here, got (2, 2, 5, 5)"),
    ({"conv1__weight": np.float32(1)}, ValueError, "`conv1.weight` must have shape (1, 2, 3, 3) here, got (1,)"),
    ({"conv1__bias": np.zeros(3)}, ValueError, "`conv1.bias` must have shape (2,) here, got (3,)"),
    ({"conv1__bias": np.zeros((2, 1))}, ValueError, "`conv1.bias` must have shape (2,) here, got (2, 1)"),
    ({"conv2__weight": np.zeros((3, 5, 3, 3))}, ValueError,
     "`conv2.weight` must have shape (3, 2, 3, 3) here, got (3, 5, 3, 3)"),
    ({"conv2__weight": np.zeros((3, 2, 3))}, ValueError,
     "`conv2.weight` must have shape (3, 2, 3, 3) here, got (3, 2, 3)"),
    ({"conv2__bias": np.zeros(2)}, ValueError, "`conv2.bias` must have shape (3,) here, got (2,)"),
    ({"fc1__weight": np.zeros((4, 4))}, ValueError, "`fc1.weight` must have shape (4, 3) here, got (4, 4)"),
    ({"fc1__bias": np.zeros(5)}, ValueError, "`fc1.bias` must have shape (4,) here, got (5,)"),
    ({"fc2__weight": np.zeros((4, 4))}, ValueError, "`fc2.weight` must have shape (3, 4) here, got (4, 4)"),
    ({"fc2__weight": np.zeros((3, 5))}, ValueError, "`fc2.weight` must have shape (3, 4) here, got (3, 5)"),
    ({"fc2__bias": np.zeros(4)}, ValueError, "`fc2.bias` must have shape (3,) here, got (4,)"),
    *[
        ({f"{layer}__bias": np.full(n, value)}, ValueError, f"`{layer}.weight` and its bias must be finite numbers")
        for layer, n in (("conv1", 2), ("conv2", 3), ("fc1", 4), ("fc2", 3))
        for value in (np.nan, np.inf, -np.inf, 1e39)  # beyond float32
    ],
    ({"conv2__weight": np.full((3, 2, 3, 3), np.nan)}, ValueError,
     "`conv2.weight` and its bias must be finite numbers"),
    ({"conv1__weight": np.zeros((0, 2, 3, 3))}, ValueError,
     "every layer must have at least one filter or unit, got widths (0, 3, 4)"),
    ({"fc1__weight": np.zeros((0, 3))}, ValueError,
     "every layer must have at least one filter or unit, got widths (2, 3, 0)"),
    ({"fc1__bias": np.zeros(4, complex)}, TypeError, "`fc1.bias` must be an array of numbers, got complex128"),
    ({"fc1__bias": np.array(["a"] * 4)}, TypeError, "`fc1.bias` must be an array of numbers, got <U1"),
    ({"fc1__bias": [None] * 4}, TypeError, "`fc1.bias` must be an array of numbers, got object"),
    ({"fc1__bias": np.zeros(4, bool)}, TypeError, "`fc1.bias` must be an array of numbers, got bool"),
]  # fmt: skip


@pytest.mark.parametrize(("weights", "error", "message"), WRONG)
def test_wrong_weights(weights, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Model(SMALL, changed(**weights), ("a", "b", "c"))


@pytest.mark.parametrize(("weights", "message"), [(weights, m) for weights, error, m in WRONG if error is ValueError])
def test_wrong_weights_in_a_file(tmp_path, weights, message):
    with np.errstate(over="ignore"):
        arrays = {name: np.asarray(values, np.float32) for name, values in changed(**weights).items()}
    save_file(arrays, tmp_path / "m", metadata())
    with pytest.raises(
        ValueError, match=f"^{re.escape(str(tmp_path / 'm'))} holds a damaged model: {re.escape(message)}$"
    ):
        load_model(tmp_path / "m")


@pytest.mark.parametrize(
    ("config", "classes", "record", "error", "message"),
    [
        (SMALL, ("a", "b"), {}, ValueError, "`fc2.weight` must have shape (2, 4) here, got (3, 4)"),
        (SMALL, (), {}, ValueError, "`classes` must hold at least one name"),
        (SMALL, "abc", {}, TypeError, "`classes` must be a tuple or list of names, got 'abc'"),
        (SMALL, None, {}, TypeError, "`classes` must be a tuple or list of names, got None"),
        (SMALL, {"a": 1, "b": 2, "c": 3}, {}, TypeError,
         "`classes` must be a tuple or list of names, got {'a': 1, 'b': 2, 'c': 3}"),
        (SMALL, ("a", "b", "c"), None, TypeError, "`record` must be a mapping, got None"),
        (SMALL, ("a", "b", "c"), [1], TypeError, "`record` must be a mapping, got [1]"),
        (SMALL.replace(bins=3), ("a", "b", "c"), {}, ValueError,
         "`conv1.weight` must have shape (2, 3, 3, 3) here, got (2, 2, 3, 3)"),
        (SMALL.replace(polarity="split"), ("a", "b", "c"), {}, ValueError,
         "`conv1.weight` must have shape (2, 4, 3, 3) here, got (2, 2, 3, 3)"),
        (SMALL.replace(grid=(8, 8)), ("a", "b", "c"), {}, ValueError,
         "`fc1.weight` must have shape (4, 12) here, got (4, 3)"),
        (SMALL.replace(grid=(3, 8)), ("a", "b", "c"), {}, ValueError,
         "`grid` must be at least (4, 4) for two 2x2 poolings, got (3, 8)"),
        (SMALL.replace(grid=(8, 2)), ("a", "b", "c"), {}, ValueError,
         "`grid` must be at least (4, 4) for two 2x2 poolings, got (8, 2)"),
    ],
)  # fmt: skip
def test_wrong_parts(config, classes, record, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Model(config, changed(), classes, record)


# -- damaged and foreign files -------------------------------------------------------------------------------


FOREIGN = f"is not a model of this package: metadata `format` must be {FORMAT!r}, got "


def metadata(**changes):
    values = {
        "format": FORMAT,
        "config": json.dumps(SMALL.to_dict()),
        "classes": '["a", "b", "c"]',
        "record": "{}",
        **changes,
    }
    return {name: value for name, value in values.items() if value is not None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config": None}, "holds a damaged model: no config in its metadata"),
        ({"config": None, "classes": None}, "holds a damaged model: no config and no classes in its metadata"),
        ({"config": "[]"}, "holds a damaged model: a configuration must be a mapping of names to values, got []"),
        ({"config": '{"bins": 0}'}, "holds a damaged model: `bins` must be in [1, 1024], got 0"),
        ({"config": '{"bins": 2.0}'}, "holds a damaged model: `bins` must be a whole number, got 2.0"),
        ({"config": '{"t_max": NaN}'}, "holds a damaged model: `t_max` must be in [1e-6, 1e6], got nan"),
        ({"config": '{"t_max": 1' + 400 * "0" + "}"}, "holds a damaged model: `t_max` must be in [1e-6, 1e6], got inf"),
        ({"config": '{"colour": 1}'}, "holds a damaged model: unknown configuration colour; known: bins, grid, "
         "landmark, polarity, remove_flow, sensor, t_max, transform, window_us"),
        ({"config": "{}"}, "holds a damaged model: `conv1.weight` must have shape (2, 9, 3, 3) here, got (2, 2, 3, 3)"),
        ({"config": "nonsense"}, "holds a damaged model: Expecting value: line 1 column 1 (char 0)"),
        ({"classes": ""}, "holds a damaged model: Expecting value: line 1 column 1 (char 0)"),
        ({"classes": '["a", "b"]'}, "holds a damaged model: `fc2.weight` must have shape (2, 4) here, got (3, 4)"),
        ({"classes": '"abc"'}, "holds a damaged model: `classes` must be a tuple or list of names, got 'abc'"),
        ({"classes": "null"}, "holds a damaged model: `classes` must be a tuple or list of names, got None"),
        ({"record": "5"}, "holds a damaged model: `record` must be a mapping, got 5"),
        ({"format": None}, FOREIGN + "None"),
        ({"format": "async_tnt 2"}, FOREIGN + "'async_tnt 2'"),
        ({"format": "pt"}, FOREIGN + "'pt'"),
    ],
)  # fmt: skip
def test_wrong_metadata(tmp_path, changes, message):
    save_file(changed(), tmp_path / "m.st", metadata(**changes))
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path / 'm.st'))} {re.escape(message)}$"):
        load_model(tmp_path / "m.st")


def test_metadata_nested_beyond_reason(tmp_path):
    save_file(changed(), tmp_path / "m", metadata(record="[" * 100_000))
    with pytest.raises(ValueError, match="m holds a damaged model: maximum recursion depth exceeded"):
        load_model(tmp_path / "m")


def test_files_of_something_else(tmp_path):
    foreign = f"{re.escape(str(tmp_path / 'f'))} is not a model of this package: metadata `format` must be"
    save_file({"weight": np.zeros(3)}, tmp_path / "f")
    with pytest.raises(ValueError, match=foreign):
        load_model(tmp_path / "f")
    for dtype in (torch.bfloat16, torch.float8_e4m3fn, torch.complex64, torch.bool):  # some are unknown to NumPy
        save_tensors({"weight": torch.zeros(3, dtype=dtype)}, tmp_path / "f", {"format": "pt"})
        with pytest.raises(ValueError, match=foreign):
            load_model(tmp_path / "f")
    for content in (b"", b"\0", b"PK\x03\x04 a zip", b"\x80\x02 a pickle", b"{}", b"\xff" * 100, b"\0" * 100):
        (tmp_path / "f").write_bytes(content)
        with pytest.raises(
            ValueError, match=rf"^{re.escape(str(tmp_path / 'f'))} is not a readable \.safetensors file: "
        ):
            load_model(tmp_path / "f")


@pytest.mark.parametrize(("dtype", "name"), [(torch.bfloat16, "BF16"), (torch.float64, "F64"), (torch.int32, "I32")])
def test_weights_of_another_type_in_a_file(tmp_path, dtype, name):
    weights = {key: torch.from_numpy(values) for key, values in changed().items()}
    save_tensors({**weights, "fc1.bias": torch.zeros(4, dtype=dtype)}, tmp_path / "m", metadata())
    with pytest.raises(ValueError, match=rf"m holds a damaged model: `fc1\.bias` must be F32, got {name}$"):
        load_model(tmp_path / "m")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A path with a strange name, and a good file's bytes."""
    path = tmp_path_factory.mktemp("damaged") / "a {model} 100%.safetensors"
    return path, small_model().save(path).read_bytes()


def refused_or_a_model(path):
    """The model in a file that may be damaged, or None if `load_model` refuses it as it should."""
    try:
        model = load_model(path)
    except ValueError as error:
        assert str(path) in str(error)
        return None
    assert type(model.config) is TNTConfig
    assert all(np.isfinite(values).all() for values in model.weights.values())
    assert len(model.classes) == len(model.weights["fc2.bias"])
    assert all(type(name) is str for name in model.classes)
    assert isinstance(model.record, dict)
    return model


def assert_refused_or_a_model(path, content):
    path.write_bytes(content)
    model = refused_or_a_model(path)
    if model is not None:
        assert_same(load_model(model.save(path)), model)


def test_a_file_cut_short_anywhere(place):
    path, content = place
    header = 8 + int.from_bytes(content[:8], "little")
    assert header > 500 and len(content) > header + 500
    path.write_bytes(content)
    assert_same(refused_or_a_model(path), small_model())
    for length in range(len(content) - 1, -1, -1):
        os.truncate(path, length)
        assert refused_or_a_model(path) is None
    path.write_bytes(content + b"\0")
    assert refused_or_a_model(path) is None


def with_bits_changed(path, content, places, rng):
    """What `load_model` makes of the file with one bit changed, for each of these places."""
    path.write_bytes(content)
    with open(path, "r+b", buffering=0) as file:
        for at in places:
            file.seek(at)
            file.write(bytes([content[at] ^ 1 << rng.integers(0, 8)]))
            yield refused_or_a_model(path)
            file.seek(at)
            file.write(content[at : at + 1])
    assert path.read_bytes() == content


def test_any_byte_of_the_header_changed(place):
    path, content = place
    header = 8 + int.from_bytes(content[:8], "little")
    models = list(with_bits_changed(path, content, range(header), np.random.default_rng(0)))
    assert models.count(None) > header / 2
    for model in models:  # names, the record and numbers of the configuration can change unnoticed, shapes cannot
        assert model is None or model.config.shape == SMALL.shape


def test_any_byte_of_the_weights_changed(place):
    path, content = place
    header = 8 + int.from_bytes(content[:8], "little")
    for model in with_bits_changed(path, content, range(header, len(content)), np.random.default_rng(1)):
        assert model is None or (model.config, model.classes) == (SMALL, small_model().classes)
    path.write_bytes(content[:-4] + np.float32("nan").tobytes())
    assert refused_or_a_model(path) is None


EDITS = st.lists(
    st.tuples(
        st.floats(0, 1, exclude_max=True),
        st.sampled_from(["flip", "set", "cut", "insert", "double"]),
        st.integers(0, 255),
        st.integers(1, 40),
        st.booleans(),
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=300, deadline=None)
@given(edits=EDITS)
def test_files_damaged_in_any_way(place, edits):
    path, content = place
    header = 8 + int.from_bytes(content[:8], "little")
    damaged = bytearray(content)
    for place_in_file, how, value, length, in_header in edits:
        at = int(place_in_file * (min(header, len(damaged)) if in_header else len(damaged)))
        if how == "flip" and at < len(damaged):
            damaged[at] ^= 1 << value % 8
        elif how == "set" and at < len(damaged):
            damaged[at] = value
        elif how == "cut":
            del damaged[at : at + length]
        elif how == "insert":
            damaged[at:at] = bytes([value]) * length
        elif how == "double":
            damaged[at:at] = damaged[at : at + length]
    assert_refused_or_a_model(path, bytes(damaged))


def header_of(content):
    n = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + n]), content[8 + n :]


@settings(max_examples=200, deadline=None)
@given(
    name=st.sampled_from(["format", "config", "classes", "record"]),
    value=st.one_of(
        st.text(max_size=12),
        st.recursive(
            st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3)),
            lambda parts: st.one_of(
                st.lists(parts, max_size=3),
                st.dictionaries(st.sampled_from(["bins", "grid", "sensor", "t_max", "landmark"]), parts, max_size=3),
            ),
            max_leaves=4,
        ).map(json.dumps),
    ),
)
def test_any_metadata_in_a_sound_file(place, name, value):
    path, content = place
    header, tensors = header_of(content)
    header["__metadata__"][name] = value
    written = json.dumps(header).encode()
    assert_refused_or_a_model(path, len(written).to_bytes(8, "little") + written + tensors)


def test_the_file_is_plain_safetensors(place):
    path, content = place
    path.write_bytes(content)
    model = small_model()
    arrays = load_file(path)
    assert arrays.keys() == model.weights.keys()
    assert all(arrays[name].tobytes() == values.tobytes() for name, values in model.weights.items())
    header, _ = header_of(content)
    assert json.loads(header["__metadata__"]["config"]) == SMALL.to_dict()
    assert json.loads(header["__metadata__"]["classes"]) == list(model.classes)
    assert json.loads(header["__metadata__"]["record"]) == {"made": True}
