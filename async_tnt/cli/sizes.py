"""Sizes in pixels on the command line: `346x260`."""

from __future__ import annotations

import argparse

from async_tnt.config import MAX_SIDE
from async_tnt.sources.sensor import format_size


def parse_size(text: str) -> tuple[int, int]:
    """`346x260` as (346, 260), which must be two whole numbers in [1, 2**15]. An argparse type."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, such as 346x260, got {text!r}")
    size = int(width), int(height)
    if not all(1 <= side <= MAX_SIDE for side in size):
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT with sides in [1, {MAX_SIDE}] pixels, got {text!r}")
    return size


def size_text(text: str) -> str:
    """The size as text, checked, so that a command keeps it as it was given. An argparse type."""
    return format_size(parse_size(text))
