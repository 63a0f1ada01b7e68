"""`async-tnt evaluate`: its numbers against an independent count, and its messages."""

import json

import numpy as np
import pytest
from made import random_model, thesis_model
from training.gestures import bar, write, write_set

from async_tnt import Processor, TNTConfig
from async_tnt.evaluation.scores import score_recordings
from async_tnt.sources.files.recording import READERS, open_recording

CLASSES = ("flat", "slanted", "upright")


@pytest.fixture(scope="module")
def model():
    """A random network whose decisions vary."""
    made = random_model(TNTConfig(sensor=(128, 128), window_us=60_000), classes=3, seed=3)
    weights = {name: w * (60 if name == "fc2.weight" else 1) for name, w in made.weights.items()}
    return thesis_model(made.config, weights, CLASSES)


@pytest.fixture(scope="module")
def saved(model, tmp_path_factory):
    return model.save(tmp_path_factory.mktemp("model") / "m.safetensors")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Recordings shorter and longer than a window, and some with a pause of many windows."""
    folder = tmp_path_factory.mktemp("set")
    for name, n in (("upright", 5), ("flat", 4), ("slanted", 2)):
        for k in range(n):
            events = bar(
                name, k, duration_us=(20_000, 100_000, 200_000)[k % 3], start_us=10**12 * (k % 2)
            )
            if k == 1:
                events["t"][700:] += 1_000_000
            write(folder / "Test" / name / f"{k}{('.npz', '.npy')[k % 2]}", events)
    # Train is not evaluated.
    write(folder / "Train" / "flat" / "0.npy", bar("flat", 9))
    return folder


def decided_by_hand(model, start_us, events):
    """A plain decision: by a new Processor without triggers."""
    processor = Processor(model, start_us=start_us)
    processor.push(events)
    return processor.fire()


@pytest.fixture(scope="module")
def windows(model, dataset):
    """Recording, label, start, events and decisions of each window.

    There is a decision at each fiftieth of a window that brought events.
    """
    found = []
    for path in sorted(dataset.glob("Test/*/*")):
        events = open_recording(path).read()
        since = (events["t"] - events["t"][0]) // 60_000
        for k in np.unique(since):
            start_us = int(events["t"][0] + 60_000 * k)
            inside = events[since == k]
            sizes = np.unique(np.searchsorted(inside["t"], start_us + 1_200 * np.arange(1, 51)))
            decisions = [decided_by_hand(model, start_us, inside[:n]) for n in sizes if n > 0]
            found.append((path, CLASSES.index(path.parent.name), start_us, inside, decisions))
    return found


def test_the_numbers_are_those_of_an_independent_count(saved, dataset, windows, program):
    code, printed, err = program("evaluate", saved, dataset, "--json")
    report = json.loads(printed)
    assert (code, err) == (0, "")
    by_recording = np.zeros((3, 3), int)
    by_window = np.zeros((3, 3), int)
    totals = {}
    right = np.zeros(10)
    decided = np.zeros(10)
    for path, label, start_us, _, decisions in windows:
        for k in range(10):
            for decision in [d for d in decisions if d.time_us < start_us + 6_000 * (k + 1)][-1:]:
                decided[k] += 1 / len(windows)
                right[k] += (decision.index == label) / len(windows)
        totals[path, label] = totals.get((path, label), 0) + decisions[-1].probabilities
        by_window[label, decisions[-1].index] += 1
    for (_, label), total in totals.items():
        by_recording[label, total.argmax()] += 1
    assert report["classes"] == list(CLASSES)
    assert len(np.unique(by_window.argmax(1))) > 1 or (by_window > 0).sum() > 3  # decisions vary
    np.testing.assert_array_equal(report["confusion"], by_recording)
    np.testing.assert_array_equal(report["window_confusion"], by_window)
    assert report["accuracy"] == pytest.approx(np.trace(by_recording) / 11)
    assert report["window_accuracy"] == pytest.approx(np.trace(by_window) / by_window.sum())
    shares = np.diag(by_recording) / by_recording.sum(1)
    assert report["per_class"] == pytest.approx(dict(zip(CLASSES, shares, strict=True)))
    assert report["balanced_accuracy"] == pytest.approx(shares.mean())
    against_time = report["accuracy_against_time"]
    assert [row["time_us"] for row in against_time] == [6_000 * (k + 1) for k in range(10)]
    np.testing.assert_allclose([row["accuracy"] for row in against_time], right, atol=1e-12)
    np.testing.assert_allclose([row["decided"] for row in against_time], decided, atol=1e-12)
    assert report["events"] == 11 * 1500 and report["decisions"] >= report["windows"]


def test_classes_without_recordings_do_not_count_in_the_balance():
    windows = [
        np.array([[0.9, 0.1, 0.0]]),
        np.array([[0.2, 0.8, 0.0]]),
        np.array([[0.1, 0.9, 0.0]]),
    ]
    scores = score_recordings(["a", "b", "never there"], [0, 0, 1], windows)
    assert scores["per_class"] == {"a": 0.5, "b": 1.0, "never there": None}
    assert scores["balanced_accuracy"] == 0.75


def test_early_decisions_are_those_of_an_independent_count(saved, dataset, windows, program):
    report = json.loads(program("evaluate", saved, dataset, "--json")[1])
    windows = [(label, decisions) for _, label, *_, decisions in windows]
    assert [row["level"] for row in report["confidence"]] == [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99]
    for row in report["confidence"]:
        first = [
            (label, next((d for d in window if d.probability >= row["level"]), None))
            for label, window in windows
        ]
        sure = [(label, d) for label, d in first if d is not None]
        assert row["decided"] == pytest.approx(len(sure) / len(windows))
        at_last = [
            window[-1] if d is None else d
            for (_, d), (_, window) in zip(first, windows, strict=True)
        ]
        right = [d.index == label for d, (label, _) in zip(at_last, windows, strict=True)]
        assert row["window_accuracy"] == pytest.approx(np.mean(right))
        if not sure:
            assert row["accuracy"] is None and row["median_ms"] is None and row["p90_ms"] is None
            continue
        assert row["accuracy"] == pytest.approx(np.mean([d.index == label for label, d in sure]))
        # no event comes after it: decided at the window's end
        last = [window[-1] for _, window in windows]
        ms = [
            60 if d in last else 1.2 * ((d.time_us - d.window_start_us) // 1_200 + 1)
            for _, d in sure
        ]
        assert (row["median_ms"], row["p90_ms"]) == pytest.approx(
            (np.median(ms), np.quantile(ms, 0.9))
        )
    decided = [row["decided"] for row in report["confidence"]]
    assert decided[0] == 1 and decided[2] > 0 and decided[-1] == 0


EARLY = "decided_at", "probability_at", "confident", "confident_us"
LEVELS = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99]


def record_by_hand(model, events):
    """The record of a recording that is in order, except for events that come too late."""
    window_us = model.config.window_us
    step_us = window_us // 50
    number = (events["t"] - events["t"][0]) // window_us
    in_time = number == np.maximum.accumulate(number)
    lists = "window_start_us", "window_probabilities", *EARLY
    record = {name: [] for name in lists} | {"decisions": 0}
    for k in np.unique(number[in_time]).tolist():
        start_us = int(events["t"][0]) + k * window_us
        inside = events[in_time & (number == k)]
        since = inside["t"] - start_us

        # number of events of the window -> the decision on these
        by_size = {0: None}
        before = 0
        processor = Processor(model, start_us=start_us)
        cuts = np.searchsorted(since, range(step_us, window_us, step_us))
        for n in np.unique([*cuts, len(inside)]).tolist():
            processor.push(inside[before:n])
            if n:
                by_size[n] = processor.fire()
            before = n

        # In the last window, time ends with the last event.
        passed = int(since[-1]) if k == number.max() else window_us - 1
        moments = [m for m in range(step_us, passed + 1, step_us) if m < window_us]
        sizes = np.searchsorted(since, moments).tolist()
        sizes_before = [0, *sizes][: len(sizes)]
        made = [
            (moment, by_size[n])
            for moment, n, n_before in zip(moments, sizes, sizes_before, strict=True)
            if n > n_before
        ]
        made.append((window_us, by_size[len(inside)]))
        tenths = [*(5 * step_us * j for j in range(1, 10)), window_us]
        at = [by_size[n] for n in np.searchsorted(since, tenths).tolist()]
        first = []
        for level in LEVELS:
            reached = [(moment, d) for moment, d in made if d.probability >= level]
            first.append(reached[0] if reached else (-1, None))

        record["window_start_us"].append(start_us)
        record["window_probabilities"].append(made[-1][1].probabilities.tolist())
        record["decided_at"].append([-1 if d is None else d.index for d in at])
        record["probability_at"].append([-1.0 if d is None else d.probability for d in at])
        record["confident"].append([-1 if d is None else d.index for _, d in first])
        record["confident_us"].append([m for m, _ in first])
        record["decisions"] += len(made)
    mean = np.mean(record["window_probabilities"], axis=0)
    record |= {
        "events": len(events),
        "late": int((~in_time).sum()),
        "label": CLASSES[mean.argmax()],
    }
    return record | {"probabilities": mean.tolist(), "error": None, "class": "flat"}


@pytest.mark.parametrize("window_us", [60_000, 60_049, 137])
def test_a_record_is_what_an_independent_count_of_its_recording_gives(
    model, window_us, tmp_path, program
):
    """The recordings have pauses, and late events.

    In some windows a fiftieth is no whole number of microseconds.
    """
    of_window = thesis_model(model.config.replace(window_us=window_us), model.weights, CLASSES)
    saved = of_window.save(tmp_path / "m.safetensors")
    kept = []
    for seed in range(3):
        events = bar(
            ("flat", "upright", "slanted")[seed],
            seed,
            n=700,
            duration_us=4 * window_us,
            start_us=10**9,
        )
        events["t"][300:] += (0, 3 * window_us + 5, 40 * window_us)[seed]
        events["t"][310::90] -= 2 * window_us
        events["t"] = np.maximum(events["t"], 10**9)
        write(tmp_path / "set" / "flat" / f"{seed}.npy", events)
        kept.append(record_by_hand(of_window, events))
    out = tmp_path / "r.jsonl"
    code, printed, _ = program("evaluate", saved, tmp_path / "set", "--out", out, "--json")
    records = [json.loads(line) for line in out.read_text().splitlines()]
    report = json.loads(printed)
    names = [record["recording"] for record in records]
    assert code == 0 and names == [f"flat/{k}.npy" for k in range(3)]
    for record, expected in zip(records, kept, strict=True):
        assert {name: record[name] for name in expected} == expected
    for name in ("decisions", "events", "late"):
        assert report[name] == sum(record[name] for record in kept)
    decided = np.concatenate([np.reshape(record["decided_at"], -1) for record in kept])
    probability = np.concatenate([np.reshape(record["probability_at"], -1) for record in kept])
    probability = probability[decided >= 0]
    right = decided[decided >= 0] == CLASSES.index("flat")
    tenth = np.minimum(probability * 10, 9).astype(int)
    assert 0 < len(right) < len(decided)
    of_tenths = [(tenth == k) for k in range(10) if (tenth == k).any()]
    assert [row["decisions"] for row in report["calibration"]] == [some.sum() for some in of_tenths]
    for name, values in (("probability", probability), ("accuracy", right)):
        assert [row[name] for row in report["calibration"]] == pytest.approx(
            [values[some].mean() for some in of_tenths]
        )
    errors = [
        some.mean() * abs(probability[some].mean() - right[some].mean()) for some in of_tenths
    ]
    assert report["calibration_error"] == pytest.approx(sum(errors))
    assert report["late"] > 0
    assert set(np.concatenate([np.ravel(record["confident_us"]) for record in kept])) > {-1}


def test_windows_of_events_are_counted_apart_and_have_no_accuracy_against_time(
    model, program, tmp_path
):
    """Two may begin at the same moment."""
    of_events = thesis_model(model.config.replace(window_events=10), model.weights, CLASSES)
    events = bar("flat", 0)[:200]
    events["t"][80:120] = events["t"][80]
    write(tmp_path / "set" / "Test" / "flat" / "a.npy", events)
    words = "evaluate", of_events.save(tmp_path / "m.safetensors"), tmp_path / "set"
    report = json.loads(program(*words, "--json")[1])
    assert report["windows"] == report["decisions"] == 20
    assert report["accuracy_against_time"] == report["confidence"] == []
    code, printed, err = program(*words)
    assert (code, err) == (0, "")
    assert "20 windows" in printed
    assert "ms into the window" not in printed


def test_the_text_names_classes_and_times(saved, dataset, program):
    code, printed, _ = program("evaluate", saved, dataset)
    assert code == 0 and "on 11 recordings" in printed
    for line in ("flat ", "slanted ", "upright ", "6 ", "60 "):
        assert any(row.startswith(line) for row in printed.splitlines()), line


def test_late_events_and_the_pixels_that_count_are_told(saved, tmp_path, program):
    """Where to look for them, too; no line without any."""
    events = bar("flat", 0, n=700, duration_us=180_000)
    events["t"][400:403] = 5
    write(tmp_path / "set" / "flat" / "a.npy", events)
    out = tmp_path / "r.jsonl"
    for words, where in (((), "the records of --out"), (("--out", out), str(out))):
        code, printed, err = program("evaluate", saved, tmp_path / "set", "--json", *words)
        assert (
            code == 0 and json.loads(printed)["late"] == 3 and "pixels" not in json.loads(printed)
        )
        assert err == (
            f"async-tnt: {tmp_path / 'set'}: 3 of 700 events were too late and dropped (see `late` "
            f"in {where})\n"
        )
    write(tmp_path / "set" / "flat" / "a.npy", np.sort(events, order="t"))
    code, printed, err = program(
        "evaluate", saved, tmp_path / "set", "--json", "--roi", "0,0,99,128"
    )
    assert (code, err) == (0, "") and json.loads(printed)["pixels"] == {"roi": "0,0,99,128"}


def test_skipped_recordings_are_named_and_strict_refuses_them(saved, tmp_path, program):
    """A damaged one is skipped as a whole: its first events alone might show something else."""
    folder = write_set(tmp_path / "set", {"upright": 2, "flat": 2})
    (folder / "flat" / "torn.npz").write_bytes(b"PK torn")
    write(folder / "flat" / "silent.npz", bar("flat", 0)[:0])
    write(folder / "flat" / "wide.npz", bar("flat", 0), sensor=(640, 480))
    with write(folder / "flat" / "end.csv", bar("flat", 0)).open("a") as file:
        file.write("torn,1\n")
    (folder / "slanted").mkdir()
    code, printed, err = program("evaluate", saved, folder, "--json")
    report = json.loads(printed)
    assert code == 0 and report["recordings"] == 4 and report["per_class"]["slanted"] is None
    assert err.count("\n") == 4
    assert err.count("async-tnt: skipped: ") == 4
    assert "`roi` X,Y,128,128" in err
    for name, why in (
        ("torn.npz", "not a readable NumPy file"),
        ("silent.npz", "no events"),
        ("wide.npz", "640x480 pixels, but the model is for 128x128"),
        ("end.csv", "damaged recording"),
    ):
        assert any(name in line and why in line for line in report["skipped"]), report["skipped"]
    assert program("evaluate", saved, folder, "--strict")[0] == 2
    for name in ("torn.npz", "silent.npz", "wide.npz", "end.csv"):
        (folder / "flat" / name).unlink()
    assert program("evaluate", saved, folder, "--strict")[0] == 0


def needs_more_memory_than_any_machine_addresses():
    np.empty(1 << 57)


def fails_by(error):
    def fails():
        raise error

    return fails


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (needs_more_memory_than_any_machine_addresses, "Unable to allocate 1.00 EiB"),
        (fails_by(MemoryError()), "MemoryError"),
        (fails_by(ValueError("torn at byte 9")), "torn at byte 9"),
        (fails_by(TypeError("`t` must be whole numbers")), "`t` must be whole numbers"),
        (fails_by(OSError(5, "Input/output error", "/disk/a.own")), "Input/output error"),
        (fails_by(OSError("the disk is gone")), "the disk is gone"),
    ],
)
def test_a_recording_of_a_format_of_ones_own_is_skipped_whatever_its_reader_raises(
    read, message, saved, tmp_path, program, monkeypatch
):
    monkeypatch.setitem(READERS, ".own", lambda path, options: read())
    folder = write_set(tmp_path / "set", {"upright": 1, "flat": 1})
    (folder / "flat" / "a.own").touch()
    code, printed, err = program("evaluate", saved, folder, "--json")
    assert code == 0 and json.loads(printed)["recordings"] == 2
    assert err.count("\n") == 1 and f"skipped: flat/a.own: {message}" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("MODEL", "unknown"),
            "the model does not know class jump, wave; it knows flat, slanted, upright",
        ),
        (("MODEL", "damaged"), "none of 1 recordings can be evaluated; "),
        (("MODEL", "empty"), "no recordings in its class folders (upright)"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(words, message, saved, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ("unknown/upright/a.npz", "unknown/jump/a.npz", "unknown/wave/a.npz"):
        write(tmp_path / path, bar("flat", 0))
    for name in ("damaged", "empty"):
        (tmp_path / name / "upright").mkdir(parents=True)
    (tmp_path / "damaged" / "upright" / "0.npy").write_bytes(b"torn")
    code, printed, err = program(
        "evaluate", *(saved if word == "MODEL" else word for word in words)
    )
    assert code == 2 and message in err and err.count("\n") == 1 and printed == "", err
