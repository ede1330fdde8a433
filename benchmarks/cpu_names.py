"""The demo and the first opening of PoCL's device under every name that its compiler may have.

    python benchmarks/cpu_names.py [NAME]...

For each name, with fresh caches: which name the kernels are built for, whether the demo prints the
tables that it prints without any change, its exit status, and the seconds that `Device.open` takes
the first and the second time. The name is written into PoCL's device before clplen opens it, as it
would stand there on such a CPU. The row "off" forbids the remedy.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

NAMES = (
    *("generic", "znver1", "znver2", "znver3", "x86-64", "haswell", "skylake-avx512"),
    *("icelake-server", "alderlake", "sapphirerapids", "bdver4"),
)
START = """
import sys, time, warnings
import pyopencl as cl
from clplen.compute.drivers import pocl, pocl_trial
warnings.simplefilter("ignore")
device = next(d for p in cl.get_platforms() if p.name == pocl.PLATFORM for d in p.get_devices())
if sys.argv[1]:
    pocl_trial.write_name(pocl_trial.find_name(device.int_ptr), sys.argv[1])
from clplen.compute.device import Device
"""
OPEN = (
    START
    + """
start = time.perf_counter()
Device.open("pocl")
print(f"{pocl.written_name(device)} {time.perf_counter() - start:.2f}")
"""
)
DEMO = START + 'from clplen.cli import main\nmain(["demo", "--device", "pocl", "-o", sys.argv[2]])'


Done = subprocess.CompletedProcess[str]


def python(code: str, name: str, folder: Path, **variables: str) -> Done:
    caches = {"XDG_CACHE_HOME": str(folder), "POCL_CACHE_DIR": str(folder / "kernels")}
    return subprocess.run(
        [sys.executable, "-c", code, name, str(folder / "demo")],
        env=os.environ | caches | variables,
        capture_output=True,
        text=True,
    )


def tables(folder: Path) -> str:
    """What the demo wrote, without its times."""
    file = folder / "demo" / "tables.txt"
    if not file.exists():
        return ""
    return re.sub(r"\d+\.\d+ s\b", "", file.read_text())


def row(name: str, reference: str, **variables: str) -> str:
    """One line of the table."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        first = python(OPEN, name, folder, **variables)
        second = python(OPEN, name, folder, **variables)
        demo = python(DEMO, name, folder, **variables)
        if first.returncode:
            said = first.stderr.strip().splitlines()[-1]
            return f"{name:16} status {demo.returncode}: {said}"
        taken, seconds = first.stdout.split()
        same = "the same" if tables(folder) == reference else "OTHERS"
        again = second.stdout.split()[-1]
        times = f"{seconds:>6} s {again:>6} s"
        return f"{name:16} {taken:16} {times}   {same}, status {demo.returncode}"


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        python(DEMO, "", Path(place))
        reference = tables(Path(place))
    if not reference:
        sys.exit("The demo wrote no tables.")
    print(f"{'name':16} {'built for':16} {'first':>8} {'then':>8}   tables of the demo")
    for name in sys.argv[1:] or NAMES:
        print(row(name, reference), flush=True)
    print("CLPLEN_POCL_CPU=off:")
    print(row("generic", reference, CLPLEN_POCL_CPU="off"))


if __name__ == "__main__":
    main()
