"""Images of points behind a microscope, and their derivatives by pupil and position.

All parameters of a fit change the phase of the pupil: dP = i g P, with g = 2 pi Z_j/lam for a
Zernike coefficient, -2 pi M f_x for x, -2 pi M f_y for y and
2 pi (sqrt((n/lam)^2 - (M f)^2) - n/lam) for z. With the linear propagation A from pupil to sensor
and u = A P, dI = 2 Re(conj(u) A(i g P)).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.lenslet_camera import sensor_grid
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.fft.lines import smooth_length
from clplen.microscopy.model.psf import array_of, binned
from clplen.wave.elements.zernike import noll, zernike

Vector = np.ndarray[Any, Any]
Parameter = int | str  # Noll's index, or "x", "y", "z"

MARGIN_LENSLETS = 6  # simulated around the geometrical blur, half the margin of psf.py


@dataclass(frozen=True, eq=False)
class PupilWaves:
    """Simulation of points near the centre of a window of lenslets."""

    camera: Microscope  # with the lenslets of the window, odd in number
    binning: int = 1  # number of pixels along an axis that are summed

    @classmethod
    def of(
        cls, camera: Microscope, z: float, *, binning: int = 1, margin: int = MARGIN_LENSLETS
    ) -> PupilWaves:
        """Choose the window for points within a lenslet of the axis and ``z`` of z = 0."""
        blur = float(np.max(camera.objective.blur(np.array([-abs(z), abs(z)]))))
        count = 2 * (int(np.ceil(blur / camera.mla.pitch)) + margin) + 1
        while smooth_length(count) != count:
            count += 2
        mla = array_of(camera.mla, count)
        grid = sensor_grid(mla, camera.pixels_per_lenslet)
        return cls(replace(camera, mla=mla, grid=grid), binning)

    @property
    def lenslets(self) -> int:
        """Number of lenslets across the window."""
        return self.camera.mla.count[0]

    def tangents(
        self, points: PointSources, parameters: Sequence[Parameter]
    ) -> tuple[Vector, Vector]:
        """Return the images of points, and their derivatives by the parameters."""
        images, tangents = [], []
        for batch, u in self._sensor(points):
            u = u.astype(np.complex128)
            images.append(binned(np.square(np.abs(u)), self.binning))
            row = []
            for name in parameters:
                du = self._at_sensor(batch, 1j * self.phases(name))
                row.append(binned(2 * (u.real * du.real + u.imag * du.imag), self.binning))
            tangents.append(row)
        derivatives = [np.concatenate(parts) for parts in zip(*tangents, strict=True)]
        return np.concatenate(images), np.array(derivatives)

    def phases(self, name: Parameter) -> Vector:
        """Return g of a parameter over the window's frequencies, in rad/m; 0 outside the pupil."""
        camera, objective = self.camera, self.camera.objective
        fy, fx = camera.grid.fy[:, None], camera.grid.fx[None, :]
        f = np.hypot(fy, fx)
        inside = f <= objective.cutoff
        M, longest = camera.magnification, camera.medium_index / camera.wavelength
        if name == "x":
            values = -M * np.broadcast_to(fx, f.shape)
        elif name == "y":
            values = -M * np.broadcast_to(fy, f.shape)
        elif name == "z":
            values = np.sqrt(np.maximum(longest**2 - (M * f) ** 2, 0)) - longest
        else:
            rho = np.minimum(f / objective.cutoff, 1)
            values = zernike(*noll(int(name)), rho, np.arctan2(fy, fx)) / camera.wavelength
        return np.asarray(2 * np.pi * np.where(inside, values, 0.0))

    def _sensor(self, points: PointSources) -> Iterator[tuple[PointSources, Vector]]:
        """Yield batches of points with their fields on the sensor."""
        for batch in self.camera.batches(points, self.camera.grid):
            yield batch, self._at_sensor(batch)

    def _at_sensor(self, points: PointSources, factor: Vector | None = None) -> Vector:
        field = self.camera.sensor_fields(points, self.camera.grid, factor=factor)
        return self.camera.device.download(field.data)
