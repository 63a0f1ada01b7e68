"""Taking turns: who decides when, what is compared, and what a ratio is."""

from __future__ import annotations

import numpy as np
import pytest
from made import random_events

from async_tnt.checking.interleaved import Timed, WorkDiffers, call_by_call, check_logits, in_blocks
from async_tnt.checking.moments import Moments

LOGITS = np.array([1.0, -20.0], np.float32)


def blocks(n_blocks: int = 3, size: int = 4):
    return list(Moments([random_events(40, duration_us=1000)], 1000, 2).blocks(n_blocks, size))


class Scribe:
    """Writes down what it is asked."""

    def __init__(self, name: str, log: list, logits: np.ndarray | None = LOGITS) -> None:
        self.name, self.log, self.logits = name, log, logits

    def prepare(self, moment) -> None:
        self.log.append((self.name, len(moment.events), moment.n_new))

    def decide(self):
        self.log.append((self.name, "decides"))
        return self.logits


@pytest.mark.parametrize("turns", [call_by_call, in_blocks])
def test_everyone_decides_at_every_moment_and_at_the_one_before_a_block(turns):
    log: list = []
    timed = turns({name: Scribe(name, log) for name in "abc"}, blocks(2, 3))
    for name in "abc":
        own = [entry[1:] for entry in log if entry[0] == name]
        assert own == [
            (n, new) if what == "prepare" else ("decides",)
            for n, new in ((1, 0), (3, 2), (5, 2), (7, 2), (19, 0), (21, 2), (23, 2), (25, 2))
            for what in ("prepare", "decides")
        ]
        assert timed.us[name].shape == (2, 3) and (timed.us[name] > 0).all()


def order_of(log: list) -> list[str]:
    return [name for name, *what in log if what == ["decides"]]


def test_call_by_call_nobody_always_follows_the_same_one():
    log: list = []
    call_by_call({name: Scribe(name, log) for name in "abc"}, blocks(5, 8))
    decided = order_of(log)
    rounds = [decided[k : k + 3] for k in range(0, len(decided), 3)]
    assert all(sorted(r) == ["a", "b", "c"] for r in rounds)
    assert len({tuple(r) for r in rounds}) == 6


def test_in_blocks_one_decides_all_of_a_block_and_the_order_turns():
    log: list = []
    in_blocks({name: Scribe(name, log) for name in "ab"}, blocks(3, 2))
    assert "".join(order_of(log)) == "aaabbb" + "bbbaaa" + "aaabbb"


@pytest.mark.parametrize("turns", [call_by_call, in_blocks])
def test_other_logits_stop_the_comparison(turns):
    other = LOGITS + np.array([0, 3e-3], np.float32)  # 1.5e-4 of the largest
    backends = {"ours": Scribe("ours", []), "wrong": Scribe("wrong", [], other)}
    with pytest.raises(WorkDiffers, match=r"within 0\.0001, got ours and wrong 1\.5e-04 apart at event 3 of"):
        turns(backends, blocks())
    backends["wrong"].logits = np.array([np.nan, 0], np.float32)
    with pytest.raises(WorkDiffers, match="got ours and wrong nan apart"):
        turns(backends, blocks())
    backends["wrong"].logits = None  # one that cannot be compared is timed
    assert turns(backends, blocks()).largest_difference == 0


def test_differences_are_in_parts_of_the_largest_logit_where_that_is_above_one():
    moment = blocks()[0][0]
    small = np.array([0.5, 0.25], np.float32)
    assert check_logits({"a": small, "b": small + np.float32(5e-5)}, moment) == pytest.approx(5e-5, rel=1e-2)
    assert check_logits({"a": LOGITS, "b": LOGITS + np.float32(1e-3)}, moment) == pytest.approx(5e-5, rel=1e-2)
    assert check_logits({"a": LOGITS}, moment) == 0


def test_ratios_are_paired_and_by_hand():
    us = {"ours": np.array([[1.0, 2.0, 9.0], [4.0, 4.0, 4.0]]), "other": np.array([[3.0, 2.0, 9.0], [8.0, 20.0, 12.0]])}
    paired = Timed(us, call_by_call=True).report()
    assert paired["ratio"]["other"]["median"] == np.median([3, 1, 1, 2, 5, 3])
    ours = paired["us"]["ours"]
    assert (ours["median"], ours["max"], ours["n"]) == (4.0, 9.0, 6) and 4 < ours["p99"] <= 9
    of_blocks = Timed(us, call_by_call=False).report()
    assert of_blocks["ratio"]["other"]["median"] == np.mean([3 / 2, 12 / 4])
    assert of_blocks["us"] == paired["us"] and set(of_blocks["ratio"]) == {"other"}
