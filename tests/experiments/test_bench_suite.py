"""`python -m experiments.bench_suite`: what it reports, and that it refuses to compare different work."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json

import numpy as np
import pytest

from async_tnt import TNTConfig, load_model
from experiments import bench_backends as backends
from experiments import bench_suite
from experiments.bench_interleaved import WorkDiffers
from experiments.bench_latency import bench_latency
from experiments.bench_moments import bench_recordings, made_recording

needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")


@pytest.fixture(autouse=True, scope="module")
def small_grids():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.bench_suite.GRIDS", ((34, 34), (64, 48)))
        small = {"rounds": 2, "moments": 40, "blocks": 1, "decisions_a_block": 5, "recordings": 1, "events": 100}
        patch.setattr("experiments.bench_suite.SIZES", {name: (None, n) for name, n in small.items()})
        yield


@pytest.fixture(scope="module")
def report(small_grids):
    """What `--quick --json` prints, run once for the tests that read it."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert bench_suite.main(["--quick", "--json"]) == 0
    return json.loads(printed.getvalue())


def figures_of(report):
    """All figures of a report, at any depth."""
    if isinstance(report, dict):
        if "median" in report:
            yield report
        for value in report.values():
            yield from figures_of(value)


def test_the_report_has_every_figure_in_order(report):
    assert report["machine"]["cpu"] and report["machine"]["numpy"] == np.__version__
    ways = {"single"} | {f"packet_{n}_{form}" for n in (10, 100, 1300) for form in ("structured", "columns")}
    assert [v["grid"] for v in report["volume"]] == [[34, 34], [64, 48]]
    assert all(set(volume["ns_per_event"]) == ways for volume in report["volume"])
    found = [
        figure for part in (*report["volume"], report["processor"], report["network"]) for figure in figures_of(part)
    ]
    assert len(found) > 50
    for figure in found:
        ordered = [figure[name] for name in ("min", "q1", "median", "q3", "p99", "max") if name in figure]
        assert ordered[0] > 0 and ordered == sorted(ordered)
    engines = set(backends.ENGINES) - set(report["left_out"])
    assert list(report["network"]) == ["1", "10", "100", "1300"]
    for row in report["network"].values():
        for mode in ("call_by_call", "in_blocks"):
            assert set(row[mode]["us"]) == engines and row[mode]["largest_difference"] < 1e-4
    assert set(report["processor"]["every_event"]) == {"ours"} | engines - {"incremental"}
    assert report["processor"]["stream"]["windows"] == 3


@needs_torch
def test_batch_processing_is_timed_and_makes_the_same_volumes(report):
    decisions = report["processor"]["latency"]
    assert {"batch", "batch_volume", "batch_network"} < set(decisions["us"])
    assert 0 < decisions["largest_difference"]["volume"] < 1e-4  # float32 against float64: not quite zero
    assert "batch" in report["processor"]["stream"]["ns_per_event"] and decisions["batch_over_stream"]["median"] > 0


def test_different_work_is_refused(monkeypatch, capsys):
    def differ(*settings, **counts):
        raise WorkDiffers("got ours and theirs 1.0e-03 apart")

    monkeypatch.setattr(bench_suite, "bench_volume", differ)
    assert bench_suite.main(["--quick"]) == 1
    assert capsys.readouterr().err.endswith(": got ours and theirs 1.0e-03 apart\n")


@needs_torch
def test_different_volumes_are_refused(monkeypatch):
    from experiments.bench_torch_batch import TorchBatch

    model, right = load_model("digits"), TorchBatch.volume
    monkeypatch.setattr(TorchBatch, "volume", lambda self, *columns: 1.001 * right(self, *columns))
    with pytest.raises(WorkDiffers, match=r"stream and batch must agree within 0\.0001, got volumes 1\.0e-03"):
        bench_latency(model, bench_recordings(model.config)[0], moments=5, with_torch=True)


def test_without_other_packages_ours_are_timed(monkeypatch, capsys):
    for module in (bench_suite, backends):
        monkeypatch.setattr(module, "is_installed", lambda *packages: not packages)
    assert bench_suite.main(["--quick"]) == 0
    text = capsys.readouterr().out
    assert "torch is not installed: only our own times" in text
    assert "packets of 1300, columns" in text and "batch: " not in text
    assert "onnxruntime, run: onnx and onnxruntime are not installed" in text
    assert "CompiledClassifier.refresh" in text and "CompiledClassifier(array)" in text


def test_mistakes(capsys):
    mistakes = {"--model no_such_model": "no model file no_such_model", "--landmark regressor": "invalid choice"}
    for words, message in mistakes.items():
        with pytest.raises(SystemExit, match="2"):
            bench_suite.main(words.split())
        assert message in capsys.readouterr().err


TWINS = [{"landmark": landmark} for landmark in ("center", "running", "line", "window")]
TWINS += [{"landmark": "line", "remove_flow": True}, {"transform": "none"}, {"bins": 1}]
TWINS += [{"polarity": "unsigned", "t_max": 2.0}, {"polarity": "split"}]


@needs_torch
@pytest.mark.parametrize("settings", TWINS, ids=str)
def test_batch_processing_equals_the_reference(settings):
    """A figure beside a wrong batch computation would mean nothing."""
    import torch

    from async_tnt.checking.reference import reference_volume
    from experiments.bench_torch_batch import TorchBatch, as_tensors

    config = TNTConfig(grid=(20, 41), window_us=20_000, **settings)
    events = made_recording(np.random.default_rng(5), config, 3000)
    events = events[events["t"] < 20_000]
    expected = reference_volume(events, config, 0)
    with torch.inference_mode():
        found = TorchBatch(config).volume(*as_tensors(events, 0)).numpy()
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
