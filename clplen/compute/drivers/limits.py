"""Memory that the process may still allocate, by the computer, control groups and ulimits.

Above the limit of a control group (containers, batch systems) Linux kills the process. Above a
limit of address space (``ulimit -v``) or data (``ulimit -d``) an allocation fails, which crashes
OpenCL drivers and their compilers. Sizes are therefore compared with the limits in advance.
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

# Measured with PoCL 3 on two cores and an empty kernel cache: loading takes 300 MiB of address
# space and a stack for each core, the first build 120 MiB (115 MiB resident), later builds 6 MiB.
DRIVER_BYTES = 300 * 2**20
MIN_STACK_BYTES = 2**23
FIRST_BUILD_BYTES = 160 * 2**20
BUILD_BYTES = 32 * 2**20
RESERVE_BYTES = 192 * 2**20  # never given to arrays under a limit of address space or data
GROUP_RESERVE_BYTES = 2**26  # never given to arrays under the limit of a control group
MIN_MACHINE_BYTES = 2**26  # arrays below this size are not compared with the computer's memory
_MAX_GROUP_BYTES = 2**60  # larger values mean no limit: version 1 writes 2**63 less a page
_MAX_FILE_BYTES = 2**15
_GROUPS = Path("/sys/fs/cgroup")


class Room(NamedTuple):
    """Bytes that may still be allocated, and the limit, worded as the subject of a sentence."""

    nbytes: int
    limit: str


_UNLIMITED = Room(sys.maxsize, "")


def process_room() -> Room:
    """Return the bytes left within this process's limits of address space and data."""
    if resource is None:
        return _UNLIMITED
    limits = (
        (resource.RLIMIT_AS, 0, "address space (ulimit -v)"),
        (resource.RLIMIT_DATA, 5, "data (ulimit -d)"),
    )
    limits_in_force = [
        (resource.getrlimit(which)[0], column, name) for which, column, name in limits
    ]
    if all(limit == resource.RLIM_INFINITY for limit, _, _ in limits_in_force):
        return _UNLIMITED
    try:
        pages = _read(Path("/proc/self/statm")).split()
    except OSError:
        return _UNLIMITED
    size = resource.getpagesize()
    return min(
        (
            Room(
                limit - int(pages[column]) * size,
                f"the process's limit of {name}, {limit:,} bytes,",
            )
            for limit, column, name in limits_in_force
            if limit != resource.RLIM_INFINITY
        ),
        default=_UNLIMITED,
    )


def group_room() -> Room:
    """Return the bytes left within the limits of this process's control groups."""
    room = _UNLIMITED
    for folder, limit, usage, reclaimable in _groups():
        try:
            maximum = int(_read(folder / limit))
            used = int(_read(folder / usage))
            pairs = (line.split() for line in _read(folder / "memory.stat").splitlines())
            used -= next((int(pair[1]) for pair in pairs if pair[0] == reclaimable), 0)
        except (OSError, ValueError):  # "max" since the list was made
            continue
        room = min(
            room, Room(maximum - used, f"the memory limit of the control group, {maximum:,} bytes,")
        )
    return room


def machine_room(*, swap: bool) -> Room:
    """Return the free bytes of the computer's memory, as far as the system reports them."""
    names = ("MemAvailable:", "SwapFree:") if swap else ("MemAvailable:",)
    try:
        lines = (line.split() for line in _read(Path("/proc/meminfo")).splitlines())
        sizes = [int(line[1]) for line in lines if line[0] in names]
    except (OSError, ValueError, IndexError):
        sizes = []
    if sizes:
        return Room(1024 * sum(sizes), "the computer's memory")
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _UNLIMITED
    return Room(free, "the computer's memory") if free > 0 and not swap else _UNLIMITED


def array_room(nbytes: int) -> Room:
    """Return the bytes that arrays may take; a reserve is left to libraries and compilers."""
    process, group = process_room(), group_room()
    room = min(
        Room(process.nbytes - RESERVE_BYTES, process.limit),
        Room(group.nbytes - GROUP_RESERVE_BYTES, group.limit),
    )
    return room if nbytes < MIN_MACHINE_BYTES else min(room, machine_room(swap=True))


def require_driver_room() -> None:
    """Raise a DeviceError if loading OpenCL drivers would end the process."""
    stacks = MIN_STACK_BYTES * (os.cpu_count() or 1)
    _require(DRIVER_BYTES + stacks, process_room(), "Loading the OpenCL drivers")


def require_build_room(what: str, *, first: bool) -> None:
    """Raise a DeviceError if a driver's compiler would end the process."""
    room = min(process_room(), group_room()) if first else process_room()
    _require(FIRST_BUILD_BYTES if first else BUILD_BYTES, room, what)


def _require(nbytes: int, room: Room, what: str) -> None:
    if nbytes > room.nbytes:
        raise DeviceError(
            f"{what} needs {nbytes:,} bytes, but {room.limit} leaves {max(room.nbytes, 0):,}: "
            "raise the limit or use smaller arrays."
        )


@cache
def _groups() -> list[tuple[Path, str, str, str]]:
    """List (folder, limit file, usage file, reclaimable key) of control groups that have a limit.

    Inside a container the path may be the host's; the group's files are then at the top.
    """
    groups = []
    for base, path, limit, usage, reclaimable in _hierarchies():
        inner = base / path.strip("/")
        for folder in dict.fromkeys((inner, *inner.parents, base)):
            if not folder.is_relative_to(base):
                continue
            try:
                if int(_read(folder / limit)) < _MAX_GROUP_BYTES:
                    groups.append((folder, limit, usage, reclaimable))
            except (OSError, ValueError):  # no such file, or "max"
                continue
    return groups


def _hierarchies() -> Iterator[tuple[Path, str, str, str, str]]:
    """Yield the hierarchies that limit memory: top, path of the group, names of its files."""
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
    """Read a file of the kernel without a buffer, as every large allocation does."""
    file = os.open(path, os.O_RDONLY)
    try:
        return os.read(file, _MAX_FILE_BYTES).decode("ascii")
    finally:
        os.close(file)
