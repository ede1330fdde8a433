"""OPD maps of a lens: wavefront, distortion, pupil shift and vignetting over field and wavelength.

A prescription changes the light of a point by three quantities: path lengths W over the pupil (Born
and Wolf 1999, section 5.1), the position of the chief ray on the image, and a mask of rays that
pass. `Aberrations` replaces a thin main lens' perfect pupil by such maps.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from clplen import units
from clplen.cameras.optics.map_interpolation import (
    ROUNDING,
    SMOOTH,
    STRAIGHT,
    FieldPositions,
    Line,
    axes,
    bilinear,
    coefficients,
    continue_edges,
    continue_maps,
    disc,
    fraction_within,
    light_edges,
    nearest,
    require_room,
    spline,
)
from clplen.cameras.optics.traced_maps import trace_maps
from clplen.checks import check_finite, fits_float64, real_array
from clplen.reprs import one_line
from clplen.results import Savable
from clplen.units import metres

Values = np.ndarray[Any, np.dtype[np.float64]]
MIN_SAMPLES = 5  # minimum samples of a map along each axis
MIN_LIT_SAMPLES = 10  # minimum samples with light in a map: a parabola needs 6
MAX_PATH_WAVES = 2000.0  # path in wavelengths above which its unit is wrong
MAX_PUPIL_SHIFT = 0.5  # maximum pupil shift in radii of the pupil


class OPDMaps(Savable):
    """Maps over the pupil of a main lens: wavefront, distortion, pupil shift and vignetting.

    Sample i of n along v or u lies at -1 + 2 i/(n - 1), as a fraction of the pupil's radius: the
    first and the last lie on the rim. v counts along y, u along x. Samples beyond the unit disc are
    ignored. A path is positive where it retards, as exp(+ikz). Its reference is the sphere about
    the chief ray's position on the image; a tilt displaces the image from that position.

    In the pupil a path is a bicubic spline; transmission and edge are bilinear. Between fields
    along a radius or on a grid, paths, distortion and pupil shift are cubic splines (parabolas
    through three, straight through two), transmission and edge straight. Between scattered fields
    all are linear in Delaunay triangles. Between wavelengths they are the same splines of 1/lam^2,
    as is dispersion. Nothing is extrapolated.

    Parameters
    ----------
    path : array_like
        W in metres, shape (n_wavelengths, n_fields, n_v, n_u), 5 samples or more along v and u.
        NaN where no ray passes.
    fields : array_like
        Image positions without distortion, (y, x) on the main lens' image plane in metres, shape
        (n_fields, 2): a grid in any order, or scattered. With ``symmetric`` along one radius, or
        distances from the axis, shape (n_fields,), along +y. A single map holds for the whole
        image.
    wavelengths : array_like, optional
        Distinct wavelengths in metres, shape (n_wavelengths,). None, for one map: a path that does
        not depend on the wavelength, as of mirrors.
    symmetric : bool
        True for a rotationally symmetric lens, whose maps, distortion and pupil shift are rotated
        about the axis.
    distortion : array_like, optional
        Displacement of the chief ray from ``fields``, (y, x) in metres, shape (n_wavelengths,
        n_fields, 2) or (n_fields, 2). None: 0.
    pupil_shift : array_like, optional
        Position of the pupil's centre on the main lens' aperture, (y, x) as fractions of its
        radius, up to 0.5, shapes as for ``distortion``. It loses no light. None: 0.
    transmission : array_like, optional
        Transmitted fraction of the energy at each sample, 0 to 1, shape of ``path`` or without its
        first axis. None: 1.
    edge : array_like, optional
        Function that is positive inside the lens' other rims and falls through 0 there, shapes as
        for ``transmission``. An example is the smallest 1 - r/a of all surfaces, r the height of a
        ray and a that of the rim. None: half a sample from the region where the path is NaN, or the
        transmission 0.
    pupil_distance, pupil_diameter : float, optional
        Distance of the exit pupil from the image plane and its diameter in metres, if known; their
        ratio is the f-number that the camera should have.

    Attributes
    ----------
    paths, transmissions, edges : numpy.ndarray
        Float64, read only, shape (n_wavelengths, n_fields, n_v, n_u). ``paths`` as in the argument
        and ``edges`` are NaN beyond the disc; ``transmissions`` continue beyond disc and edges.
    fields, wavelengths, distortion, pupil_shift : numpy.ndarray
        Arguments as float64, read only; ``wavelengths`` may be None.
    symmetric, pupil_distance, pupil_diameter
        Arguments of the constructor.

    Raises
    ------
    ValueError
        If shapes do not fit, numbers are out of range or not in metres, light passes where the path
        is NaN, or fields lie on one line.
    TypeError
        If an array does not hold real numbers.
        If an array holds no real numbers.
    MemoryError
        If there is less memory than the maps need.

    Examples
    --------
    >>> v, u = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17), indexing="ij")
    >>> defocus = 100e-9 * (2 * (v**2 + u**2) - 1)  # in metres
    >>> maps = clplen.cameras.OPDMaps([[defocus]], fields=[(0, 0)])
    >>> path = maps.path(0, 0, 532e-9, v=[0, 0.5, 1], u=0)
    >>> np.round(path * 1e9, 3).tolist()
    [-100.0, -50.0, 100.0]
    >>> lens = clplen.cameras.Aberrations(main_lens_opd=maps)
    """

    _writer: ClassVar[str] = "write_opd_maps"

    def __init__(
        self,
        path: Any,
        *,
        fields: Any,
        wavelengths: Any = None,
        symmetric: bool = False,
        distortion: Any = None,
        pupil_shift: Any = None,
        transmission: Any = None,
        edge: Any = None,
        pupil_distance: float | None = None,
        pupil_diameter: float | None = None,
    ) -> None:
        paths = real_array(path, "path", np.float64)
        _require_maps(paths)
        require_room(paths.size)
        self.symmetric = bool(symmetric)
        self.fields = _fields(fields, paths.shape[1], self.symmetric)
        self.wavelengths = _wavelengths(wavelengths, paths.shape[0])
        self._positions = FieldPositions(self.fields, self.symmetric)
        self._lines = None if self.wavelengths is None else Line(self.wavelengths**-2.0)
        inside = disc((paths.shape[2], paths.shape[3]))
        self.paths = np.where(inside, paths, np.nan)
        share = _shares(transmission, self.paths, inside)
        lit = np.isfinite(self.paths) if share is None else share > 0
        cuts = _cuts(edge, self.paths, inside)
        if cuts is not None:
            lit = inside & (cuts > 0) & (lit if share is not None else True)
        _require_light(self.paths, lit)
        _require_metres(self)
        cuts = light_edges(lit, inside) if cuts is None else cuts
        self.edges = np.where(inside, cuts, np.nan)
        self.transmissions = np.ones(paths.shape) if share is None else nearest(share, lit)
        pairs = (len(self.paths), len(self.fields), 2)
        self.distortion = _pairs(distortion, pairs, "distortion")
        self.pupil_shift = _pairs(pupil_shift, pairs, "pupil_shift")
        _require_steps(self)
        self.pupil_distance = _length(pupil_distance, "pupil_distance")
        self.pupil_diameter = _length(pupil_diameter, "pupil_diameter")
        for array in (
            self.paths, self.transmissions, self.edges, self.distortion, self.pupil_shift
        ):  # fmt: skip
            array.setflags(write=False)

    @classmethod
    def traced(
        cls,
        optic: Any,
        *,
        fields: int | Sequence[float] = 11,
        wavelengths: Sequence[float] | None = None,
        samples: int = 65,
    ) -> OPDMaps:
        """Trace the maps of a lens from its prescription, by optiland (``clplen[lenses]``).

        Coordinates are optiland's, in metres, with the same x and y and both pupils' rims at 1.
        The image plane is the prescription's. The image without distortion follows from the scale
        of a field next to the axis at the first wavelength (by default the primary one). The path
        is from the sphere about the chief ray's image position that passes the exit pupil's centre.
        Vignetting requires apertures of the surfaces in the prescription.

        Parameters
        ----------
        optic : optiland.optic.Optic or path-like
            Rotationally symmetric lens with fields by angle, object height or paraxial image
            height. A path is read: optiland's JSON, or Zemax' .zmx.
        fields : int or sequence of float
            Number of fields from the axis to the largest, or their fractions of it, 0 to 1.
        wavelengths : sequence of float, optional
            Wavelengths in metres; by default those of the prescription.
        samples : int
            Number of samples of a map along each axis, 5 or more.

        Returns
        -------
        OPDMaps
            Maps with ``symmetric`` True, or of one field if only the axis is requested.

        Raises
        ------
        ModuleNotFoundError
            If optiland is not installed.
        ValueError
            If the lens is not symmetric, its fields are of another kind, or no ray passes.
        """
        return cls(
            **trace_maps(
                optic,
                fields=fields,
                wavelengths=wavelengths,
                samples=samples,
            )
        )

    def __repr__(self) -> str:
        names = ("paths", "fields", "wavelengths", "symmetric")
        return one_line(self, {name: getattr(self, name) for name in names})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OPDMaps) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in _CACHED}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers; equal maps have equal digests."""
        sha = hashlib.sha256()
        for name, value in self.values().items():
            sha.update(name.encode())
            array = None if value is None else np.asarray(value)
            sha.update(b"" if array is None else repr(array.shape).encode() + array.tobytes())
        return sha.hexdigest()

    def values(self) -> dict[str, Any]:
        """Return constructor arguments that give equal maps, by name."""
        names = (
            "fields", "wavelengths", "symmetric", "distortion", "pupil_shift", "pupil_distance",
            "pupil_diameter",
        )  # fmt: skip
        arguments = {"path": self.paths, "transmission": self.transmissions, "edge": self.edges}
        return arguments | {name: getattr(self, name) for name in names}

    @property
    def varies(self) -> bool:
        """True for maps of several fields, distortion or pupil shift."""
        return not self._positions.everywhere or bool(
            self.distortion.any() or self.pupil_shift.any()
        )

    @property
    def vignettes(self) -> bool:
        """True if some light is blocked."""
        inside = disc((self.paths.shape[2], self.paths.shape[3]))
        return bool(((self.edges <= 0) | (self.transmissions < 1))[..., inside].any())

    @property
    def largest_shift(self) -> float:
        """Largest distance of the pupil's centre from the aperture's, in radii."""
        return float(np.hypot(*np.moveaxis(self.pupil_shift, -1, 0)).max())

    def check(self, images: Values, wavelength: float) -> None:
        """Raise for images, or a wavelength, beyond the maps."""
        self._colour(wavelength, STRAIGHT)
        self._positions.require(images)

    def path(self, y: float, x: float, wavelength: float, v: Any, u: Any) -> Values:
        """Compute W of a point imaged at (y, x), in metres.

        Parameters
        ----------
        y, x : float
            Position of the image without distortion in metres.
        wavelength : float
            Wavelength in metres.
        v, u : array_like
            Positions in the pupil as fractions of its radius; positions beyond the rim are moved
            onto it.

        Returns
        -------
        numpy.ndarray
            float64, the broadcast shape of ``v`` and ``u``; continued where no light passes.

        Raises
        ------
        ValueError
            If the image position or the wavelength is outside the maps.
        """
        table, turn = self._table(y, x, wavelength), self._positions.turn(y, x)
        return spline(table, *_rotate_back(*_clip_to_disc(v, u), turn))

    def slopes(
        self, y: float, x: float, wavelength: float, v: Any, u: Any
    ) -> tuple[Values, Values]:
        """Compute (dW/dv, dW/du) of a point imaged at (y, x), in metres over the pupil's radius.

        Parameters and errors are those of `path`.

        Returns
        -------
        tuple of numpy.ndarray
            Both float64, the broadcast shape of ``v`` and ``u``.
        """
        table, (sine, cosine) = self._table(y, x, wavelength), self._positions.turn(y, x)
        at = _rotate_back(*_clip_to_disc(v, u), (sine, cosine))
        down, right = spline(table, *at, order=(1, 0)), spline(table, *at, order=(0, 1))
        return down * cosine + right * sine, right * cosine - down * sine

    def transmission(self, y: float, x: float, wavelength: float, v: Any, u: Any) -> Values:
        """Compute the transmitted fraction of the energy of a point imaged at (y, x).

        Parameters and errors are those of `path`.

        Returns
        -------
        numpy.ndarray
            float64, 0 to 1, the broadcast shape of ``v`` and ``u``; 0 beyond the edge.
        """
        share, covered = self.share_and_cover(y, x, wavelength, v, u, 0.0)
        return share * covered

    def share_and_cover(
        self, y: float, x: float, wavelength: float, v: Any, u: Any, cell: float
    ) -> tuple[Values, Values]:
        """Compute the transmitted fraction within the edge, and the fraction of cells inside it.

        ``cell`` is the width of the cells about the positions, as a fraction of the radius.
        """
        turn, at = self._positions.turn(y, x), _clip_to_disc(v, u)
        share, edge = (
            self._interpolate(maps, y, x, wavelength, STRAIGHT)
            for maps in (self.transmissions, self._cut)
        )
        passed = np.clip(bilinear(share, *_rotate_back(*at, turn)), 0, 1)
        middle = bilinear(edge, *_rotate_back(*at, turn))
        if not cell:
            return passed, (middle > 0).astype(np.float64)
        rises = []
        for down, right in ((cell / 2, 0.0), (0.0, cell / 2)):
            ends = [
                bilinear(edge, *_rotate_back(at[0] + sign * down, at[1] + sign * right, turn))
                for sign in (-1, 1)
            ]
            rises.append(np.abs(ends[1] - ends[0]))
        return passed, fraction_within(middle, *rises)

    def chief_ray(self, y: float, x: float, wavelength: float) -> tuple[float, float]:
        """Return the position (y, x) of the chief ray of a point imaged at (y, x), in metres.

        Parameters and errors are those of `path`.
        """
        down, right = self._displacement(self.distortion, y, x, wavelength)
        return y + down, x + right

    def pupil_centre(self, y: float, x: float, wavelength: float) -> tuple[float, float]:
        """Return the position (y, x) of the pupil's centre as fractions of the aperture's radius.

        Parameters and errors are those of `path`.
        """
        return self._displacement(self.pupil_shift, y, x, wavelength)

    def passed(self, y: float, x: float, wavelength: float) -> float:
        """Return the fraction of the energy of a point imaged at (y, x) that passes the pupil.

        Parameters and errors are those of `path`.
        """
        n = 4 * max(self.paths.shape[2:])
        radius = np.sqrt((np.arange(n) + 0.5) / n)[:, None]
        angle = np.arange(n) * (2 * np.pi / n)
        return float(
            self.transmission(
                y, x, wavelength, radius * np.sin(angle), radius * np.cos(angle)
            ).mean()
        )

    def rms(self, wavelength: float) -> tuple[Values, Values]:
        """Return W's rms about its mean in metres, and the transmitted fraction, for each field."""
        colour = self._colour(wavelength, SMOOTH)
        paths = np.tensordot(colour, self._continued, 1)
        straight = self._colour(wavelength, STRAIGHT)
        share, edge = (np.tensordot(straight, m, 1) for m in (self.transmissions, self.edges))
        weight = np.clip(share, 0, 1) * (edge > 0) * disc((paths.shape[1], paths.shape[2]))
        total = weight.sum(axis=(1, 2))
        mean = (weight * paths).sum(axis=(1, 2)) / total
        square = (weight * (paths - mean[:, None, None]) ** 2).sum(axis=(1, 2)) / total
        lit = disc((paths.shape[1], paths.shape[2])).sum()
        return np.sqrt(square), total / lit

    def steepest(self, wavelength: float) -> tuple[float, float]:
        """Return the largest slope along v or u of any field, and the largest distortion.

        They are in metres over the pupil's radius, and in metres.
        """
        slopes = self._steepest.get(wavelength)
        if slopes is None:
            slopes = self._steepest[wavelength] = self._largest_slopes(wavelength)
        return slopes

    @cached_property
    def _steepest(self) -> dict[float, tuple[float, float]]:
        return {}

    def _largest_slopes(self, wavelength: float) -> tuple[float, float]:
        colour, inside = self._colour(wavelength, SMOOTH), disc(self.paths.shape[2:])
        v, u = (np.broadcast_to(axis, inside.shape)[inside] for axis in axes(inside.shape))
        lit = self.edges[..., inside].max(axis=0) > 0
        steepest = 0.0
        for number, table in enumerate(np.tensordot(colour, self._tables, 1)):
            at = (v[lit[number]], u[lit[number]])
            down, right = spline(table, *at, order=(1, 0)), spline(table, *at, order=(0, 1))
            # rotated maps may have the full slope along one axis
            both = np.hypot(down, right) if self.symmetric else np.maximum(abs(down), abs(right))
            steepest = max(steepest, float(both.max()))
        moved = np.tensordot(colour, self.distortion, 1)
        return steepest, float(np.hypot(*moved.T).max())

    @cached_property
    def _continued(self) -> Values:
        """Paths continued over the square."""
        shape = self.paths.shape
        flat = self.paths.reshape(-1, *shape[2:])
        return continue_maps(flat, np.isfinite(flat)).reshape(shape)

    @cached_property
    def _tables(self) -> Values:
        return coefficients(self._continued)

    @cached_property
    def _cut(self) -> Values:
        """Edges continued over the square."""
        return continue_edges(self.edges, disc((self.paths.shape[2], self.paths.shape[3])))

    def _colour(self, wavelength: float, degree: int) -> Values:
        """Return the weight of each wavelength at another."""
        if self._lines is None:
            return np.ones(1)
        low, high = (inverse_square**-0.5 for inverse_square in self._lines.ends[::-1])
        if not (low * (1 - 1e-6) <= wavelength <= high * (1 + 1e-6)):
            band = metres(low) if low == high else f"{metres(low)} to {metres(high)}"
            raise ValueError(
                f"wavelength must be {band} for these OPD maps, got {metres(wavelength)}: add "
                "maps, or leave wavelengths out if the path does not depend on it."
            )
        return self._lines.weights(wavelength**-2.0, degree)

    def _interpolate(
        self, maps: Values, y: float, x: float, wavelength: float, degree: int
    ) -> Values:
        """Interpolate numbers of each wavelength and field at another wavelength and field."""
        mixed = np.tensordot(self._colour(wavelength, degree), maps, 1)
        return np.asarray(np.tensordot(self._positions.weights(y, x, degree), mixed, 1))

    def _table(self, y: float, x: float, wavelength: float) -> Values:
        return self._interpolate(self._tables, y, x, wavelength, SMOOTH)

    def _displacement(
        self, pairs: Values, y: float, x: float, wavelength: float
    ) -> tuple[float, float]:
        down, right = self._interpolate(pairs, y, x, wavelength, SMOOTH)
        sine, cosine = self._positions.turn(y, x)
        return float(down * cosine + right * sine), float(right * cosine - down * sine)


_CACHED = ("digest", "_steepest", "_continued", "_tables", "_cut")  # caches, left out of the state


def _clip_to_disc(v: Any, u: Any) -> tuple[Values, Values]:
    """Return positions of the disc; positions beyond are moved to the rim."""
    check_finite(v=v, u=u)
    v, u = np.broadcast_arrays(*(real_array(x, "v and u", np.float64) for x in (v, u)))
    out = np.maximum(np.hypot(v, u), 1)
    return v / out, u / out


def _rotate_back(v: Values, u: Values, turn: tuple[float, float]) -> tuple[Values, Values]:
    """Return positions in the pupil rotated back to the given field."""
    sine, cosine = turn
    return (v, u) if sine == 0 and cosine == 1 else (
        v * cosine - u * sine, u * cosine + v * sine
    )  # fmt: skip


# Checks of arguments


def _require_maps(paths: Values) -> None:
    if paths.ndim != 4 or min(paths.shape, default=0) == 0:
        raise ValueError(
            f"path must have shape (n_wavelengths, n_fields, n_v, n_u), got {paths.shape}; use "
            "path[None, None] for one map."
        )
    if min(paths.shape[2:]) < MIN_SAMPLES:
        raise ValueError(
            f"path must have at least {MIN_SAMPLES} samples along v and u, got "
            f"{paths.shape[2]} x {paths.shape[3]}."
        )


def _fields(fields: Any, count: int, symmetric: bool) -> Values:
    positions = real_array(fields, "fields", np.float64)
    if positions.ndim == 1 and symmetric:
        positions = np.stack([positions, np.zeros_like(positions)], axis=-1)
    if positions.shape != (count, 2):
        alone = " or (n_fields,)" if symmetric else ""
        raise ValueError(
            f"fields must be (y, x) of the image of each of {count} maps, shape ({count}, 2)"
            f"{alone}, got {np.shape(fields)}."
        )
    if not np.isfinite(positions).all():
        raise ValueError("fields must be finite, in metres.")
    units.IMAGE_PLACE.check(positions, "A field")
    if len(np.unique(positions, axis=0)) < count:
        raise ValueError("fields must be distinct, but two of them are equal.")
    positions = np.array(positions)
    positions.setflags(write=False)
    return positions


def _wavelengths(wavelengths: Any, count: int) -> Values | None:
    if wavelengths is None:
        if count > 1:
            raise ValueError(
                f"wavelengths must be given, in metres, for a path of {count} wavelengths."
            )
        return None
    values = real_array(wavelengths, "wavelengths", np.float64).reshape(-1)
    if values.shape != (count,):
        raise ValueError(
            f"wavelengths must have as many elements as path, {count}, got {values.size}."
        )
    if not (np.isfinite(values).all() and (values > 0).all() and len(np.unique(values)) == count):
        raise ValueError(
            f"wavelengths must be positive, finite and distinct, in metres, got {wavelengths}."
        )
    units.WAVELENGTH.check(values, "A wavelength")
    values = np.array(values)
    values.setflags(write=False)
    return values


def _shares(transmission: Any, paths: Values, inside: Any) -> Values | None:
    """Return the checked transmission, or None."""
    shares = _broadcast_to_paths(transmission, paths, "transmission")
    if shares is None:
        return None
    ok = (shares >= 0) & (shares <= 1) | ~inside
    if not ok.all():
        raise ValueError(
            "transmission must be a fraction of the energy, 0 to 1, in the whole pupil, got "
            f"{shares[~ok][0]:g}."
        )
    return np.where(inside, shares, 0.0)


def _cuts(edge: Any, paths: Values, inside: Any) -> Values | None:
    """Return the checked edge, or None."""
    cuts = _broadcast_to_paths(edge, paths, "edge")
    if cuts is not None and not np.isfinite(cuts[..., inside]).all():
        raise ValueError("edge must be finite in the whole pupil.")
    return cuts


def _broadcast_to_paths(values: Any, paths: Values, name: str) -> Values | None:
    if values is None:
        return None
    samples = real_array(values, name, np.float64)
    if samples.shape not in (paths.shape, paths.shape[1:]):
        raise ValueError(
            f"{name} must have the shape of path, {paths.shape}, or {paths.shape[1:]}, got "
            f"{samples.shape}."
        )
    return np.array(np.broadcast_to(samples, paths.shape))


def _require_light(paths: Values, lit: Any) -> None:
    """Raise unless every map has paths where light passes, and enough of them."""
    if np.isinf(paths).any():
        raise ValueError("path must be finite, in metres, or NaN where no ray passes.")
    wrong = (lit & ~np.isfinite(paths)).sum(axis=(2, 3))
    if wrong.any():
        colour, field = np.argwhere(wrong)[0]
        raise ValueError(
            f"path must be finite where light passes, got NaN at {wrong[colour, field]} samples of "
            f"field {field}, wavelength {colour}: give the path there, or transmission 0."
        )
    counts = lit.sum(axis=(2, 3))
    if (counts < MIN_LIT_SAMPLES).any():
        colour, field = np.argwhere(counts < MIN_LIT_SAMPLES)[0]
        raise ValueError(
            f"A map must have light at {MIN_LIT_SAMPLES} samples or more, got "
            f"{counts[colour, field]} in field {field}, wavelength {colour}: leave the field out, "
            "or sample the pupil more finely."
        )


def _require_metres(maps: OPDMaps) -> None:
    largest = float(np.nanmax(np.abs(maps.paths)))
    if maps.wavelengths is not None:
        longest = float(maps.wavelengths.max())
        if largest > MAX_PATH_WAVES * longest:
            raise ValueError(
                f"path must be in metres, got up to {largest:g}, which would be "
                f"{largest / longest:.3g} wavelengths: multiply waves by the wavelength, such as "
                f"{longest:g}, and micrometres by 1e-6."
            )
    units.WAVEFRONT.check(largest, "path")


def _pairs(pairs: Any, shape: tuple[int, int, int], name: str) -> Values:
    if pairs is None:
        return np.zeros(shape)
    values = real_array(pairs, name, np.float64)
    if values.shape not in (shape, shape[1:]):
        raise ValueError(
            f"{name} must be (y, x) for each wavelength and field, shape {shape}, or for each "
            f"field, {shape[1:]}, got {values.shape}."
        )
    if not np.isfinite(values).all():
        raise ValueError(f"{name} must be finite.")
    return np.array(np.broadcast_to(values, shape))


def _require_steps(maps: OPDMaps) -> None:
    reach = float(np.hypot(*maps.fields.T).max())
    moved = float(np.hypot(*np.moveaxis(maps.distortion, -1, 0)).max())
    if reach and moved > reach * (1 + ROUNDING):
        raise ValueError(
            f"distortion must be a displacement in metres, got {moved:g} m for an outermost field "
            f"{reach:g} m from the axis: multiply fractions by the field."
        )
    units.IMAGE_PLACE.check(maps.distortion, "distortion")
    if maps.largest_shift > MAX_PUPIL_SHIFT:
        raise ValueError(
            f"pupil_shift must be at most {MAX_PUPIL_SHIFT:g} radii of the pupil, got "
            f"{maps.largest_shift:g}."
        )


def _length(length: float | None, name: str) -> float | None:
    if length is None:
        return None
    if not (fits_float64(length) and length > 0):
        raise ValueError(f"{name} must be positive and finite, in metres, got {length!r}.")
    units.CAMERA_DIAMETER.check(length, name)
    return float(length)
