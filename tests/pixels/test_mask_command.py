"""async-tnt mask: what it finds, writes and prints; damaged masks."""

import json
import subprocess
import sys

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.cli import main
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixel_filter import PixelFilter
from async_tnt.sources.pixel_masks import load_mask, save_mask

SAMPLE = sample_recordings()[3]


def with_hot_pixels(path, *pixels):
    """The sample of a 3 with hot pixels (x, y, events), as a file that does not say its sensor."""
    events = [open_recording(SAMPLE).read()]
    for x, y, n in pixels:
        events.append(events_of(np.linspace(0, 300_000, n).astype(int), [x] * n, [y] * n, [1] * n))
    events = np.concatenate(events)
    np.save(path, events[np.argsort(events["t"], kind="stable")])
    return path


def test_it_finds_what_was_planted(tmp_path, capsys):
    path = with_hot_pixels(tmp_path / "a.npy", (30, 2, 500), (3, 31, 200))
    out = tmp_path / "mask.npy"
    assert main(["mask", str(path), "--sensor", "34x34", "--out", str(out)]) == 0
    mask = np.load(out)
    assert mask.dtype == bool and mask.shape == (34, 34)
    assert {(x, y) for y, x in np.argwhere(mask).tolist()} == {(30, 2), (3, 31)}
    first, second, last = capsys.readouterr().out.splitlines()
    n = open_recording(path).n_events
    events = open_recording(path).read()
    at = [int(((events["x"] == x) & (events["y"] == y)).sum()) for x, y in ((30, 2), (3, 31))]
    assert first.split() == f"x 30 y 2 {at[0]} events {at[0] / n:.2%}".split()
    assert second.split() == f"x 3 y 31 {at[1]} events {at[1] / n:.2%}".split()
    assert last == f"2 hot pixels of 34x34 made {sum(at) / n:.2%} of {n} events; wrote {out}"
    assert len(PixelFilter((34, 34), mask=out)(events)) == n - sum(at)


def test_no_hot_pixels(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["mask", str(SAMPLE)]) == 0
    n = open_recording(SAMPLE).n_events
    printed = f"no hot pixels: none of 34x34 stands out in {n} events; wrote mask.npy, which masks nothing\n"
    assert capsys.readouterr().out == printed
    assert not np.load("mask.npy").any()


def test_only_a_named_file_is_overwritten(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mask.npy").write_bytes(b"precious")
    assert main(["mask", str(SAMPLE)]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err == (
        "async-tnt: mask.npy exists already: --out mask.npy overwrites it, --out FILE writes another file\n"
    )
    assert (tmp_path / "mask.npy").read_bytes() == b"precious"
    assert main(["mask", str(SAMPLE), "--out", "mask.npy"]) == 0
    assert not np.load("mask.npy").any()


def test_a_bin_is_of_the_sensor_of_the_option(tmp_path, capsys):
    rng = np.random.default_rng(0)
    n = 20_000
    events = events_of(np.arange(n), rng.integers(0, 240, n), rng.integers(0, 180, n), rng.integers(0, 2, n))
    events["x"][::20], events["y"][::20] = 200, 150
    write_nmnist(tmp_path / "a.bin", events, sensor=(304, 240))
    out = str(tmp_path / "m.npy")
    assert main(["mask", str(tmp_path / "a.bin"), "--sensor", "304x240", "--out", out]) == 0
    assert np.argwhere(np.load(out)).tolist() == [[150, 200]] and np.load(out).shape == (240, 304)


def test_recordings_of_one_camera_count_as_one(tmp_path, capsys):
    """A pixel that is not far above its neighbours in either recording is, in both together."""
    paths = []
    for k in range(2):
        events = np.concatenate([random_events(1156, seed=k), events_of([1] * 8, [7] * 8, [9] * 8, [1] * 8)])
        np.save(tmp_path / f"{k}.npy", events)
        paths.append(str(tmp_path / f"{k}.npy"))
    found = []
    for files in (paths[:1], paths[1:], paths):
        assert main(["mask", *files, "--sensor", "34x34", "--json", "--out", str(tmp_path / "m.npy")]) == 0
        found.append([(p["x"], p["y"]) for p in json.loads(capsys.readouterr().out)["hot_pixels"]])
    assert found == [[], [], [(7, 9)]]


def test_json_and_factor(tmp_path, capsys):
    path = with_hot_pixels(tmp_path / "a.npy", (30, 2, 500), (3, 31, 200))
    out = str(tmp_path / "mask.npy")
    assert main(["mask", str(path), "--sensor", "34x34", "--json", "--out", out]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [(p["x"], p["y"]) for p in printed["hot_pixels"]] == [(30, 2), (3, 31)]
    assert (
        printed["sensor"] == [34, 34] and printed["out"] == out and printed["events"] == open_recording(path).n_events
    )
    assert printed["share"] == sum(p["events"] for p in printed["hot_pixels"]) / printed["events"]
    assert main(["mask", str(path), "--sensor", "34x34", "--json", "--out", out, "--factor", "60"]) == 0
    assert [(p["x"], p["y"]) for p in json.loads(capsys.readouterr().out)["hot_pixels"]] == [(30, 2)]


def test_more_than_ten_are_not_all_listed(tmp_path, capsys):
    path = with_hot_pixels(tmp_path / "a.npy", *((3 * k, 0, 400) for k in range(12)))
    assert main(["mask", str(path), "--sensor", "36x34", "--out", str(tmp_path / "m.npy")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 12 and lines[10] == "... and 2 more" and lines[11].startswith("12 hot pixels of 36x34 made ")


@pytest.mark.parametrize("suffix, start", [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_picture(suffix, start, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra `plot`)")
    path = with_hot_pixels(tmp_path / "a.npy", (30, 2, 500))
    picture = tmp_path / f"counts{suffix}"
    command = ["mask", str(path), "--sensor", "34x34", "--out", str(tmp_path / "m.npy"), "--picture", str(picture)]
    assert main(command) == 0
    assert picture.read_bytes().startswith(start)
    if suffix == ".svg":
        assert "1 hot pixel<" in picture.read_text()


def test_picture_without_matplotlib(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    out = tmp_path / "m.npy"
    assert main(["mask", str(SAMPLE), "--out", str(out), "--picture", str(tmp_path / "a.png")]) == 2
    assert "--picture draws with matplotlib: pip install '.[plot]'" in capsys.readouterr().err and not out.exists()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Recordings of every kind of trouble, in the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.npy").write_bytes(b"hello")
    with_hot_pixels(tmp_path / "a.npy", (33, 33, 5))
    for side in (34, 50):
        np.savez(tmp_path / f"{side}.npz", events=random_events(9), sensor=np.array([side, side]))
    np.savez(tmp_path / "e.npz", events=random_events(0), sensor=np.array([34, 34]))
    write_nmnist(tmp_path / "a.bin", events_of([5, 6], [200, 3], [2, 3], [0, 1]), sensor=None)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("gone.npy", "gone.npy: No such file"),
        ("bad.npy", "bad.npy: not a readable NumPy file"),
        ("a.npy", "a.npy: the file does not state the camera's sensor; give --sensor WxH"),
        ("a.npy --sensor 34x33", "a.npy: `y` must be in [0, 33), got 33 at event"),
        ("34.npz --sensor 40x40", "34x34 pixels, but --sensor or an earlier recording has 40x40"),
        ("34.npz 50.npz", "50.npz: a sensor of 50x50 pixels, but --sensor or an earlier recording"),
        ("a.bin", "on the 34 x 34 sensor, got x = 200, y = 2 at event 0 (byte 0). Fetch the file again, or say"),
        ("e.npz", "e.npz: no events, no hot pixels can be found"),
        ("34.npz --out m.png", "m.png: a mask is written as .npy, got the suffix '.png'"),
        ("34.npz --out no/m.npy", "no to write m.npy to"),
    ],
)
def test_an_error_is_one_line(words, message, folder, capsys):
    assert main(["mask", *words.split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("async-tnt: ") and len(captured.err.splitlines()) == 1
    assert message in captured.err
    assert not (folder / "mask.npy").exists()


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["a.bin", "--sensor", "34"],
        ["a.bin", "--sensor", "0x4"],
        ["a.bin", "--factor", "1"],
        ["a.bin", "--factor", "x"],
        ["a.bin", "--factor", "nan"],
    ],
)
def test_bad_usage_exits_with_2(argv, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["mask", *argv])
    assert stopped.value.code == 2
    assert "async-tnt mask" in capsys.readouterr().err


def test_as_a_program(tmp_path):
    command = [sys.executable, "-m", "async_tnt.cli", "mask", str(SAMPLE), "--out", str(tmp_path / "m.npy")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout.startswith("no hot pixels: ") and done.stderr == ""


# -- files of masks --------------------------------------------------------------------------------------


def test_saved_masks_load_again(tmp_path):
    mask = np.random.default_rng(0).random((20, 30)) < 0.5
    save_mask(tmp_path / "m.npy", mask)
    assert (load_mask(tmp_path / "m.npy", (30, 20)) == mask).all()
    assert [path.name for path in tmp_path.iterdir()] == ["m.npy"]


def test_every_damaged_byte_is_one_clear_error(tmp_path):
    path = tmp_path / "m.npy"
    save_mask(path, np.zeros((4, 6), bool))
    whole = path.read_bytes()
    for at in range(0, 128, 3):  # the header
        for byte in (0, 255, whole[at] ^ 1):
            path.write_bytes(whole[:at] + bytes([byte]) + whole[at + 1 :])
            try:
                assert load_mask(path, (6, 4)).shape == (4, 6)  # some bytes do not matter
            except ValueError as error:
                assert str(error).startswith(f"{path}: ")
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"m.npy: not a readable NumPy file"):
            load_mask(path, (6, 4))


def test_files_that_are_not_masks(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 6)))
    with pytest.raises(ValueError, match=r"a.npy: a mask of a 6x4 sensor must be a bool array.*got float64 of shape"):
        load_mask(tmp_path / "a.npy", (6, 4))
    np.savez(tmp_path / "a.npz", mask=np.zeros((4, 6), bool))
    with pytest.raises(ValueError, match=r"a.npz: not a readable NumPy file: it must begin with .*, got b.PK"):
        load_mask(tmp_path / "a.npz", (6, 4))
    np.save(tmp_path / "o.npy", np.array([[None]]), allow_pickle=True)
    with pytest.raises(ValueError, match=r"o.npy: not a readable NumPy file: it holds Python objects, which"):
        load_mask(tmp_path / "o.npy", (1, 1))
    (tmp_path / "t.npy").write_text("x,y\n1,2\n")  # NumPy would advise to load it unsafely
    with pytest.raises(ValueError, match=r"t.npy: not a readable NumPy file: it must begin with") as caught:
        load_mask(tmp_path / "t.npy")
    assert "pickle" not in str(caught.value)
    with pytest.raises(FileNotFoundError):
        PixelFilter((34, 34), mask=tmp_path / "none.npy")


@pytest.mark.parametrize("mask", [np.zeros((3, 4)), np.zeros(4, bool), [[1, 0]], np.zeros((0, 3), bool)])
def test_invalid_masks_are_not_saved(mask, tmp_path):
    with pytest.raises(
        ValueError, match=r"a mask must be a bool array of shape \(height, width\), sides in .1, 32768.; got "
    ):
        save_mask(tmp_path / "m.npy", mask)
    assert list(tmp_path.iterdir()) == []
