"""`async-tnt evaluate` of a map model: counts by hand, tables in both forms, and what is refused."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made import events_of
from torch import nn

from async_tnt import Model, TNTConfig
from async_tnt.evaluation.object_scores import score_objects
from async_tnt.evaluation.object_tables import read_table
from async_tnt.kernels.objects import FOUND_SIZE

CONFIG = TNTConfig(
    sensor=(64, 40), grid=(64, 40), representation="count", bins=1, polarity="split", transform="none", window_us=1000
)
BOXES = [(name, kind) for name, kind in zip(("ts", "x", "y", "w", "h", "class_id"), ("i8", *4 * ("f4",), "u4"))]  # noqa: B905


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Finds ten ON, or ten OFF, events at one pixel."""
    net = nn.Conv2d(2, 3, 1)
    with torch.no_grad():
        net.weight[:, :, 0, 0] = torch.tensor([[1.0, 0], [0, 1.0], [0, 0]])
        net.bias[:] = torch.tensor([0.0, 0, 9.5])
    return Model.from_torch(nn.Sequential(net), CONFIG, ("on", "off")).save(
        tmp_path_factory.mktemp("model") / "m.safetensors"
    )


def ten(t, x, y, p):
    return [(t + k, x, y, p) for k in range(10)]


EVENTS = [*ten(5100, 20, 10, 1), *ten(5700, 50, 30, 0), *ten(5800, 60, 5, 1), *ten(8900, 20, 10, 1)]
TRUTH = [(9900, "on", 20, 10), (6000, "on", 21, 12), (6000, "off", 50, 30), (6000, "on", 5, 5)]


@pytest.fixture
def folder(tmp_path):
    np.savez(tmp_path / "a_td.npz", sensor=CONFIG.sensor, **dict(zip("txyp", np.array(EVENTS[::-1]).T, strict=True)))
    return tmp_path


def write_points(path, rows=TRUTH, head="t,class,x,y"):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]))


def write_boxes(path, rows=TRUTH):
    """Of 8x6 pixels."""
    numbers = [(t, x - 4, y - 3, 8, 6, ("on", "off").index(name)) for t, name, x, y in rows]
    np.save(path, np.array(numbers, BOXES))


@pytest.mark.parametrize("write, name", [(write_points, "a_td_objects.csv"), (write_boxes, "a_bbox.npy")])
def test_counts_by_hand(folder, saved, program, write, name):
    """At 6000: three are there, three found, two of them right; after .3 of the window one is found. At 9900 one."""
    write(folder / name)
    code, out, _ = program("evaluate", saved, folder, "--json")
    report = json.loads(out)
    assert code == 0
    assert report["per_class"]["on"] == {"f1": 0.66667, "objects": 3, "found": 3, "right": 2}
    assert report["per_class"]["off"] == {"f1": 1.0, "objects": 1, "found": 1, "right": 1}
    assert (report["objects"], report["found"], report["recordings"], report["moments"]) == (4, 4, 1, 2)
    assert report["precision"] == report["recall"] == report["f1"] == 0.75
    assert report["f1_against_time_ms"] == {"0.3": round(4 / 6, 5), "0.5": round(4 / 6, 5), "1": 0.75}
    assert "F1 0.7500: 0.7500 of 4 objects found are right" in program("evaluate", saved, folder)[1]
    write_points(folder / "a_td_objects.csv", [(6000, "on", -1, 5)])
    assert "off the sensor cannot be found: 1; is the table in" in program("evaluate", saved, folder)[2]


def test_a_report_of_recordings_is_the_sum_of_their_reports(folder, saved, program):
    """Of two that differ in what is there, found and right, and a third that cannot be read."""
    write_points(folder / "a_td_objects.csv")
    alone = [json.loads(program("evaluate", saved, folder, "--json")[1])]
    other = folder.parent / "other"
    other.mkdir()
    np.savez(other / "b.npz", sensor=CONFIG.sensor, events=events_of(*np.array(EVENTS[10:30]).T))
    write_points(other / "b_objects.csv", [(6000, "off", 50, 30), (6000, "off", 5, 5)])
    alone.append(json.loads(program("evaluate", saved, other, "--json")[1]))
    for path in other.iterdir():
        path.rename(folder / path.name)
    (folder / "c.npz").write_bytes(b"damaged")
    write_points(folder / "c_objects.csv")
    report = json.loads(program("evaluate", saved, folder, "--json")[1])
    for name in ("objects", "found", "recordings", "moments"):
        assert report[name] == sum(one[name] for one in alone), name
    for kind in ("on", "off"):
        for name in ("objects", "found", "right"):
            assert report["per_class"][kind][name] == sum(one["per_class"][kind][name] for one in alone), (kind, name)
    assert len(report["skipped"]) == 1 and "c.npz" in report["skipped"][0]
    at = {ms: round(2 * right / n, 5) for ms, right, n in [("0.3", 2, 8), ("0.5", 2, 8), ("1", 4, 12)]}
    assert report["f1_against_time_ms"] == at


def test_prophesees_names(folder, saved, program):
    """By the dictionary beside the boxes; of a class that the model does not know, they do not count."""
    write_boxes(folder / "a_bbox.npy")
    (folder / "label_map_dictionary.json").write_text('{"0": "off", "1": "truck"}')
    code, out, err = program("evaluate", saved, folder, "--json")
    assert (code, json.loads(out)["objects"], json.loads(out)["unknown_classes"]) == (0, 3, {"truck": 1})
    assert "objects of classes that the model does not know do not count: truck (1)" in err


def test_what_is_wrong_is_said(folder, saved, program):
    def error(*more, code=2):
        answer = program("evaluate", saved, folder, *more)
        assert answer[0] == code and answer[2].count("\n") == 1
        return answer[2]

    assert "no recordings NAME.* with a table of objects" in error()
    write_points(folder / "a_td_objects.csv", head="t,class,x")
    assert "lacks y" in error()
    for head in ("t,class,x,y,w", "t,class,x,y,width,height"):
        write_points(folder / "a_td_objects.csv", head=head)
        assert "needs the columns t, class, x, y (and w, h of boxes), lacks " in error()
    write_points(folder / "a_td_objects.csv", [(6000, "on", 5)])
    assert "x, y, w and h numbers" in error()
    write_points(folder / "a_td_objects.csv", [(6000, 5, 5)], "t,x,y,class")
    assert "a row ends before its class" in error()
    write_points(folder / "a_td_objects.csv", [(6000, "cat", 5, 5)])
    assert "no object of the model's classes, on, off" in error()
    write_points(folder / "a_td_objects.csv", [(5, "on", 5, 5)])
    assert "no event in the 1000 us before any time in its table, 5 to 5" in error()
    write_points(folder / "a_td_objects.csv")
    assert "--crop, --out, --workers cannot be used with it" in error("--workers", "2", "--out", "a.jsonl", "--crop")
    write_points(folder / "a_td_objects.csv", [(-1, "on", 5, 5)])
    assert "w, h and t at least 0" in error()
    write_points(folder / "a_td_objects.csv")
    np.save(folder / "a_td.npy", events_of(*np.array(EVENTS).T))
    assert "recordings that differ in their endings share a table of objects" in error()
    (folder / "a_td.npy").unlink()
    assert "but --sensor says 32x32" in error("--sensor", "32x32")
    np.save(folder / "b.npy", events_of(*np.array(EVENTS).T))
    write_points(folder / "b_objects.csv")
    assert "the file does not state its sensor; give it with --sensor WxH" in error("--strict")
    assert program("evaluate", saved, folder, "--sensor", "64x40", "--strict")[0] == 0


@pytest.mark.parametrize("damage", [slice(0, 4), slice(10, 11)], ids=["another format", "no literal"])
def test_damaged_boxes_are_refused_in_one_line(tmp_path, damage):
    write_boxes(path := tmp_path / "a_bbox.npy")
    content = bytearray(path.read_bytes())
    content[damage] = b"PK\x03\x04" if damage.start == 0 else b"\0"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a_bbox.npy: not a readable NumPy file: [^\n]*$"):
        read_table(path, ("on", "off"))


def test_how_near_is_near_enough(tmp_path):
    """Within a box, of at least a pixel a side, or so many pixels from a point."""
    write_points(tmp_path / "a_objects.csv", [(1, "on", 10, 20, 8, 0), (2, "on", 10, 20, 0, 0)], "t,class,x,y,w,h")
    table = read_table(tmp_path / "a_objects.csv", ("on",))
    assert (table.reach.tolist(), table.middle.tolist()) == ([[4, 0.5], [5, 5]], [[14, 20], [10, 20]])


def test_matches_by_hand():
    """An object is matched once, with the nearest of its class; a second one found there is too many."""
    found = np.zeros((4, FOUND_SIZE))
    found[:, :4] = [(10, 10, 0.9, 0), (11, 10, 0.8, 0), (30, 10, 0.7, 1), (50, 10, 0.6, 1)]
    labels, middles = np.array([0, 0, 1]), np.array([[10.0, 10], [40, 40], [50, 13]])

    def n_right(found, labels, middles, reach):
        return int(score_objects(found, labels, middles, reach, 2).right.sum())

    assert n_right(found, labels, middles, 3.0) == 2
    assert n_right(found, labels, middles, 2.0) == 1
    assert n_right(found, labels, middles, np.array([[2.0, 2], [2, 2], [1, 3]])) == 2
    assert n_right(found, np.zeros(0, int), np.zeros((0, 2)), 3.0) == 0
    assert n_right(found[:0], labels, middles, 3.0) == 0


CELLS = st.one_of(st.integers(), st.floats().map(str), st.sampled_from(["on", "", '"', "\0", "1e999", "nan"]))


@given(
    st.one_of(
        st.binary(max_size=80),
        st.lists(st.lists(CELLS, max_size=7), max_size=4).map(
            lambda rows: "\n".join(["t,class,x,y,w,h", *(",".join(map(str, row)) for row in rows)]).encode()
        ),
    ),
    st.sampled_from(["a_objects.csv", "a_bbox.npy"]),
)
def test_no_table_does_worse_than_a_valueerror(tmp_path_factory, content, name):
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(content)
    try:
        table = read_table(path, ("on", "off"))
    except ValueError as error:
        assert str(path) in str(error)
    else:
        assert len(table.t) == len(table.label) == len(table.middle) == len(table.reach) > 0
        assert np.isfinite(table.middle).all() and (table.reach > 0).all()
