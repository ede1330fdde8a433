"""Five calls are followed as they run: they enter the files that docs/architecture.md lists."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_architecture import LONGEST_WAY, PACKAGE, WAYS, ways

import clplen
from clplen import Device

RNG = np.random.default_rng(11)


def propagate(device: Device, _: Path) -> Callable[[], Any]:
    grid = clplen.Grid((128, 120), 5e-6)
    field = clplen.Field.from_array(np.ones(grid.shape), grid, wavelength=532e-9, device=device)
    return lambda: clplen.propagate(field, 0.0517)


def expose(device: Device, _: Path) -> Callable[[], Any]:
    camera = clplen.PlenopticCamera.type1(
        focal_length=0.12,
        mla=clplen.MicrolensArray(150e-6, 10e-3, count=25, fill="full"),
        wavelength=531e-9,
        pixels_per_lenslet=30,
        device=device,
    )
    scene = clplen.PointSources([(0, 0, -0.05)])
    return lambda: camera.expose(scene)


def read_lightfield(device: Device, folder: Path) -> Callable[[], Any]:
    views = RNG.integers(0, 255, (3, 3, 20, 24), np.uint8)
    for v, u in np.ndindex(3, 3):
        Image.fromarray(views[v, u]).save(folder / f"view_{v}_{u}.png")
    return lambda: clplen.read_lightfield(folder, device=device)


def focal_stack(device: Device, _: Path) -> Callable[[], Any]:
    lf = clplen.LightField.from_array(RNG.random((3, 3, 20, 24), np.float32), device=device)
    return lambda: clplen.focal_stack(lf, disparities=[-0.5, 0.5])


def deconvolve(device: Device, _: Path) -> Callable[[], Any]:
    microscope = clplen.PlenopticCamera.microscope(
        magnification=20,
        na=0.5,
        mla=clplen.MicrolensArray(125e-6, 2.5e-3, count=5, fill="full"),
        wavelength=525e-9,
        pixels_per_lenslet=25,
        device=device,
    )
    images = clplen.point_images(microscope, np.array([-2e-5, 2e-5]), voxels_per_lenslet=5)
    projector = clplen.Projector(images, (5, 5), device=device)
    frame = RNG.random((125, 125), np.float32)
    return lambda: clplen.deconvolve(frame, projector, iterations=2)


CALLS = (propagate, expose, read_lightfield, focal_stack, deconvolve)


def followed(call: Callable[[], Any]) -> list[tuple[str, str, str]]:
    """(calling file, file, function) of every call inside the package, each once."""
    calls: dict[tuple[str, str, str], None] = {}
    root = str(PACKAGE.parent) + os.sep

    def profile(frame: Any, event: str, _: Any) -> None:
        name = frame.f_code.co_filename
        if event != "call" or not name.startswith(root):
            return
        back = frame.f_back.f_code.co_filename if frame.f_back else ""
        key = (back.removeprefix(root), name.removeprefix(root), frame.f_code.co_name)
        calls[key] = None

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(before)
    return list(calls)


def test_calls_go_the_ways_that_are_written_down(device: Device, tmp_path: Path) -> None:
    if not device.is_cpu:
        pytest.skip("the ways are those of a CPU device")
    assert tuple(call.__name__ for call in CALLS) == WAYS
    for prepare in CALLS:
        stops = ways()[prepare.__name__]
        assert 3 <= len({file for file, _ in stops}) <= LONGEST_WAY
        calls = followed(prepare(device, tmp_path))
        entered = {(file, function) for _, file, function in calls}
        for file, function in stops:
            name = function.rpartition(".")[2]
            name = "__post_init__" if name[0].isupper() else name  # a class is entered by that
            assert (file, name) in entered, f"{file} {function} is not on the way"
        rank = {file: number for number, (file, _) in enumerate(stops)}
        for back, file, _ in calls:
            assert rank.get(file, 99) >= rank.get(back, -1), f"{back} climbs to {file}"
