"""Lattice of lenslets from a white image."""

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

_MIN_SIDE = 32  # pixels a side: minimum size of a picture
_STEPS = 3  # number of refinements, each from the result of the last
_DEPTH = 0.05  # of the brightest pixel: floor of the logarithm and of the local maximum
_GAP = 5  # pixels: width of the closing that removes gaps between lenslets of 5 px
_MIN_PEAK_SHARE = 0.6  # of the peaks' strength: minimum that the lattice explains
_MIN_EXPLAINED = 0.9  # of the contrast without noise: minimum that equal lenslets explain
_MIN_VISIBLE_CONTRAST = 0.5  # of the contrast: minimum for a frame that shows a scene
_MIN_AGREEING = 0.9  # of the windows: minimum that agrees with the lattice
_MAX_SPREAD = 0.025  # pitches rms: maximum deviation of local lattices
_MIN_SPREAD_PX = 0.25  # pixels rms: deviation that is always accepted
_MAX_ROTATION_DEG = 16.0  # degrees: maximum rotation
_MAX_SKEW_DEG = 4.0  # degrees: maximum deviation from 90 or 60 degrees
_MAX_RECTANGLE_RATIO = 1.5  # maximum ratio of the sides of a rectangular cell
_MAX_HEXAGON_RATIO = 1.1  # maximum ratio of the sides of a hexagonal cell
_MIN_LENSLETS = 25  # minimum number of lenslets
_CHESSBOARD = np.array([[1, 1], [1, -1]])


@dataclass(frozen=True)
class _Candidate:
    """A lattice fit with the shares of contrast and of peak strength that it explains."""

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
    """Estimate the lattice of lenslets from a white image.

    Peaks of the Fourier transform give rough base vectors. The coarsest lattice through the peaks
    is made denser where the mean cell shows several lenslets (bright and dim ones). Least squares
    on the local phases of both base frequencies (`clplen.lightfield.calibration.reciprocal`) then
    fit an affine lattice: from the middle outwards, and again with equalised lenslets. Where a
    small whole-number pitch aliases the phases, the profile of the mean lenslet locates its centre.

    Parameters
    ----------
    white : array_like
        White image in sensor orientation, shape (ny, nx), at least 32 pixels a side, real, finite,
        with a pitch of 5 to 60 px.
    dark : array_like, optional
        Dark frame of equal shape, subtracted first.
    kind : {"square", "hexagonal"}, optional
        Lattice type; estimated by default. The nearest neighbours of a hexagonal lattice may lie
        along x or along y.
    pitch : float, optional
        Nominal distance of nearest neighbours in pixels. The trust is low if the measured pitch
        differs from it by more than a quarter.
    bayer : {"RGGB", "BGGR", "GRBG", "GBRG"} or sequence of str, optional
        Colour filters; each of the four kinds of pixels is scaled to an equal mean.

    Returns
    -------
    Lattice
        Lattice with ``residual``, ``trust`` and ``verdict``. Trust is low without a repeated
        pattern, if local lattices disagree, or if equal lenslets explain less than 90 % of the
        contrast without noise: the picture may then be a texture instead of a white image.

    Raises
    ------
    ShapeError
        If the picture is not (ny, nx) of at least 32 pixels a side, or the dark frame differs in
        shape.
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
    candidate = _best_candidate(picture, kind, pitches)
    if candidate is None:
        return _no_lattice(picture.shape, kind or "square", pitch)
    lattice = _lattice_of(candidate.fit, kind, picture.shape)
    return _with_trust(lattice, candidate, kind, pitch)


def visible_lattice(
    frame: ArrayLike, *, dark: ArrayLike | None = None, bayer: Mosaic | None = None
) -> Lattice | None:
    """Return the lattice of a frame of a scene if it is visible beyond doubt, else None."""
    if min(np.shape(frame)[:2]) < _MIN_SIDE or (dark is None and _is_even(frame)):
        return None
    candidate = _best_candidate(_prepared(frame, dark, bayer), None, PITCHES)
    if (
        candidate is None
        or candidate.explained < _MIN_VISIBLE_CONTRAST
        or candidate.share < _MIN_PEAK_SHARE
    ):
        return None
    lattice = _lattice_of(candidate.fit, None, np.shape(frame))
    doubts = _doubts(lattice, replace(candidate, explained=1.0), len(lattice.centres()), None)
    return lattice if all(doubt.startswith("local lattices") for doubt in doubts) else None


def _check_pitch(pitch: float | None) -> None:
    if pitch is not None and not 3 <= pitch <= 200:
        raise ValueError(f"pitch must be 3 to 200 pixels, got {pitch!r}.")


def _is_even(frame: Any) -> bool:
    """Return True if the middle of a frame, the first area to be searched, is constant."""
    picture = as_frame(frame, "white image")
    middle = central_crop(picture)
    return min(picture.shape) >= _MIN_SIDE and bool(middle.min() == middle.max())


def _prepared(white: Any, dark: Any, bayer: Mosaic | None) -> Values:
    """Return the frame as float32, less the dark frame, with single bright pixels clipped."""
    frame = as_frame(white, "white image")
    if min(frame.shape) < _MIN_SIDE:
        raise ShapeError(
            f"A white image must have at least {_MIN_SIDE} pixels a side, got shape {frame.shape}."
        )
    picture = subtract_dark(frame, dark)
    if bayer is not None:
        picture = balance_colours(picture, bayer)
    top = float(np.quantile(picture[:: max(1, len(picture) // 1024)], 0.9995))
    return np.clip(picture, min(0.0, top), top)


def _best_candidate(
    picture: Values, kind: str | None, pitches: tuple[float, float]
) -> _Candidate | None:
    """Return the lattice of highest contrast, from the picture or from gaps between lenslets."""
    best: _Candidate | None = None
    for transform in (lambda part: part, _dark_gaps, _narrow_gaps):
        basis, share = coarse_basis(transform(central_crop(picture)), pitches)
        for candidate in _candidates(picture, basis, share, kind, pitches):
            if candidate.explained >= _MIN_EXPLAINED and _is_upright(
                candidate, kind, picture.shape
            ):
                return candidate
            if best is None or candidate.explained > best.explained:
                best = candidate
    return best


def _candidates(
    picture: Values,
    basis: Basis | None,
    share: float,
    kind: str | None,
    pitches: tuple[float, float],
) -> Iterator[_Candidate]:
    """Yield the lattice of rough base vectors, then the chessboard's finer one if it is rotated.

    The explained contrast after equalisation decides whether the dim squares are lenslets.
    """
    first = _candidate(picture, basis, share, pitches)
    if first is None:
        return
    yield first
    if not _is_upright(first, kind, picture.shape):
        closer = _candidate(picture, _CHESSBOARD @ first.fit.basis, share, pitches)
        if closer is not None:
            yield closer


def _is_upright(candidate: _Candidate, kind: str | None, shape: tuple[int, ...]) -> bool:
    return abs(_lattice_of(candidate.fit, kind, shape).rotation) <= math.radians(_MAX_ROTATION_DEG)


def _dark_gaps(picture: Values) -> Values:
    """Return logarithms, in which lenslets of unequal brightness look more alike."""
    top = max(float(picture.max()), 1e-30)
    return np.asarray(np.log1p(np.maximum(picture, 0) / (_DEPTH * top)))


def _narrow_gaps(picture: Values) -> Values:
    """Divide by the local maximum, which makes dim lenslets as bright as others."""
    from scipy.ndimage import grey_closing

    top = max(float(picture.max()), 1e-30)
    return np.asarray(picture / np.maximum(grey_closing(picture, (_GAP, _GAP)), _DEPTH * top))


def _candidate(
    picture: Values, basis: Basis | None, share: float, pitches: tuple[float, float]
) -> _Candidate | None:
    """Refine rough base vectors; return None if no lattice results."""
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
    equalised = equalise_lenslets(picture, fit.cell, fit.origin)
    fit = fit_lattice(equalised.picture, fit.basis, margin=margin)
    light = equalise_lenslets(
        picture, fit.cell, fit.origin, fall_off_share(equalised, margin)
    ).picture
    fit = fit_lattice(light, fit.basis, margin=margin)
    # lenslets cut by the border differ
    inner = light[margin : light.shape[0] - margin, margin : light.shape[1] - margin]
    phase = fit.phase + margin * fit.basis.sum(axis=1)
    corrected = replace(fit, phase=fit.phase - fit.basis @ centre_offset(inner, fit.basis, phase))
    return _Candidate(corrected, mean_cell(inner, fit.basis, phase).explained, share)


def _refined_fit(picture: Values, basis: Basis) -> PhaseFit:
    fit = fit_lattice(picture, reduced_basis(basis))
    for _ in range(_STEPS - 1):
        fit = fit_lattice(picture, fit.basis)
    return fit


def _no_lattice(shape: tuple[int, ...], kind: str, pitch: float | None) -> Lattice:
    """Return a placeholder lattice for a picture without one."""
    step = 10.0 if pitch is None else float(pitch)
    high = step * (math.sqrt(3) / 2 if kind == "hexagonal" else 1.0)
    middle = ((shape[0] - 1) / 2, (shape[1] - 1) / 2)
    verdict = (
        f"No lattice: the picture has no repeated pattern; the pitch of {step:g} px was not "
        "measured. Pass a white image."
    )
    return Lattice(
        kind, middle, (high, 0.0), (0.0, step), (shape[0], shape[1]), math.nan, "low", verdict
    )


def _lattice_of(fit: PhaseFit, kind: str | None, shape: tuple[int, ...]) -> Lattice:
    """Choose rows, columns and the central lenslet of a fitted lattice."""
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

    Rows of a square lattice follow along +y; rows of a hexagonal lattice run along the nearest
    neighbours, whether these lie closer to the x or to the y axis.
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
    lattice: Lattice, candidate: _Candidate, kind: str | None, pitch: float | None
) -> Lattice:
    """Return the lattice with its trust and the reason for it."""
    along, across = lattice.pitch
    count = len(lattice.centres())
    size = (
        f"{along:.3f} x {across:.3f} px"
        if lattice.kind == "square"
        else (f"{lattice.neighbour:.3f} px")
    )
    summary = (
        f"{lattice.kind.capitalize()} lattice, pitch {size}, rotation "
        f"{math.degrees(lattice.rotation):.2f} degrees, {count} lenslets"
    )
    doubts = _doubts(lattice, candidate, count, pitch)
    if doubts:
        verdict = f"{summary}: low trust, because {doubts[0]}. Pass a white image."
        return replace(lattice, trust="low", verdict=verdict)
    verdict = f"{summary}: local lattices agree with it to {lattice.residual:.3f} px rms."
    return replace(lattice, trust="high", verdict=verdict)


def _doubts(lattice: Lattice, candidate: _Candidate, count: int, pitch: float | None) -> list[str]:
    near = lattice.neighbour
    row, column = np.array(lattice.row), np.array(lattice.column)
    skew = math.degrees(math.asin(abs(row @ column) / np.hypot(*row) / np.hypot(*column)))
    sides = np.hypot(*row) / np.hypot(*column)
    if lattice.kind == "hexagonal":
        ratio = sides * (math.sqrt(3) / 2 if lattice.turned else 2 / math.sqrt(3))
        uneven = max(ratio, 1 / ratio) > _MAX_HEXAGON_RATIO
    else:
        uneven = max(sides, 1 / sides) > _MAX_RECTANGLE_RATIO
    tests = {
        f"it has only {count} lenslets": count < _MIN_LENSLETS,
        f"its cell is not a {'square' if lattice.kind == 'square' else 'hexagon'}": (
            skew > _MAX_SKEW_DEG or uneven
        ),
        f"only {100 * candidate.share:.0f} % of the repeated pattern fits it": candidate.share
        < _MIN_PEAK_SHARE,
        f"only {100 * candidate.fit.agreeing:.0f} % of the picture agrees with it": (
            candidate.fit.agreeing < _MIN_AGREEING
        ),
        f"local lattices lie {lattice.residual:.2g} px rms away": lattice.residual
        > max(_MAX_SPREAD * near, _MIN_SPREAD_PX),
        f"equal lenslets explain only {100 * max(candidate.explained, 0):.0f} % of the contrast": (
            candidate.explained < _MIN_EXPLAINED
        ),
        f"the nominal pitch is {pitch} px": pitch is not None and not 0.8 < near / pitch < 1.25,
        f"it is rotated by {math.degrees(lattice.rotation):.0f} degrees": (
            abs(lattice.rotation) > math.radians(_MAX_ROTATION_DEG)
        ),
        "the pitch is outside 5 to 60 px": not 4.8 <= near <= 63,
    }
    return [reason for reason, failed in tests.items() if failed]
