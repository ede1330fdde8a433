"""Fourier light-field microscope by waves: objective, field stop, relay, lenslets, sensor.

A point at (x0, y0, z) has on the conjugate pupil, at u, the field

    E(u) = P(u/(lam f_FL)) exp(2 pi i M x0 u/(lam f_FL)),   abs(u) <= NA f_FL/M,

P of `Objective`; the specimen is upright in the sub-images, so that u points against the frequency
of the native image. The field stop multiplies its Fourier transform. Behind the lenslets follows
the angular spectrum over s, for all of them together: sub-images interfere where they meet.

Objective and tube lens form the native image, with the field stop. The relay lens behind it forms
the conjugate pupil, 2 NA f_FL/M wide, on the lenslets. Each lenslet images the specimen from its
angle onto the sensor (Llavador, Sola-Pikabea, Saavedra, Javidi and Martinez-Corral 2016,
"Resolution improvements in integral microscopy with Fourier plane recording"; Scrofani et al.
2018, "FIMic"; Guo, Liu, Hua, Wang and Jia 2019, "Fourier light-field microscopy"). The specimen is
upright in every sub-image. A lenslet centred at c sees it along the rays n sin(theta) = -M c/f_FL,
and a point at (x, y, z) lies in its sub-image at c + M_T (x + z tan(theta)), M_T = M s/f_FL.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import fft

from clplen.cameras.description import Described, Description, Row
from clplen.cameras.optics.lenslet_camera import require_lengths
from clplen.cameras.optics.lenslet_layout import LensletLayout, rim_coverage
from clplen.cameras.optics.objective import (
    APODISATION,
    CoverGlass,
    check_objective,
    check_positions,
    fast_length,
    fluorescent_lines,
    fluorescent_points,
    shift_pupils,
)
from clplen.cameras.optics.objective_camera import ObjectiveCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.checks import is_integer
from clplen.compute.arrays import Image
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.errors import SamplingError, ShapeError
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage, Sensor
from clplen.progress import notebook_bar
from clplen.units import metres
from clplen.wave.coherence.averaging import Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.transmission import multiply, phasor
from clplen.wave.spectrum.spectrum_tables import check_wavelength

Vector = np.ndarray[Any, Any]

MIN_SUB_IMAGE_PIXELS = 8  # minimum pixels of a sub-image
MAX_SENSOR_PIXELS = 2**28  # maximum pixels of a sensor, 1 GiB of float32
MIN_WHOLE_FRACTION = 0.95  # minimum fraction in the pupil of a whole lenslet's aperture
MIN_LIT_FRACTION = 0.02  # minimum fraction in the pupil of the aperture of a lenslet with light
LENSLET_SAMPLES = 128  # samples across a lenslet for its fraction in the pupil
OVERSAMPLING = 4.0  # oversampling of the steepest light, because rims are sharp
WINDOW_MARGIN = 1.15  # size of the window over the size of sensor and array
MAX_WINDOW_SAMPLES = 16384  # maximum samples of a window along an axis
MAX_PIXEL_PARTS = 64  # maximum parts of a pixel along an axis


@dataclass(frozen=True, repr=False)
class FourierMicroscope(Described, ObjectiveCamera):
    """Fourier light-field microscope, built by `PlenopticCamera.fourier_microscope`.

    Its lenslets lie on the conjugate pupil: each sub-image is a view, and its pixels are positions
    in the specimen. Its frames are pictures, not raw images of a light field.

    Attributes
    ----------
    kind : str
        "fourier_microscope".
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    relay : float
        f_FL, focal length of the relay (Fourier) lens in metres.
    lenslets : LensletLayout
        Positions, focal lengths and apertures of the lenslets.
    sensor_distance : float
        s in metres, from the lenslets to the sensor.
    field_stop : float
        Diameter of the stop on the native image, in metres.
    wavelength : float
        Wavelength in vacuum, in metres.
    pixel_pitch : float
        Pitch in metres of the pixels, which integrate over their area.
    grid : Grid
        Grid of the sensor.
    device : Device
        Device of the simulation.
    cover : CoverGlass or None
        Cover glass that differs from the design of the objective.
    apodisation : float
        Exponent e of the amplitude cos(theta)^e over the pupil.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.5, wavelength=525e-9, relay=0.1, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(1e-3, 30e-3, count=5))
    >>> f"{camera.describe()['lenslets across the pupil']:.0f} across the pupil"
    '5 across the pupil'
    >>> frame = camera.expose(clplen.PointSources((0, 0, 10e-6)))
    >>> frame.shape
    (625, 625)
    """

    kind: ClassVar[str] = "fourier_microscope"

    magnification: float
    na: float
    medium_index: float
    tube_lens: float
    relay: float
    lenslets: LensletLayout
    sensor_distance: float
    field_stop: float
    wavelength: float
    pixel_pitch: float
    grid: Grid
    device: Device
    cover: CoverGlass | None = None
    apodisation: float = APODISATION

    def __post_init__(self) -> None:
        object.__setattr__(self, "device", as_device(self.device))

    def __repr__(self) -> str:
        ny, nx = self.grid.shape
        return (
            f"<{type(self).__name__} {self.magnification:g}x/{self.na:g}, {len(self.lenslets)} "
            f"lenslets of {metres(self.lenslets.diameter)}, {ny} x {nx} pixels, "
            f"{metres(self.wavelength)}, {self.device.name}>"
        )

    @property
    def pupil_diameter(self) -> float:
        """Diameter of the conjugate pupil in metres, 2 NA f_FL/M (Guo et al. 2019)."""
        return 2 * self.na * self.relay / self.magnification

    @property
    def scale(self) -> float:
        """Magnification from specimen to sub-image, M_T = M s/f_FL (Guo et al. 2019)."""
        return self.magnification * self.sensor_distance / self.relay

    @property
    def side(self) -> float:
        """Side of a pixel in the specimen, in metres."""
        return self.pixel_pitch / self.scale

    @property
    def effective_na(self) -> float:
        """Numerical aperture of a lenslet, M d/(2 f_FL) = NA/N (Scrofani et al. 2018)."""
        return self.magnification * self.lenslets.diameter / (2 * self.relay)

    @property
    def lit(self) -> Vector:
        """Fraction of each lenslet's aperture in the pupil, float64, shape (lenslets,)."""
        layout = self.lenslets
        step = 2 * layout.reach / LENSLET_SAMPLES
        t = (np.arange(LENSLET_SAMPLES) - (LENSLET_SAMPLES - 1) / 2) * step
        shape = layout.coverage(t, t, step)
        inside = self.pupil_diameter / 2 - np.hypot(*layout.positions.T)
        fractions = (inside > 0).astype(np.float64)
        for lenslet in np.flatnonzero(np.abs(inside) < layout.reach + step):
            y, x = layout.positions[lenslet]
            rim = self.pupil_diameter / 2 - np.hypot(y + t[:, None], x + t)
            fractions[lenslet] = (shape * rim_coverage(rim, step)).sum() / shape.sum()
        return fractions

    @property
    def sine(self) -> float:
        """sin(theta) of the outermost lenslet with its whole aperture in the pupil, or NaN."""
        positions = self.lenslets.positions[self.lit >= MIN_WHOLE_FRACTION]
        if not len(positions):
            return math.nan
        farthest = float(np.hypot(*positions.T).max())
        return self.magnification * farthest / (self.relay * self.medium_index)

    def displacement(self, z: float) -> Vector:
        """Compute the shift M_T z tan(theta) of every sub-image, by its lenslet's central ray.

        Parameters
        ----------
        z : float
            Distance from the focal plane in metres, farther positive.

        Returns
        -------
        numpy.ndarray
            (y, x) in metres, float64, shape (lenslets, 2); NaN beyond the pupil.
        """
        sines = -self.magnification * self.lenslets.positions / self.relay  # n sin(theta)
        length = np.hypot(*sines.T)
        inside = np.minimum(length, self.na)
        reach = self.objective.landing(inside, z) * self.sensor_distance / self.relay
        along = sines / np.maximum(length, 1e-300)[:, None]
        return np.asarray(along * reach[:, None])

    @property
    def lateral_resolution(self) -> float:
        """Larger of lam N/(2 NA) and two pixels, in metres (Scrofani et al. 2018)."""
        return max(self.wavelength / (2 * self.effective_na), 2 * self.side)

    @property
    def axial_resolution(self) -> float:
        """Smallest resolved distance of two points on the axis, in metres.

        Lateral resolution over tan(theta) of the outermost whole lenslet.
        """
        sine = self.sine
        if not 0 < sine < 1:
            return math.inf if sine == 0 else math.nan
        return self.lateral_resolution * math.sqrt(1 - sine**2) / sine

    @property
    def depth_of_field(self) -> float:
        """Total depth n lam N^2/NA^2 + n N pixel/(NA M_T) in metres (Galdon et al. 2022)."""
        na, n = self.effective_na, self.medium_index
        return n * self.wavelength / na**2 + n * self.side / na

    @property
    def sub_image(self) -> float:
        """Diameter of a sub-image in metres: diameter of the field stop times s/f_FL."""
        return self.field_stop * self.sensor_distance / self.relay

    @property
    def overlap(self) -> float:
        """Overlap of neighbouring sub-images as a fraction of their diameter."""
        return max(0.0, 1 - self.lenslets.spacing / self.sub_image)

    def describe(self) -> Description:
        """Return the derived parameters as a `Description`."""
        M, n, layout = self.magnification, self.medium_index, self.lenslets
        D, d = self.pupil_diameter, layout.diameter
        ny, nx = self.grid.shape
        kinds = np.unique(layout.focal_lengths)
        sine = self.sine
        angle = math.degrees(math.asin(sine)) if sine < 1 else math.nan
        rows = (
            Row("magnification", M, "", f"tube lens {self.tube_lens * 1e3:g} mm"),
            Row("numerical aperture", self.na, "", f"in a medium of index {n:g}"),
            Row("relay focal length", self.relay, "m", "f_FL, Fourier lens"),
            Row("pupil", D, "m", "2 NA f_FL/M, conjugate, where the lenslets lie"),
            Row("lenslets", len(layout), "",
                f"{int((self.lit >= MIN_LIT_FRACTION).sum())} with light, "
                f"{int((self.lit >= MIN_WHOLE_FRACTION).sum())} whole, {layout.fill}"),
            Row("lenslet diameter", d, "m", "d"),
            Row("lenslets across the pupil", D / d, "", "N = D/d (Guo et al. 2019)"),
            Row("lenslet focal length", float(kinds[0]), "m", "f_ML" + ("" if len(kinds) == 1
                else f", the shortest of {len(kinds)}")),
            Row("sensor distance", self.sensor_distance, "m", "s, lenslets to sensor"),
            Row("pixel pitch", self.pixel_pitch, "m", f"sensor {ny} x {nx}"),
            Row("sub-image magnification", self.scale, "", "M_T = M s/f_FL (Guo et al. 2019)"),
            Row("voxel", self.side, "m", "pixel/M_T"),
            Row("field stop", self.field_stop, "m", "diameter, on the native image"),
            Row("field of view", self.field_stop / M, "m", "diameter, in the medium; d f_FL/(f_ML "
                "M) where sub-images touch (Guo et al. 2019)"),
            Row("overlap", self.overlap, "", "of neighbours, over the diameter"),
            Row("effective aperture", self.effective_na, "", "NA/N (Scrofani et al. 2018)"),
            Row("lateral resolution", self.lateral_resolution, "m",
                "max(lam N/(2 NA), 2 pixel/M_T) (Scrofani et al. 2018)"),
            Row("largest view angle", angle, "deg", "n sin(theta) = M c/f_FL, outermost whole "
                "lenslet"),
            Row("axial resolution", self.axial_resolution, "m",
                "lateral resolution over its tan(theta)"),
            Row("depth of field", self.depth_of_field, "m",
                "n lam N^2/NA^2 + n N pixel/(NA M_T), of one sub-image (Galdon et al. 2022)"),
        )  # fmt: skip
        return Description("Fourier light-field microscope", rows)

    @notebook_bar("exposing")
    def expose(
        self,
        scene: PointSources | Sequence[Any],
        *,
        coherence: Coherence | None = None,
        sensor: Sensor | None = None,
        progress: Progress | None = None,
    ) -> Image:
        """Take a frame of incoherent points, such as beads.

        Parameters
        ----------
        scene : PointSources or list of them
            (x, y, dz) from the axis point of the focal plane, in the medium. Points beyond the
            field stop are dark. `clplen.microscopy.FourierProjector` is faster for a volume.
        coherence : Coherence, optional
            Spectrum of the fluorescence, without a spatial model.
        sensor : Sensor, optional
            Model of photons, noise and bits; None keeps units of energy.
        progress : callable, optional
            Function called as ``progress(done, total)`` after each batch of points.

        Returns
        -------
        Image
            float32, shape of ``grid``; ``power`` is the energy of a point in the pupil.

        Raises
        ------
        SamplingError
            If the window that holds the light would be too large.
        ValueError
            If ``coherence`` has a spatial model, or a point is more than 0.1 m away.
        TypeError
            If the scene does not consist of points.
        DeviceError
            If the fields do not fit the device.
        """
        parts = fluorescent_points(scene, "clplen.microscopy.FourierProjector")
        total = np.zeros(self.grid.shape)
        for wavelength, share in fluorescent_lines(coherence, self.wavelength):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                total += share * camera._sensor_energy(points, progress)
        data = self.device.upload(total.astype(np.float32))
        if sensor is not None:
            lenslets = LensletGrid((1, 1), self.grid.shape, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
            raw = RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets)
            data = sensor.record(raw).data
        return Image(data, self.device)

    def _sensor_energy(self, points: PointSources, progress: Progress | None) -> Vector:
        """Compute the energy on the sensor's pixels."""
        check_positions(points.positions)
        window, parts = self.window(points)
        total = self.energies(points, window, progress).astype(np.float64)
        return _pixels(total, self.grid.shape, parts)

    def window(self, points: PointSources) -> tuple[Grid, int]:
        """Return a grid that holds and samples the light of points, and its samples a pixel.

        The samples are counted along an axis.
        """
        reach = self.magnification * np.abs(points.positions[:, :2]).max(axis=1)
        reach += self.objective.blur(points.positions[:, 2])
        min_parts = (
            OVERSAMPLING
            * self.pixel_pitch
            * max(
                2 * self.slope / self.wavelength,
                (float(reach.max()) + self.field_stop / 2)
                / (self.wavelength * self.relay)
                / OVERSAMPLING,
            )
        )
        parts = max(1, math.ceil(min_parts))
        pitch = self.pixel_pitch / parts
        sides = 2 * (np.abs(self.lenslets.positions).max(axis=0) + self.lenslets.reach)
        across = WINDOW_MARGIN * np.maximum(np.array(self.grid.extent), sides)
        shape = [
            parts * fast_length(int(n), side / self.pixel_pitch)
            for n, side in zip(self.grid.shape, across, strict=True)
        ]
        if max(shape) > MAX_WINDOW_SAMPLES or parts > MAX_PIXEL_PARTS:
            raise SamplingError(
                f"Points need a window of {shape[0]} x {shape[1]} samples of {pitch:.3g} m, but "
                f"{MAX_WINDOW_SAMPLES} is the maximum along an axis: move them nearer to the focal "
                "plane, or use a smaller field stop or fewer lenslets."
            )
        origin = [pitch / 2 if n % 2 == 0 else 0.0 for n in shape]
        return Grid((shape[0], shape[1]), pitch, origin=(origin[0], origin[1])), parts

    @property
    def slope(self) -> float:
        """Sine of the steepest light on the sensor: field stop over f_FL and a lenslet over f."""
        focal = float(self.lenslets.focal_lengths.min())
        return self.field_stop / (2 * self.relay) + self.lenslets.reach / focal

    def pupil_fields(self, points: PointSources, window: Grid) -> Field:
        """Compute fields of points on the conjugate pupil, within the field stop.

        Shape (n, ny, nx); each field has the energy 1 before the stop.
        """
        planes, plane = np.unique(points.positions[:, 2], return_inverse=True)
        pupils = np.stack([
            self.pupil(window.y, window.x, z, diameter=points.diameter) for z in planes
        ])  # fmt: skip
        rim = np.maximum(self.rim(window.y, window.x), 1e-300)  # a share c has the energy c
        pupils /= np.sqrt((np.abs(pupils) ** 2 / rim).sum(axis=(1, 2), keepdims=True))
        per_metre = self.magnification / (self.wavelength * self.relay)
        ty, tx = (
            phasor(per_metre * points.positions[:, k : k + 1] * axis)
            for axis, k in ((window.y, 1), (window.x, 0))
        )
        out = shift_pupils(pupils, plane, (ty, tx), self.device)
        return self._apply_stop(Field(out, window, self.wavelength, self.device))

    def pupil(self, y: Vector, x: Vector, z: float, *, diameter: float = 0.0) -> Vector:
        """Compute P at positions of the conjugate pupil, 1 in its middle; the rim is antialiased.

        ``y`` and ``x`` are evenly spaced, in metres; the result is complex128, shape (ny, nx).
        """
        step = float(x[1] - x[0])
        margin = 2 * step * self.magnification / self.relay
        glass = () if self.cover is None else (self.cover.index, self.cover.designed_index)
        wider = min(self.na + margin, (self.na + min((self.medium_index, *glass))) / 2)
        per_metre = -1 / (self.wavelength * self.relay)
        objective = replace(self.objective, na=wider)
        fy, fx = y * per_metre, x * per_metre
        return np.asarray(objective.amplitude(fy, fx, z, diameter=diameter) * self.rim(y, x))

    def rim(self, y: Vector, x: Vector) -> Vector:
        """Compute the fraction of each sample within the conjugate pupil, shape (ny, nx)."""
        return rim_coverage(self.pupil_diameter / 2 - np.hypot(y[:, None], x), float(x[1] - x[0]))

    def _apply_stop(self, field: Field) -> Field:
        """Return the field behind the stop; transforms of one window need no phase."""
        device, grid = self.device, field.grid
        axes = [f * self.wavelength * self.relay for f in (grid.fy, grid.fx)]
        step = float(axes[1][1] - axes[1][0])
        inside = rim_coverage(self.field_stop / 2 - np.hypot(axes[0][:, None], axes[1]), step)
        device.fft.inverse(field.data, device)
        stopped = multiply(field, device.upload(inside.astype(device.complex)))
        device.fft.forward(stopped.data, device)
        return stopped

    def sensor_fields(self, points: PointSources, window: Grid) -> Field:
        """Compute fields of points on the sensor.

        Shape (n, ny, nx), on a `window`.
        """
        device = self.device
        lenses = self.lenslets.transmission(window.y, window.x, self.wavelength)
        before = self.pupil_fields(points, window)
        behind = multiply(before, device.upload(lenses.astype(device.complex)))
        return self.to_sensor(window, self.sensor_distance)(behind)


def fourier_microscope(
    *,
    magnification: float,
    na: float,
    mla: MicrolensArray | LensletLayout,
    wavelength: float,
    relay: float,
    pixel_pitch: float,
    shape: tuple[int, int] | None = None,
    field_stop: float | None = None,
    sensor_distance: float | None = None,
    device: DeviceLike | None = None,
    medium_index: float = 1.0,
    tube_lens: float = 0.200,
    cover: CoverGlass | None = None,
    apodisation: float = APODISATION,
) -> FourierMicroscope:
    """Build a Fourier light-field microscope (FLFM, XLFM): lenslets on the conjugate pupil.

    The light passes objective, tube lens, field stop on the native image, relay lens, lenslets one
    focal length behind it, and sensor. Each lenslet shows the specimen from another angle (Llavador
    et al. 2016; Guo et al. 2019; with two focal lengths Cong et al. 2017).

    Parameters
    ----------
    magnification : float
        Magnification M of objective and tube lens, at least 1.
    na : float
        Numerical aperture, below ``medium_index``.
    mla : MicrolensArray or LensletLayout
        Lenslets on a lattice or at any positions, of one or several focal lengths.
    wavelength : float
        Wavelength of the fluorescence in vacuum, in metres.
    relay : float
        Focal length f_FL of the relay (Fourier) lens in metres.
    pixel_pitch : float
        Pitch in metres of the pixels, which integrate over their area.
    shape : tuple of int, optional
        (ny, nx) pixels of the sensor, centred on the axis; by default it holds all sub-images with
        light.
    field_stop : float, optional
        Diameter on the native image in metres; default d f_FL/s, which makes sub-images as wide
        as lenslets.
    sensor_distance : float, optional
        Distance s from lenslets to sensor in metres; default their focal length.
    device, medium_index, tube_lens, cover, apodisation
        Same parameters as in `PlenopticCamera.microscope`.

    Returns
    -------
    FourierMicroscope
        Camera whose frames are pictures, not raw images of a light field.

    Raises
    ------
    ValueError
        If a length or number is outside its range, NA is at or above the index, no lenslet lies in
        the pupil, or several focal lengths come without ``sensor_distance``.
    TypeError
        If array or cover glass has another type.
    SamplingError
        If a sub-image has less than 8 pixels.
    ShapeError
        If ``shape`` is not two positive integers.
    """
    device = as_device(device)
    if not isinstance(mla, MicrolensArray | LensletLayout):
        raise TypeError(
            "mla must be a MicrolensArray or a LensletLayout, such as LensletLayout([(0, 0)], "
            f"30e-3, diameter=1e-3), got an object of type {type(mla).__name__}."
        )
    layout = LensletLayout.of(mla) if isinstance(mla, MicrolensArray) else mla
    require_lengths(
        relay=relay, pixel_pitch=pixel_pitch, tube_lens=tube_lens, field_stop=field_stop,
        sensor_distance=sensor_distance,
    )  # fmt: skip
    check_wavelength(wavelength)
    check_objective(magnification, na, medium_index, apodisation, cover)
    focal = np.unique(layout.focal_lengths)
    if sensor_distance is None and len(focal) > 1:
        raise ValueError(
            f"sensor_distance must be given for lenslets of {len(focal)} focal lengths, such as "
            f"sensor_distance={focal.mean():g}."
        )
    s = float(focal[0]) if sensor_distance is None else float(sensor_distance)
    stop = layout.diameter * relay / s if field_stop is None else float(field_stop)
    pixels = stop * s / relay / pixel_pitch
    if pixels < MIN_SUB_IMAGE_PIXELS:
        raise SamplingError(
            f"A sub-image must have at least {MIN_SUB_IMAGE_PIXELS} pixels (field_stop s/(f_FL "
            f"pixel_pitch)), got {pixels:.3g}: use smaller pixels, or a wider field stop."
        )
    camera = FourierMicroscope(
        magnification=float(magnification),
        na=float(na),
        medium_index=float(medium_index),
        tube_lens=float(tube_lens),
        relay=float(relay),
        lenslets=layout,
        sensor_distance=s,
        field_stop=stop,
        wavelength=float(wavelength),
        pixel_pitch=float(pixel_pitch),
        grid=Grid((1, 1), float(pixel_pitch)),
        device=device,
        cover=cover,
        apodisation=float(apodisation),
    )
    if not (camera.lit >= MIN_LIT_FRACTION).any():
        raise ValueError(
            f"At least one lenslet must lie in the pupil, {camera.pupil_diameter:g} m wide about "
            "the axis (2 NA f_FL/M). Lengths are in metres."
        )
    return replace(camera, grid=_sensor(camera, shape))


def _sensor(camera: FourierMicroscope, shape: tuple[int, int] | None) -> Grid:
    """Return the sensor's grid about the axis; by default it holds all sub-images with light."""
    pitch = camera.pixel_pitch
    if shape is None:
        farthest = np.abs(camera.lenslets.positions[camera.lit >= MIN_LIT_FRACTION]).max(axis=0)
        sides = 2 * farthest + max(camera.sub_image, camera.lenslets.diameter)
        shape = (math.ceil(sides[0] / pitch - 1e-6), math.ceil(sides[1] / pitch - 1e-6))
    elif np.shape(shape) != (2,) or any(not is_integer(n) or n < 1 for n in shape):
        raise ShapeError(f"shape must be (ny, nx) pixels of the sensor, got {shape!r}.")
    ny, nx = int(shape[0]), int(shape[1])
    if ny * nx > MAX_SENSOR_PIXELS:
        raise ValueError(
            f"The sensor must have at most {MAX_SENSOR_PIXELS:,} pixels, got {ny} x {nx}. "
            "Lengths are in metres."
        )
    return Grid(
        (ny, nx),
        pitch,
        origin=(pitch / 2 if ny % 2 == 0 else 0.0, pitch / 2 if nx % 2 == 0 else 0.0),
    )


def _pixels(fine: Vector, shape: tuple[int, int], parts: int) -> Vector:
    """Return integrals over the pixels amid a window, by its transform: exact below Nyquist.

    A pixel of an even number of parts has its middle half a sample before the sample used.
    """
    spectrum = fft.rfft2(fine)
    tables = []
    for n, frequencies in zip(fine.shape, (fft.fftfreq, fft.rfftfreq), strict=True):
        f = frequencies(n)
        tables.append(np.sinc(f * parts) * np.exp(-1j * np.pi * f * (parts % 2 == 0)))
    spectrum *= tables[0][:, None] * tables[1] * parts**2
    integrated = fft.irfft2(spectrum, s=fine.shape)
    pixels = integrated[parts // 2 :: parts, parts // 2 :: parts]
    first = [(big - n) // 2 for big, n in zip(pixels.shape, shape, strict=True)]
    rows, columns = (slice(f, f + n) for f, n in zip(first, shape, strict=True))
    return np.maximum(pixels[rows, columns], 0)
