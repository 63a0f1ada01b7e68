"""`async-tnt bench`: how long an event takes and how late a decision is, beside the batch way, on this machine."""

from .command import add_arguments, main

__all__ = ["add_arguments", "main"]
