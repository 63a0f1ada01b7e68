"""One event off the sensor is left out by every command that reads recordings.

The command says so, and goes on.
"""

import json

import numpy as np
import pytest
from made import events_of

from async_tnt.sources.files.recording import open_recording, sample_recordings


@pytest.fixture
def stray(tmp_path):
    """The path of a recording of a digit in a data set.

    It does not state its sensor, and one event in its middle has row 33,014.
    """
    events = open_recording(sample_recordings()[3]).read()
    middle = len(events) // 2
    strayed = np.insert(events, middle, events[middle])
    strayed["y"][middle] = 33_014
    for label in ("3", "4"):
        (tmp_path / "set" / label).mkdir(parents=True)
    path = tmp_path / "set" / "3" / "stray.npy"
    np.save(path, strayed)
    return path


@pytest.mark.parametrize(
    "words",
    [
        ("run", "--json"),
        ("run", "--roi", "0,0,20,20"),
        ("check", "--prefixes", "2"),
        ("mask", "--sensor", "34x34", "--out", "mask.npy"),
        ("plot", "--out", "plot.png"),
        ("view", "--out", "view.rrd"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
@pytest.mark.filterwarnings("default")
def test_commands_leave_it_out_and_say_so_in_one_line(program, stray, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    command, *options = words
    code, out, err = program(command, stray, *options)
    told = [line for line in err.splitlines() if "off the 34 x 34 sensor" in line]
    assert code == 0 and len(told) == 1
    assert told[0].startswith("async-tnt: warning: ") and "1 of 4,953 events lies off" in told[0]
    assert "y = 33014; it is left out" in told[0]
    if words == ("run", "--json"):
        assert sum(json.loads(line)["events"] for line in out.splitlines()) == 4_952


def test_info_shows_it_with_a_sensor_and_without(program, stray):
    code, out, err = program("info", stray, "--sensor", "34x34")
    assert (code, err) == (0, "")
    assert "off sensor 1 more events lie off the sensor and are left out" in out
    assert json.loads(program("info", stray, "--sensor", "34x34", "--json")[1])["off_sensor"] == 1
    code, out, err = program("info", stray)
    assert (code, err) == (0, "")
    assert "not stated; events reach 34x34, and strays 34x33015; for hot pixels" in out


def test_evaluate_and_its_records_count_it(program, stray, tmp_path):
    code, out, err = program(
        "evaluate", "digits", stray.parents[1], "--out", tmp_path / "r.jsonl", "--json"
    )
    report = json.loads(out)
    assert code == 0 and report["skipped"] == []
    assert (report["recordings"], report["off_sensor"]) == (1, 1)
    assert "1 events lie off the sensor and were left out" in err
    record = json.loads((tmp_path / "r.jsonl").read_text())
    assert (record["error"], record["off_sensor"], record["events"]) == (None, 1, 4_952)


def test_training_data_leave_it_out_and_count_it(stray):
    from async_tnt.sources.pixels.pixels import Pixels
    from async_tnt.training.dataset import read_dataset

    np.save(stray.parents[1] / "4" / "other.npy", events_of([5, 6], [1, 2], [1, 2], [1, 1]))
    dataset = read_dataset(stray.parents[1], pixels=Pixels(sensor=(34, 34)))
    assert (len(dataset.recordings), dataset.left_out, dataset.n_off_sensor) == (2, (), 1)
    assert dataset.recordings.y.max() < 34
    with pytest.raises(
        ValueError, match=r"no recording of .* states its sensor .*needs at least 34x34"
    ):
        read_dataset(stray.parents[1])
