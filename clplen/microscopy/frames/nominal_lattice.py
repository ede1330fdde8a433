"""Lattices from their parameters, without a white frame, and checks of lattices and pitch."""

from __future__ import annotations

import math

from clplen.checks import fits_float64
from clplen.errors import ShapeError
from clplen.lightfield.raw.lenslet_lattice import Lattice

MIN_PITCH_PIXELS = 3  # smaller lenslets are not resolved
MIN_SQUARENESS = 0.9  # sine of the angle between rows and columns, and ratio of their steps
PITCH_TOLERANCE = 0.005  # relative; makers' figures agree to it


def square_lattice(
    pitch: float,
    shape: tuple[int, int],
    *,
    offset: tuple[float, float] | None = None,
    rotation: float = 0.0,
) -> Lattice:
    """Return a square lattice from its pitch, a centre and an angle.

    Parameters
    ----------
    pitch : float
        Pitch in pixels, at least 3.
    shape : tuple of int
        Shape (ny, nx) of the frames.
    offset : tuple of float, optional
        Centre (y, x) of a lenslet in pixels; pixel centres have integer coordinates. Default: a
        lenslet in the corner, ((pitch - 1)/2, (pitch - 1)/2).
    rotation : float
        Angle of the lattice in radians, from +x towards +y.

    Returns
    -------
    Lattice
        Lattice with the shape of the frames.

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
            "pitch, offset, rotation and shape must be finite numbers, got "
            f"{pitch}, {offset}, {rotation} and {shape}."
        )
    first = ((pitch - 1) / 2, (pitch - 1) / 2) if offset is None else offset
    cos, sin = pitch * math.cos(rotation), pitch * math.sin(rotation)
    if not (cos > 0 and pitch >= MIN_PITCH_PIXELS):
        raise ValueError(
            f"The pitch must be at least {MIN_PITCH_PIXELS} pixels and the rotation less than 90 "
            f"degrees, got {pitch:g} pixels and {math.degrees(rotation):g} degrees."
        )
    lattice = Lattice("square", (first[0], first[1]), (cos, -sin), (sin, cos), shape)
    check_lattice(lattice)
    return lattice


def check_lattice(lattice: Lattice) -> None:
    """Raise an error if frames cannot be rectified with the lattice."""
    across, down = lattice.pitch
    if lattice.shape is None:
        raise ValueError("The lattice has no frame shape: give its shape.")
    if min(across, down) < MIN_PITCH_PIXELS:
        raise ValueError(
            f"The lenslet pitch must be at least {MIN_PITCH_PIXELS} pixels, got "
            f"{min(across, down):.4g}: give the lengths of the lattice in pixels of the frame."
        )
    sine = (lattice.row[0] * lattice.column[1] - lattice.row[1] * lattice.column[0]) / across / down
    if lattice.kind == "square" and min(sine, across / down, down / across) < MIN_SQUARENESS:
        raise ValueError(
            "The rows and columns of the lattice must form squares, got "
            f"{lattice.row} and {lattice.column} pixels."
        )
    if max(across, down) > min(lattice.shape):
        raise ShapeError(
            f"Lenslets {max(across, down):.4g} pixels apart do not fit a frame of "
            f"{lattice.shape[0]} x {lattice.shape[1]} pixels."
        )


def pitch_sentence(lattice: Lattice, nominal: float) -> str | None:
    """Return a message if the measured and the nominal pitch differ, else None."""
    measured = math.sqrt(math.prod(lattice.pitch))
    ratio = measured / nominal
    if abs(ratio - 1) <= PITCH_TOLERANCE:
        return None
    return (
        f"the measured lenslet pitch is {measured:.4g} pixels, {nominal:.4g} by the parameters: "
        f"{abs(100 * (ratio - 1)):.3g} % {'more' if ratio > 1 else 'less'}. If a relay between "
        f"array and sensor magnifies {ratio:.4g} times, or the pixels are smaller by this factor, "
        "rectification corrects it; if the lenslet pitch is wrong, voxels and z are wrong: correct "
        "pixel_size or ulens_pitch."
    )
