"""Paraxial rays through an optical system, for its side view, and the labels of its parts.

A ray is (height, slope) at every part. A distance L moves it by L slope; a lens of focal length f
adds -height/f to its slope, a lenslet centred at c adds -(height - c)/f (ray transfer matrices:
Saleh and Teich 1991, section 1.4). Labels are stacked in rows so that none overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clplen.checks import check_finite, float64_array
from clplen.plot.base import Array
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.systems.components import Lens, Part, Stop, label_of, length_of
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.space import Space

_FILL = 0.7  # object or image height over the largest half opening
_MIN_RAYS, _MAX_RAYS = 9, 21  # rays between the marginal rays of a bundle on lenslets
_ZERO = 1e-9  # relative
_NARROW = 0.02  # half width over length of an unbounded bundle
LINE = 0.145  # inches of a line of text
_LETTER = 0.068  # inches of a letter
_FUNCTION = "function"  # label of a lambda


@dataclass(frozen=True)
class ImagePoint:
    """Position and height of the image of a point, in metres."""

    z: float
    height: float


@dataclass(frozen=True, repr=False)
class Rays(OneLine):
    """Rays, object and images of a side view.

    Attributes
    ----------
    z : ndarray
        Positions of the start and behind each part, in metres, shape (parts + 1,).
    axial, oblique : ndarray or None
        Heights of the rays from the axis and from the point at ``height``, shape (parts + 1, rays):
        marginal ray, others, marginal ray; NaN behind a stop that blocks them. None if nothing
        passes.
    chief : ndarray or None
        Height of the oblique ray through the middle of the aperture stop, shape (parts + 1, 1).
    height : float
        Height of the object in metres; 0 for a distant object.
    distant : bool
        Flag that the light is collimated, for a first element in the first plane.
    tilt : float
        Slope of collimated oblique rays in front of the system.
    images : tuple of ImagePoint
        Images by the axial rays in front of any lenslets: ``z`` and ``height`` in metres.

    Examples
    --------
    >>> optics = clplen.OpticalSystem([0.24, clplen.wave.Lens(0.12, diameter=3.6e-3), 0.24])
    >>> rays = clplen.plot.rays_through(optics, height=1e-3)
    >>> [(round(image.z, 6), round(image.height, 6)) for image in rays.images]
    [(0.48, -0.001)]
    """

    z: Array
    axial: Array | None
    oblique: Array | None
    chief: Array | None
    height: float
    distant: bool
    tilt: float
    images: tuple[ImagePoint, ...]


def rays_through(optics: OpticalSystem, *, height: float | None = None) -> Rays:
    """Trace rays from a point on the axis and from a point off the axis.

    For a first element in the first plane, the light is collimated, and the second bundle is
    tilted.

    Parameters
    ----------
    optics : OpticalSystem
        Optical system; without any opening the bundle is narrow.
    height : float, optional
        Height of the off-axis point in metres; default 70 % of the widest half opening, less if an
        image is larger than the object. Ignored for collimated light.

    Returns
    -------
    Rays
        Two bundles that just pass every opening, the chief ray, and the images.

    Examples
    --------
    >>> optics = clplen.OpticalSystem([0.24, clplen.wave.Lens(0.12, diameter=3.6e-3), 0.24])
    >>> rays = clplen.plot.rays_through(optics)
    >>> (rays.axial * 1e3).round(3).tolist()
    [[0.0, 0.0], [-1.8, 1.8], [-1.8, 1.8], [0.0, 0.0]]
    """
    check_finite(height=0 if height is None else height)
    distant = _is_distant(optics)
    fan, field = ((1.0, 0.0), (0.0, 1.0)) if distant else ((0.0, 1.0), (1.0, 0.0))
    z, axial_fan = trace(optics, *fan, clip=False)
    _, oblique_fan = trace(optics, *field, clip=False)
    points = _images(optics, z, axial_fan[:, 0], oblique_fan[:, 0])
    if height is None or distant:
        largest = max([0.0 if distant else 1.0, *(abs(image.height) for image in points)])
        largest = largest or 2 * float(np.abs(oblique_fan).max())
        half_field = _FILL * max([high - low for low, high in _bounds(optics).values()] or [0]) / 2
        height = half_field / largest if largest else 0.0
    images = tuple(ImagePoint(image.z, image.height * height) for image in points)
    start = (field[0] * height, field[1] * height)
    low, high, middle = _limits(optics, axial_fan[:, 0], 0 * oblique_fan[:, 0])
    axial = _bundle(optics, (0.0, 0.0), fan, (low, high)) if low < high else None
    low, high, middle = _limits(optics, axial_fan[:, 0], oblique_fan[:, 0] * height)
    has_oblique = axial is not None and height != 0 and low < high
    return Rays(
        z=z,
        axial=axial,
        oblique=_bundle(optics, start, fan, (low, high)) if has_oblique else None,
        chief=_bundle(optics, start, fan, (middle,))
        if has_oblique and low <= middle <= high
        else None,
        height=0.0 if distant else height,
        distant=distant,
        tilt=start[1],
        images=images,
    )


def trace(
    optics: OpticalSystem, height: Array | float, slope: Array | float, *, clip: bool = True
) -> tuple[Array, Array]:
    """Follow paraxial rays through the parts of a system.

    Parameters
    ----------
    optics : OpticalSystem
        Optical system of lenses, distances, stops and lenslets; other parts only add length.
    height : array_like
        Heights of the rays in the first plane in metres; broadcast with ``slope``.
    slope : array_like
        Slopes dy/dz of the rays in front of the first part.
    clip : bool
        True to end rays at openings and refract them at lenslets; False to ignore both.

    Returns
    -------
    z : numpy.ndarray
        Positions of the start and behind each part, in metres, shape (parts + 1,).
    heights : numpy.ndarray
        Heights in metres, shape (parts + 1, rays); NaN behind a part that blocks the ray.

    Examples
    --------
    >>> optics = clplen.OpticalSystem([0.24, clplen.wave.Lens(0.12, diameter=3.6e-3), 0.24])
    >>> z, heights = clplen.plot.trace(optics, 1e-3, [-0.005, 0.0, 0.005])
    >>> z.round(3).tolist()
    [0.0, 0.24, 0.24, 0.48]
    >>> (heights[-1] * 1e3).round(3).tolist()
    [-1.0, -1.0, nan]
    """
    check_finite(height=height, slope=slope)
    y, s = np.broadcast_arrays(*(np.atleast_1d(float64_array(v)) for v in (height, slope)))
    heights = [y]
    for part in optics:
        if isinstance(part, Lens):
            s = s - y / part.focal_length
        if isinstance(part, MicrolensArray) and clip:
            rows = lenslet_rows(part)
            offset = y[:, None] - rows
            nearest = np.abs(offset).argmin(axis=1)
            off = offset[np.arange(y.size), nearest]
            s = s - np.where(
                np.abs(off) <= part.diameter / 2 * (1 + _ZERO), off / part.focal_length, np.nan
            )
            y = np.where(np.isnan(s), np.nan, y)
        bounds = opening(part)
        if clip and bounds is not None:
            rim = _ZERO * (bounds[1] - bounds[0])
            y = np.where((y >= bounds[0] - rim) & (y <= bounds[1] + rim), y, np.nan)
        y = y + length_of(part) * s
        heights.append(y)
    return np.array([*optics.positions, optics.length]), np.array(heights)


def opening(part: Part) -> tuple[float, float] | None:
    """Return the lower and upper edge of a part's opening in metres; None if all rays pass."""
    if isinstance(part, MicrolensArray):
        return (part.offset[0] - part.extent[0] / 2, part.offset[0] + part.extent[0] / 2)
    if isinstance(part, Stop):
        return (part.centre[0] - part.diameter / 2, part.centre[0] + part.diameter / 2)
    if isinstance(part, Lens) and part.diameter is not None:
        return (-part.diameter / 2, part.diameter / 2)
    return None


def _bounds(optics: OpticalSystem) -> dict[int, tuple[float, float]]:
    """Return the openings by index of the part; without any, a narrow opening per lens."""
    openings = {i: bounds for i, part in enumerate(optics) if (bounds := opening(part)) is not None}
    if openings:
        return openings
    half = _NARROW * max(abs(optics.length), _ZERO)
    return {i: (-half, half) for i, part in enumerate(optics) if isinstance(part, Lens)}


def lenslet_rows(part: MicrolensArray) -> Array:
    """Return heights in metres of the rows of lenslets, for an unrotated array."""
    count = part.count[0]
    return part.offset[0] + (np.arange(count) - (count - 1) / 2) * part.row_pitch


def _is_distant(optics: OpticalSystem) -> bool:
    for part in optics:
        if isinstance(part, Lens | Stop | MicrolensArray):
            return True
        if length_of(part):
            return False
    return False


def _bundle(
    optics: OpticalSystem,
    start: tuple[float, float],
    fan: tuple[float, float],
    t: Sequence[float],
) -> Array:
    """Trace the rays start + t fan at both ends of ``t`` and between, or a single ray."""
    count = _MIN_RAYS if any(isinstance(part, MicrolensArray) for part in optics) else 0
    if isinstance(optics[0], MicrolensArray):
        count = min(3 * optics[0].count[0], _MAX_RAYS)
    steps = np.array(t)
    if len(t) > 1 and count:
        middles = (np.arange(count) + 0.5) / count
        steps = np.concatenate([t[:1], t[0] + (t[1] - t[0]) * middles, t[1:]])
    return trace(optics, start[0] + steps * fan[0], start[1] + steps * fan[1])[1]


def _limits(optics: OpticalSystem, fan: Array, start: Array) -> tuple[float, float, float]:
    """Return lowest, highest and middle t of the rays start + t fan that pass every opening.

    The middle ray passes the centre of the aperture stop, the narrowest interval of t.
    """
    intervals = []
    for i, bounds in _bounds(optics).items():
        if fan[i] != 0:
            intervals.append(sorted((bound - start[i]) / fan[i] for bound in bounds))
        if isinstance(optics[i], MicrolensArray):
            break
    if not intervals:
        return (0.0, 0.0, 0.0)
    narrowest = min(intervals, key=lambda ends: ends[1] - ends[0])
    return (
        max(ends[0] for ends in intervals),
        min(ends[1] for ends in intervals),
        sum(narrowest) / 2,
    )


def _images(optics: OpticalSystem, z: Array, fan: Array, unit: Array) -> tuple[ImagePoint, ...]:
    """Return the images by a fan in front of any lenslets, for an object of unit height."""
    fan = np.where(np.abs(fan) < _ZERO * np.abs(fan).max(), 0.0, fan)
    images = []
    for i, part in enumerate(optics):
        if isinstance(part, MicrolensArray):
            break
        if fan[i] != 0 and (fan[i + 1] == 0 or fan[i] * fan[i + 1] < 0):
            share = fan[i] / (fan[i] - fan[i + 1])
            position = z[i] + share * (z[i + 1] - z[i])
            images.append(
                ImagePoint(float(position), float(unit[i] + share * (unit[i + 1] - unit[i])))
            )
    return tuple(images)


@dataclass(frozen=True)
class Label:
    """Text at z, or between two z, in metres."""

    z: float
    text: str
    ends: tuple[float, float] = (0.0, 0.0)

    @property
    def lines(self) -> list[str]:
        """Lines of the text."""
        return self.text.split("\n")


def names(optics: OpticalSystem, rays: Rays) -> list[Label]:
    """Return the labels above the drawing; parts in the same plane share a label."""
    image_name = "focus" if rays.distant else "image"
    entries = [] if rays.distant else [(0.0, "object")]
    entries += [
        (image.z, image_name) for image in rays.images if not is_on_lenslets(optics, image.z)
    ]
    for part, z in zip(optics, optics.positions, strict=True):
        name = _FUNCTION if label_of(part) == "<lambda>" else label_of(part)
        if isinstance(part, MicrolensArray) and any(_near(optics, z, i.z) for i in rays.images):
            name += f" at the {image_name}"
        if not isinstance(part, Space):
            entries.append((z + length_of(part) / 2, "\n".join([name, *_details(part)])))
    if not any(_near(optics, z, optics.length) for z, _ in entries):
        entries.append((optics.length, "last plane"))
    labels: list[Label] = []
    for z, text in sorted(entries, key=lambda pair: pair[0]):
        if labels and _near(optics, labels[-1].z, z):
            labels[-1] = Label(labels[-1].z, f"{labels[-1].text}\n{text}")
        else:
            labels.append(Label(z, text))
    return labels


def is_on_lenslets(optics: OpticalSystem, z: float) -> bool:
    """Return True if lenslets are in the plane z, in metres."""
    return any(
        isinstance(part, MicrolensArray) and _near(optics, position, z)
        for part, position in zip(optics, optics.positions, strict=True)
    )


def _near(optics: OpticalSystem, first: float, second: float) -> bool:
    """Return True if two planes are equal up to rounding."""
    return abs(first - second) <= 1e-6 * abs(optics.length)


def _details(part: Part) -> list[str]:
    """Return focal length and width of a part."""
    texts = []
    if isinstance(part, Lens | MicrolensArray):
        texts.append(f"f = {_short(part.focal_length)}")
    if isinstance(part, MicrolensArray):
        texts.append(f"pitch {_short(part.pitch)}")
    elif isinstance(part, Lens | Stop) and part.diameter is not None:
        texts.append(f"D = {_short(part.diameter)}")
    return texts


def spans(optics: OpticalSystem) -> list[Label]:
    """Return the labels of the distances."""
    return [
        Label(z + length / 2, _short(length), (z, z + length))
        for part, z in zip(optics, optics.positions, strict=True)
        if (length := length_of(part))
    ]


def _short(length: float) -> str:
    value, unit = metres(length).split()
    return f"{float(value):.4g} {unit.replace('um', 'µm')}".replace("-", "\u2212")


def in_rows(labels: Sequence[Label], z_inch: float) -> list[list[Label]]:
    """Arrange labels in the fewest rows without overlap."""
    rows: list[list[Label]] = []
    edges: list[float] = []
    for label in sorted(labels, key=lambda label: label.z):
        half = (max(len(line) for line in label.lines) * _LETTER / 2 + 0.05) * z_inch
        row = next((i for i, edge in enumerate(edges) if label.z - half >= edge), len(rows))
        if row == len(rows):
            rows.append([])
            edges.append(0.0)
        rows[row].append(label)
        edges[row] = label.z + half
    return rows
