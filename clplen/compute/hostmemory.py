"""How much memory of the host is free."""

from __future__ import annotations

import os
from pathlib import Path

_UNKNOWN = 4 << 30  # where a system does not say how much memory is free


def free_memory() -> int:
    """Bytes of host memory that are free now."""
    try:
        with Path("/proc/meminfo").open(encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _UNKNOWN
