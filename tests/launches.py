"""Kernels as their files declare them, beside what their launchers give."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla

from clplen.compute.launcher import Launcher

FOLDER = Path(__file__).parents[1] / "kernels"
SOURCES = {file.name: file.read_text() for file in sorted(FOLDER.rglob("*.cl"))}
COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
KERNEL = re.compile(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(([^)]*)\)")
ARGUMENT = re.compile(
    r"(?:[A-Z]+\s+)*(__local\s+)?(?:(?:__global|global|const)\s+)*(\w+)\s*(\*?).*?(\w+)$"
)
NAMES = {"int": "i4", "uint": "u4", "long": "i8", "uchar": "u1", "ushort": "u2"}
NAMES |= {"half": "f2", "float": "f4", "double": "f8"}


def code(source: str) -> str:
    """A source without its comments."""
    return COMMENT.sub(" ", source)


def opening(source: str) -> str:
    """The comment that a file opens with, empty if there is none."""
    match = COMMENT.match(source)
    return match[0] if match else ""


@cache
def declared(file: str) -> dict[str, list[tuple[str, str]]]:
    """Kernels of a file with (type, name) of each argument; a type in capitals is a macro's."""
    return {
        name: [
            (f"local {kind}{star}" if local else f"{kind}{star}", argument)
            for local, kind, star, argument in (
                ARGUMENT.match(" ".join(text.split())).groups() for text in arguments.split(",")
            )
        ]
        for name, arguments in KERNEL.findall(code(SOURCES[file]))
    }


def home(file: str, kernel: str) -> str:
    """The file that declares a kernel: that of its program, or one that this includes."""
    files = [file, *re.findall(r'#include "(.+)"', SOURCES[file])]
    return next(one for one in files if kernel in declared(one))


def fits(kind: str, arg: Any, defines: dict[str, Any]) -> bool:
    """Whether an argument is what a kernel declares, with the build's definitions."""
    if kind.startswith("local ") or isinstance(arg, cl.LocalMemory):
        return kind.startswith("local ") and isinstance(arg, cl.LocalMemory)
    if kind.endswith("*") != isinstance(arg, cla.Array):
        return False
    real = "double" if "DOUBLE" in defines else "half" if "HALF" in defines else "float"
    base = str(defines.get(kind.rstrip("*"), kind.rstrip("*")))
    base = base.replace("cplx", "real2").replace("real", real)
    scalar, width = re.fullmatch(r"(\w+?)(\d*)", base).groups()
    if scalar not in NAMES:  # another macro's
        return True
    if not isinstance(arg, cla.Array | np.generic | np.ndarray):
        return type(arg) is int and base == "int"
    dtype, size = np.dtype(NAMES[scalar]), int(width or 1)
    if size == 2 and arg.dtype.kind == "c":
        return arg.dtype == np.dtype(f"c{2 * dtype.itemsize}")
    vectors = size == 1 or (arg.ndim > 0 and arg.shape[-1] == size)
    return arg.dtype == dtype and vectors and (isinstance(arg, cla.Array) or arg.size == size)


def complaints(
    file: str, kernel: str, args: tuple[Any, ...], defines: dict[str, Any]
) -> Iterator[str]:
    """Yield what an OpenCL compiler would say of a launch if it saw both sides."""
    for define in defines:
        if define not in ("ROWS", "DOUBLE") and f"-D{define}" not in opening(SOURCES[file]):
            yield f"{file} does not describe -D{define}"
    if "LENSLETS" in defines:  # tables of warp.cl, which a macro declares
        return
    parameters = declared(home(file, kernel))[kernel]
    if len(parameters) != len(args):
        yield f"{kernel} takes {len(parameters)} arguments, not {len(args)}"
        return
    for (kind, name), arg in zip(parameters, args, strict=True):
        if not fits(kind, arg, defines):
            given = f"{type(arg).__name__} {getattr(arg, 'dtype', '')}{getattr(arg, 'shape', '')}"
            yield f"{kernel} declares {kind} {name} and is given {given}"


def watch() -> None:
    """Compare the arguments of every launch from now on with what its kernel declares."""
    build, launch = Launcher.kernel, Launcher.launch
    judged: set[tuple[Any, ...]] = set()

    def kernel(self: Launcher, file: str, name: str, **defines: Any) -> cl.Kernel:
        built = build(self, file, name, **defines)
        self.__dict__.setdefault("_built", {})[built] = (file, name, tuple(defines.items()))
        return built

    def checked(self: Launcher, built: cl.Kernel, size: Any, *args: Any, **more: Any) -> None:
        known = self.__dict__.get("_built", {}).get(built)
        if known is not None and known[0] in SOURCES:
            signature = (*known, *map(_signature, args))
            if signature not in judged:
                file, name, defines = known
                assert list(complaints(file, name, args, dict(defines))) == []
                judged.add(signature)
        launch(self, built, size, *args, **more)

    Launcher.kernel, Launcher.launch = kernel, checked  # type: ignore[method-assign]


def _signature(arg: Any) -> tuple[Any, ...]:
    """What `fits` looks at."""
    last = arg.shape[-1] if getattr(arg, "ndim", 0) else 0
    return type(arg), getattr(arg, "dtype", None), last if last <= 16 else 0
