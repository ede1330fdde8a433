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
MIN_CACHE_BYTES = 2**24  # a process with all kernels of the test suite writes 23 MB, few write 5
MIN_BUILD_BYTES = 2**21  # the largest program takes 0.4 MB with its source and kernels
TRIAL_BYTES = 2**19  # the largest file that PoCL writes has 0.2 MB
TRIAL_PREFIX = "clplen-trial-"  # of folders in PoCL's own, which come and go
REMEDY = "make it usable, or name another folder in POCL_CACHE_DIR (or XDG_CACHE_HOME)"

_lock = threading.RLock()
_tested: set[Path] = set()
_temporary: list[Path] = []  # of this process, where the user's take no files


def cache_dir() -> Path:
    """Name the user's cache folder for clplen; it need not exist or be writable."""
    return _base() / "clplen"


def keep_json(path: Path, values: dict[str, Any]) -> None:
    """Write a file of the cache folder as a whole; where nothing can be written, do nothing."""
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(values, indent=1), "utf-8")
        os.replace(temporary, path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def kernel_cache() -> Path:
    """Name the folder where PoCL keeps kernels, as `ensure_cache` left it."""
    default = _base() / "pocl" / "kcache"
    return Path(os.environ.get("POCL_CACHE_DIR") or default).absolute()


def ensure_cache() -> None:
    """Test the cache folders, and replace those that take no files by a temporary one.

    PoCL aborts the process where it cannot write a kernel or load a kept one, and shows no device
    without a folder; pyopencl makes no kernel. The temporary folder is removed at the end of the
    process, and one warning names it. PoCL reads ``$POCL_CACHE_DIR``, which is set in any case, so
    that one rule decides where it writes. Folders are tested once a process.
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
    """Refuse to let PoCL write where it cannot: it would abort the process."""
    folder = kernel_cache()
    obstacle = find_obstacle(folder, MIN_BUILD_BYTES)
    if obstacle:
        raise DeviceError(f"{what} cannot keep kernels in {folder} ({obstacle}): {REMEDY}.")


def find_obstacle(folder: Path, nbytes: int = MIN_CACHE_BYTES) -> str:
    """Return why kernels cannot be kept in a folder; the empty string if they can.

    The folder is made, and a file is written, because a quota shows at that moment only.
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
    """Test PoCL's folder; remove damaged kernels from it, which PoCL then compiles again."""
    obstacle = find_obstacle(folder)
    if obstacle:
        return obstacle
    try:
        for entry in _compiled_in(os.fspath(folder)):
            with suppress(FileNotFoundError):  # where another process was first to remove it
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                elif not (entry.is_file() and _is_whole(entry.path)):
                    os.unlink(entry.path)
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return ""


def _compiled_in(folder: str) -> Iterator[os.DirEntry[str]]:
    """Yield compiled programs and kernels; what is being written begins with "tempfile_"."""
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), folder)
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name == "program.bc" or (name.endswith(".so") and not name.startswith("tempfile_")):
                yield entry
            elif entry.is_dir(follow_symlinks=False) and not name.startswith(TRIAL_PREFIX):
                yield from _compiled_in(entry.path)


def _is_whole(path: str) -> bool:
    """Whether a compiled program or kernel has its head and its end.

    PoCL writes under another name and renames, so that no other process sees a part; what a full
    disk or a power cut leaves is shorter than its head says, or zero at the end.
    """
    with open(path, "rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(64)
        if path.endswith(".so"):  # ELF; its table of sections stands at the end
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
        place = 4
        while head[:2] == b"BC" and place + 8 <= size:
            file.seek(place)
            begin = file.read(8)
            if begin[0] & 3 != 1:  # no block begins there
                return False
            place += 8 + 4 * int.from_bytes(begin[4:], "little")
        return place == size > 64


def _temporary_cache(reason: str) -> Path:
    """Return this process's own cache folder, which is made once, with a warning that names it."""
    with _lock:
        if _temporary:
            return _temporary[0]
        folder = Path(os.devnull, "cache")  # which cannot be made, if no other can
        for place in (None, "/dev/shm", "/var/tmp"):
            with suppress(OSError):
                folder = Path(tempfile.mkdtemp(prefix="clplen-cache-", dir=place))
                atexit.register(_remove, folder, os.getpid())
                if not find_obstacle(folder):
                    break
        _temporary.append(folder)
    warn_caller(
        f"Kernels are kept in the temporary folder {folder}, which is removed when this process "
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
