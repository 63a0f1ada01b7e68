"""The camera that --sensor or --mask names, and the messages if little or nothing of a recording is left."""

import json

import numpy as np
import pytest
from made import random_model

from async_tnt import Model, Processor, TNTConfig
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import save_mask
from async_tnt.sources.pixel_selection import PixelSelection

CAMERA = (60, 48)
EVENTS = open_recording(sample_recordings()[3]).read()
CORNER = "5,4,30,30"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A `.bin` and a set of it, whose events lie within 34x34; masks; models for the camera and for a part of it."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "set" / "0").mkdir(parents=True)
    write_nmnist(folder / "inside.bin", EVENTS)
    write_nmnist(folder / "set" / "0" / "inside.bin", EVENTS)
    mask = np.zeros(CAMERA[::-1], bool)
    mask[10, 12] = True
    save_mask(folder / "mask.npy", mask)
    selection = PixelSelection((5, 4, 30, 30), True, mask)
    record = {"data": {"pixels": {**selection.record, "camera": list(CAMERA)}}}
    for name, sensor, training in (("whole", CAMERA, {}), ("part", (30, 30), record)):
        model = random_model(TNTConfig(sensor=sensor), classes=3, seed=1)
        Model(model.config, model.weights, ("0", "1", "2"), training).save(folder / f"{name}.safetensors")
    return folder


def decided(printed):
    return [(d["time_us"], d["label"], d["events"]) for d in map(json.loads, printed.splitlines())]


def expected(model, pixel_filter):
    from async_tnt import load_model

    processor = Processor(load_model(model))
    return [(d.time_us, d.label, d.events) for d in processor.push(pixel_filter(EVENTS)) + processor.finish()]


def test_run_takes_a_bin_for_the_camera_that_is_named(made, program):
    whole, part = (made / f"{name}.safetensors" for name in ("whole", "part"))
    code, printed, message = program("run", made / "inside.bin", "--model", whole, "--json", "--sensor", "60x48")
    assert code == 0 and "left out" not in message and decided(printed) == expected(whole, PixelFilter(CAMERA))
    words = ("run", made / "inside.bin", "--model", part, "--json", "--roi", CORNER, "--crop")
    by_sensor, by_mask = program(*words, "--sensor", "60x48"), program(*words, "--mask", made / "mask.npy")
    assert by_sensor[0] == by_mask[0] == 0
    assert decided(by_sensor[1]) == expected(part, PixelFilter(CAMERA, (5, 4, 30, 30), crop=True))
    code, printed, _ = program("run", made / "inside.bin", "--model", whole, "--json")  # else it is the model's
    assert code == 0 and decided(printed) == expected(whole, PixelFilter(CAMERA))


def test_evaluate_and_archives_take_it_too(made, program, tmp_path):
    whole = made / "whole.safetensors"
    code, printed, _ = program("evaluate", whole, made / "set", "--json", "--sensor", "60x48")
    assert code == 0 and json.loads(printed)["recordings"] == 1
    assert json.loads(printed)["pixels"] == {"sensor": "60x48"}
    code, printed, _ = program(
        "run", made / "set", "--model", whole, "--out", tmp_path / "r.jsonl", "--sensor", "60x48"
    )
    assert code == 0 and "1 recording" in printed


def test_an_event_of_a_bin_off_the_mask_asks_for_no_other_file(made, program, tmp_path):
    write_nmnist(tmp_path / "big.bin", np.array([(1, 3, 3, 1), (2, 200, 3, 1)], EVENTS.dtype), sensor=None)
    words = ("--model", made / "part.safetensors", "--roi", CORNER, "--crop", "--mask", made / "mask.npy")
    code, _, message = program("run", tmp_path / "big.bin", *words)
    assert code == 2 and "Fetch" not in message
    assert (
        f"big.bin: `x` must be in [0, 60), got 200 at event 1; {made / 'mask.npy'} is a mask of 60x48 pixels" in message
    )


@pytest.mark.parametrize("command", ["run", "archive", "evaluate", "view"])
def test_the_selection_of_the_training_is_compared_with_the_one_given(command, made, program, tmp_path):
    model = made / "part.safetensors"
    if command == "view":
        pytest.importorskip("rerun", reason="the view needs Rerun (extra `view`)")
    words = {
        "run": ("run", made / "inside.bin", "--model", model, "--json"),
        "archive": ("run", made / "set", "--model", model, "--out", tmp_path / "r.jsonl"),
        "evaluate": ("evaluate", model, made / "set", "--json"),
        "view": ("view", made / "inside.bin", "--model", model, "--out", tmp_path / "a.rrd"),
    }[command]
    mask = ("--mask", made / "mask.npy", "--crop", "--roi")
    code, _, message = program(*words, *mask, CORNER)
    assert code == 0 and "trained with" not in message
    code, _, message = program(*words, *mask, "0,0,30,30", *(("--restart",) if command == "archive" else ()))
    notes = [line for line in message.splitlines() if "trained with" in line]
    assert code == 0 and len(notes) == 1
    assert notes[0].startswith(f"async-tnt: {model}: trained with --roi {CORNER} --crop --mask of 1 pixels (")
    assert ", but now it is --roi 0,0,30,30 --crop --mask of 1 pixels (" in notes[0]


@pytest.mark.parametrize("command", ["run", "archive", "evaluate", "view"])
def test_nothing_left_is_told_in_the_same_words(command, made, program, tmp_path):
    (tmp_path / "set" / "0").mkdir(parents=True)
    path = tmp_path / "set" / "0" / "a.npz"
    np.savez(path, events=np.array([(1, 3, 3, 1), (2, 30, 30, 1), (3, 4, 3, 1)], EVENTS.dtype), sensor=(34, 34))
    mask = np.zeros((34, 34), bool)
    mask[3] = True
    save_mask(tmp_path / "mask.npy", mask)
    if command == "view":
        pytest.importorskip("rerun", reason="the view needs Rerun (extra `view`)")
    words = {
        "run": ("run", path),
        "archive": ("run", path, "--out", tmp_path / "r.jsonl"),
        "evaluate": ("evaluate", "digits", tmp_path / "set"),
        "view": ("view", path, "--out", tmp_path / "a.rrd"),
    }[command]
    code, _, message = program(*words, "--roi", "0,0,20,20", "--mask", tmp_path / "mask.npy")
    name = "0/a.npz" if command == "evaluate" else path
    assert code == 2
    assert f"{name}: no events are left: 1 outside of the region, 2 of masked pixels\n" in message


def test_notes_on_order_are_of_what_the_model_sees(program, tmp_path):
    """Disorder among events that are left out is no disorder; and what is left is counted without them."""
    events = EVENTS.copy()
    stray = np.array([(events["t"][-1] - 40_000 + k, 7, 7, 1) for k in range(10)][::-1], EVENTS.dtype)
    own = np.array([(events["t"][-1] - 2_000, 20, 20, 1)], EVENTS.dtype)
    save_mask(tmp_path / "mask.npy", np.fromfunction(lambda y, x: (x == 7) & (y == 7), (34, 34)))
    at_mask = int(((events["x"] == 7) & (events["y"] == 7)).sum())
    np.savez(tmp_path / "a.npz", events=np.concatenate((events, stray)), sensor=(34, 34))
    np.savez(tmp_path / "b.npz", events=np.concatenate((events, stray, own)), sensor=(34, 34))
    masked = ("--mask", tmp_path / "mask.npy")
    assert f"10 of {len(events) + 10} events are older than an earlier one" in program("run", tmp_path / "a.npz")[2]
    assert "older" not in program("run", tmp_path / "a.npz", *masked)[2]
    message = program("run", tmp_path / "b.npz", *masked)[2]
    assert f"b.npz: 1 of {len(events) - at_mask + 1} events are older than an earlier one (see --late)" in message
    message = program("run", tmp_path / "b.npz", *masked, "--late", "drop")[2]
    assert f"b.npz: 1 of {len(events) - at_mask + 1} events were too late and dropped" in message
