"""The program async-tnt: answers, exit codes, and what it says of wrong files and wrong flags."""

import json
import subprocess
import sys

import numpy as np
import pytest
from made import random_events, random_model

from async_tnt import TNTConfig, TNTVolume
from async_tnt.cli import main
from async_tnt.cli.program import COMMANDS
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import sample_recordings

SAMPLES = sample_recordings()


def test_run_classifies_the_bundled_samples(capsys):
    assert main(["run"]) == 0
    out = capsys.readouterr().out.splitlines()
    verdicts = [line for line in out if "mean probability" in line]
    assert [line.split(": ")[0] + " " + line.split(": ")[1][0] for line in verdicts] == [
        f"{digit}.bin {digit}" for digit in range(10)
    ]


def test_run_json_is_one_object_a_line_for_each_decision(capsys):
    assert main(["run", "--json", "--every-us", "20000", str(SAMPLES[7])]) == 0
    decisions = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    closed = [d for d in decisions if d["trigger"] in ("window", "end")]
    assert [d["label"] for d in closed] == ["7", "7", "7"]
    assert len(decisions) == 3 + 5 + 5 + 4
    for d in decisions:
        assert d["probability"] == max(d["probabilities"]) and sum(d["probabilities"]) == pytest.approx(1, abs=1e-4)
        assert d["window_start_us"] <= d["time_us"] and d["latency_us"] > 0 and d["recording"].endswith("7.bin")


def test_run_settings_change_windows(capsys):
    assert main(["run", "--json", "--start-us", "0", "--hop-us", "52500", str(SAMPLES[7])]) == 0
    decisions = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [d["window_start_us"] for d in decisions] == [0, 52_500, 105_000, 157_500, 210_000, 262_500]


def test_run_takes_ones_own_model(tmp_path, capsys):
    model = random_model(TNTConfig(landmark="center"), classes=2)
    path = model.save(tmp_path / "mine.safetensors")
    assert main(["run", "--model", str(path), "--json", str(SAMPLES[0])]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["label"] in model.classes


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda folder: folder / "missing.bin", "No such file"),
        (lambda folder: folder, "is a folder"),
        (lambda folder: _written(folder / "x.bin", bytes(7)), "7 bytes"),
        (lambda folder: _written(folder / "x.doc", b"hello"), r"\.bin"),
        (lambda folder: _written(folder / "x.npy", b"hello"), "x.npy"),
    ],
)
def test_run_says_what_is_wrong_with_a_file_in_one_line_and_goes_on(make, message, tmp_path, capsys):
    assert main(["run", str(make(tmp_path)), str(SAMPLES[1])]) == 2
    captured = capsys.readouterr()
    assert len(captured.err.splitlines()) == 1 and captured.err.startswith("async-tnt: ")
    assert pytest.importorskip("re").search(message, captured.err)
    assert "1.bin: 1 " in captured.out


def _written(path, content):
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "argv", [[], ["fly"], ["run", "--every-us", "0"], ["run", "--late", "maybe"], ["check", "--prefixes", "x"]]
)
def test_bad_usage_exits_with_2(argv, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(argv)
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("async-tnt") and line.endswith("--help)")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(command, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert stopped.value.code == 0
    assert len(capsys.readouterr().out.splitlines()) > 12


def test_unknown_model(capsys):
    assert main(["run", "--model", "digitz"]) == 2
    assert "no model file digitz, and no bundled model of that name (bundled: digits)" in capsys.readouterr().err


def test_a_recording_off_the_models_sensor_is_refused(tmp_path, capsys):
    path = random_model(TNTConfig(sensor=(20, 20))).save(tmp_path / "m.safetensors")
    assert main(["run", "--model", str(path), str(SAMPLES[1])]) == 2
    assert "must be in [0, 20), got 2" in (message := capsys.readouterr().err)
    assert "; the model is for 20x20 pixels; train one for this camera" in message


def test_broken_pipe_is_no_error():
    done = subprocess.run(
        f'"{sys.executable}" -m async_tnt.cli run | head -1', shell=True, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.startswith("recording") and done.stderr == ""


def test_check_holds_stream_and_batch_equal(capsys, tmp_path):
    path = tmp_path / "short.bin"
    write_nmnist(path, random_events(150, duration_us=200_000))
    assert main(["check", str(path), "--prefixes", "all"]) == 0
    out = capsys.readouterr().out
    assert "stream and batch are equal" in out and "FAILS" not in out
    assert main(["check", str(path), "--json", "--prefixes", "3"]) == 0
    report = json.loads(capsys.readouterr().out)
    rows = report["recordings"][str(path)]
    assert report["equal"] and all(row["holds"] and row["n"] > 0 for row in rows)
    assert {row["config"] for row in rows} == {
        "center",
        "running",
        "line",
        "window",
        "line, flow removed",
        "no transform",
        "the model",
    }


def test_check_takes_recordings_whose_times_run_backwards(capsys, tmp_path):
    events = random_events(600, duration_us=300_000)
    events["t"][100:500:7] = events["t"][99:499:7] - 20_000
    np.save(tmp_path / "backwards.npy", events)
    assert main(["check", str(tmp_path / "backwards.npy"), "--prefixes", "2"]) == 0, capsys.readouterr().out


def test_a_comparison_never_forgets_a_nan():
    from async_tnt.checking.equality import Comparison

    for differences in ([float("nan"), 0.0], [0.0, float("nan"), 0.5], [2.0]):
        comparison = Comparison("x", "y", 1.0)
        for difference in differences:
            comparison.add(difference)
        assert not comparison.holds
    assert not Comparison("x", "y", 1.0).holds  # nothing compared


@pytest.mark.parametrize("command", ["run", "check"])
def test_a_recording_without_events(command, tmp_path, capsys):
    (tmp_path / "empty.bin").write_bytes(b"")
    assert main([command, str(tmp_path / "empty.bin")]) == 2
    assert "empty.bin: no event" in capsys.readouterr().err


def test_events_off_the_sensor_name_file_and_event(tmp_path, capsys):
    np.save(tmp_path / "h.npy", np.array([[0, 1, 1, 1], [5, 40, 1, 1]]))
    assert main(["run", str(tmp_path / "h.npy")]) == 2
    assert "h.npy: `x` must be in [0, 34), got 40 at event 1" in capsys.readouterr().err


def test_late_events_are_reported(capsys):
    assert main(["run", "--start-us", "200000", str(SAMPLES[5])]) == 0
    assert "dropped" in capsys.readouterr().err


def test_events_out_of_order_are_reported(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("t,x,y,p\n0,1,1,1\n10,2,2,0\n5,3,3,1\n")
    assert main(["run", str(tmp_path / "a.csv")]) == 0
    message = "1 of 3 events are older than an earlier one (see --late)"
    assert capsys.readouterr().err == f"async-tnt: {tmp_path / 'a.csv'}: {message}\n"


def test_check_says_no_when_the_stream_is_wrong(monkeypatch, capsys):
    """An error of a millionth of a pixel in one landmark must not pass."""
    landmark = TNTVolume.landmark.fget
    monkeypatch.setattr(TNTVolume, "landmark", property(lambda self: tuple(np.add(landmark(self), 1e-6))))
    assert main(["check", str(SAMPLES[1]), "--prefixes", "1"]) == 1
    captured = capsys.readouterr()
    assert "FAILS" in captured.out and "NOT equal" in captured.out and "landmark" in captured.err


def test_interrupt_exits_with_130(monkeypatch, capsys):
    from async_tnt.cli import run

    def interrupt(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "main", interrupt)
    assert main(["run"]) == 130
    assert capsys.readouterr().err == "async-tnt: interrupted\n"


def test_samples_are_the_bundled_ones_where_no_such_file_is(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "samples", "--json"]) == 0
    assert len({json.loads(line)["recording"] for line in capsys.readouterr().out.splitlines()}) == 10
    (tmp_path / "samples").mkdir()
    assert main(["run", "samples"]) == 2
    assert "samples is a folder, expected a recording" in capsys.readouterr().err
    assert main(["run"]) == 0
