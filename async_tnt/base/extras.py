"""Error messages about missing optional packages, which name the extra that installs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Turn a failing import within the block into an ImportError of one line.

    The line says `what` needs the package, and how the `extra` is installed.
    """
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what}: pip install 'async_tnt[{extra}]' ({error})") from None
