"""Light-field microscope: lenslets on the native image plane of an objective with tube lens.

Levoy, Ng, Adams, Footer and Horowitz 2006, "Light field microscopy"; wave optics after Broxton et
al. 2013, "Wave optics theory and 3-D deconvolution for the light field microscope". The image side
is telecentric: sub-images are centred under their lenslets, and a ray from z meets the array at

    x = M x0 + (M^2 z/n) theta,

so that there is no F and no alpha: a plane has the disparity d = -M^2 z dx/(n f_mu p).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import pyopencl.array as cla

from clplen.cameras.description import Described, Description, Row
from clplen.cameras.exposure.local_exposure import add_windows, batches, window_samples
from clplen.cameras.exposure.source_images import (
    DeviceImages,
    images_on_patches,
    window_images,
)
from clplen.cameras.optics.lenslet_camera import (
    Kind,
    LensletCamera,
    check_lenslets,
    lenslet_grid,
    lenslet_pixels,
    require_lengths,
    sensor_grid,
)
from clplen.cameras.optics.local_window import (
    BAND,
    NUMBERS,
    ORDERS,
    RINGS,
    TRANSITION,
    Windows,
    WindowShape,
)
from clplen.cameras.optics.objective import (
    APODISATION,
    CoverGlass,
    Objective,
    check_objective,
    check_positions,
    fast_length,
    fluorescent_lines,
    fluorescent_points,
)
from clplen.cameras.optics.objective_camera import ObjectiveCamera
from clplen.cameras.optics.pixel_array import PixelArray, PixelSums
from clplen.cameras.optics.pupil_aberration import PupilAberration
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.checks import real_array
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.compute.fft.lines import smooth_length
from clplen.errors import SamplingError, SamplingWarning, warn_caller
from clplen.lightfield.depth.best_focus import focus_ratio, focus_ratio_of_disparity
from clplen.lightfield.raw.raw_image import Exposure, RawImage, Sensor
from clplen.progress import notebook_bar
from clplen.units import metres
from clplen.wave.coherence.averaging import Checkpoint, Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid
from clplen.wave.spectrum.spectrum_tables import check_wavelength

Vector = np.ndarray[Any, Any]

GUARD_LENSLETS = 2  # lenslets of light around the geometrical blur
MAX_MISMATCH = 0.1  # relative difference of the f-numbers above which a SamplingWarning is issued
SPARROW_FACTOR = 0.47  # Sparrow's resolution limit of the objective, in lam/NA
Law = Literal["paraxial", "sharpest", "marginal"]
LAWS = get_args(Law)


@dataclass(frozen=True, repr=False)
class Microscope(Described, ObjectiveCamera, LensletCamera):
    """Light-field microscope, built by `PlenopticCamera.microscope`.

    Attributes
    ----------
    kind : str
        "microscope".
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    mla : MicrolensArray
        Lenslets with pitch, focal length, count, lattice, fill, offset and rotation.
    wavelength : float
        Wavelength in vacuum, in metres.
    pixels_per_lenslet : float
        Lenslet pitch over pixel pitch; may be fractional.
    pixel_pitch : float
        Pitch of the pixels in metres.
    grid : Grid
        Grid of the sensor and of the native plane.
    device : Device
        Device of the simulation.
    cover : CoverGlass or None
        Cover glass that differs from the design of the objective.
    apodisation : float
        Exponent e of the amplitude cos(theta)^e over the pupil.
    pixels : PixelArray or None
        Pixels that integrate; None if each pixel samples the intensity in its middle.
    pupil : PupilAberration or None
        Aberrations of objective and sample; None for an ideal pupil.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=20, na=0.5, wavelength=525e-9, pixels_per_lenslet=25,
    ...     mla=clplen.MicrolensArray(125e-6, 2.5e-3, count=3, fill="full"))
    >>> f"{camera.disparity(-10e-6):.3f} lenslets a pixel, 10 um nearer"
    '0.064 lenslets a pixel, 10 um nearer'
    >>> raw = camera.expose(clplen.PointSources((0, 0, -10e-6)))
    >>> raw.shape
    (75, 75)
    """

    kind: ClassVar[Kind] = "microscope"
    telecentric: ClassVar[bool] = True

    magnification: float
    na: float
    medium_index: float
    tube_lens: float
    mla: MicrolensArray
    wavelength: float
    pixels_per_lenslet: float
    pixel_pitch: float
    grid: Grid
    device: Device
    cover: CoverGlass | None = None
    apodisation: float = APODISATION
    pixels: PixelArray | None = None
    pupil: PupilAberration | None = None

    def __repr__(self) -> str:
        return (
            f"<{type(self).__name__} {self.magnification:g}x/{self.na:g}, {self._sensor}, "
            f"{metres(self.wavelength)}, {self.device.name}>"
        )

    @property
    def sensor_distance(self) -> float:
        """Distance f_mu from the array to the sensor, in metres."""
        return self.mla.focal_length

    def array_transmission(
        self, grid: Grid, *, rim: tuple[float, float] | None = None
    ) -> cla.Array:
        """Compute the transmission of the array on a grid of any origin, shape of the grid."""
        return self.mla.transmission(grid, self.wavelength, self.device, rim=rim)

    @property
    def objective(self) -> Objective:
        """Objective with its tube lens and the aberrations of the pupil."""
        return replace(super().objective, aberration=self.pupil)

    @property
    def focal_length(self) -> float:
        """Focal length of the objective in metres: tube lens over magnification."""
        return self.tube_lens / self.magnification

    @property
    def object_distance(self) -> float:
        """Distance n f from native plane to front principal plane of the objective, in metres."""
        return self.medium_index * self.focal_length

    @property
    def image_distance(self) -> float:
        """Focal length of the tube lens in metres: distance from it to the pupil and the array."""
        return self.tube_lens

    @property
    def aperture_diameter(self) -> float:
        """Diameter 2 NA f of the objective's back pupil by the sine condition, in metres."""
        return 2 * self.na * self.focal_length

    @property
    def matched(self) -> float:
        """Image-side f-number of the objective over that of a lenslet, M/(2 NA) d/f_mu."""
        return self.magnification / (2 * self.na) * self.mla.diameter / self.mla.focal_length

    def alpha(self, dz: Any) -> Any:
        """Return NaN, because the exit pupil is at infinity; see `disparity`."""
        return _as_given(np.full(np.shape(dz), np.nan))

    def dz(self, alpha: Any) -> Any:
        """Return NaN, because the exit pupil is at infinity; see `z`."""
        return _as_given(np.full(np.shape(alpha), np.nan))

    def disparity(self, dz: Any, *, law: Law = "paraxial") -> Any:
        """Compute d = -M^2 dz dx/(n f_mu p), in lenslets a pixel of a sub-image; nearer is larger.

        Parameters
        ----------
        dz : float or array_like
            Distance from the native plane in metres, farther positive.
        law : {"paraxial", "sharpest", "marginal"}
            "paraxial": the formula above (Levoy et al. 2006). "marginal": rays of the rim, n/
            sqrt(n^2 - NA^2) times as much: a ray at theta meets the array at M z tan(theta) and
            leaves it by the sine condition. "sharpest": best focus of all rays, between the
            two; `clplen.lightfield.focus_ratio` times as much as "paraxial".

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            If ``law`` has another value.
        """
        distance = real_array(dz, "dz", np.float64)
        return _as_given(
            -distance * self._ratio(law, distance, focus_ratio) / self._depth_of_disparity
        )

    def z(self, disparity: Any, *, law: Law = "paraxial") -> Any:
        """Compute the distance from the native plane in metres, the inverse of `disparity`.

        Parameters
        ----------
        disparity : float or array_like
            Disparity in lenslets a pixel of a sub-image.
        law : {"paraxial", "sharpest", "marginal"}
            Law of `disparity`: "sharpest" for a disparity measured by sharpness, "marginal" for a
            disparity of the outermost views.

        Returns
        -------
        float or numpy.ndarray

        Raises
        ------
        ValueError
            If ``law`` has another value.
        """
        values = real_array(disparity, "disparity", np.float64)
        ratio = self._ratio(law, values, focus_ratio_of_disparity)
        return _as_given(-values * self._depth_of_disparity / ratio)

    def _ratio(
        self, law: str, values: Vector, focus_ratio_of: Callable[[Any, float], float]
    ) -> Vector:
        """Return disparity over paraxial disparity, for each number."""
        if law not in LAWS:
            raise ValueError(f"law must be one of {', '.join(map(repr, LAWS))}, got {law!r}.")
        if law == "paraxial":
            return np.ones(values.shape)
        if law == "marginal":
            cosine = math.sqrt(1 - (self.na / self.medium_index) ** 2)
            return np.full(values.shape, 1 / cosine)
        ratios = [
            focus_ratio_of(self, float(value)) if np.isfinite(value) else 1.0
            for value in values.ravel()
        ]
        return np.array(ratios).reshape(values.shape)

    @property
    def _depth_of_disparity(self) -> float:
        """abs(z) of d = 1 in metres, n f_mu p/(M^2 dx)."""
        scale = self.medium_index / (self.magnification * self.magnification)
        return scale * self.mla.focal_length * self.mla.pitch / self.pixel_pitch

    def describe(self) -> Description:
        """Return the derived parameters as a `Description`."""
        M, n, lam, d = self.magnification, self.medium_index, self.wavelength, self.mla.diameter
        sparrow, views = self.sparrow, self.resolvable
        depth = lam * n / self.na**2
        ny, nx = self.grid.shape
        close = abs(self.matched - 1) <= MAX_MISMATCH
        rows = (
            Row("magnification", M, "", f"tube lens {self.tube_lens * 1e3:g} mm"),
            Row("numerical aperture", self.na, "", f"in a medium of index {n:g}"),
            Row("objective focal length", self.focal_length, "m", "tube lens/M"),
            Row("pupil", self.aperture_diameter, "m", "2 NA f, back pupil of the objective"),
            Row("image f-number", M / (2 * self.na), "", "M/(2 NA)"),
            Row("lenslet f-number", self.mla.focal_length / d, "", "f_mu/d; equal if matched"),
            Row("match", self.matched, "", "matched" if close else "not matched: sub-images "
                + ("overlap" if self.matched < 1 else "are smaller than their cells")),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", self.mla.pitch, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            Row("lenslet focal length", self.mla.focal_length, "m", "f_mu, array to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("field of view", nx * self.pixel_pitch / M, "m", "across, in the medium"),
            Row("lateral resolution", d / M, "m", "d/M, of one lenslet at the native plane"),
            Row("Sparrow limit", sparrow, "m", "0.47 lam/NA, of the objective"),
            Row("resolvable views", views, "", "N_u = d/(M 0.47 lam/NA), across"),
            Row("depth of field", depth, "m", "lam n/NA^2, of the objective"),
            Row("light-field range", self.depth_range, "m",
                "(2 + N_u^2) lam n/(2 NA^2), depth of field of one view"),
            Row("band limit from", self.native_zone, "m",
                "abs(z) from which nu(z) = d/(0.94 lam M abs(z)) is the finest detail"),
            Row("disparity", self.disparity(-1e-6), "", "lenslets a pixel at z = -1 um"),
        )  # fmt: skip
        return Description("Light-field microscope", rows)

    @property
    def sparrow(self) -> float:
        """Sparrow limit 0.47 lam/NA in metres."""
        return SPARROW_FACTOR * self.wavelength / self.na

    @property
    def resolvable(self) -> float:
        """Independent views across, N_u = d/(M 0.47 lam/NA) (Levoy et al. 2006, eq. 3)."""
        return self.mla.diameter / (self.magnification * self.sparrow)

    @property
    def depth_range(self) -> float:
        """Depth (2 + N_u^2) lam n/(2 NA^2) about the native plane in metres (Levoy et al. 2006)."""
        return (2 + self.resolvable**2) * self.wavelength * self.medium_index / (2 * self.na**2)

    @property
    def native_zone(self) -> float:
        """Distance d^2/(2 M^2 lam) in metres within which detail is lost between lenslets."""
        return self.mla.diameter**2 / (2 * self.magnification**2 * self.wavelength)

    def band_limit(self, z: Any) -> Any:
        """Compute nu(z) = d/(0.94 lam M abs(z)) in cycles a metre (Broxton et al. 2013, eq. 5).

        Parameters
        ----------
        z : float or array_like
            Distance from the native plane in metres.

        Returns
        -------
        float or numpy.ndarray
            Band limit in the medium; NaN nearer to the native plane than `native_zone`.
        """
        distance = np.abs(np.asarray(z, np.float64))
        with np.errstate(divide="ignore"):
            limit = self.mla.diameter / (
                2 * SPARROW_FACTOR * self.wavelength * self.magnification * distance
            )
        return _as_given(np.where(distance >= self.native_zone, limit, np.nan))

    @notebook_bar("exposing")
    def expose(
        self,
        scene: PointSources | Sequence[Any],
        *,
        coherence: Coherence | None = None,
        sensor: Sensor | None = None,
        progress: Progress | None = None,
        koehler: bool = True,
        snapshots: int | None = None,
        rtol: float | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> RawImage:
        """Take a raw image of incoherent points, such as beads.

        Parameters
        ----------
        scene : PointSources or list of them
            (x, y, dz) from the axis point of the native plane, in the medium; their image lies at
            (M x, M y). `clplen.microscopy.reconstruction.projector` is faster for a volume.
        coherence : Coherence, optional
            Spectrum of the fluorescence, without a spatial model.
        sensor : Sensor, optional
            Model of photons, noise and bits; None keeps units of energy.
        progress : callable, optional
            Function called as ``progress(done, total)`` after each batch of points.
        koehler, snapshots, rtol, checkpoint
            Options for slides, for the signature of `Plenoptic.expose`; a microscope exposes no
            slides.

        Returns
        -------
        RawImage
            float32, shape of ``grid``; ``power`` is the energy of a point in the pupil. The raw
            image holds the part of it that falls on the array.

        Raises
        ------
        SamplingError
            If a point is imaged beyond the array.
        ValueError
            If ``coherence`` has a spatial model, options for slides are given, or a point is more
            than 0.1 m away.
        TypeError
            If the scene does not consist of points.
        DeviceError
            If the fields do not fit the device.
        """
        parts = fluorescent_points(scene, "clplen.microscopy.reconstruction.projector")
        if {snapshots, rtol, checkpoint} != {None}:
            raise ValueError(
                "snapshots, rtol and checkpoint apply to slides only: leave them out for points."
            )
        total = np.zeros(self.grid.shape)
        transforms: list[tuple[int, tuple[int, int]]] = []
        for wavelength, share in self.lines(coherence):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                window = camera.window(points)  # raises for points beyond the array
                if self.pixels is not None:
                    total += share * camera._window_energy(points, transforms, progress)
                    continue
                total += share * camera._sensor_energy(points, window, progress)
                transforms.append((3 * len(points), window.shape))
        if self.pixels is not None:
            total = self.pixels.read(total)
        data = self.device.upload(total.astype(np.float32))
        route = "points" if self.pixels is None else "local"
        raw = replace(self.raw_image(data), exposure=Exposure(route, tuple(transforms), 0.0))
        return raw if sensor is None else sensor.record(raw)

    def lines(self, coherence: Coherence | None) -> Sequence[tuple[float, float]]:
        """Return wavelengths and their fractions of the energy."""
        lines = fluorescent_lines(coherence, self.wavelength)
        if coherence is not None and self.pixels is None:
            for wavelength, _ in lines:
                _check_sampling(replace(self, wavelength=wavelength))
        return lines

    def _sensor_energy(
        self, points: PointSources, window: Grid, progress: Progress | None
    ) -> Vector:
        """Compute the energy on the sensor's pixels, in the device's precision."""
        total = self.energies(points, window, progress)
        rows, columns = (
            slice((big - n) // 2, (big - n) // 2 + n)
            for big, n in zip(window.shape, self.grid.shape, strict=True)
        )
        return np.asarray(total[rows, columns])

    def _window_energy(
        self,
        points: PointSources,
        transforms: list[tuple[int, tuple[int, int]]],
        progress: Progress | None,
    ) -> Vector:
        """Compute the energy on pixels that integrate, in a window for each point."""
        total = self.device.zeros(self.grid.shape, self.device.real)
        done = 0
        for indices, windows in self._windows(points):
            add_windows(windows, points.power[indices], total)
            samples = windows.shape.samples
            transforms.append((3 * len(indices), (samples, samples)))
            done += len(indices)
            if progress is not None:
                progress(done, len(points))
        return self.device.download(total).astype(np.float64)

    def _windows(self, points: PointSources) -> Iterator[tuple[list[int], MicroscopeWindows]]:
        """Yield indices and windows of points in batches of equal shape."""
        shapes = [_window_shape(self, position, points.diameter) for position in points.positions]
        for indices in batches(shapes, self.device):
            yield indices, MicroscopeWindows.of(self, shapes[indices[0]], points.chosen(indices))

    def sensor_fields(
        self,
        points: PointSources,
        window: Grid | None = None,
        *,
        factor: Vector | None = None,
    ) -> Field:
        """Compute fields of points on the sensor, each of energy 1 in the pupil.

        The periodic ``window`` about the axis must hold all light, shape (n, ny, nx). ``factor``
        has the meaning of `Objective.fields`.
        """
        window = self.window(points) if window is None else window
        at_array = self.objective.fields(points, window, self.device, factor=factor)
        behind = self.mla.apply(at_array, aliasing="allow")  # sampling is checked with the camera
        return self.to_sensor(window, self.sensor_distance)(behind)

    def window(self, points: PointSources) -> Grid:
        """Return the smallest extension of the sensor's grid that holds the blur of points."""
        check_positions(points.positions)
        images = np.abs(points.positions[:, 1::-1]) * self.magnification  # (y, x)
        half = np.asarray(self.grid.extent) / 2
        if (images > half).any():
            x, y, z = points.positions[(images > half).any(axis=1)][0]
            raise SamplingError(
                f"The point (x, y, dz) = ({x:g}, {y:g}, {z:g}) m is imaged at "
                f"({x * self.magnification:g}, {y * self.magnification:g}) m, beyond the array of "
                f"{2 * half[1]:g} x {2 * half[0]:g} m: move it or use more lenslets."
            )
        blur = self.objective.blur(points.positions[:, 2])[:, None]
        blur += self.magnification * points.diameter / 2
        reach = (images + blur + GUARD_LENSLETS * self.mla.pitch).max(axis=0)
        shape = tuple(
            n if 2 * r <= n * self.pixel_pitch else fast_length(n, 2 * r / self.pixel_pitch)
            for n, r in zip(self.grid.shape, reach, strict=True)
        )
        return Grid((shape[0], shape[1]), self.grid.pitch, origin=self.grid.origin)

    def raw_image(self, data: cla.Array) -> RawImage:
        """Return a RawImage of intensities on the sensor with the positions of its sub-images."""
        step = self.pixel_pitch * self.tube_lens / self.mla.focal_length  # du on the pupil
        lenslets = lenslet_grid(self, 1.0)
        spacing = (-step, -step, self.mla.row_pitch, self.mla.pitch)
        return RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets, spacing, self)


def microscope(
    *,
    magnification: float,
    na: float,
    mla: MicrolensArray,
    wavelength: float,
    pixels_per_lenslet: float | None = None,
    device: DeviceLike | None = None,
    medium_index: float = 1.0,
    tube_lens: float = 0.200,
    cover: CoverGlass | None = None,
    apodisation: float = APODISATION,
    pixels: PixelArray | None = None,
    pupil: PupilAberration | Mapping[int, float] | None = None,
) -> Microscope:
    """Build a light-field microscope: array on the native image plane, sensor f_mu behind it.

    The objective obeys the sine condition; the image side is telecentric. The camera is matched if
    the f-numbers M/(2 NA) and f_mu/d agree (Levoy et al. 2006).

    Parameters
    ----------
    magnification : float
        Magnification M of objective and tube lens, at least 1.
    na : float
        Numerical aperture, below ``medium_index``.
    mla : MicrolensArray
        Lenslets with pitch, f_mu, count, lattice, fill, offset and rotation. The sensor lies at
        the first of several focal lengths.
    wavelength : float
        Wavelength of the fluorescence in vacuum, in metres.
    pixels_per_lenslet : float, optional
        Lenslet pitch over pixel pitch, at least 2; may be fractional. Not needed if ``pixels`` has
        a pitch.
    device : Device or str, optional
        Device of the simulation; None is ``Device.open()``.
    medium_index : float
        Refractive index of the medium with the specimen, 1 (air) or more.
    tube_lens : float
        Focal length of the tube lens in metres; that of the objective is tube_lens/M.
    cover : CoverGlass, optional
        Cover glass that differs in thickness or index from the design of the objective.
    apodisation : float
        Exponent e of the amplitude cos(theta)^e over the pupil, -1 to 1. It is -1/2 for isotropic
        points behind an objective that obeys the sine condition: the cos^(1/2) sin(theta) of the
        Debye integral over angles (Broxton et al. 2013).
    pixels : PixelArray, optional
        Position of pixels that integrate the light over their area. None: pixels that cover the
        array and sample the intensity in their middle.
    pupil : PupilAberration or mapping of int to float, optional
        Aberrations of objective and sample: Noll's index to metres of path, rms over the pupil.

    Returns
    -------
    Microscope

    Raises
    ------
    ValueError
        If a length or number is outside its range, NA is at or above the index, or lenslets do not
        converge.
    TypeError
        If array, cover glass or pupil has another type.
    SamplingError
        If a lenslet has less than 2 pixels, or pixels that do not integrate cannot sample the
        light.

    Warns
    -----
    SamplingWarning
        If the two f-numbers differ by more than 10 %.
    """
    device = as_device(device)
    require_lengths(wavelength=wavelength, tube_lens=tube_lens)
    check_wavelength(wavelength)
    check_lenslets(mla, wavelength)
    check_objective(magnification, na, medium_index, apodisation, cover)
    _check_converging(mla)
    if pupil is not None and not isinstance(pupil, PupilAberration):
        pupil = PupilAberration(pupil)
    across = lenslet_pixels(mla, pixels_per_lenslet, pixels)
    if pixels is not None:
        mla = pixels.turned(mla)
    grid = sensor_grid(mla, across, pixels)
    camera = Microscope(
        magnification=float(magnification),
        na=float(na),
        medium_index=float(medium_index),
        tube_lens=float(tube_lens),
        mla=mla,
        wavelength=float(wavelength),
        pixels_per_lenslet=float(across),
        pixel_pitch=grid.pitch[1],
        grid=grid,
        device=device,
        cover=cover,
        apodisation=float(apodisation),
        pixels=pixels,
        pupil=pupil,
    )
    if pixels is None:
        _check_sampling(camera)
    if abs(camera.matched - 1) > MAX_MISMATCH:
        warn_caller(
            f"The f-numbers of objective and lenslets differ: M/(2 NA) = "
            f"{magnification / (2 * na):.4g}, f_mu/d = "
            f"{mla.focal_length / mla.diameter:.4g}; sub-images "
            + ("overlap." if camera.matched < 1 else "leave part of their cells dark."),
            SamplingWarning,
        )
    return camera


def _check_converging(mla: MicrolensArray) -> None:
    """Raise for lenslets that do not converge, or differ from each other."""
    if min(mla.focal_lengths) <= 0:
        raise ValueError(
            f"Focal lengths of a microscope's lenslets must be > 0, got {mla.focal_lengths}."
        )
    if mla.map is not None and mla.map.is_per_lenslet:
        raise ValueError(
            "Lenslets of a microscope must be equal, so that its point images repeat: give one map "
            "for all lenslets, not a map for each."
        )


def _check_sampling(camera: Microscope) -> None:
    """Raise if pixels cannot sample the light: NA/(M lam) + d/(2 f_mu lam) < 1/(2 dx)."""
    shortest = min(camera.mla.focal_lengths)
    slope = camera.na / camera.magnification + camera.mla.diameter / (2 * shortest)
    if 2 * camera.pixel_pitch * slope >= camera.wavelength:
        fitting = camera.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / camera.wavelength:.4g} cycles/m "
            f"((NA/M + d/(2 f_mu))/lam), but pixels of {camera.pixel_pitch:.4g} m sample "
            f"{1 / (2 * camera.pixel_pitch):.4g}: use pixels below {fitting:.4g} m "
            f"(pixels_per_lenslet = {math.floor(camera.mla.pitch / fitting) + 1}), a smaller NA, "
            "or pixels that integrate, pixels=PixelArray()."
        )


def _window_shape(optics: Microscope, position: Vector, diameter: float) -> WindowShape:
    """Return the window of a point at (x, y, z) in metres about the native plane."""
    M, lam, mla = optics.magnification, optics.wavelength, optics.mla
    slope = optics.na / M + mla.steepest_slope(lam)
    finer = math.floor(
        2 * (slope + ORDERS * lam / mla.diameter) * optics.pixel_pitch / lam / BAND
    ) + 1  # fmt: skip
    dx = optics.pixel_pitch / finer
    walk = optics.sensor_distance * slope
    blur = float(optics.objective.blur(position[2])) + M * diameter / 2
    half = blur + RINGS * 0.61 * lam * M / optics.na + mla.pitch + walk
    samples = 2 * smooth_length(math.ceil(half / dx))
    middle = 0.5 - slope * dx / lam
    rim = (middle - TRANSITION / 2, middle + TRANSITION / 2)
    return WindowShape(finer, dx, samples, samples, samples, math.ceil(walk / dx), rim)


@dataclass(frozen=True, eq=False)
class MicroscopeWindows(Windows):
    """Windows of points before an objective, whose image side is telecentric."""

    optics: Microscope
    points: PointSources

    @classmethod
    def of(cls, optics: Microscope, shape: WindowShape, points: PointSources) -> MicroscopeWindows:
        """Return the windows of points about the native plane."""
        count = len(points)
        images = points.positions[:, 1::-1] * optics.magnification
        centres = np.rint((images - np.asarray(optics.grid.origin)) / shape.pitch).astype(np.int64)
        none = np.zeros((count, 2))
        return cls(
            optics, shape, np.zeros((count, NUMBERS)), centres, none, none,
            none.astype(np.int64), np.ones(count), points,
        )  # fmt: skip

    def array_fields(self) -> cla.Array:
        """Compute fields on the array before its lenslets, shape (n, samples, samples)."""
        optics, n = self.optics, self.shape.samples
        out = optics.device.empty((len(self.points), n, n), optics.device.complex)
        for number, centre in enumerate(self.centres):
            point = PointSources(self.points.positions[number], diameter=self.points.diameter)
            grid = Grid((n, n), self.shape.pitch, origin=self._origin(centre))
            out[number] = optics.objective.fields(point, grid, optics.device).data[0]
        return out


def microscope_images(camera: Microscope, points: PointSources) -> Iterator[DeviceImages]:
    """Yield images of single points on the pixels, without crosstalk, in batches."""
    if camera.pixels is not None:
        for indices, windows in camera._windows(points):
            yield window_images(indices, windows, *window_samples(windows))
        return
    window = camera.window(points)
    first = [(big - n) // 2 for big, n in zip(window.shape, camera.grid.shape, strict=True)]
    middle = PixelSums((first[0], first[1]), 1, 0.0, (0, 0), camera.grid.shape)
    done = 0
    for batch in camera.batches(points, window):
        indices = list(range(done, done + len(batch)))
        done += len(batch)
        fields = camera.sensor_fields(batch, window).data
        sums, gains = [middle] * len(indices), np.ones(len(indices))
        yield images_on_patches(indices, fields, sums, gains, camera.device)


def _as_given(values: Vector) -> Any:
    """Return a float for a number, an array for an array."""
    return float(values) if np.ndim(values) == 0 else values
