"""Sentences whose numbers no table makes: each holds in the results.

They stand in docs/results.md, or in the texts of RESULTS.md. The numbers are read from there, so
that a changed sentence is noticed as a changed result is.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from async_tnt import load_model
from experiments.objects.scenes import SIZES
from experiments.records.run import ROOT
from experiments.tables import decisions, scales, sections, streams, texts
from experiments.tables.accuracy import share_closed
from experiments.tables.parts import results
from experiments.thesis.table import recorded_networks

PAGE = (ROOT / Path("docs/results.md")).read_text(encoding="utf-8")
"""The page."""


def said(sentence: str, page: str = PAGE) -> list[float]:
    """The numbers that a page says where `sentence` has #."""
    pattern = re.escape(sentence).replace(r"\#", r"([\d,]*\.?\d+)")
    found = list(re.finditer(pattern, " ".join(page.split())))
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


# -- the texts of RESULTS.md -----------------------------------------------------------------------


def caption_of(table) -> str:
    """What RESULTS.md says above a table."""
    (caption,) = (part.tables[table] for part in sections.SECTIONS if table in part.tables)
    return caption


def test_texts_on_time_say_how_often_was_measured():
    (block,) = said("*In blocks*: # decisions in a row", texts.DECISIONS)
    assert block == results("decisions")["settings"]["decisions_a_block"]
    (block,) = said("with # decisions in a block", texts.NETWORKS)
    assert block == results("incremental")["settings"]["decisions_a_block"]
    said("Each time is the least of four", texts.LAYER_TIMES)
    (moments,) = said("means over # moments", texts.LAYER_TIMES)
    settings = results("layer_times")["settings"]
    assert settings["laps"] == 4
    assert moments == settings["blocks"] * settings["decisions_a_block"]
    assert caption_of(decisions.starts) == "Seconds, medians of five"
    assert results("starts")["rounds"] == 5


def test_texts_on_data_say_how_many_recordings_there_are():
    cars = results("cars")["tuned"]["tests"]
    assert said("and # to test on.", texts.CARS) == [cars[0]["recordings"]]
    tested = said("and # to test on, not the official split. POKER-DVS", texts.WITHOUT_OPTIONS)
    sets = {name: entry["networks"][0]["recordings"] for name, entry in results("bare").items()}
    assert tested == [sets["nmnist"]]
    assert said("POKER-DVS: 48 and #.", texts.WITHOUT_OPTIONS) == [sets["poker"]]
    assert said("characters: 36 and #.", texts.WITHOUT_OPTIONS) == [sets["characters"]]
    assert said("The # test recordings", texts.EARLY) == [results("early")["recordings"]]
    assert said("The recordings 1 to # of", texts.EDGES) == [results("edges")["recordings"]]
    pictures = results("from_pictures")["nmnist"]
    numbers = said("MNIST's # training images; read are all # official", texts.FROM_PICTURES)
    assert numbers == [pictures["pictures"]["pictures"], pictures["networks"][0]["recordings"]]
    (n,) = said("with MNIST's # training images and without", texts.FEW_PICTURES)
    assert n == results("few_recordings")["pictures"]
    (n,) = said("N-CARS: tested on # recordings", texts.SLIDING_TRAINING)
    sliding = results("sliding_training")
    assert n == sliding["cars"]["networks"][0]["trained fixed, streamed fixed"]["recordings"]
    (n,) = said("tested on the # of the project's Test", texts.SLIDING_TRAINING)
    assert n == sliding["nmnist"]["networks"][0]["trained fixed, streamed fixed"]["recordings"]
    lengths = said("windows of # ms. N-CARS", texts.SLIDING_TRAINING)
    lengths += said("as long as a window of # ms", texts.SLIDING_TRAINING)
    assert lengths == [sliding[name]["window_ms"] for name in ("nmnist", "cars")]


def test_where_it_says_one_network_there_is_one():
    assert {part["seed"] for part in results("recipes").values()} == {0}
    ways = results("few_recordings")["ways"].values()
    assert {len(row["networks"]) for rows in ways for row in rows} == {1}


def test_the_text_on_digits_is_that_of_its_record():
    record = load_model("digits").record
    data = record["data"]
    numbers = said("Data: # real and # simulated", texts.RECIPE)
    assert numbers == [data["real_recordings"], data["simulated_recordings"]]
    assert said("; # real ones were held out", texts.RECIPE) == [data["held_out_recordings"]]
    shape = said("t_max #, nine bins of # ms on # x # pixels", texts.RECIPE)
    config = load_model("digits").config
    assert shape == [config.t_max, config.window_us / 1e3, *config.sensor]
    assert config.bins == 9
    (weights,) = said("64 hidden units, # weights", texts.RECIPE)
    assert weights == sum(array.size for array in load_model("digits").weights.values())
    tested = [k for k, run in enumerate(record["tried_with_motions"]) if "--test" in run["command"]]
    said(
        "0, 7, 8, 9, 11 and one training that is not in the table have read the test", texts.RECIPE
    )
    assert set(tested) <= {0, 7, 8, 9, 11}


def test_the_text_on_the_thesis_is_that_of_its_networks():
    networks = recorded_networks()
    numbers = said("(# to train on, # held out, # to test on)", texts.THESIS)
    names = ("training_recordings", "held_out_recordings", "test_recordings")
    for network in networks:
        assert [network["data"][name] for name in names] == numbers
    losses = {}
    for network in networks:
        if network["row"] in ("running", "running-t3", "running-t4", "running-t8"):
            loss = network["validation"]["validation_loss"]
            losses.setdefault(network["config"]["t_max"], []).append(loss)
    means = {t_max: sum(values) / len(values) for t_max, values in losses.items()}
    said("2, 3 and 4 have nearly the same loss, and 8 has a larger one", texts.THESIS)
    near = [means[t_max] for t_max in (2, 3, 4)]
    assert max(near) - min(near) < 0.1 * (means[8] - max(near))


def test_texts_on_unseen_motions_are_those_of_their_runs():
    saccades = results("unseen_saccades")["recordings"]
    numbers = said("Saccades: # recordings of", texts.FEW) + said("; the # of Test show", texts.FEW)
    assert numbers == [saccades["training"], saccades["test, each"]]
    hands = results("unseen_hands")["recordings"]
    numbers = said("eight dark objects, # recordings that move", texts.FEW)
    numbers += said("; # in each test; 25 epochs", texts.FEW)
    assert numbers == [hands["training"], hands["test, each"]]
    rows = results("found_paths")["rows"]
    session = rows["hand motion, session 1"]
    said("fewer paths are found than in session 1, and fewer of these are right", texts.PATHS)
    for name in ("turning by 16°", "growing by 25 %"):
        row = rows[f"hand motion, {name}"]
        assert row["found"] < session["found"] and row["right"] < session["right"]


def test_texts_on_objects_are_those_of_their_runs():
    (n,) = said("nothing was found in # windows", texts.EVERYWHERE)
    assert n == results("everywhere")["scenes"]
    trained = load_model("digits-everywhere").record
    command = " ".join(texts.EVERYWHERE.split()).replace("train FOLDER ", "train ")
    for word in trained["command"].removeprefix("async-tnt train").split():
        assert word in command
    assert said("and # of MNIST's training images", texts.EVERYWHERE) == [
        trained["data"]["pictures"]["pictures"]
    ]
    final = results("object_scales")
    assert said("It learns from # PNG pictures", texts.OBJECT_SCALES) == [final["pictures"]]
    assert said("(seed #) was scored once by each of five", texts.OBJECT_SCALES) == [
        final["scenes_seed"]
    ]
    assert len(final["models"]) == 5
    low, high = said("longer sides of 1/# to 1/# of", texts.OBJECT_SCALES)
    assert (1 / low, 1 / high) == SIZES
    mistakes = [model["scores"]["240x180"]["mistakes"] for model in final["models"]]
    assert "the six pairs" in caption_of(scales.object_mistaken)
    assert {len(one["mistaken"]) for one in mistakes} == {6}


def test_texts_on_flow_and_spikes_are_those_of_their_runs():
    flow = results("flow")["settings"]
    assert said("windows of # ms in eight bins", texts.FLOW) == [flow["window_us"] / 1e3]
    numbers = said("A sequence has #x# pixels and # ms. At # of its events", texts.FLOW)
    assert numbers == [*flow["sensor"], flow["duration_us"] / 1e3, flow["compared"]]
    assert said("a window opens every # ms", texts.FLOW) == [flow["hop_us"] / 1e3]
    assert said("by the error on # other sequences", texts.FLOW) == [flow["validation"]]
    us = {name: row["median"] for name, row in results("flow")["times"]["us"].items()}
    said("its first event costs more than a whole pass of async_tnt or onnxruntime", texts.FLOW)
    whole = max(us[f"whole pass, {name}"] for name in ("async_tnt", "onnxruntime"))
    assert us["first event of a new window"] > whole
    (n,) = said("The recordings are # of the 10,000", texts.SPIKING)
    assert n == results("spiking")["accuracy"]["recordings"]
    (n,) = said("measured in the windows of # recordings", texts.SPIKING)
    assert 3 * n == results("spiking")["conversion"]["calibration_windows"]


def test_the_text_on_windows_that_slide_counts_decisions_and_their_work():
    decisions_made = results("sliding")["decisions"]
    n = {name: us["n"] for name, us in decisions_made["us"].items()}
    each, replayed = said("# decisions of each kind by turns, of `window_events` #.", texts.SLIDING)
    assert n.pop("window_events, replayed") == replayed
    assert set(n.values()) == {each}
    said("a third more multiplications than two new events of a growing window", texts.SLIDING)
    work = decisions_made["multiplications"]
    assert work["last events"] / work["growing, 2 new events"] == pytest.approx(4 / 3, abs=0.03)


def test_the_text_on_udp_is_that_of_its_run():
    load = results("network")["load"]
    events, n_bytes = said("datagrams of # events, # bytes", texts.UDP)
    assert events == load["datagram_events"]
    assert n_bytes == load["sent"]["bytes"] / load["sent"]["datagrams"]
    caption = caption_of(streams.udp_load)
    assert caption.startswith("A million events a second for a minute")
    assert load["rate_wanted"] == 1e6 and round(load["sent"]["seconds"]) == 60
