"""With NumPy, SciPy and pyopencl alone, everything from the scene to the depth works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from clplen.compute.device import Device

ROOT = Path(__file__).parents[1]
# A Python in which everything but these and the standard library is not installed.
ALONE = """
import sys

ALLOWED = sys.stdlib_module_names | {
    "numpy", "scipy", "pyopencl", "lazy_loader", "packaging", "clplen",
    "pytools", "platformdirs", "typing_extensions", "siphash24",  # pyopencl's own needs
}

class Only:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        allowed = name.partition(".")[0] in ALLOWED or name.startswith("_sysconfigdata")
        return self.finder.find_spec(name, path, target) if allowed else None
    def __getattr__(self, name):
        return getattr(self.finder, name)

for name in [name for name in sys.modules if name.partition(".")[0] not in ALLOWED]:
    if name != "__main__":
        del sys.modules[name]
sys.meta_path[:] = [Only(finder) for finder in sys.meta_path]
"""
WORK = """
import numpy as np
from clplen import (
    Device,
    Field,
    Grid,
    LightField,
    MicrolensArray,
    PlenopticCamera,
    PointSources,
    depth_map,
    estimate_alpha,
    focal_stack,
    propagate,
    refocus,
)

device = Device.open()
beam = np.exp(-np.linspace(-2, 2, 64)[:, None] ** 2 - np.linspace(-3, 1, 48) ** 2)
field = Field.from_array(beam, Grid((64, 48), 10e-6), wavelength=532e-9, device=device)
assert abs(propagate(field, 5e-3).power() / field.power() - 1) < 1e-2
mla = MicrolensArray(150e-6, 10e-3, count=31, fill="full")
camera = PlenopticCamera.type1(
    focal_length=0.12, mla=mla, wavelength=532e-9, pixels_per_lenslet=10, device=device
)
raw = camera.expose(PointSources([(0, 0, camera.dz(0.9))]))
lf = LightField.from_raw(raw)
stack = focal_stack(lf, alphas=[0.8, 0.9, 1.0]).to_numpy()
assert stack.shape == (3, 31, 31)
assert stack.max(axis=(1, 2)).argmax() == 1
assert np.array_equal(refocus(lf, alpha=0.9).to_numpy(), stack[1])
for method in ("energy", "compensated"):  # half of p/D, the camera's focus tolerance
    assert abs(estimate_alpha(lf, method=method).alpha - 0.9) < 0.0417 / 2
assert depth_map(lf, alphas=[0.8, 0.9, 1.0]).z.shape == (31, 31)
print("done by", device.fft.name)
"""


def run(code: str, selector: str = "") -> subprocess.CompletedProcess[str]:
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)]),
        "CLPLEN_DEVICE": selector,
    }
    environment.pop("CLPLEN_FFT", None)
    return subprocess.run(
        [sys.executable, "-c", ALONE + code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_towers_work_without_anything_else(device: Device) -> None:
    done = run(WORK, device.platform)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout == "done by scipy\n"


LIBRARIES = ("matplotlib", "h5py", "tifffile", "imageio", "click", "tqdm", "pydantic", "ducc0")
ABSENT = f"""
import importlib, clplen, json, scipy.fft, pyopencl.array
print(clplen.__version__)
for name in {(*LIBRARIES, "clplen.plot.base", "clplen.cli.app")}:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        continue
    raise SystemExit(name)
"""


def test_the_rest_is_really_absent() -> None:
    """And what needs no library is there."""
    done = run(ABSENT)
    assert done.returncode == 0, done.stderr
