"""Sizes in pixels as argparse types: `346x260`."""

from __future__ import annotations

import argparse

from async_tnt.sources.sizes import format_size, parse_size


def size_of(text: str) -> tuple[int, int]:
    """The size as two numbers."""
    try:
        return parse_size(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def size_text(text: str) -> str:
    """The size as text, checked, so that a command keeps it as it was given."""
    return format_size(size_of(text))
