"""A disk that is full, for files that this process writes."""

import contextlib

try:
    import resource
except ImportError:  # Windows
    resource = None

TOO_LARGE = "File too large"
"""The system's words for a file that may not become longer."""


@contextlib.contextmanager
def full_after(n_bytes):
    """During the block no file can become longer than `n_bytes`.

    Writing more raises an error like that of a full disk, with the words `TOO_LARGE`.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
