"""The pixels of a simulated event camera: the low-pass of their light, and their events."""

import numpy as np
from numba import float64

from async_tnt.kernels.entry_points import entry_point
from async_tnt.kernels.jit import inlined


@entry_point(float64[:, :, ::1], float64[::1], float64, float64)
def low_pass(log_frames, frame_times_us, brightest_hz, darkest):
    """Each pixel's light after a low-pass of first order, which is slower in the dark.

    The low-pass is computed by backward differences:

        y[0] = L[0]
        y[k] = y[k - 1] + a / (1 + a) (L[k] - y[k - 1])
        a    = 2 pi brightest_hz max(exp(L[k]), darkest) (t[k] - t[k - 1])

    Parameters
    ----------
    log_frames : float64, (K, H, W). L, the logarithm of luminance.
    frame_times_us : float64, (K,), strictly increasing.
    brightest_hz : float. The corner frequency where L is 0.
    darkest : float. The luminance below which the corner frequency falls no further.

    Returns
    -------
    float64, (K, H, W) : y.
    """
    followed = np.empty_like(log_frames)
    followed[0] = log_frames[0]
    for k in range(1, log_frames.shape[0]):
        scale = 2e-6 * np.pi * brightest_hz * (frame_times_us[k] - frame_times_us[k - 1])
        for y in range(log_frames.shape[1]):
            for x in range(log_frames.shape[2]):
                light = log_frames[k, y, x]
                before = followed[k - 1, y, x]
                a = scale * max(np.exp(light), darkest)
                followed[k, y, x] = before + a / (1.0 + a) * (light - before)
    return followed


@entry_point(float64[:, :, ::1], float64[::1], *(float64[:, ::1],) * 3, float64)
def pixel_events(log_frames, frame_times_us, threshold_on, threshold_off, reference, refractory_us):
    """Threshold crossings of all pixels: pixel after pixel, and by time for each pixel.

    Parameters
    ----------
    log_frames : float64, shape (K, H, W), finite.
    frame_times_us : float64, shape (K,), strictly increasing.
    threshold_on, threshold_off : float64, shape (H, W), above 0. Not checked here.
    reference : float64, shape (H, W). The reference level R at the first frame.
    refractory_us : float, at least 0.

    Returns
    -------
    t : int64, microseconds, rounded.
    x, y : uint16.
    p : uint8, 1 = ON.
    """
    n_frames, n_rows, n_columns = log_frames.shape
    capacity = 4096
    t_out = np.empty(capacity, np.int64)
    x_out = np.empty(capacity, np.uint16)
    y_out = np.empty(capacity, np.uint16)
    p_out = np.empty(capacity, np.uint8)
    n = 0
    for y in range(n_rows):
        for x in range(n_columns):
            c_on = threshold_on[y, x]
            c_off = threshold_off[y, x]
            level = reference[y, x]
            in_reset = False
            reset_end = 0.0
            for k in range(n_frames - 1):
                t0 = frame_times_us[k]
                t1 = frame_times_us[k + 1]
                l0 = log_frames[k, y, x]
                l1 = log_frames[k + 1, y, x]
                t_now = t0
                l_now = l0
                while True:
                    if in_reset:
                        if reset_end >= t1:
                            break
                        t_now = reset_end
                        l_now = l0 + (l1 - l0) * ((t_now - t0) / (t1 - t0))
                        level = l_now
                        in_reset = False

                    # There are three cases. The light is beyond a threshold already, which happens
                    # only at the start, if the reference is far off. Or it crosses a threshold
                    # before the next frame. Or there is no event before the next frame.
                    direction_now = _beyond(l_now, level, c_on, c_off)
                    direction = direction_now
                    if direction == 0:
                        direction = _beyond(l1, level, c_on, c_off)
                    if direction == 0:
                        break
                    p = 1 if direction > 0 else 0
                    level = level + c_on if direction > 0 else level - c_off
                    if direction_now == 0:
                        t_now = t0 + (t1 - t0) * ((level - l0) / (l1 - l0))
                        l_now = level

                    if n == capacity:
                        capacity *= 2
                        t_out = np.concatenate((t_out, np.empty(n, np.int64)))
                        x_out = np.concatenate((x_out, np.empty(n, np.uint16)))
                        y_out = np.concatenate((y_out, np.empty(n, np.uint16)))
                        p_out = np.concatenate((p_out, np.empty(n, np.uint8)))
                    t_out[n] = int(np.floor(t_now + 0.5))
                    x_out[n] = x
                    y_out[n] = y
                    p_out[n] = p
                    n += 1

                    if refractory_us > 0.0:
                        in_reset = True
                        reset_end = t_now + refractory_us
    return t_out[:n].copy(), x_out[:n].copy(), y_out[:n].copy(), p_out[:n].copy()


@inlined
def _beyond(light, level, c_on, c_off):
    """1 if the light is at or above the ON threshold, -1 at or below the OFF threshold, else 0."""
    if light >= level + c_on:
        return 1
    if light <= level - c_off:
        return -1
    return 0
