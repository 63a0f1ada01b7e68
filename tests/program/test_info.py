"""async-tnt info: recordings, folders and models, for people and for programs."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made import events_of, random_events, random_model

from async_tnt import TNTConfig
from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.sources.files import worker_source
from async_tnt.sources.files.recording import READERS, sample_recordings

SAMPLE = sample_recordings()[3]


def test_a_recording_in_lines_and_as_json(program):
    code, text, _ = program("info", SAMPLE)
    lines = text.splitlines()
    assert code == 0 and lines[0] == f"{SAMPLE}: N-MNIST, 0.0 MB"
    assert lines[1:4] == [
        "  sensor     34x34",
        "  time       3,075 to 307,110 us: 0.304 s",
        "  events     4,952, 16,288 a second; 49% ON",
    ]
    assert lines[4].startswith("  rate       ▁▁▂▄▅▇▇█") and len(lines) == 5
    code, text, _ = program("info", SAMPLE, "--json")
    report = json.loads(text)
    assert code == 0 and report["hot_pixels"] == []
    assert (report["events"], report["first_us"]) == (4_952, 3_075)
    assert np.mean(report["events_a_second"]) * 0.304036 == pytest.approx(4_952, rel=1e-3)


def test_a_sensor_that_is_not_stated_is_asked_for(program, tmp_path):
    np.save(tmp_path / "a.npy", random_events(100))
    code, text, _ = program("info", tmp_path / "a.npy")
    assert code == 0 and "not stated; events reach 34x34; for hot pixels give --sensor WxH" in text
    code, text, _ = program("info", tmp_path / "a.npy", "--sensor", "64x48")
    assert code == 0 and "sensor     64x48, as given" in text
    code, _, err = program("info", tmp_path / "a.npy", "--sensor", "20x20")
    assert code == 2 and err.count("\n") == 1
    assert "events lie off the 20 x 20 sensor; the first is " in err
    assert (
        "the recording is of another sensor, or damaged; the file states none, --sensor, the model "
        "or another recording does" in err
    )


def test_a_folder_names_its_classes_and_what_cannot_be_read(program, tmp_path):
    for name in ("wave/a.npy", "wave/b.npy", "clap/a.npy"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        np.save(tmp_path / name, random_events(100))
    (tmp_path / "clap" / "damaged.npy").write_bytes(b"no")
    code, text, _ = program("info", tmp_path)
    lines = text.splitlines()
    assert code == 2 and lines[0] == f"{tmp_path}: 4 recordings, 300 events; clap 2, wave 2"
    assert len(lines) == 5 and "clap/damaged.npy" in lines[2] and "cannot be read: " in lines[2]
    text = program("info", tmp_path, "--sensor", "8x8")[1]
    assert "of another sensor, or damaged; the file states none, --sensor" in text
    report = json.loads(program("info", tmp_path, "--json")[1])
    assert report["folders"] == {"clap": 2, "wave": 2} and "error" in report["recordings"][1]
    (tmp_path / "empty").mkdir()
    code, _, err = program("info", tmp_path / "empty")
    assert code == 2 and "no recordings in this folder" in err


def test_what_is_hidden_does_not_count(program, tmp_path):
    """This holds at every depth, for files, for folders, and for what lies in hidden folders."""
    for name in ("wave/a.npy", "wave/deep/b.npy"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / name, random_events(100))
    expected = program("info", tmp_path)
    assert expected[0] == 0 and "2 recordings" in expected[1]
    for name in (
        ".cache/a.npy",
        ".cache/deep/a.npy",
        "wave/.trash/c.npy",
        "wave/.c.npy",
        "wave/deep/.x/a.npy",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        np.save(tmp_path / name, random_events(100))
    assert program("info", tmp_path) == expected


@pytest.mark.parametrize("name", bundled_models())
def test_a_model_says_what_it_decides_and_costs(program, name):
    code, text, _ = program("info", name)
    model = load_model(name)
    assert code == 0 and text.startswith(f"{name}: 10 classes: 0, 1, 2")
    assert f"{model.multiplications:,} multiplications a complete window" in text
    assert ("decides    objects" in text) == (model.places is not None)
    report = json.loads(program("info", name, "--json")[1])
    assert report["record"] == json.loads(json.dumps(model.record))
    assert report["volume"] == list(model.config.shape)


def test_a_models_record_is_shown_without_its_tables(program, tmp_path):
    record = {"made": "by hand", "epochs": 3, "accuracy": 0.5, "history": [1, 2], "of": {"a": 1}}
    model = replace(random_model(), record=record)
    _, text, _ = program("info", model.save(tmp_path / "m.safetensors"))
    shown = text.splitlines()[-4:]
    assert shown == [
        "  made       by hand",
        "  epochs     3",
        "  accuracy   0.5",
        "  all of its training record: --json",
    ]


def test_one_that_cannot_be_read_does_not_keep_the_others_back(program):
    code, text, err = program("info", "nothing.bin", SAMPLE, "digits")
    assert code == 2 and err.count("\n") == 1 and "nothing.bin" in err
    assert text.count("N-MNIST") == 1 and "137,738 weights" in text


OTHER_ERRORS = {
    ValueError("torn at byte 9"): "torn at byte 9",
    OSError(5, "Input/output error"): "Input/output error",
    ImportError("a library is missing"): "a library is missing",
    MemoryError("Unable to allocate 1 EiB"): "not enough memory. Unable to allocate 1 EiB",
}


@pytest.mark.parametrize("error", OTHER_ERRORS, ids=lambda error: type(error).__name__)
def test_whatever_a_reader_raises_is_told_of_its_file_alone(error, program, tmp_path, monkeypatch):
    """Files that are named, and those of a folder."""

    def read(path, options):
        raise error

    monkeypatch.setitem(READERS, ".own", read)
    own = tmp_path / "a.own"
    own.touch()
    code, text, err = program("info", own, SAMPLE)
    assert code == 2 and text.count("N-MNIST") == 1
    assert err.startswith(f"async-tnt: {own}: ") and err.endswith(f"{OTHER_ERRORS[error]}\n")
    assert err.count("\n") == 1
    recording_of(tmp_path / "b.npz", random_events(10))
    code, text, err = program("info", tmp_path)
    assert (code, err) == (2, "") and "2 recordings, 10 events" in text
    assert any("a.own" in line and OTHER_ERRORS[error] in line for line in text.splitlines())


def recording_of(path, events, **more):
    np.savez(path, events=events, sensor=np.array([34, 34]), **more)
    return path


@pytest.mark.parametrize(("n_hot", "more"), [(5, ""), (6, ", ...")])
def test_five_hot_pixels_are_named_busiest_first_and_all_of_them_counted(
    program, tmp_path, n_hot, more
):
    parts = [random_events(1_000)]
    for k in range(n_hot):
        n = 300 + 10 * k
        parts.append(events_of(np.arange(n), [5 * k + 2] * n, [7] * n, [1] * n))
    events = np.concatenate(parts)
    at = [int(((events["x"] == 5 * k + 2) & (events["y"] == 7)).sum()) for k in range(n_hot)]
    _, text, _ = program("info", recording_of(tmp_path / "a.npz", events))
    busiest = sorted(range(n_hot), key=lambda k: -at[k])[:5]
    named = ", ".join(f"({5 * k + 2}, 7)" for k in busiest)
    share = f"{sum(at) / len(events):.1%}"
    line = f"  hot pixels {n_hot} make {share} of the events: {named}{more}; see async-tnt mask"
    assert text.splitlines()[-1] == line


def test_unsorted_events_and_quiet_parts_are_shown(program, tmp_path):
    """In the last but one of sixty parts there is one event, and in the last there are 999."""
    t = np.array([0, 58_500, *[59_500] * 998, 60_000])
    events = events_of(t, [1] * 1_001, [2] * 1_001, [1, *[0] * 1_000])
    lines = program("info", recording_of(tmp_path / "a.npz", events))[1].splitlines()
    assert not [line for line in lines if line.startswith("  unsorted")]
    bars = next(line for line in lines if line.startswith("  rate"))
    assert bars.startswith(f"  rate       ▁{' ' * 57}▁█ up to ")
    _, text, _ = program("info", recording_of(tmp_path / "a.npz", events[::-1]))
    assert "  unsorted   3 are earlier than the event before them\n" in text


def test_a_recording_of_one_event_has_no_rate_and_one_of_none_nothing(program, tmp_path):
    one = recording_of(tmp_path / "one.npz", events_of([5], [1], [2], [1]))
    code, text, _ = program("info", one)
    assert code == 0 and "  time       5 to 5 us: 0.000 s\n  events     1; 100% ON\n" in text
    none = recording_of(tmp_path / "none.npz", random_events(0))
    code, text, _ = program("info", none)
    assert code == 0 and text == f"{none}: NumPy archive, 0.0 MB\n  no events\n"


def test_a_folder_or_file_counts_more_than_a_model_of_its_name(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "digits").mkdir()
    recording_of(tmp_path / "digits" / "a.npz", random_events(10))
    code, text, _ = program("info", "digits")
    assert code == 0 and text.splitlines()[0] == "digits: 1 recordings, 10 events; no folders in it"


def test_a_recording_that_needs_a_missing_library_does_not_keep_the_others_back(
    program, tmp_path, monkeypatch
):
    monkeypatch.setattr(worker_source, "find_spec", lambda name: None)
    recording_of(tmp_path / "a.npz", random_events(10))
    (tmp_path / "b.es").write_bytes(b"Event Stream")
    code, text, _ = program("info", tmp_path)
    assert code == 2 and "2 recordings, 10 events" in text
    assert "b.es" in text and "cannot be read: " in text and "pip install" in text


def test_a_model_of_windows_by_number_and_its_map(program, tmp_path):
    config = TNTConfig(window_events=700)
    path = random_model(config).save(tmp_path / "m.safetensors")
    assert "windows of 700 events\n" in program("info", path)[1]
    wide = load_model("digits-everywhere").for_sensor((100, 50)).save(tmp_path / "w.safetensors")
    height, width = load_model(wide).logits_shape[1:]
    assert height < width
    assert f"objects, at {width}x{height} places of the sensor\n" in program("info", wide)[1]


@pytest.mark.parametrize(
    ("window", "length"),
    [
        ({"last_events": 1_500}, "the last 1,500 events"),
        ({"last_us": 40_000}, "the last 40,000 us"),
    ],
    ids=str,
)
def test_a_window_that_slides_is_told_by_its_length(program, tmp_path, window, length):
    model = random_model(TNTConfig(representation="count", **window))
    text = program("info", model.save(tmp_path / "m.safetensors"))[1]
    assert f"windows of {length}\n" in text
    # what is told there is not repeated, and settings that are off are not told
    (volume,) = [line for line in text.splitlines() if line.startswith("  volume")]
    assert "window" not in volume and "last_" not in volume
    assert "remove_flow" not in volume and "representation count" in volume


@pytest.mark.parametrize("name", ["digits", "digits-everywhere"])
def test_what_an_event_costs_and_where_it_decides_as_json(program, name):
    report = json.loads(program("info", name, "--json")[1])
    model = load_model(name)
    work = model.work_of_one_event
    assert report["multiplications"] == model.multiplications
    assert report["multiplications_of_one_event"] == work.touched < work.whole
    assert report["map"] == (None if model.places is None else list(model.logits_shape[1:]))
    assert report["weights"] == sum(weights.size for weights in model.weights.values())
