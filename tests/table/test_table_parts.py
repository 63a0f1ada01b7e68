"""The table's parts: what is compared, what was seen in training, and the numbers brought together."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from async_tnt.training.table import (  # noqa: E402
    COLUMNS,
    ROWS,
    aggregate,
    columns_of,
    markdown_table,
    motions_table,
    text_table,
)
from async_tnt.training.table_data import RealFolder, on_first_saccade, saccade, shown_test_images, simulated_windows  # noqa: E402


def test_rows_differ_only_in_what_they_are_named_for():
    assert list(ROWS) == ["baseline", "tnt", "regress", "running", "line"]
    for name in ("tnt", "regress", "running", "line"):
        assert (ROWS[name].config.transform, ROWS[name].config.t_max) == ("tnt", ROWS["tnt"].config.t_max)
    assert ROWS["baseline"].config.transform == "none"
    assert ROWS["line"].config.remove_flow and ROWS["line"].config.polarity == "unsigned"
    plain = ROWS["baseline"].augmentation
    moves = ("shift_px", "translate_px", "start_ms", "partial", "rotation_deg", "scale", "shear")
    assert all(getattr(plain, name) == 0 for name in moves)
    assert [row.augmentation == plain for row in ROWS.values()] == [True, True, False, True, True]
    assert ROWS["regress"].augmentation.translate_px == 4
    assert all(len(row.thesis) in (0, len(COLUMNS)) for row in ROWS.values())


def test_each_network_belongs_to_its_columns():
    assert columns_of("all") == ("all/all", "all/sim")
    assert columns_of("1") == ("1/all", "1/train", "1/sim")


def test_images_seen_in_training_are_read_from_the_names():
    names = ["3/00001.bin", "3/60000.bin", "7/60001.bin", "7/60026.bin", "1/70000.bin", "1/other.bin", "1/70001.bin"]
    assert shown_test_images(names).tolist() == [0, 25, 9999]
    assert shown_test_images([]).tolist() == []


def test_real_windows_by_saccade(small_nmnist):
    data = RealFolder(small_nmnist, validation=0.25).read()
    assert data.description["split"].startswith("not the official one")
    assert (data.description["training_recordings"], data.description["held_out_recordings"]) == (30, 10)
    assert data.description["test_recordings"] == 10
    assert np.bincount(saccade(data.test)).tolist() == [10, 10, 10]
    first = on_first_saccade(data.training)
    assert len(first) == 30 and (first.start_us == 0).all()
    assert not set(data.training.recording) & set(data.held_out.recording)
    assert data.seen_images.tolist() == list(range(5, 45))


def test_simulated_windows_leave_out_the_images_seen(small_set):
    found = list(simulated_windows(small_set, np.arange(5, 45)))
    assert len(found) == 30 and len({motion for motion, _ in found}) == 30
    for _, windows in found:
        assert [windows.recordings.names[r] for r in windows.recording] == ["0", "1", "2", "3", "4"]
        assert windows.labels.tolist() == [0, 7, 4, 1, 8] and (windows.start_us == 0).all()
    everything = next(simulated_windows(small_set, np.empty(0, np.int64)))[1]
    assert len(everything) == 45


def run(row, trained_on, seed, **accuracies):
    columns = {
        column.replace("_", "/"): {"accuracy": a, "windows": 4, "per_motion": {"saccade 1": a, "saccade 2": a / 2}}
        for column, a in accuracies.items()
    }
    return {"row": row, "trained_on": trained_on, "seed": seed, "columns": columns}


RUNS = [
    run("tnt", "all", 0, all_all=0.96, all_sim=0.6),
    run("baseline", "all", 1, all_all=1.0),
    run("baseline", "all", 0, all_all=0.98),
]


def test_mean_and_deviation_by_hand():
    table = aggregate(RUNS)
    assert list(table) == ["baseline", "tnt"] and list(table["tnt"]) == ["all/all", "all/sim"]
    part = table["baseline"]["all/all"]
    assert part["mean"] == pytest.approx(0.99) and part["deviation"] == pytest.approx(0.01 * 2**0.5)
    assert part["seeds"] == {"0": 0.98, "1": 1.0} and part["thesis"] == 0.991
    assert part["per_motion"]["saccade 2"]["mean"] == pytest.approx(0.495)
    assert table["tnt"]["all/sim"]["deviation"] is None


def test_the_table_as_text():
    table = aggregate(RUNS)
    lines = text_table(table).splitlines()
    assert lines[0].split() == list(COLUMNS)
    assert lines[1].split() == ["Baseline", ".990", "±", ".014", "-", "-", "-", "-"]
    assert lines[2].split() == ["the", "thesis", "0.991", "0.437", "0.442", "0.396", "0.207"]
    markdown = markdown_table(table).splitlines()
    assert markdown[2] == "| Baseline | .990 ± .014 (.991) | - (.437) | - (.442) | - (.396) | - (.207) |"
    assert motions_table(table, "all/all").splitlines()[2:] == [
        "| saccade 1 | .990 | .960 |",
        "| saccade 2 | .495 | .480 |",
    ]
