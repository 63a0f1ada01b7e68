"""What errors say."""

from __future__ import annotations


def one_line(error: Exception, limit: int = 300) -> str:
    """Text from a library or a file, for a message: on one line, and cut after `limit` characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= limit else text[:limit] + " ..."
