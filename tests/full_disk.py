"""A disk that is full, for files that this process writes."""

import contextlib

try:
    import resource
except ImportError:  # Windows
    resource = None

TOO_LARGE = "File too large"


@contextlib.contextmanager
def full_after(n_bytes):
    """No file can become longer: an error as of a full disk, in its own words."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
