"""--columns, --topic, --between-us and --strict have one meaning in all commands.

Every command that reads recordings has them.
"""

import json

import numpy as np
import pytest
from made import events_of
from sources.files.ros_written import Bag
from sources.files.written import metavision_csv

from async_tnt.evaluation.job import Job
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.files.source import ReadOptions
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.dataset import read_dataset
from async_tnt.training.simulated_pictures import measure_camera

EVENTS = open_recording(sample_recordings()[3]).read()
SENSOR = (34, 34)
PIXELS = Pixels(sensor=SENSOR)
START = 50_000
"""The first microsecond of a part of the events."""
END = 200_000
"""The first microsecond behind that part."""
PART = EVENTS[(EVENTS["t"] >= START) & (EVENTS["t"] < END)]
SINGLE = ("run", "info", "plot", "view", "check", "mask")


def words_for(command, path, tmp_path):
    """A command on one recording, whose output does not depend on the name of its file."""
    pytest.importorskip({"view": "rerun", "plot": "matplotlib"}.get(command, "numpy"))
    return {
        "run": ("run", path, "--json"),
        "info": ("info", path, "--json", "--sensor", "34x34"),
        "plot": ("plot", path, "--out", tmp_path / "a.png"),
        "view": ("view", path, "--out", tmp_path / "a.rrd"),
        "check": ("check", path, "--prefixes", "1", "--json"),
        "mask": ("mask", path, "--sensor", "34x34", "--out", tmp_path / "mask.npy", "--json"),
        "evaluate": ("evaluate", "digits", path.parent.parent, "--json"),
    }[command]


def answer(program, command, path, tmp_path, *options):
    """Exit code, stderr, and what the command found, without names and times."""
    words = words_for(command, path, tmp_path)
    code, out, err = program(*words, *options)
    if command == "plot" and code == 0:
        return code, err, pixels_below_the_title(tmp_path / "a.png")
    if "--json" not in words:
        return code, err, out
    reports = [json.loads(line) for line in out.splitlines()]
    for report in reports:
        for name in ("recording", "format", "bytes", "sensor_stated", "topics", "out"):
            report.pop(name, None)
        if command == "check":
            report["recordings"] = list(report["recordings"].values())
    return code, err, reports


def pixels_below_the_title(path):
    """The bytes of a figure without its first line, which names the recording."""
    from matplotlib import pyplot

    picture = pyplot.imread(path)
    return picture[len(picture) // 20 :].tobytes()


def saved(path, events):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, events=events, sensor=SENSOR)
    return path


@pytest.fixture
def two_topics(tmp_path):
    (tmp_path / "bags" / "3").mkdir(parents=True)
    path = tmp_path / "bags" / "3" / "a.mcap"
    with Bag(path) as bag:
        bag.array(EVENTS, SENSOR, topic="/left")
        bag.array(EVENTS[:5], SENSOR, topic="/right")
    return path


@pytest.mark.parametrize("command", [*SINGLE, "evaluate"])
def test_the_topic_of_a_bag_is_chosen_and_several_are_listed(
    program, tmp_path, two_topics, command
):
    code, err, _ = answer(program, command, two_topics, tmp_path)
    option = "`topic`" if command == "evaluate" else "--topic"
    assert code == 2
    assert f"several topics have events, choose one by {option}: /left, /right" in err
    expected = answer(program, command, saved(tmp_path / "all" / "3" / "a.npz", EVENTS), tmp_path)
    assert expected[0] == 0
    assert answer(program, command, two_topics, tmp_path, "--topic", "/left") == expected


@pytest.mark.parametrize("command", [*SINGLE, "evaluate"])
def test_the_order_of_columns_is_stated(program, tmp_path, command):
    path = tmp_path / "rows" / "3" / "a.csv"
    path.parent.mkdir(parents=True)
    path.write_bytes(metavision_csv(EVENTS).split(b"\n", 1)[1])
    code, err, _ = answer(program, command, path, tmp_path)
    option = "`columns`" if command == "evaluate" else "--columns"
    assert code == 2 and f"look like 'xypt': state their order with {option}" in err
    expected = answer(program, command, saved(tmp_path / "all" / "3" / "a.npz", EVENTS), tmp_path)
    assert answer(program, command, path, tmp_path, "--columns", "xypt") == expected
    code, err, _ = answer(program, command, path, tmp_path, "--columns", "xyz")
    assert code == 2
    assert "--columns must have the letters t, x, y and p, each once, got 'xyz'" in err


@pytest.mark.parametrize("command", SINGLE)
def test_a_part_between_two_times_is_taken_alone(program, tmp_path, command):
    whole = saved(tmp_path / "all.npz", EVENTS)
    expected = answer(program, command, saved(tmp_path / "part.npz", PART), tmp_path)
    assert expected[0] == 0 and expected != answer(program, command, whole, tmp_path)
    assert answer(program, command, whole, tmp_path, "--between-us", f"{START},{END}") == expected


@pytest.mark.parametrize(
    "text",
    ["5", "5,5", "6,5", "a,b", "a,5", "5,b", "1.5,2", "1,2.5", "-1,5", "1,2,3", ",", f"0,{9**99}"],
)
def test_a_part_of_no_times_is_refused(program, text, capsys):
    with pytest.raises(SystemExit) as stopped:
        program("info", sample_recordings()[3], f"--between-us={text}")
    assert stopped.value.code == 2
    rule = "argument --between-us: must be START,END in whole microseconds, START before END"
    assert rule in capsys.readouterr().err


@pytest.mark.filterwarnings("always::async_tnt.sources.files.source.DamagedRecording")
@pytest.mark.parametrize("command", SINGLE)
def test_a_damaged_recording_is_read_up_to_the_damage_or_refused(program, tmp_path, command):
    path = tmp_path / "a.csv"
    rows = "".join(f"{t},{x},{y},{p}\n" for t, x, y, p in PART.tolist())
    path.write_text(f"t,x,y,p\n{rows}what\n")
    code, err, found = answer(program, command, path, tmp_path)
    assert code == 0 and "damaged recording" in err
    assert found == answer(program, command, saved(tmp_path / "part.npz", PART), tmp_path)[2]
    code, err, _ = answer(program, command, path, tmp_path, "--strict")
    assert code == 2 and "a.csv: damaged recording: line" in err and "Fetch the file again." in err


@pytest.mark.parametrize("command", ["run", "view"])
@pytest.mark.parametrize(
    "option",
    [("--columns", "xypt"), ("--topic", "/a"), ("--between-us", "0,5"), ("--strict",)],
    ids="".join,
)
def test_a_camera_and_the_network_have_no_such_options(program, tmp_path, command, option):
    more = ("--out", tmp_path / "a.rrd") if command == "view" else ()
    code, _, err = program(command, "udp://127.0.0.1:0?timeout_s=.01", *more, *option)
    assert code == 2 and f"{option[0]} must come with recordings, got udp://127.0.0.1:0" in err


def test_info_lists_all_topics(program, two_topics):
    code, out, _ = program("info", two_topics, "--topic", "/right")
    assert code == 0 and "  topic      /left: dvs_msgs/msg/EventArray, 1 messages\n" in out
    assert "  topic      /right: dvs_msgs/msg/EventArray, 1 messages, which is read\n" in out
    topics = json.loads(program("info", two_topics, "--topic", "/right", "--json")[1])["topics"]
    assert [(topic["name"], topic["messages"], topic["is_read"]) for topic in topics] == [
        ("/left", 1, False),
        ("/right", 1, True),
    ]


@pytest.mark.parametrize("command", SINGLE)
def test_a_file_of_another_format_gives_exit_code_2(program, tmp_path, command):
    path = tmp_path / "notes.csv"
    path.write_text("t,x,y,p\nnot,an,event,at all\n")
    code, err, _ = answer(program, command, path, tmp_path)
    assert code == 2 and "notes.csv: not one event can be read: line 2: expected t,x,y,p" in err


def test_results_of_another_topic_are_not_taken_for_these(program, tmp_path, two_topics):
    """`evaluate --out` keeps what it has done; what the files are read as is a part of that."""
    words = (
        "evaluate",
        "digits",
        two_topics.parent.parent,
        "--out",
        tmp_path / "results.jsonl",
        "--json",
    )
    for _ in range(2):
        code, out, _ = program(*words, "--topic", "/left")
        assert code == 0 and json.loads(out)["events"] == len(EVENTS)
    code, _, err = program(*words, "--topic", "/right")
    assert code == 2 and "results.jsonl was made with another model, " in err
    (tmp_path / "results.jsonl").unlink()
    code, out, _ = program(*words, "--topic", "/right")
    assert code == 0 and json.loads(out)["events"] == 5
    ids = {Job("digits", reading=ReadOptions(columns=order)).id for order in (None, "xypt", "yxpt")}
    assert len(ids | {Job("digits", reading=ReadOptions(topic="/left")).id}) == 4


def test_a_map_model_is_for_the_sensor_of_the_chosen_topic(program, tmp_path):
    path = tmp_path / "a.bag"
    with Bag(path) as bag:
        bag.array(EVENTS[:2_000], (100, 80), topic="/left")
        bag.array(EVENTS, (50, 40), topic="/right")
    code, out, err = program(
        "run", path, "--model", "digits-everywhere", "--topic", "/left", "--json"
    )
    assert code == 0 and out and not err


def test_a_data_set_is_read_by_its_options(tmp_path):
    """Each class has a file whose columns have no names, and a bag of two topics."""
    for label, part in (("a", EVENTS[:2_000]), ("b", EVENTS[2_000:])):
        (tmp_path / "set" / label).mkdir(parents=True)
        (tmp_path / "set" / label / "rows.csv").write_bytes(metavision_csv(part).split(b"\n", 1)[1])
        with Bag(tmp_path / "set" / label / "two.mcap") as bag:
            bag.array(part[:500], SENSOR, topic="/left")
            bag.array(part[500:900], SENSOR, topic="/right")
        saved(tmp_path / "all" / label / "rows.npz", part)
        saved(tmp_path / "all" / label / "two.npz", part[500:900])
    found = read_dataset(
        tmp_path / "set", pixels=PIXELS, reading=ReadOptions(columns="xypt", topic="/right")
    )
    expected = read_dataset(tmp_path / "all", pixels=PIXELS)
    assert not found.left_out and found.classes == ("a", "b")
    for name in ("t", "x", "y", "p", "labels", "offsets"):
        np.testing.assert_array_equal(
            getattr(found.recordings, name), getattr(expected.recordings, name)
        )
    with pytest.raises(ValueError, match="no recording of class a, b is left"):
        read_dataset(tmp_path / "set", pixels=PIXELS)


def test_a_camera_is_measured_on_a_recording_read_by_its_options(tmp_path):
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 1_000_000, 20_000))
    events = events_of(
        t, rng.integers(0, 34, t.size), rng.integers(0, 34, t.size), rng.integers(0, 2, t.size)
    )
    (tmp_path / "rows.csv").write_bytes(metavision_csv(events).split(b"\n", 1)[1])
    found = measure_camera(tmp_path / "rows.csv", 100_000, SENSOR, columns="xypt")
    assert found == measure_camera(saved(tmp_path / "a.npz", events), 100_000, SENSOR)
