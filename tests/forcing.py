"""Put the CPU name 'generic' into PoCL's device on purpose.

That is the state in which PoCL's wheel is on a CPU that its compiler does not know, so that the
remedy of `clplen.compute.pocl` is tested on every CPU.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import pyopencl as cl

from clplen.compute import pocl

ROOT = Path(__file__).parents[1]


def force_generic(device: cl.Device) -> None:
    """Overwrite the CPU name in a PoCL device of this process by 'generic'.

    The present name is taken from the end of the device's version, "... -gnu-NAME".
    """
    present = device.version.strip().rpartition("-gnu-")[2].encode()
    found = pocl._find_name(device, present + b"\0")
    assert found is not None, f"{present!r} not found in PoCL's device"
    strdup = ctypes.CDLL(None).strdup
    strdup.restype = ctypes.c_void_p
    found.value = strdup(b"generic")


def generic_environment(folder: Path, **variables: str) -> dict[str, str]:
    """Environment in which every Python process starts with 'generic' in PoCL's device.

    It works through ``generic_startup/sitecustomize.py``, so it holds for grandchildren too: the
    remedy tries a name in a child process, which has to find the same fault as its parent.

    Parameters
    ----------
    folder : Path
        Folder for the caches of PoCL, pyopencl and clplen.
    **variables : str
        More variables.
    """
    return caches_in(folder, Path(__file__).parent / "generic_startup") | variables


def caches_in(folder: Path, *paths: Path) -> dict[str, str]:
    """Environment with every cache in `folder` and clplen, the tests and `paths` importable."""
    python_path = [*paths, ROOT, ROOT / "tests", os.environ.get("PYTHONPATH", "")]
    kept = {k: v for k, v in os.environ.items() if k not in ("CLPLEN_POCL_CPU", "CLPLEN_DEVICE")}
    return kept | {
        "PYTHONPATH": os.pathsep.join(str(path) for path in python_path if path),
        "XDG_CACHE_HOME": str(folder),
        "POCL_CACHE_DIR": str(folder / "kernels"),
    }
