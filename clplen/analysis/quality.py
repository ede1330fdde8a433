"""Scores of disparity maps by the metrics of the HCI 4D light field benchmark.

Honauer, Johannsen, Kondermann and Goldluecke 2016, "A dataset and evaluation methodology for depth
estimation on 4D light fields". Where the paper gives no formula, the benchmark's tools define it.
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

DEFAULT_BORDER = 15  # pixels excluded on each side, as in the benchmark
MAX_ROUGHNESS = 0.05  # clipping level of the Hessian's norm, as in the benchmark
MIN_EDGE_ERROR = 0.15  # error in pixels above which a pixel at an edge is fattened or thinned
MASKS = ("planes", "smooth", "near", "far", "edges")
_SMOOTH = (3 / 16, 10 / 16, 3 / 16)


class Depths(Protocol):
    """Camera parameters for normals, such as `clplen.io.read_parameters` returns."""

    focal_length_mm: float | None
    sensor_size_mm: float | None

    def depth(self, d: ArrayLike) -> Real:
        """Convert a disparity to metres."""


@dataclass(frozen=True, repr=False)
class Scores(OneLine):
    """Errors of a disparity map; smaller is better, NaN is not available.

    Attributes
    ----------
    pixels : int
        Number of evaluated pixels.
    missing : float
        Percentage of evaluated pixels without a finite value; they count as bad pixels.
    covered : float
        Percentage of the truth inside its border that the map covers.
    badpix_07, badpix_03, badpix_01 : float
        Percentage with abs(error) > 0.07, 0.03, 0.01 or without a value.
    mse : float
        Mean square error x 100 of the pixels with a value.
    q25 : float
        First quartile of abs(error) x 100, missing values last.
    median : float
        Median abs(error) in pixels, infinite if most values are missing.
    bumpiness_planes, bumpiness_smooth : float
        Mean Frobenius norm x 100 of the Hessian of the error by Scharr's filters, clipped at 0.05,
        on planes and on curved surfaces; 0.05 for a missing value.
    mae_planes, mae_smooth : float
        Median angle between the normals in degrees, on planes and on curved surfaces.
    fattening : float
        Percentage of the farther pixels at edges with an error above 0.15 (too near).
    thinning : float
        Percentage of the nearer pixels at edges with an error below -0.15 (too far).
    edges : float
        Percentage of BadPix 0.07 among the pixels at edges.

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
        """Format the scores as a table, without unavailable rows."""
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
    border: int = DEFAULT_BORDER,
    offset: tuple[int, int] | None = None,
    parameters: Depths | None = None,
) -> Scores:
    """Score a disparity map against the truth.

    Pixels without a truth (NaN, masked) are excluded; pixels without a result (NaN, infinite,
    masked) are bad.

    Parameters
    ----------
    result : array_like
        Disparity of the centre view in pixels a view step, nearer larger, shape (y, x).
    truth : array_like or Truth
        True disparity, in the unit and sign of ``result``; a `Truth` brings its masks.
    masks : mapping of str to array_like, optional
        Masks in the shape of the truth, nonzero inside: any of "planes", "smooth" (bumpiness,
        normals), "near", "far" (thinning, fattening), "edges"; they replace those of a `Truth`.
    where : array_like, optional
        Mask in the shape of the truth; only nonzero pixels are evaluated.
    border : int
        Number of pixels of the truth to exclude on each side.
    offset : tuple of int, optional
        Pixel (y, x) of the truth at the result's first pixel, for a cropped map.
    parameters : Depths, optional
        Camera parameters ``focal_length_mm``, ``sensor_size_mm`` and ``depth(d)``, such as
        `clplen.io.read_parameters` returns; required for normals.

    Returns
    -------
    Scores
        Scores of the evaluated pixels; NaN where a mask or the parameters are missing.

    Raises
    ------
    ShapeError
        If the shapes do not match.
    ValueError
        If no pixel remains, or ``border`` or the name of a mask is invalid.

    Examples
    --------
    >>> truth = np.tile(np.linspace(-1, 1, 32), (32, 1))
    >>> result = truth + 0.05
    >>> result[8:16, 8:16] = np.nan  # no estimate
    >>> scores = clplen.analysis.score(result, truth, border=4)
    >>> f"{scores.badpix_07:.1f} % bad, MSE x 100 = {scores.mse:.2f}"
    '11.1 % bad, MSE x 100 = 0.25'
    """
    reference = real_map(getattr(truth, "disparity", truth), "The truth", np.float64)
    estimate = real_map(result, "The result", np.float64)
    if reference.ndim != 2 or estimate.ndim != 2:
        raise ShapeError(
            f"result and truth must have shape (y, x), got {estimate.shape} and {reference.shape}."
        )
    if not is_integer(border) or border < 0:
        raise ValueError(f"border must be an integer of at least 0, got {border!r}.")
    inner = _inside(reference.shape, int(border)) & np.isfinite(reference)
    if where is not None:
        inner &= _mask(where, reference.shape, "where")
    cut = _cut(estimate.shape, reference.shape, offset)
    judge = inner[cut]
    if not judge.any():
        raise ValueError(
            f"No pixel is left to score: the truth of {reference.shape} has a border of {border} "
            f"and {np.isfinite(reference).sum()} finite values, the result has {estimate.shape} "
            "pixels."
        )
    masks_by_name = masks if masks is not None else getattr(truth, "masks", {})
    selected = _selected_masks(masks_by_name, judge, cut, reference.shape)
    covered = 100 * judge.sum() / inner.sum()
    return _scores(estimate, reference[cut], judge, selected, float(covered), parameters)


def _scores(
    estimate: Real,
    reference: Real,
    judge: Mask,
    selected: dict[str, Mask],
    covered: float,
    parameters: Depths | None,
) -> Scores:
    """Compute all scores of maps of equal shape."""
    estimate = np.where(np.isfinite(estimate), estimate, np.nan)
    error = estimate - reference
    size = np.where(np.isnan(error), np.inf, np.abs(error))
    ordered = np.sort(size[judge])
    valid = judge & np.isfinite(size)
    near, far, edges = (selected.get(name) for name in ("near", "far", "edges"))
    is_shaped = bool({"planes", "smooth"} & selected.keys())
    rough = roughness(error) if is_shaped else error
    angles = (
        _angles(estimate, reference, parameters) if is_shaped and parameters is not None else None
    )
    return Scores(
        pixels=int(judge.sum()),
        missing=_percent(np.isinf(size), judge),
        covered=covered,
        badpix_07=_percent(size > 0.07, judge),
        badpix_03=_percent(size > 0.03, judge),
        badpix_01=_percent(size > 0.01, judge),
        mse=100 * float(np.mean(error[valid] ** 2)) if valid.any() else math.nan,
        q25=100 * float(ordered[int(0.25 * ordered.size)]),
        median=float(np.median(ordered)),
        bumpiness_planes=100 * _mean(rough, selected.get("planes")),
        bumpiness_smooth=100 * _mean(rough, selected.get("smooth")),
        mae_planes=_median(angles, selected.get("planes")),
        mae_smooth=_median(angles, selected.get("smooth")),
        fattening=_percent(error > MIN_EDGE_ERROR, far),
        thinning=_percent(error < -MIN_EDGE_ERROR, near),
        edges=_percent(size > 0.07, edges),
    )


def roughness(error: Real) -> Real:
    """Compute the Frobenius norm of the Hessian of an error map, clipped at 0.05; 0.05 for NaN.

    Each derivative is Scharr's filter, (3, 10, 3)/16 across (1, 0, -1), as in the benchmark: twice
    the slope per pixel.
    """
    slopes = [_scharr(error, axis) for axis in (0, 1)]
    total = sum(_scharr(slope, axis) ** 2 for slope in slopes for axis in (0, 1))
    norm = np.minimum(np.sqrt(total), MAX_ROUGHNESS)
    return np.where(np.isnan(norm), MAX_ROUGHNESS, norm)


def _scharr(values: Real, axis: int) -> Real:
    """Compute twice the slope along an axis, with mirrored edges."""
    padded = np.pad(values, 1, mode="symmetric")
    along = np.moveaxis(padded, axis, 0)
    slope_rows = along[2:] - along[:-2]
    n = slope_rows.shape[1] - 2
    smooth = sum(weight * slope_rows[:, k : k + n] for k, weight in enumerate(_SMOOTH))
    return np.moveaxis(np.asarray(smooth), 0, axis)


def _angles(estimate: Real, reference: Real, parameters: Depths) -> Real:
    """Compute the angle between normals in degrees; 180 where a normal is missing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        product = (_normals(estimate, parameters) * _normals(reference, parameters)).sum(axis=0)
    angle = np.degrees(np.arccos(np.clip(product, -1, 1)))
    return np.where(np.isnan(angle), 180.0, angle)


def _normals(disparity: Real, parameters: Depths) -> Real:
    """Compute unit normals of the surface, shape (3, y, x), as the benchmark's tools do.

    X = x/(2 (W - 1)) sensor Z/f from the first column, Y alike; derivatives by Scharr's filter.
    """
    f, sensor = parameters.focal_length_mm, parameters.sensor_size_mm
    if not f or not sensor:
        raise ValueError("parameters must hold the focal length and the sensor size for normals.")
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
    """Return True where a mask is nonzero."""
    mask = host_array(values, f"The mask {name}")
    if mask.shape != shape:
        raise ShapeError(f"The mask {name} must have the truth's shape {shape}, got {mask.shape}.")
    return mask != 0


def _cut(
    estimate: tuple[int, ...], reference: tuple[int, ...], offset: tuple[int, int] | None
) -> tuple[slice, slice]:
    """Return the part of the truth that the result covers."""
    if offset is None:
        if estimate != reference:
            raise ShapeError(
                f"The result has {estimate} pixels (y, x), the truth {reference}: set "
                "offset=(y, x) for a cropped map; do not resize it."
            )
        offset = (0, 0)
    y, x = (int(n) for n in offset)
    if min(y, x) < 0 or y + estimate[0] > reference[0] or x + estimate[1] > reference[1]:
        raise ShapeError(
            f"A result of {estimate} pixels at offset {tuple(offset)} does not lie within the "
            f"truth of {reference}."
        )
    return slice(y, y + estimate[0]), slice(x, x + estimate[1])


def _selected_masks(
    masks_by_name: Mapping[str, ArrayLike], judge: Mask, cut: Any, shape: tuple[int, ...]
) -> dict[str, Mask]:
    """Return the evaluated pixels of each mask."""
    for name in masks_by_name:
        if name not in MASKS:
            raise ValueError(f"masks must be among {', '.join(MASKS)}, got {name!r}.")
    return {name: _mask(mask, shape, name)[cut] & judge for name, mask in masks_by_name.items()}


def _percent(bad: Mask, of: Mask | None) -> float:
    """Return the percentage of True pixels in a mask; NaN without a mask."""
    if of is None or not of.any():
        return math.nan
    return float(100 * np.mean(bad[of]))


def _mean(values: Real, of: Mask | None) -> float:
    return math.nan if of is None or not of.any() else float(values[of].mean())


def _median(values: Real | None, of: Mask | None) -> float:
    if values is None or of is None or not of.any():
        return math.nan
    return float(np.median(values[of]))
