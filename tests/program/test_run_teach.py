"""async-tnt run --teach: classes are taught by a stream that goes on."""

import io
import json
import sys
import threading
from dataclasses import replace
from queue import SimpleQueue

import numpy as np
import pytest
from listening import sent
from made import random_model
from networks.teaching.lessons import CLASSES, CONFIG, of_classes, recording

from async_tnt import load_model
from async_tnt.cli import live_lessons


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """The file of a model with statistics."""
    model = replace(random_model(CONFIG, classes=3), classes=CLASSES).with_statistics(of_classes())
    return model.save(tmp_path_factory.mktemp("base") / "base.safetensors")


def shown(kinds, n=40):
    """A stream that shows these classes, one after the other, n recordings of each."""
    parts = []
    for kind in kinds:
        for i in range(n):
            events = recording(kind, 300 + i)
            events["t"] += 3000 * len(parts)
            parts.append(events)
    return np.concatenate(parts)


@pytest.fixture
def typed(monkeypatch):
    """Names as if they were typed on a terminal; lessons take 30 ms of the stream."""

    def names(*words):
        queue = SimpleQueue()
        for word in words:
            queue.put(word)
        monkeypatch.setattr(live_lessons, "typed_names", lambda: queue)
        original = live_lessons.LiveLessons
        monkeypatch.setattr(
            live_lessons, "LiveLessons", lambda *given: original(*given, seconds=0.03)
        )

    return names


def test_a_class_is_taught_while_the_stream_goes_on(program, base, typed, tmp_path):
    typed("d", "a")
    out = tmp_path / "more.safetensors"
    events = shown([3, 0, 3])
    with sent(events) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=3"
        code, stdout, err = program("run", url, "--model", base, "--teach", out, "--json")
    assert code == 0, err
    assert "d: show it for 0.03 s" in err
    assert "d: taught from 1 recording, " in err
    assert f"wrote {out}: 4 classes" in err
    assert "a is a class already" in err
    taught = load_model(out)
    assert taught.classes == (*CLASSES, "d")
    decisions = [json.loads(line) for line in stdout.splitlines()]
    # each window is decided once, before and after the lesson: the stream did not stop
    starts = [decision["window_start_us"] for decision in decisions]
    assert len(set(starts)) == len(starts) >= 350
    labels = [decision["label"] for decision in decisions]
    assert "d" not in labels[:20]
    assert labels[-100:].count("d") > 70
    assert labels[170:220].count("d") < 25  # another class is shown there


def test_a_stream_that_ends_too_early_is_told(program, base, typed, tmp_path):
    typed("d")
    out = tmp_path / "more.safetensors"
    with sent(shown([3], n=2)) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=1"
        code, _, err = program("run", url, "--model", base, "--teach", out)
    assert code == 0
    assert "the stream ended before d was shown for 0.03 s" in err
    assert not out.exists()


def test_a_lesson_that_fails_leaves_the_stream_as_it_was(
    program, base, typed, tmp_path, monkeypatch
):
    typed("d")
    out = tmp_path / "more.safetensors"

    def fails(*words):
        raise ValueError("no memory of that")

    monkeypatch.setattr("async_tnt.networks.models.model.teach", fails)
    with sent(shown([3], n=30)) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=1"
        code, stdout, err = program("run", url, "--model", base, "--teach", out, "--json")
    assert code == 0
    assert "d: no memory of that" in err
    assert len(stdout.splitlines()) >= 80
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("camera", "--teach", "m.onnx"), "its name must end in .safetensors"),
        (("3", "--teach", "m.safetensors"), "--teach needs one camera or network stream"),
        (
            ("udp://127.0.0.1:0", "udp://127.0.0.1:0", "--teach", "m.safetensors"),
            "--teach needs one camera or network stream",
        ),
        (
            (
                *("udp://127.0.0.1:0", "--model", "digits-from-pictures"),
                *("--teach", "m.safetensors"),
            ),
            "digits-from-pictures has no statistics of its classes",
        ),
    ],
)
def test_mistakes(program, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    code, stdout, err = program("run", *words)
    assert (code, stdout) == (2, "")
    assert message in err and err.count("\n") == 1


def test_names_are_read_from_a_terminal_only(program, base, tmp_path):
    code, _, err = program(
        "run", "udp://127.0.0.1:0", "--model", base, "--teach", tmp_path / "m.safetensors"
    )
    assert code == 2
    assert "--teach reads names from a terminal, and stdin is none" in err


def test_a_typed_line_is_a_name_and_an_empty_one_is_none(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stdin", Terminal("wave\n\n  two words \n \nend"))
    names = live_lessons.typed_names()
    for thread in threading.enumerate():
        if thread.name == "async-tnt names":
            thread.join()
    assert [names.get_nowait() for _ in range(names.qsize())] == ["wave", "two words", "end"]
