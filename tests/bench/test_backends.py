"""What is compared: the engines agree, see the events they should, and are left out where they are missing."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from bench.scripts import load_benchmark
from made import random_events, random_model

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, load_model
from async_tnt.checking import backends
from async_tnt.checking import bench_every_event as every_event
from async_tnt.checking import bench_network as network
from async_tnt.checking.backends import dense_networks, left_out
from async_tnt.checking.interleaved import WorkDiffers
from async_tnt.checking.moments import Moments, bench_recordings, windows_of

end_to_end, noise, singles = map(load_benchmark, ("measure_end_to_end", "measure_noise", "measure_singles"))

needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")
SMALL = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=3, window_us=1000)
BRIEF = {"blocks": 1, "size": 3}


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("digits")


@pytest.fixture(scope="module")
def windows(model) -> list[np.ndarray]:
    return [w for events in bench_recordings(model)[:2] for w in windows_of(events, model.config.window_us)]


def test_all_engines_give_the_same_logits_and_keep_none_of_the_volume(model):
    networks = dense_networks(model)
    assert set(networks) | set(left_out()) == set(backends.WORK) - {"incremental"}
    volumes = np.random.default_rng(0).standard_normal((3, *model.config.shape)).astype(np.float32)
    expected = [CompiledClassifier(model)(volume).copy() for volume in volumes]
    for name, run in networks.items():
        for volume, logits in zip([*volumes, volumes[0]], [*expected, expected[0]], strict=True):
            assert np.abs(run(volume) - logits).max() < 1e-4 * np.abs(logits).max(), name


def test_a_missing_package_leaves_its_rows_out_and_is_named(model, monkeypatch):
    present = backends.is_installed
    monkeypatch.setattr(backends, "is_installed", lambda *names: "onnxruntime" not in names and present(*names))
    assert not {"onnxruntime_run", "onnxruntime_binding"} & set(dense_networks(model))
    assert left_out()["onnxruntime_run"] == left_out()["onnxruntime_binding"] == "onnxruntime is not installed"
    assert end_to_end.left_out()["ours_onnxruntime"] == "onnxruntime is not installed"
    monkeypatch.setattr(backends, "is_installed", lambda *names: not names)
    assert set(dense_networks(model)) == {"dense"}
    assert left_out()["openvino"] == "onnx and openvino are not installed"


@pytest.mark.parametrize("n_new", [1, 7])
def test_ours_sees_exactly_the_new_events(n_new):
    model = random_model(SMALL, widths=(4, 6, 8))
    windows = [random_events(n, seed=n, duration_us=1000, sensor=(20, 16)) for n in (60, 40)]
    moments = Moments(windows, 1000, n_new)
    feed, seen = network.Feed(model), []
    ours = network.Incremental(model, feed)
    whole = network.Dense(CompiledClassifier(model), feed)
    for block in moments.blocks(3, moments.a_lap // 2):  # through both windows, and again
        for moment in block:
            if not moment.follows:
                ours.prepare(moment.before)
                ours.decide()
            before = feed.volume.n_events
            ours.prepare(moment)
            seen.append(feed.volume.n_events - before)
            whole.prepare(moment)  # the same feed: nothing more comes
            assert feed.volume.n_events == len(moment.events)
            assert np.array_equal(ours.decide(), whole.decide())
    assert len(seen) >= 15 and set(seen) == {n_new}


def test_the_stream_pushes_the_packet_within_its_time(monkeypatch):
    model = random_model(SMALL, widths=(4, 6, 8))
    windows = [random_events(n, seed=n, duration_us=1000, sensor=(20, 16)) for n in (12, 60)]
    (block,) = Moments(windows, 1000, 5).blocks(1, 6)  # two of one window, four of the next
    pushed = []
    push = Processor.push
    monkeypatch.setattr(Processor, "push", lambda self, events: pushed.append(len(events)) or push(self, events))
    ours = end_to_end.Stream(model)
    for moment in block:
        if not moment.follows:
            ours.prepare(moment.before)
            ours.decide()
            pushed.clear()
        ours.prepare(moment)
        assert pushed == []
        logits = ours.decide()
        assert pushed == [5]
        pushed.clear()
        expected = Processor(model, start_us=0)
        push(expected, moment.events)
        assert np.array_equal(logits, expected.fire().logits)


def test_networks_that_differ_stop_the_comparison(model, windows):
    right = CompiledClassifier(model)
    networks = {"dense": right, "wrong": lambda volume: right(volume) * np.float32(1.001)}
    with pytest.raises(WorkDiffers, match=r"got incremental and wrong 1\.0e-03 apart"):
        network.bench_network(model, networks, windows, 10, **BRIEF)
    with pytest.raises(WorkDiffers, match=r"got dense and wrong 1\.0e-03 apart"):
        noise.bench_on_noise(model, networks, **BRIEF)
    del networks["dense"]
    with pytest.raises(WorkDiffers, match=r"got ours and wrong 1\.\de-0[34] apart after \d+ events"):
        every_event.bench_every_event(model, networks, bench_recordings(model)[:1], rounds=1, n_events=1000)


@needs_torch
def test_a_wrong_batch_way_stops_the_comparison(model, windows, monkeypatch):
    from async_tnt.checking.torch_batch import TorchBatch

    right = TorchBatch.volume
    monkeypatch.setattr(TorchBatch, "volume", lambda self, *columns: right(self, *columns) * 1.01)
    with pytest.raises(WorkDiffers, match="got ours and torch"):
        end_to_end.bench_end_to_end(model, None, windows, 100, **BRIEF)


def test_the_faster_way_of_onnxruntime_is_the_one_with_less_time_over_all_rows():
    def row(run: float, binding: float):
        return {"in_blocks": {"us": {"onnxruntime_run": {"median": run}, "onnxruntime_binding": {"median": binding}}}}

    ways = backends.ONNXRUNTIME
    assert noise.fastest(ways, {"1": row(50, 49), "10": row(40, 48)}) == "onnxruntime_run"
    assert noise.fastest(ways, {"1": row(50, 49), "10": row(48, 40)}) == "onnxruntime_binding"
    assert noise.fastest(ways, {"1": {"in_blocks": {"us": {"dense": {"median": 1.0}}}}}) is None


def test_eventcv_is_asked_only_for_volumes_that_it_makes(model, monkeypatch):
    monkeypatch.setattr(end_to_end, "is_installed", lambda *names: True)
    assert end_to_end.eventcv_fits(model)
    for other in ({"polarity": "split"}, {"sensor": (68, 68)}):
        assert not end_to_end.eventcv_fits(random_model(model.config.replace(**other)))


def test_every_event_asks_a_whole_network_for_each_decision(model, monkeypatch):
    """A Processor refreshes a CompiledClassifier: as a backend it is to be called with arrays."""
    asked = []
    whole = CompiledClassifier.__call__
    monkeypatch.setattr(CompiledClassifier, "__call__", lambda self, v: asked.append(v.shape) or whole(self, v))
    events = bench_recordings(model)[0]
    networks = {"dense": CompiledClassifier(model)}
    rates = every_event.bench_every_event(model, networks, [events], rounds=1, n_events=50)
    assert asked == [model.config.shape] * 3 * 51  # compared, warm, timed: all events, and the end of the window
    dense, ours = rates["dense"], rates["ours"]
    assert dense["ratio"]["median"] == pytest.approx(dense["us"]["median"] / ours["us"]["median"])
    assert ours["a_second"] == pytest.approx(1e6 / ours["us"]["median"])


def test_single_decisions_have_a_tail_and_the_collector_is_set_back(model):
    import gc

    assert gc.isenabled()
    rows = singles.bench_singles(model, bench_recordings(model)[:1], n_decisions=2500)
    assert gc.isenabled() and set(rows) == {"collector", "no_collector", "machine"}
    for row in rows.values():
        assert row["n"] == 2500
        assert 0 < row["q1"] <= row["median"] <= row["q3"] <= row["p99"] <= row["p999"] <= row["max"]
        assert row["p99_over_median"] == pytest.approx(row["p99"] / row["median"])
