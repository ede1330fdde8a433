"""Kernel sources: located, expanded and built, with errors that name the line of the file."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pyopencl as cl

from clplen.compute.drivers.failures import ADVICE
from clplen.errors import KernelBuildError

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
_PACKAGE = Path(__file__).resolve().parents[2]
# An installed wheel has the kernels inside the package, a checkout has them beside it.
_FOLDERS = (_PACKAGE / "kernels", _PACKAGE.parent / "kernels")

BUILD_OPTIONS = ("-cl-std=CL1.2", "-cl-kernel-arg-info", "-cl-mad-enable")


def kernel_folder() -> Path:
    """Return the folder of the kernels in a wheel, an sdist, an editable install or a checkout."""
    for folder in _FOLDERS:
        if (folder / "common" / "common.cl").is_file():
            return folder
    folders = " and ".join(str(folder) for folder in _FOLDERS)
    raise KernelBuildError(f"The OpenCL kernels are missing from {folders}; reinstall clplen.")


def kernel_path(file: str) -> Path:
    """Return the path of a kernel file; names are unique across rooms."""
    folder = kernel_folder()
    path = next(folder.glob(f"*/{file}"), None)
    if path is None:
        raise KernelBuildError(f"No kernel file {file!r} in {folder}.")
    return path


@cache
def kernel_source(file: str) -> str:
    """Return the source of a kernel file, with includes expanded and ``#line`` directives."""
    return _expand(file, [])


def _expand(file: str, included: list[str]) -> str:
    path = kernel_path(file)
    included.append(file)
    lines = [f'#line 1 "{file}"']
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        match = _INCLUDE.match(line)
        if match is None:
            lines.append(line)
        elif match.group(1) not in included:
            lines.append(_expand(match.group(1), included))
            lines.append(f'#line {number + 1} "{file}"')
        else:
            lines.append("")
    return "\n".join(lines)


def build_program(
    context: cl.Context, file: str, defines: dict[str, Any], options: Sequence[str] = ()
) -> cl.Program:
    """Build one kernel file for a context."""
    source = kernel_source(file)
    definitions = (_define(name, value) for name, value in defines.items())
    options = [*BUILD_OPTIONS, *definitions, *options]
    with warnings.catch_warnings():
        # Some compilers comment on every successful build; a failed build raises.
        warnings.simplefilter("ignore", cl.CompilerWarning)
        try:
            return cl.Program(context, source).build(options=options)
        except cl.Error as error:
            names = ", ".join(
                f"{device.name.strip()} ({device.platform.name.strip()} "
                f"{device.driver_version.strip()})"
                for device in context.devices
            )
            raise KernelBuildError(
                f"The kernel file {file!r} does not build on {names} with {' '.join(options)}: "
                f"{ADVICE}.",
                source=source,
                log=str(error),
            ) from error


def _define(name: str, value: Any) -> str:
    return f"-D{name}" if value is None or value is True else f"-D{name}={value}"
