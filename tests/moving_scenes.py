"""Windows in which a known picture moves on a known path, seen by the simulator's pixels."""

import numpy as np

from async_tnt.kernels.training.simulate import pixel_events
from async_tnt.simulation.simulator import PixelModel, simulate
from async_tnt.volume.events import structured

WINDOW_US = 105_000
SENSOR = (34, 34)


def blobs(rng, sensor=SENSOR, n=6, spread=7.0):
    """A function of (x, y) that gives log luminance.

    It has a few dark smooth bars and discs about the middle of the sensor.
    """
    size = min(sensor) / 34
    centres = (np.array(sensor) - 1) / 2 + rng.uniform(-spread, spread, (n, 2)) * size
    angles = rng.uniform(0, np.pi, n)
    lengths = rng.uniform(0, 8, n) * size
    depths = rng.uniform(0.5, 1.6, n)

    def at(x, y):
        total = np.zeros(np.broadcast(x, y).shape)
        for (cx, cy), angle, length, depth in zip(centres, angles, lengths, depths, strict=True):
            along = np.cos(angle) * (x - cx) + np.sin(angle) * (y - cy)
            across = np.cos(angle) * (y - cy) - np.sin(angle) * (x - cx)
            beyond = np.maximum(np.abs(along) - length / 2, 0)
            away = (beyond**2 + across**2) / (2 * (1.2 * size) ** 2)
            total = np.maximum(total, depth * np.exp(-away))
        return -total

    return at


def pictures(scene, displacement, sensor=SENSOR):
    """Log luminance of each pixel at each displacement, (n, H, W)."""
    y, x = np.mgrid[: sensor[1], : sensor[0]].astype(float)
    dx, dy = np.asarray(displacement, float).T[:, :, None, None]
    return scene(x - dx, y - dy)


def straight(net, n=53, profile=lambda u: u):
    """A straight path of `n` displacements from 0 to `net`."""
    return profile(np.linspace(0, 1, n))[:, None] * np.asarray(net, float)


def recorded(scene, displacement, rng, sensor=SENSOR, pixels=None, window_us=WINDOW_US):
    """Columns t, x, y, p of one window."""
    times = np.linspace(0, window_us, len(displacement))
    events = simulate(pictures(scene, displacement, sensor), times, rng, pixels or PixelModel())
    events = events[events["t"] < window_us]
    return tuple(events[name].copy() for name in "txyp")


def noiseless_events(light, times, threshold_on, threshold_off, reference=None, refractory_us=0.0):
    """Events of noiseless pixels with known thresholds.

    The level begins at the first frame, or at `reference`.
    """
    level = light[0] if reference is None else reference
    of_pixels = [
        np.full(light[0].shape, value, float) for value in (threshold_on, threshold_off, level)
    ]
    found = structured(pixel_events(light, np.array(times, float), *of_pixels, refractory_us))
    return found[np.lexsort((found["x"], found["y"], found["t"]))]


def noise(rng, n, sensor=SENSOR, window_us=WINDOW_US):
    """Columns of `n` events anywhere, any time."""
    t = np.sort(rng.integers(0, window_us, n))
    width, height = sensor
    x = rng.integers(0, width, n).astype(np.uint16)
    y = rng.integers(0, height, n).astype(np.uint16)
    return t, x, y, rng.integers(0, 2, n).astype(np.uint8)


def together(*parts):
    """Events of several windows in one, in order of time."""
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return tuple(column[order] for column in columns)
