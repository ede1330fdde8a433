"""The section 1.5 camera of the source, its three points and their raw images, made once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_camera import Camera, simulate_raw

from clplen import Device, LightField, MicrolensArray, PlenopticCamera, PointSources, RawImage
from clplen.cameras.standard_camera import Plenoptic1

DISC = 10e-6
POINTS = {"A": (-3e-3, -3e-3, -0.05), "B": (0.0, 0.0, 0.0), "C": (3e-3, 3e-3, 0.05)}


def thesis_camera(device: Device) -> Plenoptic1:
    array = MicrolensArray(150e-6, 10e-3, count=101, fill="full")
    return PlenopticCamera.type1(
        focal_length=0.12, mla=array, wavelength=532e-9, pixels_per_lenslet=30, device=device
    )


@pytest.fixture(scope="session")
def camera(device: Device) -> Plenoptic1:
    return thesis_camera(device)


@pytest.fixture(scope="session")
def raws(camera: Plenoptic1) -> dict[str, RawImage]:
    """Raw images of A, B, C, each of unit power."""
    return {n: camera.expose(PointSources(p, diameter=DISC)) for n, p in POINTS.items()}


@pytest.fixture(scope="session")
def twin_raws() -> dict[str, np.ndarray]:
    """The same by the independent float64 simulation."""
    return {n: simulate_raw(*p, params=Camera()).astype(np.float32) for n, p in POINTS.items()}


@pytest.fixture(scope="session")
def scene(camera: Plenoptic1, raws: dict[str, RawImage]) -> LightField:
    """Light field of the three points, each raw divided by its own sum, then added."""
    images = [raw.to_numpy().astype(np.float64) for raw in raws.values()]
    total = sum(image / image.sum() for image in images)
    return lightfield_of(total, raws["A"], camera.device)


@pytest.fixture(scope="session")
def point_fields(raws: dict[str, RawImage]) -> dict[str, LightField]:
    return {n: LightField.from_raw(raw) for n, raw in raws.items()}


def lightfield_of(image: np.ndarray, like: RawImage, device: Device) -> LightField:
    return LightField.from_raw(replace(like, data=device.upload(image.astype(np.float32))))
