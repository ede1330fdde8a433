"""Where clplen keeps small things it has found out about this machine."""

from __future__ import annotations

import os
from pathlib import Path


def cache_dir() -> Path:
    """Name the user's cache folder for clplen; it need not exist or be writable.

    Returns
    -------
    Path
        ``$XDG_CACHE_HOME/clplen``, else ``~/.cache/clplen``.
    """
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "clplen"
