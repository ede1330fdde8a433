"""Images of points behind a microscope, and how they change with the pupil and with their places.

Everything that a fit changes turns the phase of the pupil: dP = i g P, with g = 2 pi Z_j/lam by a
Zernike coefficient, -2 pi M f_x by x, -2 pi M f_y by y and 2 pi (sqrt((n/lam)^2 - (M f)^2) - n/lam)
by z. With A the linear way from pupil to sensor and u = A P,

    dI = 2 Re(conj(u) A(i g P))                             (forward, one passage for each g)
    dL/dc = -2 sum g Im(conj(A^H(Y u)) P),  Y = dL/dI       (adjoint, one passage for all g).
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
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.elements.zernike import noll, zernike
from clplen.wave.field.field import Field

Vector = np.ndarray[Any, Any]
Parameter = int | str  # Noll's index, or "x", "y", "z"

MARGIN = 6  # lenslets that are simulated around the geometrical blur; half of those of psf


@dataclass(frozen=True, eq=False)
class PupilWaves:
    """Points about the middle of a window of lenslets."""

    camera: Microscope  # its lenslets are those of the window, odd in number
    binning: int = 1  # pixels along an axis that are added up

    @classmethod
    def of(
        cls, camera: Microscope, z: float, *, binning: int = 1, margin: int = MARGIN
    ) -> PupilWaves:
        """Simulate points up to a lenslet off the middle and up to ``z`` from the native plane."""
        blur = float(np.max(camera.objective.blur(np.array([-abs(z), abs(z)]))))
        count = 2 * (int(np.ceil(blur / camera.mla.pitch)) + margin) + 1
        while smooth_length(count) != count:
            count += 2
        mla = MicrolensArray(
            camera.mla.pitch, camera.mla.focal_length, count=count, fill=camera.mla.fill,  # type: ignore[arg-type]
            diameter=camera.mla.diameter,
        )  # fmt: skip
        grid = sensor_grid(mla, camera.pixels_per_lenslet)
        return cls(replace(camera, mla=mla, grid=grid), binning)

    @property
    def lenslets(self) -> int:
        """Across the window."""
        return self.camera.mla.count[0]

    def images(self, points: PointSources) -> Vector:
        """Energy on the pixels of each point, of 1 in the pupil."""
        found = [
            self._binned(np.square(np.abs(u.astype(np.complex128))))
            for _, u in self._sensor(points)
        ]
        return np.concatenate(found)

    def tangents(
        self, points: PointSources, parameters: Sequence[Parameter]
    ) -> tuple[Vector, Vector]:
        """Images of points, and their derivatives."""
        images, tangents = [], []
        for some, u in self._sensor(points):
            u = u.astype(np.complex128)
            images.append(self._binned(np.square(np.abs(u))))
            row = []
            for name in parameters:
                du = self._at_sensor(some, 1j * self.phases(name))
                row.append(self._binned(2 * (u.real * du.real + u.imag * du.imag)))
            tangents.append(row)
        joined = [np.concatenate(one) for one in zip(*tangents, strict=True)]
        return np.concatenate(images), np.array(joined)

    def gradient(
        self, points: PointSources, cotangents: Vector, parameters: Sequence[Parameter]
    ) -> Vector:
        """Derivatives of a loss, from its derivatives by the pixels of each image."""
        camera, found, start = self.camera, [], 0
        b, device = self.binning, camera.device
        way = camera.to_sensor(camera.grid, camera.sensor_distance)
        weights = np.stack([self.phases(name) for name in parameters])
        weights = weights.reshape(len(parameters), -1)
        for some, u in self._sensor(points):
            part = cotangents[start : start + len(some)]
            start += len(some)
            Y = np.repeat(np.repeat(part, b, axis=1), b, axis=2)
            back = Field(
                device.upload((Y * u).astype(device.complex)),
                camera.grid, camera.wavelength, device,
            )  # fmt: skip
            at_array = camera.mla.adjoint(way.adjoint(back)).data
            device.fft.forward(at_array, device)
            light = device.download(at_array).astype(np.complex128) / np.prod(camera.grid.shape)
            pupil = device.download(camera.objective.spectra(some, camera.grid, device))
            turned = np.imag(np.conj(light) * pupil).reshape(len(some), -1)
            found.append(-2 * turned @ weights.T)
        return np.concatenate(found)

    def phases(self, name: Parameter) -> Vector:
        """Return g of a parameter over the window's frequencies, rad/m; 0 beyond the rim."""
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
        """Some points after others, with their fields on the sensor."""
        for some in self.camera.batches(points, self.camera.grid):
            yield some, self._at_sensor(some)

    def _at_sensor(self, points: PointSources, factor: Vector | None = None) -> Vector:
        field = self.camera.sensor_fields(points, self.camera.grid, factor=factor)
        return self.camera.device.download(field.data)

    def _binned(self, values: Vector) -> Vector:
        b = self.binning
        ny, nx = (k // b for k in values.shape[1:])
        cells = values.reshape(len(values), ny, b, nx, b)
        return np.asarray(cells.sum(axis=(2, 4), dtype=np.float64))
