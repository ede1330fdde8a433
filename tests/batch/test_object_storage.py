"""The example that reads and writes objects through fsspec."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from clplen import focal_stack, read_lightfield
from clplen.cameras import sample_scenes
from clplen.compute.device import Device

fsspec = pytest.importorskip("fsspec", reason="the extra batch is not installed")
zarr = pytest.importorskip("zarr", reason="the extra batch is not installed")
SCRIPT = Path(__file__).parents[2] / "examples" / "object_storage.py"


@pytest.mark.parametrize("source", ["memory", pytest.param("local", marks=pytest.mark.thorough)])
@pytest.mark.parametrize("target", [pytest.param("memory", marks=pytest.mark.thorough), "local"])
def test_from_store_to_store(
    tmp_path: Path, device: Device, source: str, target: str, monkeypatch: pytest.MonkeyPatch
):
    random = np.random.default_rng(4)
    values = random.random((5, 6, 150, 140), np.float32)
    urls = {"memory": "memory://here/{}.zarr", "local": f"file://{tmp_path}/{{}}.zarr"}
    names = [urls[source].format("in"), urls[target].format("out")]
    specification = importlib.util.spec_from_file_location("object_storage", SCRIPT)
    assert specification is not None
    assert specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    script.created(names[0], values.shape, (1, *values.shape[1:]))[...] = values
    words = [str(SCRIPT), names[0], "--target", names[1], "--memory", "4500000"]
    monkeypatch.setattr(sys, "argv", [*words, "--device", device.place])
    script.main()
    found = zarr.open_array(fsspec.get_mapper(names[1]), mode="r")
    planes = np.array(found.attrs["disparities"])
    if source == "local":
        lf = read_lightfield(tmp_path / "in.zarr", device=device)
    else:
        script.put_sample(device)
        stored = zarr.open_array(fsspec.get_mapper(script.SAMPLE), mode="r")
        scene = next(one for one in sample_scenes(1, (96, 120)) if one.name == "bars").scene
        sample, _ = scene.light_field((7, 9), (96, 120), device=device)
        assert np.array_equal(stored[...], sample.to_numpy())
        from clplen import LightField

        lf = LightField.from_array(values, device=device)
    expected = focal_stack(lf, disparities=planes).to_numpy()
    assert np.array_equal(found[...], expected)
    fsspec.filesystem("memory").rm("/", recursive=True)
