"""`async-tnt evaluate` of a map model.

The tests have counts by hand, tables in both forms, and what is refused.
"""

import json
import re
import tracemalloc
import weakref
from dataclasses import replace

import numpy as np
import pytest
import torch
from held_memory import held
from hypothesis import given
from hypothesis import strategies as st
from made import events_of
from sources.files.ros_written import Bag
from torch import nn

from async_tnt import Model, Processor, TNTConfig, load_model, open_recording
from async_tnt.evaluation.object_scores import moments_us, score_objects, score_recording
from async_tnt.evaluation.object_tables import (
    ObjectTable,
    class_names,
    find_tables,
    has_tables,
    read_table,
)
from async_tnt.kernels.decisions.objects import FOUND_SIZE, X, Y
from async_tnt.sources import READERS
from async_tnt.volume.events import EVENT_DTYPE

CONFIG = TNTConfig(
    sensor=(64, 40),
    grid=(64, 40),
    representation="count",
    bins=1,
    polarity="split",
    transform="none",
    window_us=1000,
)
BOXES = [
    (name, kind)
    for name, kind in zip(
        ("ts", "x", "y", "w", "h", "class_id"), ("i8", "f4", "f4", "f4", "f4", "u4"), strict=True
    )
]


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
    np.savez(
        tmp_path / "a_td.npz",
        sensor=CONFIG.sensor,
        **dict(zip("txyp", np.array(EVENTS[::-1]).T, strict=True)),
    )
    return tmp_path


SLOW = 50
"""How many times as long recordings and windows are, so that they reach early moments: 50 ms."""


@pytest.fixture(scope="module")
def slow(saved, tmp_path_factory):
    """The same model with windows of 50 ms."""
    model = load_model(saved)
    config = CONFIG.replace(window_us=SLOW * CONFIG.window_us)
    return replace(model, config=config).save(tmp_path_factory.mktemp("slow") / "m.safetensors")


def slowed(rows):
    """Rows that begin with a time, SLOW times as late."""
    return [(SLOW * t, *more) for t, *more in rows]


def write_events(path, rows):
    np.savez(path, sensor=CONFIG.sensor, events=events_of(*np.array(rows).T))


def write_points(path, rows=TRUTH, head="t,class,x,y"):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]))


def write_boxes(path, rows=TRUTH):
    """Boxes of 8x6 pixels about the points."""
    numbers = [(t, x - 4, y - 3, 8, 6, ("on", "off").index(name)) for t, name, x, y in rows]
    np.save(path, np.array(numbers, BOXES))


@pytest.mark.parametrize(
    "write, name", [(write_points, "a_td_objects.csv"), (write_boxes, "a_bbox.npy")]
)
def test_counts_by_hand(folder, slow, program, write, name):
    """At 300 ms three objects are there and three are found, two of them rightly.

    At 495 ms one is there and found. After 10 and 30 ms of either window one is found.
    """
    write_events(folder / "a_td.npz", slowed(EVENTS))
    write(folder / name, slowed(TRUTH))
    code, out, _ = program("evaluate", slow, folder, "--json")
    report = json.loads(out)
    assert code == 0
    assert report["per_class"]["on"] == {"f1": 0.66667, "objects": 3, "found": 3, "right": 2}
    assert report["per_class"]["off"] == {"f1": 1.0, "objects": 1, "found": 1, "right": 1}
    assert report["objects"] == report["found"] == 4
    assert report["recordings"] == 1
    assert report["moments"] == 2
    assert report["precision"] == report["recall"] == report["f1"] == 0.75
    early = round(4 / 6, 5)
    assert report["f1_against_time_ms"] == {"10": early, "30": early, "50": 0.75}
    out = program("evaluate", slow, folder)[1]
    assert "F1 0.7500: 0.7500 of 4 objects found are right" in out
    assert out.splitlines()[-1] == "no scores of boxes: the model says no sizes"
    rows = [line.split() for line in out.split("ms into the window")[1].splitlines()[1:4]]
    assert rows == [["10", "0.667"], ["30", "0.667"], ["50", "0.750"]]
    write_points(folder / "a_td_objects.csv", [(SLOW * 6000, "on", -1, 5)])
    _, _, err = program("evaluate", slow, folder)
    assert "off the sensor cannot be found: 1; is the table in" in err


@pytest.mark.parametrize(
    ("window_us", "moments"),
    [
        (105_000, [10, 30, 50, 100, 105]),
        (100_000, [10, 30, 50, 100]),
        (50_000, [10, 30, 50]),
        (10_001, [10, 10.001]),
        (10_000, [10]),
        (800, [0.8]),
    ],
)
def test_moments_lie_inside_a_window_and_at_its_end(window_us, moments):
    assert moments_us(window_us) == tuple(round(1000 * ms) for ms in moments)


def test_recordings_are_read_by_the_options(folder, saved, program):
    write_points(folder / "a_td_objects.csv")
    expected = json.loads(program("evaluate", saved, folder, "--json")[1])
    (folder / "a_td.npz").unlink()
    (folder / "a_td.csv").write_text("".join(f"{x},{y},{p},{t}\n" for t, x, y, p in sorted(EVENTS)))
    assert program("evaluate", saved, folder, "--sensor", "64x40")[0] == 2
    code, out, _ = program(
        "evaluate", saved, folder, "--sensor", "64x40", "--columns", "xypt", "--json"
    )
    assert code == 0 and json.loads(out) == expected
    (folder / "a_td.csv").unlink()
    with Bag(folder / "a_td.mcap") as bag:
        bag.array(events_of(*np.array(sorted(EVENTS)).T), CONFIG.sensor, topic="/left")
        bag.array(events_of([5], [1], [2], [1]), CONFIG.sensor, topic="/right")
    code, _, err = program("evaluate", saved, folder)
    assert code == 2 and "several topics have events" in err
    code, out, _ = program("evaluate", saved, folder, "--topic", "/left", "--json")
    assert code == 0 and json.loads(out) == expected


def test_a_report_of_recordings_is_the_sum_of_their_reports(folder, slow, program):
    """Two recordings differ in what is there, found and right; a third one cannot be read."""
    write_events(folder / "a_td.npz", slowed(EVENTS))
    write_points(folder / "a_td_objects.csv", slowed(TRUTH))
    alone = [json.loads(program("evaluate", slow, folder, "--json")[1])]
    other = folder.parent / "other"
    other.mkdir()
    write_events(other / "b.npz", slowed(EVENTS[10:30]))
    two = [(6000, "off", 50, 30), (6000, "off", 5, 5)]
    write_points(other / "b_objects.csv", slowed(two))
    alone.append(json.loads(program("evaluate", slow, other, "--json")[1]))
    for path in other.iterdir():
        path.rename(folder / path.name)
    (folder / "c.npz").write_bytes(b"damaged")
    write_points(folder / "c_objects.csv")
    report = json.loads(program("evaluate", slow, folder, "--json")[1])
    for name in ("objects", "found", "recordings", "moments"):
        assert report[name] == sum(one[name] for one in alone), name
    for kind in ("on", "off"):
        for name in ("objects", "found", "right"):
            assert report["per_class"][kind][name] == sum(
                one["per_class"][kind][name] for one in alone
            ), (kind, name)
    assert len(report["skipped"]) == 1 and "c.npz" in report["skipped"][0]
    at = {
        ms: round(2 * right / n, 5) for ms, right, n in [("10", 2, 8), ("30", 2, 8), ("50", 4, 12)]
    }
    assert report["f1_against_time_ms"] == at


def test_prophesees_names(folder, saved, program):
    """The dictionary beside the boxes names the classes.

    Boxes of a class that the model does not know do not count.
    """
    write_boxes(folder / "a_bbox.npy")
    (folder / "label_map_dictionary.json").write_text('{"0": "off", "1": "truck"}')
    code, out, err = program("evaluate", saved, folder, "--json")
    assert (code, json.loads(out)["objects"], json.loads(out)["unknown_classes"]) == (
        0,
        3,
        {"truck": 1},
    )
    assert "objects of classes that the model does not know do not count: truck (1)" in err


def test_what_is_wrong_is_said(folder, saved, program):
    def error(*more, code=2):
        answer = program("evaluate", saved, folder, *more)
        assert answer[0] == code and answer[2].count("\n") == 1
        return answer[2]

    assert "no recordings NAME.* with a table of objects" in error()
    write_points(folder / "a_td_objects.csv", head="t,class,x")
    assert "lacks y" in error()
    for side in ("w", "h", "width", "height", "W", "h ", "Width"):
        write_points(folder / "a_td_objects.csv", head=f"t,class,x,y,{side}")
        assert "needs the columns t, class, x, y (and w, h of boxes), lacks " in error()
    for twice in ("t", "class", "x", "y"):
        write_points(folder / "a_td_objects.csv", [(*TRUTH[0], 5)], head=f"t,class,x,y,{twice}")
        expected = f"the column '{twice}' is there 2 times; leave out all but one"
        assert f"a_td_objects.csv: {expected}" in error()
    for twice in ("w", "h"):
        write_points(folder / "a_td_objects.csv", head=f"t,class,x,y,w,h,{twice}")
        assert f"the column '{twice}' is there 2 times; leave out all but one" in error()
    write_points(folder / "a_td_objects.csv", [(6000, "on", 5, 5), (6000, "on", 5)])
    assert "a_td_objects.csv: row 2: t must be whole microseconds, x, y, w and h numbers" in error()
    write_points(folder / "a_td_objects.csv", [(6000, 5, 5)], "t,x,y,class")
    assert "a row ends before its class" in error()
    write_points(folder / "a_td_objects.csv", [(6000, "cat", 5, 5)])
    assert "no object of the model's classes, on, off" in error()
    write_points(folder / "a_td_objects.csv", [(6000, " ", 5, 5)])
    assert "numbers, each with a class: got ''" in error()
    write_points(folder / "a_td_objects.csv", [])
    assert "the table has no rows" in error()
    far = (6000, "on", 1.7e308, 5, 1.7e308, 5)  # whose middle is infinite
    write_points(folder / "a_td_objects.csv", [far], "t,class,x,y,w,h")
    assert "must be finite" in error()
    write_points(folder / "a_td_objects.csv", [(5, "on", 5, 5)])
    assert "no event in the 1000 us before any time in its table, 5 to 5" in error()
    write_points(folder / "a_td_objects.csv")
    assert "--crop, --out, --workers cannot be used with it" in error(
        "--workers", "2", "--out", "a.jsonl", "--crop"
    )
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


@pytest.mark.parametrize(
    "error", [OSError(5, "Input/output error"), ValueError("torn at byte 9")], ids=repr
)
def test_a_recording_that_cannot_be_read_is_skipped(error, folder, saved, program, monkeypatch):
    def read(path, options):
        raise error

    monkeypatch.setitem(READERS, ".own", read)
    (folder / "b.own").touch()
    for name in ("a_td", "b"):
        write_points(folder / f"{name}_objects.csv")
    code, out, err = program("evaluate", saved, folder, "--json")
    assert code == 0 and json.loads(out)["recordings"] == 1
    assert err.count("\n") == 1 and str(error) in err


@pytest.mark.parametrize(
    "words",
    ["--roi 0,0,9,9", "--crop", "--mask m.npy", "--out a.jsonl", "--workers 2", "--dask tcp://a:1"],
)
def test_options_of_classes_are_refused(words, folder, saved, program):
    write_points(folder / "a_td_objects.csv")
    code, _, err = program("evaluate", saved, folder, *words.split())
    assert code == 2 and f"{words.split()[0]} cannot be used with it" in err


@pytest.mark.parametrize(
    "damage", [slice(0, 4), slice(10, 11)], ids=["another format", "no literal"]
)
def test_damaged_boxes_are_refused_in_one_line(tmp_path, damage):
    path = tmp_path / "a_bbox.npy"
    write_boxes(path)
    content = bytearray(path.read_bytes())
    content[damage] = b"PK\x03\x04" if damage.start == 0 else b"\0"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a_bbox.npy: not a readable NumPy file: [^\n]*$"):
        read_table(path, ("on", "off"))


def test_boxes_may_have_any_numbers(tmp_path):
    """Whole pixels, as labelled by hand, and fractions."""
    wide = [(name, {"f4": "i2"}.get(kind, kind)) for name, kind in BOXES]
    numbers = [(t, x - 4, y - 3, 8, 6, 0) for t, _, x, y in TRUTH]
    tables = []
    for fields in (BOXES, wide):
        np.save(tmp_path / "a_bbox.npy", np.array(numbers, fields))
        tables.append(read_table(tmp_path / "a_bbox.npy", ("on", "off")))
    assert tables[0].middle.tolist() == tables[1].middle.tolist()
    assert tables[0].middle[-1].tolist() == [20, 10]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in "xywh" for value in ("nan", "inf")),
        *((name, -1) for name in "twh"),
    ],
)
def test_numbers_that_no_box_has_are_refused(name, value, tmp_path):
    box = {"t": 5, "class": "on", "x": 4, "y": 3, "w": 2, "h": 1}
    path = tmp_path / "a_objects.csv"
    lines = [",".join(map(str, row.values())) for row in (box, box | {name: value})]
    path.write_text("\n".join([",".join(box), *lines]))
    message = f"{path}: x, y, w and h must be finite, w, h and t at least 0"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read_table(path, ("on", "off"))


@pytest.mark.parametrize(("t", "fits"), [(2**63 - 1, True), (2**63, False), (-(2**63) - 1, False)])
def test_a_time_fits_into_64_bits(tmp_path, t, fits):
    path = tmp_path / "a_objects.csv"
    write_points(path, [(t, "on", 5, 5)])
    if fits:
        assert read_table(path, ("on",)).t.tolist() == [t]
        return
    with pytest.raises(ValueError, match=f"row 1: t must be whole microseconds.*: got '{t}'"):
        read_table(path, ("on",))


def test_of_classes_that_the_model_does_not_know_only_the_number_of_rows_counts(tmp_path):
    """Such rows may hold any numbers. A class without a name goes by its number."""
    path = tmp_path / "a_objects.csv"
    rows = [(9, "on", 5, 5, 2, 2), (-9, "cat", "nan", 5, -1, 2), (3, "cat", 5, 5, 2, 2)]
    write_points(path, rows, "t, class, x, y, w, h")
    table = read_table(path, ("on",))
    assert (table.t.tolist(), table.unknown) == ([9], {"cat": 2})
    path = tmp_path / "a_bbox.npy"
    np.save(path, np.array([(9, 5, 5, 2, 2, k) for k in (0, 7, 7, 11)], BOXES))
    assert read_table(path, ("on",)).unknown == {"7": 2, "11": 1}


@pytest.mark.parametrize(
    ("content", "why"), [("[1]", r"got \[1\]"), ("{", "it is not JSON"), ("null", "got None")]
)
def test_a_file_of_names_that_names_nothing_is_refused(tmp_path, content, why):
    write_boxes(tmp_path / "a_bbox.npy")
    names = tmp_path / "label_map_dictionary.json"
    names.write_text(content)
    rule = "must be an object of class numbers and names, in JSON"
    with pytest.raises(ValueError, match=f"{re.escape(str(names))}: {rule}: {why}"):
        read_table(tmp_path / "a_bbox.npy", ("on", "off"))


@pytest.mark.parametrize(("field", "value"), [("ts", 5.5), ("ts", 1e30), ("class_id", np.nan)])
def test_times_and_classes_of_boxes_are_whole_numbers(tmp_path, field, value):
    boxes = np.ones(2, [(name, "f8") for name, _ in BOXES])
    path = tmp_path / "a_bbox.npy"
    np.save(path, boxes)
    assert read_table(path, ("on", "off")).label.tolist() == [1, 1]
    boxes[field][1] = value
    np.save(path, boxes)
    message = f"t and class_id must be whole numbers in int64, got {value}"
    with pytest.raises(ValueError, match=re.escape(message)):
        read_table(path, ("on", "off"))


def test_classes_of_tables_have_names_or_numbers(tmp_path):
    """Names are sorted. Numbers count from 0 and leave none out; with names they do not mix."""

    def classes_of(*tables):
        return class_names([tmp_path / name for name in tables])

    def write_numbers(numbers):
        np.save(tmp_path / "a_bbox.npy", np.array([(9, 5, 5, 2, 2, k) for k in numbers], BOXES))

    write_points(tmp_path / "b_objects.csv")
    assert classes_of("b_objects.csv") == ("off", "on")
    write_numbers([*range(11), 3])
    assert classes_of("a_bbox.npy") == tuple(str(k) for k in range(11))
    with pytest.raises(ValueError, match="some tables have names of classes, others only numbers"):
        classes_of("a_bbox.npy", "b_objects.csv")
    write_numbers([10, 9, 1])
    with pytest.raises(ValueError, match="must be 0, 1, 2 and so on, got 1, 9, 10; name them in"):
        classes_of("a_bbox.npy")
    # DSEC's numbers have names
    tracks = tmp_path / "object_detections/left/tracks.npy"
    tracks.parent.mkdir(parents=True)
    np.save(tracks, np.array([(9, 5, 5, 2, 2, k) for k in (2, 0)], BOXES))
    assert class_names([tracks]) == ("car", "pedestrian")


def test_where_recordings_with_tables_are_looked_for(tmp_path):
    """A file called `test` is no part of a set. A sequence has both events and boxes."""
    assert not has_tables(tmp_path / "missing")
    (tmp_path / "test").touch()
    assert not has_tables(tmp_path)
    for name in ("object_detections/left/tracks.npy", "events/left/events.h5"):
        path = tmp_path / name.split("/")[0] / name
        path.parent.mkdir(parents=True)
        path.touch()
        assert not has_tables(tmp_path)
    for name in ("object_detections/left/tracks.npy", "events/left/events.h5"):
        path = tmp_path / "both" / name
        path.parent.mkdir(parents=True)
        path.touch()
    both = tmp_path / "both/events/left/events.h5"
    assert find_tables(tmp_path) == [(both, tmp_path / "both/object_detections/left/tracks.npy")]


@pytest.mark.parametrize(
    ("boxes", "why"),
    [
        (np.zeros((3, 6)), "only integers, slices"),
        (np.zeros(3, BOXES[:-1]), "no field of name class_id"),
        (np.zeros(3, [*BOXES[:1], ("x", "U3"), *BOXES[2:]]), "x must be a number, got <U3"),
        (np.zeros((3, 2), BOXES), "t and class_id must be whole numbers, got int64 in"),
    ],
    ids=["plain array", "no class", "text", "two dimensions"],
)
def test_what_is_no_list_of_boxes_is_named(tmp_path, boxes, why):
    np.save(tmp_path / "a_bbox.npy", boxes)
    expected = f"a_bbox.npy: not a file of boxes with the fields t, x, y, w, h and class_id: {why}"
    with pytest.raises(ValueError, match=re.escape(expected)):
        read_table(tmp_path / "a_bbox.npy", ("on", "off"))


@pytest.mark.parametrize(
    "content", [b"\xff\xfe", b'"' + b"a" * 200_000], ids=["no UTF-8", "an endless cell"]
)
def test_what_is_no_table_of_values_is_named(tmp_path, content):
    path = tmp_path / "a_objects.csv"
    path.write_bytes(b"t,class,x,y\n" + content)
    with pytest.raises(ValueError, match=r"a_objects.csv: not a table of comma-separated values: "):
        read_table(path, ("on", "off"))


def clusters(rng, n=45):
    """Twelve events at one pixel, again and again, on a grid of times, as ends of windows."""
    rows = []
    for _ in range(n):
        t = 100 * rng.integers(0, 120)
        x = rng.integers(0, 64)
        y = rng.integers(0, 40)
        p = rng.integers(0, 2)
        spread = rng.integers(1, 6)
        rows += [(t + 100 * int(rng.integers(0, spread)), x, y, p) for _ in range(12)]
    rows.sort(key=lambda row: row[0] + rng.integers(0, 150))
    return events_of(*np.array(rows).T)


def scored_by_hand(model, events, rows, until_us):
    """(there, found, right) of each class: each window by itself, matched in plain Python."""
    counts = np.zeros((3, 2), int)
    for end_us in sorted({row[0] for row in rows}):
        start_us = end_us - model.config.window_us
        inside = events[(events["t"] >= start_us) & (events["t"] < start_us + until_us)]
        inside = inside[np.argsort(inside["t"], kind="stable")]
        inside["t"] -= start_us
        processor = Processor(model, start_us=0)
        processor.push(inside)
        waiting = [(("on", "off").index(name), x, y) for t, name, x, y in rows if t == end_us]
        for label, *_ in waiting:
            counts[0, label] += 1
        for one in processor.fire().objects:
            counts[1, one.index] += 1
            away = {
                k: np.hypot(x - one.x, y - one.y)
                for k, (label, x, y) in enumerate(waiting)
                if label == one.index
            }
            nearest = min(away, key=away.get, default=None)
            if nearest is not None and away[nearest] <= 5:
                counts[2, one.index] += 1
                waiting.pop(nearest)
    return counts.tolist()


@pytest.mark.parametrize("packet_events", [1, 37, 100_000])
@pytest.mark.parametrize("order", ["sorted", "late events", "backwards"])
@pytest.mark.parametrize("slides", [False, True])
def test_scores_are_those_of_windows_cut_by_hand(slow, tmp_path, order, packet_events, slides):
    """Times closer together than a window, several objects at one, and a table in no order.

    They depend neither on the order of the events nor on packets, nor on whether windows slide.
    Some events lie exactly at the moments after 10, 30 and 50 ms of a window.
    """
    rng = np.random.default_rng(4)
    model = load_model(slow)
    events = clusters(rng)
    in_time = events[np.argsort(events["t"], kind="stable")]
    events = {"sorted": in_time, "late events": events, "backwards": in_time[::-1]}[order]
    rows = []
    for t, x, y, p in in_time[rng.permutation(len(events))[:60]].tolist():
        beside_x = int(np.clip(x + rng.integers(-4, 5), 0, 63))
        beside_y = int(np.clip(y + rng.integers(-4, 5), 0, 39))
        later_us = 100 * int(rng.integers(1, 10))
        rows.append((t + later_us, ("off", "on")[p], beside_x, beside_y))
    events["t"] *= SLOW
    rows = slowed(rows)
    np.savez(tmp_path / "a.npz", sensor=CONFIG.sensor, events=events)
    write_points(tmp_path / "a_objects.csv", rows)
    recording = open_recording(tmp_path / "a.npz", packet_events=packet_events)
    tried = model
    if slides:
        tried = replace(model, config=model.config.replace(last_us=model.config.window_us))
    found = score_recording(tried, recording, read_table(tmp_path / "a_objects.csv", model.classes))
    assert list(found) == [10_000, 30_000, 50_000]
    for until_us, scores in found.items():
        expected = scored_by_hand(model, events, rows, until_us)
        assert [
            scores.n_present.tolist(),
            scores.n_found.tolist(),
            scores.n_right.tolist(),
        ] == expected, until_us
        there, n_found, right = np.sum(expected, axis=1).tolist()
        assert (5 if until_us == 50_000 else 0) < right < there
        assert scores.f1 == 2 * right / (there + n_found)
        words = scores.to_dict(model.classes)
        assert words["precision"] == round(right / n_found, 5)
        assert words["recall"] == round(right / there, 5)


@pytest.mark.parametrize(
    "moment, is_known", [(8900, False), (8901, True), (9900, True), (9901, False)]
)
def test_a_window_has_its_start_and_not_its_end(folder, saved, program, moment, is_known):
    """The recording has one event, at 8900."""
    np.savez(folder / "a_td.npz", sensor=CONFIG.sensor, events=events_of([8900], [20], [10], [1]))
    write_points(folder / "a_td_objects.csv", [(moment, "on", 20, 10)])
    code, _, err = program("evaluate", saved, folder)
    assert (code == 0) == is_known
    if not is_known:
        times = f"{moment} to {moment}"
        assert f"no event in the 1000 us before any time in its table, {times}" in err


def test_memory_does_not_grow_with_the_time_between_moments(saved):
    """All of the recording but its last window lies before the only moment."""
    n_alive = []

    class Packets:
        path = "a.npz"

        def __iter__(self):
            alive = []
            for k in range(300):
                t = 1000 * k - 1200 * (k % 2 == 0) + np.arange(50)
                packet = events_of(np.maximum(t, 0), *np.ones((3, 50), int))
                alive.append(weakref.ref(packet))
                yield packet
                del packet
                n_alive.append(sum(one() is not None for one in alive))

    table = ObjectTable(
        t=np.array([300_000]),
        label=np.array([0]),
        middle=np.array([[1.0, 1.0]]),
        reach=np.array([[5.0, 5.0]]),
        size=np.zeros((1, 2)),
        unknown={},
    )
    scores = score_recording(load_model(saved), Packets(), table)
    assert scores[1000].n_right.sum() == 1 and max(n_alive) <= 5


def test_memory_does_not_grow_with_the_number_of_moments(saved):
    """Events before the window of a moment are of no use for later ones."""
    n_events = 1_000
    n_packets = 25
    bytes_held = []

    class Packets:
        path = "a.npz"

        def __iter__(self):
            for k in range(n_packets):
                t = 1000 * k + np.arange(n_events) % 1000
                yield events_of(t, *np.ones((3, n_events), int))
                if k in (10, n_packets - 1):
                    bytes_held.append(held())

    times_us = 1000 * np.arange(1, n_packets + 1)
    table = ObjectTable(
        t=times_us,
        label=np.zeros(n_packets, int),
        middle=np.ones((n_packets, 2)),
        reach=np.full((n_packets, 2), 5.0),
        size=np.zeros((n_packets, 2)),
        unknown={},
    )
    tracemalloc.start()
    try:
        scores = score_recording(load_model(saved), Packets(), table)
    finally:
        tracemalloc.stop()
    assert scores[1000].n_right.sum() == n_packets
    # the recording is read twice, at first for the times of its packets alone
    *_, early, late = bytes_held
    assert late - early < 4 * n_events * EVENT_DTYPE.itemsize


@pytest.mark.parametrize(
    ("x", "y", "n_off"), [(0, 0, 0), (63, 39, 0), (64, 5, 1), (5, 40, 1), (-0.5, 5, 1)]
)
def test_objects_off_the_sensor_are_told(folder, saved, program, x, y, n_off):
    write_points(folder / "a_td_objects.csv", [(6000, "on", x, y), (9900, "on", 20, 10)])
    code, out, err = program("evaluate", saved, folder, "--json")
    assert code == 0 and json.loads(out)["off_sensor"] == n_off
    assert ("off the sensor cannot be found: 1" in err) == (n_off == 1)


def test_what_cannot_be_found_is_counted_over_all_recordings(folder, saved, program):
    (folder / "b.npz").write_bytes((folder / "a_td.npz").read_bytes())
    rows = [(9900, "on", 20, 10), (9900, "on", 64, 10), (9900, "cat", 5, 5), (9900, "dog", 5, 5)]
    write_points(folder / "a_td_objects.csv", rows)
    write_points(folder / "b_objects.csv", rows[:3])
    code, out, err = program("evaluate", saved, folder, "--json")
    report = json.loads(out)
    assert code == 0 and report["off_sensor"] == 2
    assert report["unknown_classes"] == {"cat": 2, "dog": 1}
    assert "do not count: cat (2), dog (1)" in err


def test_a_table_of_points_comes_before_boxes_and_both_may_lie_in_test(folder, saved, program):
    """Only the recordings of `Test` are scored."""
    write_points(folder / "a_td_objects.csv", [(9900, "on", 20, 10)])
    write_boxes(folder / "a_bbox.npy")
    assert json.loads(program("evaluate", saved, folder, "--json")[1])["objects"] == 1
    (folder / "Test").mkdir()
    (folder / "a_td.npz").rename(folder / "Test" / "a.npz")
    (folder / "a_bbox.npy").rename(folder / "Test" / "a_bbox.npy")
    assert json.loads(program("evaluate", saved, folder, "--json")[1])["objects"] == 4


def test_how_near_is_near_enough(tmp_path):
    """Within a box, of at least a pixel a side, or so many pixels from a point."""
    write_points(
        tmp_path / "a_objects.csv",
        [(1, "on", 10, 20, 8, 0), (2, "on", 10, 20, 0, 0)],
        "t,class,x,y,w,h",
    )
    table = read_table(tmp_path / "a_objects.csv", ("on",))
    assert table.reach.tolist() == [[4, 0.5], [5, 5]]
    assert table.middle.tolist() == [[14, 20], [10, 20]]


def test_a_table_may_begin_with_a_byte_order_mark(tmp_path):
    """Spreadsheets write such a mark."""
    path = tmp_path / "a_objects.csv"
    write_points(path)
    expected = read_table(path, ("on", "off"))
    path.write_bytes("\ufeff".encode() + path.read_bytes())
    found = read_table(path, ("on", "off"))
    assert found.t.tolist() == expected.t.tolist() == [6000, 6000, 6000, 9900]
    assert found.middle.tolist() == expected.middle.tolist()


def test_matches_by_hand():
    """An object that is there is matched once, by the nearest found object of its class.

    A second found object near it is wrong.
    """
    found = np.zeros((4, FOUND_SIZE))
    found[:, :4] = [(10, 10, 0.9, 0), (11, 10, 0.8, 0), (30, 10, 0.7, 1), (50, 10, 0.6, 1)]
    labels = np.array([0, 0, 1])
    middles = np.array([[10.0, 10], [40, 40], [50, 13]])

    def n_right(found, labels, middles, reach):
        return int(score_objects(found, labels, middles, reach, 2).n_right.sum())

    assert n_right(found, labels, middles, 3.0) == 2
    assert n_right(found, labels, middles, 2.0) == 1
    assert n_right(found, labels, middles, np.array([[2.0, 2], [2, 2], [1, 3]])) == 2
    # the likeliest find takes the object a pixel away, and leaves the other one to the next find
    beside = np.array([[6.0, 10], [11, 10]])
    found[1, 0] = 2
    assert n_right(found[:2], np.zeros(2, int), beside, 5.0) == 2
    assert n_right(found[1::-1], np.zeros(2, int), beside[::-1], 5.0) == 2
    assert n_right(found, np.zeros(0, int), np.zeros((0, 2)), 3.0) == 0
    assert n_right(found[:0], labels, middles, 3.0) == 0


def test_near_enough_is_the_ellipse_of_the_reach_and_not_its_rectangle():
    """Places a thousandth inside and outside of the ellipse, at every angle.

    With one number for all, the ellipse is a circle.
    """
    middle = np.array([[20.0, 30.0]])
    found = np.zeros((1, FOUND_SIZE))
    for reach in (np.array([[8.0, 3.0]]), np.array([[0.5, 6.0]]), 5.0):
        across, down = np.broadcast_to(reach, (1, 2))[0]
        for angle in np.linspace(0, 2 * np.pi, 33):
            for share, right in ((0.999, 1), (1.001, 0)):
                away = np.array([across * np.cos(angle), down * np.sin(angle)])
                found[0, [X, Y]] = middle[0] + share * away
                scores = score_objects(found, np.zeros(1, int), middle, reach, 1)
                assert scores.n_right.sum() == right, (reach, angle)


CELLS = st.one_of(
    st.integers(), st.floats().map(str), st.sampled_from(["on", "", '"', "\0", "1e999", "nan"])
)


@given(
    st.one_of(
        st.binary(max_size=80),
        st.lists(st.lists(CELLS, max_size=7), max_size=4).map(
            lambda rows: "\n".join(
                ["t,class,x,y,w,h", *(",".join(map(str, row)) for row in rows)]
            ).encode()
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
