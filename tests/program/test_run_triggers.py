"""async-tnt run: the options that say when to decide."""

import json

import pytest

from async_tnt import LeakyIntegrator, Processor, load_model
from async_tnt.cli import main
from async_tnt.sources.files.recording import open_recording, sample_recordings

SAMPLE = sample_recordings()[7]
MODEL = load_model("digits")


def decisions_of(capsys, *options):
    assert main(["run", "--json", *options, str(SAMPLE)]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(
    "options, settings",
    [
        (["--confidence", "0.9"], {"confidence": 0.9}),
        (["--activity", "60:4_000"], {"activity": LeakyIntegrator(60, 4000)}),
        (["--every-events", "100", "--confidence", ".95"], {"every_events": 100, "confidence": 0.95}),
        (["--activity", "80:6000", "--every-us", "9000"], {"activity": LeakyIntegrator(80, 6000), "every_us": 9000}),
    ],
)
def test_options_are_the_processors_settings(capsys, options, settings):
    got = decisions_of(capsys, *options)
    processor = Processor(MODEL, **settings)
    expected = processor.push(open_recording(SAMPLE).read()) + processor.finish()
    assert [(d["trigger"], d["time_us"], d["events"], d["label"], d["complete"]) for d in got] == [
        (d.trigger, d.time_us, d.events, d.label, d.complete) for d in expected
    ]
    assert {d["trigger"] for d in got} - {"window", "end"}


def test_windows_closed_early_have_their_say_in_the_verdict(capsys):
    assert main(["run", "--confidence", "0.8", str(SAMPLE)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.endswith("confidence") for line in lines[1:-1]) and len(lines) == 5
    assert lines[-1].startswith("7.bin: 7 (mean probability 0.8") and lines[-1].endswith("of 3 windows)")


@pytest.mark.parametrize(
    "option, text, message",
    [
        ("--confidence", "0", "must be a probability in (0, 1], got '0'"),
        ("--confidence", "sure", "must be a probability in (0, 1], got 'sure'"),
        ("--confidence", "nan", "must be a probability in (0, 1], got 'nan'"),
        ("--activity", "60", "must be two positive numbers, events:microseconds, such as 60:4000, got '60'"),
        ("--activity", "60:0", "must be two positive numbers, events:microseconds, such as 60:4000, got '60:0'"),
        ("--activity", "inf:5", "must be two positive numbers, events:microseconds, such as 60:4000, got 'inf:5'"),
        ("--activity", "nan:5", "must be two positive numbers, events:microseconds, such as 60:4000, got 'nan:5'"),
    ],
)
def test_wrong_values_are_reported(capsys, option, text, message):
    with pytest.raises(SystemExit) as stop:
        main(["run", option, text])
    assert stop.value.code == 2 and f"argument {option}: {message}" in capsys.readouterr().err
