"""Sizes in pixels as text, in options and messages: `346x260`."""

from __future__ import annotations

from async_tnt.config import MAX_SIDE


def parse_size(text: str) -> tuple[int, int]:
    """`346x260` as (346, 260).

    Raises
    ------
    ValueError : not two whole numbers in [1, 2**15] with an x between them.
    """
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"must be WIDTHxHEIGHT in pixels, such as 346x260, got {text!r}")
    size = int(width), int(height)
    if not all(1 <= side <= MAX_SIDE for side in size):
        raise ValueError(f"must be WIDTHxHEIGHT with sides in [1, {MAX_SIDE}] pixels, got {text!r}")
    return size


def format_size(size: tuple[int, int]) -> str:
    """(346, 260) as `346x260`."""
    return f"{size[0]}x{size[1]}"
