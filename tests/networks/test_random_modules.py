"""Random torch modules: what is accepted computes what the module computes, whatever the volume.

ASYNC_TNT_FUZZ_CASES makes it a long run: it was 20,000 once.
"""

import copy
import os

import numpy as np
import pytest
import torch
from networks.random_modules import N_CLASSES, SHAPE, random_module

from async_tnt import CompiledClassifier, Model, TNTConfig, TNTVolume, open_recording
from async_tnt.sources import sample_recordings

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "300"))
CONFIG = TNTConfig(sensor=(11, 12), grid=(11, 12), bins=3)


def volumes_of(config: TNTConfig, seed: int) -> list[np.ndarray]:
    """Sparse counts, these times 100, only negative ones, zeros, and recorded events."""
    rng = np.random.default_rng(seed)
    sparse = rng.poisson(0.1, config.shape).astype(np.float32) * rng.choice([-1.0, 1.0], config.shape)
    recorded = TNTVolume(TNTConfig(sensor=(34, 34), grid=config.grid, bins=config.bins, t_max=2.0))
    events = open_recording(sample_recordings()[seed % 10]).read()
    recorded.open(int(events["t"][0]))
    recorded.update(events[:1000])
    return [sparse, 100 * sparse, -np.abs(sparse) - 1, np.zeros(config.shape), recorded.array.copy()]


def logits_of(module: torch.nn.Module, volumes: list[np.ndarray], dtype: torch.dtype) -> np.ndarray:
    module = copy.deepcopy(module).to(dtype).eval()
    with torch.no_grad():
        return np.stack([module(torch.tensor(v, dtype=dtype)[None]).numpy().reshape(-1) for v in volumes])


def is_right(model: Model, module: torch.nn.Module, seed: int) -> bool:
    """Within 1e-4 of the largest logit of the module in float64, or four times torch's own error in float32."""
    volumes = volumes_of(model.config, seed)
    expected, rounded = (logits_of(module, volumes, dtype) for dtype in (torch.float64, torch.float32))
    found = np.stack([CompiledClassifier(model)(volume) for volume in volumes])
    bound = max(1e-4 * np.abs(expected).max(), 4 * np.abs(rounded - expected).max())
    return bool(np.abs(found - expected).max() <= bound)


@pytest.mark.filterwarnings("ignore:Using padding='same' with even kernel")
def test_what_is_accepted_is_right():
    assert CONFIG.shape == SHAPE
    accepted = 0
    for seed in range(CASES):
        module = random_module(seed).module
        before = copy.deepcopy(module)
        try:
            model = Model.from_torch(module, CONFIG, [str(k) for k in range(N_CLASSES)])
        except (NotImplementedError, ValueError):
            continue
        accepted += 1
        assert is_right(model, before, seed), seed
    assert accepted > CASES // 3
