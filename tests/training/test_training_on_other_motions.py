"""Windows under other motions: made once, resumed, mixed with recorded ones, and trained on."""

import json
import shutil

import numpy as np
import pytest
from moving_scenes import WINDOW_US, blobs, noise, recorded, straight

pytest.importorskip("torch")

from async_tnt import EVENT_DTYPE, TNTConfig, load_model
from async_tnt.training.loop import batches_of, train
from async_tnt.training.moved_windows import moved_recordings
from async_tnt.training.recordings import Recordings
from async_tnt.training.resynthesis import MotionSettings, examples, resynthesize
from async_tnt.training.settings import TrainSettings
from async_tnt.training.windows import Windows

CONFIG = TNTConfig(transform="none", landmark="center")
SETTINGS = MotionSettings(variations=2)
BARS = {"across": (0.0, 4.0), "down": (np.pi / 2, 4.0)}


def windows_of(seed, n=10):
    """Two windows of each recording, moving right in the first and down in the second; the last holds noise only."""
    rng = np.random.default_rng(seed)
    recordings = []
    for _ in range(n):
        scene = blobs(rng)
        first, second = (recorded(scene, straight(net), rng) for net in ((6.0, 0.0), (0.0, 6.0)))
        recordings.append([*first, *second])
    recordings.append([*noise(rng, 600), *noise(rng, 600)])
    events = []
    for t, x, y, p, t2, x2, y2, p2 in recordings:
        one = np.empty(len(t) + len(t2), EVENT_DTYPE)
        one["t"], one["x"] = np.concatenate([t, t2 + WINDOW_US]), np.concatenate([x, x2])
        one["y"], one["p"] = np.concatenate([y, y2]), np.concatenate([p, p2])
        events.append(one)
    return Windows(
        Recordings.from_events(events, np.arange(n + 1) % 2),
        np.repeat(np.arange(n + 1), 2),
        np.tile([0, WINDOW_US], n + 1),
    )


@pytest.fixture(scope="module")
def windows():
    return windows_of(0), windows_of(1, 4)


@pytest.fixture(scope="module")
def made(windows, tmp_path_factory):
    """In files of five windows."""
    folder = tmp_path_factory.mktemp("motions")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("async_tnt.training.resynthesis.MOST_WINDOWS", 5)
        yield resynthesize(*windows, CONFIG, SETTINGS, folder / "motions"), folder / "motions"


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_every_window_but_noise_has_other_motions(windows, made):
    motions, folder = made
    assert motions.found.tolist() == [True] * 20 + [False] * 2
    assert len(motions.validation) == 8 and motions.validation.labels.tolist() == [0, 0, 1, 1, 0, 0, 1, 1]
    assert (motions.record["windows"], motions.record["with_path"]) == (22, 20)
    assert (motions.record["held_out_windows"], motions.record["held_out_with_path"]) == (10, 8)
    np.testing.assert_allclose(motions.paths[:20:2, -1], np.tile([6, 0], (10, 1)), atol=1.6)
    np.testing.assert_allclose(motions.paths[1:20:2, -1], np.tile([0, 6], (10, 1)), atol=1.6)
    moved = moved_recordings([folder / "training_000005.npz"], 1, np.arange(5), CONFIG)
    assert np.diff(moved.offsets).min() > 50


def test_the_same_files_for_any_number_of_workers_and_after_an_interruption(windows, made, tmp_path, monkeypatch):
    _, folder = made
    resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "two", workers=2)
    assert contents(tmp_path / "two") == contents(folder)
    shutil.copytree(folder, tmp_path / "cut")
    for name in ("training_000010.npz", "held-out_000005.npz"):
        (tmp_path / "cut" / name).unlink()
    resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "cut")
    assert contents(tmp_path / "cut") == contents(folder)
    monkeypatch.setattr("async_tnt.training.resynthesis.run_all", lambda job, missing, workers: iter(missing[:0]))
    monkeypatch.setattr("async_tnt.training.resynthesis.calibrate", lambda *_: pytest.fail("made again"))
    resynthesize(*windows, CONFIG, SETTINGS, folder)


def test_a_shared_path_is_that_of_all_windows_with_the_same_start(windows, made, tmp_path):
    motions = resynthesize(*windows, CONFIG, MotionSettings(1, shared_path=True), tmp_path / "shared")
    assert (motions.paths[::2] == motions.paths[0]).all() and (motions.paths[1::2] == motions.paths[1]).all()
    np.testing.assert_allclose(motions.paths[:2, -1], [(6, 0), (0, 6)], atol=0.8)


def test_what_an_epoch_shows(windows, made):
    """A window or its variation, a quarter as recorded; those without a path always as recorded; epochs take turns."""
    motions, folder = made
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(22), 200))
    for epoch, variation in ((0, 0), (1, 1), (2, 0)):
        shown = motions.show(epoch, order, np.random.default_rng(epoch))
        assert shown.labels.tolist() == windows[0].labels[order].tolist()
        moved = moved_recordings([folder / "training_000005.npz"], variation, np.arange(5), CONFIG)
        of_7 = slice(*moved.offsets[2:4])
        is_recorded = []
        for i in np.flatnonzero(order == 7):
            events, as_recorded = shown.events(i, WINDOW_US), windows[0].events(7, WINDOW_US)
            is_recorded.append(np.array_equal(events[0], as_recorded[0]))
            if not is_recorded[-1]:
                np.testing.assert_array_equal(events, [getattr(moved, name)[of_7] for name in "txyp"])
        assert 0.15 < np.mean(is_recorded) < 0.35
        for i in np.flatnonzero(order >= 20)[::10]:
            np.testing.assert_array_equal(shown.events(i, WINDOW_US)[0], windows[0].events(order[i], WINDOW_US)[0])


def test_training_mixes_them_and_is_validated_on_other_motions(windows, made, tmp_path):
    motions, _ = made
    settings = TrainSettings(epochs=3, batch=8, balance=True)
    batches = [some for some, _ in batches_of(CONFIG, windows[0], settings, 0, motions)]
    assert np.bincount(np.concatenate([some.labels for some in batches])).tolist() == [11, 11]
    result = train(CONFIG, *windows, settings, tmp_path / "run", classes=("a", "b"), motions=motions)
    row = result.history[-1]
    assert {"per_window", "motions_per_window", "motions_validation_loss"} <= set(row)
    again = train(CONFIG, *windows, settings, tmp_path / "run", classes=("a", "b"), motions=motions)
    assert again.history == result.history
    with pytest.raises(ValueError, match="motions"):
        train(CONFIG, *windows, settings, tmp_path / "run", classes=("a", "b"))


def test_masked_pixels_stay_silent(windows, tmp_path):
    masked = np.zeros((34, 34), bool)
    masked[10:20, 12] = True
    motions = resynthesize(windows[0][:6], windows[1][:0], CONFIG, MotionSettings(2), tmp_path / "m", masked=masked)
    recordings = motions.show(0, np.arange(6), np.random.default_rng(0)).recordings
    moved = slice(int(recordings.offsets[-7]), None)
    assert not masked[recordings.y[moved], recordings.x[moved]].any() and len(recordings.t[moved]) > 1_000
    with pytest.raises(ValueError, match=r"other motions \(mask\)"):
        resynthesize(windows[0][:6], windows[1][:0], CONFIG, MotionSettings(2), tmp_path / "m")


def test_windows_are_cut_out_of_their_recordings():
    events = np.rec.fromarrays([np.arange(0, 1_000, 10), *np.ones((3, 100), int)], EVENT_DTYPE)
    windows = Windows(Recordings.from_events([events], [3]), np.zeros(3, np.int64), np.array([0, 300, 900]))
    cut = windows.cut(200, 50)
    assert cut.start_us.tolist() == [50, 50, 50] and cut.labels.tolist() == [3, 3, 3]
    assert np.diff(cut.recordings.offsets).tolist() == [25, 30, 15]
    for i in range(3):
        for got, expected in zip(cut.events(i, 200), windows.events(i, 200), strict=True):
            np.testing.assert_array_equal(got, expected)
            assert got.dtype == expected.dtype
    assert cut.events(1, 200)[0].tolist() == list(range(0, 200, 10))


def test_wrong_folders_and_settings_are_refused(windows, made, tmp_path):
    _, folder = made
    with pytest.raises(ValueError, match=r"run with other motions \(variations\)"):
        resynthesize(*windows, CONFIG, MotionSettings(variations=3), folder)
    with pytest.raises(ValueError, match=r"other motions \(windows\)"):
        resynthesize(windows[1], windows[1], CONFIG, SETTINGS, folder)
    shutil.copytree(folder, tmp_path / "torn")
    path = tmp_path / "torn" / "held-out_000000.npz"
    content = path.read_bytes()
    for damage in (content[:-3], content[:2_000] + bytes([content[2_000] ^ 1]) + content[2_001:], b"", b"[]"):
        path.write_bytes(damage)
        with pytest.raises(ValueError, match=r"held-out_000000.npz: damaged .*Remove it and give the same command"):
            resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "torn")
    arrays = dict(np.load(folder / path.name))
    for name, value in (("x", 34), ("p", 3), ("t", -1), ("t", 1)):
        moved = arrays["moved_0"].copy()
        moved[name][-1] = value
        np.savez(path, **arrays | {"moved_0": moved})
        with pytest.raises(ValueError, match=f"held-out_000000.npz: damaged .*`{name}` must"):
            resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "torn")
    for text in ("{", "[]", "{}", "3", "[" * 10_000):
        (tmp_path / "torn" / "motions.json").write_text(text)
        with pytest.raises(ValueError, match=r"motions\.json: damaged"):
            resynthesize(*windows, CONFIG, SETTINGS, tmp_path / "torn")
    with pytest.raises(ValueError, match="`window_us` must be at least 104"):
        resynthesize(*windows, CONFIG.replace(window_us=100), SETTINGS, tmp_path / "short")
    for settings, message in (({"variations": 0}, "`variations` must be"), ({"recorded": 1.5}, "`recorded` must be")):
        with pytest.raises(ValueError, match=message):
            MotionSettings(**settings)


def test_examples_are_those_that_were_made(windows, made):
    motions, folder = made
    shown = examples(motions, ("a", "b"))
    assert [example.name for example in shown] == ["a", "b"]
    moved = moved_recordings([folder / "training_000000.npz"], 1, np.arange(5), CONFIG)
    for name in "txyp":
        np.testing.assert_array_equal(shown[0].others[1][name], getattr(moved, name)[: moved.offsets[1]])
    assert len(shown[0].others) == 2 and len(shown[0].motions) == 3


@pytest.fixture
def classes(tmp_path):
    """A folder of two classes that move to the right only."""
    rng = np.random.default_rng(0)
    for name, (angle, length) in BARS.items():
        (tmp_path / "data" / name).mkdir(parents=True)
        for i in range(12):
            shift = rng.uniform(-3, 3, 2)

            def scene(x, y, shift=shift, angle=angle, length=length):
                x, y = x - 14 - shift[0], y - 16 - shift[1]
                along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
                return -1.5 * np.exp(-(np.maximum(np.abs(along) - length, 0) ** 2 + across**2) / 3)

            t, x, y, p = recorded(scene, straight((6.0, 1.0)), rng)
            np.savez(tmp_path / "data" / name / f"{i}.npz", t=t, x=x, y=y, p=p)
    return tmp_path / "data"


def test_the_command(classes, tmp_path, program):
    words = ["train", classes, "--sensor", "34x34", "--motions", "resynthesized", "--epochs", 2]
    words += ["--out", tmp_path / "m.safetensors"]
    code, printed, err = program(*words, "--json")
    assert code == 0 and "motion found in 20 of 20 windows" in err and "in other motions" in err
    assert "events per window" in err
    summary = json.loads(printed)
    assert summary["motions"]["with_path"] == 20 and summary["validation_motions"]["windows"] == 4
    assert load_model(tmp_path / "m.safetensors").record["motions"]["variations"] == 2  # no more than epochs
    assert (tmp_path / "runs" / "m" / "motions" / "motions.png").read_bytes().startswith(b"\x89PNG")
    code, printed, _ = program(*words)
    assert code == 0 and "held out, in other motions: " in printed
    plain = [word for word in words if word not in ("--motions", "resynthesized")]
    code, _, err = program(*plain)
    assert code == 2 and "holds a run with other motions" in err
