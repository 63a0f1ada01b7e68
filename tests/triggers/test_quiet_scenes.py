"""Where nothing happens there are no decisions, and time passes with events only."""

from deciding import CONFIG, at, summary

from async_tnt import LeakyIntegrator, Processor


def test_no_events_no_decisions(make):
    processor = make(every_us=1, every_events=1, confidence=0.01, activity=LeakyIntegrator(0.1, 1.0), start_us=0)
    for empty in (None, [], at([])):
        assert processor.push(empty) == []
    assert processor.finish() == [] and processor.counts.received == 0


def test_a_pause_repeats_nothing(make):
    """Of a hundred moments that pass without an event, the first decides about what is new; the others do nothing."""
    processor = make(every_us=5)
    assert summary(processor.push(at([0, 1, 900]))) == [("every_us", 0, 1, 2)]
    assert summary(processor.push(at([901, 905]))) == [("every_us", 0, 901, 4)]
    assert summary(processor.push(at([10_000]))) == [("every_us", 0, 905, 5), ("window", 0, 905, 5)]


def test_dropped_events_make_nothing_due(make):
    """Late ones are not of the window: `every_events` does not count them, `every_us` finds nothing new."""
    processor = make(every_events=2, every_us=300, start_us=1000)
    assert summary(processor.push(at([1000, 5, 6, 7]))) == []
    assert summary(processor.push(at([1001]))) == [("every_events", 1000, 1001, 2)]
    assert summary(processor.push(at([5, 6, 7, 8, 1500]))) == []
    assert summary(processor.push(at([1700]))) == [("every_us", 1000, 1500, 3), ("every_events", 1000, 1700, 4)]
    assert processor.counts.dropped_late == 7


def test_events_of_a_window_that_was_closed_early_do_not_charge():
    processor = Processor(
        CONFIG, classifier=lambda volume: [9.0, 0.0], activity=LeakyIntegrator(2.0, 1e9), confidence=0.9
    )
    assert [d.trigger for d in processor.push(at([0, 0]))] == ["confidence"]
    assert processor.push(at([1, 2, 3, 4, 1000])) == []
    assert [d.events for d in processor.push(at([1000]))] == [2]


def test_a_slow_scene_never_reaches_the_threshold(make):
    """One event in each window, years long: only the windows' ends are decided."""
    times = [10**12 * k for k in range(50)]
    decisions = make(activity=LeakyIntegrator(1.01, 100.0), every_events=2).push(at(times))
    assert summary(decisions) == [("window", t, t, 1) for t in times[:-1]]
