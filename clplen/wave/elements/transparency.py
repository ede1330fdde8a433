"""Transparencies: pictures, the USAF 1951 target and the Siemens star as thin elements."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen import units
from clplen.checks import (
    Aliasing,
    act_on_aliasing,
    check_centre,
    fits_float64,
    float64_array,
    host_array,
    is_integer,
)
from clplen.errors import ShapeError
from clplen.wave.elements.edges import (
    COORDINATE_TOLERANCE,
    Edges,
    check_edges,
    sine_integral,
    square_samples,
    square_samples_adjoint,
)
from clplen.wave.elements.hard_apertures import interval_coverage, polygon_coverage
from clplen.wave.field.field import Field, Grid, require_field, require_grid
from clplen.wave.field.sampling import exceeds
from clplen.wave.field.transmission import multiply

Picture = np.ndarray[Any, Any]


def transparency(
    field: Field,
    amplitude: Any = None,
    *,
    phase: Any = None,
    pitch: float | tuple[float, float] | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
    edges: Edges | None = None,
) -> Field:
    """Multiply a field by a picture as a thin element, u a exp(i phase).

    Pixels of a picture with a ``pitch`` are rectangles of constant transmission. By default each
    sample gets the mean of a exp(i phase) over its cell, the exact overlap of both grids in float64
    on the host. If the field has the coarser grid, a rapidly varying phase is averaged out.

    Parameters
    ----------
    field : Field
        Field of any shape (..., ny, nx).
    amplitude : array_like, optional
        Amplitude of shape (ny, nx), real or complex: 0 dark, 1 clear (divide 8-bit pictures by
        255). None: 1 everywhere on the picture.
    phase : array_like, optional
        Phase in radians, shape (ny, nx); positive retards as exp(+ikz) does. None: 0.
    pitch : float or tuple of float, optional
        Pixel pitch of the picture in metres, (dy, dx) or a single number; the picture is opaque
        outside. None: the pixels are the field's samples, with equal shape.
    centre : tuple of float
        Position (y, x) in metres of pixel [ny//2, nx//2]; requires a pitch.
    edges : {"samples", "area", "pixels"}, optional
        Sampling of a exp(i phase). "samples": value of the pixel at the centre of each sample.
        "area": mean over the cell of the sample. "pixels": picture with sharp rectangular pixels (a
        spatial light modulator, a pixelated mask), band-limited to the field's Nyquist frequency;
        its spectrum is that of the pixel values times the sinc of a pixel along each axis. None:
        "area" with a pitch; "samples" without, where both are equal.

    Returns
    -------
    Field
        Field behind the picture, with the shape of ``field``.

    Raises
    ------
    ShapeError
        If amplitude, phase and (without a pitch) the field differ in shape, or the picture varies
        along an axis of length 1 of the field.
    ValueError
        If there is neither amplitude nor phase, a value is not finite, the pitch is not positive,
        a centre is set without a pitch, or edges is unknown.

    Notes
    -----
    With "pixels" a step from 0 to 1 has the values 0.064 and 0.936 on the adjacent samples, and
    light beyond the Nyquist frequency is missing. Beyond a distance of about 2 N dx^2/lam that
    light would miss the window, and the propagated field is accurate, far away to 100 dB and more
    (see Accuracy in the documentation). Without a pitch border values continue outside.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> wave = clplen.wave.plane_wave(grid, wavelength=500e-9)
    >>> board = np.indices((4, 4)).sum(axis=0) % 2
    >>> behind = clplen.wave.transparency(wave, board, pitch=50e-6)
    >>> behind.to_numpy()[8, ::5].real.tolist()
    [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]
    """
    require_field(field)
    picture = picture_of(amplitude, phase)
    return apply_transmission(field, sampled_picture(picture, field.grid, pitch, centre, edges))


def sampled_picture(
    picture: Picture,
    grid: Grid,
    pitch: float | tuple[float, float] | None,
    centre: tuple[float, float],
    edges: Edges | None,
) -> Picture:
    """Return the transmission of each sample of a grid behind a picture; see `transparency`.

    It is linear in the picture.
    """
    _check_layout(picture.shape, grid, pitch, centre, edges)
    if pitch is None:
        return square_samples(picture) if edges == "pixels" else picture
    weights = _weights(_pixel_grid(picture.shape, pitch, centre), grid, edges or "area")
    return (weights[1] @ (weights[0] @ picture).T).T


def sampled_picture_adjoint(
    samples: Picture,
    shape: tuple[int, int],
    grid: Grid,
    pitch: float | tuple[float, float] | None,
    centre: tuple[float, float],
    edges: Edges | None,
) -> Picture:
    """Apply the transpose of `sampled_picture`, from samples of a grid to pixels of a picture."""
    if pitch is None:
        return square_samples_adjoint(samples) if edges == "pixels" else samples
    weights = _weights(_pixel_grid(shape, pitch, centre), grid, edges or "area")
    return (weights[1].T @ (weights[0].T @ samples).T).T


def _check_layout(
    shape: tuple[int, ...],
    grid: Grid,
    pitch: float | tuple[float, float] | None,
    centre: tuple[float, float],
    edges: Edges | None,
) -> None:
    if edges is not None:
        check_edges(edges)
    if pitch is not None:
        return
    if tuple(centre) != (0.0, 0.0):
        raise ValueError(
            f"centre requires a pitch in metres, got centre {centre!r} without a pitch."
        )
    if shape != grid.shape:
        raise ShapeError(
            f"A picture without pitch must have the field's shape {grid.shape}, got {shape}; else "
            "set pitch= in metres."
        )


def apply_transmission(field: Field, transmission: Picture) -> Field:
    """Multiply ``field`` (or each of a batch) by a transmission of shape (ny, nx) from the host."""
    device = field.device
    return multiply(field, device.upload(transmission.astype(device.complex, copy=False)))


def picture_of(amplitude: Any, phase: Any) -> Picture:
    """Return the transmission of the pixels in double precision, complex if there is a phase."""
    if amplitude is None and phase is None:
        raise ValueError("A transparency requires an amplitude, a phase or both.")
    parts = {"amplitude": amplitude, "phase": phase}
    arrays = {
        name: host_array(part, f"The {name}") for name, part in parts.items() if part is not None
    }
    for name, part in arrays.items():
        if part.ndim != 2 or 0 in part.shape:
            raise ShapeError(f"{name} must have shape (ny, nx), got {part.shape}.")
        bad = int(np.count_nonzero(~np.isfinite(part)))
        if bad:
            raise ValueError(
                f"{name} must be finite, got {bad} values that are NaN or infinite; replace them, "
                "for example by 0."
            )
    if len({part.shape for part in arrays.values()}) == 2:
        raise ShapeError(
            f"phase must have the shape of amplitude, {arrays['amplitude'].shape}, got "
            f"{arrays['phase'].shape}."
        )
    if phase is not None and np.iscomplexobj(arrays["phase"]):
        raise ValueError("phase must be real, in radians; pass complex values as amplitude.")
    if phase is None:
        values = arrays["amplitude"]
        return values.astype(np.complex128 if np.iscomplexobj(values) else np.float64)
    return arrays.get("amplitude", 1.0) * np.exp(1j * arrays["phase"].astype(np.float64))


def _pixel_grid(
    shape: tuple[int, ...], pitch: float | tuple[float, float], centre: tuple[float, float]
) -> Grid:
    """Return the pixels of a picture as a grid, with messages about a picture."""
    spacing = np.broadcast_to(float64_array(pitch), (2,))
    if not (np.isfinite(spacing).all() and (spacing > 0).all()):
        raise ValueError(
            f"A picture's pitch must be positive and finite, in metres, got {pitch!r}."
        )
    units.PITCH.check(pitch, "A picture's pitch")
    check_centre(centre, "a picture")
    return Grid((shape[0], shape[1]), (float(spacing[0]), float(spacing[1])), origin=centre)


def _weights(pixels: Grid, grid: Grid, edges: Edges) -> list[Any]:
    """Return the weights of the rows and of the columns of pixels for those of ``grid``."""
    make = {"samples": _middle_weights, "area": _overlap_weights, "pixels": _band_weights}[edges]
    for axis in (0, 1):
        if grid.shape[axis] == 1 and pixels.shape[axis] != 1:
            raise ShapeError(
                f"The picture must have a single pixel along axis {axis}, as the field has, got "
                f"{pixels.shape[axis]} pixels."
            )
    return [
        make(grid, pixels, axis) if grid.shape[axis] > 1 else np.ones((1, 1)) for axis in (0, 1)
    ]


def _middle_weights(grid: Grid, pixels: Grid, axis: int) -> Any:
    """Return 1 where the centre of a sample lies in a pixel, shape (n, n pixels)."""
    from scipy import sparse  # a local import, since it is slow

    n, pitch = grid.shape[axis], pixels.pitch[axis]
    middle = (_edges(grid, axis)[:-1] + _edges(grid, axis)[1:]) / 2
    column = np.floor((middle - _edges(pixels, axis)[0]) / pitch + COORDINATE_TOLERANCE).astype(
        np.int64
    )
    row = np.flatnonzero((column >= 0) & (column < pixels.shape[axis]))
    return sparse.csr_matrix((np.ones(len(row)), (row, column[row])), shape=(n, pixels.shape[axis]))


def _band_weights(grid: Grid, pixels: Grid, axis: int) -> Picture:
    """Return the band-limited pixels at the samples of ``grid``, shape (n, n pixels)."""
    middle = (_edges(grid, axis)[:-1] + _edges(grid, axis)[1:]) / 2
    steps = (middle[:, None] - _edges(pixels, axis)) / grid.pitch[axis]
    return -np.diff(sine_integral(steps), axis=1)


def _overlap_weights(grid: Grid, pixels: Grid, axis: int) -> Any:
    """Return the fraction of each cell of ``grid`` that each pixel covers, shape (n, n pixels).

    The edges of both grids cut the axis into pieces; each lies in one cell and in one pixel.
    """
    from scipy import sparse  # a local import, since it is slow

    size = (grid.shape[axis], pixels.shape[axis])
    cells, pixel_edges = _edges(grid, axis), _edges(pixels, axis)
    low, high = max(cells[0], pixel_edges[0]), min(cells[-1], pixel_edges[-1])
    cuts = np.union1d(cells, pixel_edges)
    cuts = cuts[(cuts >= low) & (cuts <= high)]
    middle, length = (cuts[1:] + cuts[:-1]) / 2, np.diff(cuts)
    row = np.clip(np.searchsorted(cells, middle) - 1, 0, size[0] - 1)
    column = np.clip(np.searchsorted(pixel_edges, middle) - 1, 0, size[1] - 1)
    return sparse.csr_matrix((length / grid.pitch[axis], (row, column)), shape=size)


def _edges(grid: Grid, axis: int) -> Picture:
    """Return the n + 1 edges of the cells along an axis in metres."""
    n, pitch = grid.shape[axis], grid.pitch[axis]
    return grid.origin[axis] + (np.arange(n + 1) - n // 2 - 0.5) * pitch


Values = np.ndarray[Any, Any]
# Side of a layer (groups G and G + 1) and corner (y, x) of the next, four times smaller layer, in
# bar widths of element 1 of the even group G (MIL-STD-150A).
_LAYER_WIDTH = 26.0
_INNER = (6.5, 12.1)
_FINEST = 30  # largest group number; its bars are 0.5 pm wide
_SAGITTA = 1e-4  # largest distance of a Siemens star's polygon from its circle, in samples


@dataclass(frozen=True)
class TargetElement:
    """Element of the USAF 1951 target: two squares of three bars.

    Bars and gaps are one width wide, bars five widths long (MIL-STD-150A, 1959).

    Attributes
    ----------
    group, element : int
        Numbers on the chart; the element counts from 1 to 6.
    upright : tuple of float
        Centre (y, x) in metres of the square of vertical bars, which vary along x.
    level : tuple of float
        Centre (y, x) in metres of the square of horizontal bars, which vary along y.

    Examples
    --------
    >>> element = clplen.wave.usaf1951_elements([4])[0]
    >>> element.group, element.element, f"{element.frequency / 1e3:.1f} line pairs/mm"
    (4, 1, '16.0 line pairs/mm')
    >>> f"bars {element.width * 1e6:.2f} um wide", element.bars.shape
    ('bars 31.25 um wide', (6, 4))
    """

    group: int
    element: int
    upright: tuple[float, float]
    level: tuple[float, float]

    @property
    def frequency(self) -> float:
        """Line pairs per metre: 1000 times 2^(group + (element - 1)/6)."""
        return _frequency(self.group, self.element)

    @property
    def width(self) -> float:
        """Width of a bar in metres, 1/(2 frequency)."""
        return 0.5 / self.frequency

    @property
    def bars(self) -> Values:
        """Edges of the six bars in metres, rows (y low, y high, x low, x high), vertical first."""
        along, across = 2.5 * self.width, 0.5 * self.width
        rows = []
        for shift in (-2 * self.width, 0.0, 2 * self.width):
            (y, x) = (self.upright[0], self.upright[1] + shift)
            rows.append((y - along, y + along, x - across, x + across))
        for shift in (-2 * self.width, 0.0, 2 * self.width):
            (y, x) = (self.level[0] + shift, self.level[1])
            rows.append((y - across, y + across, x - along, x + along))
        return np.array(rows)


def usaf1951_elements(
    groups: Sequence[int], *, centre: tuple[float, float] = (0.0, 0.0)
) -> tuple[TargetElement, ...]:
    """Return the elements that `usaf1951` draws, with their positions.

    Elements 2 to 6 of an even group G form a column on the left, those of group G + 1 a column on
    the right. Element 1 of group G is below, groups G + 2 and G + 3 are between the columns, as on
    the chart of MIL-STD-150A. The vertical bars of an element are left of its horizontal bars, two
    bar widths apart.

    Parameters
    ----------
    groups : sequence of int
        Numbers of the groups, of six elements each; the chart has -2 to 9.
    centre : tuple of float
        Position (y, x) in metres of the centre of the rectangle around all bars.

    Returns
    -------
    tuple of TargetElement
        Elements, sorted by group and number.

    Raises
    ------
    ValueError
        If there is no group, a group is repeated or not an integer, or the centre is not finite.

    Examples
    --------
    >>> elements = clplen.wave.usaf1951_elements([4, 5])
    >>> len(elements), elements[6].group, elements[6].element
    (12, 5, 1)
    >>> [f"{c * 1e6:.1f} um" for c in elements[0].upright]
    ['296.2 um', '109.4 um']
    """
    numbers = _groups(groups)
    check_centre(centre, "a target")
    blocks = [block for block in _layers(numbers[0], numbers[-1]) if block[0] in numbers]
    corners = np.array([block[2:] for block in blocks])
    sizes = np.array(
        [np.array([2.5, 6.0]) / _frequency(group, number) for group, number, _, _ in blocks]
    )
    down, along = centre - (corners.min(axis=0) + (corners + sizes).max(axis=0)) / 2
    return tuple(
        _element(group, number, top + float(down), left + float(along))
        for group, number, top, left in sorted(blocks)
    )


def usaf1951(
    grid: Grid,
    *,
    groups: Sequence[int],
    centre: tuple[float, float] = (0.0, 0.0),
    invert: bool = False,
    aliasing: Aliasing = "allow",
) -> Values:
    """Return the three-bar target USAF 1951 as a transmission, without its numerals.

    Element E of group G has 2^(G + (E - 1)/6) line pairs a millimetre (MIL-STD-150A, 1959).
    Every cell has the exact fraction that the bars cover: an element finer than the grid fades to
    grey, unless ``aliasing`` forbids it. Parts outside of the window are cropped.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    groups : sequence of int
        Numbers of the groups, of six elements each; the chart has -2 to 9.
    centre : tuple of float
        Position (y, x) in metres of the centre of the rectangle around all bars.
    invert : bool
        True for dark bars on a clear background instead of clear bars on a dark background.
    aliasing : {"raise", "warn", "allow"}
        Action if a bar is narrower than a sample.

    Returns
    -------
    numpy.ndarray
        Transmission 0..1, float64, shape (ny, nx): for `Field.from_array` or `transparency`.

    Raises
    ------
    SamplingError
        If a bar is narrower than a sample and ``aliasing`` is "raise".
    ShapeError
        If the grid has an axis of length 1.
    ValueError
        If the groups or the centre are invalid, or no bar lies in the window.

    Warns
    -----
    SamplingWarning
        If a bar is narrower than a sample and ``aliasing`` is "warn".

    See Also
    --------
    usaf1951_elements : Positions of the elements, to measure their contrast.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> target = clplen.wave.usaf1951(grid, groups=[5])
    >>> wave = clplen.Field.from_array(target, grid, wavelength=500e-9)
    >>> wave.shape, f"{target.mean():.3f} of the window is clear"
    ((64, 64), '0.065 of the window is clear')
    """
    require_grid(grid)
    elements = usaf1951_elements(groups, centre=centre)
    _check_two_axes(grid)
    act_on_aliasing(_too_fine(elements[-1], grid), aliasing)
    clear = np.zeros(grid.shape)
    for top, bottom, left, right in np.concatenate([element.bars for element in elements]):
        y = interval_coverage(grid.y - (top + bottom) / 2, grid.pitch[0], (bottom - top) / 2)
        x = interval_coverage(grid.x - (left + right) / 2, grid.pitch[1], (right - left) / 2)
        cells = np.ix_(np.flatnonzero(y), np.flatnonzero(x))
        clear[cells] += y[cells[0]] * x[cells[1]]
    if not clear.any():
        raise ValueError(_outside("The target", grid, centre))
    np.minimum(clear, 1, out=clear)
    return 1 - clear if invert else clear


def siemens_star(
    grid: Grid,
    spokes: int,
    *,
    diameter: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Values:
    """Return a Siemens star as a transmission.

    It is clear where cos(spokes theta) > 0 and dark outside of its disc, with spokes/(2 pi r) line
    pairs per metre at the radius r. Every cell has the exact fraction that the star covers, so the
    centre fades to grey. The rim is a polygon of equal area with an error of at most 1e-4 of a
    cell.

    Parameters
    ----------
    grid : Grid
        Samples of the plane, shape (ny, nx).
    spokes : int
        Number of clear spokes, at least 2; the centre line of the first points to +x.
    diameter : float
        Diameter in metres.
    centre : tuple of float
        Centre (y, x) in metres.

    Returns
    -------
    numpy.ndarray
        Transmission 0..1, float64, shape (ny, nx): for `Field.from_array` or `transparency`.

    Raises
    ------
    ShapeError
        If the grid has an axis of length 1.
    ValueError
        If a value is out of range, or no part of the star lies in the window.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> star = clplen.wave.siemens_star(grid, 8, diameter=500e-6)
    >>> covered = star.sum() * (10e-6) ** 2
    >>> star.shape, f"{covered / (np.pi / 4 * 500e-6**2):.3f} of the disc is clear"
    ((64, 64), '0.500 of the disc is clear')
    """
    require_grid(grid)
    if not is_integer(spokes) or spokes < 2:
        raise ValueError(f"spokes must be an integer of at least 2, got {spokes!r}.")
    if not (fits_float64(diameter) and diameter > 0):
        raise ValueError(f"The diameter of a star must be positive, in metres, got {diameter!r}.")
    units.DIAMETER.check(diameter, "The diameter of a star")
    check_centre(centre, "a star")
    _check_two_axes(grid)
    spoke = np.pi / spokes
    finest = math.sqrt(8 * _SAGITTA * min(grid.pitch) / (diameter / 2))
    count = max(math.ceil(spoke / finest), 4)
    # A radius that gives the polygon the area of the sector.
    radius = diameter / 2 * math.sqrt(spoke / count / math.sin(spoke / count))
    turns = np.linspace(-spoke / 2, spoke / 2, count + 1) + 2 * spoke * np.arange(spokes)[:, None]
    rim = radius * np.stack([np.sin(turns), np.cos(turns)], axis=-1)
    outline = np.concatenate([np.zeros((int(spokes), 1, 2)), rim], axis=1) + centre
    clear = polygon_coverage(grid, outline.reshape(-1, 2))
    if not clear.any():
        raise ValueError(_outside("The star", grid, centre))
    return clear


def _frequency(group: int, element: int) -> float:
    return 1000 * 2 ** (group + (element - 1) / 6)


def _groups(groups: Sequence[int]) -> list[int]:
    numbers = list(groups) if np.ndim(groups) == 1 else []
    if (
        not numbers
        or not all(is_integer(g) and abs(g) <= _FINEST for g in numbers)
        or len(set(numbers)) < len(numbers)
    ):
        raise ValueError(
            f"The groups of a target must be different integers, such as (0, 1), got {groups!r}."
        )
    return sorted(int(g) for g in numbers)


def _layers(lowest: int, highest: int) -> Iterator[tuple[int, int, float, float]]:
    """Yield (group, element, top, left) of the blocks of 5 x 12 bar widths, layer by layer."""
    top, left = 0.0, 0.0
    for even in range(lowest - lowest % 2, highest + 1, 2):
        unit = 0.5 / _frequency(even, 1)
        right = left + _LAYER_WIDTH * unit
        low = top
        for element in range(2, 7):
            yield even, element, low, left
            low += 7 * 0.5 / _frequency(even, element)
        bottom = low - 2 * 0.5 / _frequency(even, 6)
        yield even, 1, bottom - 5 * unit, right - 12 * unit
        low = top
        for element in range(1, 7):
            width = 0.5 / _frequency(even + 1, element)
            yield even + 1, element, low, right - 12 * width
            low += 7 * width
        top, left = top + _INNER[0] * unit, left + _INNER[1] * unit


def _element(group: int, number: int, top: float, left: float) -> TargetElement:
    width = 0.5 / _frequency(group, number)
    y = top + 2.5 * width
    return TargetElement(group, number, (y, left + 2.5 * width), (y, left + 9.5 * width))


def _too_fine(finest: TargetElement, grid: Grid) -> str:
    """Return the message about a bar narrower than a sample; empty if there is none."""
    if not exceeds(max(grid.pitch), finest.width):
        return ""
    return (
        f"Element {finest.element} of group {finest.group} has bars {finest.width:.4g} m wide, "
        f"less than the pitch of {max(grid.pitch):g} m, and fades to grey; use a pitch of at most "
        f"{finest.width:.4g} m."
    )


def _check_two_axes(grid: Grid) -> None:
    if 1 in grid.shape:
        raise ShapeError(f"A target varies along both axes; the grid has shape {grid.shape}.")


def _outside(what: str, grid: Grid, centre: tuple[float, float]) -> str:
    return (
        f"{what} is outside of the window of {grid.extent[0]:g} x {grid.extent[1]:g} m, with its "
        f"centre at {centre!r} m; move the centre."
    )
