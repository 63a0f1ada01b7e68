"""Sentences of docs/results.md and README.md whose numbers no table makes.

Each holds in the results.
"""

from __future__ import annotations

import re
from functools import partial
from statistics import mean, median

import numpy as np
import pytest
from statements import numbers_said, text_of

from async_tnt import CompiledClassifier, load_model
from experiments.speed.work import work_of
from experiments.tables.accuracy import share_closed
from experiments.tables.parts import results
from experiments.tables.thesis import unseen_motion

said = partial(numbers_said, page=text_of("docs/results.md"))
said_in_readme = partial(numbers_said, page=text_of("README.md"))


def test_few_events_need_a_part_of_a_full_pass_and_a_whole_window_all_of_it():
    us = results("decisions")["network"]["1300"]["in_blocks"]["us"]
    assert said(
        "After 1,300 events the network alone takes # us incrementally and # us in a full pass."
    ) == [round(us[name]["median"]) for name in ("incremental", "dense")]
    parts = results("layer_times")["models"]["digits"]
    needed = [sum(row["multiplications"] for row in parts[n]) for n in ("1", "100")]
    model = load_model("digits")
    network = CompiledClassifier(model)
    network(np.zeros(model.config.shape))
    whole = sum(step.products * n for step, n in work_of(network))
    assert said(
        "Of the # million multiplications of `digits`, one event needs # % in the mean, and a "
        "hundred need # %."
    ) == [round(whole / 1e6, 1), *(round(100 * n / whole) for n in needed)]


def test_engines_that_alternate_are_slower_and_ratios_shrink():
    one_us, most_us, *extremes = said(
        "Where networks alternate, `push` and `fire` take # us after one event and # us after "
        "1,300, and the other rows # to # and # to # times as long."
    )
    found = results("decisions")["end_to_end"]
    rows = [found[n]["call_by_call"] for n in ("1", "1300")]
    assert [round(row["us"]["ours"]["median"]) for row in rows] == [one_us, most_us]
    ratios = [[ratio["median"] for ratio in row["ratio"].values()] for row in rows]
    assert [round(end(row), 1) for row in ratios for end in (min, max)] == extremes


def test_layers_take_the_time_that_it_says():
    report = results("layer_times")
    parts = {row["part"]: row for row in report["models"]["digits"]["1"]}
    us = {part: row["us"] for part, row in parts.items()}
    assert said(
        "of # us of the network `digits` after one event (the least of four measurements), # are "
        "the call, and # the second convolution, which multiplies at"
    ) == [
        round(sum(us.values()), 1),
        round(us["call, nothing is new"], 1),
        round(us["conv2"], 1),
    ]
    all_multiplications = sum(row["multiplications"] for row in parts.values())
    a_us = [parts["conv2"]["multiplications"] / us["conv2"], all_multiplications / sum(us.values())]
    peak = report["peak"]["median"]
    assert said("at # % of this core's peak. All of it together is at # %.") == [
        round(0.1 * rate / peak) for rate in a_us
    ]
    shares = [
        0.1 * row["multiplications"] / row["us"] / peak
        for rows in report["models"]["digits-everywhere"].values()
        for row in rows
        if row["part"] in ("network.4", "network.7", "network.10", "network.13")
    ]
    assert said(
        "The four large convolutions of `digits-everywhere` are at # % of the peak or more, up "
        "to # times it:"
    ) == [int(min(shares)), round(max(shares) / 100, 1)]


def test_larger_networks_are_faster_than_their_full_pass():
    smallest, largest, *factors = said(
        "Three larger networks with random weights, of # to # million multiplications, are # to # "
        "times as fast as their full pass after one event, and # to # times after 1,300; where "
        "networks alternate, # to # and # to # times."
    )
    networks = results("incremental")["networks"]
    del networks["thesis"]
    millions = [
        network["touched"]["whole"]["multiplications"] / 1e6 for network in networks.values()
    ]
    assert [round(min(millions)), round(max(millions))] == [smallest, largest]

    def ratios(new, mode):
        rows = (network["network"][new][mode]["ratio"] for network in networks.values())
        return [row["dense"]["median"] for row in rows]

    assert len(networks) == 3
    assert factors == [
        round(end(ratios(new, mode)), 1)
        for mode in ("in_blocks", "call_by_call")
        for new in ("1", "1300")
        for end in (min, max)
    ]


def test_published_networks_are_as_exact_and_as_fast_as_it_says():
    zoo = results("zoo")
    exact = {name: row["deviation"] for name, row in zoo.items() if row.get("deviation")}
    (inexact,) = (name for name, deviation in exact.items() if deviation >= 1e-4)
    assert inexact.endswith("convmixer_768_32")
    deviation, of_torch = said(
        "in all but one: ConvMixer, by #, where torch itself deviates by # in float32."
    )
    assert round(exact[inexact], 4) == deviation
    assert round(zoo[inexact]["own_deviation"], 4) == of_torch
    least, most, least_torchvision, most_torchvision, flow, images, *small = said(
        "those of segmentation-models-pytorch gain # to #, those of torchvision # to #, EV-FlowNet "
        "#, E2VID without its state #, and four others of papers # to #."
    )
    speeds = {name: row["speed"] for name, row in zoo.items() if row.get("speed")}
    ratios = {name: speed["ratio"] for name, speed in speeds.items()}
    assert round(ratios["EvFlowNet"], 1) == flow
    assert round(ratios["e2vid_without_state"], 1) == images
    of_torchvision = [ratio for name, ratio in ratios.items() if "torchvision/segm" in name]
    assert [round(end(of_torchvision), 1) for end in (min, max)] == [
        least_torchvision,
        most_torchvision,
    ]
    unets = [ratio for name, ratio in ratios.items() if name.startswith("segmentation/")]
    assert [round(min(unets), 1), round(max(unets), 1)] == [least, most]
    of_papers = ("denoising_unet", "spike_flow_decoder", "event_depth", "ev_segnet")
    gains = [ratios[name] for name in of_papers]
    assert [round(min(gains), 1), round(max(gains))] == small
    of_libraries = [speed for name, speed in speeds.items() if "/" in name]
    assert said(
        "In # of these # networks one event needs more than half of a whole pass. Over all 81, an "
        "answer is # times as fast as a pass of ONNX Runtime in the median, and slower in # of "
        "them."
    ) == [
        sum(speed["share"] > 0.5 for speed in of_libraries),
        len(of_libraries),
        round(median(speed["ratio"] for speed in of_libraries), 1),
        sum(speed["ratio"] < 1 for speed in of_libraries),
    ]
    above, fastest, percent = said(
        "Factors above # are those of # networks in which an event needs less than # % of a pass;"
    )
    shares = [speed["share"] for speed in of_libraries if speed["ratio"] > above]
    assert len(shares) == fastest and max(shares) < percent / 100
    assert not any(row["wrong_bits"] for row in zoo.values() if not row["torch"])


def test_early_decisions_are_calibrated():
    early = results("early")
    levels = {row["level"]: row for row in early["confidence"]}
    error, *reached = said(
        "with an expected error of #: of the first decisions that reach .9, .95 and .99, #, # and "
        "# are right."
    )
    assert round(early["calibration_error"], 3) == error
    shares = [levels[level]["accuracy"] for level in (0.9, 0.95, 0.99)]
    assert [round(shares[0], 2), round(shares[1], 2), round(shares[2], 3)] == reached
    after = {row["time_us"]: row["accuracy"] for row in early["accuracy_against_time"]}
    decided, median_ms, as_after_ms = said(
        "A confidence of .99 is reached in # % of the windows, in half of these within # ms. "
        "Windows decided so are right as often as those decided after # ms, or more often."
    )
    assert round(100 * levels[0.99]["decided"]) == decided
    assert levels[0.99]["median_ms"] == median_ms
    assert levels[0.99]["window_accuracy"] >= after[1_000 * as_after_ms]
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
        "some digit reaches .9 at some moment in # to # % of the windows, and .99 in none."
    )
    assert {moment["0.99"] for moment in scattered} == {0}
    assert [
        *extremes([moment["0.9"] for moment in drawn]),
        *extremes([moment["0.99"] for moment in drawn]),
    ] == said(
        "some digit reaches .9 at some moment in # to # % of the windows and .99 in # to # %; of"
    )
    assert said("of hot pixels and patches, .9 in # and # % and .99 in # and # %.") == [
        round(100 * moments[kind][level])
        for level in ("0.9", "0.99")
        for kind in ("hot pixels", "a patch")
    ]
    assert said(
        "At their ends .9 is reached in # to # % of windows with edges, corners and discs, and in "
        "# % with hot pixels."
    ) == [
        *extremes([rows[kind]["decided"] for kind in drawn_kinds]),
        round(100 * rows["hot pixels"]["decided"]),
    ]
    others = [f"{name} (tested only)" for name in ("poker", "characters", "cars")]
    poker, n_poker, poker_99, *rest = said(
        "Some digit reaches .9 at some moment in # % of # recordings of POKER-DVS and .99 in # %, "
        "in # and # % of # of HOTS' letters, in # and # % of # of N-CARS' recordings;"
    )
    shares = [
        [round(100 * moments[kind][level]) for level in ("0.9", "0.99")] + [rows[kind]["windows"]]
        for kind in others
    ]
    assert [[poker, poker_99, n_poker], rest[:3], rest[3:]] == shares
    assert said("at the ends .9 in #, # and # %.") == [
        round(100 * rows[kind]["decided"]) for kind in others
    ]


def test_on_cars_the_transform_costs_accuracy_most_of_it_early():
    said(
        "On N-CARS the transform costs accuracy against the untransformed volume, most of it early."
    )
    cars = results("cars")
    raw, transformed = (
        {
            ms: mean(test["against_time_ms"][ms] for test in cars[f"equal_{name}"]["tests"])
            for ms in ("10", "30", "50", "100")
        }
        for name in ("volume", "running")
    )
    losses = [raw[ms] - transformed[ms] for ms in raw]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] > 0 and losses[0] > 2 * losses[1]


def test_a_guess_in_two_of_three_saccades_is_right_as_often_as_it_says():
    (right,) = said("a guess in the two others would have #.")
    guesses = unseen_motion().splitlines()[-1]
    assert float(guesses.split("|")[2]) == right


def test_edges_along_the_motion_have_events_without_a_preferred_sign():
    found = results("edges")
    per_gradient = np.array(found["events_per_gradient"])
    as_expected = np.array(found["polarity_as_expected"])
    said("Up to 60 degrees between gradient and motion, events for each unit of gradient fall like")
    assert found["angles_deg"][4] == 60
    assert per_gradient[:4] / per_gradient[0] == pytest.approx(
        np.array(found["cosine"][:4]), abs=0.02
    )
    least, most = said("and # to # % have the polarity of")
    assert [round(100 * end(as_expected[:4])) for end in (min, max)] == [least, most]
    said("have about a third of the events of edges across it, where the cosine gives an eighth;")
    assert per_gradient[-1] / per_gradient[0] == pytest.approx(1 / 3, abs=0.04)
    assert found["cosine"][-1] == pytest.approx(1 / 8, abs=0.01)
    (percent,) = said("an eighth; # % of these events have the expected polarity.")
    assert round(100 * as_expected[-1]) == percent
    said("The difference of the two polarities is about an eighth, too")
    differences = per_gradient * (2 * as_expected - 1)
    assert differences[-1] / differences[0] == pytest.approx(1 / 8, abs=0.01)


def test_resynthesis_closes_most_of_the_gap_where_events_are_few():
    closed = {
        name: share_closed(results(f"unseen_{name}")["accuracy"])["other motions"]
        for name in ("saccades", "hands")
    }
    assert said("| N-MNIST with a fifth of its events | # |") == [round(closed["saccades"], 2)]
    assert said("| hand motion (one network of each kind) | # |") == [round(closed["hands"], 2)]
    recorded, everywhere = (
        results("unseen_saccades")["accuracy"][row]["other motions"]["mean"]
        for row in ("recorded", "all directions")
    )
    counts = results("unseen_volumes")["accuracy"]["counts"]["other motions"]
    assert said("learns from counts, too, the share on N-MNIST is # (one network)") == [
        round((counts["mean"] - recorded) / (everywhere - recorded), 2)
    ]
    assert len(counts["seeds"]) == 1
    across = share_closed(results("unseen_hands")["accuracy"])["perpendicular"]
    assert said("across the recorded direction the share is #.") == [round(across, 2)]
    hands = {
        way: found["other motions"]["mean"]
        for way, found in results("unseen_hands")["accuracy"].items()
    }
    best, resynthesized, plain = said(
        "The best of the cheap ways there, leaving out polarity, has # in motions that were not "
        "recorded, where re-synthesis has #, and training on the recordings as they are #."
    )
    ways = ("recorded", "resynthesized", "all directions")
    assert [round(hands[way], 3) for way in ways[:2]] == [plain, resynthesized]
    cheap = {way: right for way, right in hands.items() if way not in ways}
    assert max(cheap, key=lambda way: cheap[way]) == "unsigned"
    assert round(cheap["unsigned"], 3) == best
    said("Turned and flipped recordings lose accuracy.")
    assert max(cheap["turned"], cheap["flipped"]) < hands["recorded"]
    whole = results("unseen_whole")["accuracy"]["resynthesized"]
    assert said("--motions resynthesized` reached # in 1/all and # in 1/sim (version 0.2.0).") == [
        round(whole[test]["mean"], 3) for test in ("all saccades", "simulated motions")
    ]


def test_networks_of_pictures_alone_are_as_right_as_it_says():
    rows = {
        "nmnist": "| 8,000 of N-MNIST's official test part | MNIST's images | # | # |",
        "poker": "| 68 of POKER-DVS | drawn with fonts | # | # |",
        "characters": "| 76 characters of HOTS | drawn with fonts | # | # |",
        "made": "| 180 made recordings | ten pictures of each object | # | # |",
    }
    said("Means of five networks:")
    for name, row in rows.items():
        networks = results("from_pictures")[name]["networks"]
        assert len(networks) == 5
        assert said(row) == [
            round(float(np.mean([network[key] for network in networks])), 3)
            for key in ("accuracy", "window_accuracy")
        ], name


def test_teaching_is_no_worse_than_training_that_costs_minutes():
    report = results("teaching")
    again = report["again 4 10"]
    further = [report["fine 4 10"], report["fine 6 10"]]
    minutes = [one["seconds"] / 60 for one in (again, *further)]
    said("need all old recordings and one to six minutes; they were run for one and two digits.")
    assert min(minutes) > 1 and round(max(minutes)) == 6
    taught = {digit: report[f"without {digit}"]["taught"]["10"][0] for digit in "46"}
    said("By windows they lose less of the old classes, know the new one less often,")
    for one in (again, *further):
        assert one["old"] > taught[one["digit"]]["old"]
        assert one["new"] < taught[one["digit"]]["new"]
    of_again, of_further, of_taught = said(
        "By recordings their means are lower, # and #, where teaching has #."
    )
    assert round(again["mean_recordings"], 3) == of_again
    assert round(np.mean([one["mean_recordings"] for one in further]), 3) == of_further
    means = [taught[digit]["mean_recordings"] for digit in "46"]
    assert round(means[0], 3) == round(np.mean(means), 3) == of_taught


def test_on_small_sets_teaching_loses_more():
    report = results("teaching")

    def mean_of(prefix, way, key):
        entries = [entry for name, entry in report.items() if name.startswith(prefix)]
        if way == "again":
            return round(np.mean([entry["again"][key] for entry in entries]), 3)
        return round(np.mean([[d[key] for d in entry["taught"][way]] for entry in entries]), 3)

    old, old_again, new = said(
        "each suit taught from ten recordings: # of the windows of the old classes are right, "
        "after training again #; of the new class # in both."
    )
    ways = ("10", "again")
    assert [mean_of("poker", way, "old") for way in ways] == [old, old_again]
    assert {mean_of("poker", way, "new") for way in ways} == {new}
    numbers = said("taught from one recording: # and #, of the new class # and #.")
    ways = ("1", "again")
    found = [mean_of("characters", way, key) for key in ("old", "new") for way in ways]
    assert numbers == found
    assert sum(name.startswith("characters") for name in report) == 6


def test_objects_on_a_large_sensor_are_found():
    (bundled,) = results("everywhere")["models"]
    rows = {
        ("three", "end"): "| three digits on 128x96 pixels, at the window's end | # |",
        ("three", "early"): "| the same, 30 ms after the last digit begins | # |",
        ("eight", "end"): "| eight digits on 640x480 | # |",
        ("close", "end"): "| digits may overlap by a third | # |",
        ("overlapping", "end"): "| each digit is 16 to 24 pixels from another one | # |",
    }
    for (kind, moment), row in rows.items():
        assert said(row) == [round(bundled[kind][moment], 3)], row
    said("| noise alone | finds nothing |")
    assert bundled["noise"] == 0

    (boxes,) = results("box_scenes")["models"]
    three = boxes["three"]
    assert said(
        "has an F1 of # in the first scenes, too (# after 30 ms), and by COCO's rules an mAP of # "
        "and an mAP .5 of # (one seed"
    ) == [round(three[name], 3) for name in ("end", "early", "map", "map_50")]


def test_objects_of_many_sizes_are_found_as_it_says():
    final = results("object_scales")["models"]
    mistakes = [model["scores"]["240x180"]["mistakes"] for model in final]
    shares = {
        name: np.sum([one[name] for one in mistakes], 0)
        / np.sum([one["objects"] for one in mistakes], 0)
        for name in ("found", "right")
    }
    assert [
        round(float(shares[name][size]), 2) for size in (0, -1) for name in ("found", "right")
    ] == said(
        "of those below 21 pixels on 240x180, # have a box and # have one of their kind, of the "
        "largest # and #"
    )
    said("of these times, boxes are best after 30 ms, the largest ones after 10 ms.")
    for sensor, largest in (("240x180", "map_medium"), ("640x480", "map_large")):
        for name, best in (("map", "30"), ("map_50", "30"), (largest, "10")):
            means = {
                ms: np.mean([model["scores"][sensor][ms][name] for model in final])
                for ms in ("10", "30", "50", "100")
            }
            assert max(means, key=means.__getitem__) == best

    def scores(name, sensor="240x180"):
        models = results(name)["models"]
        of_models = [model["scores"][sensor]["100"] for model in models]
        return [
            round(float(np.mean([one[key] for one in of_models])), 3) for key in ("map_50", "map")
        ]

    numbers = said(
        "where boxes weigh as much as classes, # and # (one network); with the default weight of "
        ".3, # and # (five); with a tenth, # and # (two)."
    )
    weights = ("object_scales_equal_weights", "object_scales_tuning", "object_scales_a_tenth")
    assert numbers == [number for name in weights for number in scores(name)]
    assert said("On 640x480 light boxes lose in mAP .5, too: a tenth has #, .3 has #.") == [
        scores(name, "640x480")[0] for name in ("object_scales_a_tenth", "object_scales_tuning")
    ]
    two_levels = said("Maps of two sizes, whose boxes weigh as much as classes, have # and # (five")
    assert two_levels == scores("object_scales_two_levels")
    assert said("whose sizes weigh a tenth, `map`, has # and # (one)") == scores(
        "object_scales_map"
    )
    sensors = results("box_cost_scales")["sensors"]
    *us, found, found_on_large = said(
        "A decision with boxes after one event takes # us at 240x180 and # us on 640x480, as long "
        "as one with points. The scenes of this measurement show digits, in which the network "
        "finds # and # objects."
    )
    assert us == [round(sensor["us"]["boxes"]["median"]) for sensor in sensors.values()]
    assert [found, found_on_large] == [round(sensor["objects"], 1) for sensor in sensors.values()]


def test_a_map_is_updated_in_time():
    found = results("map_times")["models"]["digits-everywhere"]
    us = {case: times["median"] for case, times in found["times_us"]["640x480"].items()}
    one_us, thousand_ms, whole_ms, our_whole_ms = said(
        "the objects are known # us after one event and # ms after 1,000 events; ONNX "
        "Runtime takes # ms for the whole map, and our whole pass # ms."
    )
    assert round(us["dense"] / 1e3) == our_whole_ms
    assert round(us["one event"]) == one_us
    assert round(us["1,000 events"] / 1e3, 1) == thousand_ms
    assert round(us["onnxruntime_run"] / 1e3) == whole_ms
    (share,) = said("1,000 decisions a second take # of a core (one run")
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
    sequences = report["settings"]["sequences"]
    ways = {name: test["ways"] for name, test in report["tests"].items()}
    better = {name: rows["plane fits, pooled"]["better"] for name, rows in ways.items()}
    assert [better["as trained"], sequences] == said(
        "In scenes as trained, the network with overlapping windows is better than pooled plane "
        "fits in # of # sequences."
    )
    assert [sequences - better["others"], sequences] == said(
        "which it was not trained on, pooled plane fits are better in # of #."
    )
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
    part, cold_part = said(
        "the flow after an event takes 1/# of ONNX Runtime's whole pass, and 1/# right after whole "
        "passes, when caches are cold."
    )
    assert round(times["ratio"]["whole pass, onnxruntime"]) == part
    assert round(whole_us / us["one event, right after whole passes"]) == cold_part
    said("its first event takes longer than a whole pass of ONNX Runtime or of ours.")
    assert us["first event of a new window"] > max(whole_us, us["whole pass, async_tnt"])
    said(
        "50 events that come at once, all over the sensor, cost about half a whole pass of ONNX "
        "Runtime."
    )
    assert us["50 events at once"] / whole_us == pytest.approx(0.5, abs=0.05)


def test_a_spiking_network_is_that_of_simulators_and_costs_less():
    report = results("spiking")
    accuracy = report["accuracy"]
    said("It is right for 985 of 1,000 recordings of the official test.")
    assert (accuracy["right"], accuracy["recordings"]) == (985, 1_000)
    said("On 100 recordings it has the spikes and membranes that sinabs computes in float64,")
    said("the small networks have the spikes of Norse and snnTorch, and membranes within 1e-13.")
    bins = report["bins"]["accuracy"]
    least, most, widest, with_floor, best = said(
        "sinabs without a floor of the membranes is right for # to # in bins of .1 to 30 ms and "
        "for # in bins of 100 ms; as `sinabs.from_nir` makes the network, with membranes of at "
        "least -1, for # with one event in each time step and for up to # in bins."
    )
    narrow = [row["right"] for ms, row in bins["no floor"].items() if ms not in ("event", "100")]
    assert [min(narrow), max(narrow)] == [least, most]
    assert bins["no floor"]["100"]["right"] == widest
    assert bins["floor"]["event"]["right"] == with_floor
    assert max(row["right"] for row in bins["floor"].values()) == best
    for row in report["agreement"]["rows"].values():
        assert row["deviations"] == row["deviations_near"] == 0
        assert row["largest_difference"] < 1e-13
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


def test_spiking_networks_of_relus_are_as_right_with_enough_spikes():
    rows = results("spiking")["conversion"]["rows"]
    said("With 16 and with 32 the spiking network is right at least as often as the network that")
    said("of recordings, the differences are one and four of 1,000.")
    relus = rows["ReLUs"]
    for name, more in (("16 spikes", 1), ("32 spikes", 4)):
        assert rows[name]["windows_right"] >= relus["windows_right"]
        assert rows[name]["recordings_right"] - relus["recordings_right"] == more


def test_windows_that_slide_cost_little():
    report = results("sliding")
    said("To add an event takes less than twice the time that it takes in a window that grows,")
    ratios = [
        ratio["median"]
        for numbers in report["events"].values()
        for name, ratio in numbers["ratio"].items()
        if not name.startswith("growing")
    ]
    assert len(ratios) == 9 and max(ratios) < 2
    assert report["decisions"]["ratio"] < 1.3


def test_readme_says_what_events_and_flow_take():
    times = results("bench")["volume"][0]["ns_per_event"]
    ways = ("packet_1300_columns", "packet_10_columns", "single")
    whole, ten, one = (times[way]["median"] for way in ways)
    assert said_in_readme(
        "On 34x34 pixels, adding an event to the volume takes # ns in a packet of 1,300 "
        "events, # ns in a packet of 10, and # ns alone."
    ) == [round(whole, 1), round(ten), round(one)]
    flow = results("flow")
    us = {name: row["median"] for name, row in flow["times"]["us"].items()}
    assert said_in_readme(
        "the flow is known # µs after an event, or # µs right after whole passes, where a whole "
        "pass of ONNX Runtime takes # ms. The first event of a new window, every # ms, takes # ms."
    ) == [
        round(us["one event"]),
        round(us["one event, right after whole passes"]),
        round(us["whole pass, onnxruntime"] / 1e3),
        flow["settings"]["hop_us"] / 1e3,
        round(us["first event of a new window"] / 1e3),
    ]
    better = flow["tests"]["others"]["ways"]["plane fits, pooled"]["better"]
    sequences = flow["settings"]["sequences"]
    assert said_in_readme(
        "in # of # sequences of other kinds than in training, plane fits are better"
    ) == [sequences - better, sequences]


def test_readme_says_how_many_objects_are_found():
    models = results("object_scales")["models"]
    assert len(models) == 5
    f1 = {
        sensor: mean(model["scores"][sensor]["100"]["f1"] for model in models)
        for sensor in ("240x180", "640x480")
    }
    assert said_in_readme(
        "have a mean F1 of # on 240x180 pixels and # on 640x480 after 100 ms"
    ) == [round(share, 2) for share in f1.values()]


def test_readme_says_that_digits_takes_letters_for_digits():
    said_in_readme("but sure of half of HOTS' letters.")
    rows = results("nothing")["rows"]
    assert rows["characters (tested only)"]["decided"] == 0.5
    shown = ("noise", "noise of one polarity", "hot pixels", "a patch", "a straight edge")
    assert max(rows[kind]["decided"] for kind in shown) < 0.05
