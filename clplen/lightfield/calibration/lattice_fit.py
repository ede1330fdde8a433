"""The lattice of lenslets of a white image."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen.errors import ShapeError
from clplen.lightfield.calibration.equalisation import equalise_lenslets, fall_off_share
from clplen.lightfield.calibration.reciprocal import (
    PITCHES,
    Basis,
    PhaseFit,
    Values,
    central_crop,
    coarse_basis,
    fit_lattice,
    reduced_basis,
)
from clplen.lightfield.calibration.sensor_frames import (
    Mosaic,
    as_frame,
    balance_colours,
    subtract_dark,
)
from clplen.lightfield.calibration.unit_cell import centre_offset, denser_basis, mean_cell
from clplen.lightfield.raw.lenslet_lattice import Lattice, lattice_kind

_LEAST = 32  # pixels a side
_STEPS = 3  # refinements, each from the last
_DEPTH = 0.05  # of the brightest pixel: what is darker is no brighter or darker gap
_GAP = 5  # pixels: a gap that is narrower than a lenslet of 5 px and its gap
_SHARE = 0.6  # of the peaks' strength that the lattice explains
_EXPLAINED = 0.9  # of the contrast that is no noise
_VISIBLE = 0.5  # of the contrast of a frame that shows a scene
_AGREEING = 0.9  # of the windows
_SPREAD = 0.025  # pitches rms
_SPREAD_PX = 0.25  # pixels, below which a spread is no doubt
_TURN = 16.0  # degrees
_ANGLE = 4.0  # degrees off 90 or 60
_LONGER = 1.5  # sides of a rectangle
_UNEVEN = 1.1  # sides of a hexagonal cell
_COUNT = 25  # lenslets
_CHESSBOARD = np.array([[1, 1], [1, -1]])


@dataclass(frozen=True)
class _Candidate:
    """What a picture gave: the fit, the contrast and the strength that it explains."""

    fit: PhaseFit
    explained: float
    share: float


def estimate_lattice(
    white: ArrayLike,
    *,
    dark: ArrayLike | None = None,
    kind: str | None = None,
    pitch: float | None = None,
    bayer: Mosaic | None = None,
) -> Lattice:
    """Find the lattice of lenslets of a white image.

    Peaks of the Fourier transform give the base vectors roughly; the coarsest lattice that holds
    them is made denser where the mean cell shows several lenslets (bright and dim ones). Least
    squares on the local phases of both base frequencies
    (`clplen.lightfield.calibration.reciprocal`) then fit an affine lattice, first in the middle,
    then over the whole picture, once more with the lenslets' light made equal. Where small pitches
    of whole pixels alias the phases, the profile of the mean lenslet tells its centre.

    Parameters
    ----------
    white : array_like
        White image as it lies on the sensor, shape (ny, nx), at least 32 pixels a side, real,
        finite. Pitches from 5 to 60 px are found.
    dark : array_like, optional
        Dark frame of the same shape, subtracted first.
    kind : {"square", "hexagonal"}, optional
        None finds out. A hexagonal lattice may have its nearest neighbours along x or along y.
    pitch : float, optional
        Nominal distance of nearest neighbours in pixels; another one than it to a quarter is not
        trusted.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"} or sequence of str, optional
        Colour filters, whose four kinds of pixels are brought to the same mean.

    Returns
    -------
    Lattice
        With its ``residual``, ``trust`` and ``verdict``. Trust is low where nothing repeats, where
        local lattices disagree, or where equal lenslets explain less than 90 % of the contrast
        that is no noise: then the picture is no white image, and the pitch may be a texture's.

    Raises
    ------
    ShapeError
        If the picture is not (ny, nx) of 32 pixels a side, or the dark frame is of another shape.
    ValueError
        If a pixel is NaN or infinite, or kind or pitch is out of range.

    Examples
    --------
    >>> wave = 1 + np.cos(2 * np.pi * np.arange(64) / 8.4)  # lenslets 8.4 pixels apart
    >>> lattice = clplen.estimate_lattice(np.outer(wave, wave))
    >>> lattice.kind, [f"{pitch:.1f}" for pitch in lattice.pitch], lattice.trust
    ('square', ['8.4', '8.4'], 'high')
    """
    kind = None if kind is None else lattice_kind(kind)
    _check_pitch(pitch)
    if dark is None and bayer is None and _is_even(white):
        return _no_lattice(np.shape(white), kind or "square", pitch)
    picture = _prepared(white, dark, bayer)
    pitches = PITCHES if pitch is None else (0.75 * pitch, 1.3 * pitch)
    found = _best_candidate(picture, kind, pitches)
    if found is None:
        return _no_lattice(picture.shape, kind or "square", pitch)
    lattice = _lattice_of(found.fit, kind, picture.shape)
    return _with_trust(lattice, found, kind, pitch)


def visible_lattice(
    frame: ArrayLike, *, dark: ArrayLike | None = None, bayer: Mosaic | None = None
) -> Lattice | None:
    """The lattice that a frame shows by itself, where it is plain that it is the lenslets'."""
    if min(np.shape(frame)[:2]) < _LEAST or (dark is None and _is_even(frame)):
        return None
    found = _best_candidate(_prepared(frame, dark, bayer), None, PITCHES)
    if found is None or found.explained < _VISIBLE or found.share < _SHARE:
        return None
    lattice = _lattice_of(found.fit, None, np.shape(frame))
    doubts = _doubts(lattice, replace(found, explained=1.0), len(lattice.centres()), None)
    return lattice if all(doubt.startswith("local lattices") for doubt in doubts) else None


def _check_pitch(pitch: float | None) -> None:
    if pitch is not None and not 3 <= pitch <= 200:
        raise ValueError(f"The pitch is 3 to 200 pixels, not {pitch!r}.")


def _is_even(frame: Any) -> bool:
    """Whether the middle of a frame, where a lattice is sought first, has pixels of one value."""
    picture = as_frame(frame, "white image")
    middle = central_crop(picture)
    return min(picture.shape) >= _LEAST and bool(middle.min() == middle.max())


def _prepared(white: Any, dark: Any, bayer: Mosaic | None) -> Values:
    """float32, dark frame taken off, single bright pixels cut."""
    frame = as_frame(white, "white image")
    if min(frame.shape) < _LEAST:
        raise ShapeError(
            f"A lattice is estimated from at least {_LEAST} pixels a side, not {frame.shape}."
        )
    picture = subtract_dark(frame, dark)
    if bayer is not None:
        picture = balance_colours(picture, bayer)
    top = float(np.quantile(picture[:: max(1, len(picture) // 1024)], 0.9995))
    return np.clip(picture, min(0.0, top), top)


def _best_candidate(
    picture: Values, kind: str | None, pitches: tuple[float, float]
) -> _Candidate | None:
    """The lattice that explains most, from the picture or else from the gaps between lenslets."""
    best: _Candidate | None = None
    for seen in (lambda part: part, _dark_gaps, _narrow_gaps):
        basis, share = coarse_basis(seen(central_crop(picture)), pitches)
        for found in _candidates(picture, basis, share, kind, pitches):
            if found.explained >= _EXPLAINED and _is_upright(found, kind, picture.shape):
                return found
            if best is None or found.explained > best.explained:
                best = found
    return best


def _candidates(
    picture: Values,
    basis: Basis | None,
    share: float,
    kind: str | None,
    pitches: tuple[float, float],
) -> Iterator[_Candidate]:
    """The lattice of rough base vectors; if it is turned far, the one of which it is a chessboard.

    The dim squares may be too small to rise over the gaps of the bright ones (`denser_basis`);
    whether they are lenslets tells the share of the contrast that is explained once they are equal.
    """
    found = _candidate(picture, basis, share, pitches)
    if found is None:
        return
    yield found
    if not _is_upright(found, kind, picture.shape):
        closer = _candidate(picture, _CHESSBOARD @ found.fit.basis, share, pitches)
        if closer is not None:
            yield closer


def _is_upright(found: _Candidate, kind: str | None, shape: tuple[int, ...]) -> bool:
    return abs(_lattice_of(found.fit, kind, shape).rotation) <= math.radians(_TURN)


def _dark_gaps(picture: Values) -> Values:
    """Logarithms: lenslets of unequal light are more alike in them."""
    top = max(float(picture.max()), 1e-30)
    return np.asarray(np.log1p(np.maximum(picture, 0) / (_DEPTH * top)))


def _narrow_gaps(picture: Values) -> Values:
    """Light over that of the brighter surroundings: dim lenslets are as bright as others."""
    from scipy.ndimage import grey_closing

    top = max(float(picture.max()), 1e-30)
    return np.asarray(picture / np.maximum(grey_closing(picture, (_GAP, _GAP)), _DEPTH * top))


def _candidate(
    picture: Values, basis: Basis | None, share: float, pitches: tuple[float, float]
) -> _Candidate | None:
    """What becomes of rough base vectors."""
    if basis is None:
        return None
    fit = _refined_fit(picture, basis)
    for _ in range(4):
        closer = denser_basis(mean_cell(picture, fit.basis, fit.phase), fit.basis)
        if closer is None or 1 / np.hypot(*reduced_basis(closer).T).max() < pitches[0] / 1.2:
            break
        fit = _refined_fit(picture, closer)
    if not np.isfinite(fit.rms) or np.hypot(*fit.cell.T).max() > max(picture.shape) / 2:
        return None
    margin = min(int(np.hypot(*fit.cell.T).max()), min(picture.shape) // 6)
    even = equalise_lenslets(picture, fit.cell, fit.origin)
    fit = fit_lattice(even.picture, fit.basis, margin=margin)
    light = equalise_lenslets(picture, fit.cell, fit.origin, fall_off_share(even, margin)).picture
    fit = fit_lattice(light, fit.basis, margin=margin)
    # lenslets that the picture cuts are not equal
    whole = light[margin : light.shape[0] - margin, margin : light.shape[1] - margin]
    phase = fit.phase + margin * fit.basis.sum(axis=1)
    moved = replace(fit, phase=fit.phase - fit.basis @ centre_offset(whole, fit.basis, phase))
    return _Candidate(moved, mean_cell(whole, fit.basis, phase).explained, share)


def _refined_fit(picture: Values, basis: Basis) -> PhaseFit:
    fit = fit_lattice(picture, reduced_basis(basis))
    for _ in range(_STEPS - 1):
        fit = fit_lattice(picture, fit.basis)
    return fit


def _no_lattice(shape: tuple[int, ...], kind: str, pitch: float | None) -> Lattice:
    """In place of a lattice where there is none."""
    step = 10.0 if pitch is None else float(pitch)
    high = step * (math.sqrt(3) / 2 if kind == "hexagonal" else 1.0)
    middle = ((shape[0] - 1) / 2, (shape[1] - 1) / 2)
    verdict = (
        f"No lattice: nothing repeats in the picture; the pitch of {step:g} px was not measured. "
        "Give a white image."
    )
    return Lattice(
        kind, middle, (high, 0.0), (0.0, step), (shape[0], shape[1]), math.nan, "low", verdict
    )


def _lattice_of(fit: PhaseFit, kind: str | None, shape: tuple[int, ...]) -> Lattice:
    """Rows and columns out of any two base vectors, and the lenslet nearest to the middle."""
    short = reduced_basis(fit.cell)
    if kind is None:
        cosine = abs(short[0] @ short[1]) / np.hypot(*short.T).prod()
        kind = "hexagonal" if cosine > math.cos(math.radians(75)) else "square"
    row, column = lattice_steps(short, kind)
    middle = (np.array(shape) - 1) / 2
    near = np.rint((middle - fit.origin) @ np.linalg.inv(short)) - 1
    best = min(
        (fit.origin + (near + np.array(n)) @ short for n in np.ndindex(3, 3)),
        key=lambda at: float(((at - middle) ** 2).sum()),
    )
    origin, down, right = ((float(v[0]), float(v[1])) for v in (best, row, column))
    return Lattice(kind, origin, down, right, (shape[0], shape[1]), fit.rms)


def lattice_steps(short: Basis, kind: str) -> tuple[Values, Values]:
    """Return the steps to the next row and column from the shortest two vectors of a lattice.

    Rows of a square lattice follow one another along +y; those of a hexagonal one run along the
    nearest neighbours, whichever axis these lie nearer to.
    """
    if kind == "square":
        down = int(abs(short[1, 0]) * abs(short[0, 1]) > abs(short[0, 0]) * abs(short[1, 1]))
        row, column = short[down], short[1 - down]
        return row * (1 if row[0] > 0 else -1), column * (1 if column[1] > 0 else -1)
    a, b = short
    if a @ b < 0:
        b = -b
    six = np.array([a, b, b - a, -a, -b, a - b])
    angle = np.degrees(np.arctan2(six[:, 0], six[:, 1]))  # from +x towards +y
    to_x, to_y = int(np.abs(angle).argmin()), int(np.abs(angle - 90).argmin())
    if abs(angle[to_x]) <= abs(angle[to_y] - 90):
        column = six[to_x]
        next_ = six[np.abs((angle - angle[to_x] - 60 + 180) % 360 - 180).argmin()]
        return next_ - column / 2, column
    row = six[to_y]
    next_ = six[np.abs((angle - angle[to_y] + 60 + 180) % 360 - 180).argmin()]
    return row, next_ - row / 2


def _with_trust(
    lattice: Lattice, found: _Candidate, kind: str | None, pitch: float | None
) -> Lattice:
    """The lattice with the trust that it deserves and the reason."""
    along, across = lattice.pitch
    count = len(lattice.centres())
    size = (
        f"{along:.3f} x {across:.3f} px"
        if lattice.kind == "square"
        else (f"{lattice.neighbour:.3f} px")
    )
    what = (
        f"{lattice.kind.capitalize()} lattice, pitch {size}, rotation "
        f"{math.degrees(lattice.rotation):.2f} degrees, {count} lenslets"
    )
    doubts = _doubts(lattice, found, count, pitch)
    if doubts:
        verdict = f"{what}: not to be trusted, because {doubts[0]}. Give a white image."
        return replace(lattice, trust="low", verdict=verdict)
    verdict = f"{what}: local lattices agree with it to {lattice.residual:.3f} px rms."
    return replace(lattice, trust="high", verdict=verdict)


def _doubts(lattice: Lattice, found: _Candidate, count: int, pitch: float | None) -> list[str]:
    near = lattice.neighbour
    row, column = np.array(lattice.row), np.array(lattice.column)
    skew = math.degrees(math.asin(abs(row @ column) / np.hypot(*row) / np.hypot(*column)))
    sides = np.hypot(*row) / np.hypot(*column)
    if lattice.kind == "hexagonal":
        ratio = sides * (math.sqrt(3) / 2 if lattice.turned else 2 / math.sqrt(3))
        uneven = max(ratio, 1 / ratio) > _UNEVEN
    else:
        uneven = max(sides, 1 / sides) > _LONGER
    tests = {
        f"it has only {count} lenslets": count < _COUNT,
        f"its cell is no {'square' if lattice.kind == 'square' else 'hexagon'}": (
            skew > _ANGLE or uneven
        ),
        f"only {100 * found.share:.0f} % of what repeats fits it": found.share < _SHARE,
        f"only {100 * found.fit.agreeing:.0f} % of the picture agrees with it": (
            found.fit.agreeing < _AGREEING
        ),
        f"local lattices lie {lattice.residual:.2g} px rms off": lattice.residual
        > max(_SPREAD * near, _SPREAD_PX),
        f"equal lenslets explain only {100 * max(found.explained, 0):.0f} % of the contrast": (
            found.explained < _EXPLAINED
        ),
        f"the nominal pitch is {pitch} px": pitch is not None and not 0.8 < near / pitch < 1.25,
        f"it is turned by {math.degrees(lattice.rotation):.0f} degrees": (
            abs(lattice.rotation) > math.radians(_TURN)
        ),
        "the pitch is out of the range of 5 to 60 px": not 4.8 <= near <= 63,
    }
    return [reason for reason, failed in tests.items() if failed]
