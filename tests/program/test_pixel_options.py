"""--roi, --crop, --mask and --sensor of run, run --out, evaluate and view: events are left out before anything else."""

import json

import numpy as np
import pytest
from made import random_model

from async_tnt import Model, Processor, TNTConfig, load_model
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import PackedMask, save_mask

HOT = [(3, 4), (30, 29), (4, 30)]
SIZE, CAMERA, CORNER = (34, 34), (100, 80), (40, 20)
REGION = ("--roi", "40,20,34,34", "--crop")
SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()


def hot_mask(size, corner=(0, 0)):
    mask = np.zeros(size[::-1], bool)
    for x, y in HOT:
        mask[corner[1] + y, corner[0] + x] = True
    return mask


def with_hot_pixels(events, corner=(0, 0)):
    """And three pixels that fire 3,000 times each; the first event stays the first."""
    extra = np.zeros(9000, events.dtype)
    extra["t"] = np.linspace(events["t"][0] + 1, events["t"][-1], len(extra)).astype(np.int64)
    extra["x"], extra["y"] = (np.array(HOT)[np.arange(len(extra)) % 3] + corner).T
    both = np.concatenate((events, extra))
    return both[np.argsort(both["t"], kind="stable")]


def write(path, events, sensor):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, events=events, sensor=np.array(sensor))
    return path


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Samples as they are, with hot pixels, and with these somewhere on a larger camera; masks; models for others."""
    folder = tmp_path_factory.mktemp("sets")
    for digit, path in sample_recordings().items():
        events, name = open_recording(path).read(), f"{digit}/a.npz"
        write(folder / "clean" / name, PixelFilter(SIZE, mask=hot_mask(SIZE))(events), SIZE)
        write(folder / "hot" / name, with_hot_pixels(events), SIZE)
        events["x"] += CORNER[0]
        events["y"] += CORNER[1]
        write(folder / "large" / name, with_hot_pixels(events, CORNER), CAMERA)
    save_mask(folder / "hot.npy", hot_mask(SIZE))
    save_mask(folder / "large.npy", hot_mask(CAMERA, CORNER))
    (folder / "bin" / "0").mkdir(parents=True)
    write_nmnist(folder / "bin" / "0" / "a.bin", EVENTS)  # whose file does not say that the camera has 60x48
    save_mask(folder / "bin.npy", np.fromfunction(lambda y, x: (x == 12) & (y == 10), (48, 60)))
    for name, sensor in (("whole", (60, 48)), ("part", (30, 30))):
        model = random_model(TNTConfig(sensor=sensor), classes=3, seed=1)
        Model(model.config, model.weights, ("0", "1", "2")).save(folder / f"{name}.safetensors")
    return folder


def words_for(command, folder, model, tmp_path):
    """A command on all recordings of a set."""
    if command == "view":
        pytest.importorskip("rerun", reason="the view needs Rerun (extra `view`)")
    files = sorted(folder.glob("*/*"))
    return {
        "run": ("run", *files, "--model", model, "--json"),
        "archive": ("run", folder, "--model", model, "--out", tmp_path / "r.jsonl", "--restart"),
        "evaluate": ("evaluate", model, folder, "--json"),
        "view": ("view", *files, "--model", model, "--out", tmp_path / "a.rrd"),
    }[command]


of_all_commands = pytest.mark.parametrize("command", ["run", "archive", "evaluate", "view"])


def result_of(command, folder, tmp_path, program, *options):
    """What a command decides, without what differs from file to file and from run to run."""
    code, printed, message = program(*words_for(command, folder, "digits", tmp_path), *options)
    assert code == 0 and (command == "run" or message == "")
    if command == "evaluate":
        return {name: value for name, value in json.loads(printed).items() if name != "pixels"}
    lines = printed if command == "run" else (tmp_path / "r.jsonl").read_text()
    own = {"recording", "bytes", "modified_ns", "settings", "latency_us"}
    return [{k: v for k, v in json.loads(line).items() if k not in own} for line in lines.splitlines()]


@pytest.mark.parametrize("command", ["run", "archive", "evaluate"])
@pytest.mark.parametrize(("name", "region"), [("hot", ()), ("large", REGION)])
def test_what_is_left_out_is_as_if_it_had_never_been_recorded(command, name, region, sets, tmp_path, program):
    clean = result_of(command, sets / "clean", tmp_path, program)
    found = result_of(command, sets / name, tmp_path, program, *region, "--mask", sets / f"{name}.npy")
    assert found == clean
    disturbed = result_of(command, sets / name, tmp_path, program, *region)
    assert disturbed != clean and (command != "evaluate" or disturbed["accuracy"] < clean["accuracy"])


def test_counts_and_report_say_what_was_left_out(sets, program):
    message = program("run", sets / "large" / "3" / "a.npz", *REGION, "--mask", sets / "large.npy")[2]
    n = 9000 + hot_mask(SIZE)[EVENTS["y"], EVENTS["x"]].sum()
    assert message == f"async-tnt: left out: 0 outside of the region, {n:,} of masked pixels\n"
    words = "evaluate", "digits", sets / "large", "--json", *REGION, "--mask", sets / "large.npy"
    mask = f"100x80 {PackedMask.of(hot_mask(CAMERA, CORNER)).sha256[:16]}"
    assert json.loads(program(*words)[1])["pixels"] == {"roi": "40,20,34,34", "crop": True, "mask": mask}


# -- archives ------------------------------------------------------------------------------------------------------


def test_another_selection_is_another_job(sets, tmp_path, program):
    out, mask = tmp_path / "r.jsonl", tmp_path / "m.npy"
    given = "run", sets / "hot", "--out", out
    save_mask(mask, hot_mask(SIZE))
    assert program(*given, "--mask", mask)[0] == 0
    before = out.read_bytes()
    code, printed, _ = program(*given, "--mask", sets / "hot.npy")
    assert code == 0 and "streamed now" not in printed and out.read_bytes() == before
    save_mask(mask, ~hot_mask(SIZE))
    for others in (("--mask", mask), ("--mask", sets / "hot.npy", "--roi", "0,0,33,34")):
        code, _, message = program(*given, *others)
        assert code == 2 and f"{out} was made with another model" in message and message.count("\n") == 1
    assert out.read_bytes() == before


# -- whose camera it is ----------------------------------------------------------------------------------------------


def test_a_bin_is_of_the_camera_that_the_model_or_a_mask_names(sets, program):
    path, whole, part = sets / "bin" / "0" / "a.bin", sets / "whole.safetensors", sets / "part.safetensors"
    roi, mask = (5, 4, 30, 30), sets / "bin.npy"
    for model, pixel_filter, options in (
        (whole, PixelFilter((60, 48)), ()),
        (part, PixelFilter((60, 48), roi, crop=True, mask=mask), ("--roi", "5,4,30,30", "--crop", "--mask", mask)),
    ):
        processor = Processor(load_model(model))
        expected = processor.push(pixel_filter(EVENTS)) + processor.finish()
        lines = program("run", path, "--model", model, "--json", *options)[1].splitlines()
        got = [(d["label"], d["events"]) for d in map(json.loads, lines)]
        assert got == [(d.label, d.events) for d in expected]


def test_an_event_off_the_camera_names_the_source_of_its_size(tmp_path, program):
    path, mask = tmp_path / "a.csv", tmp_path / "m.npy"
    path.write_text("t,x,y,p\n0,3,5,1\n1,99,90,1\n")
    save_mask(mask, np.zeros((95, 95), bool))
    part = ("--roi", "0,0,34,34", "--crop")
    for options, side, source in (
        ((*part, "--sensor", "60x60"), 60, "--sensor says 60x60 pixels"),
        ((*part, "--mask", mask), 95, f"{mask} is a mask of 95x95 pixels"),
        ((), 34, "the model is for 34x34 pixels; train one for this camera"),
    ):
        code, _, message = program("run", path, *options)
        assert code == 2 and f"{path}: `x` must be in [0, {side}), got 99 at event 1; {source}" in message


# -- messages ------------------------------------------------------------------------------------------------------


@of_all_commands
def test_a_recording_of_which_nothing_is_left_says_why(command, tmp_path, program):
    events = np.array([(1, 3, 3, 1), (2, 30, 30, 1), (3, 4, 3, 1)], EVENTS.dtype)
    path = write(tmp_path / "set" / "0" / "a.npz", events, SIZE)
    save_mask(tmp_path / "mask.npy", np.fromfunction(lambda y, x: y == 3, (34, 34)))
    words = words_for(command, tmp_path / "set", "digits", tmp_path)
    code, _, message = program(*words, "--roi", "0,0,20,20", "--mask", tmp_path / "mask.npy")
    name = "0/a.npz" if command == "evaluate" else path
    assert code == 2 and f"{name}: no events are left: 1 outside of the region, 2 of masked pixels\n" in message


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ("--crop", "--crop belongs to --roi"),
        ("--sensor 36x34", "--sensor says 36x34 pixels, but the model is for 34x34; train one for this camera"),
        ("--roi 0,0,20,20 --crop", "is for 34x34 pixels, got a region of 20x20; give --roi X,Y,34,34"),
        ("--roi 0,0,34,34 --crop --sensor 40x30", "must lie on the sensor of 40x30 pixels"),
        ("--mask torn.npy", "torn.npy: not a mask, a .npy file as `async-tnt mask` writes: not a readable NumPy file"),
        ("--mask LARGE", "large.npy is a mask of 100x80 pixels, but the model is for 34x34; train one"),
        ("--roi 0,0,34,34 --crop --mask LARGE --sensor 90x80", "given as 90x80 (--sensor)"),
    ],
)
def test_wrong_options_are_one_line(options, text, sets, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "torn.npy").write_bytes((sets / "hot.npy").read_bytes()[:90])
    options = [sets / "large.npy" if word == "LARGE" else word for word in options.split()]
    for words in ("run", SAMPLE), ("run", SAMPLE, "--out", "r.jsonl"), ("evaluate", "digits", sets / "hot"):
        code, printed, message = program(*words, *options)
        assert code == 2 and text in message and message.count("\n") == 1 and printed == "", message
        assert not list(tmp_path.glob("r.*"))
