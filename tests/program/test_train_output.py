"""What `async-tnt train` prints and writes down of itself: epochs, the summary, and its command."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from made import random_model

from async_tnt import load_model
from async_tnt.cli import train, train_options
from async_tnt.cli.train_summary import print_summary


@pytest.fixture
def clock(monkeypatch):
    """A list with the time, in seconds, that the command sees."""
    now_s = [100.0]
    monkeypatch.setattr(train, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    return now_s


def test_epochs_are_told_once_a_second_and_the_first_and_the_last_always(clock, capsys):
    report = train._reporter(6)
    for epoch, passed_s in enumerate((0.0, 0.4, 0.4, 0.3, 0.2, 0.1), 1):
        clock[0] += passed_s
        report({"epoch": epoch, "loss": 0.5})
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in lines] == ["1/6", "4/6", "6/6"]


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ({}, ""),
        ({"f1": 0.25}, "  held out: F1 0.2500"),
        (
            {"per_window": 0.75, "per_recording": 0.5},
            "  held out: 0.7500 by window, 0.5000 by recording",
        ),
        (
            {"per_window": 0.75, "per_recording": 0.5, "motions_per_window": 0.125},
            "  held out: 0.7500 by window, 0.5000 by recording; in other motions 0.1250 by window",
        ),
    ],
)
def test_a_line_of_an_epoch_has_what_was_measured(row, told, capsys):
    train._reporter(9)({"epoch": 2, "loss": 1.25, "training": 0.875, **row})
    assert capsys.readouterr().err == f"epoch 2/9  loss 1.2500{told}\n"


RECORD = {
    "validation": {"per_window": 0.75, "windows": 40, "per_recording": 0.5, "recordings": 8},
    "validation_motions": {"per_window": 0.25, "windows": 60},
    "test": {"per_window": 0.625, "windows": 16, "per_recording": 0.875, "recordings": 4},
    "data": {},
    "network": "conv4",
    "multiplications": 1_234_567,
    "temperature": 0.75,
}


def summary(capsys, record=RECORD, scores=None, statistics=None, **more):
    model = SimpleNamespace(record=record, statistics=statistics)
    fitted = SimpleNamespace(model=model, scores=scores)
    settings = {"as_json": False} | more
    print_summary(
        fitted, Path("m.safetensors"), [Path("m.safetensors"), Path("m.json")], **settings
    )
    return capsys.readouterr().out.splitlines()


def test_the_summary_tells_each_part_by_its_name(capsys):
    assert summary(capsys) == [
        "held out: 0.7500 of 40 windows, 0.5000 of 8 recordings right",
        "held out, in other motions: 0.2500 of 60 windows right",
        "Test: 0.6250 of 16 windows, 0.8750 of 4 recordings right",
        "network conv4, 1,234,567 multiplications a complete window; temperature 0.750",
        "wrote m.safetensors, m.json",
    ]
    pictures = {**RECORD, "data": {"pictures": {"held_out": 3, "pictures": 16}}}
    lines = summary(capsys, pictures)
    # those of Test are of a camera
    assert [line.partition(" recordings")[2] for line in lines[:3]] == [
        " (simulated ones: of 3 pictures) right",
        "",
        " right",
    ]
    assert "of the sessions that were learned from" in "".join(
        summary(capsys, {**RECORD, "data": {"held_out_in_time": ["a"]}})
    )
    *_, line, _ = summary(capsys, statistics=SimpleNamespace(n_bytes=1_260_000))
    assert line == "statistics for `async-tnt teach` are 1.3 MB of it (--no-statistics)"
    printed = json.loads("".join(summary(capsys, as_json=True)))
    assert printed == {"out": "m.safetensors", **RECORD}


def test_the_summary_of_a_map_model_tells_f1(capsys):
    found = {"f1": 0.75, "objects": 100, "f1_against_time_ms": {"30": 0.25, "50": 0.5}}
    record = {name: value for name, value in RECORD.items() if name in ("network", "data")}
    record |= {"validation": found, "multiplications": 5}
    assert summary(capsys, record)[:2] == [
        "held out: F1 0.7500 of 100 objects in scenes (0.2500 after 30 ms, 0.5000 after 50 ms)",
        "network conv4, 5 multiplications a complete window; temperature 1.000",
    ]
    # a window of at most 10 ms is scored at its end alone
    record["validation"] = found | {"f1_against_time_ms": {}}
    assert summary(capsys, record)[0] == "held out: F1 0.7500 of 100 objects in scenes"


@pytest.mark.parametrize(("n", "is_told"), [(19, True), (20, False)])
def test_windows_of_a_class_are_told_where_few_recordings_are_held_out(n, is_told, capsys):
    scores = {
        "classes": ["a", "b"],
        "confusion": [[n - 1, 1], [2, 3]],
        "window_confusion": [[30, 4], [5, 6]],
    }
    found = [line for line in summary(capsys, scores=scores) if line.startswith("  ")]
    expected = [
        f"  a: 30 of 34 windows of {n} held-out recordings right",
        "  b: 6 of 11 windows of 5 held-out recordings right",
    ]
    assert found == (expected if is_told else [])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("set --out b.safetensors --json", ""),
        ("set --validation 0.2 --seed 0 --motions recorded", ""),
        (
            "set --roi 1,2,30,40 --crop --size 0.2-0.4 --grid 20x16 --mirror",
            "--roi 1,2,30,40 --crop --mirror --size 0.2-0.4 --grid 20x16",
        ),
        (
            r"set --validation 0.5 --groups user\d+ --network /home/me/mine.py:build --seed 7",
            r"--validation 0.5 --groups 'user\d+' --network mine.py:build --seed 7",
        ),
        ("set --mask hot.npy --camera a.npz", "--mask MASK"),
        (
            "set --everywhere --sensor 96x64 --scales 0.2-0.5",
            "--sensor 96x64 --scales 0.2-0.5 --everywhere",
        ),
    ],
)
def test_the_command_in_the_record_repeats_what_decides_and_names_no_folder(words, told):
    parser = argparse.ArgumentParser()
    train_options.add_arguments(parser)
    args = parser.parse_args(words.split())
    assert train._command(args) == f"async-tnt train {told}".strip()


@pytest.mark.parametrize("option", ["--size", "--scales"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [("0.5", (0.5, 0.5)), (".125-0.25", (0.125, 0.25)), ("1", (1, 1)), ("0.3-1", (0.3, 1))],
)
def test_one_number_is_a_range_of_itself_alone(option, text, expected):
    parser = argparse.ArgumentParser()
    train_options.add_arguments(parser)
    args = parser.parse_args(["set", option, text])
    assert getattr(args, option.removeprefix("--")) == expected


def test_pictures_options_are_refused_for_recordings_alone(program, tmp_path):
    for name in "ab":
        (tmp_path / "set" / name).mkdir(parents=True)
        (tmp_path / "set" / name / "1.npz").touch()
    for words in (("--size", "0.2-0.4"), ("--camera", "a.npz")):
        code, _, err = program("train", tmp_path / "set", *words)
        assert code == 2
        assert "--camera, --size and --scales are for pictures; DATASET holds none" in err
    code, _, err = program("train", tmp_path / "set", "--roi", "0,0,1,9", "--crop")
    assert code == 2 and "must have sides of at least 2 pixels, got 1x9" in err


@pytest.mark.parametrize("share", ["1", "-0.1", "nan", "half"])
def test_a_validation_share_is_below_one(share, program, capsys):
    with pytest.raises(SystemExit) as stopped:
        program("train", "nowhere", f"--validation={share}")
    assert stopped.value.code == 2
    expected = f"argument --validation: must be a share in [0, 1), got '{share}'"
    assert expected in capsys.readouterr().err


NUMBERS = {"events": 100.0, "ON share": 50.0}


@pytest.mark.parametrize(("n_found", "is_warned"), [(20, False), (19, True)])
def test_motions_that_were_found_are_told_and_few_are_warned_of(n_found, is_warned, capsys):
    """A fifth is enough. What differs between recorded and simulated windows is named."""
    record = {
        "windows": 100,
        "with_path": n_found,
        "with_neighbours": 3,
        "without_path": {"too few events": 70, "it jumps": 100 - 70 - n_found},
        "match": {"recorded": NUMBERS, "resynthesized": NUMBERS},
    }
    train._note_motions(record)
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == (
        f"motion found in {n_found} of 100 windows, in 3 of them only with the neighbouring "
        "windows; the other windows are used only as recorded (too few events 70, it jumps "
        f"{30 - n_found})"
    )
    assert any("so few motions hardly change" in line for line in lines) == is_warned
    assert not any("windows differ" in line for line in lines)
    other = {"recorded": NUMBERS, "resynthesized": NUMBERS | {"ON share": 5.0}}
    record |= {"match": other, "with_neighbours": 0, "without_path": {}}
    train._note_motions(record)
    first, *lines = capsys.readouterr().err.splitlines()
    assert first == (
        f"motion found in {n_found} of 100 windows; the other windows are used only as recorded"
    )
    assert "recorded and simulated windows differ in ON share. Compare" in lines[-1]


@pytest.mark.parametrize("is_drawn", [True, False])
def test_at_the_end_what_was_left_out_and_what_was_not_drawn_is_told(
    is_drawn, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    monkeypatch.setattr("async_tnt.training.run_folder.plot_curves", lambda *_: is_drawn)
    model = replace(random_model(), record=RECORD)
    fitted = SimpleNamespace(model=model, scores={"f1": 0.5}, history=[{"epoch": 1}])
    data = SimpleNamespace(tests=None, left_out=["a.npz: no events"], held_out=("b.npz",))
    outputs = train._Outputs(tmp_path / "m.safetensors")
    args = SimpleNamespace(out=outputs.model, json=False)
    monkeypatch.setattr(train, "print_summary", lambda *given, as_json: told.append(given[2]))
    told = []
    train._write(fitted, data, outputs, args)
    why = "no picture of curves: matplotlib is not installed (pip install 'async_tnt[plot]')"
    lines = [] if is_drawn else [why]
    assert capsys.readouterr().err.splitlines() == [*lines, "left out: a.npz: no events"]
    curves = [outputs.curves] if is_drawn else []
    assert told == [[outputs.model, outputs.numbers, *curves]]
    assert load_model(outputs.model).record == RECORD
    numbers = json.loads(outputs.numbers.read_text())
    assert numbers == {
        "f1": 0.5,
        "held_out": ["b.npz"],
        "summary": RECORD,
        "history": [{"epoch": 1}],
    }


def test_what_a_camera_was_measured_to_be_is_told(monkeypatch, capsys):
    pytest.importorskip("torch", reason="training needs torch (extra `train`)")
    measured = SimpleNamespace(
        step_on=0.3, step_off=0.2, after_share=0.125, noise_hz=0.0456, refractory_us=250.4
    )
    asked = []

    def measure_camera(*given, **reading):
        asked.append((given, reading))
        return measured

    monkeypatch.setattr("async_tnt.training.simulated_pictures.measure_camera", measure_camera)
    path = Path("somewhere", "desk.npz")
    args = SimpleNamespace(camera=path, sensor=(34, 30), columns="xypt", topic=None)
    assert train._measured_camera(args, 105_000) is measured
    assert asked == [((path, 105_000, (34, 30)), {"columns": "xypt"})]
    assert capsys.readouterr().err == (
        "desk.npz: thresholds of ON to OFF 1.50, after-pulses 12%, noise 0.046 events a pixel and "
        "second, refractory time up to 250 us (0 of these two: not known)\n"
    )
