"""Nanoseconds per event of `TNTVolume`: single calls and packets, on three sensors.

    python -m experiments.volumes [--quick] [--json FILE]

Events are random, with a fixed seed. Each way of giving events to a volume fills one window. All
ways take turns, on one thread. The opening of a window is not timed, except for whole windows of
400,000 events on 1280 x 720, which are opened, filled and read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from async_tnt import TNTConfig, TNTVolume, warmup
from async_tnt.base.progress import progress
from async_tnt.volume.events import structured
from experiments.scripts.options import exit_with, run_script, script_parser
from experiments.speed.moments import made_columns
from experiments.speed.timing import interleave, machine, spread, work_clock

SENSORS = ((34, 34), (346, 260), (1280, 720))
"""Width and height of the sensors. The grid of each volume has the same size."""

PACKETS = (10, 100, 1300)
"""Numbers of events of a packet."""

CAMERA_DTYPE = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
"""Layout of an event that is common among camera drivers: 14 bytes, with t not aligned."""

N_WHOLE = 400_000
"""Number of events of the window on the largest sensor that is opened, filled and read."""

N_EVENTS = (26_000, 13_000)
"""Numbers of events of a window, in full and with --quick. Both are whole packets of every size."""

ROUNDS = (31, 5)
"""Numbers of rounds, in full and with --quick. There are many, because a round is short."""


def measure(quick: bool) -> dict[str, Any]:
    """The report of all sensors, as one JSON object."""
    rng = np.random.default_rng(0)
    # as an index, False is 0 (in full), and True is 1 (--quick)
    rounds = ROUNDS[quick]
    sensor_reports = []
    with progress(len(SENSORS) + 1, "compiling") as bar:
        warmup()
        for grid in SENSORS:
            bar.update(title=f"volume, {grid[0]} x {grid[1]}")
            sensor_reports.append(bench_volume(grid, rng, n_events=N_EVENTS[quick], rounds=rounds))
        bar.update(title="whole windows")
        whole_window = whole_windows(rng, N_EVENTS[quick] if quick else N_WHOLE, rounds)
    settings = {"quick": quick, "threads": 1, "rounds": rounds}
    return {
        "machine": machine(),
        "settings": settings,
        "volume": sensor_reports,
        "whole_window": whole_window,
    }


def bench_volume(
    grid: tuple[int, int], rng: np.random.Generator, *, n_events: int, rounds: int
) -> dict[str, Any]:
    """The report of one sensor: a window of `n_events` events, given to the volume in every way.

    Returns
    -------
    dict : the settings, and `ns_per_event`: way -> `spread` of the nanoseconds per event.
    """
    config = TNTConfig(sensor=grid, grid=grid, landmark="running")
    columns = made_columns(rng, grid, n_events, config.window_us)
    volume = TNTVolume(config)
    cases = {"single": _singles(volume, [column[::10] for column in columns])}
    for size in PACKETS:
        for form, packets in (("structured", _structured_packets), ("columns", _column_packets)):
            cases[f"packet_{size}_{form}"] = _packets(volume, packets(columns, size), n_events)
    return {
        "grid": list(grid),
        "bins": config.bins,
        "landmark": config.landmark,
        "t_max": config.t_max,
        "window_us": config.window_us,
        "events": n_events,
        "ns_per_event": {
            name: spread(values) for name, values in interleave(cases, rounds).items()
        },
    }


def whole_windows(rng: np.random.Generator, n_events: int, rounds: int) -> dict[str, Any]:
    """The nanoseconds per event of whole windows on the largest sensor.

    A window is opened, filled by packets of 1,300 events, and read once at its end.
    """
    config = TNTConfig(sensor=SENSORS[-1], grid=SENSORS[-1], landmark="running")
    packets = _column_packets(
        made_columns(rng, SENSORS[-1], n_events, config.window_us), PACKETS[-1]
    )
    volume = TNTVolume(config)

    def run() -> float:
        started = work_clock()
        volume.open(0)
        for packet in packets:
            volume.update(packet)
        assert volume.array.shape == config.shape
        return 1e9 * (work_clock() - started) / n_events

    return {"events": n_events, "ns_per_event": spread(interleave({"whole": run}, rounds)["whole"])}


def _singles(volume: TNTVolume, columns: Sequence[np.ndarray]) -> Callable[[], float]:
    """A function that gives one event after the other, and returns the nanoseconds per event.

    The opening of the window is not timed.
    """
    rows = list(zip(*(column.tolist() for column in columns), strict=True))

    def run() -> float:
        volume.open(0)
        started = work_clock()
        # the time includes that of the loop itself, some 20 ns, because a user has it, too
        for t, x, y, p in rows:
            volume.update_one(t, x, y, p)
        return 1e9 * (work_clock() - started) / len(rows)

    return run


def _packets(volume: TNTVolume, packets: Sequence[Any], n_events: int) -> Callable[[], float]:
    """A function that gives one packet after the other, and returns the nanoseconds per event.

    The opening of the window is not timed.
    """

    def run() -> float:
        volume.open(0)
        started = work_clock()
        for packet in packets:
            volume.update(packet)
        return 1e9 * (work_clock() - started) / n_events

    return run


def _structured_packets(columns: tuple[np.ndarray, ...], size: int) -> list[np.ndarray]:
    """Packets of `size` events, as structured arrays of `CAMERA_DTYPE`."""
    events = structured(columns, dtype=CAMERA_DTYPE)
    return [events[first : first + size].copy() for first in range(0, len(events), size)]


def _column_packets(columns: tuple[np.ndarray, ...], size: int) -> list[tuple[np.ndarray, ...]]:
    """Packets of `size` events, as tuples of columns."""
    n = len(columns[0])
    return [
        tuple(column[first : first + size] for column in columns) for first in range(0, n, size)
    ]


def main(argv: list[str] | None = None) -> int:
    """Measure the report, print its tables, and write JSON if asked."""
    return run_script(
        script_parser("volumes", __doc__, "fewer events and rounds"), argv, measure, "bench"
    )


if __name__ == "__main__":
    exit_with(main)
