"""The light-field microscope: lenslets on the native image plane of an objective with tube lens.

Levoy, Ng, Adams, Footer and Horowitz 2006, "Light field microscopy"; wave optics after Broxton et
al. 2013, "Wave optics theory and 3-D deconvolution for the light field microscope". The image side
is telecentric: sub-images are centred under their lenslets, and a ray from z meets the array at

    x = M x0 + (M^2 z/n) theta,

so that there is no F and no alpha: a plane has the disparity d = -M^2 z dx/(n f_mu p).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.cameras import geometry
from clplen.cameras.describe import Description, Row
from clplen.cameras.objective import CoverGlass, Objective
from clplen.cameras.scene import PointSources
from clplen.compute.device import Device
from clplen.compute.lines import smooth_length
from clplen.errors import SamplingError
from clplen.files import PathLike
from clplen.lightfield.raw import Exposure, RawImage
from clplen.lightfield.sensor import Sensor
from clplen.wave.average import Progress
from clplen.wave.checks import average_of
from clplen.wave.coherence import Coherence
from clplen.wave.field import Field, Grid
from clplen.wave.lenslets import MicrolensArray
from clplen.wave.propagation import plan
from clplen.wave.statistics import accumulate

Vector = np.ndarray[Any, Any]

BATCH_BYTES = 2**27  # of fields that travel through the microscope together
GUARD = 2  # lenslets of light around the geometrical blur
MISMATCH = 0.1  # of the two f-numbers that is said aloud
SPARROW = 0.47  # lam/NA, resolution of the objective


@dataclass(frozen=True)
class Microscope:
    """A light-field microscope. Made by `PlenopticCamera.microscope`.

    Attributes
    ----------
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    mla : MicrolensArray
    wavelength : float
        In vacuum, in metres.
    pixels_per_lenslet : float
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor, and of the native plane.
    device : Device
    cover : CoverGlass or None
        Where it is not the one that the objective is made for.
    """

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

    telecentric = True

    @property
    def objective(self) -> Objective:
        """The optics before the array."""
        return Objective(
            self.magnification, self.na, self.medium_index, self.wavelength, self.cover
        )

    @property
    def focal_length(self) -> float:
        """Of the objective in metres, tube lens over magnification."""
        return self.tube_lens / self.magnification

    @property
    def object_distance(self) -> float:
        """Front principal plane of the objective to the native plane, n f, in metres."""
        return self.medium_index * self.focal_length

    @property
    def image_distance(self) -> float:
        """Pupil (front focal plane of the tube lens) to tube lens to array: its f, in metres."""
        return self.tube_lens

    @property
    def aperture_diameter(self) -> float:
        """2 NA f of the objective, its back pupil by the sine condition, in metres."""
        return 2 * self.na * self.focal_length

    @property
    def lenslet_pitch(self) -> float:
        """p in metres."""
        return self.mla.pitch

    @property
    def lenslet_diameter(self) -> float:
        """d in metres."""
        return self.mla.diameter

    @property
    def lenslet_focal_length(self) -> float:
        """f_mu in metres, array to sensor."""
        return self.mla.f

    @property
    def lenslet_fill(self) -> str:
        """Aperture of a lenslet: "circular", a disc, or "full", the cell of the lattice."""
        return self.mla.fill

    @property
    def lenslet_lattice(self) -> str:
        """Lattice of the lenslets, "square" or "hexagonal"."""
        return self.mla.lattice

    @property
    def matched(self) -> float:
        """Image-side f-number of the objective over that of a lenslet, M/(2 NA) d/f_mu."""
        return self.magnification / (2 * self.na) * self.mla.diameter / self.mla.f

    def alpha(self, dz: Any) -> Any:
        """NaN: the exit pupil is at infinity; see `disparity`."""
        return _as_given(np.full(np.shape(dz), np.nan))

    def dz(self, alpha: Any) -> Any:
        """NaN: see `z`."""
        return _as_given(np.full(np.shape(alpha), np.nan))

    def disparity(self, dz: Any) -> Any:
        """d = -M^2 dz dx/(n f_mu p), in lenslets a pixel of a sub-image; nearer is larger.

        Parameters
        ----------
        dz : float or array_like
            In metres from the native plane, farther positive.

        Returns
        -------
        float or numpy.ndarray
        """
        return _as_given(-np.asarray(dz, np.float64) / self._depth_of_disparity)

    def z(self, disparity: Any) -> Any:
        """The inverse of `disparity`, in metres."""
        return _as_given(-np.asarray(disparity, np.float64) * self._depth_of_disparity)

    @property
    def _depth_of_disparity(self) -> float:
        """n f_mu p/(M^2 dx): abs(z) of d = 1."""
        scale = self.medium_index / self.magnification**2
        return scale * self.mla.f * self.mla.pitch / self.pixel_pitch

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
        checkpoint: PathLike | None = None,
    ) -> RawImage:
        """Take a raw image of incoherent points, such as beads.

        Parameters
        ----------
        scene : PointSources or list of them
            (x, y, dz) from the axis point of the native plane, in the medium; their image lies at
            (M x, M y). A whole volume is quicker by `clplen.microscopy.Projector`.
        coherence : Coherence, optional
            Its spectrum is that of the fluorescence; it has no spatial model.
        sensor : Sensor, optional
            Photons, noise, bits; None keeps units of energy.
        progress : callable, optional
            Called as ``progress(done, total)`` after each batch of points.
        koehler, snapshots, rtol, checkpoint
            Of slides, as in `Plenoptic.expose`, so that programs call all cameras alike; a
            microscope exposes none.

        Returns
        -------
        RawImage
            float32, shape of ``grid``; ``power`` of a point is the energy in the pupil, of which
            the raw image holds what falls on the array.

        Raises
        ------
        SamplingError
            If a point is imaged beyond the array.
        ValueError
            If there is a spatial model of coherence, or anything that only slides have.
        TypeError
            If the scene is no points.
        DeviceError
            If the fields do not fit the device.
        """
        parts = [scene] if isinstance(scene, PointSources) else list(scene)
        if not parts or not all(isinstance(one, PointSources) for one in parts):
            raise TypeError(f"A microscope exposes PointSources or a list of them, not {scene!r}.")
        if {snapshots, rtol, checkpoint} != {None}:
            raise ValueError(
                "snapshots, rtol and checkpoint are for slides; fluorescent points have none."
            )
        total = np.zeros(self.grid.shape)
        transforms: list[tuple[int, tuple[int, int]]] = []
        for wavelength, share in self._lines(coherence):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                window = camera.window(points)
                total += share * camera._exposed(points, window, progress)
                transforms.append((3 * len(points), window.shape))
        data = self.device.upload(total.astype(np.float32))
        raw = replace(self.raw_image(data), exposure=Exposure("points", tuple(transforms), 0.0))
        return raw if sensor is None else sensor.record(raw)

    def _lines(self, coherence: Coherence | None) -> Sequence[tuple[float, float]]:
        """Wavelengths and their shares of the energy."""
        if coherence is None:
            return [(self.wavelength, 1.0)]
        average_of(coherence)
        if coherence.spatial is not None:
            raise ValueError(
                "Fluorescent points are incoherent already: leave the spatial model out, "
                "Coherence(None, spectrum)."
            )
        lines = coherence.lines(self.wavelength)
        for wavelength, _ in lines:
            check_sampling(replace(self, wavelength=wavelength))
        return lines

    def _exposed(self, points: PointSources, window: Grid, progress: Progress | None) -> Vector:
        """Energy on the sensor's pixels, in the device's precision."""
        step = self.batch(window)
        total = self.device.zeros(window.shape, self.device.real)
        for start in range(0, len(points), step):
            stop = min(start + step, len(points))
            fields = self.sensor_fields(_chosen(points, slice(start, stop)), window)
            accumulate(total, fields.data, points.power[start:stop], self.device)
            if progress is not None:
                progress(stop, len(points))
        rows, columns = (
            slice((big - n) // 2, (big - n) // 2 + n)
            for big, n in zip(window.shape, self.grid.shape, strict=True)
        )
        return np.asarray(self.device.download(total)[rows, columns])

    def sensor_fields(self, points: PointSources, window: Grid | None = None) -> Field:
        """Fields of points on the sensor, each of energy 1 in the pupil.

        Parameters
        ----------
        points : PointSources
        window : Grid, optional
            Periodic, of the camera's pitch and about the axis, that holds all light; default
            `window`.

        Returns
        -------
        Field
            Shape (n, ny, nx).
        """
        window = self.window(points) if window is None else window
        at_array = self.objective.fields(points, window, self.device)
        behind = self.mla.apply(at_array, aliasing="allow")  # checked with the whole camera
        way = plan(
            window, self.mla.f, wavelength=self.wavelength, method="as", pad=1, device=self.device
        )
        return way(behind)

    def window(self, points: PointSources) -> Grid:
        """The smallest grid about the sensor's that holds the blur of points on the array.

        Raises
        ------
        SamplingError
            If a point is imaged beyond the array.
        """
        places = np.abs(points.positions[:, 1::-1]) * self.magnification  # (y, x)
        half = np.asarray(self.grid.extent) / 2
        if (places > half).any():
            x, y, z = points.positions[(places > half).any(axis=1)][0]
            raise SamplingError(
                f"The point (x, y, dz) = ({x:g}, {y:g}, {z:g}) m is imaged at "
                f"({x * self.magnification:g}, {y * self.magnification:g}) m, beyond the array of "
                f"{2 * half[1]:g} x {2 * half[0]:g} m: move it or use more lenslets."
            )
        blur = self.objective.blur(points.positions[:, 2])[:, None]
        reach = (places + blur + GUARD * self.mla.pitch).max(axis=0)
        shape = tuple(
            n if 2 * r <= n * self.pixel_pitch else wider(n, 2 * r / self.pixel_pitch)
            for n, r in zip(self.grid.shape, reach, strict=True)
        )
        return Grid((shape[0], shape[1]), self.grid.pitch, origin=self.grid.origin)

    def batch(self, window: Grid) -> int:
        """How many fields on a window travel together."""
        nbytes = math.prod(window.shape) * self.device.complex.itemsize
        count = max(1, BATCH_BYTES // nbytes)
        self.device.require_memory(4 * count * nbytes, "This exposure")
        return int(count)

    def raw_image(self, data: cla.Array) -> RawImage:
        """Intensity on the sensor with the places of the sub-images on it.

        Parameters
        ----------
        data : pyopencl.array.Array
            float32, shape of ``grid``.
        """
        step = self.pixel_pitch * self.tube_lens / self.mla.f  # du on the pupil
        lenslets = geometry.lenslet_grid(self, 1.0)
        spacing = (-step, -step, self.mla.row_pitch, self.mla.pitch)
        return RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets, spacing, self)

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
        M, n, lam, d = self.magnification, self.medium_index, self.wavelength, self.mla.diameter
        sparrow, views = self.sparrow, self.resolvable
        depth = lam * n / self.na**2
        ny, nx = self.grid.shape
        close = abs(self.matched - 1) <= MISMATCH
        rows = (
            Row("magnification", M, "", f"tube lens {self.tube_lens * 1e3:g} mm"),
            Row("numerical aperture", self.na, "", f"in a medium of index {n:g}"),
            Row("objective focal length", self.focal_length, "m", "tube lens/M"),
            Row("pupil", self.aperture_diameter, "m", "2 NA f, back pupil of the objective"),
            Row("image f-number", M / (2 * self.na), "", "M/(2 NA)"),
            Row("lenslet f-number", self.mla.f / d, "", "f_mu/d; matched: the same"),
            Row("match", self.matched, "", "matched" if close else "not matched: sub-images "
                + ("overlap" if self.matched < 1 else "are smaller than their cells")),
            Row("lenslets", self.mla.count[1], "", f"a row, {self.mla.count[0]} rows"),
            Row("lenslet pitch", self.mla.pitch, "m", f"{self.pixels_per_lenslet:.6g} pixels"),
            Row("lenslet focal length", self.mla.f, "m", "f_mu, array to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("field of view", nx * self.pixel_pitch / M, "m", "across, in the medium"),
            Row("lateral resolution", d / M, "m", "d/M, of one lenslet at the native plane"),
            Row("Sparrow limit", sparrow, "m", ".47 lam/NA, of the objective"),
            Row("resolvable views", views, "", "N_u = d/(M .47 lam/NA), across"),
            Row("depth of field", depth, "m", "lam n/NA^2, of the objective"),
            Row("light-field range", (2 + views**2) * depth / 2, "m",
                "(2 + N_u^2) lam n/(2 NA^2), depth of field of one view"),
            Row("band limit from", self.native_zone, "m",
                "abs(z) from which nu(z) = d/(.94 lam M abs(z)) is the finest detail"),
            Row("disparity", self.disparity(-1e-6), "", "lenslets a pixel at z = -1 um"),
        )  # fmt: skip
        return Description("Light-field microscope", rows)

    @property
    def sparrow(self) -> float:
        """.47 lam/NA in metres."""
        return SPARROW * self.wavelength / self.na

    @property
    def resolvable(self) -> float:
        """N_u = d/(M .47 lam/NA), independent views across (Levoy et al. 2006, eq. 3)."""
        return self.mla.diameter / (self.magnification * self.sparrow)

    @property
    def native_zone(self) -> float:
        """d^2/(2 M^2 lam) in metres: nearer to the native plane detail is lost between lenslets."""
        return self.mla.diameter**2 / (2 * self.magnification**2 * self.wavelength)

    def band_limit(self, z: Any) -> Any:
        """nu(z) = d/(.94 lam M abs(z)), cycles a metre in the medium (Broxton et al. 2013, eq. 5).

        Parameters
        ----------
        z : float or array_like
            In metres from the native plane.

        Returns
        -------
        float or numpy.ndarray
            NaN nearer to the native plane than `native_zone`.
        """
        distance = np.abs(np.asarray(z, np.float64))
        with np.errstate(divide="ignore"):
            found = self.mla.diameter / (
                2 * SPARROW * self.wavelength * self.magnification * distance
            )
        return _as_given(np.where(distance >= self.native_zone, found, np.nan))


def wider(n: int, least: float) -> int:
    """The next quick length of a transform from ``least`` samples on, even or odd as ``n`` is."""
    length = max(n, math.ceil(least))
    if n % 2 == 0:
        return 2 * smooth_length(-(-length // 2))
    length += 1 - length % 2
    while smooth_length(length) != length:
        length += 2
    return length


def check_sampling(camera: Microscope) -> None:
    """Refuse light that the pixels cannot sample: NA/(M lam) + d/(2 f_mu lam) < 1/(2 dx).

    Raises
    ------
    SamplingError
        With both sides of the rule and what would do.
    """
    slope = camera.na / camera.magnification + camera.mla.diameter / (2 * camera.mla.f)
    if 2 * camera.pixel_pitch * slope >= camera.wavelength:
        fitting = camera.wavelength / (2 * slope)
        raise SamplingError(
            f"Light reaches the sensor at up to {slope / camera.wavelength:.4g} cycles/m "
            f"((NA/M + d/(2 f_mu))/lam), but pixels of {camera.pixel_pitch:.4g} m sample "
            f"{1 / (2 * camera.pixel_pitch):.4g}: pixels below {fitting:.4g} m would do "
            f"(pixels_per_lenslet = {camera.mla.pitch / fitting:.4g}), or a smaller NA."
        )


def _chosen(points: PointSources, which: slice) -> PointSources:
    return PointSources(
        points.positions[which], diameter=points.diameter, power=points.power[which]
    )


def _as_given(values: Vector) -> Any:
    """A float for a number, an array for an array."""
    return float(values) if np.ndim(values) == 0 else values
