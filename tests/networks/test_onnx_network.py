"""OnnxClassifier: other programs' networks, wrong ones, threads, copies."""

import copy
import pickle
import re

import numpy as np
import pytest
from made import random_model
from networks.foreign import TensorProto, linear, network, node, onnx

from async_tnt import TNTConfig
from async_tnt.networks import OnnxClassifier, to_onnx

VOLUME = np.random.default_rng(1).normal(size=(2, 6, 5)).astype(np.float32)
POOL = [node("GlobalAveragePool", ["image"], ["scores"])]


@pytest.mark.parametrize("batch", [1, "batch"])
def test_a_foreign_network_of_one_volume_or_any_number(batch):
    net = OnnxClassifier(network(inputs=[("x:0", (batch, 2, 6, 5))], outputs=[("y", (batch, 3))]))
    assert (net.shape, net.n_classes, net.config, net.classes) == ((2, 6, 5), 3, None, None)
    logits = net(VOLUME)
    assert logits.shape == (3,) and logits.dtype == np.float32
    assert np.allclose(logits, linear(VOLUME), atol=1e-5)


def test_a_network_from_a_path_bytes_or_a_model_proto(tmp_path):
    content = network()
    (tmp_path / "net.onnx").write_bytes(content)
    sources = [str(tmp_path / "net.onnx"), tmp_path / "net.onnx", bytearray(content), onnx.ModelProto()]
    sources[-1].ParseFromString(content)
    for source in sources:
        assert np.allclose(OnnxClassifier(source)(VOLUME), linear(VOLUME), atol=1e-5)
    with pytest.raises(TypeError, match=r"`path_or_bytes` must be a path, bytes or an onnx\.ModelProto, got int"):
        OnnxClassifier(5)
    with pytest.raises(FileNotFoundError, match=r"^no file .*nothing\.onnx$"):
        OnnxClassifier(tmp_path / "nothing.onnx")
    with pytest.raises(ValueError, match=f"^{re.escape(str(tmp_path))} is not a readable ONNX network: "):
        OnnxClassifier(tmp_path)


def test_any_float_volume_will_do_and_answers_do_not_share_memory():
    net = OnnxClassifier(network())
    first = net(VOLUME)
    kept = first.copy()
    read_only = VOLUME.copy()
    read_only.flags.writeable = False
    for volume in (read_only, np.asfortranarray(VOLUME), VOLUME.astype(np.float64), np.repeat(VOLUME, 2, 2)[:, :, ::2]):
        before = volume.copy()
        assert np.array_equal(net(volume), kept) and np.array_equal(volume, before)
    assert not np.array_equal(net(2 * VOLUME), kept) and np.array_equal(first, kept)
    with pytest.raises(ValueError, match=r"^`volume` must have shape \(2, 6, 5\), got \(1, 2, 6, 5\)$"):
        net(VOLUME[None])


def test_sides_left_open_need_a_shape():
    content = network(POOL, inputs=[("image", (1, 2, "height", "width"))], outputs=[("scores", (1, 2, 1, 1))])
    net = OnnxClassifier(content, shape=(2, 6, 5))
    assert np.allclose(net(VOLUME), VOLUME.mean((1, 2)), atol=1e-6)
    assert np.array_equal(copy.deepcopy(net)(VOLUME), net(VOLUME))
    for shape, message in [
        (None, r"input \(1, 2, height, width\) leaves sides open: `shape` must be \(C, H, W\)"),
        ((3, 6, 5), r"`shape` must fit the network's input \(1, 2, height, width\), got \(3, 6, 5\)"),
        ((2, 1 << 20, 1 << 20), r"must have at most 268_435_456 cells"),
    ]:
        with pytest.raises(ValueError, match=message):
            OnnxClassifier(content, shape=shape)


RELU = [node("Relu", ["image"], ["scores"])]
TWO_INPUTS = [node("Flatten", ["a"], ["fa"]), node("Flatten", ["b"], ["fb"]), node("Add", ["fa", "fb"], ["scores"])]
TWO_OUTPUTS = [node("Relu", ["image"], ["one"]), node("Abs", ["image"], ["two"])]
MAPS = (1, 2, 6, 5)
WRONG = {
    "two inputs": (
        network(TWO_INPUTS, inputs=[("a", MAPS), ("b", MAPS)], outputs=[("scores", (1, 60))]),
        "must have one input, a volume, got 2: 'a' (1, 2, 6, 5), 'b' (1, 2, 6, 5)",
    ),
    "two outputs": (
        network(TWO_OUTPUTS, outputs=[("one", MAPS), ("two", MAPS)]),
        "must have one output, logits (1, n_classes), got 2: 'one' (1, 2, 6, 5), 'two' (1, 2, 6, 5)",
    ),
    "a batch of 8": (
        network(inputs=[("image", (8, 2, 6, 5))], outputs=[("scores", (8, 3))]),
        "must take one volume at a time, or any number, got input (8, 2, 6, 5)",
    ),
    "float64": (network(dtype=TensorProto.DOUBLE), "input must be tensor(float), as volumes are, got tensor(double)"),
    "a map": (
        network(RELU, outputs=[("scores", MAPS)]),
        "must give logits (1, n_classes) of a volume, got shape (1, 2, 6, 5)",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_network_that_is_not_a_classifier_of_volumes(what, tmp_path, capfd):
    content, message = WRONG[what]
    path = tmp_path / "{what} 100%.onnx"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: the network('s)? .*{re.escape(message)}"):
        OnnxClassifier(path)
    with pytest.raises(ValueError, match=r"^the ONNX network of [\d_]+ bytes: "):
        OnnxClassifier(content)
    assert capfd.readouterr() == ("", "")  # onnxruntime prints nothing by itself


def test_threads_reach_onnxruntime():
    options = OnnxClassifier(network(), threads=3)._session.get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (3, 3)
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"
    with pytest.raises(ValueError, match=r"^`threads` must be at least 1, got 0$"):
        OnnxClassifier(network(), threads=0)


def test_copies_and_pickles_open_the_network_again(tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(to_onnx(random_model(TNTConfig(bins=2), classes=3, widths=(2, 2, 2))).SerializeToString())
    for source in (path, path.read_bytes()):
        net = OnnxClassifier(source, threads=2)
        volume = np.random.default_rng(0).normal(size=net.shape).astype(np.float32)
        for duplicate in (copy.copy(net), copy.deepcopy(net), pickle.loads(pickle.dumps(net))):
            assert duplicate is not net and np.array_equal(duplicate(volume), net(volume))
            assert (duplicate.threads, duplicate.config, duplicate.classes) == (2, net.config, net.classes)
