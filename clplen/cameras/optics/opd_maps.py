"""OPD maps of a lens: wavefront, distortion, pupil shift and vignetting over field and wavelength.

What a lens of a prescription does to the light of one point is a map of path lengths W over its
pupil (Born and Wolf 1999, section 5.1), the place where the chief ray arrives, and which rays pass.
`Aberrations` puts such maps in place of a thin main lens' perfect pupil.
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
    FieldPlaces,
    Line,
    axes,
    bilinear,
    coefficients,
    continued,
    continued_edges,
    disc,
    edges_of,
    nearest,
    part_within,
    require_room,
    spline,
)
from clplen.cameras.optics.traced_maps import trace_maps
from clplen.checks import check_finite, fits_float64, real_array
from clplen.reprs import one_line
from clplen.results import Savable
from clplen.units import metres

Values = np.ndarray[Any, np.dtype[np.float64]]
LEAST_SAMPLES = 5  # of a map along each axis
LEAST_LIT = 10  # samples of a map that hold a path: what a parabola needs, and some
MOST_WAVES = 2000.0  # of a path: beyond, it was given in other units
LARGEST_SHIFT = 0.5  # of the pupil's radius


class OPDMaps(Savable):
    """Wavefront, distortion, pupil shift and vignetting of a main lens, by maps over its pupil.

    Sample i of n along v or u lies at -1 + 2 i/(n - 1), as a fraction of the pupil's radius, so
    that the first and the last lie on the rim; v counts along y and u along x. Samples beyond the
    unit disc do not count. A path is positive where it retards, as exp(+ikz) does, from the sphere
    about the place where the chief ray arrives; a tilt in it moves the image beside that place.

    In the pupil a path is a bicubic spline, transmission and edge are bilinear. Between fields
    along a radius or on a grid, paths, distortion and pupil shift are cubic splines (parabolas
    through three, straight through two), transmission and edge straight; between scattered fields
    all are linear in Delaunay's triangles. Between wavelengths they are the same splines of
    1/lam^2, as dispersion is. Nothing is extrapolated.

    Parameters
    ----------
    path : array_like
        W in metres, shape (n_wavelengths, n_fields, n_v, n_u), 5 samples or more along v and u.
        NaN where no ray passed.
    fields : array_like
        Where the points are imaged without distortion, (y, x) on the main lens' image plane in
        metres, shape (n_fields, 2): a grid in any order, or scattered. With ``symmetric`` along one
        radius, or the distances from the axis, shape (n_fields,), which are taken along +y. One
        field: its map holds for all of the image.
    wavelengths : array_like, optional
        In metres, shape (n_wavelengths,), distinct. None, with one wavelength: the same path at
        all, as of mirrors.
    symmetric : bool
        Whether the lens is rotationally symmetric: maps, distortion and pupil shift are then turned
        about the axis.
    distortion : array_like, optional
        How far beside ``fields`` the chief ray arrives, (y, x) in metres, shape (n_wavelengths,
        n_fields, 2) or (n_fields, 2). None: not at all.
    pupil_shift : array_like, optional
        Where the pupil's middle lies on the main lens' aperture, (y, x) as fractions of its radius,
        up to .5, shapes as of ``distortion``. No light is lost by it. None: in the middle.
    transmission : array_like, optional
        Share of the energy that passes each sample, 0 to 1, shape of ``path`` or without its first
        axis. None: 1.
    edge : array_like, optional
        Where the lens' other rims cut the pupil: a number that falls through 0 there, positive
        where light passes, shapes as of ``transmission``, such as the smallest 1 - r/a of all
        surfaces that a ray meets at the height r, a the height of their rims. None: half a sample
        from where the path is NaN, or the transmission 0.
    pupil_distance, pupil_diameter : float, optional
        The exit pupil's distance from the image plane and its diameter in metres, where known:
        their ratio is the f-number that the camera should have.

    Attributes
    ----------
    paths, transmissions, edges : numpy.ndarray
        Float64, read only, shape (n_wavelengths, n_fields, n_v, n_u). ``paths`` as given and
        ``edges`` are NaN beyond the disc, ``transmissions`` are continued beyond disc and edges.
    fields, wavelengths, distortion, pupil_shift : numpy.ndarray
        As given, float64, read only; ``wavelengths`` may be None.
    symmetric, pupil_distance, pupil_diameter
        As given.

    Raises
    ------
    ValueError
        For shapes that do not fit, numbers out of range or in other units than metres, NaN where
        light passes, or fields that lie on one line.
    TypeError
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
        self._places = FieldPlaces(self.fields, self.symmetric)
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
        cuts = edges_of(lit, inside) if cuts is None else cuts
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
        """The maps of a lens by its prescription, traced by optiland (``clplen[lenses]``).

        Coordinates are optiland's, in metres: its x and y are ours, and both pupils' rims are 1.
        The image plane is the prescription's, the image without distortion lies where the scale of
        a field next to the axis puts it at the first wavelength (the prescription's primary one, if
        none are given), and the path is from the sphere about the chief ray's place there, with
        the exit pupil's middle on it. Vignetting needs the surfaces' apertures in the prescription.

        Parameters
        ----------
        optic : optiland.optic.Optic or path-like
            Rotationally symmetric, of fields by angle, object height or paraxial image height. A
            path: optiland's JSON, or Zemax' .zmx.
        fields : int or sequence of float
            So many from the axis to the largest field, or their fractions of it, 0 to 1.
        wavelengths : sequence of float, optional
            In metres; None: those of the prescription.
        samples : int
            Of a map along each axis, 5 or more.

        Returns
        -------
        OPDMaps
            With ``symmetric`` True, or of one field if only the axis is asked for.

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
        return {name: value for name, value in vars(self).items() if name not in _KEPT}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers, by which maps are compared."""
        found = hashlib.sha256()
        for name, value in self.values().items():
            found.update(name.encode())
            array = None if value is None else np.asarray(value)
            found.update(b"" if array is None else repr(array.shape).encode() + array.tobytes())
        return found.hexdigest()

    def values(self) -> dict[str, Any]:
        """The arguments that give the same maps again, by name."""
        names = (
            "fields", "wavelengths", "symmetric", "distortion", "pupil_shift", "pupil_distance",
            "pupil_diameter",
        )  # fmt: skip
        found = {"path": self.paths, "transmission": self.transmissions, "edge": self.edges}
        return found | {name: getattr(self, name) for name in names}

    @property
    def varies(self) -> bool:
        """Whether there are maps for several fields, or something besides the wavefront moves."""
        return not self._places.everywhere or bool(self.distortion.any() or self.pupil_shift.any())

    @property
    def vignettes(self) -> bool:
        """Whether some light does not pass."""
        inside = disc((self.paths.shape[2], self.paths.shape[3]))
        return bool(((self.edges <= 0) | (self.transmissions < 1))[..., inside].any())

    @property
    def largest_shift(self) -> float:
        """How far the pupil lies from the middle of the aperture at most, of its radius."""
        return float(np.hypot(*np.moveaxis(self.pupil_shift, -1, 0)).max())

    def check(self, images: Values, wavelength: float) -> None:
        """Refuse images, or a wavelength, that the maps do not reach."""
        self._colour(wavelength, STRAIGHT)
        self._places.require(images)

    def path(self, y: float, x: float, wavelength: float, v: Any, u: Any) -> Values:
        """W of a point imaged at (y, x), in metres.

        Parameters
        ----------
        y, x : float
            Place of the image without distortion, in metres.
        wavelength : float
            In metres.
        v, u : array_like
            Places in the pupil as fractions of its radius; beyond the rim, those of the rim.

        Returns
        -------
        numpy.ndarray
            float64, the broadcast shape of ``v`` and ``u``; continued where no light passes.

        Raises
        ------
        ValueError
            If the maps reach neither there nor to that wavelength.
        """
        table, turn = self._table(y, x, wavelength), self._places.turn(y, x)
        return spline(table, *_turned_back(*_on_disc(v, u), turn))

    def slopes(
        self, y: float, x: float, wavelength: float, v: Any, u: Any
    ) -> tuple[Values, Values]:
        """(dW/dv, dW/du) of a point imaged at (y, x), in metres over the pupil's radius.

        Parameters are those of `path`; so are the errors.

        Returns
        -------
        tuple of numpy.ndarray
            Both float64, the broadcast shape of ``v`` and ``u``.
        """
        table, (sine, cosine) = self._table(y, x, wavelength), self._places.turn(y, x)
        at = _turned_back(*_on_disc(v, u), (sine, cosine))
        down, right = spline(table, *at, order=(1, 0)), spline(table, *at, order=(0, 1))
        return down * cosine + right * sine, right * cosine - down * sine

    def transmission(self, y: float, x: float, wavelength: float, v: Any, u: Any) -> Values:
        """Share of the energy of a point imaged at (y, x) that passes places of the pupil.

        Parameters are those of `path`; so are the errors.

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
        """Share of the energy that passes within the edge, and how much of cells is within it.

        ``cell`` is the width of the cells about the places, as a fraction of the radius.
        """
        turn, at = self._places.turn(y, x), _on_disc(v, u)
        share, edge = (
            self._mixed(maps, y, x, wavelength, STRAIGHT)
            for maps in (self.transmissions, self._cut)
        )
        passed = np.clip(bilinear(share, *_turned_back(*at, turn)), 0, 1)
        middle = bilinear(edge, *_turned_back(*at, turn))
        if not cell:
            return passed, (middle > 0).astype(np.float64)
        rises = []
        for down, right in ((cell / 2, 0.0), (0.0, cell / 2)):
            ends = [
                bilinear(edge, *_turned_back(at[0] + sign * down, at[1] + sign * right, turn))
                for sign in (-1, 1)
            ]
            rises.append(np.abs(ends[1] - ends[0]))
        return passed, part_within(middle, *rises)

    def chief_ray(self, y: float, x: float, wavelength: float) -> tuple[float, float]:
        """Where the chief ray of a point imaged at (y, x) arrives, (y, x) in metres.

        Parameters and errors are those of `path`.
        """
        down, right = self._moved(self.distortion, y, x, wavelength)
        return y + down, x + right

    def pupil_centre(self, y: float, x: float, wavelength: float) -> tuple[float, float]:
        """Where the pupil's middle lies, (y, x) as fractions of the aperture's radius.

        Parameters and errors are those of `path`.
        """
        return self._moved(self.pupil_shift, y, x, wavelength)

    def passed(self, y: float, x: float, wavelength: float) -> float:
        """Share of the energy of a point imaged at (y, x) that passes the pupil, 0 to 1.

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
        """Of each field: W's rms about its mean where light passes, metres; share that passes."""
        colour = self._colour(wavelength, SMOOTH)
        paths = np.tensordot(colour, self._whole, 1)
        straight = self._colour(wavelength, STRAIGHT)
        share, edge = (np.tensordot(straight, m, 1) for m in (self.transmissions, self.edges))
        weight = np.clip(share, 0, 1) * (edge > 0) * disc((paths.shape[1], paths.shape[2]))
        total = weight.sum(axis=(1, 2))
        mean = (weight * paths).sum(axis=(1, 2)) / total
        square = (weight * (paths - mean[:, None, None]) ** 2).sum(axis=(1, 2)) / total
        lit = disc((paths.shape[1], paths.shape[2])).sum()
        return np.sqrt(square), total / lit

    def steepest(self, wavelength: float) -> tuple[float, float]:
        """The largest slope along v or u of any field, and the largest distortion.

        In metres over the pupil's radius, and in metres.
        """
        known = self._steepest.get(wavelength)
        if known is None:
            known = self._steepest[wavelength] = self._largest_slopes(wavelength)
        return known

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
            # turned, a slope along one axis is any part of both
            both = np.hypot(down, right) if self.symmetric else np.maximum(abs(down), abs(right))
            steepest = max(steepest, float(both.max()))
        moved = np.tensordot(colour, self.distortion, 1)
        return steepest, float(np.hypot(*moved.T).max())

    @cached_property
    def _whole(self) -> Values:
        """Paths continued over the square."""
        shape = self.paths.shape
        flat = self.paths.reshape(-1, *shape[2:])
        return continued(flat, np.isfinite(flat)).reshape(shape)

    @cached_property
    def _tables(self) -> Values:
        return coefficients(self._whole)

    @cached_property
    def _cut(self) -> Values:
        """Edges continued over the square."""
        return continued_edges(self.edges, disc((self.paths.shape[2], self.paths.shape[3])))

    def _colour(self, wavelength: float, degree: int) -> Values:
        """How much of each wavelength counts at one."""
        if self._lines is None:
            return np.ones(1)
        low, high = (one**-0.5 for one in self._lines.ends[::-1])
        if not (low * (1 - 1e-6) <= wavelength <= high * (1 + 1e-6)):
            held = metres(low) if low == high else f"{metres(low)} to {metres(high)}"
            raise ValueError(
                f"The OPD maps are for wavelengths of {held}, not {metres(wavelength)}: add maps, "
                "or leave wavelengths out where the path is the same at all."
            )
        return self._lines.weights(wavelength**-2.0, degree)

    def _mixed(self, maps: Values, y: float, x: float, wavelength: float, degree: int) -> Values:
        """What is given for each wavelength and field, at one of both."""
        found = np.tensordot(self._colour(wavelength, degree), maps, 1)
        return np.asarray(np.tensordot(self._places.weights(y, x, degree), found, 1))

    def _table(self, y: float, x: float, wavelength: float) -> Values:
        return self._mixed(self._tables, y, x, wavelength, SMOOTH)

    def _moved(self, pairs: Values, y: float, x: float, wavelength: float) -> tuple[float, float]:
        down, right = self._mixed(pairs, y, x, wavelength, SMOOTH)
        sine, cosine = self._places.turn(y, x)
        return float(down * cosine + right * sine), float(right * cosine - down * sine)


_KEPT = ("digest", "_steepest", "_whole", "_tables", "_cut")  # made again when they are needed


def _on_disc(v: Any, u: Any) -> tuple[Values, Values]:
    """Places of the disc, those beyond it brought to the rim."""
    check_finite(v=v, u=u)
    v, u = np.broadcast_arrays(*(real_array(x, "v and u", np.float64) for x in (v, u)))
    out = np.maximum(np.hypot(v, u), 1)
    return v / out, u / out


def _turned_back(v: Values, u: Values, turn: tuple[float, float]) -> tuple[Values, Values]:
    """Places in the pupil as the field that is given has them."""
    sine, cosine = turn
    return (v, u) if sine == 0 and cosine == 1 else (
        v * cosine - u * sine, u * cosine + v * sine
    )  # fmt: skip


# What is refused


def _require_maps(paths: Values) -> None:
    if paths.ndim != 4 or min(paths.shape, default=0) == 0:
        raise ValueError(
            "path has shape (n_wavelengths, n_fields, n_v, n_u), not "
            f"{paths.shape}; one map is path[None, None]."
        )
    if min(paths.shape[2:]) < LEAST_SAMPLES:
        raise ValueError(
            f"A map has {LEAST_SAMPLES} samples or more along v and u, not "
            f"{paths.shape[2]} x {paths.shape[3]}."
        )


def _fields(given: Any, count: int, symmetric: bool) -> Values:
    found = real_array(given, "fields", np.float64)
    if found.ndim == 1 and symmetric:
        found = np.stack([found, np.zeros_like(found)], axis=-1)
    if found.shape != (count, 2):
        alone = " or (n_fields,)" if symmetric else ""
        raise ValueError(
            f"fields are (y, x) of the image of each of {count} maps, shape ({count}, 2){alone}, "
            f"not {np.shape(given)}."
        )
    if not np.isfinite(found).all():
        raise ValueError("fields are finite, in metres; some of these are not.")
    units.IMAGE_PLACE.check(found, "A field")
    if len(np.unique(found, axis=0)) < count:
        raise ValueError("fields are distinct; two maps are given for one of these places.")
    found = np.array(found)
    found.setflags(write=False)
    return found


def _wavelengths(given: Any, count: int) -> Values | None:
    if given is None:
        if count > 1:
            raise ValueError(
                f"path holds maps of {count} wavelengths: give wavelengths, in metres."
            )
        return None
    found = real_array(given, "wavelengths", np.float64).reshape(-1)
    if found.shape != (count,):
        raise ValueError(
            f"path holds maps of {count} wavelengths, and {found.size} wavelengths are given."
        )
    if not (np.isfinite(found).all() and (found > 0).all() and len(np.unique(found)) == count):
        raise ValueError(f"wavelengths are positive, finite and distinct, in metres, not {given}.")
    units.WAVELENGTH.check(found, "A wavelength")
    found = np.array(found)
    found.setflags(write=False)
    return found


def _shares(given: Any, paths: Values, inside: Any) -> Values | None:
    """The transmission where it is given."""
    found = _like_paths(given, paths, "transmission")
    if found is None:
        return None
    ok = (found >= 0) & (found <= 1) | ~inside
    if not ok.all():
        raise ValueError(
            "transmission is a share of the energy, 0 to 1, in all of the pupil, not "
            f"{found[~ok][0]:g}."
        )
    return np.where(inside, found, 0.0)


def _cuts(given: Any, paths: Values, inside: Any) -> Values | None:
    """The edge where it is given."""
    found = _like_paths(given, paths, "edge")
    if found is not None and not np.isfinite(found[..., inside]).all():
        raise ValueError("edge is finite in all of the pupil; some of it is not.")
    return found


def _like_paths(given: Any, paths: Values, name: str) -> Values | None:
    if given is None:
        return None
    found = real_array(given, name, np.float64)
    if found.shape not in (paths.shape, paths.shape[1:]):
        raise ValueError(
            f"{name} has the shape of path, {paths.shape}, or {paths.shape[1:]}, not {found.shape}."
        )
    return np.array(np.broadcast_to(found, paths.shape))


def _require_light(paths: Values, lit: Any) -> None:
    """Each map holds paths where light passes, and enough of them."""
    if np.isinf(paths).any():
        raise ValueError("path is finite, in metres, or NaN where no ray passed; some is infinite.")
    wrong = (lit & ~np.isfinite(paths)).sum(axis=(2, 3))
    if wrong.any():
        colour, field = np.argwhere(wrong)[0]
        raise ValueError(
            f"path is NaN at {wrong[colour, field]} samples of field {field}, wavelength {colour}, "
            "where light passes by transmission or edge: give the path there, or transmission 0."
        )
    few = lit.sum(axis=(2, 3))
    if (few < LEAST_LIT).any():
        colour, field = np.argwhere(few < LEAST_LIT)[0]
        raise ValueError(
            f"Light passes the map of field {field}, wavelength {colour}, at {few[colour, field]} "
            f"samples, and {LEAST_LIT} are the least: leave the field out, or sample the pupil "
            "finer."
        )


def _require_metres(maps: OPDMaps) -> None:
    largest = float(np.nanmax(np.abs(maps.paths)))
    if maps.wavelengths is not None:
        longest = float(maps.wavelengths.max())
        if largest > MOST_WAVES * longest:
            raise ValueError(
                f"path reaches {largest:g} m, {largest / longest:.3g} wavelengths: it is in metres "
                f"of path. Multiply waves by the wavelength, as {longest:g}, and micrometres by "
                "1e-6."
            )
    units.WAVEFRONT.check(largest, "path")


def _pairs(given: Any, shape: tuple[int, int, int], name: str) -> Values:
    if given is None:
        return np.zeros(shape)
    found = real_array(given, name, np.float64)
    if found.shape not in (shape, shape[1:]):
        raise ValueError(
            f"{name} is (y, x) for each wavelength and field, shape {shape}, or for each field, "
            f"{shape[1:]}, not {found.shape}."
        )
    if not np.isfinite(found).all():
        raise ValueError(f"{name} is finite; some of it is not.")
    return np.array(np.broadcast_to(found, shape))


def _require_steps(maps: OPDMaps) -> None:
    reach = float(np.hypot(*maps.fields.T).max())
    moved = float(np.hypot(*np.moveaxis(maps.distortion, -1, 0)).max())
    if reach and moved > reach * (1 + ROUNDING):
        raise ValueError(
            f"distortion moves a chief ray by {moved:g} m, and the outermost field is {reach:g} m "
            "from the axis: distortion is a displacement in metres, not a share of the field."
        )
    units.IMAGE_PLACE.check(maps.distortion, "distortion")
    if maps.largest_shift > LARGEST_SHIFT:
        raise ValueError(
            f"pupil_shift is a fraction of the pupil's radius, at most {LARGEST_SHIFT:g}, not "
            f"{maps.largest_shift:g}."
        )


def _length(given: float | None, name: str) -> float | None:
    if given is None:
        return None
    if not (fits_float64(given) and given > 0):
        raise ValueError(f"{name} is positive and finite, in metres, not {given!r}.")
    units.CAMERA_DIAMETER.check(given, name)
    return float(given)
