"""async-tnt teach: one more class from recordings, and mistakes that it names in one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from listening import sent
from made import random_model
from networks.teaching.lessons import CLASSES, CONFIG, of_classes, recording

from async_tnt import Processor, load_model
from async_tnt.base.files import Replacement
from async_tnt.cli import teach
from async_tnt.cli.lessons import lesson_lines


def write(path, events, sensor=CONFIG.sensor):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, events=events, sensor=sensor)
    return path


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """The file of a model with statistics."""
    model = replace(random_model(CONFIG, classes=3), classes=CLASSES).with_statistics(of_classes())
    return model.save(tmp_path_factory.mktemp("base") / "base.safetensors")


@pytest.fixture
def lesson(tmp_path):
    """A folder with six recordings of a new class."""
    for i in range(6):
        write(tmp_path / "lesson" / f"{i}.npz", recording(3, i))
    return tmp_path / "lesson"


@pytest.fixture
def refused(program, base, tmp_path):
    """Run `teach` with words that are refused, and return its line; nothing is written."""

    def run(*words, model=base):
        out = tmp_path / "refused.safetensors"
        code, stdout, err = program("teach", model, *words, "--out", out)
        lines = [line for line in err.splitlines() if not line.startswith("left out: ")]
        assert (code, stdout, len(lines)) == (2, "", 1), err
        assert not out.exists()
        return lines[0]

    return run


def test_a_class_is_taught_and_told(program, base, lesson, tmp_path):
    out = tmp_path / "more.safetensors"
    code, stdout, err = program("teach", base, "--class", "d", lesson, "--out", out)
    assert code == 0 and "left out" not in err
    lines = stdout.splitlines()
    assert lines[0] == "d: taught from 6 recordings, 18 windows"
    assert " right of what was left out in turn; 10 recordings are good" in lines[1]
    assert lines[2].startswith("  takes, by the statistics, ")
    assert lines[-1].startswith(f"wrote {out}: 4 classes, ")
    taught = load_model(out)
    decisions = Processor(taught).push(recording(3, 90))
    assert [decision.label for decision in decisions].count("d") >= len(decisions) - 1
    expected = load_model(base).with_class("d", [recording(3, i) for i in range(6)])
    assert taught.record == expected.record
    assert all((taught.weights[name] == w).all() for name, w in expected.weights.items())


def test_several_classes_and_one_forgotten_as_json(program, base, lesson, tmp_path):
    for i in range(5):
        write(tmp_path / "e" / f"{i}.npz", recording(4, i))
    files = sorted((tmp_path / "e").glob("*.npz"))
    out = tmp_path / "more.safetensors"
    words = ("--class", "d", lesson, "--forget", "a", "--class", "a", *files, "--json")
    code, stdout, _ = program("teach", base, *words, "--out", out)
    assert code == 0
    report = json.loads(stdout)
    assert report["classes"] == ["b", "c", "d", "a"]
    assert report["forgotten"] == ["a"] and report["left_out"] == []
    assert report["taught"]["a"]["recordings"] == 5
    assert set(report["taught"]["a"]["taken"]) == {"b", "c", "d"}
    assert report["bytes"] == out.stat().st_size
    assert load_model(out).classes == ("b", "c", "d", "a")


def test_the_same_file_is_taught_and_forgets_again(program, base, lesson, tmp_path):
    path = tmp_path / "m.safetensors"
    path.write_bytes(base.read_bytes())
    assert program("teach", path, "--class", "d", lesson, "--out", path)[0] == 0
    assert load_model(path).classes == (*CLASSES, "d")
    code, _, err = program("teach", path, "--class", "d", lesson, "--out", path)
    assert code == 2
    assert "--class d: the model has this class; give --forget d, too" in err
    assert program("teach", path, "--forget", "d", "--out", path)[0] == 0
    assert path.read_bytes() == base.read_bytes()


def test_what_is_empty_damaged_or_there_twice_is_left_out(program, base, lesson, tmp_path):
    write(lesson / "empty.npz", recording(3, 0)[:0])
    (lesson / "damaged.npz").write_bytes(b"no array")
    write(lesson / "copy.npz", recording(3, 2))
    out = tmp_path / "more.safetensors"
    code, stdout, err = program("teach", base, "--class", "d", lesson, "--out", out, "--json")
    assert code == 0
    assert json.loads(stdout)["taught"]["d"]["recordings"] == 6
    left_out = [line for line in err.splitlines() if line.startswith("left out: ")]
    assert left_out == [f"left out: {line}" for line in json.loads(stdout)["left_out"]]
    copy, damaged, empty = sorted(json.loads(stdout)["left_out"], key=lambda line: line[-30:])[:3]
    assert any("empty.npz: no events" in line for line in left_out)
    assert any("damaged.npz" in line for line in left_out)
    assert any("the same events as" in line for line in left_out)
    assert len({copy, damaged, empty}) == 3


def test_what_is_left_out_of_a_class_is_told_once(program, base, lesson, tmp_path):
    """And is no reason why there is nothing to learn another class from."""
    empty = write(tmp_path / "empty.npz", recording(3, 0)[:0])
    write(tmp_path / "e" / "0.npz", recording(4, 0))
    (tmp_path / "f").mkdir()
    for last, code in ((tmp_path / "e", 0), (tmp_path / "f", 2)):
        words = ("--class", "d", lesson, empty, "--class", "e", last)
        found, _, err = program("teach", base, *words, "--out", tmp_path / "m.safetensors")
        assert found == code and err.count("left out: ") == err.count("empty.npz") == 1


def test_windows_of_nothing_are_of_so_many_recordings_of_each_class(
    program, base, tmp_path, monkeypatch
):
    without = replace(load_model(base), statistics=None).save(tmp_path / "old.safetensors")
    for k, name in enumerate(CLASSES):
        for i in range(5):
            write(tmp_path / "set" / name / f"{i}.npz", recording(k, i))
    read = []
    with_nothing = teach.with_nothing

    def noted(model, windows):
        read.extend(np.unique(windows.recording))
        return with_nothing(model, windows)

    monkeypatch.setattr(teach, "with_nothing", noted)
    monkeypatch.setattr(teach, "MOST_KEPT", 2)
    words = ("--statistics", tmp_path / "set", "--out", tmp_path / "new.safetensors")
    assert program("teach", without, *words)[0] == 0
    assert len(read) == 2 * len(CLASSES)


def test_few_recordings_are_taught_with_a_word(program, base, lesson, tmp_path):
    out = tmp_path / "more.safetensors"
    code, stdout, _ = program("teach", base, "--class", "d", lesson / "0.npz", "--out", out)
    assert code == 0
    assert "d: taught from 1 recording, 3 windows" in stdout
    assert "cannot be told from 1: give 5 or more; 10 are good" in stdout


def test_a_network_stream_is_taught(program, base, tmp_path):
    events = np.concatenate([recording(3, i) for i in range(20)])
    events["t"] = np.sort(np.concatenate([recording(3, i)["t"] + 3000 * i for i in range(20)]))
    out = tmp_path / "more.safetensors"
    with sent(events) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=3"
        words = ("--class", "d", url, "--seconds", "0.03", "--out", out, "--json")
        code, stdout, err = program("teach", base, *words)
    assert code == 0
    assert "0.03 s from the first event on" in err
    windows = json.loads(stdout)["taught"]["d"]["windows"]
    assert 30 <= windows <= 32  # a packet may reach behind the end
    decisions = Processor(load_model(out)).push(recording(3, 90))
    assert [decision.label for decision in decisions].count("d") >= len(decisions) - 1


def test_statistics_come_from_a_data_set_once(program, base, lesson, refused, tmp_path):
    without = replace(load_model(base), statistics=None).save(tmp_path / "old.safetensors")
    line = refused("--class", "d", lesson, model=without)
    assert line == (
        f"async-tnt: {without} has no statistics of its classes: train it again, or give "
        "recordings of them to async-tnt teach as --statistics DATASET"
    )
    for k, name in enumerate(CLASSES):
        for i in range(5):
            write(tmp_path / "set" / name / f"{i}.npz", recording(k, i))
    out = tmp_path / "new.safetensors"
    words = ("--statistics", tmp_path / "set", "--class", "d", lesson, "--out", out)
    code, stdout, _ = program("teach", without, *words)
    assert code == 0 and "4 classes" in stdout
    taught = load_model(out)
    assert taught.classes == (*CLASSES, "d")
    assert taught.statistics.nothing.count > 0
    assert 0 <= taught.record["taught"]["d"]["taken_of_nothing"] <= 1
    line = refused("--statistics", tmp_path / "set", model=out)
    assert "statistics are of the classes a network was trained on" in line
    (tmp_path / "set" / "c").rename(tmp_path / "set" / "nose")
    line = refused("--statistics", tmp_path / "set", model=without)
    assert "`recordings` must be of the classes a, b, c, got a, b, nose" in line


def test_mistakes_are_named(refused, base, lesson, tmp_path):
    other = write(tmp_path / "other" / "a.npz", recording(3, 0), sensor=(64, 48))
    empty = write(tmp_path / "empty" / "a.npz", recording(3, 0)[:0])
    (tmp_path / "nothing").mkdir()
    for words, message in (
        ((), "give --class NAME RECORDING..., --forget NAME or --statistics DATASET"),
        (("--class", "d"), "--class d needs recordings behind the name"),
        (("--class", "d", lesson, "--class", "d", lesson), "--class d is given twice"),
        (("--class", "a", "udp://127.0.0.1:1"), "--class a: the model has this class; give --for"),
        (("--class", "", lesson), "`name` must be a text that can be printed"),
        (("--class", "d", tmp_path / "none.npz"), f"no recording {tmp_path / 'none.npz'}"),
        (("--class", "d", lesson, tmp_path / "none.npz"), "none.npz"),
        (("--class", "d", other), "a sensor of 64x48 pixels, but the model is for 20x16"),
        (("--class", "d", lesson, other), "a sensor of 64x48 pixels, but the model is for 20x16"),
        (("--class", "d", empty), "--class d: nothing to learn it from ("),
        (("--class", "d", tmp_path / "nothing"), "no recordings"),
        (("--class", "d", lesson, "--class", "e", lesson), "the same events as"),
        (("--forget", "nose"), "--forget nose: `name` must be one of the classes a, b, c"),
        (("--forget", "a", "--forget", "b", "--forget", "c"), "must not be the model's only class"),
        (("--statistics", tmp_path / "none"), f"no folder {tmp_path / 'none'}"),
    ):
        assert message in refused(*words), words


@pytest.mark.parametrize("name", ["digits-everywhere"])
def test_models_without_a_place_for_a_class(refused, lesson, name):
    line = refused("--forget", "3", model=name)
    assert "this one finds objects, and a taught class has no place: train it again" in line


def test_a_wrong_name_of_the_file_is_refused_before_anything_is_read(program, base, lesson):
    code, _, err = program("teach", base, "--class", "d", lesson, "--out", "m.onnx")
    assert code == 2 and "its name must end in .safetensors" in err


def test_an_interrupted_lesson_leaves_the_old_file(program, base, lesson, tmp_path, monkeypatch):
    path = tmp_path / "m.safetensors"
    path.write_bytes(base.read_bytes())

    def interrupted(*words):
        raise KeyboardInterrupt

    for owner, name in ((teach, "fingerprint"), (Replacement, "complete")):
        with monkeypatch.context() as patched:
            patched.setattr(owner, name, interrupted)
            code, _, err = program("teach", path, "--class", "d", lesson, "--out", path)
        assert code == 130 and "interrupted" in err
        assert path.read_bytes() == base.read_bytes()
        assert [one.name for one in tmp_path.glob("m*")] == ["m.safetensors"]


def test_info_and_check_know_a_taught_model(program, base, lesson, tmp_path):
    out = tmp_path / "more.safetensors"
    assert program("teach", base, "--class", "d", lesson, "--out", out)[0] == 0
    code, stdout, _ = program("info", out)
    assert code == 0 and "MB of statistics; taught: d" in stdout
    code, stdout, _ = program("info", out, "--json")
    report = json.loads(stdout)
    assert report["statistics"]["taught"] == ["d"]
    assert report["statistics"]["trained"] == list(CLASSES)
    assert report["record"]["taught"]["d"]["recordings"] == 6
    statistics = load_model(out).statistics
    assert (report["statistics"]["layer"], report["statistics"]["components"]) == (
        statistics.layer,
        statistics.n_components,
    )
    assert report["statistics"]["bytes"] == statistics.n_bytes
    assert "MB of statistics; taught: none yet" in program("info", base)[1]
    code, stdout, _ = program("info", "digits-from-pictures", "--json")
    assert json.loads(stdout)["statistics"] is None
    pytest.importorskip("torch", reason="check compares with torch (extra `reference`)")
    code, stdout, err = program("check", lesson / "0.npz", "--model", out)
    assert code == 0, stdout + err


@pytest.mark.parametrize(
    ("n", "told"),
    [
        (
            4,
            "  how many are right and how sure it is cannot be told from 4: give 5 or more",
        ),
        (5, "  80% right of what was left out in turn; 10 recordings are good"),
        (9, "  80% right of what was left out in turn; 10 recordings are good"),
        (10, "  80% right of what was left out in turn"),
    ],
)
def test_a_lesson_in_words_by_hand(n, told):
    """The three classes of which most is taken are named, the first one first."""
    entry = {
        "recordings": n,
        "windows": 3 * n,
        "left_out_right": 0.8,
        "taken": {"a": 0.01, "b": 0.25, "c": 0.0, "d": 0.125},
        "taken_of_nothing": 0.0625,
    }
    first, second, *more = lesson_lines("point", entry)
    assert first == f"point: taught from {n} recordings, {3 * n} windows"
    assert second.startswith(told) and (n < 5 or second == told)
    assert more == [
        "  takes, by the statistics, 25.0% of b, 12.5% of d, 1.0% of a and less of others",
        "  and 6.2% of windows that show none of the classes",
    ]
    del entry["taken"]["c"], entry["taken_of_nothing"]
    assert list(lesson_lines("point", entry))[2:] == [
        "  takes, by the statistics, 25.0% of b, 12.5% of d, 1.0% of a"
    ]


def test_recordings_are_read_by_the_options(program, base, lesson, tmp_path):
    """A part of each, of some pixels; a text whose columns are not named."""
    out = tmp_path / "more.safetensors"
    parts = []
    for i in range(6):
        events = recording(3, i)
        rows = zip(*(events[name].tolist() for name in "xypt"), strict=True)
        text = "".join(f"{x},{y},{p},{t}\n" for x, y, p, t in rows)
        (lesson / f"{i}.npz").unlink()
        (lesson / f"{i}.csv").write_text(text)
        inside = (events["t"] < 2000) & (events["x"] >= 14) & (events["y"] >= 12)
        parts.append(events[inside])
    reading = ("--columns", "xypt", "--between-us", "0,2000", "--sensor", "20x16")
    words = ("--class", "d", lesson, "--roi", "14,12,6,4", *reading, "--out", out)
    code, _, err = program("teach", base, *words)
    assert code == 0, err
    assert load_model(out).record == load_model(base).with_class("d", parts).record


def test_statistics_are_of_the_labelled_parts_of_recordings(program, base, tmp_path):
    """Each recording shows all classes, one after the other, for 3 ms each."""
    without = replace(load_model(base), statistics=None).save(tmp_path / "old.safetensors")
    labels = ["class,start,end"]
    labels += [f"{name},{3000 * k},{3000 * (k + 1)}" for k, name in enumerate(CLASSES)]
    for i in range(5):
        parts = [recording(k, i) for k in range(3)]
        for k, part in enumerate(parts):
            part["t"] += 3000 * k
        write(tmp_path / "set" / f"r{i}.npz", np.concatenate(parts))
        (tmp_path / "set" / f"r{i}_labels.csv").write_text("\n".join(labels))
    out = tmp_path / "new.safetensors"
    code, _, err = program("teach", without, "--statistics", tmp_path / "set", "--out", out)
    assert code == 0, err
    found = load_model(out).statistics
    of_parts = {name: [recording(k, i) for i in range(5)] for k, name in enumerate(CLASSES)}
    expected = replace(load_model(base), statistics=None).with_statistics(of_parts).statistics
    assert found.moments.keys() == expected.moments.keys() == set(CLASSES)
    for name, moments in expected.moments.items():
        assert found.moments[name].count == moments.count, name
        np.testing.assert_allclose(found.moments[name].mean, moments.mean)
