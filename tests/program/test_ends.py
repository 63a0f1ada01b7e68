"""How the program ends.

At a signal it prints one line, and its exit code is 128 and the signal's number. It also ends where
its output cannot be written.
"""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from listening import free_port, send_in_parts
from processes import started

from async_tnt.sources.files.recording import open_recording, sample_recordings

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
SAMPLE = str(sample_recordings()[3])
PROGRAM = ("-m", "async_tnt")
has_full = pytest.mark.skipif(
    not os.path.exists("/dev/full"), reason="no device that is always full"
)

# Python runs this module first of all where it is on PYTHONPATH.
SITECUSTOMIZE = """
import os, sys
point, number = os.environ["POINT"], int(os.environ["NUMBER"])

class Finder:
    def find_spec(self, name, path, target=None):
        if name == point:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), number)

sys.meta_path.insert(0, Finder())
"""


def interrupted(folder, *words, point, number, ignored=None):
    """The exit code and output of the program, which gets a signal when it imports a module.

    point : name of the module.
    number : number of the signal.
    ignored : a signal that the program ignores from its start.
    """
    (folder / "sitecustomize.py").write_text(SITECUSTOMIZE)
    env = os.environ | {"POINT": point, "NUMBER": str(int(number))}
    env["PYTHONPATH"] = os.pathsep.join([str(folder), *filter(None, sys.path)])
    ignore = None if ignored is None else lambda: signal.signal(ignored, signal.SIG_IGN)
    with started(*PROGRAM, *words, cwd=folder, env=env, preexec_fn=ignore) as process:
        printed, message = process.communicate()
        return process.returncode, printed, message


@pytest.mark.parametrize(
    ("point", "number", "line"),
    [
        ("async_tnt.cli.program", signal.SIGINT, "interrupted"),
        ("numpy.linalg", signal.SIGHUP, "terminated"),
    ],
)
def test_a_signal_while_the_program_starts(point, number, line, tmp_path):
    done = interrupted(tmp_path, "run", SAMPLE, point=point, number=number)
    assert done == (128 + number, "", f"async-tnt: {line}\n")


WHILE_KERNELS_COME_FROM_THE_CACHE = """
from numba.core.codegen import JITCodeLibrary
answer = JITCodeLibrary._object_getbuffer_hook
def answer_late(library):  # LLVM calls back, and does not expect an exception
    os.kill(os.getpid(), NUMBER)
    return answer(library)
JITCodeLibrary._object_getbuffer_hook = answer_late
"""
WHILE_WORKERS_START = """
from subprocess import Popen
start = Popen._execute_child
def started(process, words, *how):
    # after the start: a process waits for its calls; if none ever came, it might complain
    start(process, words, *how)
    if "async_tnt.base.worker" in str(words):
        os.kill(os.getpid(), NUMBER)
Popen._execute_child = started
"""
NONE_DONE = "interrupted: 0 of 2 recordings are done; nothing is kept without --out"


@pytest.mark.parametrize(
    ("patch", "number", "words", "line"),
    [
        (WHILE_KERNELS_COME_FROM_THE_CACHE, signal.SIGINT, ["run", SAMPLE], "interrupted"),
        (
            WHILE_WORKERS_START,
            signal.SIGTERM,
            ["evaluate", "digits", "set", "--workers", "2"],
            NONE_DONE,
        ),
    ],
)
def test_a_signal_at_a_delicate_moment(patch, number, words, line, tmp_path):
    (tmp_path / "set" / "3").mkdir(parents=True)
    for name in ("a.bin", "b.bin"):
        (tmp_path / "set" / "3" / name).symlink_to(SAMPLE)
    code = (
        f"import os, sys\nNUMBER = {int(number)}\n{patch}\n"
        "from async_tnt.cli import main; sys.exit(main())"
    )
    with started("-c", code, *words, cwd=tmp_path) as process:
        assert process.communicate() == ("", f"async-tnt: {line}\n")
    assert process.returncode == 128 + number


def test_an_ignored_signal_stays_ignored(tmp_path):
    """nohup ignores SIGHUP, and a shell's background job ignores Ctrl-C."""
    signals = {"number": signal.SIGHUP, "ignored": signal.SIGHUP}
    code, printed, message = interrupted(tmp_path, "run", SAMPLE, point="numpy.linalg", **signals)
    assert code == 0 and message == "" and "3.bin: 3 " in printed


def test_a_signal_ends_a_stream_with_its_last_decision_and_its_counts():
    port = free_port()
    events = open_recording(sample_recordings()[7]).read()
    with started(*PROGRAM, "run", f"udp://127.0.0.1:{port}", SAMPLE) as process:
        line = process.stderr.readline()
        while "listening" not in line:  # a cold cache says that it compiles
            assert line
            line = process.stderr.readline()
        send_in_parts(port, events)
        assert process.stdout.readline()  # a decision
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate()
    assert process.returncode == 128 + signal.SIGTERM
    assert " end\n" in out and " events (0 malformed" in err and "Traceback" not in err
    assert Path(SAMPLE).name not in out  # no other source is begun


@pytest.mark.parametrize("received", ["", "terminated"])
def test_a_command_that_a_signal_ends_says_which(received, program, monkeypatch):
    from async_tnt.cli import run

    def interrupt(args):
        if received:
            signal.raise_signal(signal.SIGTERM)
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "main", interrupt)
    expected = (
        (143, "", "async-tnt: terminated\n") if received else (130, "", "async-tnt: interrupted\n")
    )
    assert program("run") == expected


@pytest.mark.parametrize(("returned", "line"), [(0, "terminated"), (2, "")])
def test_a_signal_that_a_command_did_not_notice_is_its_exit_code(
    returned, line, program, monkeypatch
):
    """The signal comes in a `__del__`, while the command writes its last file.

    Python drops the KeyboardInterrupt there, and the command goes on.
    """
    from async_tnt.cli import run

    def go_on(args):
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        return returned

    monkeypatch.setattr(run, "main", go_on)
    assert program("run") == (143, "", f"async-tnt: {line}\n" if line else "")


def test_a_closed_pipe_is_no_error():
    command = f'"{sys.executable}" -m async_tnt run | head -1'
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert done.stdout.startswith("recording") and done.stderr == ""


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_output_in_another_encoding_has_bars_of_it_and_escapes_names(encoding, tmp_path):
    name = "\N{GREEK SMALL LETTER OMEGA}.bin"
    (tmp_path / name).symlink_to(SAMPLE)
    env = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONUTF8": "1"}
    done = subprocess.run(
        [sys.executable, *PROGRAM, "info", name], env=env, cwd=tmp_path, capture_output=True
    )
    first, *lines = done.stdout.decode(encoding).splitlines()
    (rate,) = [line for line in lines if "  rate  " in line]
    bars = rate.removeprefix("  rate       ").partition(" up to ")[0]
    assert done.returncode == 0 and len(bars) > 40 and "\\" not in bars
    assert first.startswith(name if encoding == "utf-8" else r"\u03c9.bin")
    assert max(bars) == ("\N{FULL BLOCK}" if encoding == "utf-8" else "@")


@pytest.mark.parametrize(("later_s", "cleaned_up"), [(0.0, True), (0.9, True), (5.0, False)])
def test_a_second_signal_at_once_does_not_end_the_cleaning_up(
    later_s, cleaned_up, program, monkeypatch
):
    """Closing a terminal sends two; somebody who presses Ctrl-C again later means it."""
    from async_tnt.cli import run, signals

    now_s = [100.0]
    done = []
    monkeypatch.setattr(signals, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def clean_up(args):
        try:
            signal.raise_signal(signal.SIGHUP)
        finally:
            now_s[0] += later_s
            signal.raise_signal(signal.SIGTERM)
            done.append(True)

    monkeypatch.setattr(run, "main", clean_up)
    assert program("run") == (128 + signal.SIGHUP, "", "async-tnt: terminated\n")
    assert done == [True] * cleaned_up


@has_full
def test_output_that_cannot_be_written_is_not_blamed_on_the_recordings():
    with open("/dev/full", "w") as full, started(*PROGRAM, "run", "--json", stdout=full) as process:
        message = process.communicate()[1]
    assert process.returncode == 2 and message.count("No space left on device") == 1


@pytest.mark.parametrize("stderr", ["2>&-", pytest.param("2>/dev/full", marks=has_full)])
def test_without_a_stderr_the_exit_code_is_the_same(stderr):
    """Where the program would report on stderr what was dropped."""
    command = f'"{sys.executable}" -m async_tnt run --start-us 200000 --json {SAMPLE} {stderr}'
    done = subprocess.run(command, shell=True, stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0 and done.stdout
    assert all(line.startswith("{") for line in done.stdout.splitlines())
