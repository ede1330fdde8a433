"""Paraxial rays through an optical system, for its side view, and the words about its parts.

A ray is (height, slope) at every part. A distance L moves it by L slope; a lens of focal length f
adds -height/f to its slope, a lenslet centred at c adds -(height - c)/f (ray transfer matrices:
Saleh and Teich 1991, section 1.4). The words share the room beside the drawing in rows.
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

_FILL = 0.7  # of the largest opening that objects and images may fill
_FEW, _MANY = 9, 21  # rays between the marginal ones of a bundle that meets lenslets
_ZERO = 1e-9  # relative
_NARROW = 0.02  # half width over length of a bundle that nothing bounds
LINE = 0.145  # inches of a line of text
_LETTER = 0.068
_FUNCTION = "function"  # a part that is one without a name


@dataclass(frozen=True)
class ImagePoint:
    """Where a bundle meets again: position and height in metres."""

    z: float
    height: float


@dataclass(frozen=True, repr=False)
class Rays(OneLine):
    """What a side view draws: rays, the object and its images.

    Attributes
    ----------
    z : ndarray
        Start, and behind each part, in metres, shape (parts + 1,).
    axial, oblique : ndarray or None
        Heights of the rays from the axis and from the point at ``height``, shape (parts + 1,
        rays): marginal ray, others, marginal ray; NaN behind a stop that blocks them. None:
        nothing passes.
    chief : ndarray or None
        Height of the oblique ray through the middle of the aperture stop, shape (parts + 1, 1).
    height : float
        Of the object in metres; 0 if it lies at infinity.
    distant : bool
        The light is collimated: the first element lies in the first plane.
    tilt : float
        Slope of the oblique rays in front of the system, if they are collimated.
    images : tuple of ImagePoint
        Where the axial rays meet again in front of any lenslets: ``z`` and ``height`` in metres.

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
    """Return rays from a point on the axis and from one beside it.

    If the first element lies in the first plane, the light is collimated, and the rays of the
    second bundle are tilted.

    Parameters
    ----------
    optics : OpticalSystem
        What the rays pass; where nothing bounds them they are narrow.
    height : float, optional
        Of the point beside the axis in metres; None: 70 % of the widest half opening, less if an
        image is larger than the object. Without meaning for collimated light.

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
    z, one = trace(optics, *fan, clip=False)
    _, other = trace(optics, *field, clip=False)
    found = _images(optics, z, one[:, 0], other[:, 0])
    if height is None or distant:
        largest = max([0.0 if distant else 1.0, *(abs(image.height) for image in found)])
        largest = largest or 2 * float(np.abs(other).max())
        room = _FILL * max([high - low for low, high in _bounds(optics).values()] or [0]) / 2
        height = room / largest if largest else 0.0
    images = tuple(ImagePoint(image.z, image.height * height) for image in found)
    beside = (field[0] * height, field[1] * height)
    low, high, middle = _limits(optics, one[:, 0], 0 * other[:, 0])
    axial = _bundle(optics, (0.0, 0.0), fan, (low, high)) if low < high else None
    low, high, middle = _limits(optics, one[:, 0], other[:, 0] * height)
    seen = axial is not None and height != 0 and low < high
    return Rays(
        z=z,
        axial=axial,
        oblique=_bundle(optics, beside, fan, (low, high)) if seen else None,
        chief=_bundle(optics, beside, fan, (middle,)) if seen and low <= middle <= high else None,
        height=0.0 if distant else height,
        distant=distant,
        tilt=beside[1],
        images=images,
    )


def trace(
    optics: OpticalSystem, height: Array | float, slope: Array | float, *, clip: bool = True
) -> tuple[Array, Array]:
    """Follow paraxial rays through the parts of a system.

    Parameters
    ----------
    optics : OpticalSystem
        Its lenses, distances, stops and lenslets; other parts only take their length.
    height : array_like
        Heights of the rays in the first plane in metres; broadcast with ``slope``.
    slope : array_like
        Their slopes dy/dz in front of the first part.
    clip : bool
        Whether rays end at openings, and lenslets bend them. Without it lenslets do nothing.

    Returns
    -------
    z : numpy.ndarray
        Of the start and behind each part, in metres, shape (parts + 1,).
    heights : numpy.ndarray
        In metres, shape (parts + 1, rays); NaN behind what blocks a ray.

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
    """Lowest and highest point in metres that a part lets through; None: all pass."""
    if isinstance(part, MicrolensArray):
        return (part.offset[0] - part.extent[0] / 2, part.offset[0] + part.extent[0] / 2)
    if isinstance(part, Stop):
        return (part.centre[0] - part.diameter / 2, part.centre[0] + part.diameter / 2)
    if isinstance(part, Lens) and part.diameter is not None:
        return (-part.diameter / 2, part.diameter / 2)
    return None


def _bounds(optics: OpticalSystem) -> dict[int, tuple[float, float]]:
    """The openings by number of the part; where there are none, a narrow one in every lens."""
    found = {i: bounds for i, part in enumerate(optics) if (bounds := opening(part)) is not None}
    if found:
        return found
    half = _NARROW * max(abs(optics.length), _ZERO)
    return {i: (-half, half) for i, part in enumerate(optics) if isinstance(part, Lens)}


def lenslet_rows(part: MicrolensArray) -> Array:
    """Heights in metres of the rows of lenslets of the array, as if it were not rotated."""
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
    """Heights of the rays start + t fan, between and at the two ends of ``t``, or of one ray."""
    inner = _FEW if any(isinstance(part, MicrolensArray) for part in optics) else 0
    if isinstance(optics[0], MicrolensArray):
        inner = min(3 * optics[0].count[0], _MANY)
    steps = np.array(t)
    if len(t) > 1 and inner:
        middles = (np.arange(inner) + 0.5) / inner
        steps = np.concatenate([t[:1], t[0] + (t[1] - t[0]) * middles, t[1:]])
    return trace(optics, start[0] + steps * fan[0], start[1] + steps * fan[1])[1]


def _limits(optics: OpticalSystem, fan: Array, start: Array) -> tuple[float, float, float]:
    """Lowest, highest and middle t of the rays start + t fan that pass every opening.

    The middle one goes through the middle of the aperture stop: what bounds t most narrowly.
    """
    found = []
    for i, bounds in _bounds(optics).items():
        if fan[i] != 0:
            found.append(sorted((bound - start[i]) / fan[i] for bound in bounds))
        if isinstance(optics[i], MicrolensArray):
            break
    if not found:
        return (0.0, 0.0, 0.0)
    narrowest = min(found, key=lambda ends: ends[1] - ends[0])
    return max(ends[0] for ends in found), min(ends[1] for ends in found), sum(narrowest) / 2


def _images(optics: OpticalSystem, z: Array, fan: Array, unit: Array) -> tuple[ImagePoint, ...]:
    """Where the rays of a fan meet, in front of any lenslets, with the height of a unit object."""
    fan = np.where(np.abs(fan) < _ZERO * np.abs(fan).max(), 0.0, fan)
    found = []
    for i, part in enumerate(optics):
        if isinstance(part, MicrolensArray):
            break
        if fan[i] != 0 and (fan[i + 1] == 0 or fan[i] * fan[i + 1] < 0):
            share = fan[i] / (fan[i] - fan[i + 1])
            where = z[i] + share * (z[i + 1] - z[i])
            found.append(ImagePoint(float(where), float(unit[i] + share * (unit[i + 1] - unit[i]))))
    return tuple(found)


@dataclass(frozen=True)
class Label:
    """Words about z, or between two z, in metres."""

    z: float
    text: str
    ends: tuple[float, float] = (0.0, 0.0)

    @property
    def lines(self) -> list[str]:
        """The words, line by line."""
        return self.text.split("\n")


def names(optics: OpticalSystem, rays: Rays) -> list[Label]:
    """What stands above the drawing; things in one plane share a label."""
    meeting = "focus" if rays.distant else "image"
    found = [] if rays.distant else [(0.0, "object")]
    found += [(image.z, meeting) for image in rays.images if not is_on_lenslets(optics, image.z)]
    for part, z in zip(optics, optics.positions, strict=True):
        name = _FUNCTION if label_of(part) == "<lambda>" else label_of(part)
        if isinstance(part, MicrolensArray) and any(_near(optics, z, i.z) for i in rays.images):
            name += f" at the {meeting}"
        if not isinstance(part, Space):
            found.append((z + length_of(part) / 2, "\n".join([name, *_details(part)])))
    if not any(_near(optics, z, optics.length) for z, _ in found):
        found.append((optics.length, "last plane"))
    labels: list[Label] = []
    for z, text in sorted(found, key=lambda pair: pair[0]):
        if labels and _near(optics, labels[-1].z, z):
            labels[-1] = Label(labels[-1].z, f"{labels[-1].text}\n{text}")
        else:
            labels.append(Label(z, text))
    return labels


def is_on_lenslets(optics: OpticalSystem, z: float) -> bool:
    """Whether lenslets stand in the plane z, in metres."""
    return any(
        isinstance(part, MicrolensArray) and _near(optics, at, z)
        for part, at in zip(optics, optics.positions, strict=True)
    )


def _near(optics: OpticalSystem, one: float, other: float) -> bool:
    """Whether two planes are one but for rounding."""
    return abs(one - other) <= 1e-6 * abs(optics.length)


def _details(part: Part) -> list[str]:
    """Focal length and width of a part."""
    words = []
    if isinstance(part, Lens | MicrolensArray):
        words.append(f"f = {_short(part.focal_length)}")
    if isinstance(part, MicrolensArray):
        words.append(f"pitch {_short(part.pitch)}")
    elif isinstance(part, Lens | Stop) and part.diameter is not None:
        words.append(f"D = {_short(part.diameter)}")
    return words


def spans(optics: OpticalSystem) -> list[Label]:
    """The distances."""
    return [
        Label(z + length / 2, _short(length), (z, z + length))
        for part, z in zip(optics, optics.positions, strict=True)
        if (length := length_of(part))
    ]


def _short(length: float) -> str:
    value, unit = metres(length).split()
    return f"{float(value):.4g} {unit.replace('um', 'µm')}".replace("-", "\u2212")


def in_rows(labels: Sequence[Label], z_inch: float) -> list[list[Label]]:
    """Labels in as few rows as it takes that none of a row overlap."""
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
