"""Sentences of docs/results.md and docs/theory.md whose numbers no table makes.

Each holds in the results. The numbers are read from the page, so that a changed sentence is noticed
as a changed result is.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from async_tnt.simulation.simulator import PixelModel
from experiments.lessons.readings import SURE
from experiments.records.run import ROOT
from experiments.tables.accuracy import share_closed
from experiments.tables.parts import results


def text_of(page: str) -> str:
    """A page, with one space where it has spaces or new lines."""
    return " ".join((ROOT / Path(page)).read_text(encoding="utf-8").split())


PAGE = text_of("docs/results.md")
THEORY = text_of("docs/theory.md")


def said(sentence: str, page: str = PAGE) -> list[float]:
    """The numbers that the page says where `sentence` has #."""
    pattern = re.escape(sentence).replace(r"\#", r"([\d,]*\.?\d+)")
    found = list(re.finditer(pattern, page))
    assert len(found) == 1, f"the page says this {len(found)} times: {sentence}"
    return [float(number.replace(",", "")) for number in found[0].groups()]


def test_the_whole_window_is_as_fast_as_a_full_pass_and_one_event_twice_as_fast():
    said("After 1,300 events an incremental decision costs what a full pass costs.")
    network = results("decisions")["network"]
    for mode in ("in_blocks", "call_by_call"):
        medians = {}
        for n in ("1", "1300"):
            us = network[n][mode]["us"]
            medians[n] = {name: us[name]["median"] for name in ("incremental", "dense")}
        assert medians["1300"]["incremental"] == pytest.approx(medians["1300"]["dense"], rel=0.2)
        assert medians["1"]["incremental"] < medians["1"]["dense"] / 2


def test_larger_networks_are_faster_than_their_full_pass():
    least, most = said(
        "Three larger networks, up to 18 million multiplications, are # to # times as fast as "
        "their full pass after one event, still faster after 1,300."
    )
    networks = results("incremental")["networks"]
    del networks["thesis"]

    def ratios(new):
        rows = (network["network"][new]["in_blocks"]["ratio"] for network in networks.values())
        return [row["dense"]["median"] for row in rows]

    assert len(networks) == 3
    assert [round(min(ratios("1"))), round(max(ratios("1")))] == [least, most]
    assert min(ratios("1300")) > 1


def test_early_decisions_are_calibrated():
    early = results("early")
    levels = {row["level"]: row for row in early["confidence"]}
    reached = said("of the decisions that reach .9, .95 and .99 first, #, # and # are right.")
    shares = [levels[level]["accuracy"] for level in (0.9, 0.95, 0.99)]
    assert [round(shares[0], 2), round(shares[1], 2), round(shares[2], 3)] == reached
    after = {row["time_us"]: row["accuracy"] for row in early["accuracy_against_time"]}
    median_ms, as_after_ms = said(
        "With confidence .99, half of the windows are decided within # ms, and as many windows are "
        "right as after # ms."
    )
    assert round(levels[0.99]["median_ms"]) == median_ms
    (time_us,) = (time_us for time_us in after if time_us // 1_000 == as_after_ms)
    assert levels[0.99]["window_accuracy"] >= after[time_us]
    assert said("# test recordings of [digits]") == [early["recordings"]]


def test_windows_of_nothing_are_decided_as_often_as_it_says():
    rows = results("nothing")["rows"]
    moments = {kind: row["at_some_moment"] for kind, row in rows.items() if "at_some_moment" in row}
    scattered = [moments[kind] for kind in ("noise", "noise of one polarity", "pairs")]
    drawn_kinds = [kind for kind in moments if re.search("edge|corner|disc", kind)]
    drawn = [moments[kind] for kind in drawn_kinds]
    assert len(drawn) == 3

    def extremes(shares):
        return [round(100 * share) for share in (min(shares), max(shares))]

    assert extremes([moment["0.9"] for moment in scattered]) == said(
        "some digit reaches .9 at some moment in # to # % of the windows, and never .99."
    )
    assert {moment["0.99"] for moment in scattered} == {0}
    assert [
        *extremes([moment["0.9"] for moment in drawn]),
        *extremes([moment["0.99"] for moment in drawn]),
    ] == said(
        "some digit reaches .9 at some moment in # to # % of the windows and .99 in # to # %."
    )
    assert extremes([rows[kind]["decided"] for kind in drawn_kinds]) == said(
        "At their ends .9 is reached in # to # % of these windows, and in half of those that show "
        "HOTS' characters."
    )
    assert rows["characters (tested only)"]["decided"] == 0.5


def test_resynthesis_closes_most_of_the_gap_where_events_are_few():
    closed = {
        name: share_closed(results(f"unseen_{name}")["accuracy"])["other motions"]
        for name in ("saccades", "hands")
    }
    assert said("| N-MNIST with a fifth of its events | # |") == [round(closed["saccades"], 2)]
    assert said("| hand motion | # |") == [round(closed["hands"], 2)]
    whole = results("unseen_whole")["accuracy"]["resynthesized"]
    assert said("--motions resynthesized` reaches # in 1/all and # in 1/sim.") == [
        round(whole[test]["mean"], 3) for test in ("all saccades", "simulated motions")
    ]


def test_objects_on_a_large_sensor_are_found():
    (bundled,) = results("everywhere")["models"]
    rows = {
        ("three", "end"): "| three digits on 128x96 pixels, at the window's end | # |",
        ("three", "early"): "| the same, 30 ms after the last digit begins | # |",
        ("eight", "end"): "| eight digits on 640x480 | # |",
        ("close", "end"): "| digits may overlap by a third | # |",
        ("overlapping", "end"): "| all digits overlap | # |",
    }
    for (kind, moment), row in rows.items():
        assert said(row) == [round(bundled[kind][moment], 3)], row
    said("| noise alone | finds nothing |")
    assert bundled["noise"] == 0


def test_a_map_is_updated_in_time():
    found = results("map_times")["models"]["digits-everywhere"]
    us = {case: times["median"] for case, times in found["times_us"]["640x480"].items()}
    one_us, thousand_ms, whole_ms = said(
        "the objects are known # us after one event and # ms after 1,000 events; ONNX Runtime "
        "takes # ms for the whole map."
    )
    assert round(us["one event"]) == one_us
    assert round(us["1,000 events"] / 1e3, 1) == thousand_ms
    assert round(us["onnxruntime_run"] / 1e3) == whole_ms
    (share,) = said("1,000 decisions a second take # of a core.")
    assert round(list(found["load"].values())[-1], 2) == share


def test_the_part_of_the_official_test_that_is_at_hand():
    found = results("official_at_hand")
    recordings, windows = said(
        "The bundled network, read again by this command, has # of the 8,000 and # of their "
        "windows."
    )
    assert (found["official_test_recordings"], found["of"]) == (8_000, 10_000)
    assert round(found["accuracy"], 4) == recordings
    assert round(found["window_accuracy"], 4) == windows


def test_flow_is_better_than_plane_fits_where_it_says_so_and_worse_where_it_says_so():
    report = results("flow")
    half = report["settings"]["sequences"] / 2
    said("In scenes as trained, the network with overlapping windows is better than pooled plane")
    said("In scenes of other kinds, which it was not trained on, pooled plane fits are better in")
    ways = {name: test["ways"] for name, test in report["tests"].items()}
    better = {name: rows["plane fits, pooled"]["better"] for name, rows in ways.items()}
    assert better["as trained"] > half > better["others"]
    said("With windows end to end the network is worse than pooled plane fits.")
    for rows in ways.values():
        assert rows["network"]["mean"] > rows["plane fits, pooled"]["mean"]
    said("A window that has just begun tells little.")
    youngest = report["tests"]["as trained"]["by_age_ms"]["0-5"]
    assert youngest["network"] > 0.9 * youngest["zero flow"]


def test_flow_after_an_event_takes_a_small_part_of_a_whole_pass():
    times = results("flow")["times"]
    us = {name: row["median"] for name, row in times["us"].items()}
    whole_us = us["whole pass, onnxruntime"]
    (part,) = said("On 346x260 pixels, the flow after an event takes less than 1/# of a whole pass")
    assert min(times["ratio"].values()) > part
    said("its first event takes longer than a whole pass.")
    assert us["first event of a new window"] > whole_us
    said("About a hundred events that come at once, all over the sensor, cost as much as a whole")
    assert 75 < 50 * whole_us / us["50 events at once"] < 150


def test_a_spiking_network_is_that_of_simulators_and_costs_less():
    report = results("spiking")
    accuracy = report["accuracy"]
    said("It is right for 985 of 1,000 recordings of the official test.")
    assert (accuracy["right"], accuracy["recordings"]) == (985, 1_000)
    said("it is what sinabs computes with one event in each time step, on 100 recordings.")
    for row in report["agreement"]["rows"].values():
        assert row["deviations"] == row["deviations_near"] == 0
    us = {name: one["median"] for name, one in report["cost"]["event_us"].items()}
    spiking_us, relu_us = said(
        "An event with its decision takes # µs, and # µs in the network of ReLUs with the same "
        "layers."
    )
    assert round(us["spiking, a decision after each"], 1) == spiking_us
    assert round(us["ReLUs, a decision after each"], 1) == relu_us
    (norse_us,) = said("A time step with one event takes # µs in Norse, the fastest")
    assert round(us["Norse, a time step"]) == norse_us
    assert norse_us < min(us["sinabs, a time step"], us["snnTorch, a time step"])


def test_windows_that_slide_cost_little():
    report = results("sliding")
    said("An event costs less than twice as much as in a window that grows:")
    ratios = [
        ratio["median"]
        for numbers in report["events"].values()
        for name, ratio in numbers["ratio"].items()
        if not name.startswith("growing")
    ]
    assert len(ratios) == 9 and max(ratios) < 2
    decisions = report["decisions"]
    assert decisions["ratio"] < 1.3
    said("Each of these takes no longer than one of a replayed window:")
    us_a_multiplication = {
        name: us["median"] / decisions["multiplications"][name]
        for name, us in decisions["us"].items()
    }
    replayed = us_a_multiplication["window_events, replayed"]
    assert us_a_multiplication["last events"] < replayed


def test_the_theory_tells_how_many_events_a_saccade_has():
    found = results("fit_pixels")
    recordings, events = said(
        "(Saccades in # training recordings of N-MNIST have # events on average.)", THEORY
    )
    assert found["official_training_recordings"] == [1, recordings, recordings]
    assert round(found["recorded"]["events per window"]) == events


def test_the_theory_tells_which_constants_the_recordings_would_change():
    deviations = results("fit_pixels")["deviations"]
    present = deviations.pop("present")
    said("no change of contrast, lens or thresholds by this factor is better.", THEORY)
    for name, value in deviations.items():
        if name.startswith(("contrast", "blur_px", "threshold_")):
            assert value > present, name
    new_hz, old_hz, new_us, old_us = said(
        "Noise of # Hz is better than #, and a refractory time of # us better than #.", THEORY
    )
    pixels = PixelModel()
    assert (pixels.noise_hz, pixels.refractory_us) == (old_hz, old_us)
    assert deviations[f"noise_hz {new_hz:g}"] < present
    assert deviations[f"refractory_us {new_us:g}"] < present
    said(r"The recordings hardly tell $\gamma$ and the mismatch.", THEORY)
    for name, value in deviations.items():
        if name.startswith(("gamma", "mismatch")):
            assert abs(value - present) < 0.005, name


def test_the_theory_tells_how_much_noise_a_line_has():
    rows = {}
    for landmark in ("running", "line"):
        # the only rows without signs
        row = re.findall(rf"\| `{landmark}` \|((?: [\d.]+ \|){{5}})", THEORY)
        assert len(row) == 1
        rows[landmark] = [float(cell) for cell in row[0].split(" |")[:5]]
    (times,) = said("at the window's end it is # times that of `running`.", THEORY)
    assert round(rows["line"][-1] / rows["running"][-1], 1) == times
    (px,) = said("both are the same to # px.", THEORY)
    assert abs(rows["line"][0] - rows["running"][0]) == pytest.approx(px)


def test_the_theory_tells_how_sure_taught_networks_are_of_nothing():
    before, level, least, most = said(
        "without the new class # % of them end with a class that has # or more, with it # to # %",
        THEORY,
    )
    assert level == SURE
    digits = [entry for name, entry in results("teaching").items() if name.startswith("without")]
    assert len(digits) == 10
    assert round(100 * np.mean([digit["base"]["sure_of_nothing"] for digit in digits]), 1) == before
    shares = []
    for n in digits[0]["taught"]:
        draws = [draw["sure_of_nothing"] for digit in digits for draw in digit["taught"][n]]
        shares.append(round(100 * np.mean(draws), 1))
    assert [min(shares), max(shares)] == [least, most]
