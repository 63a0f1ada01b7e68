"""Print the measured tables of docs/theory.md in Markdown, and draw the law of v/2.

    python -m experiments.figure_laws [--picture docs/images/laws.png]

Needs the batch reference (torch) and the bundled samples; the picture needs matplotlib.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import tnt_reference
import torch

import async_tnt
from async_tnt.sources import open_recording, sample_recordings
from experiments.scripts.options import exit_with, plain_parser

LANDMARKS = ("center", "running", "line", "window")
"""Landmarks that are compared."""

CASES = (*((name, False) for name in LANDMARKS), ("line", True))
"""What is compared: a landmark, and whether the flow is removed."""

WINDOW_US = 104_000
"""Length of a window, in microseconds."""

N = 1_300
"""Events of a window."""

REFERENCE: dict[str, Any] = dict(
    start_us=0, window_us=WINDOW_US, sensor=(201, 201), grid=(201, 201)
)
"""Arguments of the reference: window, sensor and grid."""

FRACTIONS = (1 / 8, 1 / 4, 1 / 2, 3 / 4, 1)
"""Fractions of the window at which the law is measured."""


def print_table(head: list[str], rows: list[list[str]]) -> None:
    for row in [head, ["---"] * len(head), *rows]:
        print("| " + " | ".join(row) + " |")
    print()


def constant(f: np.ndarray) -> np.ndarray:
    """The share of the path covered at fractions f of the window, at constant speed."""
    return f


def bell(f: np.ndarray) -> np.ndarray:
    """The share of the path covered at fractions f of the window, with a saccade's speed.

    The speed is bell-shaped (minimum jerk), and zero at both ends of the window.
    """
    return f**3 * (10 - 15 * f + 6 * f**2)


def points(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The places x and y of an object's events.

    They are random in a disc of radius 10 px about the grid's centre.
    """
    rng = np.random.default_rng(seed)
    radius = 10 * np.sqrt(rng.random(N))
    angle = 2 * np.pi * rng.random(N)
    return 100 + radius * np.cos(angle), 100 + radius * np.sin(angle)


@functools.cache
def shift(path: Callable[[np.ndarray], np.ndarray], landmark: str, remove_flow: bool) -> np.ndarray:
    """How far the motion of an object moves its transformed events, along x.

    It is the distance of each event from the same event of the object at rest, both transformed, in
    units of D / t_max. D is the displacement over the window.
    """
    # the events come at an even rate, the last one at the window's end
    t = (np.arange(N) + 1) * (WINDOW_US // N)
    displacement = 16.0 * path(t / WINDOW_US)
    y = np.full(N, 100.0)

    def place(dx: np.ndarray) -> np.ndarray:
        settings: dict[str, Any] = dict(t_max=1.0, landmark=landmark, remove_flow=remove_flow)
        x = points(0)[0] + dx
        return np.asarray(tnt_reference.tnt_coordinates(t, x, y, **REFERENCE, **settings).u.numpy())

    return (place(displacement) - place(0 * displacement)) / 16.0


def name_of(landmark: str, remove_flow: bool) -> str:
    return f"`{landmark}`" + (", `remove_flow`" if remove_flow else "")


def landmark_table(path: Callable[[np.ndarray], np.ndarray]) -> None:
    """Print what `shift` gives for each case, at some fractions of the window."""
    rows = []
    for landmark, remove_flow in CASES:
        values = shift(path, landmark, remove_flow)
        cells = [f"{values[round(f * N) - 1]:+.3f}" for f in FRACTIONS]
        rows.append([name_of(landmark, remove_flow), *cells])
    print_table(["landmark", *(f"f = {f:g}" for f in FRACTIONS)], rows)


def draw_motion_terms(path: str) -> None:
    """Draw the motion that each landmark leaves in the volume, over the time in the window.

    A flat line means that the image is translated as a whole.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.4, 3.9), sharey=True, layout="constrained")
    colours = ("#000000", "#0072b2", "#d55e00", "#999999", "#009e73")
    f = (np.arange(N) + 1) / N
    motions = {"constant flow": constant, "a saccade: bell-shaped speed": bell}
    for axis, (title, motion) in zip(axes, motions.items(), strict=True):
        for (landmark, remove_flow), colour in zip(CASES, colours, strict=True):
            label = f"{landmark}, flow removed" if remove_flow else landmark
            motion_left = shift(motion, landmark, remove_flow)
            axis.plot(f, motion_left, color=colour, label=label, linewidth=2)
        axis.axhline(0.5, color="#bbbbbb", linewidth=0.8, linestyle=":", zorder=0)
        axis.set(title=title, xlabel="fraction f of the window", xlim=(0, 1), ylim=(-1.1, 1.6))
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("motion left in the volume,\nin units of v / t_max")
    axes[1].legend(frameon=False, loc="lower right")
    figure.savefig(path, dpi=110)


def ridge_table() -> None:
    """Print which flow `line` finds at the window's end, if the flow v is constant.

    The events come at an even rate. The columns with formulas are those of docs/theory.md.
    """
    rows = []
    for n in (10, 30, 100, 300, 1_300, 10_000):
        t = np.round((np.arange(n) + 1) * WINDOW_US / n).astype(np.int64)
        x = 100 + 16.0 * t / WINDOW_US
        flow = tnt_reference.fitted_flow(t, x, x, **REFERENCE)[-1, 0].item() / 16
        intercept = (tnt_reference.landmark("line", t, x, x, **REFERENCE)[-1, 0].item() - 100) / 16
        c_ff = n / 12  # C of the formulas
        rows.append(
            [
                f"{n:,}",
                f"{flow:.3f}",
                f"{c_ff / (c_ff + 1):.3f}",
                f"{1 - intercept:.3f}",
                f"{1 - 0.5 / (c_ff + 1):.3f}",
            ]
        )
    print_table(["events", "m / v", "C / (C + 1)", "translation", "1 - 1 / (2 (C + 1))"], rows)


def wander_table() -> None:
    """Print how far landmarks of 400 random objects at rest are from the objects' middles."""
    t = (np.arange(N) + 1) * (WINDOW_US // N)
    rows = []
    for landmark in ("running", "line"):
        landmarks_of_objects = [
            tnt_reference.landmark(landmark, t, *points(seed), **REFERENCE) for seed in range(400)
        ]
        # (objects, N, 2)
        strays = np.stack([landmarks.numpy() - 100 for landmarks in landmarks_of_objects])
        rms = np.sqrt((strays**2).sum(2).mean(0))
        rows.append([f"`{landmark}`", *(f"{rms[round(f * N) - 1]:.2f}" for f in FRACTIONS)])
    print_table(["landmark", *(f"f = {f:g}" for f in FRACTIONS)], rows)


def sample_windows() -> list[np.ndarray]:
    """The three windows of each bundled sample. The first window starts at the first event."""
    windows = []
    for path in sample_recordings().values():
        events = open_recording(path).read()
        events["t"] -= events["t"][0]
        windows += [events[events["t"] // 105_000 == k] for k in range(3)]
    return windows


def streamed(window: np.ndarray, start_us: int, shift: int, options: dict[str, Any]) -> np.ndarray:
    """The volume that the stream makes of a window's events, moved right and up by `shift` pixels.

    Pixels of the stream are whole numbers, so the shift is a whole number, too.
    """
    volume = async_tnt.TNTVolume(async_tnt.TNTConfig(**options))
    volume.open(start_us)
    x = window["x"].astype(int) + shift
    y = window["y"].astype(int) - shift
    volume.update((window["t"], x, y, window["p"]))
    return volume.array.astype(np.float64)


def batch(window: np.ndarray, start_us: int, shift: float, options: dict[str, Any]) -> np.ndarray:
    """The volume that the reference makes of a window's events, moved by `shift` as in `streamed`.

    Here the shift may be a fraction.
    """
    return tnt_reference.tnt_volume(
        window["t"],
        window["x"] + shift,
        window["y"] - shift,
        window["p"],
        start_us=start_us,
        window_us=105_000,
        sensor=(34, 34),
        grid=(34, 34),
        dtype=torch.float64,
        **options,
    ).numpy()


def translation_table() -> None:
    """Print how much the volumes of translated samples differ, which Proposition 3 is about.

    In the stream the samples are translated by 2 px each way, the most that they leave room for. In
    the reference they are translated by 1/3 px.
    """
    # windows without the events that a translation would move off the sensor, and their starts
    inner_windows = []
    for k, window in enumerate(sample_windows()):
        x = window["x"].astype(int)
        y = window["y"].astype(int)
        inner_windows.append((window[(x >= 2) & (x < 32) & (y >= 2) & (y < 32)], k % 3 * 105_000))
    rows = []
    for landmark, remove_flow in CASES:
        options = dict(landmark=landmark, remove_flow=remove_flow, t_max=2.0)
        cells = []
        ways: tuple[tuple[Callable[..., np.ndarray], float], ...] = ((streamed, 2), (batch, 1 / 3))
        for volume_of, shift in ways:
            worst = 0.0
            for window, start_us in inner_windows:
                original = volume_of(window, start_us, 0, options)
                translated = volume_of(window, start_us, shift, options)
                worst = max(worst, np.abs(translated - original).max() / np.abs(original).max())
            # smaller numbers are rounding, which differs between machines
            cells.append("below 1e-6" if worst < 1e-6 else f"{worst:.2f}")
        rows.append([name_of(landmark, remove_flow), *cells])
    print_table(["landmark", "2 px, stream", "1/3 px, reference"], rows)


def t_max_table() -> None:
    """Print how many events each t_max keeps, and the size of an image in the last quarter."""
    windows = [(window, k % 3 * 105_000) for k, window in enumerate(sample_windows())]
    quarters = np.concatenate([_quarter(window, start_us) for window, start_us in windows])
    rows = []
    lost_first = {}  # the share of the lost events that quarter 1 has
    for t_max in (0.5, 1.0, 2.0, 3.0, 4.0, 8.0, 16.0):
        kept = {}
        for landmark in ("center", "running", "line"):
            parts = [_transformed(*window, t_max, landmark)[1] for window in windows]
            kept[landmark] = np.concatenate(parts)
        lost_shares = [1 - kept["running"][quarters == q].mean() for q in range(4)]
        lost_first[t_max] = (quarters[~kept["running"]] == 0).mean()
        size, expected = _size_in_last_quarter(windows, t_max)
        rows.append(
            [
                f"{t_max:g}",
                *(f"{100 * is_kept.mean():.1f} %" for is_kept in kept.values()),
                *(f"{100 * share:.1f} %" for share in lost_shares),
                f"{size:.2f}",
                f"{expected:.2f}",
            ]
        )
    head = [
        "t_max",
        "kept, `center`",
        "kept, `running`",
        "kept, `line`",
        *(f"lost in quarter {q}" for q in range(1, 5)),
        "size in the last quarter",
        "1 / tau there",
    ]
    print_table(head, rows)
    print(
        f"Of the events that are lost with `running`, quarter 1 has {100 * lost_first[2]:.0f} % at "
        f"t_max 2 and {100 * lost_first[3]:.0f} % at t_max 3.\n"
    )


def _quarter(window: np.ndarray, start_us: int) -> np.ndarray:
    """The quarter of the window in which each event lies: 0, 1, 2 or 3."""
    return (window["t"] - start_us) * 4 // 105_000


def _transformed(
    window: np.ndarray, start_us: int, t_max: float, landmark: str
) -> tuple[np.ndarray, np.ndarray]:
    """The column of each transformed event, and whether the event is kept."""
    u, _, keep = tnt_reference.tnt_coordinates(
        window["t"],
        window["x"],
        window["y"],
        start_us=start_us,
        window_us=105_000,
        sensor=(34, 34),
        grid=(34, 34),
        t_max=t_max,
        landmark=landmark,
    )
    return u.numpy(), keep.numpy()


def _size_in_last_quarter(
    windows: list[tuple[np.ndarray, int]], t_max: float
) -> tuple[float, float]:
    """The size of transformed images as a share of their recorded size, and the expected share.

    Both are of the last quarter of windows, with landmark `running`. A size is the standard
    deviation of columns. The expected share is the mean of 1 / tau.
    """
    sizes = []
    recorded_sizes = []
    inverse_taus = []
    for window, start_us in windows:
        u, keep = _transformed(window, start_us, t_max, "running")
        is_last = _quarter(window, start_us) == 3
        is_kept_and_last = keep & is_last
        sizes.append(u[is_kept_and_last].std())
        recorded_sizes.append(window["x"][is_last].std())
        inverse_taus.append((105_000 / (t_max * (window["t"] - start_us)[is_kept_and_last])).mean())
    return float(np.mean(sizes) / np.mean(recorded_sizes)), float(np.mean(inverse_taus))


def border_counts() -> str:
    """A sentence on events that exact arithmetic puts on the border: how many float64 moves out."""
    n = 0
    outside_a = 0
    outside_b = 0
    kept = 0
    for window_us in (800, 1_000, 10_000, 50_000, 100_000, 105_000):
        config = async_tnt.TNTConfig(window_us=window_us, landmark="center", transform="tnt")
        for t_max in (0.7, 1.0, 2.0, 3.0, 3.7, 8.0, 16.0):
            for x in range(34):
                # u = (x - 33/2) / tau + 33/2 is 0 or 33  <=>  tau = |2 x - 33| / 33
                dt = Fraction(abs(2 * x - 33), 33) * window_us / Fraction(str(t_max))
                if dt.denominator > 1 or not 0 < dt < window_us:
                    continue
                n += 1
                tau = t_max * float(dt) / window_us
                u_a = (x - 16.5) / tau + 16.5
                u_b = (x - 16.5) * (1 / float(dt)) * (window_us / t_max) + 16.5
                outside_a += not 0 <= u_a <= 33
                outside_b += not 0 <= u_b <= 33
                volume = async_tnt.TNTVolume(config.replace(t_max=t_max))
                volume.open(0)
                volume.update_one(int(dt), x, 16, 1)
                kept += volume.counts.kept
    return (
        f"{n} events exactly on the border: (x - l) / tau + c puts {outside_a} of them outside in "
        f"float64, (x - l) * (1 / dt) * (window_us / t_max) + c {outside_b}; with the tolerance "
        f"{kept} are kept."
    )


def cancellation() -> str:
    """A sentence on the error of a cell after 1000 ON and then 999 OFF events.

    The events lie at one pixel between two bins. Each OFF event cancels the weight of an ON event,
    so the weight of the last ON event should be left, which is .5.
    """
    rng = np.random.default_rng(2)
    weights = rng.random(999)
    shares = np.concatenate([weights, [0.5], -weights])
    sums = {
        dtype: np.add.accumulate(shares.astype(dtype), dtype=dtype)[-1]
        for dtype in (np.float32, np.float64)
    }
    errors = {dtype: abs(float(total) - 0.5) / 0.5 for dtype, total in sums.items()}
    return (
        "1000 ON and 999 OFF events in one cell: relative error of the cell "
        f"{errors[np.float32]:.0e} with float32 sums, {errors[np.float64]:.0e} with float64 sums"
    )


def main(argv: list[str] | None = None) -> int:
    """Print the tables, and draw the law if asked."""
    parser = plain_parser("figure_laws", __doc__)
    parser.add_argument("--picture", metavar="FILE", help="also draw the law of v/2 into this file")
    args = parser.parse_args(argv)
    if args.picture:
        draw_motion_terms(args.picture)
    print("## Translated streams: how far their volumes differ, as a share of the largest cell\n")
    translation_table()
    print("## Constant flow: translation of the volume, in units of v / t_max\n")
    landmark_table(constant)
    print("## The ridge of `line`, at the end of a window with evenly spread events\n")
    ridge_table()
    print("## Bell-shaped speed: the same, in units of D / t_max\n")
    landmark_table(bell)
    print("## How far the landmark of an object at rest strays, in pixels (rms)\n")
    wander_table()
    print("## t_max on the ten bundled samples (three windows each)\n")
    t_max_table()
    print("## Rounding\n")
    print(border_counts())
    print(cancellation())
    return 0


if __name__ == "__main__":
    exit_with(main)
