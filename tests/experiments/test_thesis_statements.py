"""Sentences of docs/thesis.md: each holds in the results."""

from __future__ import annotations

from functools import partial

from statements import numbers_said, text_of

from experiments.tables.differences import holds
from experiments.tables.parts import results
from experiments.thesis.table import recorded_networks, recorded_table

said = partial(numbers_said, page=text_of("docs/thesis.md"))

BRIGHT = ("sim bright", "centre bright", "bell bright", "bell centre bright")


def differences(row, against):
    """Column -> the recorded difference of two rows."""
    return {
        found["column"]: found
        for found in recorded_table()["differences"]
        if (found["row"], found["against"]) == (row, against)
    }


def three_digits(found):
    return [round(difference["mean"], 3) for difference in found]


def count_of(found):
    """How many differences hold, and how many there are."""
    return [sum(map(holds, found)), len(found)]


def test_differences_to_the_baseline():
    tnt = differences("thesis-tnt", "thesis-baseline")
    regress = differences("thesis-regress", "thesis-baseline")
    both = [*tnt.values(), *regress.values()]
    gains = sum(holds(found) and found["mean"] > 0 for found in both)
    n_holding, n = count_of(both)
    numbers = said("of # differences to the Baseline, # hold: gains #, losses # ([which]")
    assert numbers == [n, n_holding, gains, n_holding - gains]
    in_readme = "no gain of the transform over the Baseline holds with # seeds, and # losses do"
    (seeds,) = {found["seeds"] for found in both}
    assert numbers_said(in_readme, text_of("README.md")) == [seeds, n_holding]
    assert gains == 0
    lost = said("In all/all both transforms lose, by # and #")
    assert lost == three_digits([{"mean": -found["all/all"]["mean"]} for found in (tnt, regress)])
    assert min(lost) > 0
    numbers = said(
        "TNT # and # after training on all saccades, # and # after the first; TNT+regress # and #, "
        "# and # ([# of these # hold]"
    )
    columns = [f"{trained_on}/{test}" for trained_on in ("all", "1") for test in ("bell", "beyond")]
    found = [rows[column] for rows in (tnt, regress) for column in columns]
    assert numbers == [*three_digits(found), *count_of(found)]


def test_what_running_adds_to_resynthesis():
    found = differences("running-motions", "raw-motions")
    bright = [found[f"1/{test}"] for test in BRIGHT]
    elsewhere = [one for column, one in found.items() if column.partition("/")[2] not in BRIGHT]
    numbers = said(
        "`running` still adds # to # for bright digits after training with dark ones (# of # "
        "differences hold), and # to # elsewhere (# of # hold)"
    )
    expected = []
    for part in (bright, elsewhere):
        expected += [min(three_digits(part)), max(three_digits(part)), *count_of(part)]
    assert numbers == expected


def test_where_a_line_is_better_than_untransformed_volumes():
    numbers = said(
        "is better than untransformed volumes in # of # columns, and # of these differences hold; "
        "if training moves the windows, in # of #, the simulated ones, and # hold; with recordings "
        "it is worse then."
    )
    expected = []
    for row, against in (("line", "raw"), ("line-translated", "raw-translated")):
        found = differences(row, against)
        better = [one for one in found.values() if one["mean"] > 0]
        expected += [len(better), len(found), sum(map(holds, better))]
    assert numbers == expected
    worse = {column for column, one in found.items() if one["mean"] < 0}
    assert worse == {"1/all", "1/others", "1/train"}


def test_the_losses_of_two_values_of_t_max():
    losses = {}
    for network in recorded_networks():
        if network["row"].startswith("running") and network["seed"] == 0:
            losses[network["row"]] = round(network["validation"]["validation_loss"], 3)
    low, high = said("the loss is # for 2, 3 and 4, and # for 8 (seed 0)")
    assert {losses[row] for row in ("running", "running-t3", "running-t4")} == {low}
    assert losses["running-t8"] == high


def test_a_decision_after_one_event_and_after_many():
    numbers = said(
        "takes # µs after one new event (median) if decisions follow one another, and # µs if "
        "other networks run in between; after # new events # and # µs."
    )
    found = results("decisions")["end_to_end"]
    one, many = (
        [round(found[n][way]["us"]["ours"]["median"]) for way in ("in_blocks", "call_by_call")]
        for n in ("1", "1300")
    )
    assert numbers == [*one, 1300, *many]


def test_windows_of_networks_trained_on_images():
    share, n = said("know # of the windows of # recordings, a part of N-MNIST's official test")
    networks = results("from_pictures")["nmnist"]["networks"]
    shares = [network["window_accuracy"] for network in networks]
    assert share == round(sum(shares) / len(shares), 3)
    assert {network["recordings"] for network in networks} == {n}


def test_simulated_digits_have_as_many_on_events():
    numbers = said("# % of the simulated events are ON, and # % of the recorded ones")
    statistics = results("simulated")["constant"]["statistics"]
    shares = [statistics[name]["ON share"] for name in ("simulated", "N-MNIST")]
    assert numbers == [round(share, 1) for share in shares]


def test_recordings_of_the_table():
    numbers = said("# recordings to train on, # held out, # to test on.")
    names = ("training_recordings", "held_out_recordings", "test_recordings")
    for network in recorded_networks():
        assert numbers == [network["data"][name] for name in names]


def test_events_of_edges_along_the_motion():
    numbers = said(
        "edges within 15° of the motion give # of the events, for each unit of gradient, that "
        "edges across it give (the cosine: #), and # % of these have the expected polarity."
    )
    found = results("edges")
    shares = [found[name][-1] / found[name][0] for name in ("events_per_gradient", "cosine")]
    expected = [round(share, 2) for share in shares]
    assert numbers == [*expected, round(100 * found["polarity_as_expected"][-1])]
