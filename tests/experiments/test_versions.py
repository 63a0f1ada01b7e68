"""Cheap versions of recordings: other directions without any simulation."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.motions.versions import FLIPPED, backwards, flipped, turned
from experiments.objects.versions import N_DRAWN, write_versions

COLUMNS = tuple(np.array(column) for column in ([0, 10, 99], [1, 2, 7], [0, 5, 9], [0, 1, 1]))


def as_lists(columns):
    return [column.tolist() for column in columns]


def test_a_quarter_turn_takes_right_to_down_and_leaves_out_what_leaves_the_sensor():
    """On 8x10 pixels the middle is (3.5, 4.5): (x, y) goes to (3.5 - y + 4.5, 4.5 + x - 3.5)."""
    t, x, y, p = turned(COLUMNS, np.pi / 2, (8, 10))
    assert as_lists((t, x, y, p)) == [[10], [3], [3], [1]]
    for column, same in zip(turned(COLUMNS, 2 * np.pi, (8, 10)), COLUMNS, strict=True):
        np.testing.assert_array_equal(column, same)


def test_half_a_turn_is_both_flips_and_everything_twice_is_nothing():
    half = turned(COLUMNS, np.pi, (8, 10))
    assert as_lists(half) == as_lists(flipped(COLUMNS, "flipped x and y", (8, 10)))
    for name in FLIPPED:
        twice = flipped(flipped(COLUMNS, name, (8, 10)), name, (8, 10))
        assert as_lists(twice) == as_lists(COLUMNS)
    assert as_lists(backwards(backwards(COLUMNS, 100), 100)) == as_lists(COLUMNS)


@pytest.mark.parametrize(
    "names, n",
    [
        (("reversed",), 2),
        (FLIPPED, 4),
        ((*FLIPPED, "reversed"), 8),
        (("turned",), 1 + N_DRAWN),
        (("turned", "flipped x", "reversed"), 1 + N_DRAWN),
    ],
)
def test_a_folder_has_each_recording_and_its_versions(names, n, tmp_path):
    (tmp_path / "in" / "a").mkdir(parents=True)
    for k in range(3):
        np.savez(tmp_path / "in" / "a" / f"{k:03}.npz", **dict(zip("txyp", COLUMNS, strict=True)))
    assert write_versions(tmp_path / "in", tmp_path / "out", names, (8, 10), 100, 0) == n
    files = sorted(path.name for path in (tmp_path / "out" / "a").iterdir())
    assert files == [f"{k:03}_{version}.npz" for k in range(3) for version in range(n)]
    first = np.load(tmp_path / "out" / "a" / "001_0.npz")
    assert as_lists([first[name] for name in "txyp"]) == as_lists(COLUMNS)
    versions = [np.load(tmp_path / "out" / "a" / f"001_{k}.npz") for k in range(n)]
    assert len({versions[k]["x"].tobytes() + versions[k]["t"].tobytes() for k in range(n)}) > 1
    if "reversed" in names:
        assert {version["t"].tolist()[0] for version in versions if len(version["t"]) == 3} == {0}
