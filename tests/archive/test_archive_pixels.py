"""`run --out` and `evaluate` with --roi, --crop, --mask and --sensor: the events that `run` leaves out."""

import json

import numpy as np
import pytest

from async_tnt.archive.collect import Progress, collect
from async_tnt.archive.executor import executor_of
from async_tnt.archive.job import Job, job_of, task_of
from async_tnt.archive.records import run_recording
from async_tnt.engines import choose_engine
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import PackedMask, save_mask
from async_tnt.sources.pixel_selection import PixelSelection

TIMES = {"seconds", "decisions_per_second", "events_per_second"}
HOT = [(3, 4), (30, 29), (4, 30)]
CAMERA = (100, 80)
SIZE = (34, 34)
CORNER = (40, 20)


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
    extra["p"] = 1
    both = np.concatenate((events, extra))
    return both[np.argsort(both["t"], kind="stable")]


def write(path, events, sensor):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, events=events, sensor=np.array(sensor))


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """The ten samples, as they are; with hot pixels; and with both, somewhere on a larger camera."""
    folder = tmp_path_factory.mktemp("sets")
    for digit, path in sample_recordings().items():
        events = open_recording(path).read()
        name = f"{digit}/a.npz"
        write(folder / "clean" / name, PixelFilter(SIZE, mask=hot_mask(SIZE))(events), SIZE)
        write(folder / "hot" / name, with_hot_pixels(events), SIZE)
        moved = events.copy()
        moved["x"] += CORNER[0]
        moved["y"] += CORNER[1]
        write(folder / "large" / name, with_hot_pixels(moved, CORNER), CAMERA)
    save_mask(folder / "hot.npy", hot_mask(SIZE))
    save_mask(folder / "large.npy", hot_mask(CAMERA, CORNER))
    return folder


@pytest.fixture(scope="module")
def chosen(sets):
    """The options for each set."""
    return {
        "clean": (),
        "hot": ("--mask", sets / "hot.npy"),
        "large": ("--roi", "40,20,34,34", "--crop", "--mask", sets / "large.npy"),
    }


def records_in(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


def what_was_decided(record):
    return {k: v for k, v in record.items() if k not in ("recording", "bytes", "modified_ns", "settings", "seconds")}


def report_of(printed):
    return {name: value for name, value in json.loads(printed).items() if name not in TIMES}


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("name", ["hot", "large"])
def test_run_writes_what_run_prints_under_the_same_options(name, workers, sets, chosen, tmp_path, program):
    out = tmp_path / "r.jsonl"
    words = (*chosen[name], "--every-us", 20_000)
    assert program("run", sets / name, "--out", out, "--workers", workers, *words)[0] == 0
    _, lines, message = program("run", *sorted((sets / name).glob("*/*")), "--json", *words)
    assert "left out: " in message
    expected: dict = {}
    for line in map(json.loads, lines.splitlines()):
        del line["latency_us"]
        expected.setdefault(line.pop("recording"), []).append(line)
    assert {record["recording"]: record["decisions"] for record in records_in(out)} == expected


@pytest.mark.parametrize("name", ["hot", "large"])
def test_what_is_left_out_is_as_if_it_had_never_been_recorded(name, sets, chosen, tmp_path, program):
    """With hot pixels the decisions are others; the mask brings back every digit of them."""
    found = {}
    for which, words in (("clean", ()), (name, chosen[name])):
        out = tmp_path / f"{which}.jsonl"
        assert program("run", sets / which, "--out", out, *words)[0] == 0
        found[which] = [what_was_decided(record) for record in records_in(out)]
    assert found[name] == found["clean"] and len(found[name]) == 10
    disturbed = tmp_path / "d.jsonl"
    rest = [word for word in chosen[name] if word != "--mask" and word not in sets.glob("*.npy")]
    assert program("run", sets / name, "--out", disturbed, *rest)[0] == 0
    assert [r["label"] for r in records_in(disturbed)] != [r["label"] for r in found["clean"]]


@pytest.mark.parametrize("workers", [1, 2])
def test_evaluate_is_as_of_a_dataset_without_those_events(workers, sets, chosen, tmp_path, program):
    reports = {}
    for name, words in chosen.items():
        code, printed, message = program("evaluate", "digits", sets / name, "--json", "--workers", workers, *words)
        assert code == 0 and message == ""
        reports[name] = report_of(printed)
        roi = {"roi": "40,20,34,34", "crop": True} if name == "large" else {}
        mask = {"clean": {}, "hot": hot_mask(SIZE), "large": hot_mask(CAMERA, CORNER)}[name]
        size = f"{mask.shape[1]}x{mask.shape[0]}" if len(mask) else ""
        expected = {**roi, "mask": f"{size} {PackedMask.of(mask).sha256[:16]}"} if len(mask) else None
        assert reports[name].pop("pixels", None) == expected
    assert reports["hot"] == reports["large"] == reports["clean"] and reports["clean"]["recordings"] == 10
    disturbed = report_of(program("evaluate", "digits", sets / "hot", "--json")[1])
    assert disturbed["accuracy"] < reports["clean"]["accuracy"]
    with_file = program("evaluate", "digits", sets / "hot", "--json", "--out", tmp_path / "e.jsonl", *chosen["hot"])
    from_file = report_of(with_file[1])
    assert from_file.pop("pixels")["mask"].startswith("34x34 ")
    assert from_file == reports["clean"]


@pytest.mark.parametrize("words", [("run",), ("evaluate", "digits")])
def test_another_selection_is_another_job(words, sets, tmp_path, program):
    out = tmp_path / "r.jsonl"
    given = (*words, sets / "hot", "--out", out)
    mask = tmp_path / "m.npy"
    save_mask(mask, hot_mask(SIZE))
    assert program(*given, "--mask", mask)[0] == 0
    before = out.read_bytes()
    assert program(*given, "--mask", sets / "hot.npy")[0] == 0  # the same mask by another name
    assert out.read_bytes() == before
    save_mask(mask, ~hot_mask(SIZE))
    for others in (("--mask", mask), (), ("--mask", sets / "hot.npy", "--roi", "0,0,33,34")):
        code, _, message = program(*given, *others)
        assert code == 2 and f"{out} was made with another model" in message and message.count("\n") == 1
    assert out.read_bytes() == before


@pytest.mark.needs_pyarrow
def test_a_finished_parquet_names_the_pixels_that_differ(sets, tmp_path, program):
    out = tmp_path / "r.parquet"
    words = "evaluate", "digits", sets / "large", "--out", out, "--mask", sets / "large.npy", "--crop"
    assert program(*words, "--roi", "40,20,34,34")[0] == 0
    code, _, message = program(*words, "--roi", "41,20,34,34")
    assert code == 2 and "was made with roi 40,20,34,34 (now 41,20,34,34): give the same" in message
    assert program(*words, "--roi", "41,20,34,34", "--restart")[0] == 0


def test_without_a_selection_the_job_is_the_one_of_older_results():
    """The settings as they were written before there were selections: a change would invalidate all results."""
    job = Job("run", "digits", "compiled", {"every_us": 5000}, model_sha256="a" * 64, version="0.1.0")
    assert job.metadata == {
        "command": "run",
        "version": "0.1.0",
        "engine": "compiled",
        "every_us": 5000,
        "model_sha256": "a" * 64,
    }
    assert job.id == "083e09a68da2"
    engine = choose_engine("digits", "compiled")
    assert job_of("run", "digits", engine).id == job_of("run", "digits", engine, PixelSelection()).id
    assert job_of("run", "digits", engine).id != job_of("run", "digits", engine, PixelSelection((0, 0, 9, 9))).id


def test_a_recording_of_which_nothing_is_left_says_so(sets, tmp_path, program):
    everything = np.ones(SIZE[::-1], bool)
    save_mask(tmp_path / "all.npy", everything)
    out = tmp_path / "r.jsonl"
    one = sets / "hot" / "3" / "a.npz"
    code, _, message = program("run", one, "--out", out, "--mask", tmp_path / "all.npy")
    n = len(open_recording(one).read())
    assert code == 2 and f"{one}: no events are left: {n:,} of masked pixels" in message
    assert records_in(out)[0]["error"] in message


def test_a_recording_of_another_sensor_is_an_error_of_that_recording(sets, tmp_path, program):
    write(tmp_path / "set" / "3" / "a.npz", open_recording(sample_recordings()[3]).read(), (50, 40))
    write(tmp_path / "set" / "3" / "b.npz", np.load(sets / "large" / "3" / "a.npz")["events"], CAMERA)
    words = "--roi", "40,20,34,34", "--crop", "--sensor", "100x80"
    code, printed, message = program("evaluate", "digits", tmp_path / "set", "--json", *words)
    assert code == 0 and json.loads(printed)["recordings"] == 1
    assert "skipped: 3/a.npz: a sensor of 50x40 pixels, but --sensor says 100x80" in message
    code, _, message = program("run", tmp_path / "set", "--out", tmp_path / "r.jsonl", *words[:3])
    assert code == 2 and message.count("\n") == 1 and "must lie on the sensor of 50x40 pixels" in message


def test_where_no_file_says_the_camera_the_option_or_the_mask_does(sets, tmp_path, program):
    (tmp_path / "set" / "3").mkdir(parents=True)
    np.save(tmp_path / "set" / "3" / "a.npy", np.load(sets / "large" / "3" / "a.npz")["events"])
    words = "evaluate", "digits", tmp_path / "set", "--json", "--roi", "40,20,34,34", "--crop"
    code, _, message = program(*words)
    assert code == 2 and "does not say the camera's pixels, which --crop needs: give --sensor WxH" in message
    by_option = program(*words, "--sensor", "100x80", "--mask", sets / "large.npy")
    by_mask = program(*words, "--mask", sets / "large.npy")
    assert by_option[0] == by_mask[0] == 0 and report_of(by_option[1]) == report_of(by_mask[1])


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--crop",), "--crop belongs to --roi"),
        (("--sensor", "36x34"), "--sensor says 36x34 pixels, but the model is for 34x34"),
        (("--roi", "0,0,20,20", "--crop"), "is for 34x34 pixels, got a region of 20x20"),
        (("--roi", "20,0,20,34"), "must lie on the sensor of 34x34 pixels"),
        (("--mask", "no_such.npy"), "no_such.npy: No such file"),
        (("--mask", "torn.npy"), "torn.npy: not a readable NumPy file"),
        (
            ("--mask", "LARGE"),
            "large.npy: a mask of a 100x80 camera, but the model is for 34x34 pixels: give --roi X,Y",
        ),
        (("--roi", "0,0,34,34", "--crop", "--mask", "LARGE", "--sensor", "90x80"), "given as 90x80 (--sensor)"),
    ],
)
@pytest.mark.parametrize("command", ["run", "evaluate"])
def test_wrong_options_are_one_line_before_any_work(command, words, text, sets, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "torn.npy").write_bytes((sets / "hot.npy").read_bytes()[:90])
    words = [sets / "large.npy" if word == "LARGE" else word for word in words]
    start = ("run",) if command == "run" else ("evaluate", "digits")
    code, printed, message = program(*start, sets / "hot", "--out", "r.jsonl", *words)
    assert code == 2 and text in message and message.count("\n") == 1 and printed == "", message
    assert not list(tmp_path.glob("r.*"))


@pytest.mark.parametrize("executor", ["processes", "dask"], indirect=True)
def test_workers_need_no_file_of_the_mask(executor, sets, tmp_path):
    engine = choose_engine("digits", "compiled")
    mask = tmp_path / "m.npy"
    save_mask(mask, hot_mask(SIZE))
    job = job_of("run", "digits", engine, PixelSelection(mask=mask))
    mask.unlink()
    tasks = [task_of(path.parent.name, path, job) for path in sorted((sets / "hot").glob("*/*"))]
    here, there = (collect(run_recording, tasks, at, Progress()) for at in (executor_of(), executor))
    assert [what_was_decided(r) for r in there] == [what_was_decided(r) for r in here]
    assert len(there) == 10 and all(r["error"] is None for r in there)


def test_a_sensor_that_repeats_the_masks_size_goes_on(sets, chosen, tmp_path, program):
    out = tmp_path / "r.jsonl"
    words = ("run", sets / "large", "--out", out, *chosen["large"])
    assert program(*words)[0] == 0
    before = out.read_bytes()
    code, printed, message = program(*words, "--sensor", "100x80")
    assert code == 0 and "streamed now" not in printed, message
    assert out.read_bytes() == before
    without_mask = (*words[:4], "--roi", "40,20,34,34", "--crop", "--restart")
    assert program(*without_mask, "--sensor", "100x80")[0] == 0
    code, _, message = program(*without_mask[:-1], "--sensor", "101x80")  # of which these recordings are not
    assert code == 2 and "was made with another model" in message


def test_an_event_off_the_camera_is_message_as_by_run(sets, tmp_path, program):
    """By whom its size is said, in the words of `run`, in a recording's error too."""
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "a.csv").write_text("t,x,y,p\n0,3,5,1\n1,99,90,1\n")
    save_mask(tmp_path / "m95.npy", np.zeros((95, 95), bool))
    for words, who in (
        (("--roi", "0,0,34,34", "--crop", "--mask", tmp_path / "m95.npy"), "m95.npy is a mask of 95x95 pixels"),
        (("--roi", "0,0,30,30"), "the model is for 34x34 pixels; train one for this camera"),
        ((), "the model is for 34x34 pixels; train one for this camera"),
    ):
        code, _, message = program("run", tmp_path / "set", "--out", tmp_path / "r.jsonl", "--restart", *words)
        by_run = program("run", tmp_path / "set" / "a.csv", *words)[2].splitlines()[0]
        assert code == 2 and message.splitlines()[0] == by_run and who in by_run, (message, by_run)


def test_a_thread_keeps_one_selector_and_counts_each_recording_of_its_own(sets, tmp_path, monkeypatch):
    from async_tnt.archive import records as records_module

    made = []

    class Counted(records_module.PixelSelector):
        def __init__(self, *settings):
            made.append(settings)
            super().__init__(*settings)

    monkeypatch.setattr(records_module, "PixelSelector", Counted)
    write(tmp_path / "1.npz", np.load(sets / "hot" / "3" / "a.npz")["events"], SIZE)
    at_hot_pixels = np.zeros(7, np.load(sets / "hot" / "3" / "a.npz")["events"].dtype)
    at_hot_pixels["x"], at_hot_pixels["y"] = HOT[0]
    write(tmp_path / "2.npz", at_hot_pixels, SIZE)
    write(tmp_path / "3.npz", at_hot_pixels[:0], SIZE)
    job = job_of("run", "digits", choose_engine("digits"), PixelSelection(mask=hot_mask(SIZE)), every_us=12_345)
    records = [run_recording(task_of(path.name, path, job)) for path in sorted(tmp_path.glob("*.npz"))]
    assert [record["error"] for record in records] == [
        None,
        "2.npz: no events are left: 7 of masked pixels",
        "3.npz: no events",
    ]
    assert len(made) == 1
