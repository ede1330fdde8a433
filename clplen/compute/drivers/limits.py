"""Memory that the process may still take: of the computer, of control groups, within ulimits.

Beyond the limit of a control group (containers, batch systems) the kernel ends the process. Beyond
a limit of address space (``ulimit -v``) or of data (``ulimit -d``) an allocation fails, which
OpenCL drivers and their compilers do not survive. So sizes are compared with limits beforehand.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from clplen.errors import DeviceError

try:
    import resource
except ImportError:  # Windows, which has no such limits
    resource = None  # type: ignore[assignment]

# PoCL 3 on two cores, no kernel compiled yet: loading it takes 300 MiB of address space, each
# core's thread a stack, and the first build 120 MiB (and 115 MiB resident); later builds 6 MiB.
DRIVER_BYTES = 300 * 2**20
MIN_STACK_BYTES = 2**23
FIRST_BUILD_BYTES = 160 * 2**20
BUILD_BYTES = 32 * 2**20
RESERVE_BYTES = 192 * 2**20  # left by arrays, within a limit of address space or of data
GROUP_RESERVE_BYTES = 2**26  # left by arrays, within the limit of a control group
MIN_MACHINE_BYTES = 2**26
_MAX_GROUP_BYTES = 2**60  # of a limit that is one: version 1 writes 2**63 less a page for none
_MAX_FILE_BYTES = 2**15
_GROUPS = Path("/sys/fs/cgroup")


class Room(NamedTuple):
    """Bytes that may still be taken, and the limit that says so, as the subject of a sentence."""

    nbytes: int
    limit: str


_UNLIMITED = Room(sys.maxsize, "")


def process_room() -> Room:
    """Bytes left within the limits of address space and of data of this process."""
    if resource is None:
        return _UNLIMITED
    limits = (
        (resource.RLIMIT_AS, 0, "address space (ulimit -v)"),
        (resource.RLIMIT_DATA, 5, "data (ulimit -d)"),
    )
    known = [(resource.getrlimit(which)[0], place, name) for which, place, name in limits]
    if all(limit == resource.RLIM_INFINITY for limit, _, _ in known):
        return _UNLIMITED
    try:
        pages = _read(Path("/proc/self/statm")).split()
    except OSError:
        return _UNLIMITED
    size = resource.getpagesize()
    return min(
        (
            Room(
                limit - int(pages[place]) * size, f"the process's limit of {name}, {limit:,} bytes,"
            )
            for limit, place, name in known
            if limit != resource.RLIM_INFINITY
        ),
        default=_UNLIMITED,
    )


def group_room() -> Room:
    """Bytes left within the limits of the control groups that the process belongs to."""
    room = _UNLIMITED
    for folder, limit, usage, reclaimable in _groups():
        try:
            most = int(_read(folder / limit))
            used = int(_read(folder / usage))
            pairs = (line.split() for line in _read(folder / "memory.stat").splitlines())
            used -= next((int(pair[1]) for pair in pairs if pair[0] == reclaimable), 0)
        except (OSError, ValueError):  # "max" since
            continue
        room = min(
            room, Room(most - used, f"the memory limit of the control group, {most:,} bytes,")
        )
    return room


def machine_room(*, swap: bool) -> Room:
    """Bytes of the computer's memory that are free, where the system says how much."""
    names = ("MemAvailable:", "SwapFree:") if swap else ("MemAvailable:",)
    try:
        lines = (line.split() for line in _read(Path("/proc/meminfo")).splitlines())
        found = [int(line[1]) for line in lines if line[0] in names]
    except (OSError, ValueError, IndexError):
        found = []
    if found:
        return Room(1024 * sum(found), "the computer's memory")
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _UNLIMITED
    return Room(free, "the computer's memory") if free > 0 and not swap else _UNLIMITED


def array_room(nbytes: int) -> Room:
    """Bytes that arrays may take: less what libraries, threads and compilers are left."""
    process, group = process_room(), group_room()
    room = min(
        Room(process.nbytes - RESERVE_BYTES, process.limit),
        Room(group.nbytes - GROUP_RESERVE_BYTES, group.limit),
    )
    return room if nbytes < MIN_MACHINE_BYTES else min(room, machine_room(swap=True))


def require_driver_room() -> None:
    """Refuse to load OpenCL drivers where they would end the process."""
    stacks = MIN_STACK_BYTES * (os.cpu_count() or 1)
    _require(DRIVER_BYTES + stacks, process_room(), "Loading the OpenCL drivers")


def require_build_room(what: str, *, first: bool) -> None:
    """Refuse to run a driver's compiler where it would end the process."""
    room = min(process_room(), group_room()) if first else process_room()
    _require(FIRST_BUILD_BYTES if first else BUILD_BYTES, room, what)


def _require(nbytes: int, room: Room, what: str) -> None:
    if nbytes > room.nbytes:
        raise DeviceError(
            f"{what} needs {nbytes:,} bytes, but {room.limit} leaves {max(room.nbytes, 0):,}: "
            "raise the limit, or use smaller arrays."
        )


@cache
def _groups() -> list[tuple[Path, str, str, str]]:
    """Folders of the control groups that have a limit, with the names of their numbers.

    Inside a container the path of the group may be the host's, and the group's files lie at the
    top.
    """
    found = []
    for base, path, limit, usage, reclaimable in _hierarchies():
        inner = base / path.strip("/")
        for folder in dict.fromkeys((inner, *inner.parents, base)):
            if not folder.is_relative_to(base):
                continue
            try:
                if int(_read(folder / limit)) < _MAX_GROUP_BYTES:
                    found.append((folder, limit, usage, reclaimable))
            except (OSError, ValueError):  # no such file, or "max"
                continue
    return found


def _hierarchies() -> Iterator[tuple[Path, str, str, str, str]]:
    """Hierarchies that bound memory: top, path of the group, names of limit and usage."""
    try:
        lines = _read(Path("/proc/self/cgroup")).splitlines()
    except OSError:
        return
    for line in lines:
        number, controllers, path = line.split(":", 2)
        if number == "0":
            yield _GROUPS, path, "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            yield (_GROUPS / "memory", path, *names)


def _read(path: Path) -> str:
    """A file of the kernel's, unbuffered: this is done before every large allocation."""
    file = os.open(path, os.O_RDONLY)
    try:
        return os.read(file, _MAX_FILE_BYTES).decode("ascii")
    finally:
        os.close(file)
