"""`async-tnt check` proves that the stream equals the batch reference.

It also notices when the stream does not.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from made import events_of, random_events, random_model, random_regressor_model
from networks.random_spiking import random_spiking_model
from tnt_reference import LayerNetwork
from torch import nn

from async_tnt import (
    EVENT_DTYPE,
    CompiledClassifier,
    Model,
    Processor,
    SpikingVolume,
    TNTConfig,
    TNTVolume,
    load_model,
)
from async_tnt.checking.comparison import Comparison
from async_tnt.checking.equality import check_recording, n_steps
from async_tnt.networks.torch.from_torch import layers_from_torch
from async_tnt.networks.torch.operations import HeatmapCentroid
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import sample_recordings

CONFIGS = {"center", "running", "line", "window", "line, flow removed", "no transform", "the model"}


def test_it_holds_stream_and_batch_equal(program, tmp_path):
    path = tmp_path / "short.npy"
    events = random_events(150, duration_us=200_000)
    events["t"][30:140:7] = events["t"][29:139:7] - 20_000  # times may run backwards
    np.save(path, events)
    code, printed, _ = program("check", path, "--prefixes", "all")
    assert code == 0 and "stream and batch are equal" in printed and "FAILS" not in printed
    code, printed, _ = program("check", path, "--json", "--prefixes", "3")
    report = json.loads(printed)
    rows = report["recordings"][str(path)]
    assert code == 0 and report["equal"] and all(row["holds"] and row["n"] > 0 for row in rows)
    assert {row["config"] for row in rows} == CONFIGS


def test_as_many_prefixes_are_compared_as_are_asked_for(program, tmp_path):
    path = tmp_path / "short.npy"
    np.save(path, random_events(20, duration_us=20_000))

    n_volumes = {}
    for prefixes in (1, 5, "all"):
        report = json.loads(program("check", path, "--json", "--prefixes", prefixes)[1])
        assert report["prefixes"] == prefixes
        assert report["packet_sizes"] == [1, 2, 7, 100, "all"]
        (n_volumes[prefixes],) = [
            row["n"]
            for row in report["recordings"][str(path)]
            if row["what"].startswith("volume against") and row["config"] == "center"
        ]
    assert (n_volumes[1], n_volumes[5]) == (1, 5)
    assert n_volumes["all"] >= 20


def test_the_worst_of_all_recordings_is_printed_and_which_one_fails(program, tmp_path, monkeypatch):
    """The exit code is 1 if one of them fails, as a table and as JSON."""
    paths = [tmp_path / f"{name}.npy" for name in "abc"]
    worst = iter([2e-7, 3e-6, 1e-7] * 2)
    for path in paths:
        np.save(path, random_events(9))
    monkeypatch.setattr(
        "async_tnt.cli.check.check_recording",
        lambda *_, **__: [
            Comparison("volumes", "center", 1e-6, n=4, worst=next(worst)),
            Comparison("landmarks", "line", 1e-9, n=1, worst=0.0),
        ],
    )
    code, out, err = program("check", *paths)
    assert code == 1
    _, first, second, last = out.splitlines()
    assert first.split() == ["volumes", "center", "12", "3e-06", "1e-06", "FAILS"]
    assert second.split() == ["landmarks", "line", "3", "0", "1e-09", "ok"]
    assert last == "3 recordings: stream and batch are NOT equal"
    (line,) = [line for line in err.splitlines() if "volumes" in line]
    assert line == f"{paths[1]}: volumes (center): 3e-06 in 4 comparisons"
    code, out, _ = program("check", *paths, "--json")
    rows = json.loads(out)["recordings"]
    assert code == 1 and not json.loads(out)["equal"]
    assert [rows[str(path)][0]["holds"] for path in paths] == [True, False, True]


def test_a_recording_of_another_sensor_is_not_checked(program, tmp_path):
    path = tmp_path / "large.npz"
    np.savez(path, events=random_events(10, sensor=(64, 48)), sensor=(64, 48))
    code, out, err = program("check", path)
    assert (code, out) == (2, "")
    assert err.endswith("but the model is for 34x34; --model FILE names one for this sensor\n")


def test_a_part_behind_all_events_leaves_nothing_to_check(program):
    code, _, err = program("check", sample_recordings()[1], "--between-us", f"{10**9},{10**10}")
    assert code == 2 and err.endswith("no events to check\n")


def test_it_says_no_when_a_landmark_is_wrong_by_a_millionth_of_a_pixel(monkeypatch, program):
    landmark = TNTVolume.landmark.fget
    monkeypatch.setattr(
        TNTVolume, "landmark", property(lambda self: tuple(np.add(landmark(self), 1e-6)))
    )
    code, printed, message = program("check", sample_recordings()[1], "--prefixes", "1")
    assert code == 1 and "FAILS" in printed and "NOT equal" in printed and "landmark" in message


def loses_events_of_long_packets(monkeypatch):
    push = Processor.push

    def lossy(self, events):
        is_long = isinstance(events, np.ndarray) and len(events) > 50
        return push(self, events[:-1] if is_long else events)

    monkeypatch.setattr(Processor, "push", lossy)


def finds_no_end_of_long_streams(monkeypatch):
    """The last window is lost where all events come at once."""
    push = Processor.push
    finish = Processor.finish
    longest = []

    def noting(self, events):
        longest.append(len(events))
        return push(self, events)

    monkeypatch.setattr(Processor, "push", noting)
    monkeypatch.setattr(Processor, "finish", lambda self: [] if longest[-1] > 110 else finish(self))


def decides(processor):
    """Whether a stream decides by a network, and does not only look at volumes."""
    return isinstance(processor.classifier, CompiledClassifier)


def loses_the_same_events_of_packets_of_any_size(monkeypatch):
    """Those of the second row."""
    push = Processor.push

    def lossy(self, events):
        if decides(self):
            return push(self, events)
        rows = np.array([events], EVENT_DTYPE) if isinstance(events, tuple) else events
        return push(self, rows[rows["y"] != 1])

    monkeypatch.setattr(Processor, "push", lossy)


def finds_a_window_too_many(monkeypatch):
    """An empty one behind the last."""
    finish = Processor.finish

    def lavish(self):
        decisions = finish(self)
        if decides(self):
            return decisions
        last = decisions[-1]
        self.classifier(np.zeros(self.config.shape, np.float32))
        return [*decisions, replace(last, window_start_us=last.window_start_us + 10**6)]

    monkeypatch.setattr(Processor, "finish", lavish)


def opens_windows_a_microsecond_late(monkeypatch):
    init = Processor.__init__

    def late(self, *given, start_us=None, **settings):
        init(self, *given, start_us=None if start_us is None else start_us + 1, **settings)

    monkeypatch.setattr(Processor, "__init__", late)


def reads_volumes_that_are_too_large(monkeypatch):
    array = TNTVolume.array.fget
    monkeypatch.setattr(
        TNTVolume, "array", property(lambda self: array(self) * np.float32(1 + 1e-5))
    )


def finds_other_landmarks(monkeypatch):
    """Their rows are right."""
    landmark = TNTVolume.landmark.fget
    monkeypatch.setattr(
        TNTVolume, "landmark", property(lambda self: tuple(np.subtract(landmark(self), (1e-8, 0))))
    )


def decides_otherwise_than_the_whole_network(monkeypatch):
    """The logits differ by the last bit."""
    whole = CompiledClassifier.__call__
    monkeypatch.setattr(
        CompiledClassifier, "__call__", lambda self, v: np.nextafter(whole(self, v), np.float32(9))
    )


def decides_otherwise_than_the_reference(monkeypatch):
    """All logits are too small by the same number, in the stream and as a whole alike."""
    init = CompiledClassifier.__init__

    def other(self, model):
        weights = {**model.weights, "fc2.bias": model.weights["fc2.bias"] - np.float32(1e-3)}
        init(self, replace(model, weights=weights))

    monkeypatch.setattr(CompiledClassifier, "__init__", other)


BROKEN = {  # what is broken -> the promise that no longer holds
    loses_events_of_long_packets: "volumes that depend on packets",
    finds_no_end_of_long_streams: "volumes that depend on packets",
    loses_the_same_events_of_packets_of_any_size: "windows against reference",
    finds_a_window_too_many: "windows against reference",
    opens_windows_a_microsecond_late: "windows against reference",
    reads_volumes_that_are_too_large: "volume against reference, of the largest cell",
    finds_other_landmarks: "landmark against reference, px",
    decides_otherwise_than_the_whole_network: "bits that depend on earlier decisions",
    decides_otherwise_than_the_reference: "logits against reference",
}


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.__name__)
def test_it_says_no_to_each_promise_that_is_broken_and_to_no_other(broken, monkeypatch):
    model = random_model(TNTConfig(landmark="running", t_max=2.0), widths=(3, 4, 5))
    events = random_events(150, duration_us=200_000, start_us=7)

    def what_fails():
        comparisons = check_recording(events, model, prefixes=3, start_us=0)
        return {c.what for c in comparisons if not c.holds}

    assert what_fails() == set()
    broken(monkeypatch)
    assert what_fails() == {BROKEN[broken]}


def finds_landmarks_a_thousandth_beside(monkeypatch):
    landmark = TNTVolume.landmark.fget
    monkeypatch.setattr(
        TNTVolume, "landmark", property(lambda self: tuple(np.add(landmark(self), (0, 1e-3))))
    )


def test_it_says_no_to_a_landmark_of_a_network_that_is_wrong(monkeypatch):
    config = TNTConfig(bins=2, landmark="regressor", t_max=2.0)
    model = random_regressor_model(config, widths=(3, 4, 5), regressor_widths=(3, 3, 3))
    events = random_events(100, duration_us=90_000)
    steps = []

    def what_fails():
        comparisons = check_recording(
            events, model, prefixes=2, on_progress=lambda: steps.append(1)
        )
        return {(c.what, c.config) for c in comparisons if not c.holds}

    assert what_fails() == set() and len(steps) == n_steps(model)
    finds_landmarks_a_thousandth_beside(monkeypatch)
    assert ("landmark against reference, px", "regressor") in what_fails()


def loses_events_of_volumes(monkeypatch, kind, is_lost):
    """Packets lose the events for which `is_lost(packet)` is True."""
    update = kind.update
    monkeypatch.setattr(kind, "update", lambda self, events: update(self, events[~is_lost(events)]))


def of_long_packets(events):
    return np.arange(len(events)) >= 50


def of_the_second_row(events):
    return events["y"] == 1


def scales(name, factor):
    """A break by which an array of a `SpikingVolume` is too large."""

    def broken(monkeypatch):
        method = getattr(SpikingVolume, name)
        monkeypatch.setattr(
            SpikingVolume, name, lambda self, *given: np.float64(factor) * method(self, *given)
        )

    return broken


BROKEN_SLIDING = [
    (
        lambda monkeypatch: loses_events_of_volumes(monkeypatch, TNTVolume, of_long_packets),
        "volumes that depend on packets",
    ),
    (
        lambda monkeypatch: loses_events_of_volumes(monkeypatch, TNTVolume, of_the_second_row),
        "volume against reference",
    ),
    (decides_otherwise_than_the_whole_network, "bits that depend on earlier decisions"),
]
BROKEN_SPIKES = [
    (
        lambda monkeypatch: loses_events_of_volumes(monkeypatch, SpikingVolume, of_long_packets),
        "states that depend on packets",
    ),
    (scales("spikes", 2), "spikes against reference"),
    (scales("spikes", 0.5), "spikes against reference"),
    (scales("spike_counts", 0.5), "spikes against reference"),
    (scales("first_spikes_us", 0.5), "spikes against reference"),
    # of these neurons some leak, and have a bound
    (scales("membranes", 1 + 1e-8), "membranes against reference"),
]


def check_breaks(model, events, broken, what, monkeypatch, **settings):
    """Check that a break breaks one promise and no other, and that all steps are counted."""
    n_done = []

    def what_fails():
        comparisons = check_recording(
            events, model, prefixes=6, on_progress=lambda: n_done.append(1), **settings
        )
        return {c.what for c in comparisons if not c.holds}

    assert what_fails() == set() and len(n_done) == n_steps(model) == 1
    broken(monkeypatch)
    assert what_fails() == {what}


@pytest.mark.parametrize(("broken", "what"), BROKEN_SLIDING)
def test_it_says_no_to_each_broken_promise_of_a_window_that_slides(broken, what, monkeypatch):
    config = TNTConfig(representation="count", polarity="signed", last_us=30_000)
    model = random_model(config, widths=(3, 4, 5))
    events = random_events(150, duration_us=200_000)
    check_breaks(model, events, broken, what, monkeypatch)


@pytest.mark.parametrize(("broken", "what"), BROKEN_SPIKES)
def test_it_says_no_to_each_broken_promise_of_a_spiking_network(broken, what, monkeypatch):
    """Among the events are late ones, in the window and before it, and before the start."""
    model = random_spiking_model(9)
    window_us = model.config.window_us
    events = random_events(120, duration_us=2 * window_us, sensor=model.config.sensor)
    events["t"][20:110:9] -= np.minimum(events["t"][20:110:9], window_us // 3)
    check_breaks(model, events, broken, what, monkeypatch, start_us=window_us // 8)


@pytest.mark.parametrize("op", ["lif", "cuba_lif"])
def test_neurons_that_leak_hold_within_a_bound(op):
    model = random_spiking_model(0, ops=(op,))
    events = random_events(60, duration_us=model.config.window_us, sensor=model.config.sensor)
    membranes = check_recording(events, model, prefixes=4)[-1]
    assert membranes.what.startswith("membranes") and membranes.holds and membranes.bound == 1e-9


def test_neurons_that_do_not_leak_are_equal_to_the_bit(monkeypatch):
    model = random_spiking_model(3, ops=("if",))
    events = random_events(150, duration_us=model.config.window_us, sensor=model.config.sensor)
    broken = scales("membranes", 1 + 1e-12)
    check_breaks(model, events, broken, "membranes against reference", monkeypatch)


@pytest.mark.parametrize(
    "read", [lambda module, _: module, lambda *given: LayerNetwork(*layers_from_torch(*given)[:2])]
)
def test_a_landmark_network_of_any_layers_holds(read):
    """One of the layers is a batch norm, which takes the second of four axes for channels."""
    torch.manual_seed(0)
    config = TNTConfig(bins=3, landmark="regressor", t_max=2.0)
    batch_norm = nn.BatchNorm2d(6)
    batch_norm.running_mean.normal_()
    finds = nn.Sequential(
        nn.Conv2d(3, 6, 3, padding=1), batch_norm, nn.ReLU(), nn.Conv2d(6, 1, 1), HeatmapCentroid()
    )
    decides = nn.Sequential(nn.Conv2d(3, 2, 3), nn.AdaptiveAvgPool2d(1))  # logits (2, 1, 1)
    decides = read(decides.eval(), config.shape)
    finds = read(finds.eval(), config.shape)
    model = Model.from_torch(decides, config, ["a", "b"], regressor=finds)
    comparisons = check_recording(random_events(150, duration_us=90_000), model, prefixes=2)
    assert [c for c in comparisons if not c.holds] == []


@pytest.mark.parametrize(
    "settings",
    [
        {"landmark": "line", "remove_flow": True, "t_max": 3.0, "polarity": "split", "bins": 2},
        {"representation": "mean_time", "transform": "none", "polarity": "split", "bins": 1},
    ],
)
def test_a_network_on_a_volume_of_any_settings_holds(settings):
    """The reference makes the same volume of them. None of the values is a default."""
    config = TNTConfig(sensor=(20, 16), grid=(12, 8), window_us=40_000, **settings)
    assert all(getattr(TNTConfig(), name) != value for name, value in settings.items())
    events = random_events(150, duration_us=90_000, sensor=(20, 16))
    comparisons = check_recording(events, random_model(config), prefixes=2)
    assert [c for c in comparisons if not c.holds] == []


@pytest.mark.parametrize("start_us", [None, 5_000, 15_000])
def test_windows_without_events_and_events_of_closed_ones_hold_too(start_us):
    """Windows last 20 ms, and numbers 0, 2 and 5 hold events.

    Among the last events are late ones, of the window before. With the latest start, the first
    events come before it.
    """
    times = [np.linspace(20_000 * k, 20_000 * k + 19_000, 30).astype(int) for k in (0, 2, 5)]
    times[2][3:20:5] -= 60_000
    events = random_events(90, sensor=(20, 16))
    events["t"] = 5_000 + np.concatenate(times)
    model = random_model(TNTConfig(sensor=(20, 16), grid=(12, 8), bins=3, window_us=20_000))
    comparisons = check_recording(events, model, prefixes=2, start_us=start_us)
    assert [c for c in comparisons if not c.holds] == []


@pytest.mark.parametrize("window_us", [None, 20_000])
def test_windows_of_events_hold_too(window_us):
    config = TNTConfig(
        sensor=(20, 16), grid=(12, 8), bins=3, t_max=2.0, window_events=40, window_us=window_us
    )
    events = random_events(150, duration_us=100_000, sensor=(20, 16))
    events["t"][30:140:7] = events["t"][29:139:7] - 5_000
    for landmark in ("running", "regressor"):
        model = random_model(config.replace(landmark=landmark))
        comparisons = check_recording(events, model, prefixes=5)
        assert [c for c in comparisons if not c.holds] == []


def test_large_logits_are_compared_by_their_size_and_empty_volumes_are_equal():
    """Float32 has seven digits. Opposite events cancel each other."""
    model = random_model(TNTConfig(landmark="running", t_max=2.0), widths=(3, 4, 5))
    loud = {**model.weights, "fc2.weight": model.weights["fc2.weight"] * np.float32(1e8)}
    opposite = events_of([900, 900], [9, 9], [9, 9], [1, 0])
    for weights, events in (
        (loud, random_events(60, duration_us=90_000)),
        (model.weights, opposite),
    ):
        model = replace(model, weights=weights)
        comparisons = check_recording(events, model, prefixes=1, start_us=0)
        assert [c for c in comparisons if not c.holds] == []


@pytest.mark.parametrize("differences", [[float("nan"), 0.0], [0.0, float("nan"), 0.5], [2.0], []])
def test_a_comparison_never_forgets_a_nan_and_holds_only_if_something_was_compared(differences):
    comparison = Comparison("x", "y", 1.0)
    for difference in differences:
        comparison.add(difference)
    assert not comparison.holds


def test_stream_equals_batch_on_a_real_recording(data):
    path = sorted((data / "nmnist" / "Test" / "8").glob("*.bin"))[8]
    comparisons = check_recording(read_nmnist(path), load_model("digits"), prefixes=4)
    assert [c for c in comparisons if not c.holds] == []
