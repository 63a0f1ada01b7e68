"""Every command: help, wrong options, and errors of one line."""

import argparse
import subprocess
import sys

import numpy as np
import pytest

from async_tnt.base.checks import ParameterTypeError
from async_tnt.cli import main, run, train_options
from async_tnt.cli.program import COMMANDS, build_parser
from async_tnt.sources.files.recording import sample_recordings

SAMPLE = str(sample_recordings()[3])


@pytest.fixture
def refused(capsys):
    """Run words that are refused; returns the one line on stderr."""

    def run_refused(*words):
        try:
            code = main(list(words))
        except SystemExit as stopped:
            code = stopped.code
        out, err = capsys.readouterr()
        assert code == 2 and out == ""
        assert err.count("\n") == 1 and err.startswith("async-tnt")
        return err

    return run_refused


def test_the_program_is_also_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "async_tnt", "fly"], capture_output=True, text=True
    )
    assert done.returncode == 2 and done.stderr.startswith(
        "async-tnt: argument COMMAND: invalid choice: 'fly'"
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_a_description_and_options(command, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([command, "--help"])
    assert stopped.value.code == 0 and len(capsys.readouterr().out.splitlines()) > 12


def test_train_has_few_options_and_a_help_of_two_screens(monkeypatch):
    """None of their defaults depends on another option."""
    monkeypatch.setenv("COLUMNS", "80")
    parser = argparse.ArgumentParser(prog="async-tnt train")
    train_options.add_arguments(parser)
    options = [
        action for action in parser._actions if action.option_strings and action.dest != "help"
    ]
    assert len(options) <= 26 and len(parser.format_help().splitlines()) <= 70


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "the following arguments are required: COMMAND"),
        ("fly", "invalid choice: 'fly'"),
        ("run --every-us 0", "argument --every-us: must be a whole number of at least 1, got '0'"),
        ("check --prefixes x", "argument --prefixes: "),
        ("view --speed 0", "argument --speed: must be a positive number, got '0'"),
        ("run --confidence 0", "argument --confidence: must be a probability in (0, 1], got '0'"),
        ("train x --seed -1", "argument --seed: must be a whole number of at least 0, got '-1'"),
        ("train x --epochs 0", "argument --epochs: must be a whole number of at least 1, got '0'"),
        (
            "run --landmark line",
            "async-tnt run: unrecognized arguments: --landmark (async-tnt run --help)",
        ),
        (
            "run --model=--",
            "async-tnt run: argument --model: expected a value, got '--' (async-tnt run --help)",
        ),
        (
            "plot events --sensor=--",
            "async-tnt plot: argument --sensor: expected a value, got '--'",
        ),
        *(
            (f"run --roi {region}", "must be four whole numbers X,Y,WIDTH,HEIGHT")
            for region in ("1,2,3", "1,2,3,4,5", "1,2,3,4.5")
        ),
        (
            "run --every-us " + "9" * 5000,
            "argument --every-us: must be a whole number of at least 1, got '999",
        ),
        (
            "plot events --sensor " + "9" * 5000 + "x2",
            "must be WIDTHxHEIGHT in pixels, such as 346x260, got '999",
        ),
    ],
    ids=lambda text: text[:40],
)
def test_bad_usage_refers_to_help(words, message, refused):
    err = refused(*words.split())
    assert message in err and err.endswith("--help)\n") and len(err) < 450


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "view udp://127.0.0.1:3333 --speed 2",
            "--speed belongs to recordings; a camera or the network has a",
        ),
        ("run --every-events 1" + "0" * 400, "must be below 2**62, got 1"),
        ("run SAMPLE --keep-up 5", "--keep-up belongs to a camera or the network"),
        ("run SAMPLE --crop", "--crop belongs to --roi"),
        (
            "run SAMPLE --sensor 36x34",
            "--sensor says 36x34 pixels, but the model is for 34x34; train one for this",
        ),
        (
            "run SAMPLE --roi 0,0,20,20 --crop",
            "for 34x34 pixels, got a region of 20x20; give --roi X,Y,34,34",
        ),
        ("bench --model no_such_model", "no model file no_such_model"),
        (
            "run --model digitz",
            "no model file digitz, and no bundled model of that name (bundled: digits, ",
        ),
        ("run udp://127.0.0.1", "expected udp://HOST:PORT"),
        ("run udp://127.0.0.1:5?format=jpeg", "format"),
        ("run udp://203.0.113.1:50000", "203.0.113.1"),
        (
            "run udp://127.0.0.1:0 --roi 60,0,34,34 --crop",
            "does not say the camera's pixels, which --crop needs: give",
        ),
        ("check EMPTY", "empty.bin: no event"),
    ],
)
def test_what_cannot_be_done_is_one_line(words, message, refused, tmp_path):
    (tmp_path / "empty.bin").write_bytes(b"")
    places = {"SAMPLE": SAMPLE, "EMPTY": str(tmp_path / "empty.bin")}
    assert message in refused(*(places.get(word, word) for word in words.split()))


@pytest.mark.parametrize(
    "words",
    [
        "run",
        "check",
        "export --out m.onnx",
        "train --out m.safetensors",
        "evaluate digits",
        "mask --out m.npy",
        "plot --out p.png",
        "view --out v.rrd",
        "bench --model",
    ],
)
def test_an_error_is_one_line_whatever_the_name(words, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "no\\n\\x1b[31mwhere" in refused(*words.split(), "no\n\x1b[31mwhere")


def test_memory_that_is_not_there_is_one_line(refused, monkeypatch):
    """More memory than any machine addresses."""
    monkeypatch.setattr(run, "main", lambda args: np.empty(1 << 57))
    assert refused("run", SAMPLE).startswith(
        "async-tnt: not enough memory. Unable to allocate 1.00 EiB for an array"
    )


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(5, "Input/output error", "a.bin"), "a.bin: Input/output error"),
        (ValueError("it has no events"), "it has no events"),
        (ParameterTypeError("every_us", "must be a whole number", "'5'"), "--every-us must be"),
        (ImportError("h5py is missing"), "h5py is missing"),
        (MemoryError(), "not enough memory"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_an_error_that_a_user_can_mend_is_one_line(error, message, refused, monkeypatch):
    def fail(args):
        raise error

    monkeypatch.setattr(run, "main", fail)
    assert refused("run", SAMPLE, "--every-us", "5").startswith(f"async-tnt: {message}")


def swapped(word):
    """The word with its second and third letter exchanged: one of the most common mistakes."""
    k = 3 if word.startswith("--") else 1
    k = min(k, len(word) - 2)  # of --dt the first and second letter
    return word[:k] + word[k + 1] + word[k] + word[k + 2 :]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_mistyped_word_gets_a_hint(command, refused):
    """Each command, and each of its options, with a value or without."""
    err = refused(swapped(command))
    assert f"invalid choice: '{swapped(command)}'" in err
    assert err.endswith(f"; did you mean {command}? (async-tnt --help)\n")
    options = build_parser([command]).commands[command].options
    n_tried = 0
    for option in options:
        if not option.startswith("--") or swapped(option) in options:
            continue
        typed = swapped(option)
        for words in ((typed,), (typed, "5"), (f"{typed}=5",)):
            assert f"did you mean {option}?" in refused(command, *words)
        n_tried += 1
    assert n_tried > 1


@pytest.mark.parametrize(
    ("words", "end"),
    [
        (
            "run --modle digits",
            "unrecognized arguments: --modle; did you mean --model? (async-tnt run --help)",
        ),
        (
            "mask a.npy --otu m.npy",
            "are required: --out; --otu: did you mean --out? (async-tnt mask --help)",
        ),
        ("run -json", "unrecognized arguments: -json; did you mean --json? (async-tnt run --help)"),
        ("run --mod digits --xyzzy", "unrecognized arguments: --xyzzy (async-tnt run --help)"),
        ("run --xyzzy", "unrecognized arguments: --xyzzy (async-tnt run --help)"),
        (
            "--verison",
            "are required: COMMAND; --verison: did you mean --version? (async-tnt --help)",
        ),
        # an option of the command, but before it
        ("--modle run", "unrecognized arguments: --modle (async-tnt run --help)"),
        ("xyzzy --modle", "'view', 'plot') (async-tnt --help)"),
        ("run -- --modle", "async-tnt: --modle: No such file or directory"),
        # the beginning of --model
        ("run --mod nowhere", "(bundled: digits, digits-everywhere, digits-from-pictures)"),
    ],
)
def test_what_was_probably_meant(words, end, refused):
    assert refused(*words.split()).endswith(f"{end}\n")


@pytest.mark.parametrize("words", ["--old", "--old=5", "3 --old 5 --modle x", "--every-us 5 --old"])
def test_an_option_that_was_removed_says_what_to_write_instead(words, refused, monkeypatch):
    monkeypatch.setattr(run, "REMOVED", {"--old": "write --every-us US"}, raising=False)
    assert refused("run", *words.split()) == (
        "async-tnt run: --old is no longer an option: write --every-us US (async-tnt run --help)\n"
    )


def test_a_file_may_have_the_name_of_an_option_that_was_removed(refused, monkeypatch):
    monkeypatch.setattr(run, "REMOVED", {"--old": "write --every-us US"}, raising=False)
    assert refused("run", "--", "--old") == "async-tnt: --old: No such file or directory\n"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("info {}", "N-MNIST"),
        ("mask {} --out m.npy", "none of 34x34 stands out in 4952 events"),
        ("run {}", "3.bin: 3 (mean probability"),
        ("check {} --prefixes 1", "1 recordings: stream and batch are equal"),
        ("plot {}", "3.png ("),
        ("view {} --out v.rrd", "v.rrd: 4,952 events"),
    ],
)
def test_a_digit_names_its_bundled_recording_in_every_command(
    words, expected, program, tmp_path, monkeypatch
):
    """Unless a file has this name."""
    monkeypatch.chdir(tmp_path)
    for command, module in (("check", "torch"), ("plot", "matplotlib"), ("view", "rerun")):
        if words.startswith(command):
            pytest.importorskip(module)
    code, out, err = program(*words.format("3").split())
    assert code == 0 and expected in out, err
    assert program(*words.format(SAMPLE).split())[1].splitlines()[-1] == out.splitlines()[-1]
    (tmp_path / "3").write_bytes(b"no recording")
    code, out, err = program(*words.format("3").split())
    assert code == 2 and "3: unknown suffix ''" in err
    assert program(*words.format("12").split())[0] == 2


@pytest.mark.parametrize("command", ["run", "check", "plot"])
def test_a_model_in_the_place_of_a_recording_is_told(program, tmp_path, command):
    (tmp_path / "m.safetensors").write_bytes(b"0" * 99)
    code, _, err = program(command, tmp_path / "m.safetensors")
    assert code == 2 and err.count("\n") == 1
    assert "m.safetensors: a model, which has an option of its own, and no recording" in err
