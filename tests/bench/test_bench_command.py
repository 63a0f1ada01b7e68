"""`async-tnt bench`: what it reports, and that it refuses to compare different work."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import json
import subprocess
import sys

import numpy as np
import pytest

from async_tnt import Model, TNTConfig
from async_tnt.checking import bench_latency as latency
from async_tnt.checking.backends import WORK as ENGINES
from async_tnt.checking.moments import made_recording
from async_tnt.checking.timing import interleave, spread
from async_tnt.cli.bench import TITLES, add_arguments, main, table

WAYS = {"single"} | {f"packet_{n}_{form}" for n in (10, 100, 1300) for form in ("structured", "columns")}
needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")


def parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture(scope="module")
def small_grids():
    patch = pytest.MonkeyPatch()
    patch.setattr("async_tnt.cli.bench.GRIDS", ((34, 34), (64, 48)))
    yield
    patch.undo()


@pytest.fixture(scope="module")
def report(small_grids):
    """What `--quick --json` prints, run once for the tests that read it."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(parse("--quick", "--json")) == 0
    return json.loads(printed.getvalue())


def test_quick_json_is_one_object_with_every_figure(report):
    assert report["machine"]["cpu"] and report["machine"]["numpy"] == np.__version__
    assert [v["grid"] for v in report["volume"]] == [[34, 34], [64, 48]]
    for volume in report["volume"]:
        assert set(volume["ns_per_event"]) == WAYS
        for figure in [*volume["ns_per_event"].values(), volume["open_us"], volume["read_us"]]:
            assert 0 < figure["min"] <= figure["q1"] <= figure["median"] <= figure["q3"] <= figure["max"]
    decisions = report["processor"]["latency"]
    for figure in decisions["us"].values():
        assert 0 < figure["median"] <= figure["p99"]
    assert decisions["us"]["stream"]["median"] > decisions["us"]["push_one"]["median"]
    assert report["processor"]["stream"]["windows"] == 3


def test_decisions_are_reported_beside_every_engine_that_is_installed(report):
    engines = set(ENGINES) - set(report["left_out"])
    assert list(report["network"]) == ["1", "10", "100", "1300"]
    for row in report["network"].values():
        for way in ("call_by_call", "in_blocks"):
            assert set(row[way]["us"]) == engines and row[way]["largest_difference"] < 1e-4
            assert all(0 < figure["median"] <= figure["p99"] for figure in row[way]["us"].values())
    every_event = report["processor"]["every_event"]
    assert set(every_event) == {"ours"} | engines - {"incremental"}
    for name, row in every_event.items():
        assert row["a_second"] == pytest.approx(1e6 / row["us"]["median"])
        assert name == "ours" or row["ratio"]["median"] > 0


@needs_torch
def test_batch_way_is_timed_and_makes_the_same_volumes(report):
    assert report["settings"]["batch"] is True
    assert "batch" in report["processor"]["stream"]["ns_per_event"]
    decisions = report["processor"]["latency"]
    assert {"batch", "batch_volume", "batch_network"} < set(decisions["us"])
    assert 0 < decisions["largest_difference"]["volume"] < 1e-4  # float32 against float64: not quite zero
    assert decisions["batch_over_stream"]["median"] > 0


def test_the_table_shows_every_figure(report):
    text = "\n".join(table(report))
    for title in ("update_one", "packets of 1300, columns", "open a window", "push_one + fire"):
        assert title in text
    assert f"{report['volume'][1]['ns_per_event']['single']['median']:,.0f}" in text
    assert "batch / stream" in text or "torch is not installed" in text
    for name in report["network"]["1"]["in_blocks"]["us"]:
        assert TITLES[name] in text
    assert f"{report['processor']['every_event']['ours']['a_second']:,.0f}" in text
    assert "checked: the same logits (at most" in text


def test_an_engine_of_other_logits_is_refused(small_grids, monkeypatch, capsys):
    from async_tnt.checking import backends

    right = backends.MAKERS["dense"]

    def wrong(model):
        network = right(model)
        return lambda volume: 1.001 * network(volume)

    monkeypatch.setitem(backends.MAKERS, "dense", wrong)
    assert main(parse("--quick")) == 1
    captured = capsys.readouterr()
    assert "all must give the same logits within 0.0001, got incremental and dense 1.0e-03 apart" in captured.err
    assert captured.out == ""


@needs_torch
def test_different_work_is_not_timed_but_refused(small_grids, monkeypatch, capsys):
    from async_tnt.checking.torch_batch import TorchBatch

    right = TorchBatch.volume
    monkeypatch.setattr(TorchBatch, "volume", lambda self, *columns: 1.001 * right(self, *columns))
    assert main(parse("--quick")) == 1
    captured = capsys.readouterr()
    assert "stream and batch must agree within 0.0001, got volumes 1.0e-03" in captured.err
    assert captured.out == ""


def test_without_torch_it_says_so_and_times_ours(small_grids, monkeypatch, capsys):
    for module in ("cli.bench", "checking.backends"):
        monkeypatch.setattr(f"async_tnt.{module}.is_installed", lambda *packages: not packages)
    assert main(parse("--quick")) == 0
    text = capsys.readouterr().out
    assert "torch is not installed: only our own times" in text
    assert "packets of 1300, columns" in text and "batch: " not in text and "batch way, torch" not in text
    assert "onnxruntime, run: onnx and onnxruntime are not installed" in text
    assert "CompiledClassifier.refresh" in text and "CompiledClassifier(array)" in text


def test_the_command_does_not_import_torch():
    code = "import sys, async_tnt.cli.bench; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_model_that_cannot_be_read_is_bad_usage():
    with pytest.raises(FileNotFoundError, match="no model file no_such_model"):
        main(parse("--model", "no_such_model"))


def test_random_weights_stand_in_where_no_model_is_bundled(monkeypatch):
    monkeypatch.setattr(latency, "bundled_models", lambda: ())
    model, name = latency.bench_model(None, "line", seed=3)
    again, _ = latency.bench_model(None, "line", seed=3)
    assert name == "random weights" and model.config.landmark == "line"
    assert all(np.array_equal(model.weights[key], again.weights[key]) for key in model.weights)


@needs_torch
@pytest.mark.parametrize(
    "settings",
    [{"polarity": "split", "landmark": "line"}, {"landmark": "window"}, {"transform": "none", "bins": 1}],
    ids=str,
)
def test_any_model_is_timed_on_a_made_stream(settings):
    """Another sensor and grid than the samples', several windows: both ways see the same events at all times."""
    config = TNTConfig(sensor=(50, 40), grid=(24, 20), window_us=10_000, **settings)
    rng = np.random.default_rng(1)
    shapes = {"conv1": (4, config.channels, 3, 3), "conv2": (6, 4, 3, 3), "fc1": (8, 6 * 5 * 6), "fc2": (3, 8)}
    weights = {f"{k}.weight": rng.normal(0, 0.2, s).astype(np.float32) for k, s in shapes.items()}
    weights |= {f"{k}.bias": rng.normal(0, 0.2, s[0]).astype(np.float32) for k, s in shapes.items()}
    model = Model(config, weights, ("a", "b", "c"))
    events = made_recording(rng, config, 2000)
    decisions = latency.bench_latency(model, events, moments=30, with_torch=True)
    assert 0 < decisions["largest_difference"]["volume"] < 1e-4
    stream = latency.bench_stream(model, events, rounds=1, with_torch=True)
    assert stream["windows"] == 3 and stream["ns_per_event"]["batch"]["median"] > 0


def test_cases_take_turns_and_the_warm_up_is_not_counted():
    calls: list[str] = []

    def case(name: str, value: float):
        return lambda: calls.append(name) or value

    measured = interleave({"a": case("a", 1.0), "b": case("b", 2.0)}, rounds=3)
    assert calls == ["a", "b", "a", "b", "b", "a", "a", "b"]
    assert measured["a"].tolist() == [1.0] * 3 and measured["b"].tolist() == [2.0] * 3


def test_spread_by_hand():
    assert spread(np.array([1.0, 2.0, 3.0, 4.0, 9.0])) == {
        "median": 3.0,
        "q1": 2.0,
        "q3": 4.0,
        "min": 1.0,
        "max": 9.0,
        "n": 5,
    }


TWINS = [
    {"landmark": name, "polarity": p, "t_max": t}
    for name in ("center", "running", "line", "window")
    for p in ("signed", "unsigned", "split")
    for t in (2.0, 8.0)
]
TWINS += [{"landmark": "line", "remove_flow": True, "t_max": 2.0}, {"transform": "none"}, {"bins": 1}]


@needs_torch
@pytest.mark.parametrize("settings", TWINS, ids=lambda s: "-".join(map(str, s.values())))
@pytest.mark.parametrize("grid", [(34, 34), (20, 41)])
def test_the_batch_way_is_the_reference(settings, grid):
    """Held against the reference, not against ours: a figure beside a wrong twin would mean nothing."""
    import torch
    from tnt_reference import event_volume, tnt_volume

    from async_tnt.checking.torch_batch import TorchBatch, as_tensors

    config = TNTConfig(grid=grid, window_us=20_000, **settings)
    events = made_recording(np.random.default_rng(5), config, 3000)
    events = events[events["t"] < 20_000]
    assert len(events) > 900
    at = {"start_us": 0, "window_us": 20_000, "sensor": (34, 34), "grid": grid, "bins": config.bins}
    at |= {"polarity": config.polarity}
    columns = [events[name].astype(np.int64) for name in "txyp"]
    if config.transform == "tnt":
        at |= {"t_max": config.t_max, "landmark": config.landmark, "remove_flow": config.remove_flow}
        expected = tnt_volume(*columns, **at)
    else:
        expected = event_volume(*columns, **at)
    with torch.inference_mode():
        found = TorchBatch(config).volume(*as_tensors(events, 0))
    assert expected.abs().max() > 1
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-5 * float(expected.abs().max()))
