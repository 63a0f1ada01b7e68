"""At every event, updated logits are those of the whole network, bit for bit."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from incremental.cases import CASES, LARGE, WINDOW_US, Case, dense_of, model_of, reference_of
from made import nasty_streams, random_events

from async_tnt import CompiledClassifier, TNTConfig, TNTVolume


def assert_equal_at_every_event(case: Case, events: np.ndarray, size: int = 1) -> list[bytes]:
    """Returns the logits at each packet's end."""
    network, dense, volume = case.classifier(), dense_of(case), case.volume()
    seen = []
    for first in range(0, len(events), size):
        if size == 1:
            volume.update_one(*events[first].tolist())
        else:
            volume.update(events[first : first + size])
        logits = network.refresh(volume)
        assert logits.tobytes() == dense(volume.array).tobytes()
        seen.append(logits.tobytes())
    return seen


@pytest.mark.parametrize("case", CASES, ids=str)
def test_at_every_event_of_a_random_stream(case):
    events = random_events(250, seed=1, duration_us=2 * WINDOW_US + 100, sensor=case.config.sensor)
    seen = assert_equal_at_every_event(case, events)
    assert len(set(seen)) > 0.4 * len(events)  # most events change the logits


def test_at_every_event_on_a_large_grid():
    events = random_events(24, seed=2, duration_us=WINDOW_US, sensor=LARGE.grid)
    seen = assert_equal_at_every_event(LARGE, events)
    assert len(set(seen)) > 0.4 * len(events)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(CASES), st.data(), st.sampled_from([1, 1, 2, 7]))
def test_at_every_event_of_a_nasty_stream(case, data, size):
    events = data.draw(nasty_streams(case.config.sensor, 2 * WINDOW_US, 77))
    assert_equal_at_every_event(case, events, size)


@pytest.mark.parametrize("size", [2, 7, 100, 1300, 5000])
@pytest.mark.parametrize("case", [CASES[3], CASES[5], CASES[7]], ids=str)
def test_at_the_end_of_every_packet(case, size):
    assert_equal_at_every_event(case, random_events(5000, seed=3, duration_us=9000, sensor=case.config.sensor), size)


@pytest.mark.parametrize("case", [*CASES, LARGE], ids=str)
def test_within_1e_4_of_the_torch_reference(case):
    model = model_of(case)
    network, volume, reference = CompiledClassifier(model), case.volume(), reference_of(model)
    for packet in np.split(random_events(600, seed=4, duration_us=6000, sensor=case.config.sensor), 6):
        volume.update(packet)
        with torch.inference_mode():
            expected = reference(torch.tensor(volume.array)).numpy()
        logits = network.refresh(volume)
        assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
    assert volume.array.any()


def test_refresh_of_an_empty_volume_is_the_network_on_zeros():
    for case in CASES[:4]:
        zeros = dense_of(case)(np.zeros(case.config.shape, np.float32))
        network, volume = case.classifier(), case.volume()
        assert network.refresh(volume).tobytes() == zeros.tobytes()  # no window open yet
        volume.update(random_events(200, duration_us=WINDOW_US, sensor=case.config.sensor))
        full = network.refresh(volume)
        volume.open(7)
        assert network.refresh(volume).tobytes() == zeros.tobytes()
        assert full.tobytes() != zeros.tobytes()


def test_logits_are_the_callers_to_keep():
    case = CASES[7]
    network, volume = case.classifier(), case.volume()
    volume.update(random_events(300, duration_us=900))
    first = network.refresh(volume)
    kept = first.tobytes()
    first[:] = 7
    again = network.refresh(volume)
    assert again.tobytes() == kept and first.tolist() == [7] * 10


@pytest.mark.parametrize(
    "other, got",
    [({"bins": 8}, r"\(8, 34, 34\)"), ({"grid": (34, 33)}, r"\(9, 33, 34\)"), ({"polarity": "split"}, r"\(18, 34, 34")],
)
def test_refresh_refuses_a_volume_of_another_shape(other, got):
    network = CompiledClassifier(model_of(CASES[7]))
    with pytest.raises(ValueError, match=rf"`volume` must have shape \(9, 34, 34\), got {got}"):
        network.refresh(TNTVolume(TNTConfig(**other)))
