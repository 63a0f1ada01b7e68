"""The early decision of a window, and its cost: settings of `Processor` on labelled recordings.

Early is the first decision that a trigger makes, or with `confidence` the one that closes the window. A window without
one counts with its decision at the end.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt import Decision, LeakyIntegrator, Model, Processor, load_model, warmup
from async_tnt.evaluation.processes import run_all
from async_tnt.events import structured
from async_tnt.sources.files.recording import open_recording
from experiments.bench_moments import made_columns
from experiments.bench_timing import machine

MODEL = "digits"
N_WINDOWS = 3  # saccades; a few events follow them
MOMENTS_MS = (10, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80, 90, 100, 105)
LEVELS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
NUMBERS = (25, 50, 100, 150, 200, 300, 400, 600, 800)
INTEGRATORS = [(threshold, leak_us) for leak_us in (5_000, 20_000, math.inf) for threshold in (25, 50, 100, 200)]
SOON_EVENTS = 50  # decisions on fewer events are counted separately: are they arbitrary?
N_NOISE = 100  # recordings of noise

NOISE = {
    "uniform": "over pixels, time and polarity, as in training",
    "few": "the same, a fifteenth of the events",
    "flicker": "of the light: everywhere at once, every 10 ms, ON and OFF in turns",
    "pairs": "two neighbouring pixels at a time",
    "one polarity": "ON alone, as leak events are",
}
FLICKER_US, BURST_US = 10_000, 1_000

Settings = dict[str, Any]


def all_settings(window_us: int) -> dict[str, list[Settings]]:
    """Groups of settings of `Processor`; without any it decides at a window's end only."""
    return {
        "moment": [{"every_us": 1000 * ms} if 1000 * ms < window_us else {} for ms in MOMENTS_MS],
        "confidence": [{"confidence": level} for level in LEVELS],
        "confidence_every_ms": [{"confidence": level, "every_us": 1000} for level in LEVELS],
        "confidence_every_10_events": [{"confidence": level, "every_events": 10} for level in LEVELS],
        "every_events": [{"every_events": n} for n in NUMBERS],
        "activity": [{"activity": LeakyIntegrator(threshold, leak_us)} for threshold, leak_us in INTEGRATORS],
    }


@dataclass
class Early:
    """The early decision of one window."""

    right: bool
    ms: float
    """From the window's start to the decision."""
    events: int
    by_trigger: bool
    """False: at the window's end."""
    evaluations_until: int
    """Evaluations of the network up to it, including its own."""
    evaluations: int
    """Evaluations during the whole window."""
    emitted: int
    """Decisions of the window."""


def early_decision(decisions: Sequence[Decision], settings: Settings, window_us: int, truth: int) -> Early:
    """Of all decisions on one window, in their order."""
    counts = {"confidence"} if "confidence" in settings else {"every_us", "every_events", "activity"}
    early = next((d for d in decisions if d.trigger in counts), None)
    chosen = decisions[-1] if early is None else early
    due_us: float = window_us
    if early is not None:
        due_us = early.time_us - early.window_start_us
        if "every_us" in settings:  # due at that moment, on the events before it
            due_us = (due_us // settings["every_us"] + 1) * settings["every_us"]
    until = next(k for k, d in enumerate(decisions) if d is chosen) + 1
    evaluations = len(decisions)
    if set(settings) == {"confidence"}:  # after every event, and once more at the end of a window that stayed open
        until = evaluations = chosen.events + (early is None)
    right = chosen.index == truth
    return Early(right, due_us / 1000, chosen.events, early is not None, until, evaluations, len(decisions))


def early_decisions(model: Model, recordings: Sequence[tuple[int, np.ndarray]], settings: Settings) -> list[Early]:
    """The early decisions on all windows of labelled recordings."""
    window_us = model.config.window_us
    processor = Processor(model, start_us=0, **settings)
    found = []
    for truth, events in recordings:
        processor.reset()
        windows: dict[int, list[Decision]] = {}
        for decision in [*processor.push(events), *processor.finish()]:
            windows.setdefault(decision.window_start_us, []).append(decision)
        for start_us, decisions in windows.items():
            if start_us < N_WINDOWS * window_us:
                found.append(early_decision(decisions, settings, window_us, truth))
    return found


def summary(early: Sequence[Early]) -> dict[str, Any]:
    """Means over windows. `at_end` and `soon` are shares of them: those without an early decision, and those with one
    on fewer than SOON_EVENTS events, of which `soon_accuracy` are right (None where there are none)."""
    column = {name: np.array([getattr(e, name) for e in early], float) for name in Early.__dataclass_fields__}
    soon = (column["events"] < SOON_EVENTS) & (column["by_trigger"] > 0)
    return {
        "windows": len(early),
        "accuracy": float(column["right"].mean()),
        "mean_ms": float(column["ms"].mean()),
        "median_ms": float(np.median(column["ms"])),
        "mean_events": float(column["events"].mean()),
        "fewest_events": int(column["events"].min()),
        "at_end": float(1 - column["by_trigger"].mean()),
        "soon": float(soon.mean()),
        "soon_accuracy": float(column["right"][soon].mean()) if soon.any() else None,
        "evaluations_until": float(column["evaluations_until"].mean()),
        "evaluations": float(column["evaluations"].mean()),
        "emitted": float(column["emitted"].mean()),
    }


@functools.lru_cache(maxsize=1)
def labelled(folder: Path, n: int | None) -> list[tuple[int, np.ndarray]]:
    """(digit, events) of the recordings FOLDER/<digit>/*.bin; of n, the first ones of each digit.

    Raises
    ------
    ValueError : there are none.
    """
    paths = [sorted((folder / str(digit)).glob("*.bin")) for digit in range(10)]
    if n is not None:
        paths = [of_digit[: -(-n // 10)] for of_digit in paths]
    found = [(digit, path) for digit, of_digit in enumerate(paths) for path in of_digit]
    if not found:
        raise ValueError(f"no recordings {folder}/<digit>/*.bin: --nmnist or $TNT_DATA must name the place")
    return [(digit, open_recording(path).read()) for digit, path in found]


def measure_early(
    folder: Path, n: int | None, *, workers: int = 1, each: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """All settings on all recordings of a folder (or n of them), the network's answer to an empty volume
    (`of_nothing`, its largest probability), and confidence on noise, as one JSON object.

    each : called after each setting; there are `n_settings()`.
    """
    recordings = labelled(folder, n)
    model = load_model(MODEL)
    warmup(model)  # here, so that workers find the compiled kernels
    groups = all_settings(model.config.window_us)
    tasks = [(folder, n, group, k) for group, choices in groups.items() for k in range(len(choices))]
    found = {}
    for group, k, result in run_all(_measure_one, tasks, workers):
        found[group, k] = result
        each()
    n_events = int(np.mean([len(events) for _, events in recordings]))
    n_noise = N_NOISE if n is None else min(n, N_NOISE)
    return {
        "machine": machine(),
        "model": MODEL,
        "window_us": model.config.window_us,
        "recordings": len(recordings),
        "windows_a_recording": N_WINDOWS,
        "soon_events": SOON_EVENTS,
        "results": {group: [found[group, k] for k in range(len(choices))] for group, choices in groups.items()},
        "of_nothing": Processor(model).fire().probability,
        "noise": {kind: on_noise(model, kind, n_events, n_noise) for kind in NOISE},
    }


def n_settings() -> int:
    return sum(map(len, all_settings(load_model(MODEL).config.window_us).values()))


def made_noise(kind: str, rng: np.random.Generator, sensor: tuple[int, int], n: int, duration_us: int) -> np.ndarray:
    """About n events of one of `NOISE`, in order of time."""
    if kind == "pairs":
        t, x, y, p = (c.repeat(2) for c in made_columns(rng, (sensor[0] - 1, sensor[1]), n // 2, duration_us))
        x[1::2] += 1
        return structured((t, x, y, p))
    t, x, y, p = made_columns(rng, sensor, n // 15 if kind == "few" else n, duration_us)
    if kind == "flicker":
        t = np.sort(rng.integers(0, duration_us // FLICKER_US, n) * FLICKER_US + rng.integers(0, BURST_US, n))
        p = (t // FLICKER_US % 2).astype(np.uint8)
    elif kind == "one polarity":
        p = np.ones_like(p)
    return structured((t, x, y, p))


def on_noise(model: Model, kind: str, n_events: int, n: int) -> list[dict[str, Any]]:
    """Confidence on noise: n recordings of `n_events` events.

    Each level with its share of windows closed early, and their mean milliseconds."""
    rng = np.random.default_rng(0)
    sensor, duration_us = model.config.sensor, N_WINDOWS * model.config.window_us
    recordings = [(-1, made_noise(kind, rng, sensor, n_events, duration_us)) for _ in range(n)]
    result = []
    for settings in all_settings(model.config.window_us)["confidence"]:
        closed = [e.ms for e in early_decisions(model, recordings, settings) if e.by_trigger]
        result.append(
            {
                "settings": settings,
                "windows": n * N_WINDOWS,
                "closed_early": len(closed) / (n * N_WINDOWS),
                "mean_ms": float(np.mean(closed)) if closed else None,
            }
        )
    return result


def _measure_one(task: tuple[Path, int | None, str, int]) -> tuple[str, int, dict[str, Any]]:
    folder, n, group, k = task
    model = load_model(MODEL)
    settings = all_settings(model.config.window_us)[group][k]
    return group, k, {"settings": _plain(settings), **summary(early_decisions(model, labelled(folder, n), settings))}


def _plain(settings: Settings) -> Settings:
    """For JSON, which has no infinity."""
    plain = dict(settings)
    if "activity" in plain:
        plain["activity"] = {k: None if v == math.inf else v for k, v in asdict(plain["activity"]).items()}
    return plain
