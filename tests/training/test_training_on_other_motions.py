"""Windows under other motions: made once, resumed, mixed with recorded ones, and trained on."""

import json
import os
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
from damage import damaged_json
from moving_scenes import WINDOW_US, blobs, noise, recorded, straight

pytest.importorskip("torch")

from async_tnt import TNTConfig, load_model
from async_tnt.resynthesis.calibration import differing_numbers, side_by_side
from async_tnt.resynthesis.reconstruction import SimulatedPixels
from async_tnt.simulation.measured_pixels import MeasuredPixels
from async_tnt.training import resynthesis
from async_tnt.training.fitting import fit
from async_tnt.training.loop import train
from async_tnt.training.moved_windows import moved_recordings
from async_tnt.training.recordings import Recordings
from async_tnt.training.resynthesis import MotionSettings, examples, resynthesize
from async_tnt.training.settings import TrainSettings
from async_tnt.training.training_data import TrainingData
from async_tnt.training.windows import make_windows
from async_tnt.volume.events import structured

CONFIG = TNTConfig(transform="none", landmark="center")
SETTINGS = MotionSettings(variations=2)


def windows_of(seed, n):
    """Two windows of each recording, moving right in the first one and down in the second.

    The last recording holds noise only.
    """
    rng = np.random.default_rng(seed)
    events = []
    for k in range(n + 1):
        scene = blobs(rng)
        parts = []
        for start_us, net in ((0, (6.0, 0.0)), (WINDOW_US, (0.0, 6.0))):
            t, *rest = recorded(scene, straight(net), rng) if k < n else noise(rng, 600)
            parts.append(structured((t + start_us, *rest)))
        events.append(np.concatenate(parts))
    return make_windows(
        Recordings.from_events(events, np.arange(n + 1) % 2), WINDOW_US, duration_us=2 * WINDOW_US
    )


@pytest.fixture(scope="module")
def windows():
    return windows_of(0, 6), windows_of(1, 2)


@pytest.fixture(scope="module")
def made(windows, tmp_path_factory):
    """Motions that were made in files of five windows."""
    folder = tmp_path_factory.mktemp("motions")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("async_tnt.training.resynthesis.MOST_WINDOWS", 5)
        motions = resynthesize(*windows, CONFIG, SETTINGS, folder / "motions")
        yield motions, folder / "motions"


def test_a_damaged_description_of_the_motions_is_named(windows, made, tmp_path):
    """Whatever is in it: a value of another type, or one that nobody writes.

    What is read can be used.
    """
    folder = tmp_path / "motions"
    shutil.copytree(made[1], folder)
    manifest = folder / "motions.json"
    good = json.loads(manifest.read_text())
    n_refused = 0
    for text in [*damaged_json(good, 300, seed=0), *damaged_json(good["pixels"], 50, seed=1)]:
        manifest.write_text(text)
        try:
            motions = resynthesize(*windows, CONFIG, SETTINGS, folder)
        except ValueError as error:
            n_refused += 1
            assert str(folder) in str(error) and "\n" not in str(error) and len(str(error)) < 800
        else:
            match = motions.record["match"]
            assert side_by_side(match) and differing_numbers(match) is not None
            pixels = motions.record["pixels"]
            SimulatedPixels(MeasuredPixels(**pixels["measured"]), pixels["scale"])
    assert n_refused > 150
    manifest.unlink()
    os.mkfifo(manifest)
    with pytest.raises(OSError, match="a pipe or a device, expected a regular file"):
        resynthesize(*windows, CONFIG, SETTINGS, folder)


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_every_window_but_noise_has_other_motions(windows, made):
    motions, folder = made
    assert motions.spans.tolist() == [1] * 12 + [0] * 2
    assert motions.validation.labels.tolist() == [0, 0, 1, 1]
    assert (motions.record["windows"], motions.record["with_path"]) == (14, 12)
    assert (motions.record["held_out_windows"], motions.record["held_out_with_path"]) == (6, 4)
    assert motions.record["with_neighbours"] == 0  # each window has its own path
    (reason,) = set(motions.refused[12:])
    assert reason and motions.record["without_path"] == {reason: 2}
    assert (motions.refused[:12] == "").all()
    np.testing.assert_allclose(motions.paths[:12:2, -1], np.tile([6, 0], (6, 1)), atol=1.6)
    np.testing.assert_allclose(motions.paths[1:12:2, -1], np.tile([0, 6], (6, 1)), atol=1.6)
    moved = moved_recordings([folder / "training_000005.npz"], 1, np.arange(5), CONFIG)
    assert np.diff(moved.offsets).min() > 50


def test_only_windows_of_the_set_are_neighbours(windows):
    """A neighbour that is not trained on, or is held out, tells nothing of a window's motion."""
    every = windows[0]
    first = np.flatnonzero(every.start_us == 0)[:4]
    second = np.flatnonzero(every.start_us == WINDOW_US)[:4]
    both = every[np.concatenate([first, second])]
    assert both.neighbours(WINDOW_US).tolist() == [[0, 1]] * 4 + [[1, 0]] * 4
    assert every[first].neighbours(WINDOW_US).tolist() == [[0, 0]] * 4
    assert len(every.events(0, WINDOW_US, (0, WINDOW_US))[0]) > len(every.events(0, WINDOW_US)[0])


def test_the_same_files_for_any_number_of_workers_and_after_an_interruption(
    windows, made, tmp_path, monkeypatch
):
    """Here three of five files by two workers, after one worker has made all."""
    _, folder = made
    shutil.copytree(folder, tmp_path / "cut")
    for name in ("training_000000.npz", "training_000010.npz", "held-out_000005.npz"):
        (tmp_path / "cut" / name).unlink()
    resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "cut", workers=2)
    assert contents(tmp_path / "cut") == contents(folder)
    # a description that is gone is written again
    (tmp_path / "cut" / "motions.json").unlink()
    resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "cut")
    assert contents(tmp_path / "cut") == contents(folder)
    monkeypatch.setattr("async_tnt.training.resynthesis.run_counted", lambda *_: None)
    monkeypatch.setattr(
        "async_tnt.training.resynthesis.calibrate", lambda *_: pytest.fail("made again")
    )
    resynthesize(*windows, CONFIG, SETTINGS, folder)
    # how many are shown as recorded changes none of them
    resynthesize(*windows, CONFIG, replace(SETTINGS, recorded=0.5), folder)


def test_a_figure_shows_the_motions_that_are_in_the_files(windows, made):
    """Windows of all files: here each recording is a class, and its first window is shown.

    So every window has random motions of its own.
    """
    motions, _ = made
    recordings = replace(windows[0].recordings, labels=np.arange(7))
    training = replace(windows[0], recordings=recordings)
    shown, refused = examples(replace(motions, training=training), tuple("abcdefg"))
    ((name, events, reason),) = [(one.name, one.recorded, one.reason) for one in refused]
    assert (name, reason) == ("g", motions.refused[12])
    np.testing.assert_array_equal(events["t"], training.events(12, WINDOW_US)[0])
    chosen = {"abcdefg".index(example.name): example for example in shown}
    assert len(chosen) == 5 and {2 * k // 5 for k in chosen} == {0, 1, 2}
    all_others = []
    for variation in range(2):
        moved = moved_recordings(motions.files, variation, training.labels, CONFIG)
        for k, example in chosen.items():
            other = example.others[variation]
            of_window = slice(*moved.offsets[2 * k : 2 * k + 2])
            for name in "txyp":
                np.testing.assert_array_equal(other[name], getattr(moved, name)[of_window])
            all_others.append(other)
    assert len({other.tobytes() for other in all_others}) == 10


def test_a_recorded_window_has_the_events_around_it_that_augmentation_may_move_it_to(windows, made):
    """A tenth of its length before it, and after it also what a late start needs. Windows 6 and 7
    are the first and the second one of a recording."""
    motions = replace(made[0], settings=replace(SETTINGS, recorded=1.0))
    around_us = (WINDOW_US // 10, 7 * WINDOW_US // 10)
    shown = motions.show(0, np.array([7, 6]), np.random.default_rng(0))
    for k, own in ((0, 7), (1, 6)):
        expected = windows[0].events(own, WINDOW_US, around_us)
        assert len(expected[0]) > len(windows[0].events(own, WINDOW_US)[0])
        np.testing.assert_array_equal(shown.events(k, WINDOW_US, around_us), expected)


def test_another_process_has_the_events_of_windows_and_of_their_neighbours(
    windows, tmp_path, monkeypatch
):
    """It does not have the whole data set. Some windows have neighbours, and some have none."""
    monkeypatch.setattr(resynthesis, "MOST_WINDOWS", 5)
    every = windows[0]
    for part in (every, every[::2], every[np.array([0, 2, 3, 4])]):
        for chunk in resynthesis._chunks("training", part, CONFIG, tmp_path, 2):
            sent = pickle.loads(pickle.dumps(chunk))
            assert len(sent.windows.recordings.t) < len(every.recordings.t)
            assert sent.windows.labels.tolist() == chunk.windows.labels.tolist()
            for k, around_us in enumerate(chunk.around_us):
                events = [one.windows.events(k, WINDOW_US, around_us) for one in (sent, chunk)]
                np.testing.assert_array_equal(*events)


def test_a_file_has_as_many_windows_as_have_about_so_many_events(windows, monkeypatch, tmp_path):
    monkeypatch.setattr(resynthesis, "MOST_WINDOWS", 500)
    some = windows[0][:12]
    n_events = sum(len(some.events(k, WINDOW_US)[0]) for k in range(12))

    def firsts(most_events):
        monkeypatch.setattr(resynthesis, "MOST_EVENTS", most_events)
        chunks = resynthesis._chunks("training", some, CONFIG, tmp_path, 2)
        assert sum(len(chunk.windows) for chunk in chunks) == 12
        return [chunk.first for chunk in chunks]

    assert firsts(n_events) == [0]
    assert firsts(n_events / 12 * 5.5) == [0, 5, 10]
    assert firsts(1) == list(range(12))


def test_what_an_epoch_shows(windows, made):
    """An epoch shows a window or its variation, and a quarter as recorded.

    Windows without a path are always shown as recorded. Epochs take turns.
    """
    motions, folder = made
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(14), 200))
    for epoch, variation in ((0, 0), (1, 1), (2, 0)):
        shown = motions.show(epoch, order, np.random.default_rng(epoch))
        assert shown.labels.tolist() == windows[0].labels[order].tolist()
        moved = moved_recordings([folder / "training_000005.npz"], variation, np.arange(5), CONFIG)
        of_7 = slice(*moved.offsets[2:4])
        is_recorded = []
        for i in np.flatnonzero(order == 7):
            events = shown.events(i, WINDOW_US)
            as_recorded = windows[0].events(7, WINDOW_US)
            is_recorded.append(np.array_equal(events[0], as_recorded[0]))
            if is_recorded[-1]:  # augmentation begins some of them .6 later
                later = [
                    part.events(k, 8 * WINDOW_US // 5)[0]
                    for part, k in ((shown, i), (windows[0], 7))
                ]
                np.testing.assert_array_equal(*later)
            if not is_recorded[-1]:
                np.testing.assert_array_equal(
                    events, [getattr(moved, name)[of_7] for name in "txyp"]
                )
        assert 0.15 < np.mean(is_recorded) < 0.35
        for i in np.flatnonzero(order >= 12)[::10]:
            np.testing.assert_array_equal(
                shown.events(i, WINDOW_US)[0], windows[0].events(order[i], WINDOW_US)[0]
            )


@pytest.mark.parametrize(("at_least", "is_told"), [(4, True), (5, False)])
def test_training_is_validated_on_other_motions_if_they_are_many(
    windows, made, tmp_path, monkeypatch, at_least, is_told
):
    motions, _ = made
    for module in ("loop", "fitting"):
        monkeypatch.setattr(f"async_tnt.training.{module}.MIN_MOVED", at_least)
    settings = TrainSettings(epochs=3, batch=8, balance=True)
    data = TrainingData(CONFIG, ("a", "b"), *windows)
    fitted = fit(data, settings, tmp_path / "run", motions=motions)
    row = fitted.history[-1]
    assert (
        "per_window" in row
        and ({"motions_per_window", "motions_validation_loss"} <= set(row)) == is_told
    )
    assert "motions_per_recording" not in row
    assert ("validation_motions" in fitted.model.record) == is_told
    if is_told:  # each of these windows is a recording of its own
        found = fitted.model.record["validation_motions"]
        assert found["windows"] == 4 and not [name for name in found if "recording" in name]
    with pytest.raises(ValueError, match="motions"):
        train(data, settings, tmp_path / "run")


def test_masked_pixels_stay_silent(windows, tmp_path):
    masked = np.zeros((34, 34), bool)
    masked[10:20, 12] = True
    motions = resynthesize(
        windows[0][:6], windows[1][:0], CONFIG, MotionSettings(2), tmp_path / "m", masked=masked
    )
    recordings = motions.show(0, np.arange(6), np.random.default_rng(0)).recordings
    moved = slice(int(recordings.offsets[-7]), None)
    assert (
        not masked[recordings.y[moved], recordings.x[moved]].any()
        and len(recordings.t[moved]) > 1_000
    )


def test_other_and_damaged_folders_are_refused(windows, made, tmp_path):
    _, folder = made
    shutil.copytree(folder, tmp_path / "torn")

    def refused(message, *, of=windows, settings=SETTINGS, folder=tmp_path / "torn", **more):
        with pytest.raises(ValueError, match=message):
            resynthesize(*of, CONFIG, settings, folder, **more)

    refused(r"other motions \(variations\)", settings=MotionSettings(variations=3))
    refused(r"other motions \(windows\)", of=(windows[1], windows[1]))
    refused(r"other motions \(mask\)", masked=np.eye(34, dtype=bool))
    refused(r"other motions \(seed\)", settings=replace(SETTINGS, seed=1))
    for name, value in (("sensor", (40, 34)), ("window_us", WINDOW_US + 1)):
        with pytest.raises(ValueError, match=rf"other motions \({name}\)"):
            resynthesize(*windows, CONFIG.replace(**{name: value}), SETTINGS, tmp_path / "torn")
    with pytest.raises(ValueError, match=r"torn: damaged \(5 windows, expected 4\)"):
        moved_recordings([tmp_path / "torn/training_000000.npz"], 0, np.arange(4), CONFIG)
    path = tmp_path / "torn" / "held-out_000000.npz"
    arrays = dict(np.load(path))
    content = path.read_bytes()
    for damage in (
        content[:-3],
        content[:2_000] + bytes([content[2_000] ^ 1]) + content[2_001:],
        b"",
    ):
        path.write_bytes(damage)
        refused(r"held-out_000000.npz: damaged .*Remove it and give the same command")
    for name, value in (("x", 34), ("p", 3), ("t", -1), ("t", 1)):
        moved = arrays["moved_0"].copy()
        moved[name][-1] = value
        np.savez(path, **arrays | {"moved_0": moved})
        refused(f"held-out_000000.npz: damaged .*`{name}` must")
    for name, wrong in (
        ("refused", arrays["refused"][:, np.newaxis]),
        ("spans", arrays["spans"][:-1]),
        ("spans", arrays["spans"].astype(float)),
        ("positions", arrays["positions"][:, 1:]),
    ):
        np.savez(path, **arrays | {name: wrong})
        refused("held-out_000000.npz: damaged .*`refused`, `spans` and `positions` have shapes")
    for text in ("{", "[]", "[" * 10_000):
        (tmp_path / "torn" / "motions.json").write_text(text)
        refused(r"motions\.json: damaged")
    with pytest.raises(ValueError, match="`variations` must be at least 1, got 0"):
        MotionSettings(variations=0)
    for share in (-0.1, 1.1):
        with pytest.raises(ValueError, match=rf"`recorded` must be in \[0, 1\], got {share}"):
            MotionSettings(recorded=share)
    with pytest.raises(ValueError, match="`window_us` must be at least 104"):
        resynthesize(*windows, CONFIG.replace(window_us=100), SETTINGS, tmp_path / "short")
    sliding = TNTConfig(representation="count", last_us=WINDOW_US)
    with pytest.raises(ValueError, match="`config` must have windows with a start"):
        resynthesize(*windows, sliding, SETTINGS, tmp_path / "sliding")


def test_the_command(tmp_path, program, few_steps):
    rng = np.random.default_rng(0)
    for k in range(12):
        path = tmp_path / "data" / "ab"[k % 2] / f"{k}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, events=structured(recorded(blobs(rng), straight((6.0, 1.0)), rng)))
    words = ["--sensor", "34x34", "--epochs", 2, "--motions", "resynthesized"]
    words += ["--out", tmp_path / "m.safetensors"]
    code, printed, err = program("train", tmp_path / "data", *words, "--json")
    assert code == 0 and "motion found in 10 of 10 windows" in err and "events per window" in err
    summary = json.loads(printed)
    # of two windows
    assert summary["motions"]["with_path"] == 10 and "validation_motions" not in summary
    # no more than epochs
    model = load_model(tmp_path / "m.safetensors")
    assert model.record["motions"]["variations"] == 2
    # what moves otherwise has time bins, however often pixels fire
    assert (model.config.representation, model.config.bins) == ("volume", 5)
    assert (tmp_path / "runs" / "m" / "motions" / "motions.png").read_bytes().startswith(b"\x89PNG")
    code, _, err = program("train", tmp_path / "data", *words)
    assert code == 0 and "epoch" not in err, err  # what is finished is not done again
