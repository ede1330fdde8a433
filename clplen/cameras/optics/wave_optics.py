"""Aberrations of a camera as what multiplies its fields."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clplen.wave.field import Field, Grid
from clplen.wave.multiply import multiply
from clplen.wave.phase import phasor
from clplen.wave.zernike import wavefront

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic

Values = np.ndarray[Any, np.dtype[np.float64]]


def behind_main_lens(camera: Plenoptic, pupil: Field, places: Values | None = None) -> Field:
    """Fields right behind the main lens with its wavefront.

    Parameters
    ----------
    camera : Plenoptic
    pupil : Field
        Shape (..., ny, nx), on the camera's grid or a part of it about the same centre.
    places : numpy.ndarray, optional
        Images (y, x) of the points that each field comes from, in metres, shape (n, 2); needed
        where the wavefront changes over the field.

    Returns
    -------
    Field
        Same shape.
    """
    if not camera.aberrations.bends_main_lens:
        return pupil
    device, dtype = pupil.device, pupil.device.complex
    if not camera.aberrations.varies:
        who = ("main lens", camera.aberrations, camera.aperture_diameter)
        plate = device.plans.get(
            (*who, pupil.grid, pupil.wavelength),
            lambda: device.upload(phasor(_turns(camera, pupil, 0.0, 0.0), dtype)),
            lambda array: int(array.nbytes),
        )
        return multiply(pupil, plate)
    assert places is not None  # a slide, whose points are not known apart, is refused before
    middle = _turns(camera, pupil, 0.0, 0.0)
    down, right = (_turns(camera, pupil, *one) - middle for one in ((1.0, 0.0), (0.0, 1.0)))
    plates = [phasor(middle + y * down + x * right, dtype) for y, x in places]
    (ny, nx), count = pupil.grid.shape, len(places)
    tall = Grid((count * ny, nx), pupil.grid.pitch)  # all fields below each other, as one
    together = Field(pupil.data.reshape(tall.shape), tall, pupil.wavelength, device)
    found = multiply(together, device.upload(np.concatenate(plates)))
    return pupil.with_data(found.data.reshape(pupil.shape))


def behind_lenslets(camera: Plenoptic, field: Field) -> Field:
    """Fields right behind the array with what its lenslets depart by from thin lenses.

    Parameters
    ----------
    camera : Plenoptic
    field : Field
        Shape (..., ny, nx), behind ideal lenslets.

    Returns
    -------
    Field
        Same shape.
    """
    aberrations, mla, device = camera.aberrations, camera.mla, field.device
    if not aberrations.bends_lenslets:
        return field
    phase = device.plans.get(
        ("lenslet errors", aberrations, mla, field.grid, field.wavelength),
        lambda: aberrations.lenslet_errors(mla).phase(mla, field.grid, field.wavelength, device),
        lambda array: int(array.nbytes),
    )
    return multiply(field, phase)


def _turns(camera: Plenoptic, pupil: Field, y: float, x: float) -> Values:
    """W/lam of the main lens for an image at (y, x) in metres, shape of the pupil's grid."""
    terms = camera.aberrations.main_terms(y, x)
    path, _ = wavefront(pupil.grid, terms, diameter=camera.aperture_diameter)
    return path / pupil.wavelength
