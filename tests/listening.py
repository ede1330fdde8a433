"""Which addresses the processes of a program listen on, as Linux tells it."""

from __future__ import annotations

import os
import socket
import sys
from contextlib import suppress
from pathlib import Path

LISTEN = "0A"  # state of a socket in /proc/net/tcp


def own_address() -> str:
    """An address of this computer beyond the loopback interface; 127.0.0.2 where it has none."""
    with suppress(OSError), socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.connect(("198.51.100.1", 9))  # sends nothing: it only chooses an address
        return str(probe.getsockname()[0])
    return "127.0.0.2"


def listening(pid: int) -> set[tuple[int, str, int]]:
    """(process, address, port) of every socket on which a process or its descendants listen."""
    table = _table()
    found = set()
    for process in (pid, *_below(pid)):
        for inode in _inodes(process):
            if inode in table:
                found.add((process, *table[inode]))
    return found


def _below(pid: int) -> list[int]:
    """All processes below one."""
    found = []
    with suppress(OSError):  # it has just ended, or one of its threads has
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                found += [int(child), *_below(int(child))]
    return found


def _inodes(pid: int) -> list[str]:
    """Of all sockets of a process."""
    try:
        entries = [os.readlink(entry) for entry in Path(f"/proc/{pid}/fd").iterdir()]
    except OSError:  # it has just ended, or closed a file
        return []
    return [entry[8:-1] for entry in entries if entry.startswith("socket:[")]


def _table() -> dict[str, tuple[str, int]]:
    """Inode -> address and port of all TCP sockets that listen."""
    table = {}
    for name in ("tcp", "tcp6"):
        for line in Path("/proc/net", name).read_text().splitlines()[1:]:
            words = line.split()
            if words[3] == LISTEN:
                table[words[9]] = _address(words[1])
    return table


def _address(text: str) -> tuple[str, int]:
    """Address and port; the address stands in words of 32 bits of this computer's byte order."""
    words, port = text.split(":")
    numbers = [int(words[i : i + 8], 16) for i in range(0, len(words), 8)]
    packed = b"".join(number.to_bytes(4, sys.byteorder) for number in numbers)
    family = socket.AF_INET if len(packed) == 4 else socket.AF_INET6
    return socket.inet_ntop(family, packed), int(port, 16)
