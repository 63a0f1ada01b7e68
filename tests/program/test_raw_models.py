"""What the commands do with a model of raw outputs."""

import json

import numpy as np
import pytest
from made import raw_model

from async_tnt import CompiledNetwork, TNTConfig, load_model, open_recording, volumes
from async_tnt.sources import sample_recordings

MODEL = raw_model(TNTConfig())
SAMPLE = sample_recordings()[3]


@pytest.fixture
def model(tmp_path):
    return MODEL.save(tmp_path / "raw.safetensors")


def expected_outputs():
    """The outputs at the end of each window of the sample."""
    network = CompiledNetwork(MODEL)
    return [network(window.volume) for window in volumes(open_recording(SAMPLE), MODEL.config)]


def test_run_prints_the_range_of_each_output(program, model):
    code, text, error = program("run", "3", "--model", model)
    head, *lines = text.splitlines()
    assert code == 0 and not error and len(lines) == 3
    assert head.endswith("outputs, least to largest") and "label" not in head
    for line, (flow, half, mean) in zip(lines, expected_outputs(), strict=True):
        ranges = [f"{a.min():.4g} to {a.max():.4g}" for a in (flow, half, mean)]
        assert line.endswith(f"  flow {ranges[0]}  half {ranges[1]}  mean {ranges[2]}")


def test_run_as_json(program, model):
    code, text, _ = program("run", "3", "--model", model, "--json", "--every-us", "20000")
    values = [json.loads(line) for line in text.splitlines()]
    assert code == 0 and len(values) > 10 and "label" not in values[0]
    at_ends = [one for one in values if one["trigger"] in ("window", "end")]
    for one, arrays in zip(at_ends, expected_outputs(), strict=True):
        assert list(one["outputs"]) == ["flow", "half", "mean"]
        for said, array in zip(one["outputs"].values(), arrays, strict=True):
            assert said["shape"] == list(array.shape)
            assert said["largest"] == pytest.approx(float(array.max()), rel=1e-5)


def test_run_with_latency_and_after_every_event(program, model):
    code, text, _ = program("run", "3", "--model", model, "--every-events", "500", "--latency")
    assert code == 0 and len(text.splitlines()) == 1 + 3 + 3 + 3 + 2


def test_info_names_the_outputs(program, model):
    code, text, _ = program("info", model)
    first = text.splitlines()[0]
    assert code == 0 and first == f"{model}: raw outputs: flow 2x34x34, half 3x17x17, mean 3"
    code, text, _ = program("info", model, "--json")
    assert json.loads(text)["outputs"] == {"flow": [2, 34, 34], "half": [3, 17, 17], "mean": [3]}


def test_check_compares_all_outputs(program, model, monkeypatch):
    code, text, _ = program("check", "3", "--model", model, "--prefixes", "2")
    assert code == 0 and "outputs against reference" in text
    # a fault in the last place of the second output
    refresh = CompiledNetwork.refresh

    def wrong(self, volume):
        flow, half, mean = refresh(self, volume)
        half = half.copy()
        half[-1, -1, -1] += 1
        return flow, half, mean

    monkeypatch.setattr(CompiledNetwork, "refresh", wrong)
    code, text, _ = program("check", "3", "--model", model, "--prefixes", "2")
    assert code == 1 and "outputs against reference" in text and "FAILS" in text


def test_export_and_run_of_the_export(program, model, tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")
    out = tmp_path / "raw.onnx"
    code, text, _ = program("export", model, "--out", out)
    assert code == 0 and "-> flow (1, 2, 34, 34), half (1, 3, 17, 17), mean (1, 3)" in text
    again = load_model(out)
    volume = np.random.default_rng(0).normal(size=MODEL.config.shape).astype(np.float32)
    for one, other in zip(
        CompiledNetwork(again)(volume), CompiledNetwork(MODEL)(volume), strict=True
    ):
        assert one.tobytes() == other.tobytes()
    lines = [program("run", "3", "--model", path)[1] for path in (model, out)]
    assert lines[0] == lines[1] and lines[0]


def test_a_network_of_another_program_without_classes(program, model, tmp_path):
    onnx = pytest.importorskip("onnx", reason="needs the extra `onnx`")
    pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")
    from async_tnt.networks import to_onnx

    proto = to_onnx(MODEL)
    del proto.metadata_props[:]
    path = tmp_path / "theirs.onnx"
    onnx.save(proto, path)
    config = tmp_path / "net.json"
    config.write_text(json.dumps({"config": MODEL.config.to_dict()}))
    code, text, _ = program("run", "3", "--model", path, "--config", config)
    assert code == 0 and text == program("run", "3", "--model", model)[1]


def test_bench_measures_it(program, model, monkeypatch):
    from async_tnt.cli import bench

    for name, value in {"ROUNDS": 1, "N_MOMENTS": 3, "N_EVENTS": 30}.items():
        monkeypatch.setattr(bench, name, value)
    code, text, _ = program("bench", "--model", model, "--json")
    report = json.loads(text)
    assert code == 0 and report["model"]["outputs"] == 3 and report["model"]["classes"] == 0
    assert report["decisions_a_second"]["median"] > 0


def test_what_needs_classes_says_so_in_one_line(program, model, tmp_path):
    code, text, error = program("run", "3", "--model", model, "--confidence", "0.9")
    assert (code, text) == (2, "")
    assert error == (
        "async-tnt: --confidence is for models with classes; this one has raw outputs\n"
    )
    code, text, error = program("evaluate", model, tmp_path)
    assert (code, text) == (2, "")
    assert error.startswith(f"async-tnt: {model} has raw outputs, and evaluate scores classes")
    assert error.count("\n") == 1
