"""Early decisions: which one counts, when it fell, what it took; and the script that measures them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from bench.scripts import load_benchmark
from made import events_of

from async_tnt import CompiledClassifier, Decision, LeakyIntegrator, Processor, load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings

early = load_benchmark("measure_early")
WINDOW_US = 105_000


def decision(time_us: int, trigger: str, index: int = 3, events: int = 10, start_us: int = 210_000) -> Decision:
    complete = trigger in ("window", "confidence")
    one = np.zeros(10)
    one[index] = 1.0
    logits = one.astype(np.float32)
    return Decision(str(index), index, one, logits, start_us, start_us + time_us, events, complete, trigger)


def judged(decisions, **settings):
    return early.early_decision(decisions, settings, WINDOW_US, truth=3)


def test_a_fixed_moment_counts_from_itself_and_not_from_its_newest_event():
    found = judged(
        [decision(19_000, "every_us", 5), decision(39_999, "every_us"), decision(104_000, "window")], every_us=20_000
    )
    assert (found.right, found.ms, found.by_trigger) == (False, 20.0, True)
    assert (found.evaluations_until, found.evaluations, found.emitted) == (1, 3, 3)
    quiet = judged([decision(40_000, "every_us"), decision(104_000, "window")], every_us=20_000)
    assert quiet.ms == 60.0  # an event at 40 ms is not among those before that moment


def test_confidence_counts_where_it_closed_the_window():
    found = judged(
        [decision(900, "every_us", 1), decision(1500, "every_us", 2), decision(2700, "confidence")],
        confidence=0.9,
        every_us=1000,
    )
    assert (found.right, found.ms, found.evaluations_until, found.evaluations) == (True, 3.0, 3, 3)
    never = judged([decision(900, "every_us", 1), decision(104_000, "window")], confidence=0.9, every_us=1000)
    assert (never.right, never.ms, never.by_trigger, never.evaluations_until) == (True, 105.0, False, 2)


def test_confidence_alone_asks_at_every_event_and_once_more_at_the_end():
    sure = judged([decision(31_234, "confidence", events=245)], confidence=0.9)
    assert (sure.ms, sure.evaluations_until, sure.evaluations, sure.emitted) == (31.234, 245, 245, 1)
    for trigger in ("window", "end"):
        never = judged([decision(104_000, trigger, 7, events=1400)], confidence=0.9)
        assert (never.right, never.ms, never.by_trigger, never.evaluations) == (False, 105.0, False, 1401)


@pytest.mark.parametrize(
    "trigger, settings", [("every_events", {"every_events": 10}), ("activity", {"activity": LeakyIntegrator(9, 100)})]
)
def test_events_count_from_their_own_time(trigger, settings):
    found = judged([decision(1234, trigger, 4), decision(1300, trigger), decision(9000, "end")], **settings)
    assert (found.right, found.ms, found.evaluations_until, found.emitted) == (False, 1.234, 1, 3)


@pytest.mark.parametrize(
    "settings",
    [
        {"confidence": 0.5},
        {"confidence": 0.95},
        {"confidence": 0.9, "every_us": 3000},
        {"every_events": 200},
        {"every_us": 30_000},
        {},
    ],
    ids=str,
)
def test_the_evaluations_are_those_that_a_counting_classifier_counts(settings):
    model = load_model("digits")
    events = open_recording(sample_recordings()[3]).read()
    network, asked = CompiledClassifier(model), []

    def counting(volume):
        asked.append(None)
        return network(volume)

    processor = Processor(model, classifier=counting, start_us=0, **settings)
    processor.push(events)
    processor.finish()
    found = early.early_decisions(model, [(3, events)], settings)
    assert len(found) == 3
    assert sum(e.evaluations for e in found) == len(asked)


def test_summaries_by_hand():
    rows = [
        early.Early(True, 10.0, 20, True, 1, 3, 4),
        early.Early(False, 30.0, 60, True, 3, 5, 6),
        early.Early(True, 105.0, 100, False, 8, 8, 2),
    ]
    found = early.summary(rows)
    assert found["windows"] == 3 and found["accuracy"] == pytest.approx(2 / 3)
    assert (found["mean_ms"], found["median_ms"], found["mean_events"]) == (pytest.approx(145 / 3), 30.0, 60.0)
    assert found["at_end"] == pytest.approx(1 / 3) and found["fewest_events"] == 20
    assert found["soon"] == pytest.approx(1 / 3) and found["soon_accuracy"] == 1.0
    assert (found["evaluations_until"], found["evaluations"], found["emitted"]) == (4.0, pytest.approx(16 / 3), 4.0)
    assert early.summary(rows[1:])["soon_accuracy"] is None


def test_events_after_the_third_saccade_are_no_window():
    events = events_of([1000, 106_000, 211_000, 316_000], [3] * 4, [4] * 4, [1] * 4)
    assert len(early.early_decisions(load_model("digits"), [(0, events)], {})) == 3


def test_every_setting_is_one_that_a_processor_takes():
    model = load_model("digits")
    for group in early.all_settings(WINDOW_US).values():
        for settings in group:
            Processor(model, **settings)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The bundled samples as a folder of recordings."""
    folder = tmp_path_factory.mktemp("Test")
    for digit, path in sample_recordings().items():
        (folder / str(digit)).mkdir()
        for k in range(2):
            shutil.copy(path, folder / str(digit) / f"{k:05}.bin")
    return folder


def test_recordings_are_labelled_by_their_folder(folder):
    assert [digit for digit, _ in early.labelled(folder, None)] == [d for d in range(10) for _ in range(2)]
    assert [digit for digit, _ in early.labelled(folder, 10)] == list(range(10))
    digit, events = early.labelled(folder, 10)[7]
    assert digit == 7 and np.array_equal(events, open_recording(sample_recordings()[7]).read())
    with pytest.raises(ValueError, match=r"no recordings .*nothing/<digit>/\*\.bin: FOLDER or \$TNT_DATA"):
        early.labelled(folder / "nothing", None)


def test_what_the_network_says_of_noise_is_no_accuracy():
    rows = early.on_noise(load_model("digits"), 900, 2)
    assert [r["windows"] for r in rows] == [6] * len(early.LEVELS)
    shares = [r["closed_early"] for r in rows]
    assert shares == sorted(shares, reverse=True) and shares[-1] == 0 and rows[-1]["mean_ms"] is None
    assert 0 < shares[0] <= 1 and 0 < rows[0]["mean_ms"] < 105


def test_the_script_measures_draws_and_writes(folder, tmp_path, capsys):
    script = load_benchmark("early")
    target, picture = tmp_path / "early.json", tmp_path / "early.png"
    words = [str(folder), "--recordings", "10", "--workers", "1", "--json", str(target), "--picture", str(picture)]
    assert script.main(words) == 0
    text = capsys.readouterr().out
    report = json.loads(target.read_text(encoding="utf-8"))
    assert report["recordings"] == 10 and report["machine"]["cpu"]
    groups = early.all_settings(WINDOW_US)
    assert {name: len(rows) for name, rows in report["results"].items()} == {k: len(v) for k, v in groups.items()}
    for group in report["results"].values():
        for row in group:
            assert row["windows"] == 30 and script.words(row["settings"]) in text
    moments = {row["settings"].get("every_us"): row for row in report["results"]["moment"]}
    assert moments[10_000]["mean_ms"] == 10.0 and moments[None]["mean_ms"] == 105.0
    assert moments[None]["accuracy"] > 0.9 > moments[10_000]["accuracy"]
    levels = [row["mean_ms"] for row in report["results"]["confidence"]]
    assert levels == sorted(levels)
    assert 0.1 <= report["of_nothing"] < 0.3
    assert picture.stat().st_size > 5000
    again = tmp_path / "again.png"
    assert script.main(["--from", str(target), "--picture", str(again)]) == 0
    assert again.read_bytes() == picture.read_bytes()


@pytest.mark.parametrize(
    "words, message",
    [
        (["no_such_folder"], r"no recordings no_such_folder/<digit>/\*\.bin"),
        (["--recordings", "0"], "--recordings must be at least 1, got 0"),
        (["--workers", "0"], "--workers must be at least 1, got 0"),
        (["--picture", "early.gif"], "must end in .png, .svg, .pdf, got early.gif"),
        (["--from", "no_such.json"], "no_such.json"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_wrong_words_are_bad_usage(words, message, capsys):
    with pytest.raises(SystemExit, match="2"):
        load_benchmark("early").main(words)
    import re

    assert re.search(message, capsys.readouterr().err)
