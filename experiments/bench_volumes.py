"""Nanoseconds per event of `TNTVolume`: single calls and packets, on three sensors."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from async_tnt.config import Landmark, TNTConfig
from async_tnt.events import structured
from async_tnt.volume import TNTVolume
from experiments.bench_moments import made_columns
from experiments.bench_timing import interleave, spread, work_clock

GRIDS = ((34, 34), (346, 260), (1280, 720))
PACKETS = (10, 100, 1300)
CAMERA_DTYPE = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
"""How camera drivers commonly pack an event: 14 bytes, t not aligned."""


def bench_volume(
    grid: tuple[int, int], landmark: Landmark, rng: np.random.Generator, *, n_events: int, rounds: int
) -> dict[str, Any]:
    """Time one window of `n_events` events, fed in every way.

    Opening the window is measured separately, because its cost is per window and not per event; so is reading
    `array` after a packet of 1300 more events.

    Returns
    -------
    dict : the settings; `ns_per_event`, way -> `spread`; `open_us` and `read_us`, each a `spread`.
    """
    config = TNTConfig(sensor=grid, grid=grid, landmark=landmark)
    columns = made_columns(rng, grid, n_events, config.window_us)
    volume = TNTVolume(config)

    def begin() -> None:
        volume.open(0)

    cases = {"single": timed_singles(volume.update_one, [column[::10] for column in columns], begin)}
    for size in PACKETS:
        for form, packets in (("structured", _structured_packets), ("columns", _column_packets)):
            cases[f"packet_{size}_{form}"] = timed_packets(volume.update, packets(columns, size), n_events, begin)
    cases["open_us"] = _opening(volume, columns)
    cases["read_us"] = _reads(volume, _column_packets(columns, 1300))
    measured = {name: spread(values) for name, values in interleave(cases, rounds).items()}
    open_us, read_us = measured.pop("open_us"), measured.pop("read_us")
    return {
        "grid": list(grid),
        "bins": config.bins,
        "landmark": landmark,
        "t_max": config.t_max,
        "window_us": config.window_us,
        "events": n_events,
        "ns_per_event": measured,
        "open_us": open_us,
        "read_us": read_us,
    }


def timed_singles(
    call: Callable[..., Any],
    columns: Sequence[np.ndarray],
    begin: Callable[[], None],
    end: Callable[[], Any] | None = None,
) -> Callable[[], float]:
    """Nanoseconds per event of `call(t, x, y, p)`, one event after the other; `begin` is not timed, `end` is."""
    rows = list(zip(*(column.tolist() for column in columns), strict=True))

    def run() -> float:
        begin()
        started = work_clock()
        for t, x, y, p in rows:  # the loop itself, some 20 ns, is in the figure: a user has it too
            call(t, x, y, p)
        if end:
            end()
        return 1e9 * (work_clock() - started) / len(rows)

    return run


def timed_packets(
    call: Callable[[Any], Any],
    packets: Sequence[Any],
    n_events: int,
    begin: Callable[[], None],
    end: Callable[[], Any] | None = None,
) -> Callable[[], float]:
    """Nanoseconds per event of `call(packet)`, one packet after the other; `begin` is not timed, `end` is."""

    def run() -> float:
        begin()
        started = work_clock()
        for packet in packets:
            call(packet)
        if end:
            end()
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
