"""Both scenes of the demo, on a smaller array: tables, files, and what the pictures show."""

from __future__ import annotations

import re

import numpy as np
import pytest
import tifffile

from clplen import demo
from clplen.compute.device import Device
from clplen.demo import lights, three_points
from clplen.io import read_lightfield

pytestmark = pytest.mark.thorough  # CI runs the demonstration itself, too

COUNT = 77  # the smallest window in which A needs no padding


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, device: Device):
    """(folder, what was said, steps)."""
    folder = tmp_path_factory.mktemp("demo")
    said, steps = [], []
    three_points.run(folder, device, say=said.append, step=steps.append, count=COUNT)
    return folder, said, steps


def test_everything_is_written_and_nothing_else(result):
    folder, said, steps = result
    assert {file.name for file in folder.iterdir()} == set(three_points.FILES)
    assert len(steps) == three_points.STEPS
    assert len(said) == 3
    assert (folder / "tables.txt").read_text(encoding="utf-8") == "\n\n".join(
        [*said, "Written by clplen."]
    ) + "\n"


def test_the_tables(result):
    _, (parameters, energy, depth), _ = result
    assert "working f-number" in parameters
    for name in demo.POINTS:
        aperture, at_array, sensor = map(float, re.search(rf"  {name} +(.*)", energy)[1].split())
        assert aperture == 1
        assert 0.99 < sensor <= at_array + 1e-6 < 1  # the small window cuts more than 1e-3
    rows = [line.split("|") for line in depth.splitlines()[2:]]
    assert [float(row[0]) for row in rows] == [-50, -25, 25, 50]
    assert [float(row[1]) for row in rows] == [0.7368, 0.8837, 1.0943, 1.1724]
    assert [float(row[2]) for row in rows] == list(three_points.THESIS_ALPHAS)
    thesis, compensated, error = ([float(row[k]) for row in rows] for k in (3, 4, 5))
    np.testing.assert_allclose(thesis, (0.82, 0.92, 1.08, 1.12), atol=0.02)
    assert np.abs(error).max() <= 0.010
    true = [float(row[1]) for row in rows]
    np.testing.assert_allclose(np.array(compensated) - true, error, atol=1.01e-4)


def test_the_light_field_can_be_read_again(result, device: Device):
    folder, *_ = result
    lf = read_lightfield(folder / "lightfield.h5", device=device)
    assert lf.shape == (30, 30, COUNT, COUNT)
    assert lf.camera == demo.camera(device, count=COUNT)


def test_the_stack_is_sharp_at_each_point_in_turn(result, device: Device):
    folder, *_ = result
    stack = tifffile.imread(folder / "stack.tif")
    assert stack.shape == (25, COUNT, COUNT)
    alphas = np.linspace(*demo.STACK_ALPHAS)
    cam = demo.camera(device, count=COUNT)
    for name, (_, _, dz) in demo.POINTS.items():
        x, y = (round(place) for place in demo.array_position(cam, name))
        peak = stack[:, y - 2 : y + 3, x - 2 : x + 3].max(axis=(1, 2))
        # a peak of light: pulled towards 1 by kappa = .889, found to one plane
        pulled = 1 + 0.889 * (cam.alpha(dz) - 1)
        assert alphas[peak.argmax()] == pytest.approx(pulled, abs=0.026), name


def test_things_of_light(tmp_path, device: Device):
    said, steps = [], []
    lights.run(tmp_path, device, say=said.append, step=steps.append, count=61)
    assert {file.name for file in tmp_path.iterdir()} == set(lights.FILES)
    assert len(steps) == lights.STEPS
    rows = re.findall(r"(\w+) +(\d+) mm +(\d+) mm", said[-1])
    assert [name for name, *_ in rows] == ["heart", "star", "moon"]
    for _, true, estimated in rows:
        assert float(estimated) == pytest.approx(float(true), rel=0.05)
    cam = lights.camera(device, count=61)
    stack = tifffile.imread(tmp_path / "stack.tif")
    alphas = np.linspace(*(cam.alpha(lights.THINGS[k].dz) for k in (0, -1)), lights.PLANES)
    for thing in lights.THINGS:
        x, y = np.rint(thing.lights() * lights.FIELD * 61 + 30).astype(int).T
        peaks = np.array([picture[y, x].mean() for picture in stack])
        assert alphas[peaks.argmax()] == pytest.approx(cam.alpha(thing.dz), abs=0.012), thing.name
