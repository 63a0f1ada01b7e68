"""`async-tnt run`: decisions of recordings, and what it reports about them."""

import json
import sys

import numpy as np
import pytest
from made import random_events, random_model

from async_tnt import Processor, TNTConfig, load_model
from async_tnt.cli.output import DecisionLines
from async_tnt.sources.files.recording import READERS, open_recording, sample_recordings
from async_tnt.streaming.decision import Decision, Object

SAMPLES = sample_recordings()


def test_it_classifies_the_bundled_samples(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    expected = [f"{digit}.bin: {digit}" for digit in range(10)]
    for words in ((), ("samples",)):
        _, printed, _ = program("run", *words)
        found = [line for line in printed.splitlines() if "mean probability" in line]
        assert [line.split(" (")[0] for line in found] == expected
    (tmp_path / "samples").mkdir()  # a file or folder of that name comes first
    assert "samples is a folder, expected a recording" in program("run", "samples")[2]


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ("--every-us 20000", {"every_us": 20_000}),
        ("--start-us 0", {"start_us": 0}),
        ("--every-events 100 --confidence .95", {"every_events": 100, "confidence": 0.95}),
    ],
)
@pytest.mark.parametrize("latency", [[], ["--latency"]], ids=["packets", "single events"])
def test_options_are_the_settings_of_the_processor(program, options, settings, latency):
    code, lines, message = program("run", "--json", *options.split(), *latency, SAMPLES[7])
    assert code == 0, message
    processor = Processor(load_model("digits"), **settings)
    expected = processor.push(open_recording(SAMPLES[7]).read()) + processor.finish()
    triggers = set()
    assert expected
    for line, decision in zip(lines.splitlines(), expected, strict=True):
        printed = json.loads(line)
        triggers.add(printed["trigger"])
        assert printed.pop("recording") == str(SAMPLES[7])
        if latency:
            assert printed.pop("latency_us") > 0
        assert printed == decision.to_dict()
    assert "start_us" in settings or triggers - {"window", "end"}


@pytest.mark.parametrize(
    ("window", "settings"),
    [
        ({"last_us": 40_000}, {"every_us": 40_000}),
        ({"last_events": 500}, {"every_events": 500}),
    ],
    ids=str,
)
def test_a_window_that_slides_decides_once_in_its_length(program, window, settings, tmp_path):
    """Without an option there would be no decision before the recording's end."""
    model = random_model(TNTConfig(representation="count", **window))
    path = tmp_path / "m.safetensors"
    model.save(path)
    for options, triggers in (([], settings), (["--every-events", 90], {"every_events": 90})):
        _, lines, _ = program("run", "--json", "--model", path, *options, SAMPLES[7])
        processor = Processor(model, **triggers)
        expected = processor.push(open_recording(SAMPLES[7]).read()) + processor.finish()
        printed = [json.loads(line) for line in lines.splitlines()]
        assert [line["time_us"] for line in printed] == [d.time_us for d in expected]
        assert len(expected) > 3


def test_several_recordings_have_one_header_and_a_line_of_their_class_each(program):
    code, printed, _ = program("run", SAMPLES[7], SAMPLES[3], SAMPLES[7])
    lines = printed.splitlines()
    assert code == 0
    assert [k for k, line in enumerate(lines) if line.startswith("recording ")] == [0]
    of_each = [line.split(" (")[0] for line in lines if "mean probability" in line]
    assert of_each == ["7.bin: 7", "3.bin: 3", "7.bin: 7"]
    alone = program("run", SAMPLES[7])[1].splitlines()
    # each one begins a new stream
    assert lines[: len(alone)] == alone and lines[-len(alone) + 1 :] == alone[1:]


def test_a_line_has_the_numbers_of_its_decision(program):
    """Times in milliseconds, a window as its start and what has passed of it."""
    every = ("--every-us", 30_000)
    _, printed, _ = program("run", SAMPLES[7], *every)
    _, as_json, _ = program("run", SAMPLES[7], "--json", *every)
    decisions = [json.loads(line) for line in as_json.splitlines()]
    _, *rows, summary = printed.splitlines()
    assert len(rows) == len(decisions) > 4
    for row, decision in zip(rows, decisions, strict=True):
        start_us = decision["window_start_us"]
        since_us = decision["time_us"] - start_us
        assert row.split() == [
            "7.bin",
            f"{decision['time_us'] / 1e3:.3f}",
            f"{start_us / 1e3:.3f}+{since_us / 1e3:.3f}",
            decision["label"],
            f"{decision['probability']:.3f}",
            str(decision["events"]),
            decision["trigger"],
        ]
    ends = [d["probabilities"] for d in decisions if d["trigger"] in ("window", "end")]
    mean = np.mean(ends, axis=0)
    assert f"7 (mean probability {mean[7]:.3f} of {len(ends)} windows)" in summary


@pytest.mark.parametrize("has_size", [True, False])
def test_a_line_names_the_objects_of_a_map_model_by_hand(has_size, capsys):
    """Each with its number, its place, and its box if the model says sizes."""
    sizes = [(21.4, 9.6), (5.0, 30.0)] if has_size else [(None, None)] * 2
    objects = (
        Object("cup", 1, 0.75, 120.6, 33.2, 7, *sizes[0]),
        Object("ball", 0, 0.5, 4.0, 80.0, 2, *sizes[1]),
    )
    numbers = np.zeros((0, 3)), np.zeros((3, 2, 2), np.float32)
    lines = DecisionLines(as_json=False, with_latency=False)
    for found, label in ((objects, "cup"), ((), None)):
        index = 1 if found else -1
        decision = Decision(label, index, *numbers, 500, 20_500, 9, False, "every_us", found)
        lines.print("folder/a.npz", decision, 1.0)
    first, second = (line.split(maxsplit=6) for line in capsys.readouterr().out.splitlines())
    start = ["a.npz", "20.500", "0.500+20.000"]
    places = ["121, 33, 21 x 10", "4, 80, 5 x 30"] if has_size else ["121, 33", "4, 80"]
    assert first[:6] == [*start, "cup", "0.750", "9"]
    assert first[6] == f"every_us  7: cup ({places[0]})  2: ball ({places[1]})"
    assert second == [*start, "-", "0.000", "9", "every_us"]


def test_a_recording_of_objects_has_no_class(program):
    """Its probabilities are of objects, and not of windows."""
    code, printed, err = program("run", SAMPLES[7], "--model", "digits-everywhere")
    assert (code, err) == (0, "")
    _, *rows = printed.splitlines()
    assert len(rows) > 1 and all(row.startswith("7.bin  ") for row in rows)


def test_the_latency_is_a_column(program):
    _, plain, _ = program("run", SAMPLES[7])
    _, timed, _ = program("run", SAMPLES[7], "--latency")
    header, *rows, summary = timed.splitlines()
    plain_header, *plain_rows, plain_summary = plain.splitlines()
    assert header.split()[-3:] == ["events", "us", "why"]
    assert plain_header.split()[-2:] == ["events", "why"]
    assert summary == plain_summary and len(rows) == len(plain_rows) > 1
    for row, plain_row in zip(rows, plain_rows, strict=True):
        *words, latency, why = row.split()
        assert float(latency) > 0 and [*words, why] == plain_row.split()


def test_an_option_is_named_where_its_parameter_is_at_fault(program):
    """One is a parameter of the stream, another one a parameter of the decisions."""
    code, _, err = program("run", SAMPLES[7], "--start-us", -1)
    assert code == 2 and err.startswith("async-tnt: --start-us must be in [0, 2**62), got -1")
    code, _, err = program("run", SAMPLES[7], "--model", "digits-everywhere", "--confidence", 0.5)
    assert code == 2 and err.startswith("async-tnt: --confidence needs one answer for the window")


@pytest.mark.filterwarnings("default")
def test_a_warning_names_its_option(program):
    code, _, err = program("run", SAMPLES[7], "--every-us", 300_000)
    assert code == 0 and err.count("\n") == 1
    assert err.startswith("async-tnt: warning: --every-us = 300000 is longer than a window, ")


def test_a_field_of_a_file_is_not_taken_for_an_option(program, tmp_path):
    """The option of that name may be right."""
    events = open_recording(SAMPLES[7]).read()
    np.savez(tmp_path / "bad.npz", events=events, sensor=(0, 34))
    code, _, err = program("run", tmp_path / "bad.npz", "--sensor", "34x34")
    assert code == 2 and err.count("\n") == 1
    assert "bad.npz: " in err and " must be two integers (width, height) in " in err
    assert "--sensor" not in err


@pytest.mark.filterwarnings("default")
def test_nanoseconds_read_as_microseconds_are_warned_of(program, tmp_path):
    np.save(tmp_path / "ns.npy", random_events(60, duration_us=60_000_000))
    code, _, message = program("run", tmp_path / "ns.npy", "--json")
    assert code == 0 and message.count("divide nanoseconds by 1000") == message.count("\n") == 1
    assert message.startswith("async-tnt: warning: 32 of the first 32 windows")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.bin", None, "No such file"),
        ("", None, "is a folder"),
        ("x.bin", bytes(7), "7 bytes"),
        ("a\nb.bin", b"", "a\\nb.bin: no event"),
        (
            "off.csv",
            b"t,x,y,p\n5,40,1,1\n",
            "it is event 0 at x = 40, y = 1: the recording is of another sensor, or damaged; the "
            "file states none, --s",
        ),
    ],
)
def test_an_unreadable_recording_is_one_line_and_the_next_one_follows(
    name, content, message, tmp_path, program
):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    code, printed, err = program("run", tmp_path / name, SAMPLES[1])
    assert code == 2 and err.count("\n") == 1 and err.startswith("async-tnt: ") and message in err
    assert "1.bin: 1 " in printed


def test_the_next_recording_follows_one_whose_library_is_missing(tmp_path, program, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    code, printed, err = program("run", tmp_path / "a.h5", SAMPLES[1])
    assert code == 2 and err.count("\n") == 1 and "h5py, which is missing" in err
    assert "1.bin: 1 " in printed


def test_the_next_recording_follows_one_that_is_too_large(tmp_path, program, monkeypatch):
    """It takes more memory than any machine addresses."""
    monkeypatch.setitem(READERS, ".huge", lambda path, options: np.empty(1 << 57))
    (tmp_path / "a.huge").touch()
    code, printed, err = program("run", tmp_path / "a.huge", SAMPLES[1])
    assert code == 2 and err.count("\n") == 1
    assert f"{tmp_path / 'a.huge'}: not enough memory. Unable to allocate 1.00 EiB" in err
    assert "1.bin: 1 " in printed


def test_late_events_are_reported(program):
    n = len(open_recording(SAMPLES[5]).read())
    message = program("run", "--start-us", "200000", SAMPLES[5])[2]
    assert f" of {n} events were too late and dropped (see --start-us)\n" in message


def test_a_recording_that_ends_before_the_start_has_no_event_in_any_window(program):
    code, printed, err = program("run", "--start-us", 10**9, "--json", SAMPLES[5])
    assert (code, printed) == (2, "")
    assert err.splitlines()[-1] == f"async-tnt: {SAMPLES[5]}: no event in any window"


def test_events_older_than_the_newest_one_are_used(program, tmp_path):
    events = open_recording(SAMPLES[5]).read()[:1000]
    events["t"][500] = events["t"][499] - 1
    np.savez(tmp_path / "a.npz", sensor=(34, 34), events=events)
    code, out, err = program("run", "--json", tmp_path / "a.npz")
    assert code == 0 and err == ""
    assert [json.loads(line)["events"] for line in out.splitlines()] == [1000]
