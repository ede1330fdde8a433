"""Try PoCL under a CPU name: a program for a child process, which an unfit name kills.

It needs the standard library alone and speaks to PoCL's library without an OpenCL loader, so that
it starts in a few hundredths of a second. pocl.py starts it and reads its exit status: 0 where
every built-in function that clplen's kernels call builds, runs and is right, `UNFIT` where one does
not. Before them a kernel without any is run, and "ready" printed: a child that dies earlier lacks a
linker, memory or room for files, which says nothing about the name.

OpenCL's functions are reached as a loader reaches them: the first word of a platform is the
address of a table of functions, in the order of ``cl_icd.h`` (Khronos, cl_khr_icd).
"""

from __future__ import annotations

import ctypes
import re
import sys
from array import array
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

Pointer = ctypes.c_uint64
SEARCHED_BYTES = 1024
SECONDS = 15  # of computing; a compiler that was given an unfit name may never end
UNFIT = 3  # exit status, other than those of Python itself
READY = b"ready"
HEADROOM = 2**28  # bytes of address space beside PoCL's own; a trial takes 0.4e9 in all
_TRIPLE = re.compile(rb"x86_64-[a-z0-9_-]+\Z")
_NAME = re.compile(rb"[a-z0-9][a-z0-9_.-]{1,30}\Z")
_LONGEST = 64
_OPTIONS = b"-cl-std=CL1.2 -cl-mad-enable -w"
# Places of the functions in the table of cl_icd.h.
_TABLE = {
    "clGetDeviceIDs": 2,
    "clGetDeviceInfo": 3,
    "clCreateContext": 4,
    "clCreateCommandQueue": 9,
    "clCreateBuffer": 14,
    "clCreateProgramWithSource": 26,
    "clBuildProgram": 30,
    "clCreateKernel": 34,
    "clSetKernelArg": 38,
    "clEnqueueReadBuffer": 48,
    "clEnqueueNDRangeKernel": 59,
}
_DEVICE_TYPE_ALL = 0xFFFFFFFF
_DEVICE_EXTENSIONS = 0x1030
_MEM_COPY_HOST_PTR = 1 << 5
_MEMORY = (-4, -5, -6)  # statuses of a want of memory
_PLAIN = b"kernel void builtins(global float *a, const int n) { a[0] = n; }"


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
    """The name that a pointer of `find_name` leads to."""
    return ctypes.string_at(pointer.value).decode("ascii")


def write_name(pointer: Pointer, name: str) -> None:
    """Let the pointer lead to another name.

    The new string is the C library's and never freed here, as PoCL would have made it itself.
    """
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    pointer.value = strdup(name.encode("ascii"))


def table_of(platform: int) -> ctypes.Array[ctypes.c_uint64]:
    """The addresses of OpenCL's functions, in the order of ``cl_icd.h``."""
    address = ctypes.c_uint64.from_address(platform).value
    return (ctypes.c_uint64 * (max(_TABLE.values()) + 1)).from_address(address)


def _mapped_memory() -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """The readable and the writable mappings of this process, as (begin, end)."""
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
    """The string at an address, empty where there is none that ends soon."""
    end = next((end for begin, end in memory if begin <= address < end), address)
    text, zero, _ = ctypes.string_at(address, min(_LONGEST, end - address)).partition(b"\0")
    return text if zero else b""


class _RefusalError(Exception):
    """A step that OpenCL refuses, but not for want of memory."""


class _PoCL:
    """The functions of PoCL's library for its first device."""

    def __init__(self, library: str) -> None:
        entry = ctypes.CDLL(library).clGetExtensionFunctionAddress
        entry.restype = ctypes.c_void_p
        platforms_of = ctypes.CFUNCTYPE(ctypes.c_int)(entry(b"clIcdGetPlatformIDsKHR"))
        platform = ctypes.c_void_p()
        platforms_of.argtypes = [ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p]
        _require(platforms_of(1, ctypes.byref(platform), None))
        if platform.value is None:
            raise RuntimeError("PoCL shows no platform")
        self.table = table_of(platform.value)
        device = ctypes.c_void_p()
        _require(
            self.call(
                "clGetDeviceIDs",
                platform,
                ctypes.c_uint64(_DEVICE_TYPE_ALL),
                1,
                ctypes.byref(device),
                None,
            )
        )
        if device.value is None:
            raise RuntimeError("PoCL shows no device")
        self.device, self.address = device, device.value

    def call(self, name: str, *args: Any, result: Any = ctypes.c_int) -> Any:
        """Call a function of the table."""
        return ctypes.CFUNCTYPE(result)(self.table[_TABLE[name]])(*args)

    def create(self, name: str, *args: Any) -> ctypes.c_void_p:
        """Call a function that creates something and tells an error through its last argument."""
        error = ctypes.c_int()
        made = self.call(name, *args, ctypes.byref(error), result=ctypes.c_void_p)
        _require(error.value)
        return ctypes.c_void_p(made)

    def has_double(self) -> bool:
        """Whether the device computes in double precision."""
        words = ctypes.create_string_buffer(4096)
        size = ctypes.c_size_t(len(words))
        _require(self.call("clGetDeviceInfo", self.device, _DEVICE_EXTENSIONS, size, words, None))
        return b"cl_khr_fp64" in words.value

    def run(
        self, source: bytes, inputs: list[bytes], count: int, size: int, options: bytes
    ) -> bytes:
        """Build the kernel ``builtins``, run one item and read the `size` bytes that it writes."""
        device = ctypes.byref(self.device)
        context = self.create("clCreateContext", None, 1, device, None, None)
        queue = self.create("clCreateCommandQueue", context, self.device, ctypes.c_uint64(0))
        text = ctypes.c_char_p(source)
        program = self.create("clCreateProgramWithSource", context, 1, ctypes.byref(text), None)
        _require(self.call("clBuildProgram", program, 1, device, options, None, None))
        kernel = self.create("clCreateKernel", program, b"builtins")
        held = [
            self.create(
                "clCreateBuffer",
                context,
                ctypes.c_uint64(_MEM_COPY_HOST_PTR),
                ctypes.c_size_t(len(data)),
                data,
            )
            for data in (bytes(size), *inputs)
        ]
        for place, value in enumerate([*held, ctypes.c_int(count)]):
            length = ctypes.c_size_t(ctypes.sizeof(value))
            _require(self.call("clSetKernelArg", kernel, place, length, ctypes.byref(value)))
        one = ctypes.byref(ctypes.c_size_t(1))
        _require(
            self.call("clEnqueueNDRangeKernel", queue, kernel, 1, None, one, one, 0, None, None)
        )
        result = ctypes.create_string_buffer(size)
        _require(
            self.call(
                "clEnqueueReadBuffer",
                queue,
                held[0],
                1,
                ctypes.c_size_t(0),
                ctypes.c_size_t(size),
                result,
                0,
                None,
                None,
            )
        )
        return result.raw


def _require(status: int) -> None:
    if status in _MEMORY:
        raise MemoryError(f"OpenCL error {status}")
    if status:
        raise _RefusalError(f"OpenCL error {status}")


def main(library: str, name: str, source: str) -> None:
    """Give PoCL's device a CPU name and compare every built-in function with its value."""
    import mmap
    import resource

    functions: Any = import_module("builtin_functions")  # it lies beside this file

    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    with suppress(ValueError):  # a limit of the user's ends it earlier, by SIGKILL
        # below the hard limit: by SIGXCPU, which no other process sends
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pocl = _PoCL(library)
    mmap.mmap(-1, HEADROOM).close()
    if name:
        pointer = find_name(pocl.address)
        if pointer is None:
            sys.exit("PoCL's device holds no CPU name that can be found.")
        write_name(pointer, name)
    try:
        pocl.run(_PLAIN, [], 1, 4, _OPTIONS)
        print(READY.decode(), flush=True)
        double = pocl.has_double()
        x, *samples = functions.inputs()
        size = 4 * functions.COUNT * len(functions.expected(double=double))
        options = _OPTIONS + (b" -DDOUBLE" if double else b"")
        values = array("f")
        inputs = [x.tobytes(), *samples]
        text = Path(source).read_bytes()
        values.frombytes(pocl.run(text, inputs, functions.COUNT, size, options))
        wrong = functions.wrong(values, double=double)
        if wrong:
            raise _RefusalError(f"Wrong values: {'; '.join(wrong)}.")
    except _RefusalError as refusal:
        print(refusal, file=sys.stderr, flush=True)
        sys.exit(UNFIT)


if __name__ == "__main__":
    # At the end, so that no module beside this one takes the place of one of Python's own.
    sys.path.append(str(Path(__file__).parent))
    main(*sys.argv[1:])
