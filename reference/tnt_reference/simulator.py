"""The events of an event camera's pixel, made from its log luminance.

The model is written out in pure Python, pixel by pixel. Between two frames the log luminance L of a
pixel changes along a straight line. With the reference level R:

    ON  event at the time t where L(t) = R + C_on;      then R := R + C_on
    OFF event at the time t where L(t) = R - C_off;     then R := R - C_off

After an event at t the pixel sees nothing until t + refractory; then R := L(t + refractory).

References
----------
Lichtsteiner, Posch, Delbruck 2008, A 128 x 128 120 dB 15 us Latency Asynchronous Temporal Contrast
Vision Sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np


def simulate_events(
    log_frames: np.ndarray,
    frame_times_us: Sequence[float],
    threshold_on: np.ndarray,
    threshold_off: np.ndarray,
    reference: np.ndarray,
    refractory_us: float,
) -> list[tuple[int, int, int, int]]:
    """Events of every pixel, sorted by (t, y, x).

    Parameters
    ----------
    log_frames : shape (K, H, W), natural log of luminance.
    frame_times_us : K increasing times.
    threshold_on, threshold_off : shape (H, W), positive.
    reference : shape (H, W), level R at the first frame.
    refractory_us : 0 for none.

    Returns
    -------
    list of (t, x, y, p) : t in microseconds, rounded; p = 1 for ON, 0 for OFF.
    """
    _, height, width = np.shape(log_frames)
    times = [float(t) for t in frame_times_us]
    events = []
    for y in range(height):
        for x in range(width):
            light = [float(frame[y][x]) for frame in log_frames]
            c_on = float(threshold_on[y][x])
            c_off = float(threshold_off[y][x])
            for t, p in pixel(light, times, c_on, c_off, float(reference[y][x]), refractory_us):
                events.append((math.floor(t + 0.5), x, y, p))
    # Python's sort is stable: events of one pixel in one microsecond stay in the order in which
    # they happened.
    return sorted(events, key=lambda event: (event[0], event[2], event[1]))


def low_pass(
    light: Sequence[float], times_us: Sequence[float], brightest_hz: float, darkest: float
) -> list[float]:
    """The smoothed log luminance y that a pixel follows: y' = 2 pi f (L - y).

    The corner frequency is f = brightest_hz max(exp(L), darkest): it grows with the luminance. The
    equation is solved by backward differences from frame to frame.
    """
    smoothed = [float(light[0])]
    for (t0, _), (t1, light_now) in pairwise(zip(times_us, light, strict=True)):
        f = brightest_hz * max(math.exp(light_now), darkest)
        a = 2 * math.pi * f * (t1 - t0) * 1e-6
        smoothed.append((smoothed[-1] + a * light_now) / (1 + a))
    return smoothed


def pixel(
    light: list[float],
    times: list[float],
    c_on: float,
    c_off: float,
    level: float,
    refractory_us: float,
) -> list[tuple[float, int]]:
    """Events (t, p) of one pixel with log luminance `light` at `times`, in order of time."""
    events = []
    blind_until = times[0]
    waking = False  # whether the level must be set to the light at `blind_until`
    for (t0, t1), (l0, l1) in zip(pairwise(times), pairwise(light), strict=True):
        now = t0
        light_now = l0
        while blind_until < t1:
            if waking:
                now = blind_until
                light_now = l0 + (l1 - l0) * ((now - t0) / (t1 - t0))
                level = light_now
                waking = False

            crossing = _next_crossing(now, light_now, t0, t1, l0, l1, level + c_on, level - c_off)
            if crossing is None:
                break
            now, light_now, p = crossing
            level = level + c_on if p == 1 else level - c_off
            events.append((now, p))
            if refractory_us > 0:
                blind_until = now + refractory_us
                waking = True
    return events


def _next_crossing(
    now: float,
    light_now: float,
    t0: float,
    t1: float,
    l0: float,
    l1: float,
    upper: float,
    lower: float,
) -> tuple[float, float, int] | None:
    """Time, log luminance and polarity of the event where the light reaches `upper` or `lower`.

    The light goes from l0 at t0 to l1 at t1, in a straight line. It is `light_now` at the time
    `now`. None if it reaches neither `upper` nor `lower` until t1.
    """
    # The light is past a threshold already only if the pixel's initial level was far from it.
    if light_now >= upper:
        return now, light_now, 1
    if light_now <= lower:
        return now, light_now, 0

    if l1 >= upper:
        return t0 + (t1 - t0) * ((upper - l0) / (l1 - l0)), upper, 1
    if l1 <= lower:
        return t0 + (t1 - t0) * ((lower - l0) / (l1 - l0)), lower, 0
    return None
