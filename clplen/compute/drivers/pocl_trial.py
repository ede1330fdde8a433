"""Try PoCL under a CPU name: a program for a child process, which an unfit name kills.

pocl.py starts it and reads its exit status: 0 where every built-in function that clplen's kernels
call builds, runs and is right, `UNFIT` where one does not. Before them a kernel without any is run,
and "ready" printed: a child that dies earlier lacks a linker, memory or room for files, which says
nothing about the name.
"""

from __future__ import annotations

import ctypes
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from clplen.compute.drivers import builtin_functions

Pointer = ctypes.c_uint64
SEARCHED_BYTES = 1024
SECONDS = 15  # of computing; a compiler that was given an unfit name may never end
UNFIT = 3  # exit status, other than those of Python itself
READY = b"ready"
HEADROOM = 2**28  # bytes of address space that a trial takes
_TRIPLE = re.compile(rb"x86_64-[a-z0-9_-]+\Z")
_NAME = re.compile(rb"[a-z0-9][a-z0-9_.-]{1,30}\Z")
_LONGEST = 64
_PLAIN = "kernel void builtins(global float *a, const int n) { a[0] = n; }"


def find_name(address: int) -> Pointer | None:
    """Find the pointer to the name of the CPU in a device object of PoCL on x86-64.

    PoCL 3 keeps two strings one behind the other, the target of its compiler, as
    ``x86_64-unknown-linux-gnu``, and the name of the CPU. Nothing is read beyond the first
    kilobyte, behind which another device's object may lie, or outside of mapped memory.
    """
    readable, writable = _mapped_memory()
    end = next((end for begin, end in writable if begin <= address < end), address)
    for at in range(address, min(address + SEARCHED_BYTES, end) - 15, 8):
        triple = _text(ctypes.c_uint64.from_address(at).value, readable)
        pointer = Pointer.from_address(at + 8)
        if _TRIPLE.match(triple) and _NAME.match(_text(pointer.value, writable)):
            return pointer
    return None


def read_name(pointer: Pointer) -> str:
    """Read the name that a pointer of `find_name` leads to."""
    return ctypes.string_at(pointer.value).decode("ascii")


def write_name(pointer: Pointer, name: str) -> None:
    """Let the pointer lead to another name, which the C library makes, as PoCL does."""
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    pointer.value = strdup(name.encode("ascii"))


def _mapped_memory() -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """List the readable and the writable mappings of this process, as (begin, end)."""
    readable, writable = [], []
    for line in Path("/proc/self/maps").read_text(errors="replace").splitlines():
        span, rights = line.split()[:2]
        begin, end = (int(word, 16) for word in span.split("-"))
        if rights.startswith("r"):
            readable.append((begin, end))
        if rights.startswith("rw"):
            writable.append((begin, end))
    return readable, writable


def _text(address: int, memory: list[tuple[int, int]]) -> bytes:
    """Read the string at an address; it is empty where none ends soon."""
    end = next((end for begin, end in memory if begin <= address < end), address)
    text, zero, _ = ctypes.string_at(address, min(_LONGEST, end - address)).partition(b"\0")
    return text if zero else b""


def main(version: str, name: str, source: str) -> None:
    """Give PoCL's device a CPU name and compare every built-in function with its value."""
    import mmap
    import resource

    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    with suppress(ValueError):  # a limit of the user's ends it earlier, by SIGKILL
        # below the hard limit: by SIGXCPU, which no other process sends
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    device = next(p for p in cl.get_platforms() if p.version == version).get_devices()[0]
    mmap.mmap(-1, HEADROOM).close()
    pointer = find_name(device.int_ptr)
    if pointer is None:
        sys.exit("PoCL's device holds no CPU name that can be found.")
    write_name(pointer, name)
    double = "cl_khr_fp64" in device.extensions
    y = np.empty((len(builtin_functions.expected(double=double)), builtin_functions.COUNT), "f")
    try:
        _run(device, _PLAIN, np.empty(1, "f"))
        print(READY.decode(), flush=True)
        options = ["-DDOUBLE"] if double else []
        _run(device, Path(source).read_text(), y, *builtin_functions.inputs(), options=options)
    except cl.MemoryError:
        raise
    except cl.Error as refusal:
        print(refusal, file=sys.stderr, flush=True)
        sys.exit(UNFIT)
    if wrong := builtin_functions.wrong(y, double=double):
        print(f"Wrong values: {'; '.join(wrong)}.", file=sys.stderr, flush=True)
        sys.exit(UNFIT)


def _run(device: Any, source: str, y: Any, *inputs: Any, options: list[str] | None = None) -> None:
    """Build the kernel ``builtins``, run one item and fill `y` with what it writes."""
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    flags = ["-cl-std=CL1.2", "-cl-mad-enable", "-w", *(options or [])]
    kernel = cl.Kernel(cl.Program(context, source).build(flags), "builtins")
    copied = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(context, copied, hostbuf=values) for values in (y, *inputs)]
    kernel(queue, (1,), (1,), *buffers, np.int32(builtin_functions.COUNT))
    cl.enqueue_copy(queue, y, buffers[0])


if __name__ == "__main__":
    main(*sys.argv[1:])
