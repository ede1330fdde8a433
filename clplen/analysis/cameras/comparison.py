"""Measurement of one or several plenoptic cameras with the same analyses."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from clplen.analysis.cameras.camera_psf import (
    DEFAULT_POSITIONS,
    DepthTransfer,
    Done,
    camera_psf,
    line_curve,
    psf_exposures,
)
from clplen.analysis.cameras.crosstalk import camera_crosstalk
from clplen.analysis.cameras.depth_scan import (
    DEPTH_POSITIONS,
    DepthErrors,
    default_depths,
    depth_scan,
)
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
from clplen.progress import notebook_bar
from clplen.reprs import OneLine
from clplen.wave.elements.lenslets import circumscribed

MAX_CUTOFF_RATIO = 1.05  # largest valid measured cut-off over the diffraction cut-off
_SAMPLES = 61  # number of separations and of radii
_MAX_WIDTHS = 4  # largest separation and radius, in FWHM


@dataclass(frozen=True, eq=False, repr=False)
class Measured:
    """Measurements of one camera; None for an analysis that was not requested.

    Attributes
    ----------
    name : str
        Name of the camera in `compare`.
    camera : Plenoptic
        The camera itself.
    sampling : Sampling
        Sampling along x.
    psf : PSF or None
        Point spread function on the main lens' image.
    crosstalk : float or None
        Share of light outside the cell, from `camera_crosstalk`.
    transfer : DepthTransfer or None
        Contrast over depth, from `depth_scan`.
    depth : DepthErrors or None
        Errors of depth, from `depth_scan`.
    picture : Rendered or None
        Picture of the camera's scene.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> macro = clplen.analysis.compare({"macro": camera}, only=["psf"], quick=True)["macro"]
    >>> f"FWHM {macro.fwhm() * 1e6:.0f} um, lenslets {macro.sampling.spatial_pitch * 1e6:.0f} um"
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
        """Compute the contrast over frequency on the main lens' image, along y (0) or x (1).

        Raises
        ------
        ValueError
            If the point spread function was not measured.
        """
        _, line = self._psf.line_spread(axis)
        return line_curve(line, self._psf.pitch[axis])

    def mtf_cutoff(self, axis: int = 1) -> float:
        """Return the cut-off of `mtf` in cycles a metre, as `Curve.cutoff`.

        NaN where contrast stays above 0.01 beyond the diffraction limit: it is no signal, but a
        residue of pixels and their interpolation.
        """
        cutoff = self.mtf(axis).cutoff()
        mla, diffraction_limit = self.camera.mla, self.sampling.diffraction_cutoff
        if mla.lattice == "hexagonal" or mla.rotation:  # corners reach farther along the axes
            diffraction_limit *= circumscribed(mla) / mla.diameter
        return cutoff if cutoff <= MAX_CUTOFF_RATIO * diffraction_limit else math.nan

    def fwhm(self, axis: int = 1) -> float:
        """Return `PSF.fwhm` in metres; NaN where the window is too narrow."""
        try:
            return self._psf.fwhm(axis)
        except ValueError:
            return math.nan

    def separations(self) -> Values:
        """Return separations for `mid_over_peak`, from 0 to four point widths, in metres."""
        return np.linspace(0, _MAX_WIDTHS * self._width, _SAMPLES)

    def mid_over_peak(self, separations: Any, axis: int = 1) -> Values:
        """Compute `TwoPoints.contrast` of two incoherent points; NaN beyond the window."""
        two = TwoPoints.incoherent(self._psf, axis=axis)
        s = np.asarray(separations, np.float64)
        is_inside = (s > 0) & (s <= two.reach / 1.5)
        contrast = np.where(s == 0, 1.0, np.nan)
        if is_inside.any():
            contrast[is_inside] = two.contrast(s[is_inside])
        return contrast

    def two_point_limit(self, axis: int = 1) -> float:
        """Return the smallest separation in metres with mid/peak of 8/pi^2 (square lenslets).

        NaN where the window is too narrow.
        """
        try:
            return TwoPoints.incoherent(self._psf, axis=axis).rayleigh(SLIT)
        except ValueError:
            return math.nan

    def encircled(self) -> tuple[Values, Values]:
        """Return radii in metres, up to four point widths, and their shares of the energy."""
        near = self._near
        centre = near.centroid()
        reach = min(n // 2 * d for n, d in zip(near.values.shape, near.pitch, strict=True))
        radii = np.linspace(0, min(_MAX_WIDTHS * self._width, 0.98 * reach), _SAMPLES)
        shares = near.encircled_energy(radii, centre=centre, total=self._psf.energy)
        return radii, np.asarray(shares, np.float64)

    def radius(self, share: float) -> float:
        """Return the radius in metres that encircles a share of the energy; NaN if outside."""
        radii, shares = self.encircled()
        above = np.flatnonzero(shares >= share)
        if not above.size or above[0] == 0:
            return math.nan
        k = slice(int(above[0]) - 1, int(above[0]) + 1)
        return float(np.interp(share, shares[k], radii[k]))

    def strehl(self) -> float:
        """Compute the peak over that of the main lens alone, at equal energy.

        The main lens without aberrations has the peak pi D^2/(4 lam^2 F^2) at an energy of 1 (Born
        and Wolf 1999, section 8.5.2). The ratio shows the loss by lenslets and pixels.
        """
        c = self.camera
        reference_peak = np.pi / 4 * (c.aperture_diameter / (c.wavelength * c.image_distance)) ** 2
        return float(self._psf.peak / self._psf.energy / reference_peak)

    @property
    def _psf(self) -> PSF:
        if self.psf is None:
            raise ValueError(
                f"The point spread function of {self.name!r} was not measured: add 'psf' to only=."
            )
        return self.psf

    @property
    def _width(self) -> float:
        """Larger FWHM in metres, or a quarter of the window where none exists."""
        sides = zip(self._psf.values.shape, self._psf.pitch, strict=True)
        fallback = min(n * d for n, d in sides) / (2 * _MAX_WIDTHS)
        return float(
            np.nanmin([fallback, np.nanmax([self.fwhm(0), self.fwhm(1), 0.0]) or fallback])
        )

    @property
    def _near(self) -> PSF:
        """Middle of the PSF window, half as large again as the largest radius."""
        psf, centre = self._psf, self._psf.centroid()
        half = [math.ceil(1.5 * _MAX_WIDTHS * self._width / d) for d in psf.pitch]
        index = [
            round((c - first) / d)
            for c, first, d in zip(centre, (psf.grid.y[0], psf.grid.x[0]), psf.pitch, strict=True)
        ]
        half_sizes = [
            min(h, i, n - 1 - i) for h, i, n in zip(half, index, psf.values.shape, strict=True)
        ]
        return psf.cut(centre, (2 * half_sizes[0] + 1, 2 * half_sizes[1] + 1))


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
QUICK_POSITIONS = 3  # replaces `DEFAULT_POSITIONS` where ``quick`` is set
_MIN_SIMILARITY = 0.5  # ratio of difflib from which a name is suggested

Progress = Callable[[int, int], Any]


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(OneLine):
    """Measurements of several cameras, as `compare` returns them.

    A camera's name selects its measurements: the attributes ``sampling``, ``psf``, ``crosstalk``,
    ``transfer`` (``dz``, ``curves``, ``mtf50``, ``best``), ``depth`` (``dz``, ``errors``, ``rms``)
    and ``picture``, None if not measured, and the methods ``fwhm()``, ``mtf()``, ``strehl()``,
    ``two_point_limit()``, ``radius(share)``.

    Attributes
    ----------
    cameras : tuple of Measured
        Measurements of each camera, in the order of ``compare``'s mapping.
    analyses : tuple of str
        Names of the analyses, out of `ANALYSES`.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...     mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=19)
    >>> comparison = clplen.analysis.compare({"macro": camera}, only=["crosstalk"])
    >>> comparison.analyses, f"{comparison['macro'].crosstalk:.3f}"
    (('crosstalk',), '0.032')
    """

    cameras: tuple[Measured, ...]
    analyses: tuple[str, ...]

    def __getitem__(self, name: str) -> Measured:
        """Return the measurements of the camera of this name."""
        for measured in self.cameras:
            if measured.name == name:
                return measured
        raise KeyError(
            f"no camera {name!r}; choose among {', '.join(c.name for c in self.cameras)}"
        )


@notebook_bar("comparing cameras")
def compare(
    cameras: Mapping[str, Plenoptic],
    *,
    only: Iterable[str] | None = None,
    depths: Sequence[float] | Values | None = None,
    scenes: Mapping[str, Any] | None = None,
    quick: bool = False,
    progress: Progress | None = None,
) -> Comparison:
    """Measure and compare resolution, sampling, crosstalk and depth error of cameras.

    Each camera takes exposures for `camera_psf` (15 for a 1.0 camera whose array has mirror
    symmetry, 81 for any other 1.0 camera, 4 for a 2.0 camera), `camera_crosstalk` (1),
    `depth_scan` (3 for each depth), and its scene (1).

    Parameters
    ----------
    cameras : mapping of str to Plenoptic
        Cameras by name, 1.0 and 2.0.
    only : iterable of str, optional
        Names out of `ANALYSES`; default all, and "pictures" only with scenes.
    depths : array_like, optional
        Values of dz in metres, shape (n,), from the focused plane, farther positive; default seven
        from -15 to 15 % of the first camera's object distance.
    scenes : mapping of str to scene, optional
        Scene of each camera for "pictures", as `Plenoptic.expose` takes it.
    quick : bool
        True to take 3 positions below a lenslet instead of 9, and three depths.
    progress : callable, optional
        Function that is called as ``progress(done, total)`` after exposures.

    Returns
    -------
    Comparison
        Measurements of each camera, in the order of ``cameras``.

    Raises
    ------
    ValueError
        If the mapping is empty, an analysis is unknown, "pictures" lacks a scene of a camera, or a
        depth is impossible.
    TypeError
        If ``cameras`` is not a mapping of names to cameras.
    SamplingError, DeviceError
        If `Plenoptic.expose` raises it.

    Examples
    --------
    >>> def macro(pixels):
    ...     return clplen.PlenopticCamera.type1(
    ...         focal_length=15e-3, object_distance=30e-3, wavelength=532e-9,
    ...         mla=clplen.MicrolensArray(100e-6, 2e-3, count=7), pixels_per_lenslet=pixels)
    >>> cameras = {"coarse": macro(19), "fine": macro(27)}
    >>> comparison = clplen.analysis.compare(cameras, only=["sampling", "crosstalk"])
    >>> {c.name: (round(c.sampling.views), round(c.crosstalk, 2)) for c in comparison.cameras}
    {'coarse': (19, 0.03), 'fine': (27, 0.03)}
    """
    _require_cameras(cameras)
    analyses = _selected_analyses(only, cameras, scenes)
    if scenes is not None and "pictures" in analyses:
        for name, camera in cameras.items():
            with prefix_errors(name):
                _check_scene(camera, scenes[name])
    if depths is None:
        depths = default_depths(next(iter(cameras.values())), quick=quick)
    plan = _Plan(
        analyses,
        real_array(depths, "depths", np.float64),
        QUICK_POSITIONS if quick else DEFAULT_POSITIONS,
    )
    total = sum(plan.exposures(camera) for camera in cameras.values())
    count = 0

    def done(exposures: int) -> None:
        nonlocal count
        count += exposures
        if progress is not None:
            progress(count, total)

    measurements = []
    for name, camera in cameras.items():
        with prefix_errors(name):
            scene = None if scenes is None else scenes.get(name)
            measurements.append(plan.measure(name, camera, scene, done))
    return Comparison(tuple(measurements), analyses)


@contextmanager
def prefix_errors(name: str) -> Iterator[None]:
    """Prefix errors with the name of the camera."""
    try:
        yield
    except (ValueError, SamplingError) as error:
        raise type(error)(f"{name}: {error}") from error


def check_analyses(names: Iterable[str]) -> tuple[str, ...]:
    """Return these names in the order of `ANALYSES`; raise ValueError for an unknown name."""
    requests = list(names)
    for name in requests:
        if name not in ANALYSES:
            near = difflib.get_close_matches(name, ANALYSES, 1, _MIN_SIMILARITY)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(
                f"There is no analysis {name!r}; choose among {', '.join(ANALYSES)}.{hint}"
            )
    if not requests:
        raise ValueError(f"Name at least one analysis of {', '.join(ANALYSES)}.")
    return tuple(name for name in ANALYSES if name in requests)


def _require_cameras(cameras: Any) -> None:
    if not isinstance(cameras, Mapping):
        raise TypeError(f"cameras must be {{name: camera}}, got {type(cameras).__name__}.")
    if not cameras:
        raise ValueError("cameras must contain at least one camera, got none.")
    for name, camera in cameras.items():
        if not isinstance(camera, Plenoptic):
            raise TypeError(
                f"{name}: the camera must be PlenopticCamera.type1(...) or type2(...), got "
                f"{type(camera).__name__}."
            )


def _selected_analyses(
    only: Iterable[str] | None, cameras: Mapping[str, Plenoptic], scenes: Mapping[str, Any] | None
) -> tuple[str, ...]:
    missing = [name for name in cameras if name not in (scenes or {})]
    if only is None:
        return tuple(name for name in ANALYSES if name != "pictures" or not missing)
    analyses = check_analyses(only)
    if "pictures" in analyses and missing:
        raise ValueError(f"'pictures' needs a scene of every camera; {missing[0]!r} has none.")
    return analyses


def _check_scene(camera: Plenoptic, scene: Any) -> None:
    """Raise before the first exposure if the camera cannot image the scene."""
    for part in as_sources(scene):
        camera.check_scene(part if isinstance(part, PointSources) else part.corners())


@dataclass(frozen=True)
class _Plan:
    """Analyses and sample counts for every camera."""

    analyses: tuple[str, ...]
    depths: Values
    positions: int

    def exposures(self, camera: Plenoptic) -> int:
        return (
            self._includes(OF_PSF) * psf_exposures(camera, self.positions)
            + self._includes(("crosstalk",))
            + self._includes(OVER_DEPTH) * len(self.depths) * DEPTH_POSITIONS
            + self._includes(("pictures",))
        )

    def measure(self, name: str, camera: Plenoptic, scene: Any, done: Done) -> Measured:
        psf = light = picture = None
        transfer, depth = None, None
        sampling = sampling_of(camera)
        if self._includes(OF_PSF):
            psf = camera_psf(camera, positions=self.positions, done=done)
        if self._includes(("crosstalk",)):
            light = camera_crosstalk(camera)
            done(1)
        if self._includes(OVER_DEPTH):
            transfer, depth = depth_scan(
                camera,
                self.depths,
                transfer="transfer" in self.analyses,
                errors="depth" in self.analyses,
                done=done,
            )
        if self._includes(("pictures",)):
            picture = native_picture(camera.expose(scene))
            done(1)
        return Measured(name, camera, sampling, psf, light, transfer, depth, picture)

    def _includes(self, names: Sequence[str]) -> bool:
        return any(name in self.analyses for name in names)
