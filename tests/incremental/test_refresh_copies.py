"""Copies of volumes, classifiers and processors in mid-stream: both continue, each with different events."""

import copy
import itertools
import pickle

import pytest
from deciding import key
from incremental.cases import CASES, WINDOW_US, Case, dense_of, model_of
from made import random_events

from async_tnt import Processor, volume_state
from async_tnt.kernels import layout as L

DUPLICATES = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda one: pickle.loads(pickle.dumps(one))}
SMALL = Case((8, 8), 2, "signed", "running", (3, 5, 7), 3)


@pytest.mark.parametrize("duplicate", DUPLICATES.values(), ids=DUPLICATES)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_volume_and_its_copy_seen_by_one_classifier(case, duplicate):
    """As many events here as there, but not the same."""
    network, volume = case.classifier(), case.volume()
    events = random_events(60, seed=5, duration_us=WINDOW_US, sensor=case.config.sensor).tolist()
    for event in events[:20]:
        volume.update_one(*event)
    network.refresh(volume)
    other = duplicate(volume)
    assert network.refresh(other).tobytes() == dense_of(case)(volume.array).tobytes()
    for mine, yours in zip(events[20:40], events[40:], strict=True):
        volume.update_one(*mine)
        other.update_one(*yours)
        assert network.refresh(volume).tobytes() == dense_of(case)(volume.array).tobytes()
        assert network.refresh(other).tobytes() == dense_of(case)(other.array).tobytes()
    assert volume.array.tobytes() != other.array.tobytes()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, DUPLICATES["pickle"]], ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("case", [CASES[3], CASES[5], CASES[7]], ids=str)
def test_a_classifier_and_its_copy_on_one_volume(case, duplicate):
    network, volume = case.classifier(), case.volume()
    events = random_events(60, seed=6, duration_us=WINDOW_US, sensor=case.config.sensor).tolist()
    for event in events[:20]:
        volume.update_one(*event)
        network.refresh(volume)
    other = duplicate(network)
    for k, event in enumerate(events[20:]):
        volume.update_one(*event)
        expected = dense_of(case)(volume.array).tobytes()
        assert other.refresh(volume).tobytes() == expected
        if k % 3 == 0:
            assert network.refresh(volume).tobytes() == expected


@pytest.mark.parametrize("duplicate", [copy.deepcopy, DUPLICATES["pickle"]], ids=["deepcopy", "pickle"])
def test_a_volume_and_its_classifier_copied_together(duplicate):
    case = CASES[7]
    pair = case.classifier(), case.volume()
    events = random_events(90, seed=7, duration_us=WINDOW_US).tolist()
    for event in events[:30]:
        pair[1].update_one(*event)
        pair[0].refresh(pair[1])
    other = duplicate(pair)
    for k in range(30, 60):
        for (network, volume), event in ((pair, events[k]), (other, events[k + 30])):
            volume.update_one(*event)
            assert network.refresh(volume).tobytes() == dense_of(case)(volume.array).tobytes()


def test_a_classifier_from_another_process_does_not_know_this_ones_windows(monkeypatch):
    """Windows there are numbered 1, 2, 3 .. too; it must not mistake one for a window of the first process."""
    network, volume = SMALL.classifier(), SMALL.volume()
    for event in random_events(10, seed=1, duration_us=900, sensor=(8, 8)).tolist():
        volume.update_one(*event)
    network.refresh(volume)
    parcel, number = pickle.dumps(network), int(network.network.layout[L.EPOCH])
    assert number > 0
    monkeypatch.setattr(volume_state, "_epochs", itertools.count(number - 1))  # one for `reset`, one for `open`
    here = SMALL.volume()
    for event in random_events(10, seed=2, duration_us=900, sensor=(8, 8)).tolist():
        here.update_one(*event)
    unknown = pickle.loads(parcel)
    assert unknown.refresh(here).tobytes() == dense_of(SMALL)(here.array).tobytes()
    network.network.layout[L.EPOCH] = number  # had it kept the number, it would have been wrong
    assert network.refresh(here).tobytes() != dense_of(SMALL)(here.array).tobytes()


@pytest.mark.parametrize(
    "settings",
    [
        {"every_events": 1},
        {"every_events": 3, "hop_us": 1500},
        {"every_us": 300, "confidence": 0.5},
        {"confidence": 0.5, "late": "drop"},
    ],
    ids=str,
)
@pytest.mark.parametrize("case", [CASES[2], CASES[4], CASES[5], CASES[7]], ids=str)
def test_a_processor_copied_in_midstream(case, settings):
    events = random_events(400, seed=8, duration_us=3 * WINDOW_US, sensor=case.config.sensor)
    first, rest, others = (
        events[:130],
        events[130:280],
        random_events(
            150, seed=9, duration_us=2 * WINDOW_US, sensor=case.config.sensor, start_us=int(events["t"][130])
        ),
    )

    def straight(*packets):
        processor = Processor(model_of(case), **settings)
        decisions = [d for packet in packets for d in processor.push(packet)]
        return [key(d) for d in decisions + processor.finish()]

    for duplicate in (copy.deepcopy, DUPLICATES["pickle"]):
        original = Processor(model_of(case), **settings)
        start = original.push(first)
        twin = duplicate(original)
        mine, yours = [], []
        for k in range(0, 150, 10):
            mine += original.push(rest[k : k + 10])
            yours += twin.push(others[k : k + 10])
        for processor, ends, packets in ((original, mine, rest), (twin, yours, others)):
            assert [key(d) for d in start + ends + processor.finish()] == straight(first, packets)
        assert mine
