"""Networks of any layers: updates have the bits of a whole forward pass, near torch, at what the changes cost."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from incremental.random_networks import CONFIG, random_models
from made import random_events
from tnt_reference import LayerNetwork

from async_tnt import CompiledClassifier, TNTVolume


@settings(max_examples=10 * settings.default.max_examples)
@given(random_models(), st.integers(0, 10_000), st.lists(st.sampled_from([1, 1, 2, 10, 100]), min_size=3, max_size=12))
def test_at_every_packet(model, seed, sizes):
    dense, incremental = CompiledClassifier(model), CompiledClassifier(model)
    reference = LayerNetwork(model.layers["classifier"], model.weights).double().eval()
    volume, first = TNTVolume(model.config), 0
    events = random_events(sum(sizes), seed=seed, duration_us=2500, sensor=CONFIG.sensor)
    for size in sizes:
        volume.update(events[first : first + size])
        first += size
        logits = incremental.refresh(volume)
        assert logits.tobytes() == dense(volume.array).tobytes()
        with torch.no_grad():
            expected = reference(torch.tensor(volume.array.copy())[None].double()).flatten().numpy()
        assert np.abs(logits - expected).max() <= 1e-4 * max(1, np.abs(expected).max())
