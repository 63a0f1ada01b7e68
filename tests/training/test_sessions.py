"""Sessions: long recordings, and tables of which part shows which class.

They are cut as if each part were a file.
"""

import json
import os
import sys

import numpy as np
import pytest
from made import events_of, random_model, thesis_model
from sources.files.written import aedat3
from training.gestures import bar, write

from async_tnt import TNTConfig
from async_tnt.sources.files.labelled_recordings import (
    find_recordings,
    has_test,
    recordings_under,
)
from async_tnt.sources.files.recording import READERS
from async_tnt.training.data import dataset_data
from async_tnt.training.held_out import Split
from async_tnt.training.simulated_pictures import find_pictures

HEADER = "class,startTime_usec,endTime_usec\n"
PART_US = 150_000


def part(kind, seed, k):
    """The k-th part of a session, at its times."""
    return bar(kind, seed, duration_us=100_000, start_us=5_000_000 + k * PART_US)


def write_session(folder, name, kinds, seed=0, numbers=None, suffix=".npz"):
    """Parts one after another, with half of the last 50 ms of each not labelled."""
    parts = [part(kind, seed + k, k) for k, kind in enumerate(kinds)]
    events = np.concatenate(parts)
    if suffix == ".npz":
        write(folder / f"{name}.npz", events)
    else:
        (folder / f"{name}{suffix}").write_bytes(aedat3(events, (128, 128)))
    rows = []
    for k, kind in enumerate(kinds):
        name_of_class = (numbers or {}).get(kind, kind)
        start_us = 5_000_000 + k * PART_US
        rows.append(f"{name_of_class},{start_us},{start_us + 80_000}\n")
    (folder / f"{name}_labels.csv").write_text(HEADER + "".join(rows))


def cut(events):
    return events[events["t"] < events["t"][0] + 80_000]


@pytest.fixture
def sessions(tmp_path):
    folder = tmp_path / "sessions"
    folder.mkdir()
    for k, name in enumerate(("user01_lab", "user02_lab", "user02_led")):
        write_session(folder, name, ("flat", "upright", "flat"), seed=10 * k)
    return folder


def test_training_sees_the_parts_and_keeps_sessions_together(sessions):
    data = dataset_data(sessions, TNTConfig(), split=Split(0.3))
    assert data.classes == ("flat", "upright") and data.record["classes"] == {
        "flat": 6,
        "upright": 3,
    }
    recordings = data.training.recordings
    assert "user01_lab.npz[5150000:5230000]" in recordings.names
    r = recordings.names.index("user01_lab.npz[5150000:5230000]")
    assert recordings.offsets[r + 1] - recordings.offsets[r] == len(cut(part("upright", 1, 1)))
    assert data.record["source"] == "recordings of own classes, held out by session"
    assert "held out by session: 1 of 3" in data.notes
    sides = [
        {recordings.names[r][:10] for r in windows.recording}
        for windows in (data.training, data.validation)
    ]
    assert len(sides[1]) == 1 and not sides[0] & sides[1]
    by_user = dataset_data(sessions, TNTConfig(), split=Split(0.3, groups=r"user\d+"))
    assert len({recordings.names[r][:6] for r in by_user.validation.recording}) == 1


def test_what_is_learned_ends_before_what_is_held_out_in_time(tmp_path):
    """This also holds where the parts of a session overlap."""
    t = np.arange(0, 2_000_000, 100)
    write(tmp_path / "s.npz", events_of(t, t // 100 % 128, t // 777 % 128, [1] * len(t)))
    rows = [f"{'ab'[k % 2]},{45_000 * k},{45_000 * k + 500_000}\n" for k in range(30)]
    (tmp_path / "s_labels.csv").write_text(HEADER + "".join(rows))
    data = dataset_data(tmp_path, TNTConfig(window_us=100_000))
    begin_us = np.array(
        [int(name[6:].partition(":")[0]) for name in data.training.recordings.names]
    )
    for label in range(2):
        learned, held_out = [
            (begin_us[some.recording] + some.start_us)[some.labels == label]
            for some in (data.training, data.validation)
        ]
        assert len(learned) > 25 and len(held_out) > 10
        assert learned.max() + 100_000 <= held_out.min()


def test_evaluation_is_that_of_the_parts_in_files_of_their_own(sessions, tmp_path, program):
    random = random_model(TNTConfig(sensor=(128, 128), window_us=60_000), classes=2, seed=3)
    model = thesis_model(random.config, random.weights, ("flat", "upright")).save(
        tmp_path / "m.safetensors"
    )
    for s, name in enumerate(("user01_lab", "user02_lab", "user02_led")):
        for k, kind in enumerate(("flat", "upright", "flat")):
            write(tmp_path / "files" / kind / f"{name}{k}.npz", cut(part(kind, 10 * s + k, k)))
    reports = []
    for folder in (sessions, tmp_path / "files"):
        code, out, err = program(
            "evaluate", model, folder, "--json", "--out", tmp_path / f"{folder.name}.jsonl"
        )
        report = json.loads(out)
        assert code == 0 and report["recordings"] == 9, err
        reports.append(report)
    assert reports[0] == reports[1]


def test_the_files_of_dvs128_gesture(tmp_path):
    """The data set has AEDAT 3.1, and class numbers with names in a table of their own.

    Lists say which sessions are to train and to test on.
    """
    for seed, name in enumerate(("user01_lab", "user02_lab")):
        numbers = {"flat": 2, "upright": 10}
        write_session(
            tmp_path, name, ("flat", "upright"), seed=10 * seed, numbers=numbers, suffix=".aedat"
        )
    assert list(find_recordings(tmp_path)) == ["2", "10"]
    (tmp_path / "gesture_mapping.csv").write_text("action,label\nhand_clapping,2\nair_guitar,10\n")
    (tmp_path / "trials_to_train.txt").write_text("user01_lab.aedat\n")
    (tmp_path / "trials_to_test.txt").write_text("user02_lab.aedat\n\n")
    found = find_recordings(tmp_path, "Test")
    assert {name: [one.name for one in some] for name, some in found.items()} == {
        "air_guitar": ["user02_lab.aedat[5150000:5230000]"],
        "hand_clapping": ["user02_lab.aedat[5000000:5080000]"],
    }
    data = dataset_data(tmp_path, TNTConfig(), split=Split(0, test=True))
    assert [name[:6] for name in data.training.recordings.names] == ["user01"] * 2
    assert [name[:6] for name in data.tests["test"][0].recordings.names] == ["user02"] * 2
    (tmp_path / "gesture_mapping.csv").write_text("action,label\nhand_clapping,2\nair_guitar,010\n")
    with pytest.raises(ValueError, match=r"line 3: gesture_mapping.csv does not name class 10"):
        find_recordings(tmp_path)
    (tmp_path / "trials_to_test.txt").write_bytes(b"user\xff")
    with pytest.raises(ValueError, match=r"trials_to_test.txt: not a text in UTF-8: "):
        find_recordings(tmp_path, "Test")
    (tmp_path / "trials_to_test.txt").write_text("\ufeffuser02_lab.aedat\r\n user 07.aedat \r\n")
    with pytest.raises(
        ValueError,
        match=r"trials_to_test.txt names user 07.aedat, which is not there, or has no table",
    ):
        find_recordings(tmp_path, "Test")


def test_tables_and_lists_may_begin_with_a_byte_order_mark(sessions):
    """Spreadsheets write such a mark."""
    (sessions / "gesture_mapping.csv").write_text("action,label\nlying,flat\nstanding,upright\n")
    (sessions / "trials_to_train.txt").write_text("user01_lab.npz\nuser02_led.npz\n")
    (sessions / "trials_to_test.txt").write_text("user02_lab.npz\n")
    expected = [find_recordings(sessions, part) for part in ("Train", "Test")]
    assert [len(found["lying"]) for found in expected] == [4, 2]
    for path in (*sessions.glob("*.csv"), *sessions.glob("*.txt")):
        path.write_bytes("\ufeff".encode() + path.read_bytes())
    assert [find_recordings(sessions, part) for part in ("Train", "Test")] == expected


@pytest.mark.parametrize(
    ("lists", "train", "test"),
    [
        ({}, "abc", "abc"),
        ({"train": "a b"}, "ab", "c"),
        ({"test": "b"}, "ac", "b"),
        ({"train": "a", "test": "b"}, "a", "b"),  # c is for neither
        ({"train": "", "test": "b"}, "", "b"),
        ({"test": ""}, "abc", ""),
    ],
    ids=lambda names: "".join(sorted(names)) if isinstance(names, set) else str(names),
)
def test_what_a_list_sets_aside_is_not_for_the_other_part(tmp_path, lists, train, test):
    for seed, name in enumerate("abc"):
        write_session(tmp_path, name, ("flat", "upright"), seed=10 * seed)
    for part_name, names in lists.items():
        (tmp_path / f"trials_to_{part_name}.txt").write_text(
            "\n".join(f"{name}.npz" for name in names.split())
        )
    for part_name, expected in (("Train", train), ("Test", test), (None, "abc")):
        found = find_recordings(tmp_path, part_name)
        assert {one.path.stem for some in found.values() for one in some} == set(expected), (
            part_name
        )
    if not lists or not train or not test:
        return
    data = dataset_data(tmp_path, TNTConfig(), split=Split(0, test=True))
    assert {name[0] for name in data.training.recordings.names} == set(train)
    assert {name[0] for name in data.tests["test"][0].recordings.names} == set(test)


def test_only_texts_and_the_other_part_may_lie_beside_sessions(tmp_path):
    write_session(tmp_path, "a", ("flat",))
    found = find_recordings(tmp_path)
    write_session(tmp_path / "Test", "c", ("flat",))
    for name in ("notes.csv", "a.csv"):
        (tmp_path / name).touch()
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "setup.png").touch()
    assert not find_pictures(tmp_path)
    assert find_recordings(tmp_path) == found and find_recordings(tmp_path, "Test").keys() == {
        "flat"
    }
    (tmp_path / "a.npy").touch()
    with pytest.raises(ValueError, match=r"a\.npy and a\.npz have one table"):
        find_recordings(tmp_path)
    (tmp_path / "a.npy").unlink()
    write(tmp_path / "b.npz", part("flat", 0, 0))
    with pytest.raises(ValueError, match=r"b\.npz has no table b_labels\.csv, as others have"):
        find_recordings(tmp_path)
    (tmp_path / "b.npz").rename(tmp_path / "c.npz")
    (tmp_path / "b_labels.csv").touch()
    (tmp_path / "c_labels.csv").write_bytes((tmp_path / "a_labels.csv").read_bytes())
    with pytest.raises(
        ValueError, match=r"b_labels\.csv has no recording b\.\*, as others have; remove it"
    ):
        find_recordings(tmp_path)
    (tmp_path / "c_labels.csv").unlink()
    (tmp_path / "trials_to_test.txt").touch()  # lists say what is for training and for testing
    assert find_recordings(tmp_path) == found
    write(tmp_path / "flat" / "d.npz", part("flat", 0, 0))
    with pytest.raises(
        ValueError,
        match=r"expected class folders, or sessions .*, got both: flat/d\.npz and a\.npz",
    ):
        find_recordings(tmp_path)
    write_session(tmp_path / "flat", "d", ("flat",))
    with pytest.raises(
        ValueError, match=r"flat: d\.npz has a table of labels, but lies in a class folder"
    ):
        find_recordings(tmp_path)


def test_tables_that_cannot_be_read_are_named(tmp_path):
    write_session(tmp_path, "a", ("flat",))
    for table, message in (
        (
            "class,begin,end\n",
            "expected a column start or start_us or startTime_usec, got class, begin, end",
        ),
        ("", "expected a column class or label, got none"),
        (
            HEADER + "1,5,9\n1,9,5\n",
            "line 3: expected a class, and whole start < end in us, got 1, 9, 5",
        ),
        (
            "class,start,start,end\n1,5,6,9\n",
            "the column 'start' is there 2 times; leave out all but one",
        ),
        ("label, start, end\nwave, 1.5, 3\n", "line 2: expected a class, .*, got wave, 1.5, 3"),
    ):
        (tmp_path / "a_labels.csv").write_text(table)
        with pytest.raises(ValueError, match=f"a_labels.csv: {message}"):
            find_recordings(tmp_path)


@pytest.mark.parametrize(
    "content", [b"\xff\xfe,1,2", b'"' + b"a" * 200_000], ids=["no UTF-8", "an endless cell"]
)
def test_a_table_that_is_no_text_of_values_is_named(content, tmp_path):
    write_session(tmp_path, "a", ("flat",))
    (tmp_path / "a_labels.csv").write_bytes(HEADER.encode() + content)
    with pytest.raises(ValueError, match=r"a_labels\.csv: not a CSV file: "):
        find_recordings(tmp_path)


def test_times_that_the_file_does_not_have_are_answered_with_those_it_has(sessions):
    """Such times come from a table in another unit, or with another origin."""
    table = sessions / "user02_led_labels.csv"
    table.write_text(HEADER + "upright,20,80\n")
    data = dataset_data(sessions, TNTConfig(), split=Split(0.3))
    (reason,) = data.record["left_out"]
    last = int(part("flat", 22, 2)["t"][-1])
    assert reason == f"user02_led.npz[20:80]: no events; the file has 5000000 to {last} us"


@pytest.mark.parametrize("suffix", sorted(READERS))
def test_a_folder_holds_recordings_of_every_format_with_its_suffix_in_any_case(tmp_path, suffix):
    """They lie in class folders, as sessions, and anywhere below a folder."""
    name = f"a{suffix.upper()}"
    (tmp_path / "classes" / "wave").mkdir(parents=True)
    (tmp_path / "classes" / "wave" / name).touch()
    (found,) = find_recordings(tmp_path / "classes")["wave"]
    assert found.path.name == name and recordings_under(tmp_path) == [found.path]
    (tmp_path / "sessions").mkdir()
    (tmp_path / "sessions" / name).touch()
    (tmp_path / "sessions" / "a_labels.csv").write_text(HEADER + "wave,0,1\n")
    (found,) = find_recordings(tmp_path / "sessions")["wave"]
    assert (found.path.name, found.between_us) == (name, (0, 1))


def names_in(folder, part_name=None):
    """Class name -> the names of its recordings."""
    found = find_recordings(folder, part_name)
    return {label: [one.name for one in some] for label, some in found.items()}


def test_a_session_may_be_a_text(tmp_path):
    """Beside a recording of another format, a text of its name is a note."""
    for suffix, rows in ((".csv", "t,x,y,p\n"), (".txt", "")):
        (tmp_path / f"a{suffix}").write_text(rows)
        (tmp_path / "a_labels.csv").write_text(HEADER + "wave,5,9\n")
        assert names_in(tmp_path) == {"wave": [f"a{suffix}[5:9]"]}
        (tmp_path / f"a{suffix}").unlink()
    for suffix in (".csv", ".npz"):
        (tmp_path / f"a{suffix}").touch()
    assert names_in(tmp_path) == {"wave": ["a.npz[5:9]"]}


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("wave,-1,5\n", "line 2: expected a class, and whole start < end in us, got wave, -1, 5"),
        ("wave,5,5\n", "line 2: expected a class, and whole start < end in us, got wave, 5, 5"),
        ("wave,5\n", "line 2: expected a class, and whole start < end in us, got wave, 5,"),
        (",5,6\n", "line 2: expected a class, and whole start < end in us, got , 5, 6"),
        ("wave,0,5\nclap,5,6\nclap,0,5\n", "line 4: 0 to 5 us is there twice"),
    ],
)
def test_a_part_has_a_class_and_a_length_and_is_there_once(tmp_path, rows, message):
    (tmp_path / "a.npz").touch()
    (tmp_path / "a_labels.csv").write_text(HEADER + rows)
    with pytest.raises(ValueError, match=f"a_labels.csv: {message}$"):
        find_recordings(tmp_path)


def test_parts_of_one_class_may_follow_at_once_and_begin_at_0(tmp_path):
    (tmp_path / "a.npz").touch()
    (tmp_path / "a_labels.csv").write_text(HEADER + "wave,0,5\nwave , 5 , 6 \nwave,0,6\n")
    assert names_in(tmp_path) == {"wave": ["a.npz[0:5]", "a.npz[5:6]", "a.npz[0:6]"]}


def test_a_part_of_a_data_set_that_holds_nothing_is_not_one(tmp_path):
    """As a folder Train that was made for something else."""
    (tmp_path / "Train").mkdir()
    (tmp_path / "Train" / "notes.md").touch()
    for name in (
        *("wave/a.npy", "wave/.hidden.npy", "wave/folder.npy/b.npy"),
        *("clap/b.npy", "clap/a.npy", ".hidden/a.npy"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    expected = {"Train": [], "clap": ["clap/a.npy", "clap/b.npy"], "wave": ["wave/a.npy"]}
    assert names_in(tmp_path, "Train") == names_in(tmp_path) == expected
    (tmp_path / "Train" / "bow").mkdir()
    assert names_in(tmp_path, "Train") == {"bow": []}


@pytest.mark.parametrize("what", ["sessions", "class folders"])
def test_a_part_of_a_data_set_that_holds_anything_hides_what_is_around_it(tmp_path, what):
    """Whether it holds sessions without a class folder, or class folders without a session."""
    expected = {}
    for folder in (tmp_path, tmp_path / "Train", tmp_path / "Test"):
        folder.mkdir(exist_ok=True)
        recording = folder / f"of_{folder.name}.npz"
        if what == "sessions":
            (folder / f"of_{folder.name}_labels.csv").write_text(HEADER + "wave,5,9\n")
        else:
            recording = folder / "wave" / recording.name
            recording.parent.mkdir()
        recording.touch()
        expected[folder.name] = [recording]
    for part_name in ("Train", "Test"):
        (found,) = find_recordings(tmp_path, part_name).values()
        assert [one.path for one in found] == expected[part_name]
    found = find_recordings(tmp_path)["wave"]
    assert [one.path for one in found] == expected[tmp_path.name]


@pytest.mark.parametrize("name", ["trials_to_train.txt", "trials_to_test.txt", "Test"])
def test_a_list_or_a_folder_sets_recordings_aside(tmp_path, name):
    assert not has_test(tmp_path)
    (tmp_path / name).mkdir() if name == "Test" else (tmp_path / name).touch()
    assert has_test(tmp_path)


def test_recordings_below_a_folder_are_sorted_and_links_to_folders_are_not_followed(tmp_path):
    for name in ("set/b/1.npy", "set/a/2.npy", "set/a/1.npy", "set/a/1_labels.csv", "other/3.npy"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "set" / "more").symlink_to(tmp_path / "other")
    (tmp_path / "set" / "round").symlink_to(tmp_path / "set")
    (tmp_path / "set" / "0.npy").symlink_to(tmp_path / "other" / "3.npy")
    found = recordings_under(tmp_path / "set")
    assert [str(path.relative_to(tmp_path / "set")) for path in found] == [
        "0.npy",
        "a/1.npy",
        "a/2.npy",
        "b/1.npy",
    ]


def test_a_folder_that_cannot_be_listed_is_an_error(tmp_path):
    (tmp_path / "a.npy").touch()
    for name, error in (("gone", FileNotFoundError), ("a.npy", NotADirectoryError)):
        with pytest.raises(error):
            recordings_under(tmp_path / name)
        with pytest.raises(error):
            find_recordings(tmp_path / name)


@pytest.mark.skipif(sys.platform != "linux", reason="names need not be in UTF-8 on Linux alone")
def test_a_class_whose_name_is_not_in_utf_8_is_named(tmp_path):
    os.makedirs(os.fsencode(tmp_path) + b"/wa\xffve")
    with pytest.raises(ValueError, match=r"must be in UTF-8, got 'wa.udcffve'; rename it$"):
        find_recordings(tmp_path)
