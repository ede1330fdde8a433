"""Waves through a plenoptic camera: from points to the main lens, the array and the sensor.

Positions are plain arrays; what shines there, and how its energies add up, is for others to know.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clplen.cameras.optics.pupil_fields import pupil_fields
from clplen.cameras.optics.ray_optics import FixedOptics, check_in_view, check_sampling
from clplen.compute.fft.blocks import window
from clplen.compute.fft.lines import smooth_length
from clplen.errors import ShapeError
from clplen.wave.elements.lens import thin_lens
from clplen.wave.elements.zernike import wavefront
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.transmission import multiply, phasor
from clplen.wave.propagation.band import blas_limit
from clplen.wave.propagation.free_space import plan
from clplen.wave.propagation.propagator import Propagator

Values = np.ndarray[Any, np.dtype[np.float64]]
FRESNEL_WIDTHS = 2  # diffraction beyond the geometric edge that a window without padding holds


@dataclass(frozen=True, repr=False)
class WaveOptics(FixedOptics):
    """Fields behind the main lens, at the array and on the sensor of a plenoptic camera.

    Attributes are those of `FixedOptics`.
    """

    def pupil(self, positions: Values, diameter: float = 0.0, *, full_grid: bool = True) -> Field:
        """Fields of points right behind the main lens.

        Parameters
        ----------
        positions : numpy.ndarray
            (x, y, dz) in metres from the axis point of the focused plane, shape (n, 3).
        diameter : float
            Each is a uniform coherent disc of this diameter in metres; 0 is a point.
        full_grid : bool
            On the whole grid, or only on those of its samples that the aperture touches.

        Returns
        -------
        Field
            Shape (n, ny, nx); not normalised.
        """
        spherical = pupil_fields(
            positions,
            diameter,
            grid=self.grid if full_grid else aperture_grid(self.grid, self.aperture_diameter),
            object_distance=self.object_distance,
            focal_length=self.focal_length,
            aperture_diameter=self.aperture_diameter,
            wavelength=self.wavelength,
            device=self.device,
        )
        return self.behind_main_lens(spherical, self.image_of(positions)[:, ::-1])

    def array_field(self, pupil: Field, *, pad: int = 1) -> Field:
        """Fields behind the main lens propagated to the array, before its lenslets.

        Parameters
        ----------
        pupil : Field
            Shape (..., ny, nx), on the camera's grid or a part of it about the same centre.
        pad : int
            Zero padding, see `padding`.

        Returns
        -------
        Field
            On the camera's grid.
        """
        return propagate_part(self.propagator(self.array_distance, "blas", pad), pupil)

    def sensor_field(self, at_array: Field, *, pad: int = 1) -> Field:
        """Fields at the array sent through it and on to the sensor.

        Parameters
        ----------
        at_array : Field
            Shape (..., ny, nx).
        pad : int
            Zero padding, see `padding`.

        Returns
        -------
        Field
            Same shape.
        """
        if self.field_lens:
            at_array = thin_lens(at_array, self.array_distance)
        behind = self._behind_lenslets(self.mla.apply(at_array))
        return self.propagator(self.sensor_distance, "as", pad)(behind)

    def padding(self, positions: Values) -> tuple[int, int]:
        """Padding of the ways to the array and to the sensor: 1 where no light leaves the window.

        A ray to the array moves sideways by up to abs(X) + abs(beta) D/2 and z2 times the slope of
        the main lens' wavefront; diffraction adds a few Fresnel widths sqrt(lam z2). Behind the
        array it stays within `spread` of X (1 + z3/z2).

        Parameters
        ----------
        positions : numpy.ndarray
            (x, y, dz) in metres, shape (n, 3).

        Returns
        -------
        tuple of int
            1 or 2 each.
        """
        D, z2 = self.aperture_diameter, self.array_distance
        X = np.abs(self.on_array(positions))[:, ::-1]  # (y, x)
        beta = np.abs(np.atleast_1d(self.array_alpha(positions[:, 2])))[:, None]
        guard = FRESNEL_WIDTHS * math.sqrt(self.wavelength * z2)
        shift = X + np.maximum(1, beta) * D / 2 + z2 * self.main_slope() + guard
        limit = np.array(
            [
                blas_limit(n, d, z2, self.wavelength)
                for n, d in zip(self.grid.shape, self.grid.pitch, strict=True)
            ]
        )
        to_array = 1 if (shift / z2 / self.wavelength <= limit).all() else 2
        spread = np.atleast_1d(self.spread(positions[:, 2]))[:, None]
        at_sensor = X * self.sub_image_scale + spread + guard
        to_sensor = 1 if (at_sensor <= np.asarray(self.grid.extent) / 2).all() else 2
        return to_array, to_sensor

    def propagator(self, z: float, method: str, pad: int) -> Propagator:
        """The plan of a distance on the camera's grid, ``pad`` times as wide or a little more."""
        return plan(
            self.grid,
            z,
            wavelength=self.wavelength,
            method=method,
            pad=_pad_factor(self.grid.shape, pad),
            device=self.device,
        )

    def check_positions(self, positions: Values) -> None:
        """Refuse points that the camera cannot show.

        Parameters
        ----------
        positions : numpy.ndarray
            (x, y, dz) in metres, shape (n, 3).

        Raises
        ------
        ValueError
            If one lies behind the main lens.
        SamplingError
            If one is imaged beyond the array, or the pixels do not sample its light.
        """
        check_in_view(self, positions)
        images = self.on_array(positions)
        beta = np.abs(np.atleast_1d(self.array_alpha(positions[:, 2])))
        for reach, b in zip(np.abs(images).max(axis=1), beta, strict=True):
            check_sampling(self, float(reach), max(1.0, float(b)))

    def behind_main_lens(self, pupil: Field, images: Values | None = None) -> Field:
        """Fields right behind the main lens with its wavefront.

        Parameters
        ----------
        pupil : Field
            Shape (..., ny, nx), on the camera's grid or a part of it about the same centre.
        images : numpy.ndarray, optional
            Images (y, x) of the points that each field comes from, in metres, shape (n, 2); needed
            where the wavefront changes over the field.

        Returns
        -------
        Field
            Same shape.
        """
        if not self.aberrations.bends_main_lens:
            return pupil
        device, dtype = pupil.device, pupil.device.complex
        if not self.aberrations.varies:
            key = ("main lens", self.aberrations, self.aperture_diameter)
            plate = device.plans.get(
                (*key, pupil.grid, pupil.wavelength),
                lambda: device.upload(phasor(self._turns(pupil, 0.0, 0.0), dtype)),
                lambda array: int(array.nbytes),
            )
            return multiply(pupil, plate)
        assert images is not None  # a slide, whose points are not known apart, is refused before
        middle = self._turns(pupil, 0.0, 0.0)
        down, right = (self._turns(pupil, *image) - middle for image in ((1.0, 0.0), (0.0, 1.0)))
        plates = [phasor(middle + y * down + x * right, dtype) for y, x in images]
        (ny, nx), count = pupil.grid.shape, len(images)
        tall = Grid((count * ny, nx), pupil.grid.pitch)  # all fields below each other, as one
        stack = Field(pupil.data.reshape(tall.shape), tall, pupil.wavelength, device)
        bent = multiply(stack, device.upload(np.concatenate(plates)))
        return pupil.with_data(bent.data.reshape(pupil.shape))

    def _behind_lenslets(self, field: Field) -> Field:
        """Fields right behind the array with what its lenslets depart by from thin lenses.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx), behind ideal lenslets.

        Returns
        -------
        Field
            Same shape.
        """
        aberrations, mla, device = self.aberrations, self.mla, field.device
        if not aberrations.bends_lenslets:
            return field
        key = (mla, field.grid, field.wavelength)
        phase = device.plans.get(
            ("lenslet errors", aberrations, *key),
            lambda: aberrations.lenslet_errors(mla).phase(*key, device),
            lambda array: int(array.nbytes),
        )
        return multiply(field, phase)

    def _turns(self, pupil: Field, y: float, x: float) -> Values:
        """W/lam of the main lens for an image at (y, x) in metres, shape of the pupil's grid."""
        terms = self.aberrations.main_terms(y, x)
        path, _ = wavefront(pupil.grid, terms, diameter=self.aperture_diameter)
        return path / pupil.wavelength


def padded_shape(shape: tuple[int, int], pad: int) -> tuple[int, int]:
    """The window that `WaveOptics.propagator` pads to."""
    if pad == 1:
        return shape
    factor = _pad_factor(shape, pad)
    return (round(factor * shape[0]), round(factor * shape[1]))


def _pad_factor(shape: tuple[int, int], pad: int) -> float:
    """``pad``, or a little more for a quick transform."""
    longest = max(shape)
    return 1 if pad == 1 else smooth_length(pad * longest) / longest


def aperture_grid(grid: Grid, diameter: float) -> Grid:
    """The samples of a grid whose cells a circular aperture about the axis touches.

    Parameters
    ----------
    grid : Grid
    diameter : float
        Of the aperture, in metres.

    Returns
    -------
    Grid
        About the same centre, at most as large as ``grid``: sample n//2 stays where it is.
    """
    shape = []
    for n, pitch, centre in zip(grid.shape, grid.pitch, grid.origin, strict=True):
        half = math.ceil((diameter / 2 + abs(centre)) / pitch + 0.5)
        shape.append(min(n, 2 * half + 1))
    return replace(grid, shape=(shape[0], shape[1]))


def propagate_part(plan: Propagator, field: Field) -> Field:
    """A field on a part of a plan's grid, propagated with zeros beside it.

    Parameters
    ----------
    plan : Propagator
    field : Field
        Shape (..., ny, nx), on the plan's grid or on fewer samples about the same centre.

    Returns
    -------
    Field
        On the plan's output grid.

    Raises
    ------
    ShapeError
        If the field is on another grid.
    """
    if field.grid == plan.grid:
        return plan(field)
    fits = all(n <= m for n, m in zip(field.grid.shape, plan.grid.shape, strict=True))
    if not fits or replace(field.grid, shape=plan.grid.shape) != plan.grid:
        raise ShapeError(
            f"The plan is for {plan.grid}; the field is on {field.grid}, which is no part of it."
        )
    shape = (*field.shape[:-2], *plan.grid.shape)
    whole = window(field.data, shape, field.device)
    return plan(Field(whole, plan.grid, field.wavelength, field.device))
