"""Simulate the pixels of an event camera: from frames of log luminance to events.

Between two frames the log luminance L of a pixel is interpolated linearly. A pixel has a reference
level R:

    ON  event at the time t where L(t) = R + C_on;      then R := R + C_on
    OFF event at the time t where L(t) = R - C_off;     then R := R - C_off

A pixel has an event each time that L reaches such a threshold. After an event at t the pixel is
held in reset for `refractory_us`, and sees nothing. Then R := L(t + refractory_us). Times are
rounded to whole microseconds, and events are sorted by (t, y, x). Events of one pixel at one time
stay in the order in which they occurred.

Real circuits have these effects, too. All are off by default:

    bandwidth     The pixel follows its light as a low-pass does, y' = 2 pi f (L - y). It is slower
                  in the dark, because f = bandwidth_hz max(exp(L), DARKEST). In the brightest
                  light L is 0.
    leak          R drifts down by C_on leak_hz a second. So there are ON events even if L is
                  constant.
    after-pulses  Some events are followed by an event of the other sign.
    hot pixels    Some pixels have much noise, each at a rate of its own.

References
----------
- Hu, Liu, Delbruck 2021, v2e: From Video Frames to Realistic DVS Events. From it are the bandwidth
  in proportion to the light, and the leak.
- Lichtsteiner, Posch, Delbruck 2008, A 128 x 128 120 dB 15 us Latency Asynchronous Temporal
  Contrast Vision Sensor. From it is the pixel.
- Rebecq, Gehrig, Scaramuzza 2018, ESIM: an Open Event Camera Simulator. From it are the times of
  events, by linear interpolation between frames. In ESIM, events in the refractory time are
  dropped, but R still moves by thresholds. Here R follows the light. So it does in the pixel's
  circuit, whose capacitor is shorted during the refractory time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from async_tnt.base.checks import ParameterValueError, plain_array
from async_tnt.kernels.training.simulate import low_pass, pixel_events
from async_tnt.volume.events import EVENT_DTYPE, structured

MIN_THRESHOLD = 1e-3
"""Smallest threshold, in log luminance: a change by 0.1 %, far below the threshold of any pixel."""
DARKEST = 0.1
"""Luminance below which a pixel's bandwidth falls no further. The brightest light has luminance
1."""
AFTER_US = 1_000
"""Longest time between an event and its after-pulse, in microseconds."""


@dataclass(frozen=True)
class PixelModel:
    """The parameters of a simulated sensor's pixels.

    The defaults are fitted to N-MNIST. `experiments/RESULTS.md` compares simulated and recorded
    events.

    Attributes
    ----------
    threshold_on, threshold_off : mean contrast thresholds C_on and C_off, in natural log of
        luminance.
    mismatch : standard deviation, over pixels, of the log of the thresholds. The ON and the OFF
        threshold of a pixel are independent.
    refractory_us : microseconds that a pixel is held in reset after each event.
    noise_hz : background events per pixel and second. Their times are uniform, and independent of
        the light.
    noise_on_share : share of the background events that are ON.
    bandwidth_hz : corner frequency of the pixel's low-pass in the brightest light, in hertz. None:
        the pixel has no low-pass.
    leak_hz : ON events per pixel and second that the leak causes in steady light.
    after_share : share of the events that an after-pulse follows.
    hot_share : share of the pixels that are hot.
    hot_hz : mean number of background events of a hot pixel per second.
    """

    threshold_on: float = 0.197
    threshold_off: float = 0.185
    mismatch: float = 0.12
    refractory_us: float = 600.0
    noise_hz: float = 0.3
    noise_on_share: float = 0.99
    bandwidth_hz: float | None = None
    leak_hz: float = 0.0
    after_share: float = 0.0
    hot_share: float = 0.0
    hot_hz: float = 0.0

    def __post_init__(self) -> None:
        for name in ("threshold_on", "threshold_off"):
            value = getattr(self, name)
            if not MIN_THRESHOLD <= value < math.inf:
                rule = f"must be finite and at least {MIN_THRESHOLD}"
                raise ParameterValueError(name, rule, value)
        for name in ("mismatch", "refractory_us", "noise_hz", "leak_hz", "hot_hz"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ParameterValueError(name, "must be finite and at least 0", value)
        for name in ("noise_on_share", "after_share", "hot_share"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ParameterValueError(name, "must be in [0, 1]", value)
        if self.bandwidth_hz is not None and not 0 < self.bandwidth_hz < math.inf:
            rule = "must be None, or finite and above 0"
            raise ParameterValueError("bandwidth_hz", rule, self.bandwidth_hz)


def simulate(
    log_frames: np.ndarray,
    frame_times_us: np.ndarray,
    rng: np.random.Generator,
    pixels: PixelModel | None = None,
) -> np.ndarray:
    """Events of a sensor whose pixels differ, begin in random states and add background noise.

    A pixel's reference level begins at a random place, uniform from C_on below the first frame to
    C_off above it, because earlier events may have left it anywhere in this range. Noise events do
    not reset the pixel, and they ignore the refractory time.

    Parameters
    ----------
    log_frames : shape (K, H, W), natural log of luminance.
    frame_times_us : shape (K,), increasing, in microseconds.
    rng : the source of all randomness. The same state gives the same events.
    pixels : the parameters of the pixels; `PixelModel()` by default.

    Returns
    -------
    Structured array of `EVENT_DTYPE`, sorted by (t, y, x).

    Raises
    ------
    ValueError : shapes are wrong, light is not finite, or times do not increase.
    """
    if pixels is None:
        pixels = PixelModel()
    frames, times = _checked_frames(log_frames, frame_times_us)
    shape = frames.shape[1:]
    threshold_on = _thresholds(pixels.threshold_on, pixels.mismatch, shape, rng)
    threshold_off = _thresholds(pixels.threshold_off, pixels.mismatch, shape, rng)
    reference = frames[0] - threshold_on + rng.random(shape) * (threshold_on + threshold_off)

    if pixels.bandwidth_hz is not None:
        frames = low_pass(frames, times, pixels.bandwidth_hz, DARKEST)
    if pixels.leak_hz:
        frames = frames + pixels.leak_hz * 1e-6 * (times - times[0])[:, None, None] * threshold_on
    refractory_us = float(pixels.refractory_us)
    columns = pixel_events(frames, times, threshold_on, threshold_off, reference, refractory_us)

    parts = [structured(columns), _noise(pixels.noise_hz, (0, 0), shape, times, rng, pixels)]
    if pixels.hot_share:
        hot_pixels = np.argwhere(rng.random(shape) < pixels.hot_share)  # (row, column)
        rates_hz = rng.exponential(pixels.hot_hz, len(hot_pixels))
        for corner, hz in zip(hot_pixels.tolist(), rates_hz, strict=True):
            parts.append(_noise(hz, corner, (1, 1), times, rng, pixels))
    events = np.concatenate(parts)
    if pixels.after_share:
        events = np.concatenate([events, _after_pulses(events, pixels.after_share, rng)])
    # the last key of the sort counts most; the sort is stable
    return events[np.lexsort((events["x"], events["y"], events["t"]))]


def _thresholds(
    mean: float, mismatch: float, shape: tuple[int, ...], rng: np.random.Generator
) -> np.ndarray:
    """Draw a threshold for each pixel."""
    return np.maximum(mean * np.exp(mismatch * rng.standard_normal(shape)), MIN_THRESHOLD)


def _after_pulses(events: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Draw after-pulses of a share of the events."""
    after = events[rng.random(len(events)) < share]
    after["t"] += rng.integers(1, AFTER_US, len(after))
    after["p"] ^= 1
    return after


def _noise(
    hz: float,
    corner: Sequence[int],
    shape: Sequence[int],
    times: np.ndarray,
    rng: np.random.Generator,
    pixels: PixelModel,
) -> np.ndarray:
    """Draw background events: a Poisson process of the same rate at each pixel of a rectangle.

    Parameters
    ----------
    hz : events per pixel and second.
    corner, shape : (row, column) of the rectangle's first pixel, and the rectangle's (rows,
        columns).
    times : times of the frames, in microseconds. The noise is between the first and the last frame.
    rng : draws the events.
    pixels : has the share of ON events.
    """
    span_us = times[-1] - times[0]
    events = np.empty(rng.poisson(hz * shape[0] * shape[1] * span_us * 1e-6), EVENT_DTYPE)
    events["t"] = np.floor(times[0] + span_us * rng.random(len(events)))
    events["x"] = corner[1] + rng.integers(shape[1], size=len(events))
    events["y"] = corner[0] + rng.integers(shape[0], size=len(events))
    events["p"] = rng.random(len(events)) < pixels.noise_on_share
    return events


def _checked_frames(
    log_frames: np.ndarray, frame_times_us: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The arguments of `simulate` as contiguous float64 arrays.

    Raises
    ------
    ValueError : an argument breaks a rule of `simulate`.
    """
    frames = np.ascontiguousarray(plain_array("log_frames", log_frames), np.float64)
    times = np.ascontiguousarray(plain_array("frame_times_us", frame_times_us), np.float64)
    if frames.ndim != 3 or frames.shape[0] == 0:
        rule = "must have shape (K, H, W) with K >= 1"
        raise ParameterValueError("log_frames", rule, frames.shape)
    if max(frames.shape[1:]) > 1 << 16:
        rule = "must be at most 65536 pixels wide and high"
        raise ParameterValueError("log_frames", rule, frames.shape)
    if times.shape != frames.shape[:1]:
        rule = f"must have shape ({frames.shape[0]},), one per frame"
        raise ParameterValueError("frame_times_us", rule, times.shape)
    if not np.isfinite(frames).all():
        rule = "must be finite; luminance 0 has no logarithm"
        raise ParameterValueError("log_frames", rule)
    is_increasing = np.isfinite(times).all() and (np.diff(times) > 0).all()
    if not is_increasing or times[0] < 0 or times[-1] > 2**53:
        rule = "must be strictly increasing, in [0, 2^53]: what float64 holds exactly"
        raise ParameterValueError("frame_times_us", rule)
    return frames, times
