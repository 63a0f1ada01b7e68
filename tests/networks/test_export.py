"""to_onnx, and the command `async-tnt export`."""

import json
import os
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from made import random_model, random_regressor_model
from networks.foreign import onnx
from torch import nn

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.base.package import __version__
from async_tnt.networks import to_onnx
from async_tnt.networks.layers import conversion_check
from async_tnt.networks.layers.conversion_check import compare
from async_tnt.networks.onnx import export as onnx_export


def test_what_an_onnx_file_cannot_hold_is_refused(monkeypatch):
    named = json.loads(json.dumps(random_model().network).replace("fc2.bias", "logits"))
    weights = {name.replace("fc2.bias", "logits"): w for name, w in random_model().weights.items()}
    with pytest.raises(ValueError, match="a weight is named 'logits', as ONNX's input"):
        to_onnx(replace(random_model(), network=named, weights=weights))
    monkeypatch.setattr(onnx_export, "MAX_BYTES", 1000)
    with pytest.raises(
        ValueError, match=r"less than 2 GiB, the classifier's weights are [\d_]+ bytes"
    ):
        to_onnx(random_model())


def test_the_bytes_of_an_onnx_file_are_counted_exactly(monkeypatch):
    """Four for each weight; just below the limit they fit."""
    n_bytes = 4 * sum(w.size for w in random_model().weights.values())
    monkeypatch.setattr(onnx_export, "MAX_BYTES", n_bytes + 1)
    to_onnx(random_model())
    monkeypatch.setattr(onnx_export, "MAX_BYTES", n_bytes)
    with pytest.raises(ValueError, match=f"the classifier's weights are {n_bytes:_} bytes$"):
        to_onnx(random_model())


def test_a_file_is_of_the_version_that_programs_read():
    """That of ONNX 1.8."""
    proto = to_onnx(random_model())
    assert proto.ir_version == 7
    assert [(entry.domain, entry.version) for entry in proto.opset_import] == [("", 13)]
    assert (proto.producer_name, proto.producer_version) == ("async_tnt", __version__)


@pytest.mark.parametrize(
    "wrong", [lambda logits: -logits, lambda logits: logits * np.nan, lambda logits: logits + 1]
)
def test_one_volume_that_differs_is_one_too_many(wrong):
    calls = []
    classifier = CompiledClassifier(random_model(classes=3))

    def network(volume):
        return [classifier(volume)]

    def sometimes_wrong(volume):
        calls.append(1)
        logits = classifier(volume)
        return [wrong(logits) if len(calls) == 7 else logits]

    compare(network, network, classifier.shape)
    with pytest.raises(ValueError, match=r"^its layers compute other numbers \(by "):
        compare(sometimes_wrong, network, classifier.shape)


@pytest.mark.parametrize(
    ("large", "small", "is_same"),
    [(5e-3, 0, True), (2e-2, 0, False), (0, 5e-5, True), (0, 1e-3, False)],
)
def test_numbers_may_differ_by_so_much_of_the_largest_of_their_own_volume(large, small, is_same):
    """The network gives 100 for a volume of large numbers, and 1 for others."""

    def network(volume, large=0.0, small=0.0):
        return [np.array([100 + large if np.abs(volume).max() > 50 else 1 + small])]

    expected = nullcontext()
    if not is_same:
        expected = pytest.raises(ValueError, match="its layers compute other numbers")
    with expected:
        compare(network, partial(network, large=large, small=small), (2, 6, 5))


@pytest.mark.parametrize(
    ("numbers", "difference", "is_same"),
    [
        # a hundredth of the largest number of all volumes counts: 1e-4 of 1
        ((100, 1e-3), 5e-5, True),
        ((100, 1e-3), 2e-4, False),
        # and 0.01 in any case
        ((1e-3, 1e-3), 5e-7, True),
        ((1e-3, 1e-3), 5e-6, False),
        ((np.nan, np.nan), 0, True),
        ((np.inf, -np.inf), 0, True),
        ((1.0, -np.inf), np.inf, False),  # no number
    ],
)
def test_numbers_that_make_no_difference_to_a_softmax_may_differ_more(numbers, difference, is_same):
    """The network gives the first number for a volume of large numbers, the second for others."""

    def network(volume, difference=0.0):
        is_large = np.abs(volume).max() > 50
        return [np.array([numbers[0] if is_large else numbers[1] + difference])]

    expected = nullcontext()
    if not is_same:
        expected = pytest.raises(ValueError, match="its layers compute other numbers")
    with expected:
        compare(network, partial(network, difference=difference), (2, 6, 5))


@pytest.mark.parametrize(
    "shows",
    [
        lambda v: not v.any(),
        lambda v: v.max() < 0,
        lambda v: np.abs(v).max() >= 100,
        lambda v: (v[:, :2, :2] > 0).any() and not v[:, 4:].any() and not v[..., 4:].any(),
        lambda v: v.min() < 0 < v.max() and (v != np.rint(v)).any(),
    ],
    ids=["zeros", "negative", "large", "dense in a corner", "any numbers"],
)
def test_a_difference_that_one_kind_of_volume_shows_is_found(shows):
    def network(volume):
        return [np.ones(2), np.ones(3)]

    def other(volume):
        return [np.ones(2), np.full(3, 2.0 if shows(volume) else 1.0)]

    with pytest.raises(ValueError, match="its layers compute other numbers"):
        compare(network, other, (2, 6, 5))


def test_numbers_without_an_axis_of_the_batch_stay_as_they_are():
    for numbers, expected in (
        (np.ones((1, 3)), (3,)),
        (np.ones((2, 3)), (2, 3)),
        (np.ones(()), ()),
    ):
        assert conversion_check.without_batch(numbers).shape == expected
    assert conversion_check.without_batch(np.ones((2, 3)), 2).shape == (3,)


@pytest.mark.parametrize(("long_s", "n_compared"), [(-1.0, 3), (1e9, 8)])
def test_three_kinds_of_volumes_are_compared_however_long_that_takes(
    long_s, n_compared, monkeypatch
):
    """Any numbers, sparse counts, and those that are dense in a corner."""
    monkeypatch.setattr(conversion_check, "LONG_S", long_s)
    seen = []

    def network(volume):
        seen.append(volume)
        return [np.ones(2)]

    compare(network, lambda volume: [np.ones(2)], (2, 6, 5))
    assert len(seen) == n_compared
    normal, counts, dense = seen[:3]
    assert (normal != np.rint(normal)).all()
    assert np.abs(counts).max() > 0 and (counts == 0).mean() > 0.8
    assert dense[:, :4, :3].mean() > 3 and not dense[:, 4:].any() and not dense[..., 3:].any()


def test_a_network_may_change_the_volume_on_which_it_is_compared():
    def original(volume):
        answer = [volume.sum(keepdims=True)]
        volume[:] = 0
        return answer

    compare(original, lambda volume: [volume.sum(keepdims=True)], (2, 6, 5))


@pytest.mark.parametrize(("difference", "is_same"), [(3e-3, True), (5e-3, False)])
def test_numbers_may_differ_by_four_times_the_error_of_rounding(difference, is_same):
    """The layers' own error is 1e-3, where 1e-4 may be without one."""
    expected = nullcontext()
    if not is_same:
        expected = pytest.raises(ValueError, match="its layers compute other numbers")
    with expected:
        compare(
            lambda volume: [np.array([1 + difference])],
            lambda volume: [np.ones(1)],
            (2, 6, 5),
            exact=lambda volume: [np.array([1 + 1e-3])],
        )


# -- the command -----------------------------------------------------------------------------------


def test_export_writes_the_file_and_checks_it(tmp_path, program):
    out = tmp_path / "digits.onnx"
    code, text, _ = program("export", "digits", "--out", out)
    assert code == 0 and os.listdir(tmp_path) == ["digits.onnx"]
    size = out.stat().st_size
    assert text.startswith(
        f"{out} ({size / 1e3:.0f} kB): volume (1, 9, 34, 34) -> logits (1, 10)\nonnxruntime "
    )
    assert text.endswith(" agrees with the compiled network\n")
    assert out.read_bytes() == to_onnx(load_model("digits")).SerializeToString()
    report = json.loads(program("export", "digits", "--out", out, "--json")[1])
    assert report["agrees"] and report["difference"] is None and report["files"] == {str(out): size}


def test_nothing_is_written_where_the_networks_do_not_agree(tmp_path, monkeypatch, program):
    model = load_model("digits")
    wrong = replace(
        model, weights={**model.weights, "fc2.bias": model.weights["fc2.bias"] + np.float32(0.1)}
    )
    monkeypatch.setattr(onnx_export, "to_onnx", lambda model: to_onnx(wrong))
    out = tmp_path / "m.onnx"
    out.write_bytes(b"what was there")
    code, text, _ = program("export", "digits", "--out", out)
    assert code == 1
    assert (
        "nothing is written: its layers compute other numbers (by 0.1, where the largest is" in text
    )
    assert os.listdir(tmp_path) == ["m.onnx"] and out.read_bytes() == b"what was there"
    code, text, _ = program("export", "digits", "--out", out, "--json")
    report = json.loads(text)
    assert (code, report["agrees"], report["files"]) == (1, False, {})
    assert report["difference"].startswith("its layers compute other numbers (by 0.1, ")


@pytest.mark.parametrize(
    "layers, shape",
    [
        ([nn.Conv2d(1, 4, 1)], (1, 4, 6, 5)),  # a map of three classes and nothing
        ([nn.AdaptiveAvgPool2d(1), nn.Conv2d(1, 3, 1)], (1, 3)),  # logits (3, 1, 1)
    ],
    ids=["a map", "one place"],
)
def test_the_shape_of_the_output_is_told_as_it_is_in_the_file(layers, shape, tmp_path, program):
    config = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=1, transform="none", landmark="center")
    model = Model.from_torch(nn.Sequential(*layers), config, ["a", "b", "c"])
    path = model.save(tmp_path / "m.safetensors")
    out = tmp_path / "m.onnx"
    code, text, _ = program("export", path, "--out", out)
    assert code == 0
    assert f"volume (1, 1, 6, 5) -> logits {shape}\n" in text
    (output,) = onnx.load(out).graph.output
    assert tuple(side.dim_value for side in output.type.tensor_type.shape.dim) == shape


def test_wrong_arguments_give_one_line(tmp_path, program):
    for out, message in (
        ("m.pt", f"{tmp_path}/m.pt: its name must end in .onnx"),
        ("no/m.onnx", "no folder "),
    ):
        code, printed, error = program("export", "digits", "--out", tmp_path / out)
        assert (code, printed) == (2, "") and error.startswith(f"async-tnt: {message}")
    assert os.listdir(tmp_path) == []


def test_onnxruntime_sends_and_keeps_nothing_about_its_use(tmp_path):
    """Its telemetry, on by default, writes below the home folder when a session is made."""
    code = (
        "from async_tnt import load_model\nfrom async_tnt.networks import OnnxClassifier, to_onnx\n"
        "OnnxClassifier(to_onnx(load_model('digits')))"
    )
    env = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    env |= {"HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run([sys.executable, "-c", code], env=env, check=True)
    assert not list(tmp_path.rglob("*onnxruntime*"))


def test_a_landmark_network_has_no_onnx_form(tmp_path, program):
    path = random_regressor_model().save(tmp_path / "m.safetensors")
    code, _, error = program("export", path, "--out", tmp_path / "m.onnx")
    assert (code, error.count("\n")) == (
        2,
        1,
    )
    assert f"{path} has a landmark network, which has no ONNX form" in error
    (tmp_path / "m.onnx").write_bytes(to_onnx(load_model(path)).SerializeToString())
    with pytest.raises(
        NotImplementedError,
        match=r"^the landmark network of .*m.onnx has no ONNX form: load the model",
    ):
        load_model(tmp_path / "m.onnx")
