"""Fair comparisons: the same moments for all, interleaved, and refused where results differ."""

from __future__ import annotations

import numpy as np
import pytest
from made import random_events, random_model

from async_tnt import CompiledClassifier, Processor, TNTConfig
from async_tnt.volume.events import structured
from experiments.speed import end_to_end
from experiments.speed import networks as network
from experiments.speed.interleaved import Timed, WorkDiffers, timed
from experiments.speed.moments import Moments, made_columns
from experiments.speed.timing import spread

WINDOW_US = 1000
SMALL = random_model(
    TNTConfig(sensor=(20, 16), grid=(20, 16), bins=3, window_us=WINDOW_US), widths=(4, 6, 8)
)
LOGITS = np.array([1.0, -20.0], np.float32)


def window(n, seed=0):
    return random_events(n, seed=seed, duration_us=WINDOW_US, sensor=(20, 16))


@pytest.mark.parametrize("n_new", [1, 3, 10])
def test_every_moment_has_so_many_new_events_after_the_first_one_of_its_window(n_new):
    moments = Moments([window(31), window(7, 1), window(2, 2)], WINDOW_US, n_new)
    assert moments.a_lap == 30 // n_new + 6 // n_new + 1 // n_new
    last = None
    for i in range(3 * moments.a_lap):
        moment = moments[i]
        assert moment.n_new == n_new and moment.start_us % WINDOW_US == 0
        assert (moment.events["t"] // WINDOW_US == moment.start_us // WINDOW_US).all()
        assert (
            np.array_equal(moment.before.events, moment.events[:-n_new])
            and moment.before.n_new == 0
        )
        if moment.follows:
            assert np.array_equal(moment.before.events, last.events)
        else:
            assert len(moment.before.events) == 1 and (
                last is None or moment.start_us > last.start_us
            )
        last = moment
    with pytest.raises(
        ValueError,
        match=f"a window of at least {n_new + 1} events is needed, the longest has {n_new}",
    ):
        Moments([window(n_new), window(1)], WINDOW_US, n_new)


class Answer:
    """Always the same."""

    def __init__(self, logits):
        self.logits = logits

    def prepare(self, moment):
        pass

    def decide(self):
        return self.logits


@pytest.mark.parametrize("mode", [True, False], ids=["call by call", "in blocks"])
def test_different_logits_stop_the_comparison(mode):
    blocks = list(Moments([window(40)], WINDOW_US, 2).blocks(3, 4))
    wrong = LOGITS + np.array([0, 3e-3], np.float32)  # 1.5e-4 of the largest
    for logits, words in (
        (wrong, r"1\.5e-04 apart at event 3 of"),
        (LOGITS * np.float32(np.nan), "nan apart"),
    ):
        with pytest.raises(WorkDiffers, match=rf"within 0\.0001, got ours and wrong {words}"):
            timed({"ours": Answer(LOGITS), "wrong": Answer(logits)}, blocks, mode)
    assert (
        timed({"ours": Answer(LOGITS), "other": Answer(None)}, blocks, mode).largest_difference == 0
    )


def test_ratios_are_paired_and_by_hand():
    us = {
        "ours": np.array([[1.0, 2.0, 9.0], [4.0, 4.0, 4.0]]),
        "other": np.array([[3.0, 2.0, 9.0], [8.0, 20.0, 12.0]]),
    }
    paired = Timed(us, call_by_call=True).report()
    of_blocks = Timed(us, call_by_call=False).report()
    assert paired["ratio"]["other"]["median"] == np.median([3, 1, 1, 2, 5, 3])
    assert of_blocks["ratio"]["other"]["median"] == np.mean([3 / 2, 12 / 4])
    assert of_blocks["us"] == paired["us"] and paired["us"]["ours"]["median"] == 4.0
    assert spread(np.array([1, 2, 3, 4, 9])) == {
        "median": 3,
        "q1": 2,
        "q3": 4,
        "min": 1,
        "max": 9,
        "n": 5,
    }


@pytest.mark.parametrize("n_new", [1, 7])
def test_ours_sees_exactly_the_new_events(n_new):
    moments = Moments([window(60), window(40, 1)], WINDOW_US, n_new)
    feed = network.Feed(SMALL)
    seen = []
    ours = network.Incremental(SMALL, feed)
    whole = network.Dense(CompiledClassifier(SMALL), feed)
    stream = end_to_end.Stream(SMALL)
    push = Processor.push
    for block in moments.blocks(3, moments.a_lap // 2):  # through both windows, and again
        for moment in block:
            if not moment.follows:
                for one in (ours, stream):
                    one.prepare(moment.before)
                    one.decide()
            before = feed.volume.n_events
            ours.prepare(moment)
            seen.append(feed.volume.n_events - before)
            whole.prepare(moment)  # the same feed: nothing more comes
            stream.prepare(moment)
            assert np.array_equal(ours.decide(), whole.decide())
            expected = Processor(SMALL, start_us=0)
            push(expected, moment.events)
            assert np.array_equal(stream.decide(), expected.fire().logits)
    assert len(seen) >= 15 and set(seen) == {n_new}


@pytest.mark.parametrize("settings", [{}, {"bins": 1}, {"t_max": 2.0}], ids=str)
def test_batch_processing_equals_the_reference(settings):
    """A figure beside a wrong batch computation would mean nothing."""
    torch = pytest.importorskip("torch")
    from async_tnt.checking.reference import reference_volume
    from experiments.speed.torch_batch import TorchBatch, as_tensors

    config = TNTConfig(grid=(20, 41), window_us=20_000, **settings)
    events = structured(
        made_columns(np.random.default_rng(5), config.sensor, 3000, 3 * config.window_us)
    )
    events = events[events["t"] < 20_000]
    expected = reference_volume(events, config, 0)
    with torch.inference_mode():
        found = TorchBatch(config).volume(*as_tensors(events, 0)).numpy()
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())
    with pytest.raises(
        ValueError, match="must be tnt, running and signed, got none, center, signed"
    ):
        TorchBatch(config.replace(transform="none", landmark="center"))
