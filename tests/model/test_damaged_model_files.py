"""A damaged or foreign file is refused in one line with its path; only a sound model loads."""

import json
import os
import re

import numpy as np
import pytest
import torch
from model.small import SMALL, assert_same, changed, small_model, write_file, write_format_1
from safetensors.numpy import save, save_file
from safetensors.torch import save_file as save_tensors

from async_tnt import CompiledClassifier, TNTConfig, load_model
from async_tnt.checked_tensors import read_tensors
from async_tnt.networks.layer_graph import layer_graph

FOREIGN = "is not a model that this release can read: `format` must be 'async_tnt 2' or 'async_tnt 1', got "


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
        (
            {"config": '{"colour": 1}'},
            "holds a damaged model: unknown configuration colour; known: bins, grid, "
            "landmark, polarity, remove_flow, sensor, t_max, transform, window_us",
        ),
        (
            {"config": '{"a\\nb": 1}'},
            "holds a damaged model: unknown configuration a b; known: bins, grid, "
            "landmark, polarity, remove_flow, sensor, t_max, transform, window_us",
        ),
        ({"config": "{}"}, "holds a damaged model: `conv1.weight` must have shape (2, 9, 3, 3) here, got (2, 2, 3, 3)"),
        ({"config": "nonsense"}, "holds a damaged model: Expecting value: line 1 column 1 (char 0)"),
        ({"classes": ""}, "holds a damaged model: Expecting value: line 1 column 1 (char 0)"),
        ({"classes": '["a", "b"]'}, "holds a damaged model: `fc2.weight` must have shape (2, 4) here, got (3, 4)"),
        ({"classes": '"abc"'}, "holds a damaged model: `classes` must be a tuple or list of names, got 'abc'"),
        ({"classes": "null"}, "holds a damaged model: `classes` must be a tuple or list of names, got None"),
        ({"record": "5"}, "holds a damaged model: `record` must be a mapping, got 5"),
        ({"network": None}, "holds a damaged model: no network in its metadata"),
        ({"network": "[]"}, "holds a damaged model: `network` must map names to lists of layers, got []"),
        ({"sha256": None}, "holds a damaged model: no sha256 in its metadata"),
        ({"sha256": 64 * "0"}, "holds a damaged model: its checksum differs; copy or download it again"),
        (
            {"format": "async_tnt 1"},
            "holds a damaged model: its `format` must be 'async_tnt 2', as it has a checksum, got 'async_tnt 1'",
        ),
        ({"format": None}, FOREIGN + "None"),
        ({"format": "async_tnt 3"}, FOREIGN + "'async_tnt 3'"),
        ({"format": "pt"}, FOREIGN + "'pt'"),
    ],
)
def test_wrong_metadata(tmp_path, changes, message):
    path = write_file(tmp_path / "m.st", changed(), **changes)
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))} {re.escape(message)}$"):
        load_model(path)


def test_metadata_nested_beyond_reason(tmp_path):
    write_file(tmp_path / "m", changed(), record="[" * 100_000)
    with pytest.raises(ValueError, match="m holds a damaged model: maximum recursion depth exceeded"):
        load_model(tmp_path / "m")


def test_files_of_something_else(tmp_path):
    foreign = re.escape(f"{tmp_path / 'f'} {FOREIGN}")
    save_file({"weight": np.zeros(3)}, tmp_path / "f")
    with pytest.raises(ValueError, match=foreign):
        load_model(tmp_path / "f")
    for dtype in (torch.bfloat16, torch.float8_e4m3fn, torch.complex64, torch.bool):  # some are unknown to NumPy
        save_tensors({"weight": torch.zeros(3, dtype=dtype)}, tmp_path / "f", {"format": "pt"})
        with pytest.raises(ValueError, match=foreign):
            load_model(tmp_path / "f")
    deep = (10**7).to_bytes(8, "little") + b"[" * 10**7
    for content in (b"", b"\0", b"PK\x03\x04 a zip", b"\x80\x02 a pickle", b"{}", b"\xff" * 100, b"\0" * 100, deep):
        (tmp_path / "f").write_bytes(content)
        with pytest.raises(
            ValueError, match=rf"^{re.escape(str(tmp_path / 'f'))} is not a readable \.safetensors file: "
        ):
            load_model(tmp_path / "f")


def test_of_another_programs_file_only_the_header_is_read(tmp_path):
    (tmp_path / "f").write_bytes(save({"weight": np.zeros(3)}, {"format": "pt"}))
    with open(tmp_path / "f", "rb") as file:
        with pytest.raises(ValueError, match=r"^`format` must be 'a', got 'pt'$"):
            read_tensors(file, ("a",))
        assert len(file.read()) == 24  # the weights


@pytest.mark.parametrize(
    ("dtype", "message"),
    [
        (torch.bfloat16, "m is not a readable .safetensors file: NumPy has no type BF16"),
        (torch.float64, "m holds a damaged model: `fc1.bias` must be float32, got float64"),
        (torch.int32, "m holds a damaged model: `fc1.bias` must be float32, got int32"),
    ],
)
def test_weights_of_another_type_in_a_file(tmp_path, dtype, message):
    _, metadata = header_and_tensors(write_format_1(tmp_path / "m", changed()).read_bytes())
    weights = {key: torch.from_numpy(values) for key, values in changed().items()}
    save_tensors({**weights, "fc1.bias": torch.zeros(4, dtype=dtype)}, tmp_path / "m", metadata)
    with pytest.raises(ValueError, match=f"{re.escape(message)}$"):
        load_model(tmp_path / "m")


def header_and_tensors(content):
    """The header without its metadata, the metadata, and all that follows."""
    n = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + n])
    metadata = header.pop("__metadata__")
    return (header, content[8 + n :]), metadata


def joined(header, metadata, tensors):
    text = json.dumps({"__metadata__": metadata, **header}).encode()
    return len(text).to_bytes(8, "little") + text + tensors


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A path with a strange name, and a good file's bytes."""
    path = tmp_path_factory.mktemp("damaged") / "a {model} 100%.safetensors"
    return path, small_model().save(path).read_bytes()


def refused_or_a_model(path, content=None):
    """The model in a file that may be damaged, or None if `load_model` refuses it as it should.

    content : written first.
    """
    if content is not None:
        path.write_bytes(content)
    try:
        model = load_model(path)
    except ValueError as error:
        message = str(error)
        assert message.startswith(f"{path} ") and len(message.splitlines()) == 1 and len(message) < 1200
        return None
    assert type(model.config) is TNTConfig
    assert isinstance(model.record, dict) and all(type(name) is str for name in model.classes)
    assert CompiledClassifier(model)(np.zeros(model.config.shape, np.float32)).shape == (len(model.classes),)
    return model


def test_a_file_cut_short_anywhere(place):
    path, content = place
    assert_same(refused_or_a_model(path, content), small_model())
    assert refused_or_a_model(path, content + b"\0") is None
    for length in range(len(content), -1, -1):
        os.truncate(path, length)
        assert (refused_or_a_model(path) is None) == (length < len(content))


def test_any_bit_of_any_byte_changed(place):
    path, content = place
    bits = np.random.default_rng(0).integers(0, 8, len(content))
    path.write_bytes(content)
    with open(path, "r+b", buffering=0) as file:
        for at, bit in enumerate(bits.tolist()):
            for value in (content[at] ^ 1 << bit, content[at]):
                file.seek(at)
                file.write(bytes([value]))
                assert (refused_or_a_model(path) is None) == (value != content[at]), f"bit {bit} of byte {at}"


def damaged_file(content, rng):
    """Other content under the old checksum: bytes, tensors or metadata changed in one of several ways."""
    (header, tensors), metadata = header_and_tensors(content)
    one, other = rng.choice(sorted(header), 2, replace=False)
    kind = rng.choice(["bits", "zeros", "swap", "rename", "dtype", "shape", "metadata", "drop", "add", "record"])
    if kind == "bits":
        damaged = bytearray(content)
        for at in rng.integers(0, len(content), rng.integers(1, 9)):
            damaged[at] ^= 1 << int(rng.integers(8))
        return bytes(damaged)
    if kind == "zeros":
        at = int(rng.integers(len(tensors) - 64))
        tensors = tensors[:at] + bytes(64) + tensors[at + 64 :]
    elif kind == "swap":
        header[one], header[other] = header[other], header[one]
    elif kind == "rename":
        header[one + rng.choice(["x", "\n", "é", " "])] = header.pop(one)
    elif kind == "dtype":
        header[one]["dtype"] = str(rng.choice(["I32", "U32"]))
    elif kind == "shape":
        header[one]["shape"] = [1, *header[one]["shape"]]
    else:
        name = str(rng.choice(sorted(metadata)))
        if kind == "metadata":
            at = int(rng.integers(len(metadata[name])))
            metadata[name] = metadata[name][:at] + chr(rng.integers(32, 127)) + metadata[name][at + 1 :]
        elif kind == "drop":
            del metadata[name]
        elif kind == "add":
            metadata["more"] = "x"
        else:
            metadata["record"] = '{"test": {"accuracy": 1.0}}'
    return joined(header, metadata, tensors)


def test_damage_after_the_checksum_was_written(place):
    path, content = place
    (header, tensors), metadata = header_and_tensors(content)
    assert_same(refused_or_a_model(path, joined(header, metadata, tensors)), small_model())
    rng, n_damaged = np.random.default_rng(1), 0
    while n_damaged < 1000:
        damaged = damaged_file(content, rng)
        if header_and_tensors_or_none(damaged) != ((header, tensors), metadata):
            assert refused_or_a_model(path, damaged) is None, damaged[:3000]
            n_damaged += 1


def header_and_tensors_or_none(content):
    try:
        return header_and_tensors(content)
    except (ValueError, KeyError, AttributeError):
        return None


def forged_json(rng, depth=0):
    """A value of any kind, as an enemy writes it."""
    kinds = [None, True, 0, -1, 2**31, 10**400, 1e400, -0.5, float("nan"), "a\nb", "window", "x" * 5000, [], {}]
    if depth < 2 and rng.random() < 0.4:
        parts = [forged_json(rng, depth + 1) for _ in range(rng.integers(4))]
        return parts if rng.random() < 0.5 else {f"k{k}": part for k, part in enumerate(parts)}
    return kinds[rng.integers(len(kinds))]


def forge(path, rng):
    """Write a file whose checksum is right and whose content is not."""
    weights, config, network = changed(), SMALL.to_dict(), layer_graph(SMALL)
    name = str(rng.choice(sorted(weights)))
    metadata = {}
    match rng.integers(9):
        case 0:
            shape = tuple(rng.integers(0, 4, rng.integers(6)).tolist())
            weights[name] = np.zeros(shape, np.float32)
        case 1:
            weights[name].flat[rng.integers(weights[name].size)] = rng.choice([np.nan, np.inf, -np.inf, 3e38])
        case 2:
            weights[name] = weights[name].astype(rng.choice(["f2", "f8", "i4", "i8", "u1", "?"]))
        case 3:
            weights[name + rng.choice(["", "\n", ".weight"])] = weights.pop(name)
        case 4:
            config[str(rng.choice([*config, "a\nb"]))] = forged_json(rng)
        case 5:
            metadata[str(rng.choice(["config", "classes", "record", "network"]))] = json.dumps(forged_json(rng))
        case 6:
            text = str(rng.choice(["[" * 100_000, '{"a":' * 100_000, "1" * 5000, "\0", "", "[1,]", "{"]))
            metadata[str(rng.choice(["config", "classes", "record", "network"]))] = text
        case 7:
            layers = network["classifier"]
            at = int(rng.integers(len(layers)))
            match rng.integers(4):
                case 0:
                    del layers[at]
                case 1:
                    layers.insert(at, layers[int(rng.integers(len(layers)))])
                case 2:
                    layers[at] = {**layers[at], str(rng.choice([*layers[at], "new"])): forged_json(rng)}
                case _:
                    layers[at] = forged_json(rng)
        case _:
            network[str(rng.choice(["classifier", "regressor", "a\nb"]))] = forged_json(rng)
    write_file(path, weights, **{"config": json.dumps(config), "network": json.dumps(network), **metadata})


def test_anything_under_a_valid_checksum(tmp_path):
    rng, n_models = np.random.default_rng(2), 0
    for _ in range(1000):
        forge(tmp_path / "m", rng)
        n_models += refused_or_a_model(tmp_path / "m") is not None
    assert 0 < n_models < 150  # such as a record of another kind
