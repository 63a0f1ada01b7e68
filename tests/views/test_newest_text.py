"""The text beside the pictures: a class and the bars of all, plain text as Markdown."""

import numpy as np
import pytest

from async_tnt import Decision
from async_tnt.views.rerun_pictures import BAR_LENGTH, MOST_BARS, bars, newest_text, plain


def decision_of(probabilities, classes, events=1_234):
    p = np.asarray(probabilities)
    k = int(p.argmax())
    return Decision(classes[k], k, p, np.log(p), 5_000, 84_900, events, False, "fire")


def test_the_class_is_the_heading():
    text = newest_text(decision_of([0.25, 0.75], ["cat", "mouse"]), ["cat", "mouse"])
    assert text.splitlines()[:3] == ["# mouse", "", "with probability 0.750, from 1,234 events in 79.9 ms"]
    assert text.splitlines()[4:] == ["```", "cat   ███▌           0.250", "mouse ██████████▌    0.750", "```"]


def test_an_empty_window_has_no_class():
    text = newest_text(decision_of([0.25, 0.75], ["cat", "mouse"], events=0), ["cat", "mouse"])
    assert "mouse" not in text and text.startswith("# no event")


def test_bars_are_as_long_as_the_probabilities():
    probabilities = np.linspace(0, 1, 9)
    lines = bars(probabilities, [str(k) for k in range(9)]).splitlines()
    lengths = [8 * line.count("█") + " ▏▎▍▌▋▊▉".index(line[2:].replace("█", "")[0]) for line in lines]
    assert lengths == [round(p * BAR_LENGTH * 8) for p in probabilities]
    assert len({line.index(".") for line in lines}) == 1


def test_of_many_classes_the_likeliest_come_first():
    probabilities = np.arange(30) / 435
    lines = bars(probabilities, [f"class {k}" for k in range(30)]).splitlines()
    assert [int(line.split()[1]) for line in lines] == list(range(29, 29 - MOST_BARS, -1))


def test_long_names_are_cut_and_cannot_end_the_block():
    line, other = bars(np.array([0.5, 0.5]), ["x" * 40, "a\n```b"]).splitlines()
    assert line.startswith("x" * 15 + "… ") and other.startswith("a '''b ")


@pytest.mark.parametrize("text, shown", [("*a*_b", r"\*a\*\_b"), ("a\n# b", r"a \# b"), ("thumbs up", "thumbs up")])
def test_names_are_plain(text, shown):
    assert plain(text) == shown
