"""A main lens' wavefront taken out of a light field, view by view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clplen.cameras.optics.camera_aberrations import Aberrations, slopes
from clplen.lightfield.given import as_lightfield
from clplen.lightfield.lightfield import LightField
from clplen.lightfield.moved import move_views
from clplen.lightfield.parametrisation import require_two_plane
from clplen.lightfield.raw import CameraModel


def correct_aberrations(
    lf: LightField, zernike: Mapping[int, float], *, camera: CameraModel | None = None
) -> LightField:
    """The light field as if the main lens had no such wavefront.

    A ray from u on the main lens meets the image plane F dW/du beside its place (ray aberration:
    Born and Wolf 1999, section 5.1; Ng 2006, chapter 7): view u is moved back by that, through the
    phase of its spectrum. The slope in the middle of what one view sees is corrected, not how it
    changes within: lenslets blur directions by lam f_mu/d on the sensor.

    Parameters
    ----------
    lf : LightField
        Decoded with "calibrated" sub-images; with a spacing in metres.
    zernike : mapping of int to float
        Noll's index to metres of path, rms over the aperture, as `Aberrations.main_lens`.
    camera : CameraModel, optional
        None: ``lf.camera``. Its image_distance F and aperture_diameter count.

    Returns
    -------
    LightField
        float32, of the same shape. Views beyond the rim of the aperture are moved as those on it.

    Raises
    ------
    ValueError
        If the camera or the spacing is not known, or the views are directions.
    """
    lf = as_lightfield(lf)
    terms = Aberrations(main_lens=zernike).main_terms()
    known = lf.camera if camera is None else camera
    if known is None or lf.spacing is None:
        raise ValueError(
            "A wavefront is corrected where views and pixels lie in metres: give camera=, and a "
            "light field with spacing."
        )
    require_two_plane(lf, "The correction of a wavefront")
    if lf.decode == "naive":
        raise ValueError(
            "Naive cells are directions, not places on the main lens: decode with 'calibrated'."
        )
    return move_views(lf, _steps(lf, lf.spacing, terms, known))


def _steps(lf: LightField, spacing: Any, terms: Any, camera: CameraModel) -> Any:
    """How far rays of each view land beside their place, (y, x) in pixels, shape (V, U, 2)."""
    dv, du, dy, dx = spacing
    if lf.positions is None:
        v, u = (np.arange(n) - (n - 1) / 2 for n in lf.shape[:2])
        v, u = np.meshgrid(v, u, indexing="ij")
    else:
        v, u = np.moveaxis(lf.positions, -1, 0)
    radius = camera.aperture_diameter / 2
    y, x = v * dv / radius, u * du / radius
    beyond = np.maximum(np.hypot(y, x), 1)
    down, right = slopes(terms, y / beyond, x / beyond)
    reach = camera.image_distance / radius
    return np.stack([down * reach / dy, right * reach / dx], axis=-1)
