"""--roi, --crop, --mask and --sensor of run, run --out, evaluate and view: events are left out before anything else."""

import json

import numpy as np
import pytest
from made import random_model

from async_tnt import Model, Processor, TNTConfig, load_model
from async_tnt.archive.collect import Progress, collect
from async_tnt.archive.executor import executor_of
from async_tnt.archive.job import Job, job_of, task_of
from async_tnt.archive.records import run_recording
from async_tnt.engines import choose_engine
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import PackedMask, save_mask
from async_tnt.sources.pixel_selection import PixelSelection

HOT = [(3, 4), (30, 29), (4, 30)]
SIZE, CAMERA, CORNER = (34, 34), (100, 80), (40, 20)
REGION = ("--roi", "40,20,34,34", "--crop")
SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()
TIMES = ("seconds", "decisions_per_second", "events_per_second")


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
    selection = PixelSelection((5, 4, 30, 30), True, folder / "bin.npy")
    record = {"data": {"pixels": {**selection.record, "camera": [60, 48]}}}
    for name, sensor, training in (("whole", (60, 48), {}), ("part", (30, 30), record)):
        model = random_model(TNTConfig(sensor=sensor), classes=3, seed=1)
        Model(model.config, model.weights, ("0", "1", "2"), training).save(folder / f"{name}.safetensors")
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
        return {name: value for name, value in json.loads(printed).items() if name not in (*TIMES, "pixels")}
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


def test_a_region_without_crop_keeps_the_coordinates(program):
    processor = Processor(load_model("digits"))
    expected = processor.push(PixelFilter(SIZE, roi=(0, 0, 20, 34))(EVENTS)) + processor.finish()
    got = [json.loads(line) for line in program("run", SAMPLE, "--json", "--roi", "0,0,20,34")[1].splitlines()]
    assert [(d["time_us"], d["label"], d["events"]) for d in got] == [(d.time_us, d.label, d.events) for d in expected]


# -- archives ------------------------------------------------------------------------------------------------------


def test_another_selection_is_another_job(sets, tmp_path, program):
    out, mask = tmp_path / "r.jsonl", tmp_path / "m.npy"
    given = "run", sets / "hot", "--out", out
    save_mask(mask, hot_mask(SIZE))
    assert program(*given, "--mask", mask)[0] == 0
    before = out.read_bytes()
    for same in (("--mask", sets / "hot.npy"), ("--mask", mask, "--sensor", "34x34")):
        code, printed, _ = program(*given, *same)
        assert code == 0 and "streamed now" not in printed and out.read_bytes() == before
    save_mask(mask, ~hot_mask(SIZE))
    for others in (("--mask", mask), (), ("--mask", sets / "hot.npy", "--roi", "0,0,33,34")):
        code, _, message = program(*given, *others)
        assert code == 2 and f"{out} was made with another model" in message and message.count("\n") == 1
    assert out.read_bytes() == before


def test_a_finished_parquet_names_the_pixels_that_differ(sets, tmp_path, program):
    pytest.importorskip("pyarrow", reason="Parquet needs pyarrow (extra `cluster`)")
    words = "evaluate", "digits", sets / "large", "--out", tmp_path / "r.parquet", "--mask", sets / "large.npy"
    assert program(*words, *REGION)[0] == 0
    code, _, message = program(*words, "--crop", "--roi", "41,20,34,34")
    assert code == 2 and "was made with roi 40,20,34,34 (now 41,20,34,34): give the same" in message


def test_without_a_selection_the_job_is_the_one_of_older_results():
    """The settings as they were written before there were selections: a change would invalidate all results."""
    of_old = {"command": "run", "version": "0.1.0", "engine": "compiled", "every_us": 5000, "model_sha256": "a" * 64}
    job = Job("run", "digits", "compiled", {"every_us": 5000}, model_sha256="a" * 64, version="0.1.0")
    assert job.metadata == of_old and job.id == "083e09a68da2"
    engine = choose_engine("digits")
    assert job_of("run", "digits", engine).id == job_of("run", "digits", engine, PixelSelection()).id
    assert job_of("run", "digits", engine).id != job_of("run", "digits", engine, PixelSelection((0, 0, 9, 9))).id


def test_workers_need_no_file_of_the_mask(sets, tmp_path):
    mask = tmp_path / "m.npy"
    save_mask(mask, hot_mask(SIZE))
    job = job_of("run", "digits", choose_engine("digits"), PixelSelection(mask=mask))
    mask.unlink()
    tasks = [task_of(path.parent.name, path, job) for path in sorted((sets / "hot").glob("[01]/*"))]
    here, there = (collect(run_recording, tasks, executor_of(n), Progress()) for n in (1, 2))
    assert [r["decisions"] for r in there] == [r["decisions"] for r in here] and here[0]["error"] is None


def test_each_recording_is_counted_by_itself(sets, tmp_path):
    at_hot_pixels = np.zeros(7, EVENTS.dtype)
    at_hot_pixels["x"], at_hot_pixels["y"] = HOT[0]
    for name, events in (("1", with_hot_pixels(EVENTS)), ("2", at_hot_pixels), ("3", at_hot_pixels[:0])):
        write(tmp_path / f"{name}.npz", events, SIZE)
    job = job_of("run", "digits", choose_engine("digits"), PixelSelection(mask=hot_mask(SIZE)), every_us=12_345)
    records = [run_recording(task_of(path.name, path, job)) for path in sorted(tmp_path.glob("*.npz"))]
    nothing = [None, "2.npz: no events are left: 7 of masked pixels", "3.npz: no events"]
    assert [record["error"] for record in records] == nothing


# -- whose camera it is ----------------------------------------------------------------------------------------------


def test_a_bin_is_of_the_camera_that_an_option_or_a_mask_names(sets, tmp_path, program):
    path, whole, part = sets / "bin" / "0" / "a.bin", sets / "whole.safetensors", sets / "part.safetensors"
    roi, mask = (5, 4, 30, 30), sets / "bin.npy"
    crop = ("--roi", "5,4,30,30", "--crop")
    for model, pixel_filter, options in (
        (whole, PixelFilter((60, 48)), ("--sensor", "60x48")),
        (part, PixelFilter((60, 48), roi, crop=True), (*crop, "--sensor", "60x48")),
        (part, PixelFilter((60, 48), roi, crop=True, mask=mask), (*crop, "--mask", mask)),
    ):
        processor = Processor(load_model(model))
        expected = processor.push(pixel_filter(EVENTS)) + processor.finish()
        lines = program("run", path, "--model", model, "--json", *options)[1].splitlines()
        got = [(d["label"], d["events"]) for d in map(json.loads, lines)]
        assert got == [(d.label, d.events) for d in expected]
    for command in ("run", "archive", "evaluate"):
        words = words_for(command, sets / "bin", whole, tmp_path)
        assert program(*words, "--sensor", "60x48")[0] == 0
        code, _, message = program(*words)
        assert code == 2 and "a sensor of 34x34 pixels, but the model is for 60x48" in message


def test_where_no_file_states_the_camera_the_option_or_the_mask_does(sets, tmp_path, program):
    (tmp_path / "set" / "3").mkdir(parents=True)
    np.save(tmp_path / "set" / "3" / "a.npy", np.load(sets / "large" / "3" / "a.npz")["events"])
    for command in ("run", "evaluate"):
        words = (*words_for(command, tmp_path / "set", "digits", tmp_path), *REGION)
        code, _, message = program(*words)
        assert code == 2 and "does not say the camera's pixels, which --crop needs: give --sensor WxH" in message
        assert program(*words, "--sensor", "100x80")[0] == program(*words, "--mask", sets / "large.npy")[0] == 0


def test_a_recording_of_another_sensor_is_an_error_of_that_recording(sets, tmp_path, program):
    write(tmp_path / "set" / "3" / "a.npz", EVENTS, (50, 40))
    write(tmp_path / "set" / "3" / "b.npz", np.load(sets / "large" / "3" / "a.npz")["events"], CAMERA)
    words = "evaluate", "digits", tmp_path / "set", "--json", *REGION, "--sensor", "100x80"
    code, printed, message = program(*words)
    assert code == 0 and json.loads(printed)["recordings"] == 1
    assert "skipped: 3/a.npz: a sensor of 50x40 pixels, but --sensor says 100x80" in message
    code, _, message = program("run", tmp_path / "set", "--out", tmp_path / "r.jsonl", *REGION)
    assert code == 2 and message.count("\n") == 1 and "must lie on the sensor of 50x40 pixels" in message


def test_an_event_off_the_camera_names_the_source_of_its_size(sets, tmp_path, program):
    (tmp_path / "set").mkdir()
    path = tmp_path / "set" / "a.csv"
    path.write_text("t,x,y,p\n0,3,5,1\n1,99,90,1\n")
    part = ("--roi", "0,0,34,34", "--crop")
    for options, side, source in (
        ((*part, "--sensor", "60x60"), 60, "--sensor says 60x60 pixels"),
        ((*part, "--mask", tmp_path / "m.npy"), 95, f"{tmp_path / 'm.npy'} is a mask of 95x95 pixels"),
        (("--roi", "0,0,30,30"), 34, "the model is for 34x34 pixels; train one for this camera"),
        ((), 34, "the model is for 34x34 pixels; train one for this camera"),
    ):
        save_mask(tmp_path / "m.npy", np.zeros((95, 95), bool))
        code, _, message = program("run", path, *options)
        assert code == 2 and f"{path}: `x` must be in [0, {side}), got 99 at event 1; {source}" in message
        archived = program("run", tmp_path / "set", "--out", tmp_path / "r.jsonl", "--restart", *options)[2]
        assert archived.splitlines()[0] == message.splitlines()[0]
    assert "--roi X,Y,34,34 --crop" in message


def test_an_event_of_a_bin_off_the_mask_asks_for_no_other_file(sets, tmp_path, program):
    write_nmnist(tmp_path / "big.bin", np.array([(1, 3, 3, 1), (2, 200, 3, 1)], EVENTS.dtype), sensor=None)
    words = "--model", sets / "part.safetensors", "--roi", "5,4,30,30", "--crop", "--mask", sets / "bin.npy"
    code, _, message = program("run", tmp_path / "big.bin", *words)
    assert code == 2 and "Fetch" not in message
    assert f"big.bin: `x` must be in [0, 60), got 200 at event 1; {sets / 'bin.npy'} is a mask of 60x48" in message


# -- messages ------------------------------------------------------------------------------------------------------


@of_all_commands
def test_the_selection_of_the_training_is_compared_with_the_one_given(command, sets, tmp_path, program):
    model = sets / "part.safetensors"
    words = *words_for(command, sets / "bin", model, tmp_path), "--mask", sets / "bin.npy", "--crop", "--roi"
    code, _, message = program(*words, "5,4,30,30")
    assert code == 0 and "trained with" not in message
    code, _, message = program(*words, "0,0,30,30")
    (note,) = [line for line in message.splitlines() if "trained with" in line]
    assert code == 0 and note.startswith(
        f"async-tnt: {model}: trained with --roi 5,4,30,30 --crop --mask of 1 pixels ("
    )
    assert ", but now it is --roi 0,0,30,30 --crop --mask of 1 pixels (" in note


@of_all_commands
def test_a_recording_of_which_nothing_is_left_says_why(command, tmp_path, program):
    events = np.array([(1, 3, 3, 1), (2, 30, 30, 1), (3, 4, 3, 1)], EVENTS.dtype)
    path = write(tmp_path / "set" / "0" / "a.npz", events, SIZE)
    save_mask(tmp_path / "mask.npy", np.fromfunction(lambda y, x: y == 3, (34, 34)))
    words = words_for(command, tmp_path / "set", "digits", tmp_path)
    code, _, message = program(*words, "--roi", "0,0,20,20", "--mask", tmp_path / "mask.npy")
    name = "0/a.npz" if command == "evaluate" else path
    assert code == 2 and f"{name}: no events are left: 1 outside of the region, 2 of masked pixels\n" in message


def test_notes_on_order_are_of_what_the_model_sees(program, tmp_path):
    """Disorder among events that are left out is none; and what is left is counted without them."""
    last = EVENTS["t"][-1]
    stray = np.array([(last - 40_000 + k, 7, 7, 1) for k in range(10)][::-1], EVENTS.dtype)
    own = np.array([(last - 2_000, 20, 20, 1)], EVENTS.dtype)
    save_mask(tmp_path / "mask.npy", np.fromfunction(lambda y, x: (x == 7) & (y == 7), (34, 34)))
    n_left = len(EVENTS) - int(((EVENTS["x"] == 7) & (EVENTS["y"] == 7)).sum()) + 1
    a = write(tmp_path / "a.npz", np.concatenate((EVENTS, stray)), SIZE)
    b = write(tmp_path / "b.npz", np.concatenate((EVENTS, stray, own)), SIZE)
    masked = ("--mask", tmp_path / "mask.npy")
    assert f"10 of {len(EVENTS) + 10} events are older than an earlier one" in program("run", a)[2]
    assert "older" not in program("run", a, *masked)[2]
    message = program("run", b, *masked)[2]
    assert f"b.npz: 1 of {n_left} events are older than an earlier one (see --late)" in message
    message = program("run", b, *masked, "--late", "drop")[2]
    assert f"b.npz: 1 of {n_left} events were too late and dropped (see --late, --start-us)" in message


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ("--crop", "--crop belongs to --roi"),
        ("--sensor 36x34", "--sensor says 36x34 pixels, but the model is for 34x34: give --roi X,Y,34,34 --crop too"),
        ("--roi 0,0,20,20 --crop", "is for 34x34 pixels, got a region of 20x20; give --roi X,Y,34,34"),
        ("--roi 20,0,20,34", "must lie on the sensor of 34x34 pixels"),
        ("--roi 0,0,34,34 --crop --sensor 40x30", "must lie on the sensor of 40x30 pixels"),
        ("--mask no_such.npy", "no_such.npy: No such file"),
        ("--mask torn.npy", "torn.npy: not a readable NumPy file"),
        ("--mask LARGE", "large.npy: a mask of a 100x80 camera, but the model is for 34x34 pixels: give --roi X,Y"),
        ("--roi 0,0,34,34 --crop --mask LARGE --sensor 90x80", "given as 90x80 (--sensor)"),
    ],
)
@pytest.mark.parametrize("command", ["run", "archive", "evaluate"])
def test_wrong_options_are_one_line(command, options, text, sets, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "torn.npy").write_bytes((sets / "hot.npy").read_bytes()[:90])
    words = [sets / "large.npy" if word == "LARGE" else word for word in options.split()]
    (tmp_path / "set" / "3").mkdir(parents=True)
    (tmp_path / "set" / "3" / "a.npz").symlink_to(sets / "hot" / "3" / "a.npz")
    code, printed, message = program(*words_for(command, tmp_path / "set", "digits", tmp_path), *words)
    assert code == 2 and text in message and message.count("\n") == 1 and printed == "", message
    assert not list(tmp_path.glob("r.*"))
