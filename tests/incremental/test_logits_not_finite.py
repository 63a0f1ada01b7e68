"""Weights so large that logits overflow: an error that says so, on every path, and the stream goes on."""

import numpy as np
import pytest
from deciding import key
from incremental.float32 import forward
from made import events_of, random_model

from async_tnt import CompiledClassifier, LeakyIntegrator, Model, Processor, TNTConfig, TNTVolume

FINITE = "`classifier` must return finite logits, got"
CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=1, window_us=1000, transform="none")
LOUD = 7, 7  # an event here overflows; elsewhere events hardly count
AT_EVENTS = [
    {"every_events": 1},
    {"confidence": 1.0},
    {"activity": LeakyIntegrator(0.5, 1000.0)},
    {"every_events": 1, "hop_us": 400},
    {"every_events": 1, "late": "drop"},
]


def overflowing(kind: str) -> Model:
    """A place of the image whose weights are 1e38: an event there makes infinities, or infinity minus infinity."""
    weights = {name: np.zeros_like(w) for name, w in random_model(CONFIG, classes=2, widths=(2, 2, 3)).weights.items()}
    weights["conv1.weight"][0, 0, 1, 1] = weights["conv2.weight"][0, 0, 1, 1] = 1
    weights["fc1.weight"][:2, 3] = 1e38  # of filter 0 the lower right
    weights["fc1.weight"][2, 0] = 1  # the upper left
    weights["fc2.weight"][0] = {"inf": [1e38, 0, 0], "nan": [1e38, -1e38, 0]}[kind]
    weights["fc2.weight"][1, 2] = 0.01
    weights["fc2.bias"][:] = 0.1, 0.2
    return Model(CONFIG, weights, ("a", "b"))


@pytest.mark.parametrize("kind", ["inf", "nan"])
def test_the_numbers_do_overflow(kind):
    model = overflowing(kind)
    volume, network = TNTVolume(CONFIG), CompiledClassifier(model)
    volume.open(0)
    volume.update_one(100, *LOUD, 1)
    assert not np.isfinite(network(volume.array)).all() and np.isnan(network.refresh(volume)).any() == (kind == "nan")
    volume.update_one(100, *LOUD, 0)  # and go back: nothing of it is left
    assert network.refresh(volume).tobytes() == CompiledClassifier(model)(volume.array).tobytes()
    assert np.isfinite(network.refresh(volume)).all()


def test_a_relu_keeps_nan():
    """An infinity in the first map, weighed with 0 in the second: that is nan, and stays it up to the logits."""
    weights = {name: w.copy() for name, w in overflowing("inf").weights.items()}
    weights["conv1.weight"][0, 0, 1, 1] = 3e38
    for name in ("conv2.weight", "fc1.weight", "fc2.weight"):
        weights[name][:] = 0
    model = Model(CONFIG, weights, ("a", "b"))
    for every in (None, 1):
        processor = Processor(model, every_events=every)
        assert len(processor.push(([5, 6], [7, 7], [7, 0], [1, 1]))) == (2 if every else 0)
        with pytest.raises(ValueError, match=FINITE):  # two events at one pixel: 6e38
            processor.push_one(7, *LOUD, 1)
            processor.fire()
        assert np.isnan(CompiledClassifier(model)(processor.volume())).all()
        with np.errstate(all="ignore"):
            assert np.isnan(forward(model.weights, processor.volume())).all()


def processors(kind: str, **settings) -> list[Processor]:
    """On the compiled path, and on the general one."""
    model = overflowing(kind)
    dense = CompiledClassifier(model)
    return [
        Processor(model, **settings),
        Processor(CONFIG, classifier=lambda v: dense(v), classes=["a", "b"], **settings),
    ]


def stream(n: int, loud: list[int]) -> np.ndarray:
    """Quiet events at the upper left, one each microsecond; `loud`: where one overflows, and the next cancels it."""
    k = np.arange(n)
    events = events_of(100 + k, k % 3, (k + 1) % 3, [1] * n)
    for k in loud:
        events["x"][k : k + 2], events["y"][k : k + 2] = LOUD
        events["p"][k : k + 2] = 1, 0
    return events


def one_by_one(processor: Processor, events: np.ndarray) -> tuple[list, list[int]]:
    """Decisions, and at which events there was an error instead."""
    decisions, errors = [], []
    for k, event in enumerate(events.tolist()):
        try:
            decisions += processor.push_one(*event)
        except ValueError as error:
            assert str(error).startswith(FINITE)
            errors.append(k)
    return [key(d) for d in decisions + processor.finish()], errors


@pytest.mark.parametrize("kind", ["inf", "nan"])
@pytest.mark.parametrize("settings", AT_EVENTS, ids=str)
def test_events_go_on_after_the_error(settings, kind):
    """The event is absorbed nevertheless: after the next one, which cancels it, the stream is as without both."""
    loud = [4, 9, 700, 1303]
    events = stream(1500, loud)
    compiled, general = processors(kind, **settings)
    decisions, errors = one_by_one(compiled, events)
    assert errors == loud
    assert (decisions, errors) == one_by_one(general, events)
    assert compiled.counts == general.counts and compiled.counts.received == 1500
    assert len(decisions) > 1000 or "confidence" in settings


@pytest.mark.parametrize("size", [2, 7, 1500])
@pytest.mark.parametrize("settings", AT_EVENTS[:-1], ids=str)
def test_a_packet_is_absorbed_up_to_the_error(settings, size):
    """Its later events are not: pushed again, the stream continues there."""
    loud = [4, 700, 1303]
    events = stream(1500, loud)
    alone = processors("nan", **settings)[0]
    one_by_one(alone, events[:1450])
    for processor in processors("nan", **settings):
        first, errors = 0, []
        while first < 1450:
            try:
                processor.push(events[first : min(first + size, 1450)])
                first = min(first + size, 1450)
            except ValueError as error:
                assert str(error).startswith(FINITE)
                first = processor.counts.received
                errors.append(first - 1)
                assert len(errors) <= len(loud)  # and not the same one again and again
        assert errors == loud
        processor.finish()
        assert processor.counts == alone.counts
        rest = [key(d) for d in processor.push(events[1450:])]
        again = processors("nan", **settings)[0]
        one_by_one(again, events[:1450])
        assert rest == [key(d) for d in again.push(events[1450:])]


@pytest.mark.parametrize("kind", ["inf", "nan"])
@pytest.mark.parametrize(
    "settings", [{}, {"every_us": 10}, {"every_us": 10, "confidence": 0.9}, {"hop_us": 400}], ids=str
)
def test_a_decision_that_is_due_is_tried_again(settings, kind):
    """At a window's end, or when time is up, the event that shows it is not absorbed; the next push tries again."""
    for processor in processors(kind, **settings):
        assert processor.push_one(0, 1, 1, 1) == []
        assert processor.push_one(5, *LOUD, 1) == []
        for _ in range(3):
            with pytest.raises(ValueError, match=FINITE):
                processor.push_one(1002, 1, 1, 1)
            with pytest.raises(ValueError, match=FINITE):
                processor.push(([1002, 1003], [1, 1], [1, 1], [1, 1]))
            with pytest.raises(ValueError, match=FINITE):
                processor.fire()
        assert processor.counts.received == 2
        assert processor.push_one(6, *LOUD, 0) == []  # still in time, and cancels it
        decision = processor.push_one(1002, 1, 1, 1)[0]
        assert (decision.events, decision.window_start_us, decision.time_us) == (3, 0, 6)
        assert np.isfinite(decision.logits).all()
        assert processor.counts.received == 4


@pytest.mark.parametrize("kind", ["inf", "nan"])
def test_fire_finish_and_another_classifier(kind):
    for processor in processors(kind):
        processor.push_one(5, *LOUD, 1)
        for _ in range(2):
            with pytest.raises(ValueError, match=FINITE):
                processor.fire()
            with pytest.raises(ValueError, match=FINITE):
                processor.finish()
        quiet = random_model(CONFIG, classes=2, widths=(2, 2, 2))
        processor.classifier = CompiledClassifier(quiet)
        (decision,) = processor.finish()
        volume = TNTVolume(CONFIG)
        volume.open(5)
        volume.update_one(5, *LOUD, 1)
        assert decision.logits.tobytes() == CompiledClassifier(quiet)(volume.array).tobytes()
