"""What OpenCL's loader needs before it starts: a cache folder, and the path of Intel's runtime.

The cache folder holds what was found out about this machine, and the kernels that runtimes keep.

An OpenCL loader finds its drivers through ``*.icd`` files, each holding the path of one library.
The wheel ``intel-opencl-rt`` brings such a file, but with a path that exists on its builder's
machine only. `expose_intel_runtime` writes one with the right path into a folder of its own and
names that folder in ``OCL_ICD_VENDORS``. The variable replaces the system's folder, so the
system's drivers are repeated in it. It has to name a folder: where it names a file, the loader
reads nothing else. PoCL's wheel is found by pyopencl's own loader in either case.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
from importlib import metadata
from pathlib import Path

VENDOR_FOLDERS = (Path("/etc/OpenCL/vendors"), Path(sys.prefix) / "etc/OpenCL/vendors")


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


def expose_intel_runtime() -> None:
    """Name a folder with Intel's runtime in ``OCL_ICD_VENDORS``, if that is needed.

    Call it before the first platform query of the process: the loader looks only once.
    Nothing happens where the user has chosen the vendors (``OCL_ICD_VENDORS`` or
    ``OPENCL_VENDOR_PATH`` is set), where the runtime is not installed in this Python
    environment, or where an existing ICD file already leads to a copy of it.
    """
    if os.environ.get("OCL_ICD_VENDORS") or os.environ.get("OPENCL_VENDOR_PATH"):
        return
    intel = _intel_library()
    known = _known_drivers()
    if intel is None or any(Path(name).name.startswith("libintelocl.so") for name in known):
        return
    os.environ["OCL_ICD_VENDORS"] = str(_vendor_folder([str(intel), *known]))


def _intel_library() -> Path | None:
    """Find ``libintelocl.so`` of this Python environment."""
    places = [Path(sys.prefix) / "lib" / "libintelocl.so"]
    try:
        installed = metadata.distribution("intel-opencl-rt").files or []
    except metadata.PackageNotFoundError:
        installed = []
    places += [Path(str(f.locate())) for f in installed if f.name == "libintelocl.so"]
    return next((place.resolve() for place in places if place.is_file()), None)


def _known_drivers() -> list[str]:
    """Read the libraries that the machine's ICD files name, less those with a dead path."""
    files = [file for folder in VENDOR_FOLDERS for file in sorted(folder.glob("*.icd"))]
    names = [file.read_text(errors="replace").strip() for file in files if os.access(file, os.R_OK)]
    return [name for name in names if name and (not os.path.isabs(name) or os.path.isfile(name))]


def _vendor_folder(drivers: list[str]) -> Path:
    """Make a folder of ICD files, or find the one made earlier for the same drivers.

    It is filled under a temporary name and then moved in one step, so that processes that
    start together never see a folder half filled. Without a writable cache it lives in the
    system's temporary folder until this process ends.
    """
    key = hashlib.sha256("\n".join(drivers).encode()).hexdigest()[:16]
    folder = cache_dir() / f"icd-{key}"
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix="icd-", dir=folder.parent))
    except OSError:
        folder = fresh = Path(tempfile.mkdtemp(prefix="clplen-icd-"))
        atexit.register(shutil.rmtree, fresh, ignore_errors=True)
    for number, driver in enumerate(drivers):
        (fresh / f"{number:02d}.icd").write_text(f"{driver}\n")
    try:
        fresh.rename(folder)
    except OSError:  # another process was first
        shutil.rmtree(fresh)
    return folder
