"""A damaged .onnx file is refused by a ValueError with its path, or runs; nothing else, and silently."""

import json
import re

import numpy as np
import pytest
from engines.foreign import network, onnx
from hypothesis import given, settings
from hypothesis import strategies as st
from made import random_model, random_regressor_model

from async_tnt import TNTConfig
from async_tnt.networks.model import UncheckedModelWarning
from async_tnt.networks.onnx_export import regressor_to_onnx, to_onnx
from async_tnt.networks.onnx_metadata import seal
from async_tnt.networks.onnx_network import OnnxClassifier, OnnxRegressor

SMALL = TNTConfig(sensor=(9, 8), grid=(5, 6), bins=2)
LANDMARKED = random_regressor_model(SMALL, classes=3, widths=(2, 3, 4), regressor_widths=(2, 3, 2))
GOOD = {
    OnnxClassifier: to_onnx(random_model(SMALL, classes=3, widths=(2, 3, 4))).SerializeToString(),
    OnnxRegressor: regressor_to_onnx(LANDMARKED).SerializeToString(),
}
BOTH = pytest.mark.parametrize("kind", GOOD, ids=lambda kind: kind.__name__)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("damaged") / "a {net} 100%.onnx"


def refused(kind, path, content):
    """Whether the file is refused, in one line that names it; else it must run, and if damaged not claim to be ours."""
    path.write_bytes(content)
    try:
        opened = kind(path)
    except ValueError as error:
        assert str(path) in str(error) and "\n" not in str(error) and len(str(error)) < 700
        return True
    assert content == GOOD[kind] or opened.exported is None
    answer = opened(np.zeros(opened.shape, np.float32))
    assert len(answer) == (opened.n_classes if kind is OnnxClassifier else 2)
    return False


@BOTH
def test_a_file_cut_short_anywhere(kind, path, capfd):
    content = GOOD[kind]
    assert not refused(kind, path, content)
    whole = [length for length in range(len(content)) if not refused(kind, path, content[:length])]
    assert len(whole) < 3  # protobuf has no end mark: what is cut off before all metadata is another program's file
    assert capfd.readouterr() == ("", "")


@BOTH
def test_any_byte_changed(kind, path, capfd):
    content, rng = GOOD[kind], np.random.default_rng(0)
    n_refused = 0
    for at in range(len(content)):
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(rng.integers(8))
        n_refused += refused(kind, path, bytes(damaged))
    assert n_refused > len(content) - 60  # the others hit `format`, by which a file says that it is ours
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("content", [b"", b"\0", b"PK\x03\x04 a zip", b"\x80\x02 a pickle", b"{}", b"\xff" * 99])
def test_files_of_something_else(content, path):
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))} is not a readable ONNX network: "):
        OnnxClassifier(path)


EDITS = st.lists(
    st.tuples(
        st.floats(0, 1, exclude_max=True),
        st.sampled_from(["flip", "set", "cut", "insert", "double"]),
        st.integers(0, 255),
        st.integers(1, 40),
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=300, deadline=None)
@given(kind=st.sampled_from(list(GOOD)), edits=EDITS)
def test_files_damaged_in_any_way(kind, edits, path):
    damaged = bytearray(GOOD[kind])
    for place, how, value, length in edits:
        at = int(place * len(damaged))
        if how == "flip" and damaged:
            damaged[at] ^= 1 << value % 8
        elif how == "set" and damaged:
            damaged[at] = value
        elif how == "cut":
            del damaged[at : at + length]
        elif how == "insert":
            damaged[at:at] = bytes([value]) * length
        elif how == "double":
            damaged[at:at] = damaged[at : at + length]
    refused(kind, path, bytes(damaged))


def with_metadata(content, **changes):
    """Other metadata under a valid checksum; None leaves a name out."""
    made = onnx.ModelProto()
    made.ParseFromString(content)
    metadata = {entry.key: entry.value for entry in made.metadata_props} | changes
    del made.metadata_props[:]
    onnx.helper.set_model_props(made, {key: value for key, value in metadata.items() if value is not None})
    if metadata["sha256"] is not None:
        seal(made)
    return made.SerializeToString()


@pytest.mark.parametrize(
    "changes, message",
    [
        (
            {"format": "async_tnt 3"},
            "is damaged: metadata `format` must be 'async_tnt 2' or 'async_tnt 1', got 'async_tnt 3'",
        ),
        ({"sha256": None}, "is damaged: no sha256 in its metadata"),
        ({"config": '{"a\\nb": 1}'}, "is damaged: unknown configuration a b"),
        ({"config": None}, "is damaged: no config in its metadata"),
        ({"weights": None, "record": None}, "is damaged: no record and no weights in its metadata"),
        ({"network": "dog"}, "is damaged: metadata `network` must be classifier or regressor, got 'dog'"),
        ({"config": "{"}, "is damaged: Expecting property name"),
        ({"config": "[]"}, "is damaged: a configuration must be a mapping of names to values, got []"),
        ({"config": '{"bins": 0}'}, "is damaged: `bins` must be in [1, 1024], got 0"),
        ({"config": '{"colour": 1}'}, "is damaged: unknown configuration colour"),
        (
            {"config": "{}"},
            "is damaged: its configuration gives volumes of shape (9, 34, 34), its network takes (2, 6, 5)",
        ),
        ({"classes": '["a", "b"]'}, "is damaged: it names 2 classes, its network gives 3 logits"),
        ({"classes": '"abc"'}, "is damaged: metadata `classes` must be a list of names, got '\"abc\"'"),
        ({"classes": "[1, 2, 3]"}, "is damaged: metadata `classes` must be a list of names, got '[1, 2, 3]'"),
        ({"record": "5"}, "is damaged: metadata `record` must be a mapping, got '5'"),
        ({"record": "[" * 100_000}, "is damaged: maximum recursion depth exceeded"),
    ],
)
def test_wrong_metadata(changes, message, path):
    path.write_bytes(with_metadata(GOOD[OnnxClassifier], **changes))
    with pytest.raises(ValueError, match=f"^{re.escape(str(path) + ' ' + message)}"):
        OnnxClassifier(path)


def test_files_from_before_the_checksum_run_with_one_warning(path):
    path.write_bytes(with_metadata(GOOD[OnnxClassifier], format="async_tnt 1", sha256=None))
    with pytest.warns(UncheckedModelWarning, match=f"^{re.escape(str(path))} has no checksum") as caught:
        assert OnnxClassifier(path).config == SMALL
    assert len(caught) == 1 and caught[0].filename == __file__


@pytest.mark.parametrize("format", [None, "", "pt", "async_tnt"])
def test_metadata_of_other_people(format):
    net = OnnxClassifier(with_metadata(GOOD[OnnxClassifier], format=format))
    assert (net.config, net.classes, net.exported) == (None, None, None)
    foreign = OnnxClassifier(network(metadata={"config": "{}", "classes": json.dumps(["a"])}))
    assert foreign.config is None and foreign.classes is None


def test_one_network_for_the_other(path):
    path.write_bytes(GOOD[OnnxRegressor])
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))} holds a regressor, not a classifier: OnnxRegressor"):
        OnnxClassifier(path)
    two = to_onnx(random_model(SMALL, classes=2, widths=(2, 3, 4)))
    with pytest.raises(ValueError, match=r"^the ONNX network .* holds a classifier, not a regressor: OnnxClassifier"):
        OnnxRegressor(two)  # which otherwise looks like one: two numbers
