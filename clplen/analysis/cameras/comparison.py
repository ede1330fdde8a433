"""Measurements of one plenoptic camera, and of several cameras alike."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import (
    PLACES,
    DepthTransfer,
    Done,
    camera_psf,
    line_curve,
    psf_exposures,
)
from clplen.analysis.cameras.crosstalk import camera_crosstalk
from clplen.analysis.cameras.depth_scan import PLACES as DEPTH_PLACES
from clplen.analysis.cameras.depth_scan import DepthErrors, default_depths, depth_scan
from clplen.analysis.cameras.imaging import Rendered, native_picture
from clplen.analysis.cameras.sampling import Sampling, sampling_of
from clplen.analysis.point.otf import Curve
from clplen.analysis.point.psf import PSF
from clplen.analysis.point.samples import Values
from clplen.analysis.point.twopoint import SLIT, TwoPoints
from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.scenes.scene_sources import PointSources, as_sources
from clplen.checks import real_array
from clplen.errors import SamplingError
from clplen.reprs import OneLine
from clplen.wave.elements.lenslets import circumscribed

HIGHEST = 1.05  # of the diffraction cut-off: where a cut-off that is measured may lie
_STEPS = 61  # of separations and radii
_WIDTHS = 4  # FWHM up to which they go


@dataclass(frozen=True, eq=False, repr=False)
class Measured:
    """What was measured of one camera; None was not asked for.

    Attributes
    ----------
    name : str
        The camera's, as `compare` was given it.
    camera : Plenoptic
        The camera itself.
    sampling : Sampling
        Along x.
    psf : PSF or None
        On the main lens' image.
    crosstalk : float or None
        As `camera_crosstalk`.
    transfer : DepthTransfer or None
        Contrast over depth, as `depth_scan`.
    depth : DepthErrors or None
        Errors of depth, as `depth_scan`.
    picture : Rendered or None
        Of the scene that was given.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> one = clplen.analysis.compare({"macro": camera}, only=["psf"], quick=True)["macro"]
    >>> f"FWHM {one.fwhm() * 1e6:.0f} um, lenslets {one.sampling.spatial_pitch * 1e6:.0f} um"
    'FWHM 101 um, lenslets 100 um'
    """

    name: str
    camera: Plenoptic
    sampling: Sampling
    psf: PSF | None = None
    crosstalk: float | None = None
    transfer: DepthTransfer | None = None
    depth: DepthErrors | None = None
    picture: Rendered | None = None

    def __repr__(self) -> str:
        return f"<Measured {self.name}>"

    def mtf(self, axis: int = 1) -> Curve:
        """Contrast against cycles a metre on the main lens' image, along y (0) or x (1).

        Raises
        ------
        ValueError
            If the point spread function was not measured.
        """
        _, line = self._psf.line_spread(axis)
        return line_curve(line, self._psf.pitch[axis])

    def mtf_cutoff(self, axis: int = 1) -> float:
        """Cut-off of `mtf`, cycles a metre, as `Curve.cutoff`.

        NaN where contrast stays above .01 beyond what diffraction passes: that is no signal, but
        what pixels and their interpolation leave of it.
        """
        found = self.mtf(axis).cutoff()
        mla, passed = self.camera.mla, self.sampling.diffraction_cutoff
        if mla.lattice == "hexagonal" or mla.rotation:  # corners reach farther along the axes
            passed *= circumscribed(mla) / mla.diameter
        return found if found <= HIGHEST * passed else math.nan

    def fwhm(self, axis: int = 1) -> float:
        """`PSF.fwhm` in metres; NaN where the window is too narrow."""
        try:
            return self._psf.fwhm(axis)
        except ValueError:
            return math.nan

    def separations(self) -> Values:
        """For `mid_over_peak`: from 0 to four times the point's width, metres."""
        return np.linspace(0, _WIDTHS * self._width, _STEPS)

    def mid_over_peak(self, separations: Any, axis: int = 1) -> Values:
        """Contrast of two incoherent points, as `TwoPoints.contrast`; NaN beyond the window."""
        two = TwoPoints.incoherent(self._psf, axis=axis)
        s = np.asarray(separations, np.float64)
        known = (s > 0) & (s <= two.reach / 1.5)
        found = np.where(s == 0, 1.0, np.nan)
        if known.any():
            found[known] = two.contrast(s[known])
        return found

    def two_point_limit(self, axis: int = 1) -> float:
        """The least separation in metres with mid/peak of 8/pi^2, two square lenslets' Rayleigh.

        NaN where the window is too narrow to find it.
        """
        try:
            return TwoPoints.incoherent(self._psf, axis=axis).rayleigh(SLIT)
        except ValueError:
            return math.nan

    def encircled(self) -> tuple[Values, Values]:
        """Radii in metres, to four times the point's width, and shares of the window's energy."""
        near = self._near
        centre = near.centroid()
        reach = min(n // 2 * d for n, d in zip(near.values.shape, near.pitch, strict=True))
        radii = np.linspace(0, min(_WIDTHS * self._width, 0.98 * reach), _STEPS)
        shares = near.encircled_energy(radii, centre=centre, total=self._psf.energy)
        return radii, np.asarray(shares, np.float64)

    def radius(self, share: float) -> float:
        """Radius in metres of the circle with a share of the window's energy; NaN where unknown."""
        radii, shares = self.encircled()
        past = np.flatnonzero(shares >= share)
        if not past.size or past[0] == 0:
            return math.nan
        k = slice(int(past[0]) - 1, int(past[0]) + 1)
        return float(np.interp(share, shares[k], radii[k]))

    def strehl(self) -> float:
        """Peak over that of the main lens alone, for equal energy.

        Without aberrations the latter is pi D^2/(4 lam^2 F^2) for an energy of 1 (Born and Wolf
        1999, section 8.5.2): what lenslets and pixels leave of the main lens' resolution.
        """
        c = self.camera
        alone = np.pi / 4 * (c.aperture_diameter / (c.wavelength * c.image_distance)) ** 2
        return float(self._psf.peak / self._psf.energy / alone)

    @property
    def _psf(self) -> PSF:
        if self.psf is None:
            raise ValueError(
                f"The point spread function of {self.name!r} was not measured: ask for 'psf'."
            )
        return self.psf

    @property
    def _width(self) -> float:
        """The larger FWHM, or a quarter of the window where there is none."""
        sides = zip(self._psf.values.shape, self._psf.pitch, strict=True)
        least = min(n * d for n, d in sides) / (2 * _WIDTHS)
        return float(np.nanmin([least, np.nanmax([self.fwhm(0), self.fwhm(1), 0.0]) or least]))

    @property
    def _near(self) -> PSF:
        """The middle of the window, half as far again as the radii go."""
        psf, centre = self._psf, self._psf.centroid()
        half = [math.ceil(1.5 * _WIDTHS * self._width / d) for d in psf.pitch]
        at = [
            round((c - first) / d)
            for c, first, d in zip(centre, (psf.grid.y[0], psf.grid.x[0]), psf.pitch, strict=True)
        ]
        room = [min(h, i, n - 1 - i) for h, i, n in zip(half, at, psf.values.shape, strict=True)]
        return psf.cut(centre, (2 * room[0] + 1, 2 * room[1] + 1))


ANALYSES = (
    "sampling",
    "psf",
    "mtf",
    "two-points",
    "strehl",
    "energy",
    "crosstalk",
    "transfer",
    "depth",
    "pictures",
)
OF_PSF = ("psf", "mtf", "two-points", "strehl", "energy")
OVER_DEPTH = ("transfer", "depth")
QUICK = 3  # places of a point below a lenslet, in place of `PLACES`
_CLOSE = 0.5  # of a name that is meant, as difflib counts

Progress = Callable[[int, int], Any]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(OneLine):
    """Cameras measured alike. Made by `compare`.

    Attributes
    ----------
    cameras : tuple of Measured
        In the order in which they were given.
    analyses : tuple of str
        What was asked for, out of `ANALYSES`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> found = clplen.analysis.compare({"macro": camera}, only=["crosstalk"])
    >>> found.analyses, f"{found['macro'].crosstalk:.3f}"
    (('crosstalk',), '0.032')
    """

    cameras: tuple[Measured, ...]
    analyses: tuple[str, ...]

    def __getitem__(self, name: str) -> Measured:
        """What was measured of the camera of this name."""
        for one in self.cameras:
            if one.name == name:
                return one
        raise KeyError(f"no camera {name!r}; there are {', '.join(c.name for c in self.cameras)}")


def compare(
    cameras: Mapping[str, Plenoptic],
    *,
    only: Iterable[str] | None = None,
    depths: Sequence[float] | Values | None = None,
    scenes: Mapping[str, Any] | None = None,
    quick: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Measure plenoptic cameras in the same way: resolution, samples, crosstalk, depth.

    What is simulated for each camera: `camera_psf` (15 exposures of a point by a 1.0 camera whose
    array is its own mirror image, 81 by another one, 4 by a 2.0 camera), `camera_crosstalk` (1),
    `depth_scan` (3 for each depth), and its scene.

    Parameters
    ----------
    cameras : mapping of str to Plenoptic
        By name, 1.0 and 2.0.
    only : iterable of str, optional
        Out of `ANALYSES`; default all, "pictures" where there are scenes.
    depths : array_like, optional
        Values of dz in metres, shape (n,), from the focused plane, farther positive; default seven
        from -15 to 15 % of the first camera's object distance.
    scenes : mapping of str to scene, optional
        For "pictures", what each camera looks at, as `Plenoptic.expose` takes it.
    quick : bool
        Fewer places below a lenslet, 3 for 9, and three depths.
    progress : callable, optional
        Called as ``progress(done, total)`` for exposures.

    Returns
    -------
    Comparison
        What was measured of each camera, in the order of ``cameras``.

    Raises
    ------
    ValueError
        If there is no camera, an analysis is unknown (with the nearest known one), "pictures" is
        asked for without a scene for every camera, or a depth cannot be.
    TypeError
        If they are no mapping of names to cameras.
    SamplingError, DeviceError
        As `Plenoptic.expose`.

    Examples
    --------
    >>> def macro(pixels):
    ...     return clplen.PlenopticCamera.type1(
    ...         focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...         mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=pixels)
    >>> cameras = {"coarse": macro(19), "fine": macro(27)}
    >>> found = clplen.analysis.compare(cameras, only=["sampling", "crosstalk"])
    >>> {one.name: (round(one.sampling.views), round(one.crosstalk, 2)) for one in found.cameras}
    {'coarse': (19, 0.03), 'fine': (27, 0.03)}
    """
    _require_cameras(cameras)
    wanted = _wanted(only, cameras, scenes)
    if scenes is not None and "pictures" in wanted:
        for name, camera in cameras.items():
            with prefix_errors(name):
                _check_scene(camera, scenes[name])
    if depths is None:
        depths = default_depths(next(iter(cameras.values())), quick=quick)
    plan = _Plan(wanted, real_array(depths, "depths", np.float64), QUICK if quick else PLACES)
    total = sum(plan.exposures(camera) for camera in cameras.values())
    count = 0

    def done(more: int) -> None:
        nonlocal count
        count += more
        if progress is not None:
            progress(count, total)

    found = []
    for name, camera in cameras.items():
        with prefix_errors(name):
            scene = None if scenes is None else scenes.get(name)
            found.append(plan.measure(name, camera, scene, done))
    return Comparison(tuple(found), wanted)


@contextmanager
def prefix_errors(name: str) -> Iterator[None]:
    """Put the name of a camera before what is said about it."""
    try:
        yield
    except (ValueError, SamplingError) as error:
        raise type(error)(f"{name}: {error}") from error


def check_analyses(names: Iterable[str]) -> tuple[str, ...]:
    """These names, in the order of `ANALYSES`."""
    asked = list(names)
    for name in asked:
        if name not in ANALYSES:
            near = difflib.get_close_matches(name, ANALYSES, 1, _CLOSE)
            meant = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"There is no analysis {name!r} of {', '.join(ANALYSES)}.{meant}")
    if not asked:
        raise ValueError(f"Name at least one analysis of {', '.join(ANALYSES)}.")
    return tuple(name for name in ANALYSES if name in asked)


def _require_cameras(cameras: Any) -> None:
    if not isinstance(cameras, Mapping):
        raise TypeError(f"Cameras are given as {{name: camera}}, not as {type(cameras).__name__}.")
    if not cameras:
        raise ValueError("A comparison needs at least one camera.")
    for name, camera in cameras.items():
        if not isinstance(camera, Plenoptic):
            raise TypeError(
                f"{name}: a camera is PlenopticCamera.type1(...) or type2(...), not "
                f"{type(camera).__name__}."
            )


def _wanted(
    only: Iterable[str] | None, cameras: Mapping[str, Plenoptic], scenes: Mapping[str, Any] | None
) -> tuple[str, ...]:
    missing = [name for name in cameras if name not in (scenes or {})]
    if only is None:
        return tuple(name for name in ANALYSES if name != "pictures" or not missing)
    wanted = check_analyses(only)
    if "pictures" in wanted and missing:
        raise ValueError(f"For 'pictures' give a scene of every camera; {missing[0]!r} has none.")
    return wanted


def _check_scene(camera: Plenoptic, scene: Any) -> None:
    """Refuse a scene that a camera cannot show, before anything is simulated."""
    for part in as_sources(scene):
        camera.check_scene(part if isinstance(part, PointSources) else part.corners())


@dataclass(frozen=True)
class _Plan:
    """What is done with every camera."""

    wanted: tuple[str, ...]
    depths: Values
    places: int

    def exposures(self, camera: Plenoptic) -> int:
        return (
            self._asks(OF_PSF) * psf_exposures(camera, self.places)
            + self._asks(("crosstalk",))
            + self._asks(OVER_DEPTH) * len(self.depths) * DEPTH_PLACES
            + self._asks(("pictures",))
        )

    def measure(self, name: str, camera: Plenoptic, scene: Any, done: Done) -> Measured:
        psf = light = picture = None
        transfer, depth = None, None
        sampling = sampling_of(camera)
        if self._asks(OF_PSF):
            psf = camera_psf(camera, places=self.places, done=done)
        if self._asks(("crosstalk",)):
            light = camera_crosstalk(camera)
            done(1)
        if self._asks(OVER_DEPTH):
            transfer, depth = depth_scan(
                camera,
                self.depths,
                transfer="transfer" in self.wanted,
                errors="depth" in self.wanted,
                done=done,
            )
        if self._asks(("pictures",)):
            picture = native_picture(camera.expose(scene))
            done(1)
        return Measured(name, camera, sampling, psf, light, transfer, depth, picture)

    def _asks(self, names: Sequence[str]) -> bool:
        return any(name in self.wanted for name in names)
