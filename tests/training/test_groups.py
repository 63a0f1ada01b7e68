"""Groups of recordings that stay together, and how they are held out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from async_tnt.training.groups import (
    groups_by_pattern,
    hold_out_end,
    hold_out_groups,
    hold_out_last,
)


def test_a_pattern_groups_by_its_parentheses_or_by_all_it_finds():
    names = ["wave/user01_lab_3.npz", "clap/user01_led_1.npz", "clap/user22_lab_1.npz"]
    assert groups_by_pattern(names, r"user\d+") == ["user01", "user01", "user22"]
    assert groups_by_pattern(names, r"user(\d+)_(led)?") == ["01/", "01/led", "22/"]
    with pytest.raises(ValueError, match=r"got 'led', which is not in wave/user01_lab_3.npz"):
        groups_by_pattern(names, "led")
    with pytest.raises(ValueError, match=r"`groups` must be a regular expression, got '\(': "):
        groups_by_pattern(names, "(")


def test_of_numbered_recordings_the_last_are_held_out():
    names = [f"car/obj_{99 - k}_td.dat" for k in range(100)]
    # a single one needs no number
    names += ["road/7.npy", "road/30.npy", "road/8.npy", "sky/blue.npy"]
    labels = np.array([0] * 100 + [1] * 3 + [2])
    train, held_out = hold_out_last(names, labels, 0.2)
    assert sorted([*train, *held_out]) == list(range(104))
    # at least one, if there are two
    expected = {f"car/obj_{k}_td.dat" for k in range(80, 100)} | {"road/30.npy"}
    assert {names[r] for r in held_out} == expected
    assert len(hold_out_last(names, labels, 0)[1]) == 0
    assert hold_out_last(["a/left.npy", "a/right.npy"], np.zeros(2, int), 0.2) is None
    # one name, but no number
    assert hold_out_last(["a/left.npy", "a/left.npz"], np.zeros(2, int), 0.2) is None
    one_then_three = ["a/blue.npy", "b/1.npy", "b/2.npy", "b/3.npy"]
    # one stays to learn from
    train, held_out = hold_out_last(one_then_three, np.array([0, 1, 1, 1]), 0.9)
    assert (train.tolist(), held_out.tolist()) == ([0, 1], [2, 3])
    users = [f"a/user{u}_{k}.npy" for k in range(20) for u in (10, 9)]  # by user, then by number
    held_out = hold_out_last(users, np.zeros(40, int), 0.1)[1]
    assert {users[r] for r in held_out} == {f"a/user10_{k}.npy" for k in range(16, 20)}


def test_of_the_windows_of_one_session_some_are_learned():
    assert [some.tolist() for some in hold_out_end(10, 0.95)] == [[0], list(range(2, 10))]
    for n_windows, share in [(9, 0.2), (10, 0)]:
        assert [some.tolist() for some in hold_out_end(n_windows, share)] == [
            list(range(n_windows)),
            [],
        ]
    assert [some.tolist() for some in hold_out_end(10, 0.1)] == [list(range(8)), [9]]


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), min_size=1, max_size=60),
    st.floats(0, 0.99),
    st.integers(0, 9),
)
def test_no_group_is_on_both_sides_and_each_class_is_on_the_side_of_training(
    recordings, share, seed
):
    labels = np.array([label for label, _ in recordings])
    groups = [str(group) for _, group in recordings]
    train, held_out = hold_out_groups(labels, groups, share, np.random.default_rng(seed))
    assert sorted([*train, *held_out]) == list(range(len(labels)))
    assert not {groups[r] for r in train} & {groups[r] for r in held_out}
    assert set(labels[train]) == set(labels)
    again = hold_out_groups(labels, groups, share, np.random.default_rng(seed))
    assert again[1].tolist() == held_out.tolist()
    assert share or not len(held_out)


@given(st.lists(st.integers(0, 3), min_size=1, max_size=60), st.floats(0, 0.99), st.integers(0, 9))
def test_without_groups_each_class_gives_its_share_and_no_more(labels, share, seed):
    labels = np.array(labels)
    groups = [str(r) for r in range(len(labels))]
    held_out = hold_out_groups(labels, groups, share, np.random.default_rng(seed))[1]
    for label in np.unique(labels):
        n = np.sum(labels == label)
        wanted = max(1, round(share * n)) if share else 0
        assert np.sum(labels[held_out] == label) == min(wanted, n - 1)


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), min_size=1, max_size=60),
    st.floats(0.01, 0.99),
    st.integers(0, 9),
)
def test_a_class_below_its_share_has_no_other_group_that_could_be_held_out(recordings, share, seed):
    labels = np.array([label for label, _ in recordings])
    groups = np.array([str(group) for _, group in recordings])
    train, held_out = hold_out_groups(labels, groups.tolist(), share, np.random.default_rng(seed))
    for label in np.unique(labels):
        if np.sum(labels[held_out] == label) >= max(1, round(share * np.sum(labels == label))):
            continue
        for group in np.unique(groups[train][labels[train] == label]):
            left = labels[train][groups[train] != group]
            assert set(left) != set(labels), f"group {group} of class {label} could be held out"
