"""Whatever is damaged in a file from outside, the error has one line and names the file.

What can be read can be used.
"""

import functools
import json
import re
from contextlib import contextmanager

import numpy as np
import pytest
from damage import RAW, damaged_bytes, damaged_json
from networks.foreign import network, onnx
from networks.small import SMALL, changed, small_model, write_file

from async_tnt import CompiledClassifier, Model, Processor, load_model
from async_tnt.base.json_text import MAX_JSON_DEPTH, parse_json
from async_tnt.cli.evaluate import lines_of, report_of
from async_tnt.evaluation.job import job_of, task_of
from async_tnt.evaluation.object_tables import read_table
from async_tnt.evaluation.processes import run_all
from async_tnt.evaluation.records import check_record, evaluate_recording
from async_tnt.evaluation.results import collect
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.engines import choose_engine
from async_tnt.networks.onnx.metadata import seal
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.sources.files.recording import sample_recordings
from async_tnt.sources.pixels.pixel_masks import load_mask, save_mask
from async_tnt.sources.pixels.pixels import Pixels

WORDS_OF_PYTHON = (
    "sys.set_int_max_str_digits",
    "recursion",
    "Traceback",
    "NoneType",
    "object is not",
    "indices must be",
)


@contextmanager
def refused_in_one_line(path, count):
    """Allow only a ValueError or an OSError of one line that names the file.

    count : a list that gets the message.
    """
    try:
        yield
    except (ValueError, OSError) as error:
        message = str(error)
        assert str(path) in message and "\n" not in message and len(message) < 1500, message
        assert not any(words in message for words in WORDS_OF_PYTHON), message
        count.append(message)


def try_all(path, contents, read, use=lambda value: None):
    """Read a file with each of these contents, and use what was read. Returns the errors."""
    errors = []
    for content in contents:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with refused_in_one_line(path, errors):
            value = read(path)
            use(value)
    return errors


# -- JSON itself -----------------------------------------------------------------------------------


def test_json_is_read_or_refused_in_our_words():
    for depth in (1, 5, MAX_JSON_DEPTH):
        assert parse_json("[" * depth + "]" * depth) == json.loads("[" * depth + "]" * depth)
        assert parse_json('{"a":' * depth + "1" + "}" * depth)
    for text, message in (
        ("[" * (MAX_JSON_DEPTH + 1) + "]" * (MAX_JSON_DEPTH + 1), "nested more than 100 deep"),
        ('{"a":[' * 60 + "]}" * 60, "nested more than 100 deep"),
        (RAW["nested too deep"], "nested more than 100 deep"),
        (
            '[{"a": ' + RAW["whole number of 5,000 digits"] + "}]",
            "a whole number of thousands of digits",
        ),
        ('{"a": {"b": 1, "c": 2, "b": 3}}', "it names 'b' twice in one object"),
        ("[1,]", "it is not JSON: "),
        (b'"\xff"', "it is not JSON: "),
        ("", "it is not JSON: "),
    ):
        for form in {text, text.encode() if isinstance(text, str) else text}:
            with pytest.raises(ValueError, match=message) as caught:
                parse_json(form)
            assert "\n" not in str(caught.value) and "sys." not in str(caught.value)
    values = [None, True, -3, 0.5, "a\n", [[1], [2]] * 200, {"a": {"a": []}}]
    assert (
        parse_json(json.dumps(values)) == parse_json(json.dumps(values).encode("utf-16")) == values
    )


# -- results of an evaluation ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory):
    """The path of a file of results, the model, the tasks, and their records by recording.

    Three recordings have a few windows, and one cannot be read.
    """
    folder = tmp_path_factory.mktemp("results")
    model = load_model("digits")
    job = job_of("digits", model, Pixels())
    (folder / "empty.bin").write_bytes(b"12")
    tasks = [
        task_of(f"{digit}.bin", path, job, str(digit))
        for digit, path in list(sample_recordings().items())[:3]
    ]
    tasks.append(task_of("empty.bin", folder / "empty.bin", job, "3"))
    records = {task.recording: evaluate_recording(task) for task in tasks}
    assert [name for name, record in records.items() if record["error"]] == ["empty.bin"]
    return folder / "r.jsonl", model, tasks, records


def test_damaged_results(evaluation):
    out, model, tasks, records = evaluation
    check = functools.partial(check_record, classes=model.classes, config=model.config)
    run = functools.partial(run_all, workers=1)

    def read(path):
        return collect(lambda task: records[task.recording], tasks, run, path, check=check)

    def use(found):
        assert [record["recording"] for record in found] == sorted(records)
        good = [record for record in found if record["error"] is None]
        report = report_of(model, good, [])
        assert json.loads(json.dumps(report)) and lines_of(report)
        assert report["recordings"] == 3

    use(read(out))
    content = out.read_bytes()
    assert use(read(out)) is None and out.read_bytes() == content
    errors = try_all(out, damaged_bytes(content, 300, seed=1), read, use)
    assert len(errors) > 100
    lines = content.splitlines(keepends=True)
    for k, line in enumerate(lines):
        others = (
            b"".join([*lines[:k], text.encode() + b"\n", *lines[k + 1 :]])
            for text in damaged_json(json.loads(line), 150, k)
        )
        errors = try_all(out, others, read, use)
        assert len(errors) > 30


def test_a_record_that_a_model_cannot_have_made_is_named(evaluation):
    out, model, tasks, records = evaluation
    check = functools.partial(check_record, classes=model.classes, config=model.config)
    run = functools.partial(run_all, workers=1)

    def evaluate(task):
        return records[task.recording]

    good = records["0.bin"]
    check(good)
    n = len(good["window_start_us"])
    for name, value, message in (
        ("label", "cat", "`label` must be one of the model's classes, got 'cat'"),
        ("class", "cat", "`class` must be one of the model's classes, got 'cat'"),
        ("decisions", -1, "`decisions` must be numbers of type int in .*, got -1"),
        ("off_sensor", 0.5, "`off_sensor` must be numbers of type int in .*, got 0.5"),
        (
            "confident",
            [[10] * 7] * n,
            r"`confident` must be numbers of type int in \[-1, 9\], got 10",
        ),
        (
            "probability_at",
            [[1.5] * 10] * n,
            r"`probability_at` must be numbers of type float in \[-1, 1\], got 1.5",
        ),
        ("probabilities", [0.5] * 9, "`probabilities` must hold 10 numbers"),
        (
            "probabilities",
            [2.0] * 10,
            r"`probabilities` must be numbers of type float in \[0, 1\], got 2.0",
        ),
        ("window_start_us", [], r"`window_start_us` must be a list of one time or more, got \[\]"),
        (
            "window_start_us",
            [0.5] * n,
            r"`window_start_us` must be numbers of type int in .*, got 0.5",
        ),
        (
            "window_probabilities",
            [[0.1] * 10] * (n + 1),
            f"`window_probabilities` must hold {n} x 10 numbers",
        ),
        (
            "decided_at",
            [[10] * 10] * n,
            r"`decided_at` must be numbers of type int in \[-1, 9\], got 10",
        ),
        ("confident", [[0] * 6] * n, f"`confident` must hold {n} x 7 numbers"),
        ("events", True, "`events` must be numbers of type int in .*, got True"),
        ("late", -1, "`late` must be numbers of type int in .*, got -1"),
    ):
        out.unlink(missing_ok=True)
        collect(evaluate, tasks, run, out)
        lines = [json.loads(line) for line in out.read_bytes().splitlines()]
        lines[0][name] = value
        content = "".join(json.dumps(line) + "\n" for line in lines)
        out.write_text(content)
        with pytest.raises(ValueError, match=f"{out} is damaged: the record of '0.bin': {message}"):
            collect(evaluate, tasks, run, out, check=check)
        assert out.read_text() == content  # it may be worth more to its owner than to us


# -- models ----------------------------------------------------------------------------------------


def use_model(model):
    assert isinstance(model, Model)
    logits = CompiledClassifier(model)(np.zeros(model.config.shape, np.float32))
    assert len(logits) == len(model.classes)
    assert json.dumps(model.record) and repr(model) and model.description()
    Processor(model).fire()


def test_damaged_models(tmp_path):
    path = tmp_path / "m.safetensors"
    content = small_model().save(path).read_bytes()
    assert len(try_all(path, damaged_bytes(content, 100, seed=2), load_model, use_model)) > 95
    record = {"data": "a", "accuracy": {"0": 0.5, "1": [1, None]}}
    parts = {
        "config": SMALL.to_dict(),
        "classes": list("abc"),
        "record": record,
        "network": small_model().network,
    }
    for k, (name, value) in enumerate(parts.items()):

        def written(text, name=name):
            write_file(path, changed(), **{name: text})
            return path.read_bytes()

        texts = map(written, damaged_json(value, 100, seed=k))
        assert try_all(path, texts, load_model, use_model)
        path.write_bytes(written(RAW["nested too deep"]))
        with pytest.raises(
            ValueError,
            match=f"{path} holds a damaged model: `{name}` in its metadata cannot be read: its",
        ):
            load_model(path)


@pytest.mark.parametrize("read", [load_model, OnnxClassifier], ids=["load_model", "OnnxClassifier"])
def test_damaged_exports(read, tmp_path):
    path = tmp_path / "m.onnx"
    content = to_onnx(small_model()).SerializeToString()

    def use(found):
        if isinstance(found, Model):
            use_model(found)
        else:
            assert len(found(np.zeros(found.shape, np.float32))) == found.n_classes

    def read_ours(path):
        try:
            return read(path)
        except TypeError as error:  # by damage to `format` it has become one of another program
            assert read is load_model and "does not say how events become its volume" in str(error)
            raise ValueError(str(error)) from None

    assert len(try_all(path, damaged_bytes(content, 100, seed=3), read_ours, use)) > 80
    proto = onnx.ModelProto()
    proto.ParseFromString(content)
    metadata = {entry.key: entry.value for entry in proto.metadata_props}
    for k, name in enumerate(("config", "classes", "record", "network")):

        def written(text, name=name):
            del proto.metadata_props[:]
            onnx.helper.set_model_props(proto, metadata | {name: text})
            seal(proto)
            return proto.SerializeToString()

        texts = map(written, damaged_json(json.loads(metadata[name]), 60, seed=k))
        assert try_all(path, texts, read_ours, use)


def test_damaged_configurations_of_other_programs_networks(tmp_path):
    (tmp_path / "n.onnx").write_bytes(network())
    path = tmp_path / "c.json"
    value = {"config": SMALL.to_dict(), "classes": ["a", "b", "c"]}

    def read(path):
        try:
            return choose_engine(tmp_path / "n.onnx", config=path)
        except ValueError as error:
            # a configuration that the network does not fit
            if str(tmp_path / "n.onnx") in str(error):
                raise ValueError(f"{path}: {error}") from None
            raise

    path.write_text(json.dumps(value))
    assert read(path).model.classes == ("a", "b", "c")
    assert try_all(path, damaged_bytes(path.read_bytes(), 100, seed=4), read)
    assert try_all(path, damaged_json(value, 150, seed=5), read)


# -- tables, masks ---------------------------------------------------------------------------------


BOX = [("t", "<i8"), ("x", "<f4"), ("y", "<f4"), ("w", "<f4"), ("h", "<f4"), ("class_id", "<u4")]


def test_damaged_tables_of_objects(tmp_path):
    names = tmp_path / "label_map_dictionary.json"
    boxes = tmp_path / "a_bbox.npy"
    points = tmp_path / "a_objects.csv"
    read = functools.partial(read_table, classes=("on", "off"))

    def use(table):
        assert len(table.t) == len(table.label) == len(table.middle) == len(table.reach) > 0
        assert np.isfinite(table.middle).all() and sum(1 for _ in table.moments()) > 0

    rows = np.array([(5, 1, 2, 3, 4, 0), (9, 2, 2, 3, 4, 1)], BOX)
    np.save(boxes, rows)
    good = boxes.read_bytes()
    errors = try_all(boxes, damaged_bytes(good, 200, seed=6), read, use)
    assert len(errors) > 100
    shapes = {f"of shape {shape}": np.resize(rows, shape) for shape in ((), (1, 2), (2, 1), (0,))}
    odd = {
        **shapes,
        "t is a number with decimals": _with(rows, "t", "f8", 0.5),
        "t is not finite": _with(rows, "t", "f8", np.nan),
        "t is infinite": _with(rows, "t", "f8", np.inf),
        "t is a text": _with(rows, "t", "U3", "a"),
        "t is a date": _with(rows, "t", "M8[s]", 5),
        "t is beyond int64": _with(rows, "t", "u8", 2**63 + 5),
        "t has two numbers": _with(rows, "t", ("i8", (2,)), 5),
        "x has two numbers": _with(rows, "x", ("f4", (2,)), 5),
        "x is complex": _with(rows, "x", "c8", 5),
        "class_id is negative": _with(rows, "class_id", "i4", -1),
        "class_id is a text": _with(rows, "class_id", "S3", b"a"),
    }
    for what, array in odd.items():
        np.save(boxes, array)
        with pytest.raises(ValueError, match=re.escape(str(boxes)) + r": (not a|no object)[^\n]*$"):
            read(boxes)
            pytest.fail(what)
    boxes.write_bytes(good)
    value = {"0": "on", "1": "off"}
    for text in damaged_json(value, 150, seed=7):
        names.write_text(text)
        is_empty = "no object of the model" in _error_of(read, boxes)
        with refused_in_one_line(boxes if is_empty else names, []):
            use(read(boxes))
    names.unlink()
    text = "t,class,x,y,w,h\n5,on,1,2,3,4\n9,off,2,2,3,4.5\n"
    assert try_all(points, damaged_bytes(text.encode(), 200, seed=8), read, use)
    cells = ("9" * 5_000, "9" * 25, "", "nan", "1e999", "1.5", "0x5", "\0")
    for column in range(6):
        for cell in cells:
            row = ["5", "on", "1", "2", "3", "4"]
            row[column] = cell
            points.write_text(f"t,class,x,y,w,h\n{','.join(row)}\n")
            with refused_in_one_line(points, []):
                use(read(points))


def _with(rows, name, dtype, value):
    """The rows with one field of another type and value."""
    fields = [(field, dtype if field == name else old) for field, old in BOX]
    other = np.zeros(len(rows), fields)
    for field, _ in BOX:
        if field != name:
            other[field] = rows[field]
    other[name] = value
    return other


def _error_of(read, path):
    try:
        read(path)
    except ValueError as error:
        return str(error)
    return ""


def test_damaged_tables_of_labels(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 4), np.int64))
    path = tmp_path / "a_labels.csv"
    text = "class,start,end\nwave,5,9\nclap,10,20\n"

    def use(found):
        assert all(
            0 <= one.between_us[0] < one.between_us[1] for some in found.values() for one in some
        )

    def read(_):
        try:
            return find_recordings(tmp_path)
        except ValueError as error:
            if f"{tmp_path}: no class folders" in str(error):  # a table without rows
                raise ValueError(f"{path}: {error}") from None
            raise

    path.write_text(text)
    use(read(path))
    assert try_all(path, damaged_bytes(text.encode(), 200, seed=9), read, use)
    for number in ("9" * 5_000, "9" * 25, "1e9", "0x9", "-5"):
        tables = [f"class,start,end\nwave,{number},9\n", f"class,start,end\nwave,{number}"]
        assert len(try_all(path, tables, read, use)) == 2


def test_damaged_masks(tmp_path):
    path = tmp_path / "m.npy"
    save_mask(path, np.eye(6, 9, dtype=bool))
    errors = try_all(
        path, damaged_bytes(path.read_bytes(), 300, seed=10), load_mask, lambda mask: mask.sum()
    )
    assert len(errors) > 50
