"""Values of options at their borders, and what a command leaves behind in the process that calls
it."""

import argparse
import gc
import signal
import sys
import threading

import pytest

from async_tnt.cli import main, options, run
from async_tnt.sources.files.recording import sample_recordings

SAMPLE = sample_recordings()[3]


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (options.size_of, "1x1", (1, 1)),
        (options.size_of, "346X260", (346, 260)),
        (options.size_of, "32768x2", (32_768, 2)),
        (options.positive_int, "1", 1),
        (options.whole_number, "0", 0),
        (options.positive_number, "1e-9", 1e-9),
        (options._probability, "1", 1.0),
        (options._probability, ".5", 0.5),
        (options._times, "0,1", (0, 1)),
        (options.volume_of, "remove_flow=no", {"remove_flow": False}),
        (
            options.volume_of,
            "remove_flow=yes,bins=5,t_max=2,polarity=split",
            {"remove_flow": True, "bins": 5, "t_max": 2.0, "polarity": "split"},
        ),
        (options.volume_of, None, {}),
    ],
)
def test_values_that_are_read(read, text, value):
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text", "rule"),
    [
        (options.size_of, "0x5", r"must be WIDTHxHEIGHT with sides in \[1, 32768\] pixels"),
        (options.size_of, "5x32769", r"must be WIDTHxHEIGHT with sides in \[1, 32768\] pixels"),
        (options.size_of, "5", "must be WIDTHxHEIGHT in pixels, such as 346x260"),
        (options.size_of, "5x-5", "must be WIDTHxHEIGHT in pixels, such as 346x260"),
        (options.positive_int, "0", "must be a whole number of at least 1"),
        (options.positive_int, "1.0", "must be a whole number of at least 1"),
        (options.whole_number, "-1", "must be a whole number of at least 0"),
        (options.positive_number, "0", "must be a positive number"),
        (options.positive_number, "nan", "must be a positive number"),
        (options._probability, "0", r"must be a probability in \(0, 1\]"),
        (options._probability, "1.001", r"must be a probability in \(0, 1\]"),
        (options._probability, "nan", r"must be a probability in \(0, 1\]"),
        (options.volume_of, "bins=5,bins=6", "must be NAME=VALUE,... with each of .* at most once"),
        (options.volume_of, "grid=5", "must be NAME=VALUE,... with each of .* at most once"),
        (options.volume_of, "bins=x", "bins must be a whole number"),
        (options.volume_of, "t_max=x", "t_max must be a number"),
        (options.volume_of, "remove_flow=1", "remove_flow must be yes or no"),
    ],
)
def test_values_that_are_refused_with_their_rule(read, text, rule):
    got = text.rpartition("=")[2] if rule.split()[0] in options.FIELDS else text.split(",")[-1]
    with pytest.raises(argparse.ArgumentTypeError, match=rf"^{rule}, got '{got}'$"):
        read(text)


@pytest.mark.parametrize("name", ["m.onnx", "M.ONNX"])
def test_a_file_for_another_program_is_refused_where_weights_are_needed(name, program, tmp_path):
    code, _, err = program("evaluate", name, tmp_path)
    assert code == 2 and f"{name}: an .onnx file is for run and view (--model) alone" in err


def test_signals_and_hooks_are_restored_after_a_command(program):
    """A program that calls it, such as a notebook, keeps its hooks, also after an error."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    hook = sys.unraisablehook
    for words, code in ((("run", SAMPLE), 0), (("run", "nowhere.npz"), 2)):
        assert program(*words)[0] == code
        assert [signal.getsignal(number) for number in numbers] == before
        assert sys.unraisablehook is hook


def test_a_command_runs_in_a_thread_where_signals_cannot_be_handled(program):
    codes = []
    thread = threading.Thread(target=lambda: codes.append(program("run", SAMPLE)))
    thread.start()
    thread.join()
    ((code, printed, err),) = codes
    assert (code, err) == (0, "") and "3.bin: 3 " in printed


def test_garbage_is_collected_again_after_bad_usage():
    assert gc.isenabled()
    with pytest.raises(SystemExit):
        main(["fly"])
    assert gc.isenabled()


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_errors_that_python_drops_reach_the_hook_of_the_caller(error, program, monkeypatch):
    """Without a signal, also a KeyboardInterrupt is not ours."""
    dropped = []
    monkeypatch.setattr(sys, "unraisablehook", lambda given: dropped.append(given.exc_type))

    class Fails:
        def __del__(self):
            raise error

    def drop(args):
        Fails()
        return 0

    monkeypatch.setattr(run, "main", drop)
    assert program("run", SAMPLE) == (0, "", "")
    assert dropped == [error]
