"""COCO's scores of boxes: numbers by hand, what counts, and the command that prints them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from made import events_of
from torch import nn

from async_tnt import Model, TNTConfig, load_model
from async_tnt.evaluation.box_conventions import CONVENTIONS
from async_tnt.evaluation.box_scores import SCORES, FoundBoxes
from async_tnt.evaluation.object_tables import ObjectTable

pytest.importorskip("pycocotools", reason="needs the extra `boxes`")


def table(*rows):
    """t, class, x, y, w, h of each object; x, y is its middle."""
    numbers = np.array(rows, float).reshape(-1, 6)
    return ObjectTable(
        t=numbers[:, 0].astype(np.int64),
        label=numbers[:, 1].astype(np.int64),
        middle=numbers[:, 2:4],
        reach=numbers[:, 4:] / 2,
        size=numbers[:, 4:],
        unknown={},
    )


def found(*rows):
    """Class, x, y, w, h, probability of each object."""
    return np.array([(x, y, p, k, 0, w, h) for k, x, y, w, h, p in rows], float).reshape(-1, 7)


WHOLE = slice(None)


def test_a_perfect_box_a_shifted_one_and_a_false_one():
    """The second box overlaps by 8 x 10 of 12 x 10: .667. It is right for overlaps up to .65."""
    boxes = FoundBoxes()
    boxes.add(table((9, 0, 20, 20, 10, 10)), WHOLE, found((0, 20, 20, 10, 10, 0.9)))
    boxes.add(table((9, 0, 20, 20, 10, 10)), WHOLE, found((0, 22, 20, 10, 10, 0.8)))
    scores = boxes.scores(["a"])
    assert scores["map_50"] == 1.0
    # at .7 to .95 only the first one is right: half of the recall, up to .5 of 101 steps
    one = 51 / 101
    assert scores["map_75"] == pytest.approx(one, abs=1e-4)
    assert scores["map"] == pytest.approx((4 * 1 + 6 * one) / 10, abs=1e-4)
    assert scores["map_small"] == scores["map"]
    assert scores["map_medium"] is None and scores["map_large"] is None
    # a false one that is likelier than all others halves the precision
    other = FoundBoxes()
    other.add(
        table((9, 0, 20, 20, 10, 10)),
        WHOLE,
        found((0, 60, 20, 10, 10, 0.95), (0, 20, 20, 10, 10, 0.9)),
    )
    assert other.scores(["a"])["map"] == pytest.approx(0.5, abs=1e-4)


def test_classes_are_apart():
    boxes = FoundBoxes()
    boxes.add(
        table((9, 0, 20, 20, 10, 10), (9, 1, 60, 60, 50, 50)),
        WHOLE,
        found((1, 20, 20, 10, 10, 0.9), (1, 60, 60, 50, 50, 0.8)),
    )
    scores = boxes.scores(["a", "b"])
    # class a: never found; class b: one false box before the right one
    assert scores["map"] == pytest.approx((0 + 0.5) / 2, abs=1e-4)
    assert scores["map_small"] == 0.0


def test_without_boxes():
    boxes = FoundBoxes()
    boxes.add(table((9, 0, 5, 5, 0, 0)), WHOLE, found((0, 5, 5, 3, 3, 0.9)))
    boxes.add(table((9, 0, 5, 5, 4, 0), (9, 0, 5, 5, 0, 4)), WHOLE, found())  # no area
    assert boxes.n_present == 0 and boxes.scores(["a"]) == dict.fromkeys(SCORES)
    boxes.add(table((9, 0, 5, 5, 4, 4)), WHOLE, found())
    none = FoundBoxes()
    none.add(table((9, 0, 5, 5, 4, 4)), WHOLE, found())
    assert none.scores(["a"])["map"] == 0.0


@pytest.mark.parametrize(
    "name, counted",
    [
        ("all", [True] * 8),
        ("gen1", [False, True, True, False, True, False, True, False]),
        ("1mpx", [False, True, False, False, False, False, False, False]),
    ],
)
def test_what_counts(name, counted):
    """A box at half a second; then, later, a large one, and boxes of several sizes and a point."""
    t = np.array([500_000, *[500_001] * 7])
    width = np.array([99.0, 99, 12, 9, 25, 12, 18, 0])
    height = np.array([99.0, 99, 40, 200, 25, 12, 24, 0])  # 18 x 24: a diagonal of 30
    assert CONVENTIONS[name].counts(t, width, height).tolist() == counted
    assert CONVENTIONS["all"].counts(np.zeros(1), np.zeros(1), np.zeros(1)).all()


@pytest.fixture
def recording(tmp_path):
    """Ten ON events at a pixel, a Gen1-like file of boxes, and a model that finds 8 x 4 boxes."""
    config = TNTConfig(sensor=(64, 40), grid=(64, 40), representation="count", window_us=1000)
    net = nn.Conv2d(2, 5, 1)
    with torch.no_grad():
        net.weight[:, :, 0, 0] = torch.tensor([[1.0, 0], [0, 1.0], [0, 0], [0, 0], [0, 0]])
        net.bias[:] = torch.tensor([0.0, 0, 9.5, np.log(8.0), np.log(4.0)])
    model = tmp_path / "m.safetensors"
    Model.from_torch(nn.Sequential(net), config, ("on", "off")).save(model)
    folder = tmp_path / "gen1"
    folder.mkdir()
    n = 10
    events = events_of(600_100 + np.arange(n), [20] * n, [10] * n, [1] * n)
    np.savez(folder / "a_td.npz", events=events, sensor=config.sensor)
    kinds = [("ts", "i8"), *((name, "f4") for name in "xywh"), ("class_id", "u4")]
    rows = [(600_900, 16, 8, 8, 4, 0), (600_900, 40, 8, 8, 4, 1)]
    np.save(folder / "a_bbox.npy", np.array(rows, kinds))
    return model, folder


def test_the_command(recording, program):
    code, out, _ = program("evaluate", *recording, "--json")
    report = json.loads(out)
    assert code == 0 and report["f1"] == 0.66667
    assert report["coco"]["map"] == pytest.approx(0.5)  # one class of two
    assert report["coco_against_time_ms"] == {"1": report["coco"]}  # a window of 1 ms
    _, out, _ = program("evaluate", *recording)
    assert "mAP .5" in out and "0.500" in out.splitlines()[-1]


def test_conventions_need_sizes(recording, program):
    """Neither a model that finds points nor one of classes can leave out found boxes."""
    model, folder = recording
    loaded = load_model(model)
    net = nn.Conv2d(2, 3, 1)
    Model.from_torch(nn.Sequential(net), loaded.config, loaded.classes).save(model)
    code, _, err = program("evaluate", model, folder, "--boxes", "gen1")
    assert (
        code == 2
        and f"--boxes gen1 leaves objects out by their sizes, and {model} says none" in err
    )
    code, _, err = program("evaluate", "digits", folder, "--boxes", "1mpx")
    assert code == 2 and "--boxes 1mpx is for objects, and digits finds none" in err


def test_a_recording_that_is_skipped_has_no_boxes(recording, program):
    """All of its events come long before the moments of its table."""
    model, folder = recording
    _, before, _ = program("evaluate", model, folder, "--json")
    np.savez(folder / "b_td.npz", **np.load(folder / "a_td.npz"))
    boxes = np.load(folder / "a_bbox.npy")
    boxes["ts"] += 5_000_000
    np.save(folder / "b_bbox.npy", boxes)
    _, after, err = program("evaluate", model, folder, "--json")
    assert "skipped: " in err and "no event in the 1000 us before" in err
    assert json.loads(after)["coco"] == json.loads(before)["coco"]


def test_sequences_of_dsec_detection(recording, program, tmp_path):
    """Times are those of DSEC's clock, which the events' file gives by an offset."""
    h5py = pytest.importorskip("h5py", reason="needs the extra `files`")
    model, _ = recording
    net = load_model(model)
    replace(net, classes=("car", "train")).save(model)
    fields = [("t", "u8"), *((name, "f8") for name in "xyhw"), ("class_id", "u1")]
    fields += [("class_confidence", "f8"), ("track_id", "u8")]
    start_us = 49_599_300_523
    n = 10
    for name in ("thun_02_a", "interlaken_00_a"):
        sequence = tmp_path / "dsec" / name
        for part in ("events/left", "object_detections/left"):
            (sequence / part).mkdir(parents=True)
        with h5py.File(sequence / "events/left/events.h5", "w") as file:
            file["events/t"] = np.arange(n, dtype="u4")
            file["events/x"] = np.full(n, 20, "u2")
            file["events/y"] = np.full(n, 10, "u2")
            file["events/p"] = np.ones(n, "u1")
            file["t_offset"] = start_us
        # a car where the model finds one, and a pedestrian, which it does not know
        rows = [(start_us + 900, 16, 8, 4, 8, 2, 1, 0), (start_us + 900, 40, 8, 4, 8, 0, 1, 1)]
        np.save(sequence / "object_detections/left/tracks.npy", np.array(rows, fields))
    (tmp_path / "dsec/thun_03_a/object_detections/left").mkdir(parents=True)  # without events
    for folder, n_recordings in ((tmp_path / "dsec", 2), (tmp_path / "dsec/thun_02_a", 1)):
        code, out, err = program("evaluate", model, folder, "--sensor", "64x40", "--json")
        report = json.loads(out)
        assert code == 0 and report["recordings"] == n_recordings
        assert report["per_class"]["car"]["f1"] == 1.0 and report["coco"]["map"] == 1.0
        assert f"pedestrian ({n_recordings})" in err


def test_a_folder_of_etram(recording, program, tmp_path):
    """Prophesee's boxes beside a file in RVT's layout, which states its sensor."""
    h5py = pytest.importorskip("h5py", reason="needs the extra `files`")
    model, _ = recording
    n = 10
    (tmp_path / "etram").mkdir()
    with h5py.File(tmp_path / "etram/val_day_001_td.h5", "w") as file:
        file["events/t"] = 600_100 + np.arange(n)
        file["events/x"] = np.full(n, 20, "u2")
        file["events/y"] = np.full(n, 10, "u2")
        file["events/p"] = np.ones(n, "u1")
        file["events/width"] = 64
        file["events/height"] = 40
    fields = [("t", "i8"), *((name, "f4") for name in "xywh"), ("class_id", "u4"), ("id", "u4")]
    rows = [(600_900, 16, 8, 8, 4, 0, 7)]
    np.save(tmp_path / "etram/val_day_001_bbox.npy", np.array(rows, fields))
    code, out, _ = program("evaluate", model, tmp_path / "etram", "--json")
    assert code == 0 and json.loads(out)["coco"]["map"] == 1.0


def test_windows_of_a_number_of_events_are_refused(recording, program):
    model, folder = recording
    loaded = load_model(model)
    config = loaded.config.replace(last_events=50)
    replace(loaded, config=config).save(model)
    code, _, err = program("evaluate", model, folder)
    assert code == 2 and "objects are scored in windows of a duration" in err


def test_without_the_extra_there_is_a_line_that_names_it(recording, program, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pycocotools.coco", None)
    code, out, _ = program("evaluate", *recording)
    assert code == 0 and "F1 0.6667" in out
    assert "no scores of boxes: COCO's scores of boxes need pycocotools: pip install" in out
    assert "async_tnt[boxes]" in out
