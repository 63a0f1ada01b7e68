"""OnnxClassifier and TorchClassifier.

They run networks of other programs, refuse wrong ones, and work in threads and in copies.
"""

import copy
import pickle
import re

import numpy as np
import pytest
import torch
from made import random_events, random_model
from networks.foreign import WEIGHTS, TensorProto, linear, network, node, onnx

from async_tnt import Processor, TNTConfig
from async_tnt.networks import OnnxClassifier, TorchClassifier, to_onnx

VOLUME = np.random.default_rng(1).normal(size=(2, 6, 5)).astype(np.float32)
CONFIG = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=2, window_us=1000, landmark="center", t_max=1.0)
LINEAR = torch.nn.Linear(60, 3)
LINEAR.load_state_dict({"weight": torch.tensor(WEIGHTS["w"].T), "bias": torch.tensor(WEIGHTS["b"])})
MODULE = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Dropout(0.5), LINEAR).eval()


@pytest.fixture(autouse=True)
def _one_thread():
    yield
    torch.set_num_threads(1)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_any_form_of_a_network_takes_any_float_volume_and_its_answers_share_no_memory(tmp_path):
    content = network()
    path = tmp_path / "net.onnx"
    proto = onnx.ModelProto()
    path.write_bytes(content)
    proto.ParseFromString(content)
    of_any_batch = network(inputs=[("x:0", ("batch", 2, 6, 5))], outputs=[("y", ("batch", 3))])
    example = torch.zeros(1, 2, 6, 5)
    program = torch.export.export(MODULE, (example,))
    scripted = torch.jit.trace(MODULE, example)
    modules = (
        MODULE,
        scripted,
        program,
        program.module(),
        copy.deepcopy(MODULE).double(),
        lambda v: MODULE(v)[0],
    )
    read_only = VOLUME.copy()
    read_only.flags.writeable = False
    strided = np.repeat(VOLUME, 2, 2)[:, :, ::2]
    for net in (
        *map(OnnxClassifier, (content, bytearray(content), path, str(path), proto, of_any_batch)),
        *map(TorchClassifier, modules),
    ):
        first = net(VOLUME)
        kept = first.copy()
        assert type(first) is np.ndarray and first.dtype == np.float32 and first.shape == (3,)
        assert np.allclose(first, linear(VOLUME), atol=1e-5)
        for volume in (read_only, np.asfortranarray(VOLUME), VOLUME.astype(np.float64), strided):
            assert np.array_equal(net(volume), kept) and np.array_equal(volume, VOLUME)
        assert not np.array_equal(net(2 * VOLUME), kept) and np.array_equal(first, kept)


class Scaled(torch.nn.Module):
    """Without parameters: a counter, and the numbers that it scales by, as buffers."""

    def __init__(self, dtype):
        super().__init__()
        self.register_buffer("n_calls", torch.tensor(0))
        self.register_buffer("scale", torch.full((), 2.0, dtype=dtype))

    def forward(self, volume):
        self.kept = self.scale * volume.flatten(1)[:, :3]
        self.types = (volume.dtype, self.kept.dtype)
        return self.kept


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_volume_has_the_type_of_the_first_floating_numbers_of_a_module(dtype):
    module = Scaled(dtype)
    found = TorchClassifier(module)(VOLUME)
    assert module.types == (dtype, dtype)
    np.testing.assert_allclose(found, 2 * VOLUME.ravel()[:3])
    assert TorchClassifier(lambda v: v.flatten(1)[:, :3])(VOLUME).dtype == np.float32


def test_an_answer_is_not_the_tensor_that_a_module_keeps():
    module = Scaled(torch.float32)
    classifier = TorchClassifier(module)
    first = classifier(VOLUME)
    kept = first.copy()
    with torch.inference_mode():
        module.kept.zero_()
    np.testing.assert_array_equal(first, kept)
    first[:] = 1
    np.testing.assert_array_equal(module.kept.numpy(), np.zeros((1, 3)))


def test_threads_are_left_as_they_are_if_nothing_is_said():
    torch.set_num_threads(2)
    TorchClassifier(MODULE, threads=None)
    assert torch.get_num_threads() == 2
    TorchClassifier(MODULE)
    assert torch.get_num_threads() == 1


def test_sides_left_open_need_a_shape():
    pool = [node("GlobalAveragePool", ["image"], ["scores"])]
    content = network(
        pool, inputs=[("image", (1, 2, "height", "width"))], outputs=[("scores", (1, 2, 1, 1))]
    )
    net = OnnxClassifier(content, shape=(2, 6, 5))
    assert np.allclose(net(VOLUME), VOLUME.mean((1, 2)), atol=1e-6)
    assert np.array_equal(copy.deepcopy(net)(VOLUME), net(VOLUME))
    for shape, message in [
        (None, r"input \(1, 2, height, width\) leaves sides open: `shape` must be \(C, H, W\)"),
        (
            (3, 6, 5),
            r"`shape` must fit the network's input \(1, 2, height, width\), got \(3, 6, 5\)",
        ),
        ((6, 5), r"`shape` must be \(C, H, W\), got \(6, 5\)"),
        ((2, 0, 5), r"`shape` must be at least 1, got 0"),
        ((2, 1 << 20, 1 << 20), r"must have at most 268_435_456 cells"),
        ((2, 1 << 14, (1 << 13) + 1), r"must have at most 268_435_456 cells"),  # of both channels
    ]:
        with pytest.raises(ValueError, match=message):
            OnnxClassifier(content, shape=shape)


MAPS = (1, 2, 6, 5)
TWO_INPUTS = [
    node("Flatten", ["a"], ["fa"]),
    node("Flatten", ["b"], ["fb"]),
    node("Add", ["fa", "fb"], ["scores"]),
]
TWO_OUTPUTS = [node("Relu", ["image"], ["one"]), node("Abs", ["image"], ["two"])]
WRONG = [
    (
        network(TWO_INPUTS, inputs=[("a", MAPS), ("b", MAPS)], outputs=[("scores", (1, 60))]),
        "must have one input, a volume, tensor(float) of shape (1, C, H, W), or of any number of "
        "them; "
        "got 'a' tensor(float) (1, 2, 6, 5), 'b' tensor(float) (1, 2, 6, 5)",
    ),
    (
        network(TWO_OUTPUTS, outputs=[("one", MAPS), ("two", MAPS)]),
        "must have one output, logits (1, n_classes), or a map (1, n_classes + n, R, C) with n of "
        "1, 3 or 5, "
        "tensor(float); got 'one' "
        "tensor(float) (1, 2, 6, 5), 'two' ",
    ),
    (network(dtype=TensorProto.DOUBLE), "got 'image' tensor(double) (1, 2, 6, 5)"),
    (
        network(
            [
                node("Flatten", ["image"], ["flat"]),
                node("Cast", ["flat"], ["scores"], to=TensorProto.DOUBLE),
            ],
            outputs=[("scores", (1, 60))],
            output_dtype=TensorProto.DOUBLE,
        ),
        "must have one output, logits (1, n_classes), or a map (1, n_classes + n, R, C) with n of "
        "1, 3 or 5, "
        "tensor(float); got 'scores' tensor(double) (1, 60)",
    ),
    (
        network(inputs=[("image", (2, 2, 6, 5))], outputs=[("scores", (2, 3))]),
        "must have one input, a volume, tensor(float) of shape (1, C, H, W), or of any number of "
        "them; got 'image' tensor(float) (2, 2, 6, 5)",
    ),
    (
        network(
            [node("Transpose", ["image"], ["scores"], perm=[1, 0, 2, 3])],
            outputs=[("scores", (2, 1, 6, 5))],
        ),
        "must give logits (1, n_classes), or a map (1, n_classes + n, R, C) with n of "
        "1, 3 or 5, of a volume, got "
        "shape (2, 1, 6, 5)",
    ),
]


@pytest.mark.parametrize(
    "content, message",
    WRONG,
    ids=["two inputs", "two outputs", "float64", "float64 logits", "a batch of two", "two maps"],
)
def test_a_network_that_is_not_a_classifier_of_volumes(content, message, tmp_path, capfd):
    path = tmp_path / "{what} 100%.onnx"
    path.write_bytes(content)
    with pytest.raises(
        ValueError, match=rf"^{re.escape(str(path))}: the network('s)? .*{re.escape(message)}"
    ):
        OnnxClassifier(path)
    with pytest.raises(ValueError, match=r"^the ONNX network of [\d_]+ bytes: "):
        OnnxClassifier(content)
    assert capfd.readouterr() == ("", "")  # onnxruntime prints nothing by itself


@pytest.mark.parametrize(
    "call, error, message",
    [
        (
            lambda: OnnxClassifier(5),
            TypeError,
            "`path_or_bytes` must be a path, bytes or an onnx.ModelProto, got int",
        ),
        (lambda: OnnxClassifier("no.onnx"), FileNotFoundError, "no file no.onnx"),
        (lambda: OnnxClassifier("."), ValueError, ". is not a readable ONNX network: "),
        (
            lambda: OnnxClassifier(network())(VOLUME[None]),
            ValueError,
            "`volume` must have shape (2, 6, 5), got (1, 2",
        ),
        (
            lambda: OnnxClassifier(network(), threads=0),
            ValueError,
            "`threads` must be at least 1, got 0",
        ),
        (
            lambda: TorchClassifier(len, threads=0),
            ValueError,
            "`threads` must be at least 1, got 0",
        ),
        (lambda: TorchClassifier(5), TypeError, "`module` must be callable, got int"),
        (
            lambda: TorchClassifier(lambda v: v[None])(VOLUME),
            ValueError,
            "the module must return logits (1, n_classes), or a map (1, n_classes + n, R, C) with "
            "n of 1, 3 or 5, got "
            "shape (1, 1, 2,",
        ),
        (
            lambda: TorchClassifier(lambda v: (v, 1))(VOLUME),
            TypeError,
            "the module must return a tensor of logits, ",
        ),
    ],
)
def test_what_is_no_network_no_volume_and_no_logits(call, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        call()


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((), (1,)),
        ((1,), (1,)),
        ((3,), (3,)),
        ((1, 3), (3,)),
        ((1, 3, 1, 1), (3,)),
        ((1, 1, 3), (3,)),
        ((2, 5, 4), (2, 5, 4)),
        ((1, 2, 5, 4), (2, 5, 4)),
        # no numbers, several volumes, a map without a channel for nothing
        ((0,), None),
        ((1, 0), None),
        ((2, 3), None),
        ((2, 3, 5, 4), None),
        ((1, 5, 4), None),
        ((1, 1, 5, 4), None),
        ((1, 1, 2, 5, 4), None),
    ],
)
def test_the_shape_in_which_an_answer_is_read(shape, expected):
    classifier = TorchClassifier(lambda volume: torch.zeros(shape))
    if expected is not None:
        assert classifier(VOLUME).shape == expected
        return
    with pytest.raises(
        ValueError, match=rf"^the module must .*, got shape {re.escape(str(shape))}"
    ):
        classifier(VOLUME)


def test_copies_and_pickles_open_the_network_again(tmp_path):
    path = tmp_path / "net.onnx"
    path.write_bytes(to_onnx(random_model(CONFIG, classes=3, widths=(2, 2, 2))).SerializeToString())
    for source in (path, path.read_bytes()):
        net = OnnxClassifier(source, threads=2)
        for duplicate in (copy.copy(net), copy.deepcopy(net), pickle.loads(pickle.dumps(net))):
            assert duplicate is not net and np.array_equal(duplicate(VOLUME), net(VOLUME))
            assert (duplicate.threads, duplicate.config, duplicate.classes) == (
                2,
                net.config,
                net.classes,
            )


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_bare_module_as_a_classifier_says_how_it_is_passed():
    for bare in (MODULE, torch.jit.trace(MODULE, torch.zeros(1, 2, 6, 5))):
        message = r"a torch module is wrapped, TorchClassifier\(module\), or compiled"
        with pytest.raises(TypeError, match=message) as raised:
            Processor(CONFIG, classifier=bare).fire()
        assert raised.value.__cause__ is not None and "\n" not in str(raised.value)


def test_a_module_runs_in_eval_and_inference_mode_on_a_volume_of_its_own():
    """The module may work in place, and may keep its input."""
    seen = []
    kept = []

    class Greedy(torch.nn.Module):
        def forward(self, volume):
            seen.append(
                (
                    self.training,
                    torch.is_inference_mode_enabled(),
                    tuple(volume.shape),
                    volume.dtype,
                )
            )
            kept.append(volume)
            return volume.mul_(-1).flatten(1)[:, :3]

    module = torch.nn.Sequential(Greedy(), torch.nn.Dropout(0.9)).train()
    processor = Processor(CONFIG, classifier=TorchClassifier(module))
    assert copy.copy(processor).classifier is not processor.classifier
    for start_us in (0, 90):
        processor.push(
            random_events(300, seed=start_us, sensor=(5, 6), duration_us=900, start_us=start_us)
        )
        before = processor.volume().copy()
        assert np.array_equal(processor.fire().logits, -before.ravel()[:3])
        assert before.any() and np.array_equal(processor.volume(), before)
        assert torch.equal(kept[-1][0], torch.tensor(-before))
    assert seen == [(False, True, (1, 2, 6, 5), torch.float32)] * 2 and not module.training
    assert not torch.equal(*kept) and not torch.is_inference_mode_enabled()
