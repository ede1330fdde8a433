"""Lattices that are told, where no white frame shows them, and the pitch that parameters tell."""

from __future__ import annotations

import math

from clplen.checks import fits_float64
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_lattice import Lattice

SMALLEST = 3  # pixels, the pitch of a lattice that is looked for
SQUARE = 0.9  # least sine of the angle between rows and columns, and ratio of their steps
CLOSE = 0.005  # of the pitch, to which makers' figures are taken to agree


def square_lattice(
    pitch: float,
    shape: tuple[int, int],
    *,
    offset: tuple[float, float] | None = None,
    rotation: float = 0.0,
) -> Lattice:
    """Return a square lattice by its pitch, a centre and an angle.

    Parameters
    ----------
    pitch : float
        In pixels, from 3 on.
    shape : tuple of int
        (ny, nx) of the frames.
    offset : tuple of float, optional
        (y, x) of the centre of a lenslet in pixels, whose centres are integers; default that of a
        lenslet in the corner, ((pitch - 1)/2, (pitch - 1)/2).
    rotation : float
        In radians, by which +x is turned towards +y.

    Returns
    -------
    Lattice
        With the shape of the frames.

    Raises
    ------
    ValueError
        If the pitch is below 3 pixels, or a number is not finite.
    ShapeError
        If no lenslet fits the frame.

    Examples
    --------
    >>> clplen.microscopy.square_lattice(33.04, (500, 600)).column
    (0.0, 33.04)
    """
    if not all(map(fits_float64, (pitch, rotation, *(offset or ()), *shape))):
        raise ValueError(
            "The pitch, the offset, the rotation and the shape of a lattice are finite numbers, "
            f"not {pitch}, {offset}, {rotation} and {shape}."
        )
    first = ((pitch - 1) / 2, (pitch - 1) / 2) if offset is None else offset
    cos, sin = pitch * math.cos(rotation), pitch * math.sin(rotation)
    if not (cos > 0 and pitch >= SMALLEST):
        raise ValueError(
            f"A lattice has a pitch of {SMALLEST} pixels or more and is turned by less than 90 "
            f"degrees, not {pitch:g} pixels and {math.degrees(rotation):g} degrees."
        )
    found = Lattice("square", (first[0], first[1]), (cos, -sin), (sin, cos), shape)
    check_given(found)
    return found


def check_given(lattice: Lattice) -> None:
    """Refuse a lattice with which no frame can be rectified."""
    across, down = lattice.pitch
    if lattice.shape is None:
        raise ValueError("The lattice does not tell the shape of its frame: give it.")
    if min(across, down) < SMALLEST:
        raise ValueError(
            f"Lenslets {min(across, down):.4g} pixels apart are none: a lattice has {SMALLEST} or "
            "more; lengths of a lattice are pixels of the frame."
        )
    sine = (lattice.row[0] * lattice.column[1] - lattice.row[1] * lattice.column[0]) / across / down
    if lattice.kind == "square" and min(sine, across / down, down / across) < SQUARE:
        raise ValueError(
            f"The rows and columns of the lattice, {lattice.row} and {lattice.column} pixels, make "
            "no square."
        )
    if max(across, down) > min(lattice.shape):
        raise ShapeError(
            f"Lenslets {max(across, down):.4g} pixels apart do not fit a frame of "
            f"{lattice.shape[0]} x {lattice.shape[1]} pixels."
        )


def pitch_sentence(lattice: Lattice, nominal: float) -> str | None:
    """Return what it means that lenslets lie otherwise than the parameters say; None if alike."""
    measured = math.sqrt(math.prod(lattice.pitch))
    ratio = measured / nominal
    if abs(ratio - 1) <= CLOSE:
        return None
    return (
        f"lenslets lie {measured:.4g} pixels apart, {nominal:.4g} by the parameters: "
        f"{abs(100 * (ratio - 1)):.3g} % {'more' if ratio > 1 else 'less'}. If a relay between "
        f"array and sensor magnifies {ratio:.4g} times, or pixels are smaller by it, frames are "
        "right, because they are rectified; if the pitch of the lenslets is another, voxels and z "
        "are wrong: mend pixel_size or ulens_pitch."
    )
