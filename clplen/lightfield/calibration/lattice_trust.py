"""Tests of a white image: its trust, and its agreement with the camera of a frame.

`estimate_lattice` measures four figures and trusts a lattice only if all of them pass. The table
compares white images (synthetic ones with noise up to 2/5 of the lenslets' brightness, real ones
of two microscopes) with other pictures (frames of those microscopes, noise, photographs):

==============================  ============  ==========  ============================
figure                          white images  required    other pictures
==============================  ============  ==========  ============================
share of the peaks' strength    1.00          0.6         0.69 to 0.98, or no peaks
windows that agree              0.99 to 1     0.9         0.67 to 0.93, or none
contrast of equal lenslets      0.97 to 1     0.9         0.33 to 0.81
rms of local lattices, pitches  to 0.017      0.025       0.041 to 0.086
==============================  ============  ==========  ============================

The required values are constants of `clplen.lightfield.calibration.lattice_fit`. No single figure
separates all cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clplen.checks import host_array
from clplen.errors import SamplingWarning, argument, warn_caller
from clplen.files import PathLike, naming
from clplen.lightfield.calibration.lattice_fit import estimate_lattice, visible_lattice
from clplen.lightfield.calibration.sensor_frames import Mosaic
from clplen.lightfield.raw.demosaicing import tile_of
from clplen.lightfield.raw.lenslet_lattice import Lattice

_PROPER = "pass the white image of this camera, evenly lit and not saturated"
_MIDDLE = 512  # pixels a side of the part of a frame that is searched for its lattice
_MAX_STEP_ERROR = 0.05  # of a lenslet: maximum difference of the steps of two lattices of a camera


def require_trust(
    lattice: Lattice,
    source: str,
    *,
    pitch: float | None = None,
    force: bool = False,
    error: type[Exception] = ValueError,
) -> Lattice:
    """Reject a lattice of low trust; ``pitch`` is the nominal one, used in the message."""
    if not lattice.is_measured:
        about = "" if pitch is None else f" of about {pitch:g} pixels"
        raise error(
            f"{source} is not a white image: it has no repeated pattern{about}, so the lenslets "
            f"cannot be located; {_PROPER}."
        )
    if lattice.trust == "high":
        return lattice
    verdict = lattice.verdict.removesuffix(" Give a white image.").rstrip(".")
    if not force:
        raise error(
            f"{source} is not a reliable white image ({verdict}); it may be a frame of a scene or "
            f"be saturated. {_PROPER[0].upper()}{_PROPER[1:]}, or {argument('force', True)} to go "
            "on."
        )
    warn_caller(f"{source}: {verdict}.", SamplingWarning)
    return lattice


def lattice_of_white(
    white: Any,
    source: PathLike,
    *,
    frame: Any = None,
    path: PathLike = "The frame",
    dark: Any = None,
    bayer: Mosaic | None = None,
    kind: str | None = None,
    pitch: float | None = None,
    force: bool = False,
    error: type[Exception] = ValueError,
    estimate: Callable[..., Lattice] = estimate_lattice,
) -> Lattice:
    """Estimate the lattice of a white image; reject low trust or disagreement with the frame.

    Messages call the white image ``source`` and the frame ``path``.
    """
    with naming(source):
        lattice = estimate(white, dark=dark, bayer=bayer, kind=kind, pitch=pitch)
    require_trust(lattice, str(source), pitch=pitch, force=force, error=error)
    if frame is None or force:
        return lattice
    with naming(path):
        frame_lattice = visible_lattice(
            _central_crop(frame, bayer),
            dark=None if dark is None else _central_crop(dark, bayer),
            bayer=bayer,
        )
    if frame_lattice is None or _steps_agree(frame_lattice, lattice):
        return lattice
    raise error(
        f"{source} is of another camera: its lenslets are {lattice.neighbour:.4g} px apart and "
        f"those of the frame {frame_lattice.neighbour:.4g} px; pass the white image of this "
        f"camera, or {argument('force', True)} to go on."
    )


def rms_apart(reference: Lattice, lattice: Lattice) -> float:
    """Return the rms distance of lenslets from the nearest ones of a reference, in pixels."""
    centres = lattice.centres()
    steps = np.array([reference.row, reference.column])
    multiples = (centres - reference.origin) @ np.linalg.inv(steps)
    if reference.kind == "hexagonal":
        along, across = (0, 1) if reference.turned else (1, 0)
        multiples[:, along] -= np.rint(multiples[:, across]) % 2 / 2
    residuals = (multiples - np.rint(multiples)) @ steps
    return float(np.sqrt((residuals**2).sum(1).mean()))


def _central_crop(picture: Any, bayer: Mosaic | None) -> Any:
    """Return the middle of a picture, aligned to the tile of colour filters."""
    values = host_array(picture, "A picture")
    tile = (2, 2) if bayer is None else np.shape(tile_of(bayer))
    start = [
        max(0, (n - _MIDDLE) // (2 * t) * t) for n, t in zip(values.shape[:2], tile, strict=True)
    ]
    return values[start[0] : start[0] + _MIDDLE, start[1] : start[1] + _MIDDLE]


def _steps_agree(first: Lattice, second: Lattice) -> bool:
    """Return True if the steps of one lattice are integer multiples of the other's."""
    a, b = (_steps(lattice) for lattice in (first, second))
    return any(_is_whole(m) for m in (a @ np.linalg.inv(b), b @ np.linalg.inv(a)))


def _steps(lattice: Lattice) -> Any:
    """Return two primitive steps (y, x) between lenslets, as rows."""
    row, column = np.array(lattice.row), np.array(lattice.column)
    if lattice.kind == "square":
        return np.array([row, column])
    along, across = (row, column) if lattice.turned else (column, row)
    return np.array([along, across + along / 2])


def _is_whole(multiples: Any) -> bool:
    integers = np.rint(multiples)
    near = np.abs(multiples - integers).max() <= _MAX_STEP_ERROR * max(1.0, np.abs(integers).max())
    return bool(near and abs(np.linalg.det(integers)) > 0.5)
