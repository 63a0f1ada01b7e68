"""The options that say when to decide, besides at the end of a window."""

from __future__ import annotations

import argparse
from typing import Any

from async_tnt.cli.arguments import positive_int
from async_tnt.triggers import LeakyIntegrator


def add_triggers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--every-us", type=positive_int, metavar="US", help="decide also every US microseconds")
    parser.add_argument("--every-events", type=positive_int, metavar="N", help="decide also every N events")
    parser.add_argument(
        "--confidence",
        type=_probability,
        metavar="P",
        help="decide and close the window early once the likeliest class has probability P; looked for at the "
        "decisions that the other triggers make, or else after every event",
    )
    parser.add_argument(
        "--activity",
        type=_integrator,
        metavar="N:US",
        help="decide also when much happens in little time: a potential to which each event adds 1, and which leaks "
        "with the time constant US microseconds, reaches N",
    )


def triggers_of(args: argparse.Namespace) -> dict[str, Any]:
    """The settings of a Processor."""
    return {name: getattr(args, name) for name in ("every_us", "every_events", "confidence", "activity")}


def _probability(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"must be a probability in (0, 1], got {text!r}")
    return value


def _integrator(text: str) -> LeakyIntegrator:
    try:
        threshold, leak_us = (float(number.replace("_", "")) for number in text.split(":"))
        return LeakyIntegrator(threshold, leak_us)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be two positive numbers, events:microseconds, such as 60:4000, got {text!r}"
        ) from None
