"""The example that reads and writes objects through fsspec."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from clplen import LightField, focal_stack
from clplen.cameras import sample_scenes
from clplen.compute.device import Device

fsspec = pytest.importorskip("fsspec", reason="the extra batch is not installed")
zarr = pytest.importorskip("zarr", reason="the extra batch is not installed")
SCRIPT = Path(__file__).parents[2] / "examples" / "object_storage.py"


def test_from_store_to_store(tmp_path: Path, device: Device, monkeypatch: pytest.MonkeyPatch):
    """From memory to files; the sample of the script is in memory, too."""
    values = np.random.default_rng(4).random((5, 6, 110, 90), np.float32)
    names = ["memory://here/in.zarr", f"file://{tmp_path}/out.zarr"]
    specification = importlib.util.spec_from_file_location("object_storage", SCRIPT)
    assert specification is not None
    assert specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    script.created(names[0], values.shape, (1, *values.shape[1:]))[...] = values
    words = [str(SCRIPT), names[0], "--target", names[1], "--memory", "2000000"]
    monkeypatch.setattr(sys, "argv", [*words, "--device", device.place])
    script.main()
    found = zarr.open_array(fsspec.get_mapper(names[1]), mode="r")
    planes = np.array(found.attrs["disparities"])
    script.put_sample(device)
    stored = zarr.open_array(fsspec.get_mapper(script.SAMPLE), mode="r")
    scene = next(one for one in sample_scenes(1, (96, 120)) if one.name == "bars").scene
    sample, _ = scene.light_field((7, 9), (96, 120), device=device)
    assert np.array_equal(stored[...], sample.to_numpy())
    expected = focal_stack(LightField.from_array(values, device=device), disparities=planes)
    assert np.array_equal(found[...], expected.to_numpy())
    fsspec.filesystem("memory").rm("/", recursive=True)
