"""Hot pixels: all that were planted are found, and no others.

The command is `async-tnt mask`.
"""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.pixels.hot_pixels import (
    count_pixels,
    hot_pixels,
    learn_mask,
    listed_pixels,
)
from async_tnt.sources.pixels.pixel_filter import PixelFilter
from async_tnt.sources.pixels.pixel_masks import load_mask

SENSOR = (34, 34)
RECORDINGS = {digit: open_recording(sample_recordings()[digit]).read() for digit in (0, 1, 8)}


def planted(pixels, n, *, seed=0, duration_us=315_000):
    """Packets of hot pixels: about n events each, at random times."""
    rng = np.random.default_rng(seed)
    for x, y in pixels:
        events = rng.poisson(n)
        t = np.sort(rng.integers(0, duration_us, events))
        yield events_of(t, [x] * events, [y] * events, rng.integers(0, 2, events))


def found(packets, sensor=SENSOR):
    return {(x, y) for y, x in np.argwhere(learn_mask(packets, sensor)).tolist()}


FOUR = [(10, 10), (11, 10), (10, 11), (11, 11)]
BRIGHT = [(5, 5), (6, 5), (30, 30)]


@pytest.mark.parametrize(
    ("packets", "pixels"),
    [
        # In the dark corner of a recording 60 events are many. On the digit's edge they would be
        # normal.
        ([RECORDINGS[0], *planted([(0, 0), (33, 0), (33, 33)], 60)], [(0, 0), (33, 0), (33, 33)]),
        *(([random_events(20_000), *planted([at], 400)], [at]) for at in [(0, 0), (32, 1)]),
        ([random_events(5_000), *planted(FOUR, 500)], FOUR),
        # a lamp
        (
            [
                random_events(5_000),
                *planted([(x, y) for x in range(10, 14) for y in range(10, 14)], 500),
            ],
            [],
        ),
        (list(planted([(3, 4), (20, 30)], 300)), [(3, 4), (20, 30)]),  # alone in the dark
        # one outshines two
        ([random_events(2000), *planted(BRIGHT[:1], 100_000), *planted(BRIGHT[1:], 60)], BRIGHT),
        *(([recording], []) for recording in RECORDINGS.values()),
        ([None, random_events(0)], []),
    ],
)
def test_hot_pixels_at_borders_side_by_side_and_in_the_dark(packets, pixels):
    assert found(packets) == set(pixels)


def test_a_line_that_moves_along_itself_is_not_hot():
    counts = np.zeros((20, 30), np.int64)
    counts[7, :] = 400
    counts[:, 0] = 300
    assert not hot_pixels(counts).any()
    counts[7, 12] = 400 * 6
    before = counts.copy()
    assert np.argwhere(hot_pixels(counts)).tolist() == [[7, 12]] and (counts == before).all()
    # one ends on the sensor
    for x, y in ((np.arange(60) + 20, np.arange(60) + 10), (np.arange(60), np.full(60, 9))):
        counts = np.random.default_rng(0).poisson(0.2, (90, 120))
        counts[y, x] = 25
        assert hot_pixels(counts).sum() <= 4  # its very ends


@pytest.mark.parametrize(
    ("others", "n", "is_hot"),
    [
        (100, 500, False),  # the mean is 100.3: 5 times that is 501.7
        (100, 510, True),
        (0, 8, False),  # 9 log 9 - 8 = 11.8 > log(1156 / 0.01) = 11.7 > 8 log 8 - 7 = 9.6
        (0, 9, True),
    ],
)
def test_factor_and_bound_by_hand(others, n, is_hot):
    counts = np.full((34, 34), others)
    counts[9, 9] = n
    assert hot_pixels(counts).any() == is_hot


@pytest.mark.parametrize(("n_neighbours", "is_hot"), [(3, True), (4, False)])
def test_four_bright_pixels_of_the_block_around_explain_a_pixel(n_neighbours, is_hot):
    """The block reaches two pixels from the pixel, or further from one at a border."""
    for x, y in ((9, 9), (0, 0), (19, 29)):
        counts = np.full((30, 20), 8)
        left = min(max(x - 2, 0), 15)
        top = min(max(y - 2, 0), 25)
        corners = [(left + dx, top + dy) for dx in (0, 4) for dy in (0, 4)]
        others = [corner for corner in corners if corner != (x, y)] + [(left + 1, top + 3)]
        for column, row in others[:n_neighbours]:
            counts[row, column] = 30
        for k in range(5):  # pixels that lie beyond the block do not count
            for column, row in ((left + 5, top + k), (left - 1, top + k), (left + k, top + 5)):
                if 0 <= column < 20 and row < 30:
                    counts[row, column] = 30
        counts[y, x] = 120
        assert hot_pixels(counts)[y, x] == is_hot, (x, y)


@pytest.mark.parametrize("sensor", [(4, 30), (30, 4), (3, 3), (2, 1)])
def test_a_sensor_may_be_smaller_than_the_block(sensor):
    """Where there are too few pixels to compare with, none is hot."""
    x, y = sensor[0] - 1, sensor[1] - 1
    packets = list(planted([(x, y)], 500))
    assert found(packets, sensor) == ({(x, y)} if sensor[0] * sensor[1] > 4 else set())


def test_hot_pixels_are_listed_busiest_first():
    counts = np.array([[7, 9, 1], [8, 9, 2]])
    assert listed_pixels(counts, counts > 6) == [
        {"x": x, "y": y, "events": n} for x, y, n in ((1, 0, 9), (1, 1, 9), (0, 1, 8), (0, 0, 7))
    ]


def test_an_event_off_the_sensor_is_refused():
    with pytest.raises(ValueError, match=r"^`x` must be in \[0, 34\), got 34 at event 0$"):
        learn_mask([([1], [34], [0], [1])], SENSOR)


# -- async-tnt mask --------------------------------------------------------------------------------

SAMPLE = sample_recordings()[3]
EVENTS = open_recording(SAMPLE).read()


def with_hot_pixels(path, *pixels):
    """A file of the bundled 3 with hot pixels (x, y, events).

    The file does not state its sensor.
    """
    hot = [
        events_of(np.linspace(0, 300_000, n).astype(int), [x] * n, [y] * n, [1] * n)
        for x, y, n in pixels
    ]
    events = np.concatenate([EVENTS, *hot])
    np.save(path, events[np.argsort(events["t"], kind="stable")])
    return path


def test_it_finds_what_was_planted(tmp_path, program):
    path = with_hot_pixels(tmp_path / "a.npy", (30, 2, 500), (3, 31, 200))
    out = tmp_path / "mask.npy"
    events = open_recording(path).read()
    at = [int(((events["x"] == x) & (events["y"] == y)).sum()) for x, y in ((30, 2), (3, 31))]
    code, printed, _ = program("mask", path, "--sensor", "34x34", "--out", out)
    share = f"{sum(at) / len(events):.2%}"
    line = f"2 hot pixels of 34x34 made {share} of {len(events)} events; wrote {out}"
    assert code == 0 and printed.splitlines()[-1] == line
    assert {(x, y) for y, x in np.argwhere(load_mask(out, (34, 34))).tolist()} == {(30, 2), (3, 31)}
    assert len(PixelFilter((34, 34), mask=out)(events)) == len(events) - sum(at)

    words = ("mask", path, "--sensor", "34x34", "--json", "--out", out)
    pixels = [{"x": 30, "y": 2, "events": at[0]}, {"x": 3, "y": 31, "events": at[1]}]
    result = {"sensor": [34, 34], "events": len(events), "out": str(out)}
    assert json.loads(program(*words)[1]) == result | {
        "hot_pixels": pixels,
        "share": sum(at) / len(events),
    }


def test_several_recordings_count_as_one_and_share_the_sensor_that_one_states(tmp_path, program):
    """A pixel that is hot in each, and one that is only in the first; in either order."""
    out = tmp_path / "mask.npy"
    for k in range(2):
        hot = [(30, 2, 40), (3, 31, 400)][: 2 - k]
        with_hot_pixels(tmp_path / f"{k}.npy", *hot)
    np.savez(tmp_path / "stated.npz", events=EVENTS[:100], sensor=np.array(SENSOR))
    paths = [tmp_path / name for name in ("stated.npz", "0.npy", "1.npy")]
    counts = np.zeros((34, 34), np.int64)
    for path in paths:
        events = open_recording(path).read()
        np.add.at(counts, (events["y"], events["x"]), 1)
    code, printed, _ = program("mask", *paths, "--out", out, "--json")
    report = json.loads(printed)
    assert code == 0 and report["events"] == counts.sum() and report["sensor"] == [34, 34]
    assert [[pixel["x"], pixel["y"]] for pixel in report["hot_pixels"]] == [[3, 31], [30, 2]]
    assert report["hot_pixels"][0]["events"] == counts[31, 3]
    np.testing.assert_array_equal(np.load(out), hot_pixels(counts))


def test_an_error_names_its_recording_once(tmp_path, program):
    path = with_hot_pixels(tmp_path / "a.npy", (34, 2, 50))
    words = "mask", path, "--sensor", "34x34", "--strict", "--out", tmp_path / "mask.npy"
    code, _, err = program(*words)
    assert code == 2 and err.count(str(path)) == 1 and "off the 34 x 34 sensor" in err


@pytest.mark.parametrize(("n", "more"), [(1, []), (9, []), (10, []), (11, ["... and 1 more"])])
def test_at_most_ten_hot_pixels_are_listed(tmp_path, program, n, more):
    path = with_hot_pixels(tmp_path / "a.npy", *((3 * k, 2 + 2 * (k % 2), 900) for k in range(n)))
    code, printed, _ = program("mask", path, "--sensor", "34x34", "--out", tmp_path / "mask.npy")
    *pixels, total = printed.splitlines()
    number = "1 hot pixel" if n == 1 else f"{n} hot pixels"
    assert code == 0 and total.startswith(f"{number} of 34x34 made ")
    events = open_recording(path).read()
    x, y = (int(pixels[0].split()[k]) for k in (1, 3))
    n_first = int(((events["x"] == x) & (events["y"] == y)).sum())
    share = f"{n_first / len(events):.2%}"
    assert pixels[0].split() == ["x", str(x), "y", str(y), str(n_first), "events", share]
    assert pixels[10:] == more and all(line.startswith("x ") for line in pixels[:10])
    assert len(pixels[:10]) == min(n, 10)


def test_a_mask_never_replaces_a_recording_by_whichever_path(tmp_path, program, monkeypatch):
    path = with_hot_pixels(tmp_path / "a.npy", (30, 2, 500))
    before = path.read_bytes()
    monkeypatch.chdir(tmp_path)
    Path("link.npy").symlink_to(path)
    os.link(path, "second_name.npy")
    (tmp_path / "below").mkdir()
    for other in ("a.npy", "below/../a.npy", "link.npy", "second_name.npy"):
        code, _, err = program("mask", path, "--sensor", "34x34", "--out", other)
        assert code == 2
        assert err.count("\n") == 1
        assert f"--out is one of the recordings, {other}" in err
        assert path.read_bytes() == before


def test_where_nothing_stands_out_the_mask_masks_nothing(tmp_path, program):
    out = tmp_path / "mask.npy"
    printed = (
        f"no hot pixels: none of 34x34 stands out in {len(EVENTS)} events; wrote {out}, which "
        "masks nothing\n"
    )
    assert program("mask", SAMPLE, "--out", out) == (0, printed, "")
    assert not np.load(out).any()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "a.npy --out m.npy",
            "a.npy: the file does not state the camera's sensor; give --sensor WxH",
        ),
        (
            "34.npz 50.npz --out m.npy",
            "50.npz: a sensor of 50x50 pixels, but --sensor or an earlier recording",
        ),
        ("e.npz --out m.npy", "e.npz: no events, no hot pixels can be found"),
        ("a.npy --sensor 34x34 --out a.npy", "--out is one of the recordings, a.npy"),
        ("34.npz --out m.png", "m.png: its name must end in .npy"),
    ],
)
def test_an_error_is_one_line(words, message, tmp_path, program, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", EVENTS)
    for name, n, side in (("34", 9, 34), ("50", 9, 50), ("e", 0, 34)):
        np.savez(f"{name}.npz", events=random_events(n), sensor=np.array([side, side]))
    code, printed, error = program("mask", *words.split())
    assert (code, printed) == (2, "")
    assert error.startswith("async-tnt: ")
    assert len(error.splitlines()) == 1
    assert message in error
    assert not (tmp_path / "mask.npy").exists()


def test_a_sensor_may_have_so_many_pixels(tmp_path, program):
    """A file of a few hundred bytes may state any number: their counts would take gigabytes."""
    assert count_pixels([], (4096, 4096)).shape == (4096, 4096)
    with pytest.raises(
        ValueError,
        match=r"^a sensor must have at most 16,777,216 pixels to count .*, got 4097x4096$",
    ):
        learn_mask([], (4097, 4096))
    columns = dict(t=[5], x=[1], y=[2], p=[1])
    np.savez(tmp_path / "a.npz", **columns, sensor=[32768, 32768])
    code, _, err = program("mask", tmp_path / "a.npz", "--out", tmp_path / "m.npy")
    assert code == 2 and err.count("\n") == 1
    assert err.startswith(f"async-tnt: {tmp_path / 'a.npz'}: a sensor must have at most 16,777,216")
    assert "32768x32768" in err
    np.savez(tmp_path / "b.npz", **columns)
    code, _, err = program(
        "mask", tmp_path / "b.npz", "--sensor", "32768x32768", "--out", tmp_path / "m.npy"
    )
    assert code == 2 and "b.npz: a sensor must have at most 16,777,216 pixels" in err
