"""Objects in windows that slide: an object keeps its id as long as it is there."""

import os

import numpy as np
import pytest
from made import events_of

from async_tnt import Model, Processor, TNTConfig

torch = pytest.importorskip("torch", reason="the model is made by torch")

SENSOR = (40, 20)
STEP_US = 20_000
"""An object moves by a pixel in this time."""

SECONDS = float(os.environ.get("ASYNC_TNT_LONG_STREAM_S", "4"))
"""How long the stream is. ASYNC_TNT_LONG_STREAM_S changes it: it was an hour once."""


def pair_finder(**window):
    """An object of class "pair" stands where two events are; one event alone is nothing."""
    config = TNTConfig(
        sensor=SENSOR, grid=SENSOR, representation="count", polarity="unsigned", **window
    )
    net = torch.nn.Conv2d(1, 2, 1)
    with torch.no_grad():
        net.weight[:, 0, 0, 0] = torch.tensor([2.0, 0.0])
        net.bias[:] = torch.tensor([0.0, 3.0])
    return Model.from_torch(net, config, ["pair"])


def back_and_forth(n, low, span):
    """Places from `low` on that move by one in each of n steps, and back after `span` steps."""
    return low + span - np.abs(np.arange(n) % (2 * span) - span)


def moving_pairs(n_steps):
    """Two objects that blink every 2 ms, and single events of noise between them."""
    rng = np.random.default_rng(0)
    t = np.arange(0, n_steps * STEP_US, 2_000)
    rows = []
    for x0, y in ((2, 3), (22, 15)):
        x = back_and_forth(n_steps, x0, 14)[t // STEP_US]
        rows.append([t, x, np.full(len(t), y), np.ones(len(t), int)])
    n_noise = len(t) // 5
    limits = (n_steps * STEP_US, SENSOR[0], 5, 2)
    noise = [rng.integers(0, limit, n_noise) for limit in limits]
    noise[2] += 7
    events = np.concatenate([np.stack(row, axis=1) for row in (*rows, noise)])
    return events_of(*events[np.argsort(events[:, 0], kind="stable")].T)


@pytest.mark.parametrize("window", [{"last_us": 10_000}, {"last_events": 12}], ids=str)
def test_ids_live_on(window):
    """Far longer than a window, as objects move and noise comes and goes."""
    events = moving_pairs(int(SECONDS * 1e6 / STEP_US))
    processor = Processor(pair_finder(**window), every_us=5_000)
    ids = {3: set(), 15: set()}
    n_found = {3: 0, 15: 0}
    n = 0
    for first in range(0, len(events), 10_000):
        for decision in processor.push(events[first : first + 10_000]):
            n += 1
            for row in ids:
                found = [thing.id for thing in decision.objects if abs(thing.y - row) < 1]
                ids[row].update(found)
                n_found[row] += len(found) > 0
    assert min(n_found.values()) > 0.99 * n > 99 * SECONDS
    assert len(ids[3]) == len(ids[15]) == 1 and ids[3] != ids[15]


@pytest.mark.parametrize("window", [{"last_us": 10_000}, {"last_events": 2}], ids=str)
def test_a_long_absence_gives_a_new_id(window):
    """A window of a number of events has no length in time: objects are remembered for 105 ms."""
    memory_us = 10_000 if "last_us" in window else 105_000
    for pause_us, is_same in ((memory_us - 2_000, True), (memory_us + 2_000, False)):
        processor = Processor(pair_finder(**window), every_events=2)
        (first,) = processor.push(([0, 1], [5, 5], [4, 4], [1, 1]))
        # events elsewhere, with which the object leaves a window of two events
        processor.push(([pause_us - 9, pause_us - 8], [30, 31], [12, 12], [1, 1]))
        (again,) = processor.push(([pause_us, pause_us + 1], [5, 5], [4, 4], [1, 1]))
        before = {thing.id for thing in first.objects}
        after = {thing.id for thing in again.objects}
        assert len(before) == 1 and (before <= after) is is_same
