"""Aberrations of a plenoptic camera: wavefronts, misplaced lenslets, a shifted or tilted sensor.

A wavefront W is a path length, positive where it retards, as exp(+ikW). Rays turn by its slope: the
ray from u on the main lens meets the array z2 dW/du beside its ideal position. Born and Wolf (1999,
section 5.1) use the opposite sign of W. `correct_aberrations` removes the main lens'
wavefront from a light field, view by view.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clplen import units
from clplen.cameras.optics.opd_maps import OPDMaps
from clplen.checks import fits_float64, is_integer
from clplen.lightfield.model.alpha_law import require_two_plane
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.stored_light_field import as_lightfield
from clplen.lightfield.raw.raw_image import CameraModel
from clplen.lightfield.refocusing.phase_ramps import shift_views
from clplen.reprs import OneLine
from clplen.wave.elements.lenslet_errors import HIGHEST_ORDER, LensletErrors
from clplen.wave.elements.lenslets import MicrolensArray, circumscribed
from clplen.wave.elements.zernike import noll, zernike_gradient

Values = np.ndarray[Any, np.dtype[np.float64]]
Orders = tuple[int, int]
Pair = tuple[float, float]
Terms = tuple[tuple[int, float], ...]
FieldTerms = tuple[tuple[int, Pair], ...]
MAX_DEVIATION_RMS = 4.0  # cut-off of the normal distribution of the scatter, in rms
MAX_TILT = 0.1  # maximum slope of the sensor: a projected pitch is then right to 0.5 %
MAX_FOCAL_SCATTER = 0.2  # maximum rms of f/f_designed - 1: four times it leaves f positive


@dataclass(frozen=True)
class LensletScatter:
    """Random deviations of the lenslets of an array from their design, by manufacture.

    Each quantity is normally distributed, cut off at four times its rms, and independent between
    lenslets and between axes.

    Parameters
    ----------
    focal_length : float
        Rms of f/f_designed - 1, at most 0.2.
    tilt : float
        Rms of the slope that a lenslet adds to all its rays (a wedge), along each axis, in radians.
    position : float
        Rms distance of the vertex from the centre of its aperture, along each axis, in metres;
        apertures keep their positions.
    seed : int
        Seed of the random numbers, 0 or more; equal seeds give equal arrays.

    Raises
    ------
    ValueError
        If a number is negative, not finite, or too large.

    Examples
    --------
    >>> scatter = clplen.cameras.LensletScatter(0.01, tilt=1e-4, seed=3)
    >>> focal, tilt, position = scatter.draw((100, 100))  # f/f_designed; (y, x) of the others
    >>> focal.shape, tilt.shape
    ((100, 100), (100, 100, 2))
    >>> f"{focal.std():.3f}, {tilt.std():.1e} rad"
    '0.010, 1.0e-04 rad'
    """

    focal_length: float = 0.0
    tilt: float = 0.0
    position: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("focal_length", "tilt", "position"):
            value = getattr(self, name)
            if not (fits_float64(value) and value >= 0):
                raise ValueError(f"{name} of LensletScatter must be an rms >= 0, got {value!r}.")
            object.__setattr__(self, name, float(value))
        if self.focal_length > MAX_FOCAL_SCATTER:
            raise ValueError(
                f"focal_length of LensletScatter, a relative rms, must be <= "
                f"{MAX_FOCAL_SCATTER}, got {self.focal_length!r}: some lenslets would have no "
                "focal length."
            )
        if not is_integer(self.seed) or self.seed < 0:
            raise ValueError(f"seed must be an integer >= 0, got {self.seed!r}.")
        object.__setattr__(self, "seed", int(self.seed))

    @property
    def is_none(self) -> bool:
        """True if all deviations are 0."""
        return self.focal_length == self.tilt == self.position == 0

    def draw(self, count: tuple[int, int]) -> tuple[Values, Values, Values]:
        """Draw f/f_designed, tilt and position (y, x), shapes ``count`` and ``(*count, 2)``."""
        sizes = (count, (*count, 2), (*count, 2))
        rms = (self.focal_length, self.tilt, self.position)
        focal, tilt, position = (
            scale
            * np.clip(
                np.random.default_rng([self.seed, n]).normal(size=size),
                -MAX_DEVIATION_RMS,
                MAX_DEVIATION_RMS,
            )
            for n, (scale, size) in enumerate(zip(rms, sizes, strict=True))
        )
        return 1 + focal, tilt, position


@dataclass(frozen=True, init=False, repr=False)
class Aberrations(OneLine):
    """Departures of a plenoptic camera from its design, all optional.

    Parameters
    ----------
    main_lens : mapping of int to float
        Wavefront of the main lens: Noll's index to metres of path, rms over the aperture (one
        wave is ``wavelength`` metres). See `clplen.wave.elements.zernike.phase_plate`.
    main_lens_field : mapping of int to tuple of float
        Additional wavefront in proportion to a point's image (Y, X) on the main lens' image plane:
        Noll's index to metres of path per metre of (Y, X). {7: (c, 0), 8: (0, c)} is Seidel's coma,
        {4: (c, 0)} a tilted image plane.
    main_lens_opd : OPDMaps, optional
        Measured or traced wavefronts of the main lens over its field, with distortion, pupil shift
        and vignetting, added to the terms above.
    lenslets : mapping of int to float
        Wavefront of every lenslet over a circle about its centre, in the units of ``main_lens``;
        radial orders up to 8.
    lenslet_circle : float, optional
        Diameter of that circle in metres, at least that of the circle around a lenslet's aperture.
        None: that of a circular lenslet; square and hexagonal cells need a value.
    scatter : LensletScatter, optional
        Random deviations of the lenslets; none by default.
    sensor_shift : float
        Distance of the sensor beyond its design position, away from the array, in metres.
    sensor_tilt : tuple of float
        Slopes (y, x) of the sensor against the array, about the optical axis: the pixel at (y, x)
        is farther from the array by y and x times these. The pixel pitch is the projection of the
        tilted pitch along the axis, times cos(angle). Waves require ``method="points"``; rays of a
        `SurfaceScene` do not support a tilt.

    Attributes
    ----------
    main_lens, main_lens_field, lenslets : tuple
        Pairs of index and value, in the order of the index.
    main_lens_opd : OPDMaps or None
        Argument of the constructor.
    lenslet_circle : float or None
        Diameter in metres.
    scatter : LensletScatter
        Argument of the constructor, or a scatter of zeros.
    sensor_shift : float
        Distance in metres.
    sensor_tilt : tuple of float
        Slopes (y, x).

    Raises
    ------
    ValueError
        If an index does not exist, or a number is not finite or out of range.
    TypeError
        If coefficients are not a mapping, or the scatter or the maps have another type.

    Examples
    --------
    >>> defocused = clplen.cameras.Aberrations(main_lens={4: 53.2e-9}, sensor_shift=50e-6)
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=30, aberrations=defocused)
    >>> f"{camera.describe()['wavefront of main lens'] / 532e-9:.2f} waves rms"
    '0.10 waves rms'
    >>> f"sensor {camera.sensor_distance * 1e3:.2f} mm behind the array"
    'sensor 10.05 mm behind the array'
    """

    main_lens: Terms
    main_lens_field: FieldTerms
    main_lens_opd: OPDMaps | None
    lenslets: Terms
    lenslet_circle: float | None
    scatter: LensletScatter
    sensor_shift: float
    sensor_tilt: Pair

    def __init__(
        self,
        *,
        main_lens: Mapping[int, float] | Terms = (),
        main_lens_field: Mapping[int, Pair] | FieldTerms = (),
        main_lens_opd: OPDMaps | None = None,
        lenslets: Mapping[int, float] | Terms = (),
        lenslet_circle: float | None = None,
        scatter: LensletScatter | None = None,
        sensor_shift: float = 0.0,
        sensor_tilt: Pair = (0.0, 0.0),
    ) -> None:
        if lenslet_circle is not None and not (fits_float64(lenslet_circle) and lenslet_circle > 0):
            raise ValueError(f"lenslet_circle must be > 0 metres, got {lenslet_circle!r}.")
        units.LENSLET_PITCH.check(lenslet_circle or 0.0, "lenslet_circle")
        if not fits_float64(sensor_shift):
            raise ValueError(f"sensor_shift must be finite, in metres, got {sensor_shift!r}.")
        if np.shape(sensor_tilt) != (2,) or not np.isfinite(sensor_tilt).all():
            raise ValueError(f"sensor_tilt must be two finite slopes (y, x), got {sensor_tilt!r}.")
        if max(map(abs, sensor_tilt)) > MAX_TILT:
            raise ValueError(
                f"sensor_tilt must be at most {MAX_TILT} along y and x, so that the projected "
                f"pitch is right to 0.5 %, got {sensor_tilt!r}."
            )
        if not isinstance(scatter, LensletScatter | None):
            kind = type(scatter).__name__
            raise TypeError(f"scatter must be a LensletScatter, got an object of type {kind}.")
        if not isinstance(main_lens_opd, OPDMaps | None):
            kind = type(main_lens_opd).__name__
            raise TypeError(f"main_lens_opd must be an OPDMaps, got an object of type {kind}.")
        values = {
            "main_lens": _terms(main_lens, "main_lens"),
            "main_lens_field": _field_terms(main_lens_field),
            "main_lens_opd": main_lens_opd,
            "lenslets": _terms(lenslets, "lenslets"),
            "lenslet_circle": None if lenslet_circle is None else float(lenslet_circle),
            "scatter": LensletScatter() if scatter is None else scatter,
            "sensor_shift": float(sensor_shift),
            "sensor_tilt": (float(sensor_tilt[0]), float(sensor_tilt[1])),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        highest = max((noll(j)[0] for j, _ in self.lenslets), default=0)
        if highest > HIGHEST_ORDER:
            raise ValueError(
                f"Radial orders of lenslets must be at most {HIGHEST_ORDER}, got {highest}."
            )

    @classmethod
    def from_json(cls, text: str, *, main_lens_opd: OPDMaps | None = None) -> Aberrations:
        """Read aberrations that `to_json` wrote.

        Parameters
        ----------
        text : str
            Text of `to_json`.
        main_lens_opd : OPDMaps, optional
            OPD maps of the aberrations, if they have any.

        Raises
        ------
        ValueError
            If ``main_lens_opd`` are not the maps of the aberrations.
        """
        values = json.loads(text)
        digest = values.pop("main_lens_opd", None)
        if digest != (None if main_lens_opd is None else main_lens_opd.digest):
            raise ValueError(
                "main_lens_opd must be the OPD maps of the saved aberrations, which are stored "
                "in a separate file: give these maps, or None if there were none."
            )
        scatter = LensletScatter(**values.pop("scatter"))
        return cls(**values, scatter=scatter, main_lens_opd=main_lens_opd)

    def to_json(self) -> str:
        """Return the aberrations as JSON with all digits; OPD maps are replaced by their digest."""
        values = asdict(replace(self, main_lens_opd=None))
        if self.main_lens_opd is None:
            del values["main_lens_opd"]
        else:
            values["main_lens_opd"] = self.main_lens_opd.digest
        return json.dumps(values)

    @property
    def bends_main_lens(self) -> bool:
        """True if the main lens has a wavefront."""
        has_wavefront = any(c for _, c in self.main_lens) or self.main_lens_opd is not None
        return has_wavefront or self.varies

    @property
    def varies(self) -> bool:
        """True if the wavefront changes over the field, or maps displace the image."""
        maps = self.main_lens_opd
        by_terms = any(any(pair) for _, pair in self.main_lens_field)
        return by_terms or (maps is not None and maps.varies)

    @property
    def vignettes(self) -> bool:
        """True if the main lens blocks light within its aperture."""
        return self.main_lens_opd is not None and self.main_lens_opd.vignettes

    @property
    def pupil_reach(self) -> float:
        """Largest distance of light from the main lens' centre, in radii of the aperture."""
        return 1.0 if self.main_lens_opd is None else 1 + self.main_lens_opd.largest_shift

    @property
    def bends_lenslets(self) -> bool:
        """True if the lenslets depart from thin lenses on their lattice."""
        return any(c for _, c in self.lenslets) or not self.scatter.is_none

    def main_terms(self, y: float = 0.0, x: float = 0.0) -> dict[Orders, float]:
        """Return orders (n, m) and metres of the main lens' wavefront for an image at (y, x)."""
        terms = {noll(j): metres for j, metres in self.main_lens}
        for j, (down, right) in self.main_lens_field:
            terms[noll(j)] = terms.get(noll(j), 0.0) + down * y + right * x
        return terms

    def main_slope(
        self, reach: float, radius: float, *, image_distance: float, wavelength: float
    ) -> float:
        """Return an upper bound of the slope of the main lens' wavefront in radians, to 0.5 %.

        It holds for images up to ``reach`` metres from the axis and an aperture of this radius. OPD
        maps add the steepest slope of all their fields and that of the distortion.
        """
        total = _steepest(self.main_lens)
        for axis in (0, 1):
            per_metre = tuple((j, pair[axis]) for j, pair in self.main_lens_field)
            total += reach * _steepest(per_metre)
        if self.main_lens_opd is None:
            return total / radius
        slope, moved = self.main_lens_opd.steepest(wavelength)
        return (total + slope) / radius + moved / image_distance

    def lenslet_errors(self, mla: MicrolensArray) -> LensletErrors:
        """Return the departures of an array's lenslets from thin lenses on their lattice."""
        focal, tilt, position = self.scatter.draw(mla.count)
        units = np.asarray(mla.focal_lengths)[mla.types()] * focal
        terms = {noll(j): metres for j, metres in self.lenslets}
        circle = self.lenslet_circle or circumscribed(mla)
        return LensletErrors(terms, circle, units, tilt, position)

    def lenslet_slope(self, mla: MicrolensArray) -> float:
        """Return an upper bound of the slope that aberrations add to d/(2 f), in radians."""
        return _lenslet_slope(self, mla) if self.bends_lenslets else 0.0

    def check_lenslets(self, mla: MicrolensArray) -> None:
        """Raise for Zernike terms on lenslets that reach beyond their circle."""
        if not self.lenslets:
            return
        needed, circle = circumscribed(mla), self.lenslet_circle
        if circle is None and needed > mla.diameter * (1 + 1e-12):
            raise ValueError(
                "lenslet_circle must be given for Zernike terms on lenslets with fill='full': use "
                f"{needed:.6g} m or more, or fill='circular'."
            )
        if circle is not None and circle < needed * (1 - 1e-12):
            raise ValueError(
                f"lenslet_circle must be at least {needed:.6g} m to contain the lenslets, got "
                f"{circle:.6g} m."
            )


@lru_cache(maxsize=16)
def _lenslet_slope(aberrations: Aberrations, mla: MicrolensArray) -> float:
    """Compute `Aberrations.lenslet_slope`; cached, because every point of a scene needs it."""
    errors = aberrations.lenslet_errors(mla)
    designed = np.asarray(mla.focal_lengths)[mla.types()]
    defocus = mla.diameter / 2 * np.abs(1 / errors.focal_lengths - 1 / designed)
    decentre = np.abs(errors.position).max(axis=-1) / errors.focal_lengths
    slope = defocus + decentre + np.abs(errors.tilt).max(axis=-1)
    return float(slope.max()) + _steepest(aberrations.lenslets) / (errors.circle / 2)


@lru_cache(maxsize=16)
def _steepest(terms: Terms) -> float:
    """Return the largest slope along y or x of a wavefront over the unit disc, to 0.5 %."""
    if not any(metres for _, metres in terms):
        return 0.0
    orders = {noll(j): metres for j, metres in terms}
    finer = 32 * (1 + max(n for n, _ in orders))
    radius, angle = np.linspace(0, 1, finer)[:, None], np.arange(finer) * (2 * np.pi / finer)
    down, right = slopes(orders, radius * np.sin(angle), radius * np.cos(angle))
    return float(max(np.abs(down).max(), np.abs(right).max()))


def slopes(terms: Mapping[Orders, float], y: Any, x: Any) -> tuple[Values, Values]:
    """Compute (dW/dy, dW/dx) at positions on the unit disc, in metres over its radius."""
    down, right = np.zeros(np.shape(y)), np.zeros(np.shape(x))
    for (n, m), metres in terms.items():
        steps = zernike_gradient(n, m, y, x)
        down, right = down + metres * steps[0], right + metres * steps[1]
    return down, right


def _pairs(terms: Mapping[int, Any] | Iterable[Any], name: str) -> list[tuple[int, Any]]:
    try:
        pairs = sorted(dict(terms).items())
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must map Noll's index to metres, got {terms!r}.") from error
    for j, _ in pairs:
        noll(j)
    return [(int(j), value) for j, value in pairs]


def _terms(terms: Mapping[int, float] | Terms, name: str) -> Terms:
    pairs = []
    for j, metres in _pairs(terms, name):
        if not (np.ndim(metres) == 0 and fits_float64(metres)):
            raise ValueError(f"{name}[{j}] must be finite, in metres, got {metres!r}.")
        units.WAVEFRONT.check(metres, f"{name}[{j}]")
        pairs.append((j, float(metres)))
    return tuple(pairs)


def _field_terms(terms: Mapping[int, Pair] | FieldTerms) -> FieldTerms:
    pairs = []
    for j, pair in _pairs(terms, "main_lens_field"):
        if np.shape(pair) != (2,) or not np.isfinite(pair).all():
            raise ValueError(
                f"main_lens_field[{j}] must be two finite numbers, along Y and X, got {pair!r}."
            )
        pairs.append((j, (float(pair[0]), float(pair[1]))))
    return tuple(pairs)


NONE = Aberrations()


def correct_aberrations(
    lf: LightField | ArrayLike, zernike: Mapping[int, float], *, camera: CameraModel | None = None
) -> LightField:
    """Remove a wavefront of the main lens from a light field.

    A ray from u on the main lens meets the image plane F dW/du beside its ideal position (ray
    aberration: Born and Wolf 1999, section 5.1; Ng 2006, chapter 7). View u is shifted back by that
    amount, through the phase of its spectrum. Only the slope in the middle of each view's pupil is
    corrected, not its change within: lenslets blur directions by lam f_mu/d on the sensor.

    Parameters
    ----------
    lf : LightField or array_like
        Light field decoded with "calibrated" sub-images and with a spacing in metres.
    zernike : mapping of int to float
        Noll's index to metres of path, rms over the aperture, as `Aberrations.main_lens`.
    camera : CameraModel, optional
        Camera whose image_distance F and aperture_diameter are used; default ``lf.camera``.

    Returns
    -------
    LightField
        Corrected light field, float32. Views beyond the rim of the aperture are shifted by the
        slope at the rim.

    Raises
    ------
    ValueError
        If the camera or the spacing is unknown, or the views are directions.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(  # F = 240 mm, D = 3.6 mm
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=16),
    ...     wavelength=532e-9, pixels_per_lenslet=15)
    >>> views = np.zeros((3, 3, 16, 16))
    >>> views[:, :, 8, 8] = 1.0
    >>> lf = clplen.LightField.from_array(
    ...     views, spacing=(-1e-3, -1e-3, 150e-6, 150e-6), camera=camera)
    >>> corrected = clplen.cameras.correct_aberrations(lf, {2: 0.5625e-6})  # F dW/du = 150 um
    >>> int(corrected.to_numpy()[1, 1, 8].argmax())
    7
    """
    lf = as_lightfield(lf)
    terms = Aberrations(main_lens=zernike).main_terms()
    model = lf.camera if camera is None else camera
    if model is None or lf.spacing is None:
        raise ValueError(
            "The light field must have a camera and a spacing in metres for the correction of a "
            "wavefront: give camera=, and a light field with spacing."
        )
    require_two_plane(lf.parametrisation, "The correction of a wavefront")
    if lf.decode == "naive":
        raise ValueError(
            "Naive cells are directions, not positions on the main lens: decode with 'calibrated'."
        )
    return shift_views(lf, _steps(lf, lf.spacing, terms, model))


def _steps(lf: LightField, spacing: Any, terms: Any, camera: CameraModel) -> Any:
    """Return displacements of each view's rays, (y, x) in pixels, shape (V, U, 2)."""
    dv, du, dy, dx = spacing
    if lf.positions is None:
        v, u = (np.arange(n) - (n - 1) / 2 for n in lf.shape[:2])
        v, u = np.meshgrid(v, u, indexing="ij")
    else:
        v, u = np.moveaxis(lf.positions, -1, 0)
    radius = camera.aperture_diameter / 2
    y, x = v * dv / radius, u * du / radius
    beyond = np.maximum(np.hypot(y, x), 1)
    down, right = slopes(terms, y / beyond, x / beyond)
    reach = camera.image_distance / radius
    return np.stack([down * reach / dy, right * reach / dx], axis=-1)
