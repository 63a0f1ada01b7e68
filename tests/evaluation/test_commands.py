"""`async-tnt evaluate --out`: what it writes and prints, also after an interruption."""

import json
import os
import re
import shutil
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from evaluation.made_work import JOB
from made import random_events, random_model, thesis_model
from processes import started
from waiting import until

from async_tnt.cli.evaluate import lines_of
from async_tnt.evaluation.early import (
    LEVELS,
    decision_at,
    early_fields,
    early_report,
    every_us,
    moments,
)
from async_tnt.evaluation.job import job_of, task_of
from async_tnt.evaluation.processes import run_all
from async_tnt.evaluation.records import evaluate_recording, processor_of
from async_tnt.evaluation.results import collect
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixel_masks import save_mask
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.streaming.decision import in_windows
from async_tnt.volume.config import TNTConfig


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ended_in_the_middle_the_same_command_resumes(samples, tmp_path, program):
    folder = shutil.copytree(samples, tmp_path / "set", copy_function=shutil.copy2)
    out = tmp_path / "r.jsonl"
    # evaluating it takes until the signal
    shutil.copy2(samples / "4" / "00.bin", folder / "9" / "zz.bin")
    code = (
        "import sys; from evaluation.made_work import evaluate_or_sleep; from async_tnt.cli import "
        "evaluate, main\n"
        "evaluate.evaluate_recording = evaluate_or_sleep; sys.exit(main())"
    )
    words = "evaluate", "digits", folder, "--json"
    with started("-c", code, *words, "--out", out, "--workers", 2) as process:
        until(
            lambda: (
                process.poll() is not None or (out.exists() and out.read_bytes().count(b"\n") >= 20)
            )
        )
        process.send_signal(signal.SIGTERM)
        printed, message = process.communicate()
    assert printed == "" and out.read_bytes().count(b"\n") == 20
    line = r"async-tnt: interrupted: (19|20) of 21 recordings are done; the same command resumes\n$"
    # the 20th may not be counted
    assert process.returncode == 128 + signal.SIGTERM and re.search(line, message)
    code, printed, message = program(*words, "--out", out)
    assert code == 0 and f"{out}: 20 of 21 recordings are done, resuming" in message
    assert printed == program(*words, "--out", tmp_path / "plain.jsonl")[1] == program(*words)[1]
    assert out.read_bytes() == (tmp_path / "plain.jsonl").read_bytes()


def test_damaged_recordings_are_named_and_kept_as_errors_until_they_are_mended(
    samples, tmp_path, program
):
    folder = shutil.copytree(samples, tmp_path / "set")
    out = tmp_path / "r.jsonl"
    torn = folder / "3" / "torn.npz"
    empty = folder / "4" / "empty.bin"
    torn.write_bytes(b"PK torn")
    empty.write_bytes(b"")
    code, printed, message = program("evaluate", "digits", folder, "--out", out)
    assert code == 0
    assert message.count("\n") == 2
    assert "torn.npz" in message
    assert "empty.bin" in message
    assert "on 20 recordings" in printed
    errors = {
        r["recording"]: r["error"]
        for r in map(json.loads, out.read_text().splitlines())
        if r["error"]
    }
    assert errors.keys() == {"3/torn.npz", "4/empty.bin"}
    # named as in the results, once, and by no path
    assert errors["3/torn.npz"].startswith("3/torn.npz: not a readable NumPy file")
    for name, error in errors.items():
        assert error.count(name) == 1 and str(folder) not in error
    torn.unlink()
    shutil.copy(samples / "4" / "00.bin", empty)
    code, printed, message = program("evaluate", "digits", folder, "--out", out)
    assert code == 0
    assert "recordings that no longer exist are left out (1)" in message
    assert "on 21 recordings" in printed


def test_a_moment_knows_the_events_before_it_and_no_others():
    """A decision at an event exactly at a moment is known only at the next one."""
    times = [0, 10, 20, 29]
    window = [SimpleNamespace(window_start_us=5, time_us=5 + t) for t in times]
    expected = [None, window[0], window[0], window[1], window[1], window[3]]
    assert [decision_at(window, 5 + moment) for moment in (0, 1, 10, 11, 20, 30)] == expected


@pytest.mark.parametrize("level", LEVELS)
def test_a_level_of_confidence_is_reached_by_the_first_decision_that_has_it_exactly(level):
    config = TNTConfig(window_us=1000)
    at = {200: np.nextafter(level, 0), 410: level, 500: 1.0}
    window = [
        SimpleNamespace(
            window_start_us=5, time_us=5 + t, index=k, probability=p, trigger="every_us"
        )
        for k, (t, p) in enumerate(at.items())
    ]
    found = early_fields(5, window, config)
    assert found["confident"][LEVELS.index(level)] == 1
    assert found["confident_us"][LEVELS.index(level)] == 420  # when the event at 410 was known


@pytest.mark.parametrize("event_windows", [{"window_events": 7}, {"last_events": 7}], ids=str)
def test_in_windows_of_events_a_level_is_reached_at_the_newest_event(event_windows):
    """These windows have no moments, as they have no duration of their own."""
    config = TNTConfig(representation="count", **event_windows)
    assert every_us(config) is None and moments(config) == []
    decision = SimpleNamespace(time_us=107, index=2, probability=0.8, trigger="every_events")
    found = early_fields(100, [decision], config)
    assert found["decided_at"] == found["probability_at"] == []
    assert found["confident_us"] == [7, 7, 7, 7, -1, -1, -1]


def test_the_moments_of_windows_shorter_than_fifty_microseconds_lie_within_them():
    config = TNTConfig(window_us=20)
    assert every_us(config) == 1
    assert moments(config) == [5, 10, 15, *[20] * 7]


def decided(time_us, trigger="every_us", start_us=0, events=7):
    return SimpleNamespace(
        time_us=time_us, trigger=trigger, window_start_us=start_us, events=events
    )


@pytest.mark.parametrize(
    "config, decisions, expected",
    [
        (
            TNTConfig(window_us=100),
            [(3, "every_us", 3), (90, "window", 3), (110, "every_us", 103), (120, "end", 103)],
            [(3, 2), (103, 2)],
        ),
        # of a window that slides, stretches of its length from the first event on, without empty
        # ones; the oldest event of the window is another one at each decision
        (
            TNTConfig(representation="count", last_us=100),
            [(3, "every_us", 3), (102, "every_us", 9), (103, "every_us", 20), (450, "end", 400)],
            [(3, 2), (103, 1), (403, 1)],
        ),
        (
            TNTConfig(representation="count", last_events=7),
            [(3, "every_events", 1), (102, "every_events", 9), (103, "end", 20)],
            [(1, 1), (9, 1), (20, 1)],
        ),
        # no event has come since: the end says the same again
        (
            TNTConfig(representation="count", last_events=7),
            [(3, "every_events", 1), (102, "every_events", 9), (102, "end", 9)],
            [(1, 1), (9, 1)],
        ),
        # events of one time: each decision counts, and the end if the window has grown
        (
            TNTConfig(representation="count", last_events=7),
            [(3, "every_events", 1), (3, "every_events", 2), (3, "end", 2, 6)],
            [(1, 1), (2, 1), (2, 1)],
        ),
    ],
)
def test_the_windows_of_an_evaluation(config, decisions, expected):
    found = list(in_windows([decided(*decision) for decision in decisions], config))
    assert [(start_us, len(window)) for start_us, window in found] == expected


def test_what_is_decided_early_by_hand():
    """Two windows of 1 ms, decided every 20 us.

    The first one is of class 0 by three decisions and its end. Two of the decisions are on an
    event at a moment, and have exactly the probability of a level. The second window is of
    class 2, and never sure.
    """
    config = TNTConfig(window_us=1000)

    def window(*decisions):
        return [
            SimpleNamespace(window_start_us=7, time_us=7 + t, index=k, probability=p, trigger=why)
            for t, k, p, why in decisions
        ]

    sure = window(
        (0, 1, 0.5, "every_us"),
        (100, 0, 0.7, "every_us"),
        (250, 0, 0.9, "every_us"),
        (990, 2, 0.95, "end"),
    )
    unsure = window((300, 0, 0.4, "every_us"), (900, 2, 0.45, "window"))
    fields = [early_fields(7, one, config) for one in (sure, unsure)]
    assert fields[0]["decided_at"] == [1, 0, *[0] * 7, 2]
    assert fields[1]["decided_at"] == [-1] * 3 + [0] * 6 + [2]
    assert fields[0]["probability_at"] == [0.5, 0.7, *[0.9] * 7, 0.95]
    assert fields[1]["probability_at"][2:4] == [-1, 0.4]
    assert LEVELS == (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
    assert fields[0]["confident"] == [1, 0, 0, 0, 0, 2, -1] and fields[1]["confident"] == [-1] * 7
    # the fiftieth after the newest event, as an event at a fiftieth is decided at the next one; the
    # end at the end
    assert fields[0]["confident_us"] == [20, 120, 120, 260, 260, 1000, -1]
    assert fields[1]["confident_us"] == [-1] * 7
    records = [{name: [value] for name, value in one.items()} for one in fields]
    report = early_report(records, [0, 2], config)
    against_time = [
        (row["time_us"], row["accuracy"], row["decided"]) for row in report["accuracy_against_time"]
    ]
    assert against_time[:4] == [(100, 0, 0.5), (200, 0.5, 0.5), (300, 0.5, 0.5), (400, 0.5, 1)]
    assert against_time[-1] == (1000, 0.5, 1)
    found = {row["level"]: row for row in report["confidence"]}
    assert [found[level]["decided"] for level in LEVELS] == [0.5] * 6 + [0]
    assert [found[level]["accuracy"] for level in LEVELS] == [0, 1, 1, 1, 1, 0, None]
    # else at their ends
    assert [found[level]["window_accuracy"] for level in LEVELS] == [0.5, 1, 1, 1, 1, 0.5, 0.5]
    assert (found[0.6]["median_ms"], found[0.95]["p90_ms"], found[0.99]["median_ms"]) == (
        0.12,
        1.0,
        None,
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": "0.1"}, "a worker has async_tnt .*, but this program is 0.1"),
        ({}, "not the model that the job"),
    ],
)
def test_a_worker_refuses_the_job_of_another_program_or_model(changes, message):
    with pytest.raises(ValueError, match=message):
        processor_of(replace(JOB, **changes))


def test_a_thread_keeps_the_processor_of_a_job_and_shares_it_with_no_other_thread():
    """It is reset for each recording. Another job has another one."""
    from async_tnt import load_model

    job = job_of("digits", load_model("digits"), Pixels())
    processor, pixels = processor_of(job)
    processor.push(random_events(100))
    again = processor_of(job)
    assert again[0] is processor and again[1] is pixels
    assert processor.counts.received == 0
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(processor_of, job).result()[0] is not processor
    other = replace(job, pixels=Pixels(roi=(0, 0, 34, 34)))
    assert processor_of(other)[0] is not processor


def test_a_job_names_a_bundled_model_or_a_file_wherever_its_worker_starts(tmp_path, monkeypatch):
    """A task names its recording so, too."""
    from async_tnt import load_model

    monkeypatch.chdir(tmp_path)
    model = load_model("digits")
    model.save(tmp_path / "m.safetensors")
    assert job_of("digits", model, Pixels()).model == "digits"
    job = job_of("m.safetensors", model, Pixels())
    assert job.model == str(tmp_path / "m.safetensors")
    assert job.id == job_of("digits", model, Pixels()).id  # the same weights
    Path("3").mkdir()
    Path("3", "a.bin").write_bytes(b"12345")
    task = task_of("3/a.bin", Path("3", "a.bin"), job, "3", (5, 9))
    assert (task.path, task.recording) == (tmp_path / "3" / "a.bin", "3/a.bin")
    assert (task.label, task.between_us, task.bytes) == ("3", (5, 9), 5)
    gone = task_of("3/b.bin", Path("3", "b.bin"), job, "3", (5, 9))
    assert (gone.label, gone.between_us) == ("3", (5, 9))
    assert gone.bytes is None and gone.modified_ns is None
    # a file's name need not be text
    assert task_of("3/\udcff.bin", Path("3", "b.bin"), job).recording == r"3/\udcff.bin"


@pytest.mark.parametrize("option", [{"columns": "xypt"}, {"topic": "/left"}], ids=str)
def test_results_of_files_that_were_read_otherwise_are_refused(samples, tmp_path, option):
    """The events of a file depend on it."""
    from async_tnt import load_model

    model = load_model("digits")
    plain, read_so = (
        job_of("digits", model, Pixels(), ReadOptions(**some)) for some in ({}, option)
    )
    path = samples / "3" / "00.bin"
    out = tmp_path / "r.jsonl"
    run = partial(run_all, workers=1)
    collect(evaluate_recording, [task_of("3/00.bin", path, plain, "3")], run, out)
    before = out.read_bytes()
    with pytest.raises(ValueError, match="was made with another model, version or selection"):
        collect(evaluate_recording, [task_of("3/00.bin", path, read_so, "3")], run, out)
    assert out.read_bytes() == before


def test_a_report_says_what_each_class_is_confused_with_and_when_it_is_sure():
    """The most frequent first, three at most; a class without recordings has no accuracy."""
    report = {
        "accuracy": 0.4,
        "window_accuracy": 0.25,
        "recordings": 2010,
        "windows": 4020,
        "classes": ["a", "b", "c", "d", "e"],
        "per_class": {"a": 0.4, "b": None, "c": 0.0, "d": 1.0, "e": 0.5},
        "confusion": [
            [4, 1, 2, 0, 3],
            [0, 0, 0, 0, 0],
            [1, 1, 0, 1, 2],
            [0, 0, 0, 6, 0],
            [0, 5, 0, 0, 5],
        ],
        "window_confusion": np.diag([1200, 0, 3, 4, 5]) + 1,
        "accuracy_against_time": [{"time_us": 10_500, "accuracy": 0.25, "decided": 0.5}],
        "confidence": [
            {
                "level": 0.9,
                "accuracy": 0.75,
                "decided": 0.5,
                "window_accuracy": 0.625,
                "median_ms": 20.06,
                "p90_ms": 105.0,
            },
            {
                "level": 0.99,
                "accuracy": None,
                "decided": 0.0,
                "window_accuracy": 0.5,
                "median_ms": None,
                "p90_ms": None,
            },
        ],
        "calibration_error": 0.0625,
    }
    report["window_confusion"] = report["window_confusion"].tolist()
    assert [" ".join(line.split()) for line in lines_of(report)] == [
        "accuracy 0.4000 on 2010 recordings, 0.2500 on 4020 windows",
        "",
        "class accuracy recordings windows right confused with",
        "a 0.400 10 1,201 of 1,205 e (3), c (2), b (1)",
        "b - 0 1 of 5",
        "c 0.000 5 4 of 8 e (2), d (1), b (1)",
        "d 1.000 6 5 of 9",
        "e 0.500 10 6 of 10 b (5)",
        "",
        "ms into the window accuracy decided",
        "10.5 0.250 0.500",
        "",
        "first decision at accuracy decided all windows ms: median, 90 %",
        "0.9 0.750 0.500 0.625 20.1, 105.0",
        "0.99 - 0.000 0.500",
        "",
        "expected calibration error 0.062",
    ]


def test_another_model_of_the_same_name_is_refused(samples, tmp_path, program):
    from async_tnt import load_model

    model = load_model("digits")
    model.save(tmp_path / "m.safetensors")
    words = "evaluate", tmp_path / "m.safetensors", samples, "--out", tmp_path / "r.jsonl"
    assert program(*words)[0] == 0
    thesis_model(model.config, model.weights, model.classes, {"other": "record"}).save(
        tmp_path / "m.safetensors"
    )
    assert program(*words)[0] == 0  # the training record changes no decision
    weights = {**model.weights, "fc2.bias": model.weights["fc2.bias"] + np.float32(1)}
    thesis_model(model.config, weights, model.classes).save(tmp_path / "m.safetensors")
    code, _, message = program(*words)
    assert code == 2 and "was made with another model, version or" in message
    (tmp_path / "r.jsonl").unlink()
    assert program(*words)[0] == 0


def test_results_of_whatever_changes_a_decision_are_never_mixed(tmp_path, program):
    """Each selection of pixels and each part of a model; a training record changes no decision."""
    folder = tmp_path / "set" / "0"
    folder.mkdir(parents=True)
    np.save(folder / "a.npy", random_events(60))
    for name, row in (("upper", 3), ("lower", 30)):
        save_mask(tmp_path / f"{name}.npy", np.arange(34)[:, None] + np.zeros(34, int) == row)
    base = replace(random_model(TNTConfig(window_us=50_000), classes=3), classes=("0", "1", "2"))
    other_weights = {name: w + (w.ndim == 1) for name, w in base.weights.items()}
    models = {
        "base": base,
        "weights": replace(base, weights=other_weights),
        "classes": replace(base, classes=("0", "1", "two")),
        "configuration": replace(base, config=base.config.replace(landmark="center")),
    }
    for name, model in models.items():
        model.save(tmp_path / f"{name}.safetensors")
    selections = [
        "",
        "--roi 0,0,20,20",
        "--roi 1,0,20,20",
        "--roi 0,0,34,34",
        "--roi 0,0,34,34 --crop --sensor 34x34",
    ]
    selections += [
        "--sensor 34x34",
        *(f"--mask {tmp_path / name}.npy" for name in ("upper", "lower")),
    ]
    kinds = [("base", options) for options in selections] + [
        (name, "") for name in list(models)[1:]
    ]
    settings = set()
    for model, options in kinds:
        words = (
            "evaluate",
            tmp_path / f"{model}.safetensors",
            folder.parent,
            *options.split(),
            "--out",
        )
        out = tmp_path / f"{len(settings)}.jsonl"
        assert program(*words, out)[0] == 0
        settings.add(json.loads(out.read_text())["settings"])
        for earlier in range(len(settings) - 1):
            code, _, message = program(*words, tmp_path / f"{earlier}.jsonl")
            assert code == 2
            assert "was made with another model, version or selection of pixels" in message
    assert len(settings) == len(kinds)
    replace(base, record={"other": "record"}).save(tmp_path / "base.safetensors")
    words = "evaluate", tmp_path / "base.safetensors", folder.parent, "--out", tmp_path / "0.jsonl"
    assert program(*words)[0] == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("evaluate digits SET --out r.jsonl --workers 2 --dask tcp://a:1", "give one of them"),
        ("evaluate digits SET --out r.csv", "r.csv: its name must end in .jsonl"),
        ("evaluate digits SET --out nowhere/r.jsonl", "no folder nowhere to write r.jsonl to"),
        ("evaluate digits none --out r.jsonl", "no folder none"),
        ("evaluate digits EMPTY --out r.jsonl", "no class folders"),
        (
            "evaluate digits SET --out r.jsonl --dask tcp://127.0.0.1:9",
            "pip install 'async_tnt[cluster]'",
        ),  # without Dask
    ],
)
def test_what_cannot_be_done_is_one_line_and_exit_code_2(
    words, text, samples, tmp_path, program, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "distributed", None)
    (tmp_path / "empty").mkdir()
    places = {"SET": samples, "EMPTY": tmp_path / "empty"}
    code, printed, message = program(*(places.get(word, word) for word in words.split()))
    assert code == 2 and text in message and message.count("\n") == 1 and printed == "", message
    assert not list(tmp_path.glob("r.*"))
