"""Points at several depths through one camera, for what is measured over depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from clplen.analysis.camera_psf import Done, check_places
from clplen.analysis.curve import Curve
from clplen.analysis.deptherror import DepthErrors, depth_of, search_of, too_few_views
from clplen.analysis.placing import beside_lenslet, offsets
from clplen.analysis.samples import Values
from clplen.analysis.transfer import DepthTransfer, transfer_of
from clplen.errors import SamplingError

if TYPE_CHECKING:
    from clplen.cameras.plenoptic import Plenoptic
    from clplen.lightfield.raw.raw_image import RawImage

PLACES = 3
_SHARES = (-0.15, -0.05, -0.02, 0.0, 0.02, 0.05, 0.15)  # of the object distance


def default_depths(camera: Plenoptic, *, quick: bool = False) -> Values:
    """dz in metres, from -15 to 15 % of the object distance; quick: the outer two and 0."""
    shares = _SHARES[::3] if quick else _SHARES
    return np.array(shares) * camera.object_distance


def depth_scan(
    camera: Plenoptic,
    depths: Sequence[float] | Values,
    *,
    places: int = PLACES,
    transfer: bool = True,
    errors: bool = True,
    done: Done | None = None,
) -> tuple[DepthTransfer | None, DepthErrors | None]:
    """Contrast of refocused pictures, and errors of the depth that is measured, over depth.

    Each depth takes ``places`` exposures of one point, moved along x below the middle lenslet.
    Where a camera cannot picture or measure a depth the result is NaN and says why.

    Parameters
    ----------
    camera : Plenoptic
    depths : array_like
        dz in metres, shape (n,).
    places : int
        Odd.
    transfer, errors : bool
        Which of the two are wanted; the other is None.
    done : callable, optional
        Called as ``done(1)`` for each exposure.

    Returns
    -------
    tuple
        `DepthTransfer` or None, `DepthErrors` or None.

    Raises
    ------
    ValueError
        If there is no depth, one is not finite or lies behind the main lens, or ``places`` is not
        odd and positive.
    """
    dz = _checked(camera, depths)
    check_places(places)
    c_max = search_of(camera, dz)
    curves: list[Curve | None] = []
    measured = np.full((len(dz), places), np.nan)
    notes: list[tuple[str, str]] = []
    for k, one in enumerate(dz):
        raws, why = _exposed(camera, float(one), places, done or (lambda _: None))
        curve, no_curve = _curve(raws, float(one)) if raws and transfer else (None, why)
        no_depth = why or too_few_views(camera, float(one))
        if errors and not no_depth:
            measured[k], no_depth = _depths(raws, c_max)
        curves.append(curve)
        notes.append((no_curve, no_depth))
    contrast = DepthTransfer(dz, tuple(curves), tuple(note for note, _ in notes))
    wrong = DepthErrors(dz, measured - dz[:, None], tuple(note for _, note in notes))
    return contrast if transfer else None, wrong if errors else None


def _checked(camera: Plenoptic, depths: Sequence[float] | Values) -> Values:
    dz = np.asarray(depths, np.float64)
    if dz.ndim != 1 or dz.size == 0 or not np.isfinite(dz).all():
        raise ValueError(f"depths are finite numbers of metres, at least one, not {depths!r}.")
    camera.alpha(dz)  # refuses what lies behind the lens
    return dz


def _exposed(camera: Plenoptic, dz: float, places: int, done: Done) -> tuple[list[RawImage], str]:
    """Raw images of the point at all places, or why there are none."""
    raws = []
    for n, right in enumerate(offsets(camera.mla.pitch, places)):
        try:
            raws.append(camera.expose(beside_lenslet(camera, (0.0, float(right)), dz)))
        except SamplingError as error:
            done(places - n)
            return [], str(error)
        done(1)
    return raws, ""


def _curve(raws: list[RawImage], dz: float) -> tuple[Curve | None, str]:
    try:
        return transfer_of(raws, dz), ""
    except ValueError as error:
        return None, str(error)


def _depths(raws: list[RawImage], c_max: float) -> tuple[Values, str]:
    try:
        return np.array([depth_of(raw, c_max=c_max) for raw in raws]), ""
    except ValueError as error:
        return np.full(len(raws), np.nan), str(error)
