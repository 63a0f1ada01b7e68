"""How the program ends when somebody else ends it, or when its output does."""

import json
import os
import signal
import subprocess
import sys

import pytest

from async_tnt.cli import main
from async_tnt.sources.files.recording import sample_recordings

ENV = os.environ | {"PYTHONUNBUFFERED": "1"}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("number, code", [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_ends_a_stream_with_its_last_decision_and_its_counts(number, code):
    words = ["run", "udp://127.0.0.1:0", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "async_tnt.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENV,
    )
    try:
        lines = [process.stderr.readline()]
        while "listening" not in lines[-1] and process.poll() is None:
            lines.append(process.stderr.readline())
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code
    assert "0 datagrams, 0 events" in err and "Traceback" not in err


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize("words, unbuffered", [(["run", "--json"], "1"), (["run", "--json"], ""), (["--help"], "")])
def test_output_that_cannot_be_written_is_no_fault_of_the_recordings(words, unbuffered):
    env = ENV | {"PYTHONUNBUFFERED": unbuffered}
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "async_tnt.cli", *words]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env=env)
    assert done.returncode == 2
    assert done.stderr.count("No space left on device") == 1


def test_a_name_with_a_line_break_stays_on_its_line(tmp_path, capsys):
    path = tmp_path / "a\nb.bin"
    path.write_bytes(sample_recordings()[3].read_bytes())
    assert main(["run", str(path)]) == 0
    assert "\na\\nb.bin " in capsys.readouterr().out
    assert main(["run", "--json", str(path)]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["recording"] == str(path)


@pytest.mark.parametrize(
    "words",
    [
        ["run"],
        ["check"],
        ["export", "--out", "m.onnx"],
        ["send", "udp://127.0.0.1:9"],
        ["train", "--out", "m.safetensors"],
        ["evaluate", "digits"],
        ["simulate", "--out", "set", "--mnist"],
        ["mask"],
        ["plot", "--out", "p.png"],
        ["view", "--out", "v.rrd"],
        ["bench", "--model"],
        ["run", "--late"],
        ["table", "--nmnist"],
        ["run", str(sample_recordings()[3]), "--out"],
        ["evaluate", "digits", ".", "--picture"],
    ],
)
def test_a_complaint_is_one_line_whatever_the_name(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        code = main([*words, "no\n\x1b[31mwhere"])
    except SystemExit as stopped:
        code = stopped.code
    err = capsys.readouterr().err
    assert code == 2 and err.count("\n") == 1 and "no\\n\\x1b[31mwhere" in err


@pytest.mark.parametrize("command", ["run", "view"])
def test_latest_is_of_streams(command, capsys):
    assert main([command, str(sample_recordings()[3]), "--latest", "5"]) == 2
    assert "--latest belongs to a camera or the network" in capsys.readouterr().err


def test_a_sensor_of_another_size_says_what_to_do(tmp_path, capsys):
    path = tmp_path / "large.csv"
    path.write_text("t,x,y,p\n1,100,5,1\n2,3,4,0\n")
    assert main(["run", str(path)]) == 2
    err = capsys.readouterr().err
    assert "got 100 at event 0" in err
    assert "the model is for 34x34 pixels; train one for this camera" in err and "--roi X,Y,34,34 --crop" in err
    assert len(err.splitlines()) == 1
