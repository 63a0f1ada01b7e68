"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path, *, shared: bool = False) -> Iterator[Path]:
    """Write the file that this gives, `path` with a further suffix: after the block it takes the place of `path`.

    Where the block fails, `path` stays as it was. A kill leaves the old file or the new one, and maybe a `.part`.

    Parameters
    ----------
    shared : several processes may write it at once; each has a `.part` of its own.

    Raises
    ------
    OSError : the file cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.txt")
    ...     with replacing(path) as part:
    ...         _ = part.write_text("whole")
    ...     path.read_text(), part.exists()
    ('whole', False)
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part" if shared else f"{path.name}.part")
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
