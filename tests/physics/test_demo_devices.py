"""The demo's numbers are the same on every device, and on a CPU that PoCL does not know."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from forcing import forced_environment

from clplen import Device, LightField, PointSources, estimate_alpha
from clplen.demo import DEPTHS, SOURCE_DIAMETER, camera

ON_AXIS = """
import json, sys, warnings
warnings.simplefilter("ignore")
from clplen import Device, LightField, PointSources, estimate_alpha
from clplen.demo import SOURCE_DIAMETER, camera
device = Device.open("pocl")
raw = camera(device, count=35).expose(PointSources((0, 0, -0.025), diameter=SOURCE_DIAMETER))
alpha = estimate_alpha(LightField.from_raw(raw), at=(17, 17)).alpha
print(json.dumps({"alpha": alpha, "note": device.note, "peak": float(raw.to_numpy().max())}))
"""


@pytest.mark.thorough
def test_same_alphas_and_raw_images_on_every_device(device):
    first = Device.all()[0]
    reference = Device.open(f"{first.platform}") if device.platform != first.platform else None
    if reference is None:
        pytest.skip("the first device is the one that the others are compared with")
    for dz in (DEPTHS[0], DEPTHS[2]):
        raws = [
            camera(d).expose(PointSources((0, 0, dz), diameter=SOURCE_DIAMETER))
            for d in (reference, device)
        ]
        a, b = (raw.to_numpy() for raw in raws)
        assert np.abs(a - b).max() <= 1e-5 * a.max()
        alphas = [estimate_alpha(LightField.from_raw(raw)).alpha for raw in raws]
        assert alphas[0] == pytest.approx(alphas[1], abs=1e-4)


def on_axis(**environment):
    return subprocess.run(
        [sys.executable, "-c", ON_AXIS], capture_output=True, text=True, check=False, **environment
    )


@pytest.mark.thorough
def test_forced_generic_cpu_gives_the_same_numbers(tmp_path: Path):
    if "Portable Computing Language" not in {d.platform for d in Device.all()}:
        pytest.skip("no PoCL here")
    plain = on_axis()
    assert plain.returncode == 0, plain.stderr
    forced = on_axis(env=forced_environment(tmp_path))
    assert forced.returncode == 0, forced.stderr
    expected, got = json.loads(plain.stdout), json.loads(forced.stdout)
    assert "given the CPU name" in got["note"]
    assert got["alpha"] == pytest.approx(expected["alpha"], abs=1e-4)
    assert got["peak"] == pytest.approx(expected["peak"], rel=1e-5)


def test_without_the_remedy_the_build_fails_clearly(tmp_path: Path):
    if "Portable Computing Language" not in {d.platform for d in Device.all()}:
        pytest.skip("no PoCL here")
    refused = on_axis(env=forced_environment(tmp_path, CLPLEN_POCL_CPU="off"))
    assert refused.returncode != 0
    assert "clplen.errors.DeviceError" in refused.stderr
    assert "does not fit this CPU" in refused.stderr
