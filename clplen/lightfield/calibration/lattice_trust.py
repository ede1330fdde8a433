"""Whether a white image tells where the lenslets are, and is of the camera of a frame.

`estimate_lattice` measures four figures, and trusts a lattice only where all of them hold. What
they are on white images (drawn ones with noise up to 2/5 of the lenslets' light, real ones of two
microscopes) and on what is none (their frames in place of the white images, noise, pictures):

==============================  ============  ==========  ============================
figure                          white images  required    no white images
==============================  ============  ==========  ============================
share of the peaks' strength    1.00          0.6         0.69 to 0.98, or no peaks
windows that agree              0.99 to 1     0.9         0.67 to 0.93, or none
contrast of equal lenslets      0.97 to 1     0.9         0.33 to 0.81
rms of local lattices, pitches  to 0.017      0.025       0.041 to 0.086
==============================  ============  ==========  ============================

The required values stand in `clplen.lightfield.calibration.lattice_fit`. No figure alone tells all
apart.
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

_PROPER = "give the white image of this camera, evenly lit and not saturated"
_MIDDLE = 512  # pixels a side of a frame, in which its own lattice is looked for
_APART = 0.05  # of a lenslet, by which steps of two lattices of one camera may differ


def require_trust(
    lattice: Lattice,
    source: str,
    *,
    pitch: float | None = None,
    force: bool = False,
    error: type[Exception] = ValueError,
) -> Lattice:
    """Refuse the lattice of a white image in doubt; ``pitch`` is the one that was looked for."""
    if not lattice.is_measured:
        about = "" if pitch is None else f" about every {pitch:g} pixels"
        raise error(
            f"{source} is no white image: nothing repeats in it{about}, so that nothing tells "
            f"where the lenslets are; {_PROPER}."
        )
    if lattice.trust == "high":
        return lattice
    verdict = lattice.verdict.removesuffix(" Give a white image.").rstrip(".")
    if not force:
        raise error(
            f"{source} is no white image to rely on ({verdict}): is it a frame, or saturated? "
            f"{_PROPER[0].upper()}{_PROPER[1:]}, or {argument('force', True)} to go on."
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
    """Find the lattice of a white image; refuse one in doubt, or beside the frame's own lattice.

    Messages call the white image ``source`` and the frame ``path``.
    """
    with naming(source):
        lattice = estimate(white, dark=dark, bayer=bayer, kind=kind, pitch=pitch)
    require_trust(lattice, str(source), pitch=pitch, force=force, error=error)
    if frame is None or force:
        return lattice
    with naming(path):
        own = visible_lattice(
            _central_crop(frame, bayer),
            dark=None if dark is None else _central_crop(dark, bayer),
            bayer=bayer,
        )
    if own is None or _steps_agree(own, lattice):
        return lattice
    raise error(
        f"{source} is of another camera: its lenslets are {lattice.neighbour:.4g} px apart and "
        f"those of the frame {own.neighbour:.4g} px; give the white image of this camera, or "
        f"{argument('force', True)} to go on."
    )


def rms_apart(given: Lattice, found: Lattice) -> float:
    """Return the rms distance of lenslets from the nearest ones of a given lattice, in pixels."""
    centres = found.centres()
    steps = np.array([given.row, given.column])
    places = (centres - given.origin) @ np.linalg.inv(steps)
    if given.kind == "hexagonal":
        along, across = (0, 1) if given.turned else (1, 0)
        places[:, along] -= np.rint(places[:, across]) % 2 / 2
    apart = (places - np.rint(places)) @ steps
    return float(np.sqrt((apart**2).sum(1).mean()))


def _central_crop(picture: Any, bayer: Mosaic | None) -> Any:
    """The middle of a picture, its corner at the first pixel of a tile of colour filters."""
    values = host_array(picture, "A picture")
    tile = (2, 2) if bayer is None else np.shape(tile_of(bayer))
    start = [
        max(0, (n - _MIDDLE) // (2 * t) * t) for n, t in zip(values.shape[:2], tile, strict=True)
    ]
    return values[start[0] : start[0] + _MIDDLE, start[1] : start[1] + _MIDDLE]


def _steps_agree(one: Lattice, other: Lattice) -> bool:
    """Whether the steps of one lattice are whole multiples of the other's, either way."""
    a, b = (_steps(lattice) for lattice in (one, other))
    return any(_is_whole(m) for m in (a @ np.linalg.inv(b), b @ np.linalg.inv(a)))


def _steps(lattice: Lattice) -> Any:
    """Two primitive steps (y, x) between lenslets, as rows."""
    row, column = np.array(lattice.row), np.array(lattice.column)
    if lattice.kind == "square":
        return np.array([row, column])
    along, across = (row, column) if lattice.turned else (column, row)
    return np.array([along, across + along / 2])


def _is_whole(multiples: Any) -> bool:
    whole = np.rint(multiples)
    near = np.abs(multiples - whole).max() <= _APART * max(1.0, np.abs(whole).max())
    return bool(near and abs(np.linalg.det(whole)) > 0.5)
