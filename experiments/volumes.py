"""Nanoseconds per event of `TNTVolume`: single calls and packets, on three sensors.

    python -m experiments.volumes [--quick] [--json FILE]

Events are random, seeded. Each way feeds one window, all ways in turns, on one thread; opening a window and reading it
are measured apart, because they cost by the window and not by the event.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from async_tnt import TNTConfig, TNTVolume, warmup
from async_tnt.events import structured
from async_tnt.progress import progress
from experiments.bench_moments import made_columns
from experiments.bench_timing import interleave, machine, machine_text, quartiles, spread, work_clock
from experiments.script_options import exit_with, run_script, script_parser

GRIDS = ((34, 34), (346, 260), (1280, 720))
PACKETS = (10, 100, 1300)
CAMERA_DTYPE = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
"""How camera drivers commonly pack an event: 14 bytes, t not aligned."""
N_EVENTS, ROUNDS = (26_000, 13_000), (31, 5)  # in full, with --quick; whole packets of every size, many short rounds


def measure(quick: bool) -> dict[str, Any]:
    """All sensors, as one JSON object."""
    rng, rounds, found = np.random.default_rng(0), ROUNDS[quick], []
    with progress(len(GRIDS), "compiling") as bar:
        warmup()
        for grid in GRIDS:
            bar.update(title=f"volume, {grid[0]} x {grid[1]}")
            found.append(bench_volume(grid, rng, n_events=N_EVENTS[quick], rounds=rounds))
    return {"machine": machine(), "settings": {"quick": quick, "threads": 1, "rounds": rounds}, "volume": found}


def bench_volume(grid: tuple[int, int], rng: np.random.Generator, *, n_events: int, rounds: int) -> dict[str, Any]:
    """Time one window of `n_events` events, fed in every way.

    Returns
    -------
    dict : the settings; `ns_per_event`, way -> `spread`; `open_us` and `read_us` (after 1300 more events), a `spread`
        each.
    """
    config = TNTConfig(sensor=grid, grid=grid, landmark="running")
    columns = made_columns(rng, grid, n_events, config.window_us)
    volume = TNTVolume(config)
    cases = {"single": _singles(volume, [column[::10] for column in columns])}
    for size in PACKETS:
        for form, packets in (("structured", _structured_packets), ("columns", _column_packets)):
            cases[f"packet_{size}_{form}"] = _packets(volume, packets(columns, size), n_events)
    cases["open_us"] = _opening(volume, columns)
    cases["read_us"] = _reads(volume, _column_packets(columns, 1300))
    measured = {name: spread(values) for name, values in interleave(cases, rounds).items()}
    open_us, read_us = measured.pop("open_us"), measured.pop("read_us")
    return {
        "grid": list(grid),
        "bins": config.bins,
        "landmark": config.landmark,
        "t_max": config.t_max,
        "window_us": config.window_us,
        "events": n_events,
        "ns_per_event": measured,
        "open_us": open_us,
        "read_us": read_us,
    }


def _singles(volume: TNTVolume, columns: Sequence[np.ndarray]) -> Callable[[], float]:
    """Nanoseconds per event, one event after the other; opening the window is not timed."""
    rows = list(zip(*(column.tolist() for column in columns), strict=True))

    def run() -> float:
        volume.open(0)
        started = work_clock()
        for t, x, y, p in rows:  # the loop itself, some 20 ns, is in the figure: a user has it too
            volume.update_one(t, x, y, p)
        return 1e9 * (work_clock() - started) / len(rows)

    return run


def _packets(volume: TNTVolume, packets: Sequence[Any], n_events: int) -> Callable[[], float]:
    """Nanoseconds per event, one packet after the other; opening the window is not timed."""

    def run() -> float:
        volume.open(0)
        started = work_clock()
        for packet in packets:
            volume.update(packet)
        return 1e9 * (work_clock() - started) / n_events

    return run


def _opening(volume: TNTVolume, columns: tuple[np.ndarray, ...]) -> Callable[[], float]:
    """Microseconds of opening a window after a full one."""

    def run() -> float:
        volume.open(0)
        volume.update(columns)
        _ = volume.array
        started = work_clock()
        volume.open(0)
        return 1e6 * (work_clock() - started)

    return run


def _reads(volume: TNTVolume, packets: list[Any]) -> Callable[[], float]:
    """Microseconds of one read after each packet: the median over the packets of a window."""

    def run() -> float:
        volume.open(0)
        _ = volume.array
        taken = []
        for packet in packets[:20]:
            volume.update(packet)
            started = time.perf_counter()
            _ = volume.array
            taken.append(time.perf_counter() - started)
        return 1e6 * float(np.median(taken))  # no other process interrupts that many

    return run


def _structured_packets(columns: tuple[np.ndarray, ...], size: int) -> list[np.ndarray]:
    events = structured(columns, dtype=CAMERA_DTYPE)
    return [events[first : first + size].copy() for first in range(0, len(events), size)]


def _column_packets(columns: tuple[np.ndarray, ...], size: int) -> list[tuple[np.ndarray, ...]]:
    n = len(columns[0])
    return [tuple(column[first : first + size] for column in columns) for first in range(0, n, size)]


def lines(report: dict[str, Any]) -> Iterator[str]:
    """The report as text."""
    volumes = report["volume"]
    yield machine_text(report["machine"])
    yield f"processor time, medians of {report['settings']['rounds']} interleaved rounds, quartiles in brackets"
    yield (
        f"landmark {volumes[0]['landmark']}, {volumes[0]['bins']} bins, {volumes[0]['events']:,} events a window: "
        "ns per event"
    )
    yield f"{'':28}" + "".join(f"{'{} x {}'.format(*v['grid']):>28}" for v in volumes)
    ways = {"single": "update_one, each event"}
    ways |= {f"packet_{n}_{form}": f"packets of {n}, {form}" for n in PACKETS for form in ("structured", "columns")}
    rows = {title: [v["ns_per_event"][way] for v in volumes] for way, title in ways.items()}
    rows["us to open a window"] = [v["open_us"] for v in volumes]
    rows["us to read after 1300"] = [v["read_us"] for v in volumes]
    for title, figures in rows.items():
        yield f"{title:28}" + "".join(f"{quartiles(figure):>28}" for figure in figures)


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and write JSON if asked."""
    return run_script(script_parser("volumes", __doc__, "fewer events and rounds"), argv, measure, lines)


if __name__ == "__main__":
    exit_with(main)
