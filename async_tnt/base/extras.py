"""Error messages about missing optional packages, which name the extra that installs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs_extra(extra: str, what: str) -> Iterator[None]:
    """Turn a failing import within the block into an ImportError of one line.

    Parameters
    ----------
    extra : name of the extra that installs the missing package.
    what : the beginning of the message, which says what needs the package, such as "views need
        rerun-sdk".
    """
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{what}: pip install 'async_tnt[{extra}]' ({error})") from None
