"""Real recordings, at every event: the bundled samples, and N-MNIST where it is."""

import numpy as np
import pytest
import torch
from incremental.cases import reference_of
from incremental.oracle import decisions_one_by_one, row
from made import random_model

from async_tnt import CompiledClassifier, Processor, TNTVolume, load_model
from async_tnt.sources.files.nmnist import read_nmnist
from async_tnt.sources.files.recording import open_recording, sample_recordings

MODEL = load_model("digits")
LANDMARKS = [
    {"landmark": "center"},
    {"landmark": "running"},
    {"landmark": "line"},
    {"landmark": "line", "remove_flow": True},
    {"landmark": "window"},
    {"transform": "none", "landmark": "center", "remove_flow": False},
    {"polarity": "split"},
    {"polarity": "unsigned"},
]


def assert_equal_at_every_event(model, events: np.ndarray, every_reference: int = 200) -> None:
    network, dense, reference = CompiledClassifier(model), CompiledClassifier(model), reference_of(model)
    volume, distinct = TNTVolume(model.config), set()
    for k, event in enumerate(events.tolist()):
        volume.update_one(*event)
        logits = network.refresh(volume)
        assert logits.tobytes() == dense(volume.array).tobytes()
        distinct.add(logits.tobytes())
        if k % every_reference == 0:
            with torch.inference_mode():
                expected = reference(torch.tensor(volume.array)).numpy()
            assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
    assert len(distinct) > 0.5 * len(events)


def sample(number: int) -> np.ndarray:
    return open_recording(sample_recordings()[number]).read()


def test_every_event_of_a_sample_with_the_bundled_model():
    events = sample(0)
    assert len(events) > 3000
    assert_equal_at_every_event(MODEL, events)


@pytest.mark.parametrize("changes", LANDMARKS, ids=str)
def test_events_of_a_sample_with_every_kind_of_volume(changes):
    base = MODEL.config.replace(landmark="running", remove_flow=False, transform="tnt", polarity="signed")
    config = base.replace(**changes)
    events = sample(3)
    n = 300 if config.needs_replay else 1500
    assert_equal_at_every_event(random_model(config, seed=1), events[len(events) // 3 :][:n])


def test_decisions_after_every_event_of_a_sample():
    """Three windows in one packet, in packets of a thousand, and event by event."""
    events, dense = sample(7), CompiledClassifier(MODEL)
    expected = decisions_one_by_one(events, lambda: TNTVolume(MODEL.config), dense, 1)
    assert len(expected) > len(events)
    for size in (len(events), 1000, 1):
        processor = Processor(MODEL, every_events=1)
        decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
        assert [row(d) for d in decisions + processor.finish()] == expected


@pytest.mark.parametrize("digit", [1, 4, 8])
def test_every_event_of_nmnist_recordings(data, digit):
    path = sorted((data / "nmnist" / "Test" / str(digit)).glob("*.bin"))[digit]
    assert_equal_at_every_event(MODEL, read_nmnist(path))


def test_packets_of_nmnist_recordings(data):
    network, dense, volume = CompiledClassifier(MODEL), CompiledClassifier(MODEL), TNTVolume(MODEL.config)
    for path in sorted((data / "nmnist" / "Test" / "6").glob("*.bin"))[:10]:
        for packet in open_recording(path, packet_events=61):
            volume.update(packet)
            assert network.refresh(volume).tobytes() == dense(volume.array).tobytes()
        volume.reset()
