"""`async-tnt bench`: what an event and a decision cost on this machine."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from made import random_model

from async_tnt import Processor, TNTConfig, TNTVolume, load_model
from async_tnt.cli import bench
from async_tnt.kernels.shipped import state_of_kernels
from async_tnt.sources.files.recording import open_recording, sample_recordings

CONFIGS = {
    "another sensor": {"sensor": (40, 30), "grid": (20, 16)},
    "windows of events": {"window_events": 500},
    "images": {"representation": "count"},
    "replayed": {"landmark": "window"},
}


def check(report):
    figures = [
        report["ns_an_event"],
        *report["us_a_decision"].values(),
        report["decisions_a_second"],
    ]
    assert list(report["us_a_decision"]) == ["1", "100", "1300"]
    assert all(
        0 < figure["q1"] <= figure["median"] <= figure["q3"] and figure["n"] > 1
        for figure in figures
    )


def test_the_report_has_machine_model_and_every_figure(program):
    code, text, _ = program("bench", "--json")
    report = json.loads(text)
    check(report)
    assert code == 0 and report["machine"]["cpu"] and report["machine"]["numba"]
    assert report["model"] == {
        "name": "digits",
        "config": load_model("digits").config.to_dict(),
        "classes": 10,
        "outputs": 0,
    }
    work = load_model("digits").work_of_one_event
    assert report["multiplications"] == {"one_event": work.touched, "whole_pass": work.whole}
    text = program("bench")[1]
    assert (
        "model digits: 34 x 34 pixels, landmark running; bundled samples" in text
        and "1,300 new events " in text
    )


@pytest.mark.parametrize("settings", CONFIGS.values(), ids=CONFIGS)
def test_any_model_is_measured(settings, tmp_path, program):
    path = random_model(TNTConfig(**settings), widths=(4, 6, 8)).save(tmp_path / "own.safetensors")
    code, text, _ = program("bench", "--json", "--model", str(path))
    report = json.loads(text)
    check(report)
    assert code == 0 and report["events_from"].endswith(
        "spread over the sensor" if "sensor" in settings else "samples"
    )


# -- what is measured, without a clock -------------------------------------------------------------

TICK_S = 1e-3
SAMPLES = [open_recording(path).read() for path in sample_recordings().values()]


@pytest.fixture
def a_tick_a_look(monkeypatch):
    """A clock that goes on by a millisecond whenever it is looked at."""
    looks = iter(range(1 << 30))
    monkeypatch.setattr(bench.time, "perf_counter", lambda: TICK_S * next(looks))


def test_the_samples_are_spread_over_another_sensor():
    own, own_words = bench._recordings_for((34, 34))
    wide, words = bench._recordings_for((100, 17))
    assert (own_words, words) == ("bundled samples", "bundled samples, spread over the sensor")
    for events, same, spread in zip(SAMPLES, own, wide, strict=True):
        np.testing.assert_array_equal(same, events)
        np.testing.assert_array_equal(spread["x"], events["x"].astype(int) * 100 // 34)
        np.testing.assert_array_equal(spread["y"], events["y"].astype(int) // 2)
        np.testing.assert_array_equal(spread[["t", "p"]], events[["t", "p"]])


def test_nanoseconds_of_an_event_in_the_first_windows(a_tick_a_look):
    """A tick for each of ten windows; also of a recording that begins late."""
    model = load_model("digits")
    late = [events.copy() for events in SAMPLES]
    for events in late:
        events["t"] += 10**9
    n_events = sum(int((e["t"] < e["t"][0] + model.config.window_us).sum()) for e in SAMPLES)
    for recordings in (SAMPLES, late):
        measured = list(bench._volume_ns(model, recordings))
        assert len(measured) == bench.ROUNDS
        assert measured == pytest.approx([10 * 1e6 / n_events] * bench.ROUNDS)


@pytest.mark.parametrize(
    "settings",
    [{}, {"window_events": 500}, {"representation": "count", "last_us": 50_000}],
    ids=str,
)
def test_whole_passes_are_on_the_complete_first_window_of_each_recording(
    settings, a_tick_a_look, monkeypatch
):
    config = TNTConfig(**settings)
    passed = []
    monkeypatch.setattr(bench, "compiled_network_of", lambda model: passed.append)
    measured = list(bench._whole_pass_us(random_model(config, widths=(4, 6, 8)), SAMPLES[:2]))
    assert measured == pytest.approx([1000.0] * 2 * bench.N_PASSES)
    for k, volume in enumerate(passed):
        events = SAMPLES[k // bench.N_PASSES]
        expected = TNTVolume(config)
        expected.open(int(events["t"][0]))
        since = events["t"] - events["t"][0]
        expected.update(events[since < config.window_us][: settings.get("window_events")])
        assert expected.array.any() and not volume.flags.writeable
        np.testing.assert_array_equal(volume, expected.array)


@pytest.mark.parametrize("n_new", bench.NEW_EVENTS)
def test_a_decision_is_timed_so_many_events_after_another(n_new, a_tick_a_look, monkeypatch):
    between = []

    class Noting(Processor):
        n = 0

        def push(self, events):
            self.n += len(events)
            return super().push(events)

        def fire(self):
            between.append(self.n)
            self.n = 0
            return super().fire()

    monkeypatch.setattr(bench, "Processor", Noting)
    measured = list(bench._decision_us(load_model("digits"), SAMPLES[:2], n_new))
    assert measured == pytest.approx([1000.0] * len(measured))
    assert len(between) == 2 * len(measured) > 2
    assert set(between[1::2]) == {n_new}


def test_decisions_a_second_are_one_after_every_event(a_tick_a_look):
    """And one at the end of each of the two closed windows of a recording, at the most."""
    events = [recording[:1500] for recording in SAMPLES[:3]]
    for rate in bench._decisions_a_second(load_model("digits"), events):
        assert 1500 <= rate * TICK_S < 1503


def test_figures_stand_in_their_rows(monkeypatch, program):
    """Quartiles of 1 to 5; numbers from a thousand on have no decimals."""
    values = [1.0, 2.0, 3.0, 4.0, 5.0]
    monkeypatch.setattr(bench, "_volume_ns", lambda *_: values)
    monkeypatch.setattr(bench, "_decision_us", lambda *given: [n * given[2] for n in values])
    monkeypatch.setattr(bench, "_whole_pass_us", lambda *_: [10.0 * n for n in values])
    taken = []

    def decisions_a_second(model, recordings):
        taken.extend(map(len, recordings))
        return [7.0 * n for n in values]

    monkeypatch.setattr(bench, "_decisions_a_second", decisions_a_second)
    report = json.loads(program("bench", "--json")[1])
    assert taken == [bench.N_EVENTS] * 10
    assert report["kernels"] == state_of_kernels()
    assert report["ns_an_event"] == {"median": 3, "q1": 2, "q3": 4, "n": 5}
    assert report["us_a_decision"]["100"] == {"median": 300, "q1": 200, "q3": 400, "n": 5}
    assert report["decisions_a_second"] == {"median": 21, "q1": 14, "q3": 28, "n": 5}
    *rows, reach = [" ".join(line.split()) for line in program("bench")[1].splitlines()[3:]]
    assert reach.startswith("one event reaches at most ")
    assert rows == [
        "median quartiles",
        "ns an event into the volume 3.0 2.0 to 4.0",
        "us a decision, 1 new event 3.0 2.0 to 4.0",
        "us a decision, 100 new events 300.0 200.0 to 400.0",
        "us a decision, 1,300 new events 3,900 2,600 to 5,200",
        "us a pass through the whole network 30.0 20.0 to 40.0",
        "decisions a second, one after every event 21.0 14.0 to 28.0",
    ]


CPUINFO = """\
processor\t: 0
cpu family\t: 6
model\t\t: 85
model name\t: Some(R) Processor @ 2.50GHz
power management:

processor\t: 1
cpu family\t: 6
model\t\t: 85
model name\t: Some(R) Processor @ 2.50GHz
"""


def test_the_machine_is_named_with_its_load(monkeypatch, program):
    """By family and model, too, as some virtual machines hide the processor's name."""
    for name in ("_volume_ns", "_decision_us", "_whole_pass_us", "_decisions_a_second"):
        monkeypatch.setattr(bench, name, lambda *_: [1.0])
    monkeypatch.setattr(bench, "open", lambda *_, **__: io.StringIO(CPUINFO), raising=False)
    monkeypatch.setattr(bench.os, "getloadavg", lambda: (1.256, 2.0, 3.0), raising=False)
    monkeypatch.setattr(bench.os, "cpu_count", lambda: 7)
    cpu = "Some(R) Processor @ 2.50GHz (family 6, model 85)"
    facts = json.loads(program("bench", "--json")[1])["machine"]
    assert (facts["cpu"], facts["cores"], facts["load_1min"]) == (cpu, 7, 1.26)
    first = program("bench")[1].splitlines()[0]
    assert first.startswith(f"{cpu}, 7 cores, load 1.26; python {facts['python']}, async_tnt ")

    def missing(*_, **__):
        raise FileNotFoundError

    monkeypatch.setattr(bench, "open", missing, raising=False)
    monkeypatch.setattr(bench.platform, "processor", lambda: "of another system")
    assert bench.machine()["cpu"] == "of another system"
