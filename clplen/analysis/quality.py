"""How good a disparity map is, by the definitions of the HCI 4D light field benchmark.

Honauer, Johannsen, Kondermann and Goldluecke 2016, "A dataset and evaluation methodology for depth
estimation on 4D light fields", and the benchmark's own tools, whose formulas are followed where the
paper leaves them open. Needs NumPy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from clplen.cameras.scenes.ground_truth import Truth
from clplen.checks import host_array, is_integer, real_map
from clplen.errors import ShapeError
from clplen.reprs import OneLine, columns

Real = np.ndarray[Any, np.dtype[np.float64]]
Mask = np.ndarray[Any, np.dtype[np.bool_]]

BORDER = 15  # pixels left out on each side
ROUGHEST = 0.05  # at which the Hessian's norm is clipped
BESIDE = 0.15  # error at which a pixel beside an edge counts as fattened or thinned
MASKS = ("planes", "smooth", "near", "far", "edges")
_SMOOTH = (3 / 16, 10 / 16, 3 / 16)


class Depths(Protocol):
    """What normals need of a camera, such as `clplen.io.read_parameters` gives."""

    focal_length_mm: float | None
    sensor_size_mm: float | None

    def depth(self, d: ArrayLike) -> Real:
        """Metres of a disparity."""


@dataclass(frozen=True, repr=False)
class Scores(OneLine):
    """Errors of a disparity map; smaller is better, nan is not known.

    Attributes
    ----------
    pixels : int
        That were judged.
    missing : float
        Percentage of them without a finite value; these are bad pixels.
    covered : float
        Percentage of the truth inside its border that the map covers.
    badpix_07, badpix_03, badpix_01 : float
        Percentage with abs(error) > 0.07, 0.03, 0.01 or without a value.
    mse : float
        Mean square error x 100, of the pixels with a value.
    q25 : float
        The abs(error) x 100 at index int(n/4) of all sorted errors; missing ones come last.
    median : float
        Median abs(error) in pixels, infinite where most are missing.
    bumpiness_planes, bumpiness_smooth : float
        Mean Frobenius norm x 100 of the Hessian of the error by Scharr's filters, clipped at 0.05,
        on planes and on curved surfaces; a pixel without a value counts 0.05.
    mae_planes, mae_smooth : float
        Median angle between the normals in degrees, there.
    fattening : float
        Percentage, of the farther pixels beside edges, that came out nearer by more than 0.15.
    thinning : float
        Percentage, of the nearer pixels beside edges, that came out farther by more than 0.15.
    edges : float
        BadPix 0.07 of the pixels beside edges.

    Examples
    --------
    >>> truth = np.tile(np.linspace(-1, 1, 32), (32, 1))
    >>> print(clplen.analysis.score(truth + 0.05, truth, border=4))
    pixels        576
    missing         0 %
    covered       100 %
    BadPix 0.07     0 %
    BadPix 0.03   100 %
    ...
    """

    pixels: int
    missing: float
    covered: float
    badpix_07: float
    badpix_03: float
    badpix_01: float
    mse: float
    q25: float
    median: float
    bumpiness_planes: float = math.nan
    bumpiness_smooth: float = math.nan
    mae_planes: float = math.nan
    mae_smooth: float = math.nan
    fattening: float = math.nan
    thinning: float = math.nan
    edges: float = math.nan

    def __str__(self) -> str:
        """A table; what is not known is left out."""
        rows = [
            (label, f"{value:.4g}", unit)
            for (label, unit), value in zip(_LABELS, asdict(self).values(), strict=True)
            if not math.isnan(value)
        ]
        rows[0] = ("pixels", str(self.pixels), "")
        lines = columns([row[:2] for row in rows], "<>")
        return "\n".join(f"{line} {row[2]}".rstrip() for line, row in zip(lines, rows, strict=True))


_LABELS = (
    ("pixels", ""),
    ("missing", "%"),
    ("covered", "%"),
    ("BadPix 0.07", "%"),
    ("BadPix 0.03", "%"),
    ("BadPix 0.01", "%"),
    ("MSE x 100", "px^2"),
    ("Q25 x 100", "px"),
    ("median error", "px"),
    ("bumpiness of planes", ""),
    ("bumpiness of curved surfaces", ""),
    ("normals of planes", "degrees"),
    ("normals of curved surfaces", "degrees"),
    ("fattening", "%"),
    ("thinning", "%"),
    ("BadPix 0.07 at edges", "%"),
)


def score(
    result: ArrayLike,
    truth: ArrayLike | Truth,
    *,
    masks: Mapping[str, ArrayLike] | None = None,
    where: ArrayLike | None = None,
    border: int = BORDER,
    offset: tuple[int, int] | None = None,
    parameters: Depths | None = None,
) -> Scores:
    """Judge a disparity map.

    Pixels without a truth (nan, masked) are left out; pixels without a result (nan, infinite,
    masked) are bad.

    Parameters
    ----------
    result : array_like
        Disparity of the centre view in pixels a view step, nearer larger, shape (y, x).
    truth : array_like or Truth
        The same of the truth; a `Truth` brings its masks.
    masks : mapping of str to array_like, optional
        Shape of the truth, not 0 where it holds: any of "planes", "smooth" (bumpiness, normals),
        "near", "far" (thinning, fattening), "edges"; in place of those of a `Truth`.
    where : array_like, optional
        Shape of the truth: only pixels that are not 0 are judged.
    border : int
        Pixels of the truth that are left out on each side.
    offset : tuple of int, optional
        (y, x) of the truth's pixel that the result's first one is, for a cropped map.
    parameters : Depths, optional
        Of the camera, with ``focal_length_mm``, ``sensor_size_mm`` and ``depth(d)``, such as
        `clplen.io.read_parameters` gives: needed for normals.

    Returns
    -------
    Scores
        Of the pixels that were judged; NaN where a mask or the parameters are missing.

    Raises
    ------
    ShapeError
        If the shapes do not fit.
    ValueError
        If no pixel is left to judge, or a number or a name of a mask is wrong.

    Examples
    --------
    >>> truth = np.tile(np.linspace(-1, 1, 32), (32, 1))
    >>> result = truth + 0.05
    >>> result[8:16, 8:16] = np.nan  # not found
    >>> scores = clplen.analysis.score(result, truth, border=4)
    >>> f"{scores.badpix_07:.1f} % bad, MSE x 100 = {scores.mse:.2f}"
    '11.1 % bad, MSE x 100 = 0.25'
    """
    known = real_map(getattr(truth, "disparity", truth), "The truth", np.float64)
    found = real_map(result, "The result", np.float64)
    if known.ndim != 2 or found.ndim != 2:
        raise ShapeError(
            f"Disparity maps have shape (y, x); the result has {found.shape}, the truth "
            f"{known.shape}."
        )
    if not is_integer(border) or border < 0:
        raise ValueError(f"border is a whole number of pixels, not negative, not {border!r}.")
    inner = _inside(known.shape, int(border)) & np.isfinite(known)
    if where is not None:
        inner &= _mask(where, known.shape, "where")
    cut = _cut(found.shape, known.shape, offset)
    judge = inner[cut]
    if not judge.any():
        raise ValueError(
            f"No pixel is left to judge: the truth of {known.shape} has a border of {border} and "
            f"{np.isfinite(known).sum()} finite values, the result has {found.shape} pixels."
        )
    given = masks if masks is not None else getattr(truth, "masks", {})
    chosen = _chosen(given, judge, cut, known.shape)
    covered = 100 * judge.sum() / inner.sum()
    return _scores(found, known[cut], judge, chosen, float(covered), parameters)


def _scores(
    found: Real,
    known: Real,
    judge: Mask,
    chosen: dict[str, Mask],
    covered: float,
    parameters: Depths | None,
) -> Scores:
    """All figures of maps of one shape."""
    found = np.where(np.isfinite(found), found, np.nan)
    error = found - known
    size = np.where(np.isnan(error), np.inf, np.abs(error))
    ordered = np.sort(size[judge])
    some = judge & np.isfinite(size)
    near, far, edges = (chosen.get(name) for name in ("near", "far", "edges"))
    is_shaped = bool({"planes", "smooth"} & chosen.keys())
    rough = roughness(error) if is_shaped else error
    turn = _angles(found, known, parameters) if is_shaped and parameters is not None else None
    return Scores(
        pixels=int(judge.sum()),
        missing=_percent(np.isinf(size), judge),
        covered=covered,
        badpix_07=_percent(size > 0.07, judge),
        badpix_03=_percent(size > 0.03, judge),
        badpix_01=_percent(size > 0.01, judge),
        mse=100 * float(np.mean(error[some] ** 2)) if some.any() else math.nan,
        q25=100 * float(ordered[int(0.25 * ordered.size)]),
        median=float(np.median(ordered)),
        bumpiness_planes=100 * _mean(rough, chosen.get("planes")),
        bumpiness_smooth=100 * _mean(rough, chosen.get("smooth")),
        mae_planes=_median(turn, chosen.get("planes")),
        mae_smooth=_median(turn, chosen.get("smooth")),
        fattening=_percent(error > BESIDE, far),
        thinning=_percent(error < -BESIDE, near),
        edges=_percent(size > 0.07, edges),
    )


def roughness(error: Real) -> Real:
    """Frobenius norm of the Hessian of an error map, clipped at 0.05; nan counts 0.05.

    Each derivative is Scharr's filter, (3, 10, 3)/16 across (1, 0, -1), as the benchmark uses it:
    twice the slope a pixel.
    """
    slopes = [_scharr(error, axis) for axis in (0, 1)]
    total = sum(_scharr(slope, axis) ** 2 for slope in slopes for axis in (0, 1))
    norm = np.minimum(np.sqrt(total), ROUGHEST)
    return np.where(np.isnan(norm), ROUGHEST, norm)


def _scharr(values: Real, axis: int) -> Real:
    """Twice the slope along an axis; the edge is mirrored."""
    padded = np.pad(values, 1, mode="symmetric")
    along = np.moveaxis(padded, axis, 0)
    rise = along[2:] - along[:-2]
    n = rise.shape[1] - 2
    smooth = sum(weight * rise[:, k : k + n] for k, weight in enumerate(_SMOOTH))
    return np.moveaxis(np.asarray(smooth), 0, axis)


def _angles(found: Real, known: Real, parameters: Depths) -> Real:
    """Angle between the normals in degrees; 180 where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        product = (_normals(found, parameters) * _normals(known, parameters)).sum(axis=0)
    angle = np.degrees(np.arccos(np.clip(product, -1, 1)))
    return np.where(np.isnan(angle), 180.0, angle)


def _normals(disparity: Real, parameters: Depths) -> Real:
    """Unit normals of the surface, shape (3, y, x).

    As the benchmark's tools project it: X = x/(2 (W - 1)) sensor Z/f from the first column on, and
    Y alike; derivatives by Scharr's filter.
    """
    f, sensor = parameters.focal_length_mm, parameters.sensor_size_mm
    if not f or not sensor:
        raise ValueError("Normals need the focal length and the sensor size of the camera.")
    Z = np.asarray(parameters.depth(disparity), np.float64)
    ny, nx = Z.shape
    X = np.arange(nx)[None, :] / max(1, nx - 1) / 2 * sensor / f * Z
    Y = np.arange(ny)[:, None] / max(1, ny - 1) / 2 * sensor / f * Z
    down, right = (np.stack([_scharr(part, axis) for part in (X, Y, Z)]) for axis in (0, 1))
    normal = np.cross(down, right, axis=0)
    return normal / np.sqrt((normal**2).sum(axis=0))


def _inside(shape: tuple[int, ...], border: int) -> Mask:
    mask = np.zeros(shape, bool)
    mask[border : shape[0] - border, border : shape[1] - border] = True
    return mask


def _mask(values: ArrayLike, shape: tuple[int, ...], name: str) -> Mask:
    """Where an array is not 0."""
    mask = host_array(values, f"The mask {name}")
    if mask.shape != shape:
        raise ShapeError(f"The mask {name} has shape {mask.shape}; the truth has {shape}.")
    return mask != 0


def _cut(
    found: tuple[int, ...], known: tuple[int, ...], offset: tuple[int, int] | None
) -> tuple[slice, slice]:
    """Where a result lies in the truth."""
    if offset is None:
        if found != known:
            raise ShapeError(
                f"The result has {found} pixels (y, x), the truth {known}: for a cropped map give "
                "its offset=(y, x); do not resize it."
            )
        offset = (0, 0)
    y, x = (int(n) for n in offset)
    if min(y, x) < 0 or y + found[0] > known[0] or x + found[1] > known[1]:
        raise ShapeError(
            f"A result of {found} pixels at offset {tuple(offset)} does not lie within the truth "
            f"of {known}."
        )
    return slice(y, y + found[0]), slice(x, x + found[1])


def _chosen(
    given: Mapping[str, ArrayLike], judge: Mask, cut: Any, shape: tuple[int, ...]
) -> dict[str, Mask]:
    """The judged pixels of each mask."""
    for name in given:
        if name not in MASKS:
            raise ValueError(f"There is no mask {name!r}; masks are {', '.join(MASKS)}.")
    return {name: _mask(mask, shape, name)[cut] & judge for name, mask in given.items()}


def _percent(bad: Mask, of: Mask | None) -> float:
    """How many of the pixels of a mask are so; nan if there is none."""
    if of is None or not of.any():
        return math.nan
    return float(100 * np.mean(bad[of]))


def _mean(values: Real, of: Mask | None) -> float:
    return math.nan if of is None or not of.any() else float(values[of].mean())


def _median(values: Real | None, of: Mask | None) -> float:
    if values is None or of is None or not of.any():
        return math.nan
    return float(np.median(values[of]))
