"""The user's cache folder: for what was found out about this machine, and for OpenCL runtimes."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path


def cache_dir() -> Path:
    """Name the user's cache folder for clplen; it need not exist or be writable.

    Returns
    -------
    Path
        ``$XDG_CACHE_HOME/clplen``, else ``~/.cache/clplen``.
    """
    return _base() / "clplen"


def ensure_cache() -> None:
    """Give this process a cache folder where the user's cannot be written (read-only homes).

    PoCL shows no device and pyopencl makes no kernel without one. A temporary folder, removed at
    the end of the process, is then named in ``$XDG_CACHE_HOME``.
    """
    base = _base()
    existing = next(folder for folder in (base, *base.parents) if folder.exists())
    if os.access(existing, os.W_OK | os.X_OK):
        return
    folder = tempfile.mkdtemp(prefix="clplen-cache-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["XDG_CACHE_HOME"] = folder


def _base() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")).absolute()
