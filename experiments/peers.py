"""Event volumes of 9 bins: ours against eventcv, tonic and torch, in one run, interleaved, warm, on one thread.

    python -m experiments.peers [--quick] [--json FILE]

A row is left out, with the reason, if its package is not installed:
`pip install torch==2.13.0 eventcv tonic`. What each row does is printed beside its figures, because the rows
differ: read `WORK` before quoting a ratio.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

if __name__ == "__main__":  # before any library reads them
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", RAYON_NUM_THREADS="1")

import numpy as np

from async_tnt import TNTConfig, TNTVolume, warmup
from async_tnt.events import structured
from async_tnt.progress import progress
from experiments.bench_moments import made_columns
from experiments.bench_timing import (
    interleave,
    is_installed,
    machine,
    one_thread,
    spread,
    work_clock,
)
from experiments.script_options import exit_with, run_script, script_parser
from experiments.volumes import GRIDS

BINS = 9
PACKET = 1300
DENSITY = PACKET / (34 * 34)  # events per pixel of a packet of 1300 at 34x34, for windows of the same density

WORK = {
    "ours_update": "TNT about the running centroid, 8 cells an event, into an open window; not read",
    "ours_update_read": "the same, and the dense float32 volume of the window so far read after each packet",
    "ours_fresh": "open an empty window, TNT, 8 cells, read: a volume of the packet alone, as the peers make it",
    "ours_fresh_raw": "the same without the transform: the volume that dsec_torch and eventcv make",
    "eventcv": "EventStream.voxel() of a stream made beforehand: 2 cells an event, whole pixels, no transform; "
    "left in eventcv's own frame",
    "eventcv_numpy": "from_numpy() of an (N, 4) array, .voxel(), .numpy(): the same, array to array",
    "tonic": "transforms.ToVoxelGrid: 2 cells an event, whole pixels, no transform, float64",
    "dsec_torch": "the method of DSEC's VoxelGrid: 8 cells an event, each a mask and a put_, no transform; "
    "tensors made beforehand",
    "torch_scatter": "TNT, 8 cells, one scatter_add_ (experiments.bench_torch_batch): the work of ours_fresh; tensors "
    "made beforehand",
}
PACKAGES = {
    "eventcv": "eventcv",
    "eventcv_numpy": "eventcv",
    "tonic": "tonic",
    "dsec_torch": "torch",
    "torch_scatter": "torch",
}

Case = Callable[[], Any]


def made_packets(grid: tuple[int, int], size: int, n_packets: int, window_us: int, seed: int) -> list[np.ndarray]:
    """Consecutive packets that together fill one window, its first event at the start."""
    events = structured(made_columns(np.random.default_rng(seed), grid, size * n_packets, window_us))
    events["t"][0] = 0
    return [events[k * size : (k + 1) * size].copy() for k in range(n_packets)]


def our_cases(volume: TNTVolume, packets: list[np.ndarray]) -> dict[str, Case]:
    raw = TNTVolume(volume.config.replace(transform="none"))

    def update() -> None:
        for packet in packets:
            volume.update(packet)

    def update_read() -> None:
        for packet in packets:
            volume.update(packet)
            _ = volume.array

    def fresh(volume: TNTVolume) -> np.ndarray:
        for packet in packets:
            volume.open(0)
            volume.update(packet)
            array = volume.array
        return array

    return {
        "ours_update": update,
        "ours_update_read": update_read,
        "ours_fresh": lambda: fresh(volume),
        "ours_fresh_raw": lambda: fresh(raw),
    }


def eventcv_cases(grid: tuple[int, int], packets: list[np.ndarray]) -> dict[str, Case]:
    import eventcv

    tables = [np.stack([p["t"], p["x"], p["y"], p["p"]], axis=1).astype(np.int64) for p in packets]
    ages_ms = [(table[-1, 0] - table[0, 0]) / 1000 for table in tables]  # its window ends at the newest event

    def stream(table: np.ndarray) -> Any:
        return eventcv.from_numpy(table, order="txyp", sensor_size=grid, time_unit="us")

    streams = [stream(table) for table in tables]

    def voxel() -> Any:
        for events, age_ms in zip(streams, ages_ms, strict=True):
            frame = events.voxel(bins=BINS, window_ms=age_ms)
        return frame

    def to_numpy() -> Any:
        for table, age_ms in zip(tables, ages_ms, strict=True):
            array = stream(table).voxel(bins=BINS, window_ms=age_ms).numpy()
        return array

    return {"eventcv": voxel, "eventcv_numpy": to_numpy}


def tonic_cases(grid: tuple[int, int], packets: list[np.ndarray]) -> dict[str, Case]:
    from tonic.transforms import ToVoxelGrid

    to_voxel_grid = ToVoxelGrid(sensor_size=(*grid, 2), n_time_bins=BINS)
    as_tonic = np.dtype([("x", "i8"), ("y", "i8"), ("t", "i8"), ("p", "i8")])  # of tonic's own N-MNIST
    packets = [packet[["x", "y", "t", "p"]].astype(as_tonic) for packet in packets]

    def run() -> Any:
        for packet in packets:
            volume = to_voxel_grid(packet)
        return volume

    return {"tonic": run}


def torch_cases(grid: tuple[int, int], packets: list[np.ndarray], window_us: int) -> dict[str, Case]:
    import torch

    from experiments.bench_torch_batch import TorchBatch, as_tensors

    batch = TorchBatch(TNTConfig(sensor=grid, grid=grid, bins=BINS, window_us=window_us))
    tensors = [as_tensors(packet, 0) for packet in packets]

    def scatter() -> Any:
        with torch.inference_mode():
            for columns in tensors:
                volume = batch.volume(*columns)
        return volume

    def dsec() -> Any:
        with torch.inference_mode():
            for columns in tensors:
                volume = dsec_volume(*columns, grid)
        return volume

    return {"dsec_torch": dsec, "torch_scatter": scatter}


def dsec_volume(dt: Any, x: Any, y: Any, sign: Any, grid: tuple[int, int]) -> Any:
    """V[b, y, x] += s k(b - b_i) k(y - y_i) k(x - x_i), b_i = (B - 1)(t_i - t_1)/(t_N - t_1), the way DSEC's
    data loader does it (Gehrig et al. 2021, scripts/dataset/representations.py): corner by corner, masks and an
    accumulating put_. float32; x and y may be fractions. The method is theirs, the lines are ours."""
    import torch

    width, height = grid
    volume = torch.zeros(BINS, height, width)
    b = (BINS - 1) * (dt - dt[0]) / (dt[-1] - dt[0])
    lower = b.int(), y.int(), x.int()  # toward zero; no coordinate here is negative
    for corner in range(8):
        at_b, at_y, at_x = (z + (corner >> shift & 1) for z, shift in zip(lower, (2, 1, 0), strict=True))
        inside = (at_b >= 0) & (at_b < BINS) & (at_y >= 0) & (at_y < height) & (at_x >= 0) & (at_x < width)
        weight = sign * (1 - (at_b - b).abs()) * (1 - (at_y - y).abs()) * (1 - (at_x - x).abs())
        place = at_b.long() * (height * width) + at_y.long() * width + at_x.long()
        volume.put_(place[inside], weight[inside], accumulate=True)
    return volume


def check_work(cases: dict[str, Case], packet: np.ndarray, grid: tuple[int, int]) -> dict[str, float]:
    """The largest difference between volumes that should be equal, in parts of the largest cell.

    `ours_fresh_raw`, `eventcv_numpy` and `dsec_torch` of one packet over [t_1, t_N] are the same volume;
    `ours_fresh` and `torch_scatter` are. tonic scales time by B instead of B - 1, so that no other equals it.
    """
    t, x, y, p = (packet[name].astype(np.int64) for name in "txyp")
    window_us = int(t[-1] - t[0])
    raw = TNTVolume(TNTConfig(sensor=grid, grid=grid, bins=BINS, window_us=window_us, transform="none"))
    raw.open(int(t[0]))
    inside = t < t[-1]
    raw.update(packet[inside])
    expected = raw.array.copy()
    np.add.at(expected[BINS - 1], (y[~inside], x[~inside]), 2 * p[~inside] - 1)  # at t_N: a window is half-open
    found = {}
    if "eventcv_numpy" in cases:
        found["eventcv_numpy"] = eventcv_cases(grid, [packet])["eventcv_numpy"]()
    if "dsec_torch" in cases:
        found["dsec_torch"] = torch_cases(grid, [packet], window_us)["dsec_torch"]().numpy()
    differences = {name: float(np.abs(v - expected).max() / np.abs(expected).max()) for name, v in found.items()}
    if "torch_scatter" in cases:
        config = TNTConfig(sensor=grid, grid=grid, bins=BINS)
        ours = our_cases(TNTVolume(config), [packet])["ours_fresh"]()
        twin = torch_cases(grid, [packet], config.window_us)["torch_scatter"]().numpy()
        differences["torch_scatter"] = float(np.abs(ours - twin).max() / np.abs(ours).max())
    tolerance = max(1e-4, 4 * max(grid) * 2.0**-24)  # four roundings of a float32 coordinate
    wrong = {name: d for name, d in differences.items() if d > tolerance}
    if wrong:
        raise RuntimeError(
            f"these must make the same volume as ours within {tolerance:.0e} of the largest cell, got {wrong}"
        )
    return differences


def compare(grid: tuple[int, int], size: int, n_packets: int, rounds: int) -> dict[str, Any]:
    """Every row at one grid with packets of `size` events: nanoseconds per event and ratios to ours."""
    window_us = TNTConfig().window_us
    packets = made_packets(grid, size, n_packets, window_us, seed=0)
    volume = TNTVolume(TNTConfig(sensor=grid, grid=grid, bins=BINS, window_us=window_us))
    cases = our_cases(volume, packets)
    if is_installed("eventcv"):
        cases |= eventcv_cases(grid, packets)
    if is_installed("tonic"):
        cases |= tonic_cases(grid, packets)
    if is_installed("torch", "tnt_reference"):
        cases |= torch_cases(grid, packets, window_us)
    checked = check_work(cases, packets[0], grid)
    timed = {name: _timed(case, volume, size * n_packets) for name, case in cases.items()}
    measured = interleave(timed, rounds)
    rows = {}
    for name, ns in measured.items():
        rows[name] = {"ns_per_event": spread(ns), "mev_per_s": 1e3 / float(np.median(ns))}
        if not name.startswith("ours"):
            for ours in ("ours_update_read", "ours_fresh"):  # paired in each round: the machine's load cancels
                rows[name][f"times_{ours}"] = float(np.median(ns / measured[ours]))
    return {
        "grid": list(grid),
        "events_a_packet": size,
        "packets": n_packets,
        "rounds": rounds,
        "rows": rows,
        "largest_difference": checked,
    }


def _timed(case: Case, volume: TNTVolume, n_events: int) -> Callable[[], float]:
    """Nanoseconds per event of a case, the window for our streaming rows opened before the clock starts."""

    def run() -> float:
        volume.open(0)
        started = work_clock()
        case()
        return 1e9 * (work_clock() - started) / n_events

    return run


def measure(quick: bool) -> dict[str, Any]:
    """Every row, on every grid."""
    warmup()
    settings = [(grid, PACKET, 20) for grid in GRIDS]
    settings += [(grid, round(DENSITY * grid[0] * grid[1]), 1) for grid in GRIDS[1:]]
    settings = settings[:1] if quick else settings
    results = []
    with progress(len(settings), "volumes") as bar, one_thread(is_installed("torch")):
        for grid, size, n_packets in settings:
            bar.update(0, "{} x {}, ".format(*grid) + f"packets of {size:,}")
            results.append(compare(grid, size, n_packets, rounds=3 if quick else 15))
            bar.update()
    missing = {row: package for row, package in PACKAGES.items() if not is_installed(package)}
    return {
        "machine": machine("torch", "eventcv", "tonic"),
        "bins": BINS,
        "threads": 1,
        "work": WORK,
        "results": results,
        "left_out": {row: f"{package} is not installed" for row, package in missing.items()},
    }


def main(argv: list[str] | None = None) -> int:
    """Run, print, and write JSON if asked."""
    return run_script(script_parser("peers", __doc__, "the small grid only, few rounds"), argv, measure, "peers")


if __name__ == "__main__":
    exit_with(main)
