"""Scores of taught digits by hand, and which recordings they are taught from."""

import numpy as np
import pytest

from async_tnt.networks.teaching.window_readings import Readings
from experiments.digit_data.small_sets import write_small_nmnist
from experiments.lessons.other_sets import OTHER_SETS, write_hands
from experiments.lessons.place import PER_CLASS, Place, files_of
from experiments.lessons.readings import Part, chosen, sure_share
from experiments.lessons.settings import SETTINGS
from experiments.tables.teaching import teaching_others


def test_scores_by_hand():
    """Three recordings: one of an old class, right; one of it, half wrong; one new one."""
    is_end = np.array([0, 1, 1, 1, 1, 1], bool)
    readings = Readings(np.zeros((6, 1)), np.zeros((6, 2)), is_end)
    part = Part(readings, np.array([0, 0, 0, 0, 0, 2]), np.array([1, 1, 1, 2, 2, 3]))
    logits = np.array(
        [[0, 0, 9], [5, 0, 0], [5, 0, 0], [0, 0, 9], [1, 0, 0], [0, 0, 1.0]], np.float64
    )
    scores = part.score(logits, new=2)
    assert scores["new"] == 1.0
    assert scores["old"] == 0.75
    assert scores["mean"] == pytest.approx((0.75 + 1) / 2)
    assert scores["new_recordings"] == 1.0
    assert scores["old_recordings"] == 0.5  # the surer window of the second recording is wrong
    assert scores["mean_recordings"] == 0.75
    assert scores["old_early"] == 0.0
    assert scores["taken"] == 0.25
    kept = chosen(readings, is_end)
    assert len(kept.is_end) == 5
    assert sure_share(readings, logits) == 0.6  # softmax (5, 0, 0): .987; (1, 0, 0): .576


def test_a_lesson_is_drawn_from_what_training_learns_from(tmp_path):
    nmnist = write_small_nmnist(tmp_path / "nmnist", n_train=10, first_number=1)
    place = Place(nmnist / "Train", nmnist / "Test", tmp_path, ())
    assert place.classes == [str(digit) for digit in range(10)]
    learned = place.learned("4")
    held_out = place.held_out("4")
    assert (len(learned), len(held_out)) == (8, 2)
    assert max(learned).name < min(held_out).name
    for k in PER_CLASS:
        first = place.drawn("4", k, 0)
        assert first == place.drawn("4", k, 0)
        assert len(first) == min(k, 8)
        assert set(first) <= set(learned)
    assert place.drawn("4", 5, 0) != place.drawn("4", 5, 1)


def test_settings_differ_from_the_first_in_one_value():
    for setting in SETTINGS[1:]:
        pairs = zip(vars(setting).values(), vars(SETTINGS[0]).values(), strict=True)
        assert sum(ours != theirs for ours, theirs in pairs) == 1


def test_some_classes_of_other_sets_are_left_out(tmp_path):
    assert OTHER_SETS["poker"].left_out(["he", "di"]) == ["he", "di"]
    left_out = OTHER_SETS["characters"].left_out([str(i) for i in range(36)])
    assert len(set(left_out)) == 6
    for name, n in (("one", 1), ("two", 2)):
        for i in range(n):
            path = tmp_path / "Train" / name / f"{i}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    place = OTHER_SETS["characters"].place(tmp_path, tmp_path / "models")
    assert [len(place.learned(name)) for name in ("one", "two")] == [1, 1]
    assert [len(place.held_out(name)) for name in ("one", "two")] == [0, 1]


def test_hands_move_in_all_directions(tmp_path):
    write_hands(tmp_path, {"train": 8, "test": 1})
    place = OTHER_SETS["hands"].place(tmp_path, tmp_path / "models")
    assert len(place.classes) == 8
    assert len(files_of(place.train / place.classes[0])) == 8
    assert len(files_of(place.test / place.classes[0])) == 1


def test_other_sets_have_their_rows():
    def scores(new):
        row = dict.fromkeys(("old", "mean", "old_recordings", "mean_recordings"), 0.5)
        return {**row, "new": new, "new_recordings": new}

    entry = {
        "title": "made hands",
        "base": scores(0.0),
        "taught": {"1": [scores(0.1), scores(0.3)]},
        "again": {"k": 1, **scores(0.9)},
    }
    assert teaching_others({"hands cup": entry}).splitlines()[2:] == [
        "| made hands: network without the class | 1 | - / .500 / - | - / .500 / - |",
        "| made hands: taught, 1 | 1 | .200 / .500 / .500 | .200 / .500 / .500 |",
        "| made hands: everything again, 1 | 1 | .900 / .500 / .500 | .900 / .500 / .500 |",
        "| made hands: taught, 1, the same recordings | 1 | .100 / .500 / .500 "
        "| .100 / .500 / .500 |",
    ]
    assert teaching_others({}) == ""
