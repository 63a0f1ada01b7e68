"""Draw docs/images/what_happens.png: what the transform makes of a moving digit, and the decisions in time.

    python docs/figures/what_happens.py                          the bundled digit 3, its first two saccades
    python docs/figures/what_happens.py --recording 8 --windows 1 2 --out eight.png
    python docs/figures/what_happens.py --recording my.bin --landmark line --remove-flow

Two windows in which the same digit moves in different directions, one in each row: its events along the
axis that it moves along most, raw and transformed, and slices of both volumes. Below, the class probabilities
of the whole recording as it streams by. Needs matplotlib and torch (the reference gives each event's place).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # draws into a file; needs no screen

import matplotlib.pyplot as plt
import numpy as np
import tnt_reference
from matplotlib.colors import LinearSegmentedColormap
from PIL import Image  # matplotlib brings it along

import async_tnt
from async_tnt.recordings import open_recording, sample_recordings

ON, OFF, GREY = "#D55E00", "#0072B2", "#8a8a8a"  # Okabe and Ito's colours: told apart by the colour-blind too
POLARITY = LinearSegmentedColormap.from_list("off-on", [OFF, "#ffffff", ON])
SLICES = (2, 3, 4, 5)  # bins of 9; a saccade's bell-shaped speed leaves few events in the others
OUT = Path(__file__).resolve().parents[1] / "images" / "what_happens.png"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Draw what the transform makes of two windows of a recording.")
    parser.add_argument("--recording", default="3", metavar="DIGIT|FILE", help="bundled sample or file (default: 3)")
    parser.add_argument("--windows", type=int, nargs=2, default=(0, 1), metavar="K", help="two windows (default: 0 1)")
    parser.add_argument("--landmark", default="running", choices=("center", "running", "line", "window"))
    parser.add_argument("--remove-flow", action="store_true", help='with --landmark line: the flow "line" has found')
    parser.add_argument("--t-max", type=float, default=3.0, help="default: %(default)s")
    parser.add_argument("--model", default="digits", metavar="NAME|FILE", help="for the probabilities")
    parser.add_argument("--every-us", type=int, default=2_500, help="between decisions (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=OUT, help="image file (default: %(default)s)")
    return parser.parse_args()


def volume_of(events: np.ndarray, config: async_tnt.TNTConfig, start_us: int) -> np.ndarray:
    volume = async_tnt.TNTVolume(config)
    volume.open(start_us)
    volume.update(events)
    return volume.array.copy()


def transformed(events: np.ndarray, config: async_tnt.TNTConfig, start_us: int) -> tuple[np.ndarray, np.ndarray]:
    """Each event's (u, v), shape (2, N), and whether it is kept."""
    u, v, kept = tnt_reference.tnt_coordinates(
        events["t"], events["x"], events["y"], start_us=start_us, window_us=config.window_us, sensor=config.sensor,
        grid=config.grid, t_max=config.t_max, landmark=config.landmark, remove_flow=config.remove_flow,
    )  # fmt: skip
    return np.stack([u.numpy(), v.numpy()]), kept.numpy()


def draw_events(ax, time_ms, place, on, config) -> None:
    """Events as dots, and the mean place of those in each twelfth of the window."""
    for polarity, color, name in ((True, ON, "ON"), (False, OFF, "OFF")):
        ax.scatter(time_ms[on == polarity], place[on == polarity], s=3.2, c=color, lw=0, label=name)
    part = (12 * time_ms / (config.window_us / 1e3)).astype(int)
    means = [(time_ms[part == k].mean(), place[part == k].mean()) for k in range(12) if (part == k).sum() >= 60]
    ax.plot(*zip(*means, strict=True), color="white", lw=4.5, solid_capstyle="round")
    ax.plot(*zip(*means, strict=True), color="black", lw=2, solid_capstyle="round", label="mean")
    ax.set_xlim(0, config.window_us / 1e3)
    ax.set_ylim(max(config.grid) - 0.5, -0.5)
    ax.set_yticks([0, 10, 20, 30])


def draw_slices(grid, volume, name, bins_ms, title) -> None:
    limit = np.quantile(np.abs(volume[volume != 0]), 0.97)
    for column, k in enumerate(SLICES):
        ax = plt.gcf().add_subplot(grid[column])
        ax.imshow(volume[k], cmap=POLARITY, vmin=-limit, vmax=limit, interpolation="nearest")
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set(visible=True, color="#bbbbbb")
        if title:
            ax.set_title(f"{bins_ms[k]:.0f} ms", fontsize=9, pad=3)
        if column == 0:
            ax.set_ylabel(name, fontsize=9)


def draw_probabilities(ax, events, model, every_us) -> None:
    decisions = list(async_tnt.stream([events], model, every_us=every_us))
    starts_ms = sorted({d.window_start_us / 1e3 for d in decisions})
    best = int(np.mean([d.probabilities for d in decisions], axis=0).argmax())
    highest = np.max([d.probabilities for d in decisions], axis=0)
    others = [k for k in np.argsort(-highest) if k != best]
    for number, start_ms in enumerate(starts_ms, start=1):
        inside = [d for d in decisions if d.window_start_us / 1e3 == start_ms]
        time_ms = [d.time_us / 1e3 for d in inside]
        for k in [*others[::-1], best]:
            style = dict(color="black", lw=2.4) if k == best else dict(color=GREY, lw=0.9)
            ax.plot(time_ms, [d.probabilities[k] for d in inside], **style)
        ax.axvline(start_ms, color="#bbbbbb", lw=0.8, ls=(0, (4, 3)))
        ax.annotate(f"window {number}", (start_ms, 1), xytext=(4, 0), textcoords="offset points", fontsize=9,
                    color="#555555", va="top")  # fmt: skip
    last = decisions[-1]
    ax.annotate(f"“{model.classes[best]}”", (last.time_us / 1e3, last.probabilities[best]), xytext=(6, 0),
                textcoords="offset points", fontsize=13, fontweight="bold", va="center")  # fmt: skip
    ax.annotate("others", (last.time_us / 1e3, last.probabilities[others].max()), xytext=(6, 0),
                textcoords="offset points", fontsize=9, color="#555555", va="center")  # fmt: skip
    ax.set(xlim=(events["t"][0] / 1e3 - 1, last.time_us / 1e3 + 1), ylim=(0, 1), yticks=[0, 0.5, 1])
    ax.set_xlabel(f"time in the recording (ms); a decision every {every_us / 1e3:g} ms")
    ax.set_ylabel("class probability")


def main() -> None:
    args = arguments()
    path = sample_recordings()[int(args.recording)] if args.recording.isdigit() else Path(args.recording)
    events = open_recording(path).read()
    model = async_tnt.load_model(args.model)
    config = model.config.replace(
        landmark=args.landmark, remove_flow=args.remove_flow, t_max=args.t_max, polarity="signed", transform="tnt",
        bins=9,
    )  # fmt: skip
    raw = config.replace(transform="none", landmark="center", remove_flow=False)

    plt.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
    figure = plt.figure(figsize=(10.4, 8.6))
    rows = figure.add_gridspec(3, 1, height_ratios=(1.15, 1.15, 0.85), hspace=0.32, left=0.085,
                               right=0.93, top=0.925, bottom=0.065)  # fmt: skip
    windows = []
    for k in args.windows:
        start_us = int(events["t"][0]) + k * config.window_us
        windows.append((start_us, events[(events["t"] >= start_us) & (events["t"] < start_us + config.window_us)]))
    flows = [
        tnt_reference.fitted_flow(
            w["t"], w["x"], w["y"], start_us=start_us, window_us=config.window_us, sensor=config.sensor,
            grid=config.grid,
        )[-1]
        for start_us, w in windows
    ]  # fmt: skip
    axis = int(sum(flow.abs() for flow in flows).argmax())  # the one the digit moves along most

    for row, (k, (start_us, window)) in enumerate(zip(args.windows, windows, strict=True)):
        left, right = rows[row].subgridspec(1, 2, width_ratios=(1.2, 1), wspace=0.1)
        left, right = left.subgridspec(1, 2, wspace=0.08), right.subgridspec(2, len(SLICES), wspace=0.06, hspace=0.06)
        time_ms, on = (window["t"] - start_us) / 1e3, window["p"] == 1
        uv, kept = transformed(window, config, start_us)
        # pixels are whole numbers: dots are spread over their pixel, or they would hide one another
        spread = np.random.default_rng(0).uniform(-0.4, 0.4, window.size)
        name, t_name = ("x", "u") if axis == 0 else ("y", "v")

        ax = figure.add_subplot(left[0])
        draw_events(ax, time_ms, window[name] + spread, on, config)
        ax.set_ylabel(f"{name}, after TNT {t_name} (px)")
        direction = (("left", "right"), ("up", "down"))[axis][int(flows[row][axis] > 0)]
        figure.text(0.022, ax.get_position().y0 + ax.get_position().height / 2, f"window {k + 1}: moving {direction}",
                    rotation=90, ha="center", va="center", fontsize=12, fontweight="bold")  # fmt: skip
        ax_tnt = figure.add_subplot(left[1], sharex=ax, sharey=ax)
        draw_events(ax_tnt, time_ms[kept], uv[axis, kept], on[kept], config)
        ax_tnt.tick_params(labelleft=False)
        bins_ms = np.arange(config.bins) * config.window_us / 1e3 / (config.bins - 1)
        draw_slices(right[0, :].subgridspec(1, len(SLICES), wspace=0.06), volume_of(window, raw, start_us), "raw",
                    bins_ms, True)  # fmt: skip
        draw_slices(right[1, :].subgridspec(1, len(SLICES), wspace=0.06), volume_of(window, config, start_us), "TNT",
                    bins_ms, False)  # fmt: skip
        if row == 0:
            ax.set_title("events as they come", fontsize=11, pad=8)
            ax_tnt.set_title(f"after TNT ({args.landmark}, t_max {args.t_max:g})", fontsize=11, pad=8)
            box = right[0, :].get_position(figure)
            figure.text((box.x0 + box.x1) / 2, 0.958, "slices of the event volume", ha="center", fontsize=11)
        else:
            ax.set_xlabel("time in the window (ms)")
            ax_tnt.set_xlabel("time in the window (ms)")
            ax_tnt.legend(loc="upper right", markerscale=3.5, frameon=False, fontsize=9, handletextpad=0.4,
                          handlelength=1, borderpad=0, labelspacing=0.2)  # fmt: skip

    draw_probabilities(figure.add_subplot(rows[2]), events, model, args.every_us)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out, dpi=150)
    if args.out.suffix == ".png":  # a palette: half of the bytes, and no eye sees it
        Image.open(args.out).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(args.out, optimize=True)
    print(f"{args.out} ({args.out.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
