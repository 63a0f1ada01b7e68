"""Sentences of docs/results.md whose numbers no table makes: each holds in the results."""

from __future__ import annotations

import re

import pytest

from experiments.tables.accuracy import share_closed
from experiments.tables.parts import results


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

    def extremes(shares):
        return [round(100 * share) for share in (min(shares), max(shares))]

    assert extremes([moments[kind]["0.9"] for kind in drawn]) == [44, 61]
    assert extremes([moments[kind]["0.99"] for kind in drawn]) == [2, 25]
    assert extremes([rows[kind]["decided"] for kind in drawn]) == [1, 10]
    assert rows["characters (tested only)"]["decided"] == 0.5


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
