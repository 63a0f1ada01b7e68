"""Made recordings of classes that a network with random weights can tell apart."""

import numpy as np
from made import random_events

from async_tnt import TNTConfig

CONFIG = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=2, window_us=1000, transform="none")
CLASSES = ("a", "b", "c")


def recording(kind: int, seed: int, n: int = 600, config: TNTConfig = CONFIG):
    """Events of three windows that lie mostly in one part of the sensor."""
    rng = np.random.default_rng((kind, seed))
    width, height = config.sensor
    events = random_events(n, seed=int(rng.integers(1 << 30)), sensor=config.sensor)
    events["t"] = np.sort(rng.integers(0, 3 * 1000, n))
    centre = np.array([[0.2, 0.2], [0.8, 0.2], [0.2, 0.8], [0.8, 0.8], [0.5, 0.5]])[kind]
    events["x"] = np.clip(rng.normal(centre[0] * width, 2.0, n), 0, width - 1)
    events["y"] = np.clip(rng.normal(centre[1] * height, 2.0, n), 0, height - 1)
    return events


def of_classes(config: TNTConfig = CONFIG, n: int = 8):
    return {
        name: [recording(k, i, config=config) for i in range(n)] for k, name in enumerate(CLASSES)
    }
