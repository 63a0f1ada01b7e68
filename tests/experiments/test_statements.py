"""Sentences of docs/results.md whose numbers no table makes: each holds in the results."""

from __future__ import annotations

import re

import pytest

from experiments.tables.accuracy import share_closed
from experiments.tables.parts import results
from experiments.thesis.factors import FACTORS
from experiments.thesis.numbers import LEVEL
from experiments.thesis.rows import IMAGES, INPUTS, SETS


@pytest.fixture(scope="module")
def differences():
    """Row, against, column -> the difference."""
    return {(d["row"], d["against"], d["column"]): d for d in results("table")["differences"]}


def holds(difference):
    return difference["holm"] < LEVEL


def test_the_whole_window_is_as_fast_as_a_full_pass_and_one_event_twice_as_fast():
    network = results("decisions")["network"]
    for mode in ("in_blocks", "call_by_call"):
        medians = {}
        for n in ("1", "1300"):
            us = network[n][mode]["us"]
            medians[n] = {name: us[name]["median"] for name in ("incremental", "dense")}
        assert medians["1300"]["incremental"] == pytest.approx(medians["1300"]["dense"], rel=0.2)
        assert medians["1"]["incremental"] < medians["1"]["dense"] / 2


@pytest.mark.parametrize("new, least, most", [("1", 5.5, 14.5), ("1300", 1.05, 1.6)])
def test_larger_networks_are_faster_than_their_full_pass(new, least, most):
    networks = results("incremental")["networks"]
    del networks["thesis"]
    ratios = {
        name: network["network"][new]["in_blocks"]["ratio"]["dense"]["median"]
        for name, network in networks.items()
    }
    assert len(ratios) == 3 and all(least < ratio < most for ratio in ratios.values()), ratios


def test_early_decisions_are_calibrated():
    early = results("early")
    levels = {row["level"]: row for row in early["confidence"]}
    shares = [round(levels[level]["accuracy"], 3) for level in (0.9, 0.95, 0.99)]
    assert shares == [0.949, 0.977, 0.995]
    after = {row["time_us"]: row["accuracy"] for row in early["accuracy_against_time"]}
    assert levels[0.99]["median_ms"] == 25.2
    assert levels[0.99]["window_accuracy"] >= after[52_500]
    assert early["recordings"] == 1000


def test_scattered_events_are_rarely_decided_at_some_moment():
    rows = results("nothing")["rows"]
    moments = {kind: row["at_some_moment"] for kind, row in rows.items() if "at_some_moment" in row}
    for kind in ("noise", "noise of one polarity", "pairs"):
        assert 0.03 <= moments[kind]["0.9"] <= 0.05
        assert moments[kind]["0.99"] == 0
    drawn = [kind for kind in moments if re.search("edge|corner|disc", kind)]
    assert len(drawn) == 3
    assert all(0.4 < moments[kind]["0.9"] < 0.65 for kind in drawn)


def test_resynthesis_closes_most_of_the_gap_where_events_are_few():
    closed = {
        name: share_closed(results(f"unseen_{name}")["accuracy"])["other motions"]
        for name in ("saccades", "hands")
    }
    assert {name: f"{share:.2f}" for name, share in closed.items()} == {
        "saccades": "0.98",
        "hands": "0.84",
    }
    whole = results("unseen_whole")["accuracy"]["resynthesized"]
    assert round(whole["all saccades"]["mean"], 3) == 0.984
    assert round(whole["simulated motions"]["mean"], 3) == 0.985


def test_objects_on_a_large_sensor_are_found():
    bundled, *others = results("everywhere")["models"]
    told = {
        ("three", "end"): 0.986,
        ("three", "early"): 0.972,
        ("eight", "end"): 0.986,
        ("close", "end"): 0.98,
        ("overlapping", "end"): 0.96,
    }
    assert {(kind, at): round(bundled[kind][at], 3) for kind, at in told} == told
    assert len(others) == 4
    for other in others:
        assert all(other[kind][at] >= bundled[kind][at] for kind, at in told)
    assert {model["noise"] for model in (bundled, *others)} == {0}
    assert round(results("car_scenes")["models"][0]["cars"]["end"], 3) == 0.707


def test_a_map_is_updated_in_time():
    found = results("map_times")["models"]["digits-everywhere"]
    us = {case: times["median"] for case, times in found["times_us"]["640x480"].items()}
    assert round(us["one event"]) == 60
    rounded = {case: round(us[case], -2) for case in ("1,000 events", "dense", "onnxruntime_run")}
    assert rounded == {"1,000 events": 600, "dense": 26_600, "onnxruntime_run": 20_100}
    assert [round(share, 2) for share in found["load"].values()] == [0.22, 0.38, 0.43]


@pytest.mark.parametrize(
    "column, held", [("1/all", {"time_surface"}), ("1/sim", {"mean_time", "time_surface"})]
)
def test_inputs_that_gain_over_the_event_volume(differences, column, held):
    names = [name for name in (*INPUTS, *IMAGES) if name != "raw"]
    found = {
        name for name in names if holds(differences[f"{name}-translated", "raw-translated", column])
    }
    assert found == held


@pytest.mark.parametrize(
    "row, against, n_held", [("line", "raw", 17), ("line-translated", "raw-translated", 6)]
)
def test_line_gains_wherever_its_difference_holds(differences, row, against, n_held):
    of_pair = [d for key, d in differences.items() if key[:2] == (row, against)]
    held = [d for d in of_pair if holds(d)]
    assert (len(of_pair), len(held)) == (22, n_held)
    assert all(d["mean"] > 0 for d in held)


def test_line_with_translations_gains_on_bright_digits_only(differences):
    held = [
        d
        for (row, against, _), d in differences.items()
        if (row, against) == ("line-translated", "raw-translated") and holds(d)
    ]
    assert all(d["column"].endswith(" bright") for d in held)
    means = [d["mean"] for d in held]
    assert (round(min(means), 3), round(max(means), 3)) == (0.136, 0.174)


def test_resynthesis_gains_in_all_columns_but_one(differences):
    of_motions = {key[2]: d for key, d in differences.items() if key[1] == "raw-8000"}
    assert len(of_motions) == 32
    not_gained = {column for column, d in of_motions.items() if not (d["mean"] > 0 and holds(d))}
    assert not_gained == {"all/all"}
    assert round(differences["raw-motions", "raw-8000", "1/beyond"]["mean"], 3) == 0.643
    assert round(differences["raw-motions", "raw-8000", "all/beyond"]["mean"], 3) == 0.361


def test_running_gains_on_bright_digits_with_resynthesis(differences):
    gains = {
        column.removeprefix("1/"): round(d["mean"], 3)
        for (row, _, column), d in differences.items()
        if row == "running-motions" and holds(d)
    }
    bright = {name: gains.pop(name) for name in list(gains) if name.endswith(" bright")}
    assert set(bright) == {f"{name} bright" for name in ("sim", "centre", "bell", "bell centre")}
    assert (min(bright.values()), max(bright.values())) == (0.105, 0.137)
    assert gains == {"train": 0.002, "centre": 0.009, "bell centre": 0.012}


def test_what_the_gain_of_the_thesis_rows_depends_on():
    effects = {
        (e["row"], e["effect"]): e for e in results("table")["effects"] if e["trained_on"] == "all"
    }
    polarity, start, _, distance = FACTORS
    for row, effect, mean in (
        ("thesis-tnt", polarity, 0.166),
        ("thesis-tnt", start, 0.122),
        ("thesis-tnt", distance, 0.079),
        ("thesis-regress", start, 0.1),
        ("thesis-regress", distance, 0.058),
    ):
        found = effects[row, effect]
        assert round(found["mean"], 3) == mean
        assert holds(found)
    assert not holds(effects["thesis-regress", polarity])


@pytest.mark.parametrize(
    "row, column, low, high",
    [
        ("thesis-tnt", "all/centre bright", 0.034, 0.139),
        ("thesis-tnt", "all/bell centre bright", 0.083, 0.206),
        ("thesis-regress", "all/centre bright", -0.161, 0.075),
    ],
)
def test_intervals_that_are_told_and_do_not_hold(differences, row, column, low, high):
    found = differences[row, "thesis-baseline", column]
    assert (round(found["low"], 3), round(found["high"], 3)) == (low, high)
    assert not holds(found)


@pytest.mark.parametrize(
    "row, against, column, mean, does_hold",
    [
        ("thesis-tnt", "thesis-baseline", "1/all", 0.014, False),
        ("thesis-tnt", "thesis-baseline", "all/all", -0.015, True),
        ("thesis-regress", "thesis-baseline", "1/all", 0.048, True),
        ("thesis-regress", "thesis-baseline", "1/others", 0.079, True),
        ("thesis-regress", "thesis-baseline", "all/all", -0.012, True),
        ("thesis-regress", "thesis-baseline", "all/centre bright", -0.043, False),
        ("raw-translated", "raw", "1/all", 0.093, True),
        ("line", "raw", "all/centre bright", 0.277, True),
        ("center-1000-events", "center", "all/centre bright", 0.247, True),
    ],
)
def test_differences_that_are_told(differences, row, against, column, mean, does_hold):
    found = differences[row, against, column]
    assert round(found["mean"], 3) == mean
    assert holds(found) == does_hold


def test_a_regressor_adds_nothing_to_translated_windows(differences):
    assert not holds(differences["regressor-translated", "raw-translated", "1/all"])


@pytest.mark.parametrize("name", [name for name, (_, is_dark) in SETS.items() if is_dark])
def test_tnt_loses_on_dark_digits(differences, name):
    found = differences["thesis-tnt", "thesis-baseline", f"all/{name}"]
    assert found["mean"] < 0
    assert holds(found)
