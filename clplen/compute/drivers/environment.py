"""Environment of OpenCL's loader: a cache folder and the path of Intel's runtime.

The cache folder holds test results for this machine and the kernels that runtimes compile.

An OpenCL loader finds its drivers through ``*.icd`` files, each with the path of a library. The
wheel ``intel-opencl-rt`` brings such a file, but its path exists only on the machine that built the
wheel. `expose_intel_runtime` writes a file with the right path into a new folder and names that
folder in ``OCL_ICD_VENDORS``. The variable replaces the system's folder, so the new folder lists
the system's drivers as well. The variable must name a folder: for a file, the loader reads nothing
else. pyopencl's bundled loader finds PoCL's wheel in either case.
"""

from __future__ import annotations

import atexit
import errno
import hashlib
import json
import os
import secrets
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from clplen.errors import DeviceError, warn_caller

VENDOR_FOLDERS = (Path("/etc/OpenCL/vendors"), Path(sys.prefix) / "etc/OpenCL/vendors")
MIN_CACHE_BYTES = 2**24  # most processes write below 5 MB, the whole test suite 23 MB
MIN_BUILD_BYTES = 2**21  # the largest program takes 0.4 MB with its source and kernels
TRIAL_BYTES = 2**19  # the largest file that PoCL writes has 0.2 MB
TRIAL_PREFIX = "clplen-trial-"  # prefix of temporary folders in PoCL's folder
REMEDY = "make it usable, or name another folder in POCL_CACHE_DIR (or XDG_CACHE_HOME)"

_lock = threading.RLock()
_tested: set[Path] = set()
_temporary: list[Path] = []  # cache of this process if the user's is not writable


def cache_dir() -> Path:
    """Return the user's cache folder for clplen, which need not exist or be writable."""
    return _base() / "clplen"


def keep_json(path: Path, values: dict[str, Any]) -> None:
    """Write a file of the cache folder atomically; do nothing if writing fails."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(values, indent=1), "utf-8")
        os.replace(temporary, path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def kernel_cache() -> Path:
    """Return the folder where PoCL stores kernels, as set by `ensure_cache`."""
    default = _base() / "pocl" / "kcache"
    return Path(os.environ.get("POCL_CACHE_DIR") or default).absolute()


def ensure_cache() -> None:
    """Test the cache folders; replace those that are not writable by a temporary folder.

    PoCL aborts the process if it cannot write a kernel or load a stored kernel, and lists no device
    without a folder; pyopencl then creates no kernel. A warning names the temporary folder, which
    is removed at the end of the process. ``$POCL_CACHE_DIR`` is always set, so that PoCL and clplen
    agree on the folder. Each folder is tested once per process.
    """
    with _lock:
        for variable, folder_of, test in (
            ("XDG_CACHE_HOME", _base, find_obstacle),
            ("POCL_CACHE_DIR", kernel_cache, _find_kernel_obstacle),
        ):
            folder = folder_of()
            problem = "" if folder in _tested else test(folder)
            if problem:
                folder = _temporary_cache(f"{folder} cannot be used ({problem})")
            if problem or variable == "POCL_CACHE_DIR":
                os.environ[variable] = str(folder)
            _tested.add(folder)


def require_room(what: str) -> None:
    """Raise a DeviceError if PoCL cannot write to its folder, which would abort the process."""
    folder = kernel_cache()
    obstacle = find_obstacle(folder, MIN_BUILD_BYTES)
    if obstacle:
        raise DeviceError(f"{what} cannot store kernels in {folder} ({obstacle}): {REMEDY}.")


def find_obstacle(folder: Path, nbytes: int = MIN_CACHE_BYTES) -> str:
    """Return the reason why a folder cannot store kernels; an empty string if it can.

    The folder is created and a file written, since a quota shows only at that moment.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(TRIAL_BYTES))
            file.flush()
        free = shutil.disk_usage(folder).free
        if hasattr(os, "ST_NOEXEC") and os.statvfs(folder).f_flag & os.ST_NOEXEC:
            return "its file system forbids to execute files"
    except OSError as error:
        return error.strerror or str(error)
    if free < nbytes:
        return f"{free / 1e6:.1f} MB are free of the {nbytes / 1e6:.1f} MB that kernels may take"
    return ""


def _find_kernel_obstacle(folder: Path) -> str:
    """Test PoCL's folder and remove damaged kernels, which PoCL then compiles again."""
    obstacle = find_obstacle(folder)
    if obstacle:
        return obstacle
    try:
        for entry in _compiled_in(os.fspath(folder)):
            with suppress(FileNotFoundError):  # another process removed it first
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                elif not (entry.is_file() and _is_complete(entry.path)):
                    os.unlink(entry.path)
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return ""


def _compiled_in(folder: str) -> Iterator[os.DirEntry[str]]:
    """Yield compiled programs and kernels; files being written begin with "tempfile_"."""
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder)
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name == "program.bc" or (name.endswith(".so") and not name.startswith("tempfile_")):
                yield entry
            elif entry.is_dir(follow_symlinks=False) and not name.startswith(TRIAL_PREFIX):
                yield from _compiled_in(entry.path)


def _is_complete(path: str) -> bool:
    """Return True if a compiled program or kernel has its whole length.

    A full disk or a power cut leaves it shorter than its header says, or with zeros at its end.
    """
    with open(path, "rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(64)
        if path.endswith(".so"):  # ELF; its table of sections is at the end
            if head[:5] != b"\x7fELF\x02":
                return head[:5] == b"\x7fELF\x01" and size > 64
            table, length, count = (
                int.from_bytes(head[begin:end], "little")
                for begin, end in ((40, 48), (58, 60), (60, 62))
            )
            end = table + length * count
            file.seek(max(end - 64, 0))
            return 64 < end <= size and any(file.read(64))
        # LLVM's bitcode: blocks, each with its length in words at its fifth byte
        offset = 4
        while head[:2] == b"BC" and offset + 8 <= size:
            file.seek(offset)
            begin = file.read(8)
            if begin[0] & 3 != 1:  # no block begins there
                return False
            offset += 8 + 4 * int.from_bytes(begin[4:], "little")
        return offset == size > 64


def _temporary_cache(reason: str) -> Path:
    """Return this process's cache folder; create it at the first call and warn."""
    with _lock:
        if _temporary:
            return _temporary[0]
        folder = Path(os.devnull, "cache")  # an impossible folder, if no other can be created
        for parent in (None, "/dev/shm", "/var/tmp"):
            with suppress(OSError):
                folder = Path(tempfile.mkdtemp(prefix="clplen-cache-", dir=parent))
                atexit.register(_remove, folder, os.getpid())
                if not find_obstacle(folder):
                    break
        _temporary.append(folder)
    warn_caller(
        f"Kernels are stored in the temporary folder {folder}, which is removed when this process "
        f"ends, because {reason}: {REMEDY}.",
        RuntimeWarning,
    )
    return folder


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() == owner:  # not a process that was forked from it
        shutil.rmtree(folder, ignore_errors=True)


def _base() -> Path:
    folder = os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    if folder.startswith("~"):
        folder = str(_temporary_cache("this user has no home folder"))
        os.environ["XDG_CACHE_HOME"] = folder
    return Path(folder).absolute()


def expose_intel_runtime() -> None:
    """Name a folder with Intel's runtime in ``OCL_ICD_VENDORS`` if necessary.

    Call it before the first platform query of the process, since the loader looks only once.
    Nothing happens if the user has chosen vendors (``OCL_ICD_VENDORS`` or ``OPENCL_VENDOR_PATH`` is
    set), if this Python environment lacks the runtime, or if an existing ICD file leads to a copy
    of it.
    """
    if os.environ.get("OCL_ICD_VENDORS") or os.environ.get("OPENCL_VENDOR_PATH"):
        return
    intel = _intel_library()
    drivers = _known_drivers()
    if intel is None or any(Path(name).name.startswith("libintelocl.so") for name in drivers):
        return
    os.environ["OCL_ICD_VENDORS"] = str(_vendor_folder([str(intel), *drivers]))


def _intel_library() -> Path | None:
    """Return the path of ``libintelocl.so`` in this Python environment, or None."""
    candidates = [Path(sys.prefix) / "lib" / "libintelocl.so"]
    try:
        installed = metadata.distribution("intel-opencl-rt").files or []
    except metadata.PackageNotFoundError:
        installed = []
    candidates += [Path(str(f.locate())) for f in installed if f.name == "libintelocl.so"]
    return next((candidate.resolve() for candidate in candidates if candidate.is_file()), None)


def _known_drivers() -> list[str]:
    """Return the libraries that the machine's ICD files name, without dead paths."""
    files = [file for folder in VENDOR_FOLDERS for file in sorted(folder.glob("*.icd"))]
    names = [file.read_text(errors="replace").strip() for file in files if os.access(file, os.R_OK)]
    return [name for name in names if name and (not os.path.isabs(name) or os.path.isfile(name))]


def _vendor_folder(drivers: list[str]) -> Path:
    """Return a folder of ICD files for the drivers; create it if there is none.

    It is renamed when complete, for other processes. Without a cache it is temporary.
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
