"""Memory that this process takes."""

from __future__ import annotations

import os
import sys


def resident_mb() -> float:
    """Resident memory of this process in MB (2^20 bytes).

    If the system does not report it, the peak of resident memory so far is returned.
    """
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except OSError:
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (2**20 if sys.platform == "darwin" else 2**10)
