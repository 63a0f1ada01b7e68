"""A damaged or foreign model file, of ours or of ONNX, is refused in one line with its path.

Only a sound file loads.
"""

import json
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from made import thesis_network
from networks.foreign import network, onnx
from networks.small import SMALL, changed, small_model, write_file
from safetensors.torch import save_file as save_tensors

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.models.model import FORMAT
from async_tnt.networks.onnx.metadata import seal

ONNX = to_onnx(small_model()).SerializeToString()
READERS = (load_model, OnnxClassifier)
STEP = 17  # bytes from one damage to the next
of_all = pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A path with a strange name, and a sound file's bytes for each reader."""
    path = tmp_path_factory.mktemp("damaged") / "a {model} 100%.file"
    content = small_model().save(path).read_bytes()
    return path, {load_model: content, OnnxClassifier: ONNX}


def refused(reader, path, content=None):
    """Whether a reader refuses a file, in one line that names it; what it opens instead must run.

    content : written first. ONNX files carry no mark at their end, and damage to `format` in their
        metadata makes them files of another program: that is fine as long as they do not claim to
        be ours.
    """
    if content is not None:
        path.write_bytes(content)
    try:
        opened = reader(path)
    except ValueError as error:
        message = str(error)
        assert message.startswith(str(path)) and "\n" not in message and len(message) < 1200
        return True
    if isinstance(opened, Model):
        assert type(opened.config) is TNTConfig and isinstance(opened.record, dict)
        logits = CompiledClassifier(opened)(np.zeros(opened.config.shape, np.float32))
        assert len(logits) == len(opened.classes)
        assert all(type(name) is str for name in opened.classes)
    else:
        assert content == ONNX or opened.exported is None
        assert len(opened(np.zeros(opened.shape, np.float32))) == opened.n_classes
    return False


@of_all
def test_a_file_cut_short_or_changed_anywhere(reader, files, capfd):
    """Hardly any damage to an ONNX file makes it one of another program, none to a model."""
    path = files[0]
    content = files[1][reader]
    assert not refused(reader, path, content)
    places = range(0, len(content), STEP)
    damaged = [content[:at] for at in places]
    damaged += [
        content[:at] + bytes([content[at] ^ 1 << at % 8]) + content[at + 1 :] for at in places
    ]
    opened = sum(not refused(reader, path, other) for other in damaged)
    assert opened < (1 if reader is load_model else 8)
    assert capfd.readouterr() == ("", "")


# -- model files: what the checksum covers, and what is checked under it ---------------------------


json_values = st.recursive(
    st.sampled_from(
        [None, True, 0, -1, 2**31, 10**400, 1e400, -0.5, float("nan"), "a\nb", "window", "x" * 5000]
    ),
    lambda values: (
        st.lists(values, max_size=3)
        | st.dictionaries(st.sampled_from(["a", "b\n"]), values, max_size=3)
    ),
    max_leaves=5,
)
broken_json = st.sampled_from(["[" * 100_000, '{"a":' * 100_000, "1" * 5000, "\0", "", "[1,]", "{"])


@settings(max_examples=100)
@given(st.data())
def test_anything_under_a_valid_checksum(files, data):
    config = SMALL.to_dict()
    graph = thesis_network(SMALL)
    metadata = {}
    layers = graph["classifier"]
    place = data.draw(st.sampled_from(["config", "layer", "parameter", "network", "text"]))
    value = data.draw(json_values)
    if place == "config":
        config[data.draw(st.sampled_from([*config, "a\nb"]))] = value
    elif place == "layer":
        layers[data.draw(st.integers(0, len(layers) - 1))] = value
    elif place == "parameter":
        layer = data.draw(st.sampled_from(layers))
        layer[data.draw(st.sampled_from([*layer, "new"]))] = value
    elif place == "network":
        graph[data.draw(st.sampled_from(["classifier", "regressor", "a\nb"]))] = value
    else:
        name = data.draw(st.sampled_from(["config", "classes", "record", "network"]))
        metadata[name] = data.draw(broken_json | json_values.map(json.dumps))
    write_file(
        files[0],
        changed(),
        **{"config": json.dumps(config), "network": json.dumps(graph), **metadata},
    )
    refused(load_model, files[0])


DAMAGED = "holds a damaged model: "
FORMATS = "`format` must be 'async_tnt 2' or 'async_tnt 3'"
FOREIGN = (
    f"is not a model that this release can read: {FORMATS} or 'async_tnt 4' or 'async_tnt 5', got "
)


def model_file(path, **changes):
    return write_file(path, changed(), **changes)


def onnx_file(path, **changes):
    """The small classifier with other metadata under a valid checksum; None leaves a name out."""
    made = onnx.ModelProto()
    made.ParseFromString(ONNX)
    metadata = {entry.key: entry.value for entry in made.metadata_props} | changes
    del made.metadata_props[:]
    onnx.helper.set_model_props(
        made, {key: value for key, value in metadata.items() if value is not None}
    )
    if metadata["sha256"] is not None:
        seal(made)
    path.write_bytes(made.SerializeToString())
    return path


@pytest.mark.parametrize(
    "write, changes, message",
    [
        (
            model_file,
            {"config": None, "classes": None},
            DAMAGED + "no config and no classes in its metadata",
        ),
        (
            model_file,
            {"config": "{}"},
            DAMAGED + "layer 'conv1' (conv): its weight must have shape (2, 9, 3, 3) here",
        ),
        (
            model_file,
            {"sha256": 64 * "0"},
            DAMAGED + "its checksum differs; copy or download it again",
        ),
        (model_file, {"format": "async_tnt 6"}, FOREIGN + "'async_tnt 6'"),
        (
            onnx_file,
            {"format": "async_tnt 4"},
            f"is damaged: metadata {FORMATS}, got 'async_tnt 4",
        ),
        (onnx_file, {"sha256": None}, "is damaged: no sha256 in its metadata"),
        (onnx_file, {"config": '{"a\\nb": 1}'}, "is damaged: unknown configuration a b"),
        (
            onnx_file,
            {"config": "{}"},
            "is damaged: its configuration gives volumes of shape (9, 34, 34), its netw",
        ),
        (
            onnx_file,
            {"classes": "[1, 2, 3]"},
            "is damaged: metadata `classes` must be a list of names, got '[1, 2",
        ),
        (onnx_file, {"record": "3"}, "is damaged: metadata `record` must be a mapping, got '3'"),
        (
            onnx_file,
            {"network": "{}"},
            "is damaged: metadata `network` must be a list of layers, got '{}'",
        ),
        (
            onnx_file,
            {"outputs": "[1]"},
            "is damaged: metadata `outputs` must map names to layers, got '[1]'",
        ),
        (
            onnx_file,
            {"classes": '["a", "b"]'},
            "is damaged: it names 2 classes, its network gives 3 logits",
        ),
    ],
)
def test_wrong_metadata(write, changes, message, files):
    path = write(files[0], **changes)
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} {message}')}"):
        (load_model if write is model_file else OnnxClassifier)(path)


@pytest.mark.parametrize(
    "layers, message",
    [
        (
            [{"op": "mish", "name": "a", "inputs": ["volume"]}],
            "holds a network that this release cannot run: layer 'a' is a 'mish'",
        ),
        ([{"op": "relu", "name": "a", "inputs": ["b"]}], DAMAGED + "layer 'a' (relu): "),
        ([1], DAMAGED),
    ],
    ids=["unknown", "unfit", "no layer"],
)
def test_wrong_layers_in_an_onnx_file(layers, message, tmp_path):
    path = onnx_file(tmp_path / "m.onnx", network=json.dumps(layers))
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} {message}')}"):
        load_model(path)


def test_files_of_other_programs_and_types(tmp_path):
    path = tmp_path / "f"
    path.write_bytes(b"PK a zip")
    for reader, message in ((load_model, ".safetensors file"), (OnnxClassifier, "ONNX network")):
        with pytest.raises(ValueError, match=f"^{path} is not a readable {message}: "):
            reader(path)
    # unknown to NumPy or to safetensors
    for dtype in (torch.bfloat16, torch.float8_e4m3fn, torch.complex64):
        save_tensors({"weight": torch.zeros(3, dtype=dtype)}, path, {"format": "pt"})
        with pytest.raises(ValueError, match=re.escape(f"{path} {FOREIGN}'pt'")):
            load_model(path)
    save_tensors({"fc1.bias": torch.zeros(4, dtype=torch.bfloat16)}, path, {"format": FORMAT})
    with pytest.raises(
        ValueError, match=r"f (is not a readable .safetensors file|holds a damaged model): "
    ):
        load_model(path)
    write_file(path, changed(fc1__bias=np.zeros(4, "int32")))
    with pytest.raises(
        ValueError, match=r"f holds a damaged model: `fc1.bias` must be float32, got int32$"
    ):
        load_model(path)


def test_onnx_files_of_other_programs_have_no_configuration(files):
    files[0].write_bytes(network(metadata={"config": "{}", "classes": json.dumps(["a"])}))
    for path in (
        files[0],
        *(onnx_file(files[0], format=format) for format in (None, "", "pt", "async_tnt")),
    ):
        net = OnnxClassifier(path)
        assert (net.config, net.classes, net.exported) == (None, None, None)
