"""An event camera in front of a moving image: what its pixels follow, and the threshold crossings
of its pixels."""

import numpy as np

from async_tnt.kernels.jit import compiled


@compiled
def low_pass(log_frames, frame_times_us, brightest_hz, darkest):
    """Each pixel's light behind a low-pass of first order, the slower the darker it is, by backward
    differences.

    y[0] = L[0];  y[k] = y[k - 1] + a / (1 + a) (L[k] - y[k - 1]),
    a = 2 pi brightest_hz max(exp(L[k]), darkest) (t[k] - t[k - 1])

    Parameters
    ----------
    log_frames : float64, (K, H, W), L. frame_times_us : float64, (K,), strictly increasing.
    brightest_hz : float64, the corner where L is 0. darkest : float64, luminance below which it
        falls no further.

    Returns
    -------
    float64, (K, H, W), y.
    """
    followed = np.empty_like(log_frames)
    followed[0] = log_frames[0]
    for k in range(1, log_frames.shape[0]):
        scale = 2e-6 * np.pi * brightest_hz * (frame_times_us[k] - frame_times_us[k - 1])
        for y in range(log_frames.shape[1]):
            for x in range(log_frames.shape[2]):
                light, before = log_frames[k, y, x], followed[k - 1, y, x]
                turns = scale * max(np.exp(light), darkest)
                followed[k, y, x] = before + turns / (1.0 + turns) * (light - before)
    return followed


@compiled
def pixel_events(log_frames, frame_times_us, threshold_on, threshold_off, reference, refractory_us):  # noqa: C901 (one loop: a call for each element would cost more than its work)
    """Threshold crossings of every pixel, pixel after pixel, each pixel's in order of time.

    Parameters
    ----------
    log_frames : float64, shape (K, H, W), finite.
    frame_times_us : float64, shape (K,), strictly increasing.
    threshold_on, threshold_off : float64, shape (H, W), above 0. Not checked here.
    reference : float64, shape (H, W), level R at the first frame.
    refractory_us : at least 0.

    Returns
    -------
    t : int64, microseconds, rounded. x, y : uint16. p : uint8, 1 = ON.
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
            c_on, c_off = threshold_on[y, x], threshold_off[y, x]
            level = reference[y, x]
            in_reset = False
            reset_end = 0.0
            for k in range(n_frames - 1):
                t0, t1 = frame_times_us[k], frame_times_us[k + 1]
                l0, l1 = log_frames[k, y, x], log_frames[k + 1, y, x]
                t_now, l_now = t0, l0
                while True:
                    if in_reset:
                        if reset_end >= t1:
                            break
                        t_now = reset_end
                        l_now = l0 + (l1 - l0) * ((t_now - t0) / (t1 - t0))
                        level = l_now
                        in_reset = False
                    if l_now >= level + c_on:  # only at the start, from a far-off reference
                        p, level = 1, level + c_on
                    elif l_now <= level - c_off:
                        p, level = 0, level - c_off
                    elif l1 >= level + c_on:
                        p, level = 1, level + c_on
                        t_now, l_now = t0 + (t1 - t0) * ((level - l0) / (l1 - l0)), level
                    elif l1 <= level - c_off:
                        p, level = 0, level - c_off
                        t_now, l_now = t0 + (t1 - t0) * ((level - l0) / (l1 - l0)), level
                    else:
                        break
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
