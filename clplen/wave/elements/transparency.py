"""Arbitrary pictures as elements of one plane."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.compute import lengths
from clplen.errors import ShapeError
from clplen.wave.field.arguments import check_centre
from clplen.wave.field.field import Field, Grid, require_field
from clplen.wave.field.transmission import multiply

Picture = np.ndarray[Any, Any]


def transparency(
    field: Field,
    amplitude: Any = None,
    *,
    phase: Any = None,
    pitch: float | tuple[float, float] | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Field:
    """A picture as a thin element: u a exp(i phase), area-weighted on the samples of the field.

    With a ``pitch`` every sample takes the mean of a exp(i phase) over its cell, picture pixels
    being rectangles of constant transmission: the exact overlap of both grids, in float64 on the
    host. A rapidly varying phase is therefore averaged out where the field is the coarser grid.

    Parameters
    ----------
    field : Field
    amplitude : array_like, optional
        Shape (ny, nx), real or complex, unitless: 0 dark, 1 clear (divide 8-bit pictures by 255).
        None: 1 everywhere on the picture.
    phase : array_like, optional
        Shape (ny, nx), radians; positive retards as exp(+ikz) does. None: 0.
    pitch : float or tuple of float, optional
        Pixel spacing of the picture in metres, (dy, dx) or one number. None: the picture lies on
        the field's own samples and has its shape. Outside a picture with a pitch nothing passes.
    centre : tuple of float
        (y, x) in metres of pixel [ny//2, nx//2]; needs a pitch.

    Returns
    -------
    Field

    Raises
    ------
    ShapeError
        If amplitude, phase and (without a pitch) the field differ in shape, or the picture varies
        along an axis of length 1 of the field.
    ValueError
        If there is neither amplitude nor phase, a value is not finite, the pitch is not positive,
        or a centre comes without a pitch.
    """
    require_field(field)
    picture = _picture(amplitude, phase)
    if pitch is None:
        if tuple(centre) != (0.0, 0.0):
            raise ValueError(
                f"A picture without pitch lies on the field's samples: its centre {centre!r} "
                "needs a pitch in metres."
            )
        if picture.shape != field.grid.shape:
            raise ShapeError(
                f"The picture has shape {picture.shape}, the field {field.grid.shape}: they must "
                "agree, or give the pitch of the picture in metres."
            )
        return apply_transmission(field, picture)
    return apply_transmission(field, _resample(picture, _place(picture, pitch, centre), field.grid))


def apply_transmission(field: Field, transmission: Picture) -> Field:
    """``field`` (or each of a batch) times a transmission of shape (ny, nx) from the host."""
    device = field.device
    return multiply(field, device.upload(transmission.astype(device.complex, copy=False)))


def _picture(amplitude: Any, phase: Any) -> Picture:
    """The complex (or real, without phase) transmission of the pixels in double precision."""
    if amplitude is None and phase is None:
        raise ValueError("A transparency has an amplitude, a phase or both; neither was given.")
    parts = {"amplitude": amplitude, "phase": phase}
    given = {name: np.asarray(part) for name, part in parts.items() if part is not None}
    for name, part in given.items():
        if part.ndim != 2 or 0 in part.shape:
            raise ShapeError(f"The {name} of a picture has shape (ny, nx), not {part.shape}.")
        bad = int(np.count_nonzero(~np.isfinite(part)))
        if bad:
            raise ValueError(
                f"The {name} of the picture has {bad} values that are NaN or infinite: replace "
                "them, by 0 for no light."
            )
    if len({part.shape for part in given.values()}) == 2:
        raise ShapeError(
            f"The amplitude has shape {given['amplitude'].shape}, the phase "
            f"{given['phase'].shape}: they must agree."
        )
    if phase is not None and np.iscomplexobj(given["phase"]):
        raise ValueError("The phase of a picture is real, in radians; an amplitude may be complex.")
    if phase is None:
        values = given["amplitude"]
        return values.astype(np.complex128 if np.iscomplexobj(values) else np.float64)
    return given.get("amplitude", 1.0) * np.exp(1j * given["phase"].astype(np.float64))


def _place(
    picture: Picture, pitch: float | tuple[float, float], centre: tuple[float, float]
) -> Grid:
    """The pixels as a grid, with messages that speak of a picture."""
    spacing = np.broadcast_to(np.asarray(pitch, np.float64), (2,))
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise ValueError(f"A picture's pitch is positive and finite, in metres, not {pitch!r}.")
    lengths.PITCH.check(pitch, "A picture's pitch")
    check_centre(centre, "a picture")
    shape = (picture.shape[0], picture.shape[1])
    return Grid(shape, (float(spacing[0]), float(spacing[1])), origin=centre)


def _resample(picture: Picture, pixels: Grid, grid: Grid) -> Picture:
    """Mean of the picture over every cell of ``grid``, 0 outside the picture."""
    weights = [_overlap_weights(grid, pixels, axis) for axis in (0, 1)]
    return (weights[1] @ (weights[0] @ picture).T).T


def _overlap_weights(grid: Grid, pixels: Grid, axis: int) -> Any:
    """Fraction of each cell of ``grid`` that each pixel covers along an axis, shape (n, n pixels).

    All edges of both grids cut the axis into pieces; each lies in one cell and in one pixel.
    """
    from scipy import sparse  # here, because importing it takes a while

    size = (grid.shape[axis], pixels.shape[axis])
    if grid.shape[axis] == 1:
        if pixels.shape[axis] != 1:
            raise ShapeError(
                f"Nothing varies along axis {axis} of the field, but the picture has "
                f"{pixels.shape[axis]} pixels there: give it one."
            )
        return sparse.csr_matrix(np.ones(size))
    cells, pixel_edges = _edges(grid, axis), _edges(pixels, axis)
    low, high = max(cells[0], pixel_edges[0]), min(cells[-1], pixel_edges[-1])
    cuts = np.union1d(cells, pixel_edges)
    cuts = cuts[(cuts >= low) & (cuts <= high)]
    middle, length = (cuts[1:] + cuts[:-1]) / 2, np.diff(cuts)
    row = np.clip(np.searchsorted(cells, middle) - 1, 0, size[0] - 1)
    column = np.clip(np.searchsorted(pixel_edges, middle) - 1, 0, size[1] - 1)
    return sparse.csr_matrix((length / grid.pitch[axis], (row, column)), shape=size)


def _edges(grid: Grid, axis: int) -> Picture:
    """The n + 1 edges of the cells along an axis in metres."""
    n, pitch = grid.shape[axis], grid.pitch[axis]
    return grid.origin[axis] + (np.arange(n + 1) - n // 2 - 0.5) * pitch
