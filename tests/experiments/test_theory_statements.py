"""Sentences of docs/theory.md whose numbers no table makes: each holds in the results."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest
from statements import numbers_said, text_of

from async_tnt.simulation.simulator import PixelModel
from async_tnt.training.settings import OFTEN
from experiments import figure_laws
from experiments.lessons.readings import SURE
from experiments.motions.scene import Scene
from experiments.tables.parts import results

THEORY = text_of("docs/theory.md")
said = partial(numbers_said, page=THEORY)


def test_the_theory_tells_how_many_events_a_saccade_has():
    found = results("fit_pixels")
    recordings, events = said(
        "(Saccades in # training recordings of N-MNIST have # events on average.)"
    )
    assert found["official_training_recordings"] == [1, recordings, recordings]
    assert round(found["recorded"]["events per window"]) == events


def test_the_theory_tells_which_errors_dense_layers_have():
    about_centre = results("equivariance")["errors"]["TNT, center"]
    flows = results("equivariance")["flows_px"]
    hidden, logits, near_px, far_px = said(
        "the errors of the hidden layer and of the logits are # and # for a digit that moved by # "
        "pixels, and above 1 for one that moved by #."
    )
    near, far = (flows.index(2 * px) for px in (near_px, far_px))
    assert round(about_centre["dense 1"][near], 2) == hidden
    assert round(about_centre["logits"][near], 2) == logits
    assert about_centre["dense 1"][far] > 1 and about_centre["logits"][far] > 1
    (most,) = said("With the flow of `line` removed, all errors are below #.*")
    errors = results("equivariance")["errors"]["TNT, line, flow removed"]
    assert max(max(of_layer) for of_layer in errors.values()) < most


def test_the_theory_tells_what_the_ridge_takes_from_the_flow():
    found = re.findall(r"^\| ([\d,]+) \| ([\d.]+) \| [\d.]+ \| [\d.]+ \| [\d.]+ \|$", THEORY, re.M)
    share_of_flow = {float(n.replace(",", "")): float(share) for n, share in found}
    events, percent = said("At # events the fitted flow is # % too small.")
    assert round(100 * (1 - share_of_flow[events]), 1) == percent


def test_the_theory_tells_how_many_events_the_first_quarter_has():
    (percent,) = said("Of all events it has # %.")
    windows = figure_laws.sample_windows()
    quarters = [figure_laws._quarter(window, k % 3 * 105_000) for k, window in enumerate(windows)]
    assert round(100 * (np.concatenate(quarters) == 0).mean()) == percent


def test_the_theory_tells_which_constants_the_recordings_would_change():
    deviations = results("fit_pixels")["deviations"]
    present = deviations.pop("present")
    said("no change of contrast, lens or thresholds by this factor is better.")
    for name, value in deviations.items():
        if name.startswith(("contrast", "blur_px", "threshold_")):
            assert value > present, name
    new_hz, old_hz, new_us, old_us = said(
        "Noise of # Hz is better than #, and a refractory time of # us better than #."
    )
    pixels = PixelModel()
    assert (pixels.noise_hz, pixels.refractory_us) == (old_hz, old_us)
    assert deviations[f"noise_hz {new_hz:g}"] < present
    assert deviations[f"refractory_us {new_us:g}"] < present
    said(r"The recordings hardly tell $\gamma$ and the mismatch.")
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
    (times,) = said("at the window's end it is # times that of `running`.")
    assert round(rows["line"][-1] / rows["running"][-1], 1) == times
    (px,) = said("both are the same to # px.")
    assert abs(rows["line"][0] - rows["running"][0]) == pytest.approx(px)


def test_the_theory_tells_how_sure_taught_networks_are_of_nothing():
    before, level, least, most = said(
        "without the new class # % of them end with a class that has # or more, with it # to # %",
    )
    changed, without, at_most = said(
        "The largest change is that of the digit # as the new class: # % without it, up to # % "
        "with it",
    )
    assert level == SURE
    found = results("teaching")
    names = [name for name in found if name.startswith("without")]
    digits = [found[name] for name in names]
    assert len(digits) == 10
    assert round(100 * np.mean([digit["base"]["sure_of_nothing"] for digit in digits]), 1) == before
    means = [
        [np.mean([draw["sure_of_nothing"] for draw in draws]) for draws in digit["taught"].values()]
        for digit in digits
    ]
    shares = np.round(100 * np.mean(means, axis=0), 1)
    assert [shares.min(), shares.max()] == [least, most]
    bases = np.array([digit["base"]["sure_of_nothing"] for digit in digits])
    digit = int(np.abs(np.array(means) - bases[:, None]).max(axis=1).argmax())
    assert names[digit] == f"without {changed:g}"
    assert round(100 * bases[digit], 1) == without
    assert round(100 * max(means[digit]), 1) == at_most


def test_the_theory_tells_the_constants_of_the_simulator():
    scene = Scene()
    pixels = PixelModel()
    assert said(
        r"Contrast #, $\gamma = #$, $\sigma = #$ px, $C_+ = #$, $C_- = #$, mismatch #, refractory "
        "time # us and noise of # Hz were fitted",
    ) == [
        scene.contrast,
        scene.gamma,
        scene.blur_px,
        pixels.threshold_on,
        pixels.threshold_off,
        pixels.mismatch,
        pixels.refractory_us,
        pixels.noise_hz,
    ]


def test_the_theory_tells_what_the_rule_of_time_bins_was_seen_on():
    counts, bins = said("one network each had # of its windows right with counts and # with bins")
    found = results("recipes")
    for name, share in (("counts", counts), ("5 bins", bins)):
        numbers = found[f"nmnist, {name}, seed 0"]
        assert round(numbers["per_window"], 3) == share
    (recordings,) = said("held-out N-MNIST: # recordings of the project's Train")
    assert numbers["windows"] == 3 * recordings
    (least,) = said("five time bins where an active pixel has at least # events")
    assert least == OFTEN
