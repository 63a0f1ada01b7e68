"""Class folders of pictures.

Simulated cameras record them. They are split, mixed with recordings, kept and refused.
"""

import json
import os
import shutil
import sys

import numpy as np
import pytest
from damage import damaged_json
from small_sets import write_pictures

from async_tnt import load_model
from async_tnt.simulation.outlines import MOMENTS, POINTS
from async_tnt.simulation.picture_scene import PictureRecording, SceneSettings
from async_tnt.simulation.pictures import read_picture
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training import data as data_module
from async_tnt.training import plan, settings, simulated_pictures
from async_tnt.training.data import dataset_data
from async_tnt.training.recordings import RecordingsWriter
from async_tnt.training.settings import default_config, settings_for
from async_tnt.training.simulated_pictures import (
    LabelledPicture,
    example_recordings,
    find_pictures,
    measure_camera,
    simulate_pictures,
)
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.work import Work
from async_tnt.volume.events import EVENT_DTYPE

SENSOR = (24, 20)
EVENT = np.zeros(1, EVENT_DTYPE)
NOTHING = PictureRecording(EVENT[:0], np.zeros((MOMENTS, POINTS, 2), np.float32))


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": 40, "held-out": 8})
    monkeypatch.setattr(simulated_pictures, "CHUNK", 12)


def data_of(folder, store=None):
    pixels = Pixels(sensor=SENSOR)
    volume = VolumeChoice(default_config(), fitted={"grid"})
    return dataset_data(folder, volume, pixels=pixels, work=Work(store))


def test_each_picture_is_recorded_and_on_one_side(tmp_path):
    data = data_of(write_pictures(tmp_path / "p"), store=tmp_path)
    assert data.classes == ("bar", "disc") and data.config.sensor == SENSOR
    names = data.training.recordings.names
    learned, held_out = [
        {names[r].partition(",")[0] for r in windows.recording}
        for windows in (data.training, data.validation)
    ]
    assert len(learned) == 8
    assert held_out == {"bar/bar04.png", "disc/disc04.png"} == set(data.held_out)
    assert not learned & held_out
    assert 38 <= len(data.training) <= 40 and len(data.validation) == 8  # few without an event
    assert data.record["pictures"]["takes"] == 5 and any(
        "recorded 5 times each" in note for note in data.notes
    )


def test_bad_pictures_are_named_and_left_out(tmp_path):
    write_pictures(tmp_path / "p")
    (tmp_path / "p/bar/bar07.jpg").write_text("no picture")
    if sys.platform == "linux":  # others have no such names
        os.mkfifo(tmp_path / "p/bar/pipe.png")  # no file: to read it would take forever
        (tmp_path / "p/bar/bar00.png").rename(tmp_path / os.fsdecode(b"p/bar/bar00\xff.png"))
        data_of(tmp_path / "p", store=tmp_path)
        (tmp_path / os.fsdecode(b"p/bar/bar00\xff.png")).rename(tmp_path / "p/bar/bar00.png")
        (tmp_path / "p/bar/pipe.png").unlink()
    (tmp_path / "p/bar/gone.png").symlink_to("nowhere.png")
    data = data_of(tmp_path / "p")
    assert len(data.left_out) == 2 and data.left_out[0].startswith("bar/bar07.jpg: not a picture")
    assert "bar/gone.png: [Errno 2] No such file" in data.left_out[1]
    (tmp_path / "p/bar/gone.png").unlink()
    for name, match in (
        ("bar", "bar/zzz.png: the same picture as bar/bar00.png"),
        ("disc", "in two classes"),
    ):
        copy = tmp_path / "p" / name / "zzz.png"
        copy.write_bytes((tmp_path / "p/bar/bar00.png").read_bytes())
        if name == "bar":
            assert any(match in line for line in data_of(tmp_path / "p").left_out)
        else:
            with pytest.raises(ValueError, match=match):
                data_of(tmp_path / "p")
        copy.unlink()
    for path in (tmp_path / "p/bar").iterdir():
        path.write_text("no picture")
    with pytest.raises(ValueError, match="no picture of class bar is left"):
        data_of(tmp_path / "p")


@pytest.mark.parametrize("of_all, takes", [(40, 15), (1, 2)])
def test_a_single_picture_is_not_on_both_sides_and_recorded_so_often(
    tmp_path, monkeypatch, of_all, takes
):
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": of_all, "held-out": 8})
    monkeypatch.setattr(simulated_pictures, "MOST_TAKES", 15)  # of 40 / 2
    data = data_of(write_pictures(tmp_path / "p", n=1))
    assert len(data.validation) == 0 and any("not held out" in note for note in data.notes)
    assert data.record["pictures"]["takes"] == takes


def test_pictures_and_recordings_mix(tmp_path):
    """A class of recordings only, one of pictures only, one of both."""
    write_pictures(tmp_path / "p")
    for name in ("bar", "wave"):
        (tmp_path / "p" / name).mkdir(exist_ok=True)
        for i in range(4):
            t = np.sort(np.random.default_rng((len(name), i)).integers(0, 100_000, 300))
            width, height = SENSOR
            x = np.random.default_rng(i).integers(0, width, 300)
            y = np.random.default_rng(i).integers(0, height, 300)
            p = np.random.default_rng(i).integers(0, 2, 300)
            np.savez(tmp_path / "p" / name / f"{name}{90 + i}.npz", t=t, x=x, y=y, p=p)
    data = data_of(tmp_path / "p")
    of_class = {name: (data.training.labels == k).sum() for k, name in enumerate(data.classes)}
    assert (
        list(of_class) == ["bar", "disc", "wave"]
        and of_class["wave"] == 3
        and of_class["bar"] > of_class["wave"]
    )
    assert {file.name for file in find_pictures(tmp_path / "p")["bar"]} == {
        f"bar{i:02}.png" for i in range(5)
    }
    assert set(data.held_out) == {
        "bar/bar04.png",
        "bar/bar93.npz",
        "disc/disc04.png",
        "wave/wave93.npz",
    }
    record = data.record
    assert (record["real_recordings"], record["held_out_recordings"]) == (6, 2)
    assert record["pictures"]["held_out"] == 2
    assert "recordings and pictures: bar 9, disc 5, wave 4" in data.notes
    for path in tmp_path.glob("p/*/*.npz"):
        path.unlink()
    (tmp_path / "p/wave").rmdir()
    (tmp_path / "p/bar/bar00.png").write_text("no picture")
    data = data_of(tmp_path / "p")
    # no recording follows another one where there are pictures alone
    assert data.record["held_out_recordings"] == data.record["real_recordings"] == 0
    assert not any("within seconds" in note for note in data.notes)
    assert data.record["left_out"] == list(data.left_out) != []


def test_windows_of_a_number_of_events_are_cut_of_recordings_of_the_default_length(
    tmp_path, monkeypatch
):
    """The number says nothing of how long a camera must record."""
    asked = []
    monkeypatch.setattr(
        data_module, "with_pictures", lambda *given: asked.append(given[3]) or pytest.fail("asked")
    )
    folder = write_pictures(tmp_path / "p", n=2)
    pixels = Pixels(sensor=SENSOR)
    for window, window_us in (({"last_events": 50}, 105_000), ({"last_us": 30_000}, 30_000)):
        with pytest.raises(pytest.fail.Exception, match="asked"):
            dataset_data(folder, VolumeChoice.of(**window), pixels=pixels)
        assert (asked[-1].window_us, asked[-1].sensor) == (window_us, SENSOR)


def test_recordings_repeat_and_are_kept(tmp_path, monkeypatch):
    """Any number of processes gives the same recordings.

    What is there is not made again, and other settings are refused.
    """
    folder = write_pictures(tmp_path / "p")
    pictures = [
        LabelledPicture(path, k)
        for k, some in enumerate(find_pictures(folder).values())
        for path in some
    ]
    scene = SceneSettings(SENSOR, 50_000)

    def simulated(store, settings=scene, **options):
        with RecordingsWriter() as writer:
            simulate_pictures(writer, "training", pictures, settings, store, **options)
            return writer.finish()

    first = simulated(tmp_path / "a")
    second = simulated(tmp_path / "b", workers=2)
    for name in ("t", "x", "y", "p", "offsets", "labels"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    (tmp_path / "b/training_000012.npz").unlink()
    monkeypatch.setattr(simulated_pictures, "record_picture", lambda *_: pytest.fail("made again"))
    np.testing.assert_array_equal(simulated(tmp_path / "a").t, first.t)
    manifest = tmp_path / "a/pictures.json"
    good = manifest.read_text()
    errors = []
    for text in damaged_json(json.loads(good), 150, seed=0):
        manifest.write_text(text)
        try:
            np.testing.assert_array_equal(simulated(tmp_path / "a").t, first.t)
        except ValueError as error:
            errors.append(str(error))
    assert len(errors) > 50 and all(
        str(tmp_path / "a") in error and "\n" not in error for error in errors
    )
    manifest.write_text(good)
    with pytest.raises(ValueError, match=r"pictures \(settings\)"):
        simulated(tmp_path / "a", SceneSettings(SENSOR, 40_000))
    with monkeypatch.context() as patch:  # recordings of another release
        patch.setattr(simulated_pictures, "FORMAT", simulated_pictures.FORMAT + 1)
        with pytest.raises(ValueError, match=r"pictures \(format\)"):
            simulated(tmp_path / "a")
    with pytest.raises(pytest.fail.Exception, match="made again"):
        simulated(tmp_path / "b")
    changed = pictures[0].path.read_bytes()
    pictures[0].path.write_bytes(pictures[1].path.read_bytes())
    with pytest.raises(ValueError, match=r"pictures \(training pictures\)"):
        simulated(tmp_path / "a")
    pictures[0].path.write_bytes(changed)
    (tmp_path / "a/training_000012.npz").write_bytes(b"PK damaged")
    with pytest.raises(ValueError, match=r"training_000012\.npz"):
        simulated(tmp_path / "a")
    manifest.write_text(manifest.read_text()[:-9])
    with pytest.raises(ValueError, match=r"pictures.json: damaged .*; remove"):
        simulated(tmp_path / "a")
    manifest.unlink()
    with pytest.raises(
        ValueError,
        match=r"a: recordings of pictures without their pictures.json; remove this folder",
    ):
        simulated(tmp_path / "a")


def test_each_part_of_a_run_is_made_of_pictures_that_are_written_down(tmp_path, monkeypatch):
    """A run with other pictures on either side is refused; another seed is another run."""
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": 4, "held-out": 3})
    folder = write_pictures(tmp_path / "p", n=3)
    pictures = [LabelledPicture(path, 0) for path in find_pictures(folder)["bar"]]
    scene = SceneSettings(SENSOR, 20_000)
    sides = {"training": pictures[:2], "held-out": pictures[2:]}

    def simulated(store, changed=None, seed=0):
        made = []
        for part, some in sides.items():
            if part == changed:
                some = pictures
            with RecordingsWriter() as writer:
                simulate_pictures(writer, part, some, scene, store, seed=seed)
                made.append(writer.finish())
        return made

    first = simulated(tmp_path / "a")
    assert [name.partition(", ")[0] for name in first[1].names] == ["bar/bar02.png"] * 3
    assert {name.rpartition(", ")[2] for name in first[1].names} == {f"take {k}" for k in (1, 2, 3)}
    again = simulated(tmp_path / "a")
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.t, other.t)
    for part in sides:
        with pytest.raises(ValueError, match=rf"other pictures \({part} pictures\)"):
            simulated(tmp_path / "a", changed=part)
    with pytest.raises(ValueError, match=r"other pictures \(seed\)"):
        simulated(tmp_path / "a", seed=1)
    renamed = pictures[0].path.with_stem("bar0")
    sides["training"][0] = LabelledPicture(pictures[0].path.rename(renamed), 0)
    with pytest.raises(ValueError, match=r"other pictures \(training pictures\)"):
        simulated(tmp_path / "a")
    other = simulated(tmp_path / "b", seed=1)
    assert not any(np.array_equal(a.t, b.t) for a, b in zip(first, other, strict=True))


def test_every_recording_has_motions_of_its_own(tmp_path, monkeypatch):
    """One picture is in two classes and on both sides, and in a figure."""
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": 6, "held-out": 6})
    path = find_pictures(write_pictures(tmp_path / "p", n=1))["bar"][0]
    scene = SceneSettings(SENSOR, 20_000)
    with RecordingsWriter() as writer:
        for part in simulated_pictures.RECORDINGS:
            twice = [LabelledPicture(path, label) for label in (0, 1)]
            assert simulate_pictures(writer, part, twice, scene, tmp_path / "a") == 3
        made = writer.finish()
    assert len({part.tobytes() for part in np.split(made.t, made.offsets[1:-1])}) == 12
    shown = example_recordings({"one": [path], "other": [path]}, scene, seed=0)
    takes = [events.tobytes() for _, _, recordings in shown for events in recordings]
    assert len(takes) == 2 * simulated_pictures.N_TAKES == len(set(takes))


@pytest.mark.parametrize(
    ("sensor", "how", "n_takes"),
    [
        ((128, 128), {}, 40),
        ((64, 32), {}, 40),
        ((256, 128), {}, 20),
        ((128, 128), {"follow": True}, 7),  # 40 / 6
        ((64, 32), {"follow": True}, 40),
        ((1280, 720), {}, 4),  # a tenth at least
        ((1280, 720), {"follow": True}, 4),
        ((256, 256), {"cut_out": True}, 40),
        ((512, 256), {"cut_out": True}, 20),
    ],
)
def test_a_sensor_that_takes_longer_takes_fewer(sensor, how, n_takes, tmp_path, monkeypatch):
    """A large one, and one that follows the object, which takes six times as long. Of one that is
    cut out around objects, a quarter is simulated."""
    monkeypatch.setattr(simulated_pictures, "run_counted", lambda *_: None)
    monkeypatch.setattr(simulated_pictures, "_read", lambda chunk: [NOTHING] * len(chunk.takes))
    picture = LabelledPicture(find_pictures(write_pictures(tmp_path / "p", n=1))["bar"][0], 0)
    settings = SceneSettings(sensor, 20_000, **how)
    with RecordingsWriter() as writer:
        takes = simulate_pictures(writer, "training", [picture], settings, tmp_path / "a")
        assert takes == len(writer.finish()) == n_takes


def test_pictures_are_found_by_suffixes_in_any_case_but_no_hidden_files_or_folders(tmp_path):
    folder = write_pictures(tmp_path / "p", n=1)
    (folder / "bar" / "bar00.png").rename(folder / "bar" / "IMG.PNG")
    (folder / "bar" / ".thumb.png").write_bytes(b"")
    (folder / "bar" / "old.png").mkdir()
    found = find_pictures(folder)
    assert {name: [path.name for path in some] for name, some in found.items()} == {
        "bar": ["IMG.PNG"],
        "disc": ["disc00.png"],
    }


def test_pictures_of_all_usual_formats_are_found(tmp_path):
    suffixes = ["bmp", "gif", "jpeg", "jpg", "pgm", "png", "ppm", "tif", "tiff", "webp"]
    (tmp_path / "bar").mkdir()
    for suffix in suffixes:
        (tmp_path / "bar" / f"a.{suffix}").touch()
    (found,) = find_pictures(tmp_path).values()
    assert [path.name for path in found] == [f"a.{suffix}" for suffix in suffixes]


def test_the_example_of_a_class_is_its_first_picture_that_can_be_read(tmp_path, monkeypatch):
    """One is damaged, and one is gone since it was found."""
    folder = write_pictures(tmp_path / "p")
    found = {name: paths[:3] for name, paths in find_pictures(folder).items()}
    first, second, third = found["bar"]
    first.write_bytes(b"no picture")
    second.unlink()
    shown = example_recordings(found, SceneSettings(SENSOR, 100_000), seed=0)
    assert [name for name, *_ in shown] == list(found)
    monkeypatch.setattr(simulated_pictures, "N_EXAMPLES", 1)
    (only,) = example_recordings(found, SceneSettings(SENSOR, 100_000), seed=0)
    assert only[0] == "bar"
    examples = {name: light for name, light, _ in shown}
    assert np.array_equal(examples["bar"], read_picture(third).light)
    assert np.array_equal(examples["disc"], read_picture(found["disc"][0]).light)


def test_a_camera_of_another_sensor_is_not_measured(tmp_path):
    t = np.arange(0, 300_000, 100)
    np.savez(tmp_path / "a.npz", t=t, x=t % 5, y=t % 7, p=t % 2, sensor=(25, 20))
    with pytest.raises(ValueError, match=r"a camera of \(25, 20\) pixels, expected \(24, 20\)"):
        measure_camera(tmp_path / "a.npz", 100_000, SENSOR)


def test_a_file_of_a_large_sensor_has_fewer_recordings(tmp_path, monkeypatch):
    # a third of them, five
    monkeypatch.setattr(simulated_pictures, "RECORDINGS", {"training": 15, "held-out": 8})
    picture = LabelledPicture(find_pictures(write_pictures(tmp_path / "p"))["bar"][0], 0)
    with RecordingsWriter() as writer:
        simulate_pictures(
            writer, "training", [picture], SceneSettings((256, 192), 20_000), tmp_path
        )
    assert sorted(path.name for path in tmp_path.glob("*.npz"))[1] == "training_000004.npz"


def test_without_a_sensor_or_pictures(tmp_path, program, monkeypatch):
    write_pictures(tmp_path / "p")
    code, _, err = program("train", tmp_path / "p", "--out", tmp_path / "m.safetensors")
    assert code == 2 and "--sensor must be given, the camera's: " in err
    assert "has pictures, which have no sensor" in err
    code, _, err = program(
        "train", tmp_path / "p", "--sensor", "24x20", "--motions", "resynthesized"
    )
    assert code == 2 and "--motions resynthesized is for recordings" in err
    for words in (("--mask", "m.npy"), ("--roi", "0,0,9,9")):
        code, _, err = program("train", tmp_path / "p", "--sensor", "24x20", *words)
        assert code == 2 and "--mask, and --roi without --crop, are for recordings" in err
    code, _, err = program("train", tmp_path / "p", "--camera", tmp_path / "a.npz")
    assert code == 2 and "--camera needs --sensor WxH, the camera's pixels" in err
    write_pictures(tmp_path / "p" / "Test", n=1)
    code, _, err = program("train", tmp_path / "p", "--sensor", "24x20", "--test")
    assert code == 2 and "--test needs recordings of a camera in DATASET/Test" in err
    shutil.rmtree(tmp_path / "p" / "Test")
    code, _, err = program("train", tmp_path / "q", "--sensor", "24x20", "--size", "0.2-0.4")
    assert code == 2 and f"no folder {tmp_path / 'q'}" in err
    np.savez(tmp_path / "p/day.npz", t=[1], x=[1], y=[1], p=[1])
    (tmp_path / "p/day_labels.csv").write_text("class,start,end\nbar,0,5\n")
    code, _, err = program(
        "train", tmp_path / "p", "--sensor", "24x20", "--out", tmp_path / "m.safetensors"
    )
    assert code == 2 and "expected pictures or sessions, got both: bar/bar00.png and day.npz" in err
    (tmp_path / "p/day.npz").unlink()
    (tmp_path / "p/day_labels.csv").unlink()
    monkeypatch.setattr(simulated_pictures, "record_picture", lambda *_: NOTHING)
    with pytest.raises(
        ValueError, match=r"no window of class bar, disc has an event \(windows of 105000 us\)"
    ):
        data_of(tmp_path / "p")
    (tmp_path / "p/none").mkdir()
    code, _, err = program(
        "train", tmp_path / "p", "--sensor", "24x20", "--out", tmp_path / "m.safetensors"
    )
    assert code == 2 and "no recordings in the class folder none" in err


@pytest.mark.parametrize("text", ["0.8-0.4", "0-1", "a", "0.2-1.1", ""])
def test_sizes_that_are_none(program, capsys, text):
    with pytest.raises(SystemExit):
        program("train", "x", "--size", text)
    assert "expected a range such as 0.4-0.8" in capsys.readouterr().err


def test_a_camera_is_measured(tmp_path):
    """Two thirds of its events are ON, a refractory time of at least 1 ms."""
    rng = np.random.default_rng(0)
    t = np.arange(0, 3_000_000, 50)
    x = rng.integers(0, 24, len(t))
    y = rng.integers(0, 20, len(t))
    np.savez(tmp_path / "a.npz", t=t, x=x, y=y, p=rng.random(len(t)) < 2 / 3)
    camera = measure_camera(tmp_path / "a.npz", 100_000, SENSOR)
    with np.load(tmp_path / "a.npz") as columns:  # it may state its sensor
        np.savez(tmp_path / "stated.npz", sensor=SENSOR, **columns)
    assert measure_camera(tmp_path / "stated.npz", 100_000, SENSOR) == camera
    assert camera.step_on / camera.step_off == pytest.approx(0.5, rel=0.05)
    # noise alone, before and after an hour
    t = np.concatenate(
        [np.sort(rng.integers(start, start + 10_000_000, 500)) for start in (0, 3_600_000_000)]
    )
    np.savez(
        tmp_path / "b.npz",
        t=t,
        x=rng.integers(0, 24, 1000),
        y=rng.integers(0, 20, 1000),
        p=np.arange(1000) % 2,
    )
    noisy = measure_camera(tmp_path / "b.npz", 100_000, SENSOR)
    assert (noisy.step_on, noisy.step_off) == (1, 1) and noisy.noise_hz == pytest.approx(
        1000 / 480 / 20, rel=0.2
    )
    with pytest.raises(ValueError, match=f"no longer than a window of {t[-1]} us"):
        measure_camera(tmp_path / "b.npz", int(t[-1]), SENSOR)


def test_trained_on_pictures_alone(tmp_path, program, monkeypatch):
    """The model of the whole command tells bars from discs that it was not shown.

    Its record says what it is from.
    """
    write_pictures(tmp_path / "p", n=8)
    asked = []
    monkeypatch.setattr(
        plan, "settings_for", lambda *a, **k: asked.append(k) or settings_for(*a, **k)
    )
    out = tmp_path / "m.safetensors"
    words = ("train", tmp_path / "p", "--sensor", "24x20", "--epochs", 2, "--network", "thesis")
    words += ("--out", out)
    code, printed, err = program(*words, "--json")
    assert code == 0, err
    assert (tmp_path / "runs/m/pictures/pictures.png").stat().st_size > 10_000
    assert (
        all(settings.OF_PICTURES.items() <= one["augmentation"].items() for one in asked) and asked
    )
    record = json.loads(printed)
    assert record["data"]["pictures"]["pictures"] == 16 and record["data"]["pictures"]["settings"][
        "size"
    ] == [0.4, 0.8]
    repeated = program(*words)
    assert repeated[0] == 0, repeated[2]  # what is finished is not done again
    assert "recordings (simulated ones: of 4 pictures) right" in repeated[1]
    again, _, err = program(*words, "--size", ".5")
    assert again == 2 and "a run with other pictures (settings)" in err


def test_objects_of_many_sizes_are_learned_in_scenes_of_the_sensor(tmp_path, program, few_steps):
    """A short training from the command line; the model knows objects by their share."""
    write_pictures(tmp_path / "p")
    out = tmp_path / "m.safetensors"
    words = ["train", tmp_path / "p", "--everywhere", "--sensor", "96x64", "--scales", "0.2-0.5"]
    code, _, err = program(*words, "--out", out, "--epochs", "1")
    assert code == 0, err
    model = load_model(out)
    assert model.by_share and model.has_sizes
    # the smallest objects have about 10 cells: 50 along the shorter side, in steps of 8
    assert (model.config.sensor, model.config.grid) == ((96, 64), (72, 48))
    assert model.logits_shape == (2 + 5, 12, 18) and model.record["network"] == "boxes"
    settings_of_pictures = model.record["data"]["pictures"]["settings"]
    # 2.4 times the largest object of 32 pixels
    assert settings_of_pictures["sensor"] == [77, 77] and settings_of_pictures["cut_out"] is True
    assert np.array(settings_of_pictures["size"]) * 77 == pytest.approx([0.2 * 64, 0.5 * 64])
    assert "f1" in model.record["validation"]
    assert model.for_sensor((192, 128)).config.grid == (72, 48)
    # it resumes from the run folder, and ends with the same weights
    before = out.read_bytes()
    code, _, err = program(*words, "--out", out, "--epochs", "1")
    assert code == 0 and out.read_bytes() == before


def test_which_options_go_with_sizes_of_objects(tmp_path, program):
    write_pictures(tmp_path / "p", n=2)
    words = ("train", tmp_path / "p", "--sensor", "48x32", "--out", tmp_path / "m.safetensors")
    for more, message in [
        (("--scales", "0.2-0.5"), "--scales is for --everywhere"),
        (("--scales", "0.2-0.5", "--everywhere", "--size", "0.3"), "give --scales alone"),
    ]:
        code, _, err = program(*words, *more)
        assert code == 2 and message in err, err
    t = np.arange(300)
    for name in ("bar", "disc"):
        path = tmp_path / "p" / name / "one.npz"
        np.savez(path, t=t, x=(t + len(name)) % 48, y=t % 32, p=t % 2)
    code, _, err = program(*words, "--scales", "0.2-0.5", "--everywhere")
    assert code == 2 and "--scales is for pictures, which are recorded at any size" in err
    for path in tmp_path.glob("p/*/*.png"):
        path.unlink()
    code, _, err = program(*words, "--scales", "0.2-0.5", "--everywhere")
    assert code == 2 and "--scales are for pictures; DATASET holds none" in err
