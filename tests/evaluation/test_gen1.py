"""`async-tnt evaluate` on a folder laid out as Prophesee's Gen1 set: scores worked out by hand.

The model says an object's size and probability by its number of events at a pixel. It finds cars by
ON events and pedestrians by OFF events.
"""

import json

import numpy as np
import pytest
import torch
from made import events_of
from sources.files.written import dat
from torch import nn

from async_tnt import Model, TNTConfig

pytest.importorskip("pycocotools", reason="needs the extra `boxes`")

CONFIG = TNTConfig(
    sensor=(304, 240), grid=(304, 240), representation="count", bins=1, window_us=50_000
)
CAR = 0
PEDESTRIAN = 1
SIZES = np.array([(40.0, 30.0), (12.0, 40.0)])
"""Class -> width and height of an object of 20 events."""
FIELDS = [
    ("ts", "<u8"),
    *((name, "<f4") for name in "xywh"),
    ("class_id", "u1"),
    ("track_id", "<u4"),
    ("class_confidence", "<f4"),
]
"""The fields of Gen1's boxes."""
HALF = 51 / 101
"""Average precision, in 101 steps of recall, if half of the objects are found and nothing else."""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Eight events at a pixel and more are an object."""
    net = nn.Conv2d(2, 5, 1)
    with torch.no_grad():
        net.weight[:] = 0
        net.bias[:] = torch.tensor([0, 0, 1.5, 0, 0])
        for k in (CAR, PEDESTRIAN):
            net.weight[k, k] = 0.2
            net.weight[3:, k, 0, 0] = torch.tensor(np.log(SIZES[k]) / 20)
    path = tmp_path_factory.mktemp("model") / "finder.safetensors"
    return Model.from_torch(nn.Sequential(net), CONFIG, ("car", "pedestrian")).save(path)


def size_of(kind, n_events=20):
    """The width and height of an object of so many events, as the model says it."""
    return SIZES[kind] ** (n_events / 20)


def box(t_us, kind, x, y, size=None):
    """A row of a table of boxes with its middle at (x, y)."""
    width, height = size_of(kind) if size is None else size
    return (t_us, x - width / 2, y - height / 2, width, height, kind, 0, 1.0)


def cluster(t_us, kind, x, y, n_events=20, after_us=1_000):
    """What the model finds at a time, from a moment of the window that ends then."""
    begin_us = t_us - CONFIG.window_us + after_us
    return [(begin_us + k, x, y, 1 - kind) for k in range(n_events)]


def write(folder, name, events, boxes):
    rows = sorted(row for part in events for row in part)
    content = dat(events_of(*np.array(rows).T), CONFIG.sensor)
    (folder / f"{name}_td.dat").write_bytes(content)
    np.save(folder / f"{name}_bbox.npy", np.array(boxes, FIELDS))


@pytest.fixture
def gen1(tmp_path):
    """A folder `gen1/test` of two recordings. Of its eight boxes four count, at three times."""
    folder = tmp_path / "gen1" / "test"
    folder.mkdir(parents=True)
    early = []
    for t_us in (400_000, 500_000):  # no time is later than half a second
        early += [cluster(t_us, CAR, 200, 100, 23)]
    write(
        folder,
        "17-03-30_12-53-58_61500000_121500000",
        [
            *early,
            cluster(1_000_000, CAR, 100, 100),
            cluster(1_000_000, CAR, 50, 50, 10),  # 6 pixels wide
            cluster(2_000_000, CAR, 250, 200, 24),  # where nothing is
        ],
        [
            box(400_000, CAR, 100, 100),
            box(500_000, CAR, 100, 100),
            box(1_000_000, CAR, 100, 100),
            box(1_000_000, CAR, 200, 60, (9, 40)),  # too narrow
            box(2_000_000, CAR, 100, 100, (20, 20)),  # a diagonal of 28.3 pixels
        ],
    )
    # the box that is found is moved by a fifth of its width: an overlap of .8 / 1.2
    wide = size_of(CAR, 22)
    write(
        folder,
        "17-04-04_11-00-13_cut_15_500000_60500000",
        [
            cluster(1_500_000, CAR, 150, 120, 22, after_us=20_000),
            cluster(1_500_000, PEDESTRIAN, 60, 150, after_us=20_000),
        ],
        [
            box(1_500_000, CAR, 150 + 0.2 * wide[0], 120, wide),
            box(1_500_000, PEDESTRIAN, 60, 150),
            box(2_500_000, PEDESTRIAN, 200, 100),  # not found
        ],
    )
    return folder


def report_of(program, *words):
    code, out, err = program("evaluate", *words, "--json")
    assert (code, err) == (0, "")
    return json.loads(out)


def test_the_scores_of_gen1_by_hand(gen1, model, program):
    report = report_of(program, model, gen1, "--boxes", "gen1")
    assert report["boxes"] == "gen1"
    assert (report["recordings"], report["moments"], report["left_out"]) == (2, 3, 4)
    # F1 counts the same boxes: two cars and a pedestrian are found rightly, a pedestrian is not
    assert (report["objects"], report["found"], report["f1"]) == (4, 3, round(6 / 7, 5))
    # Cars: both right up to an overlap of .65; above, the likelier one is wrong.
    # Pedestrians: one of two is found.
    low, high = 1.0, HALF / 2
    scores = report["coco"]
    assert scores["map_50"] == pytest.approx((low + HALF) / 2, abs=1e-5)
    assert scores["map_75"] == pytest.approx((high + HALF) / 2, abs=1e-5)
    assert scores["map"] == pytest.approx((0.4 * low + 0.6 * high + HALF) / 2, abs=1e-5)
    # after 10 ms there is only the car at 1 s
    assert list(report["coco_against_time_ms"]) == ["10", "30", "50"]
    assert report["coco_against_time_ms"]["10"]["map_50"] == pytest.approx(HALF / 2, abs=1e-5)
    assert report["coco_against_time_ms"]["30"] == scores
    assert report["f1_against_time_ms"] == {
        "10": round(2 / 5, 5),
        "30": round(6 / 7, 5),
        "50": round(6 / 7, 5),
    }
    _, out, _ = program("evaluate", model, gen1, "--boxes", "gen1")
    assert "--boxes gen1: 4 objects of the tables do not count" in out


def test_the_folder_of_the_whole_set_may_be_given(gen1, model, program):
    """Its folder `test` is scored, and not what lies beside it."""
    (gen1.parent / "train").mkdir()
    assert report_of(program, model, gen1.parent) == report_of(program, model, gen1)
    (gen1 / "17-04-04_11-00-13_cut_15_500000_60500000_bbox.npy").unlink()
    (gen1 / "17-03-30_12-53-58_61500000_121500000_bbox.npy").unlink()
    code, _, err = program("evaluate", model, gen1.parent)
    assert code == 2 and f"{gen1}: no recordings NAME.* with a table of objects" in err


def test_all_boxes_count_unless_a_convention_is_named(gen1, model, program):
    """Six cars. Three false ones come before the two that are right, and a small one after them."""
    report = report_of(program, model, gen1)
    assert (report["boxes"], report["moments"], report["left_out"]) == ("all", 6, 0)
    assert (report["objects"], report["found"]) == (8, 7)
    # two of six cars are found, with a precision of 2 / 5: 34 of 101 steps of recall
    cars = 0.4 * 34 / 101
    assert report["coco"]["map_50"] == pytest.approx((cars + HALF) / 2, abs=1e-5)


def test_what_is_found_where_no_box_counts_is_not_wrong(tmp_path, model, program):
    """A large false box, the likelier one, is found while the table has only a box too small.

    With all boxes, or if only the small one were left out, the average precision would be half.
    """
    write(
        tmp_path,
        "a",
        [cluster(1_000_000, CAR, 100, 100), cluster(2_000_000, CAR, 250, 200, 24)],
        [box(1_000_000, CAR, 100, 100), box(2_000_000, CAR, 100, 100, (20, 20))],
    )
    report = report_of(program, model, tmp_path, "--boxes", "gen1")
    assert report["coco"]["map_50"] == report["f1"] == 1.0
    # where another box counts, it is wrong
    write(
        tmp_path,
        "a",
        [cluster(1_000_000, CAR, 100, 100), cluster(2_000_000, CAR, 250, 200, 24)],
        [box(1_000_000, CAR, 100, 100), box(2_000_000, PEDESTRIAN, 100, 100)],
    )
    report = report_of(program, model, tmp_path, "--boxes", "gen1")
    assert report["coco"]["map_50"] == pytest.approx(0.5 / 2, abs=1e-5)


def test_recordings_in_which_no_box_counts(tmp_path, model, program):
    write(tmp_path, "a", [cluster(400_000, CAR, 100, 100)], [box(400_000, CAR, 100, 100)])
    report = report_of(program, model, tmp_path, "--boxes", "gen1")
    assert (report["recordings"], report["moments"], report["left_out"]) == (1, 0, 1)
    assert report["no_coco"] == "the tables have no boxes that count"
    # of 1Mpx neither: they are too small
    write(tmp_path, "a", [cluster(900_000, CAR, 100, 100)], [box(900_000, CAR, 100, 100)])
    assert report_of(program, model, tmp_path, "--boxes", "1mpx")["moments"] == 0
    assert report_of(program, model, tmp_path, "--boxes", "gen1")["f1"] == 1.0
