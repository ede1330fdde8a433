"""Fourier light-field microscopes that tests and measurements share, and their float64 twins."""

from __future__ import annotations

from typing import Any

import numpy as np
import reference_fourier

from clplen import Device, MicrolensArray, PlenopticCamera
from clplen.cameras import FourierMicroscope, LensletLayout

TURNS = np.arange(6) * np.pi / 3
RING = 2e-3 * np.stack([np.sin(TURNS), np.cos(TURNS)], axis=-1)
SYSTEMS: dict[str, dict[str, Any]] = {
    "square": {
        "magnification": 20, "na": 0.5, "wavelength": 525e-9, "relay": 0.1, "pixel_pitch": 8e-6,
        "mla": MicrolensArray(1e-3, 30e-3, count=5, fill="full"),
    },
    "hexagonal": {
        "magnification": 40, "na": 0.8, "medium_index": 1.33, "wavelength": 580e-9,
        "relay": 0.125, "pixel_pitch": 6.5e-6,
        "mla": MicrolensArray(1.2e-3, 36e-3, count=5, lattice="hexagonal", fill="full"),
    },
    "seven": {
        "magnification": 60, "na": 1.2, "medium_index": 1.33, "wavelength": 593e-9,
        "relay": 0.15, "pixel_pitch": 6.5e-6, "sensor_distance": 60e-3,
        "mla": LensletLayout([(0.0, 0.0), *RING], [60e-3, *[61e-3, 59e-3] * 3], diameter=1.9e-3),
    },
}  # fmt: skip
SMALL: dict[str, Any] = {
    "magnification": 20, "na": 0.3, "wavelength": 525e-9, "relay": 0.05, "pixel_pitch": 8e-6,
    "mla": MicrolensArray(500e-6, 12e-3, count=3),
}  # fmt: skip


def camera_of(name: str, device: Device | None = None) -> FourierMicroscope:
    """One of the systems; "small": 3 x 3 lenslets, 188 x 188 pixels."""
    given = SMALL if name == "small" else SYSTEMS[name]
    return PlenopticCamera.fourier_microscope(**given, device=device)


def twin(camera: FourierMicroscope) -> reference_fourier.Setup:
    """The same for the independent simulation."""
    layout = camera.lenslets
    lenslets = np.column_stack([layout.positions, layout.focal_lengths])
    return reference_fourier.Setup(
        camera.magnification,
        camera.na,
        camera.medium_index,
        camera.wavelength,
        camera.relay,
        tuple(map(tuple, lenslets.tolist())),
        layout.diameter,
        layout.fill,
        camera.sensor_distance,
        camera.pixel_pitch,
        camera.grid.shape,
        camera.apodisation,
        camera.field_stop,
    )


def spot(camera: FourierMicroscope, lenslet: int, point: Any) -> tuple[float, float]:
    """(y, x) in pixels where rays put a point's image behind a lenslet."""
    x, y, z = point
    place = camera.lenslets.positions[lenslet] + camera.displacement(z)[lenslet]
    place = place + camera.scale * np.array([y, x])
    middle = (np.array(camera.grid.shape) - 1) / 2
    found = place / camera.pixel_pitch + middle
    return float(found[0]), float(found[1])
