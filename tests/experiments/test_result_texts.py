"""Sentences in the texts of RESULTS.md: their numbers are those of the results."""

from __future__ import annotations

import pytest
from statements import numbers_said

from async_tnt import load_model
from experiments.objects.scenes import SIZES
from experiments.tables import decisions, scales, sections, streams, texts
from experiments.tables.parts import results
from experiments.thesis.table import recorded_networks


def caption_of(table) -> str:
    """What RESULTS.md says above a table."""
    (caption,) = (part.tables[table] for part in sections.SECTIONS if table in part.tables)
    return caption


def test_texts_on_time_say_how_often_was_measured():
    (block,) = numbers_said("*In blocks*: # decisions in a row", texts.DECISIONS)
    assert block == results("decisions")["settings"]["decisions_a_block"]
    (block,) = numbers_said("with # decisions in a block", texts.NETWORKS)
    assert block == results("incremental")["settings"]["decisions_a_block"]
    numbers_said("Each time is the least of four", texts.LAYER_TIMES)
    (moments,) = numbers_said("means over # moments", texts.LAYER_TIMES)
    settings = results("layer_times")["settings"]
    assert settings["laps"] == 4
    assert moments == settings["blocks"] * settings["decisions_a_block"]
    assert caption_of(decisions.starts) == "Seconds, medians of five"
    assert results("starts")["rounds"] == 5


def test_texts_on_data_say_how_many_recordings_there_are():
    cars = results("cars")["tuned"]["tests"]
    assert numbers_said("and # to test on.", texts.CARS) == [cars[0]["recordings"]]
    tested = numbers_said(
        "and # to test on, not the official split. POKER-DVS", texts.WITHOUT_OPTIONS
    )
    sets = {name: entry["networks"][0]["recordings"] for name, entry in results("bare").items()}
    assert tested == [sets["nmnist"]]
    assert numbers_said("POKER-DVS: 48 and #.", texts.WITHOUT_OPTIONS) == [sets["poker"]]
    assert numbers_said("characters: 36 and #.", texts.WITHOUT_OPTIONS) == [sets["characters"]]
    assert numbers_said("The # test recordings", texts.EARLY) == [results("early")["recordings"]]
    assert numbers_said("The recordings 1 to # of", texts.EDGES) == [results("edges")["recordings"]]
    pictures = results("from_pictures")["nmnist"]
    numbers = numbers_said(
        "MNIST's # training images; read are all # official", texts.FROM_PICTURES
    )
    assert numbers == [pictures["pictures"]["pictures"], pictures["networks"][0]["recordings"]]
    (n,) = numbers_said("with MNIST's # training images and without", texts.FEW_PICTURES)
    assert n == results("few_recordings")["pictures"]
    (n,) = numbers_said("N-CARS: tested on # recordings", texts.SLIDING_TRAINING)
    sliding = results("sliding_training")
    assert n == sliding["cars"]["networks"][0]["trained fixed, streamed fixed"]["recordings"]
    (n,) = numbers_said("tested on the # of the project's Test", texts.SLIDING_TRAINING)
    assert n == sliding["nmnist"]["networks"][0]["trained fixed, streamed fixed"]["recordings"]
    lengths = numbers_said("windows of # ms. N-CARS", texts.SLIDING_TRAINING)
    lengths += numbers_said("as long as a window of # ms", texts.SLIDING_TRAINING)
    assert lengths == [sliding[name]["window_ms"] for name in ("nmnist", "cars")]


def test_where_it_says_one_network_there_is_one():
    assert {part["seed"] for part in results("recipes").values()} == {0}
    ways = results("few_recordings")["ways"].values()
    assert {len(row["networks"]) for rows in ways for row in rows} == {1}


def test_the_text_on_digits_is_that_of_its_record():
    record = load_model("digits").record
    data = record["data"]
    numbers = numbers_said("Data: # real and # simulated", texts.RECIPE)
    assert numbers == [data["real_recordings"], data["simulated_recordings"]]
    assert numbers_said("; # real ones were held out", texts.RECIPE) == [
        data["held_out_recordings"]
    ]
    shape = numbers_said("t_max #, nine bins of # ms on # x # pixels", texts.RECIPE)
    config = load_model("digits").config
    assert shape == [config.t_max, config.window_us / 1e3, *config.sensor]
    assert config.bins == 9
    (weights,) = numbers_said("64 hidden units, # weights", texts.RECIPE)
    assert weights == sum(array.size for array in load_model("digits").weights.values())
    tested = [k for k, run in enumerate(record["tried_with_motions"]) if "--test" in run["command"]]
    numbers_said(
        "0, 7, 8, 9, 11 and one training that is not in the table have read the test", texts.RECIPE
    )
    assert set(tested) <= {0, 7, 8, 9, 11}


def test_the_text_on_the_thesis_is_that_of_its_networks():
    networks = recorded_networks()
    numbers = numbers_said("(# to train on, # held out, # to test on)", texts.THESIS)
    names = ("training_recordings", "held_out_recordings", "test_recordings")
    for network in networks:
        assert [network["data"][name] for name in names] == numbers
    losses = {}
    for network in networks:
        if network["row"] in ("running", "running-t3", "running-t4", "running-t8"):
            loss = network["validation"]["validation_loss"]
            losses.setdefault(network["config"]["t_max"], []).append(loss)
    means = {t_max: sum(values) / len(values) for t_max, values in losses.items()}
    numbers_said("2, 3 and 4 have nearly the same loss, and 8 has a larger one", texts.THESIS)
    near = [means[t_max] for t_max in (2, 3, 4)]
    assert max(near) - min(near) < 0.1 * (means[8] - max(near))


def test_texts_on_unseen_motions_are_those_of_their_runs():
    saccades = results("unseen_saccades")["recordings"]
    numbers = numbers_said("Saccades: # recordings of", texts.FEW) + numbers_said(
        "; the # of Test show", texts.FEW
    )
    assert numbers == [saccades["training"], saccades["test, each"]]
    hands = results("unseen_hands")["recordings"]
    numbers = numbers_said("eight dark objects, # recordings that move", texts.FEW)
    numbers += numbers_said("; # in each test; 25 epochs", texts.FEW)
    assert numbers == [hands["training"], hands["test, each"]]
    rows = results("found_paths")["rows"]
    session = rows["hand motion, session 1"]
    numbers_said(
        "fewer paths are found than in session 1, and fewer of these are right", texts.PATHS
    )
    for name in ("turning by 16°", "growing by 25 %"):
        row = rows[f"hand motion, {name}"]
        assert row["found"] < session["found"] and row["right"] < session["right"]


def test_texts_on_objects_are_those_of_their_runs():
    (n,) = numbers_said("nothing was found in # windows", texts.EVERYWHERE)
    assert n == results("everywhere")["scenes"]
    trained = load_model("digits-everywhere").record
    command = " ".join(texts.EVERYWHERE.split()).replace("train FOLDER ", "train ")
    for word in trained["command"].removeprefix("async-tnt train").split():
        assert word in command
    assert numbers_said("and # of MNIST's training images", texts.EVERYWHERE) == [
        trained["data"]["pictures"]["pictures"]
    ]
    final = results("object_scales")
    assert numbers_said("It learns from # PNG pictures", texts.OBJECT_SCALES) == [final["pictures"]]
    assert numbers_said("(seed #) was scored once by each of five", texts.OBJECT_SCALES) == [
        final["scenes_seed"]
    ]
    assert len(final["models"]) == 5
    low, high = numbers_said("longer sides of 1/# to 1/# of", texts.OBJECT_SCALES)
    assert (1 / low, 1 / high) == SIZES
    mistakes = [model["scores"]["240x180"]["mistakes"] for model in final["models"]]
    assert "the six pairs" in caption_of(scales.object_mistaken)
    assert {len(one["mistaken"]) for one in mistakes} == {6}


def test_texts_on_flow_and_spikes_are_those_of_their_runs():
    flow = results("flow")["settings"]
    assert numbers_said("windows of # ms in eight bins", texts.FLOW) == [flow["window_us"] / 1e3]
    numbers = numbers_said("A sequence has #x# pixels and # ms. At # of its events", texts.FLOW)
    assert numbers == [*flow["sensor"], flow["duration_us"] / 1e3, flow["compared"]]
    assert numbers_said("a window opens every # ms", texts.FLOW) == [flow["hop_us"] / 1e3]
    assert numbers_said("by the error on # other sequences", texts.FLOW) == [flow["validation"]]
    us = {name: row["median"] for name, row in results("flow")["times"]["us"].items()}
    numbers_said(
        "its first event costs more than a whole pass of async_tnt or onnxruntime", texts.FLOW
    )
    whole = max(us[f"whole pass, {name}"] for name in ("async_tnt", "onnxruntime"))
    assert us["first event of a new window"] > whole
    (n,) = numbers_said("The recordings are # of the 10,000", texts.SPIKING)
    assert n == results("spiking")["accuracy"]["recordings"]
    (n,) = numbers_said("measured in the windows of # recordings", texts.SPIKING)
    assert 3 * n == results("spiking")["conversion"]["calibration_windows"]


def test_the_text_on_windows_that_slide_counts_decisions_and_their_work():
    decisions_made = results("sliding")["decisions"]
    n = {name: us["n"] for name, us in decisions_made["us"].items()}
    each, replayed = numbers_said(
        "# decisions of each kind by turns, of `window_events` #.", texts.SLIDING
    )
    assert n.pop("window_events, replayed") == replayed
    assert set(n.values()) == {each}
    numbers_said(
        "a third more multiplications than two new events of a growing window", texts.SLIDING
    )
    work = decisions_made["multiplications"]
    assert work["last events"] / work["growing, 2 new events"] == pytest.approx(4 / 3, abs=0.03)


def test_the_text_on_udp_is_that_of_its_run():
    load = results("network")["load"]
    events, n_bytes = numbers_said("datagrams of # events, # bytes", texts.UDP)
    assert events == load["datagram_events"]
    assert n_bytes == load["sent"]["bytes"] / load["sent"]["datagrams"]
    caption = caption_of(streams.udp_load)
    assert caption.startswith("A million events a second for a minute")
    assert load["rate_wanted"] == 1e6 and round(load["sent"]["seconds"]) == 60
