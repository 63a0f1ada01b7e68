"""A damaged or foreign file is refused with its path in the message, or is a sound model; nothing else."""

import json
import os
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from model.small import SMALL, assert_same, changed, metadata, small_model
from safetensors.numpy import save_file
from safetensors.torch import save_file as save_tensors

from async_tnt import TNTConfig, load_model
from async_tnt.model import FORMAT

FOREIGN = f"is not a model of this package: metadata `format` must be {FORMAT!r}, got "


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


def header_and_tensors(content):
    n = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + n]), content[8 + n :]


def with_header(header, tensors):
    text = json.dumps(header, sort_keys=True).encode()
    return len(text).to_bytes(8, "little") + text + tensors


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A path with a strange name, and a good file's bytes: the same in every run, as safetensors' are not."""
    path = tmp_path_factory.mktemp("damaged") / "a {model} 100%.safetensors"
    return path, with_header(*header_and_tensors(small_model().save(path).read_bytes()))


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
    for model in models:  # names and numbers can change unnoticed, what the weights' shapes depend on cannot
        assert model is None or model.config.channels == SMALL.channels


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
    header, tensors = header_and_tensors(content)
    header["__metadata__"][name] = value
    assert_refused_or_a_model(path, with_header(header, tensors))
