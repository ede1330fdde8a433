"""Put another CPU name into PoCL's device on purpose.

So every CPU gets into the state in which PoCL's wheel is on a CPU that its compiler does not know
("generic"), or takes for another one ("znver3"), and the remedy of compute/drivers/pocl.py is
tested everywhere.
"""

from __future__ import annotations

import os
from pathlib import Path

import pyopencl as cl

from clplen.compute.drivers import pocl_trial

ROOT = Path(__file__).parents[1]
VARIABLE = "CLPLEN_TESTS_CPU_NAME"


def force_name(device: cl.Device, name: str) -> None:
    """Overwrite the CPU name in a PoCL device of this process."""
    pointer = pocl_trial.find_name(device.int_ptr)
    assert pointer is not None, "no CPU name found in PoCL's device"
    pocl_trial.write_name(pointer, name)


def forced_environment(folder: Path, name: str = "generic", **variables: str) -> dict[str, str]:
    """Environment in which every Python process starts with a CPU name in PoCL's device.

    It works through ``forced_startup/sitecustomize.py``.

    Parameters
    ----------
    folder : Path
        Folder for the caches of PoCL, pyopencl and clplen.
    name : str
        The CPU name.
    **variables : str
        More variables.
    """
    startup = Path(__file__).parent / "forced_startup"
    return caches_in(folder, startup) | {VARIABLE: name} | variables


def caches_in(folder: Path, *paths: Path) -> dict[str, str]:
    """Environment with every cache in `folder` and clplen, the tests and `paths` importable."""
    python_path = [*paths, ROOT, ROOT / "tests", os.environ.get("PYTHONPATH", "")]
    kept = {k: v for k, v in os.environ.items() if k not in ("CLPLEN_POCL_CPU", "CLPLEN_DEVICE")}
    return kept | {
        "PYTHONPATH": os.pathsep.join(str(path) for path in python_path if path),
        "XDG_CACHE_HOME": str(folder),
        "POCL_CACHE_DIR": str(folder / "kernels"),
    }
