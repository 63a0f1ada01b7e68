"""Sizes on the command line: `346x260`."""

from __future__ import annotations

import argparse


def parse_size(text: str) -> tuple[int, int]:
    """`346x260` as (346, 260).

    Raises
    ------
    ValueError : not two whole numbers with an x between them.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"must be WIDTHxHEIGHT in pixels, such as 346x260, got {text!r}")
    return int(width), int(height)


def size_text(text: str) -> str:
    """An argparse type: the size as text, checked; so a command keeps it as it was given."""
    try:
        width, height = parse_size(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return f"{width}x{height}"
