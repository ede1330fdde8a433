"""The Fourier light-field microscope by waves: objective, field stop, relay, lenslets, sensor.

A point at (x0, y0, z) has on the conjugate pupil, at u, the field

    E(u) = P(u/(lam f_FL)) exp(2 pi i M x0 u/(lam f_FL)),   abs(u) <= NA f_FL/M,

P of `Objective`; the specimen is upright in the sub-images, so that u points against the frequency
of the native image. The field stop multiplies its Fourier transform. Behind the lenslets follows
the angular spectrum over s, for all of them together: sub-images interfere where they meet.

Objective and tube lens make the native image, with the field stop; the relay lens behind it makes
the conjugate pupil, 2 NA f_FL/M wide, where the lenslets lie, and each shows the specimen from its
own angle on the sensor (Llavador, Sola-Pikabea, Saavedra, Javidi and Martinez-Corral 2016,
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
from clplen.cameras.optics.lenslet_layout import LensletLayout, covered
from clplen.cameras.optics.objective import (
    APODISATION,
    CoverGlass,
    check_objective,
    check_positions,
    fluorescent_lines,
    fluorescent_points,
    moved_pupils,
    quick_length,
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

LEAST = 8  # pixels of a sub-image
MOST = 2**28  # pixels of a sensor
WHOLE = 0.95  # of a lenslet's aperture in the pupil: it counts as a whole one
LIT = 0.02  # of it: a lenslet that has less of the pupil makes no sub-image
SAMPLES = 128  # across a lenslet, by which its share of the pupil is found
FINENESS = 4.0  # times the samples that the steepest light needs, because rims are sharp
GUARD = 1.15  # times what sensor and array take
LONGEST = 16384  # samples of a window along an axis
MOST_PARTS = 64  # of a pixel along an axis


@dataclass(frozen=True, repr=False)
class FourierMicroscope(Described, ObjectiveCamera):
    """A Fourier light-field microscope. Made by `PlenopticCamera.fourier_microscope`.

    Its lenslets lie on the conjugate pupil: a pixel of a sub-image is a place, a sub-image a view.
    Its frames are pictures, and no raw images of a light field.

    Attributes
    ----------
    kind : str
        "fourier_microscope".
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    relay : float
        f_FL, focal length of the relay (Fourier) lens in metres.
    lenslets : LensletLayout
        Their places, focal lengths and apertures.
    sensor_distance : float
        s in metres, from the lenslets to the sensor.
    field_stop : float
        Diameter of the stop on the native image, in metres.
    wavelength : float
        In vacuum, in metres.
    pixel_pitch : float
        In metres; pixels integrate over their area.
    grid : Grid
        Of the sensor.
    device : Device
        Where the simulation runs.
    cover : CoverGlass or None
        Where it is not the one that the objective is made for.
    apodisation : float
        e, of the amplitude cos(theta)^e over the pupil.

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
        """2 NA f_FL/M, of the conjugate pupil in metres (Guo et al. 2019)."""
        return 2 * self.na * self.relay / self.magnification

    @property
    def scale(self) -> float:
        """M_T = M s/f_FL, from the specimen to a sub-image (Guo et al. 2019)."""
        return self.magnification * self.sensor_distance / self.relay

    @property
    def side(self) -> float:
        """Of a pixel in the specimen, in metres."""
        return self.pixel_pitch / self.scale

    @property
    def effective_na(self) -> float:
        """M d/(2 f_FL) = NA/N, of one lenslet (Scrofani et al. 2018)."""
        return self.magnification * self.lenslets.diameter / (2 * self.relay)

    @property
    def lit(self) -> Vector:
        """Share of each lenslet's aperture in the pupil, float64, shape (lenslets,)."""
        layout = self.lenslets
        step = 2 * layout.reach / SAMPLES
        t = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * step
        shape = layout.coverage(t, t, step)
        inside = self.pupil_diameter / 2 - np.hypot(*layout.positions.T)
        found = (inside > 0).astype(np.float64)
        for lenslet in np.flatnonzero(np.abs(inside) < layout.reach + step):
            y, x = layout.positions[lenslet]
            rim = self.pupil_diameter / 2 - np.hypot(y + t[:, None], x + t)
            found[lenslet] = (shape * covered(rim, step)).sum() / shape.sum()
        return found

    @property
    def sine(self) -> float:
        """sin(theta) of the outermost lenslet that has its whole aperture in the pupil; or NaN."""
        whole = self.lenslets.positions[self.lit >= WHOLE]
        if not len(whole):
            return math.nan
        farthest = float(np.hypot(*whole.T).max())
        return self.magnification * farthest / (self.relay * self.medium_index)

    def displacement(self, z: float) -> Vector:
        """M_T z tan(theta) of every sub-image on the sensor, by its lenslet's central ray.

        Parameters
        ----------
        z : float
            In metres, farther positive.

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
        """The larger of lam N/(2 NA) and two pixels, in metres (Scrofani et al. 2018)."""
        return max(self.wavelength / (2 * self.effective_na), 2 * self.side)

    @property
    def axial_resolution(self) -> float:
        """Lateral resolution over tan(theta) of the outermost whole lenslet, in metres.

        Two points that far apart on the axis are told apart in its sub-image.
        """
        sine = self.sine
        if not 0 < sine < 1:
            return math.inf if sine == 0 else math.nan
        return self.lateral_resolution * math.sqrt(1 - sine**2) / sine

    @property
    def depth_of_field(self) -> float:
        """n lam N^2/NA^2 + n N pixel/(NA M_T) in metres, whole (Galdon et al. 2022)."""
        na, n = self.effective_na, self.medium_index
        return n * self.wavelength / na**2 + n * self.side / na

    @property
    def sub_image(self) -> float:
        """Diameter of a sub-image on the sensor in metres: of the field stop, times s/f_FL."""
        return self.field_stop * self.sensor_distance / self.relay

    @property
    def overlap(self) -> float:
        """Share of a sub-image's diameter that its neighbour covers, too."""
        return max(0.0, 1 - self.lenslets.spacing / self.sub_image)

    def describe(self) -> Description:
        """Derived parameters; see `Description`."""
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
            Row("lenslets", len(layout), "", f"{int((self.lit >= LIT).sum())} with light, "
                f"{int((self.lit >= WHOLE).sum())} whole, {layout.fill}"),
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
            Row("overlap", self.overlap, "", "of neighbouring sub-images, over their diameter"),
            Row("effective aperture", self.effective_na, "", "NA/N (Scrofani et al. 2018)"),
            Row("lateral resolution", self.lateral_resolution, "m",
                "max(lam N/(2 NA), 2 pixel/M_T) (Scrofani et al. 2018)"),
            Row("largest view angle", angle, "deg", "n sin(theta) = M c/f_FL, outermost whole "
                "lenslet"),
            Row("axial resolution", self.axial_resolution, "m", "lateral over tan(theta) of it"),
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
            (x, y, dz) from the axis point of the focal plane, in the medium. Beyond the field stop
            they are dark. A whole volume is quicker by `clplen.microscopy.FourierProjector`.
        coherence : Coherence, optional
            Its spectrum is that of the fluorescence; it has no spatial model.
        sensor : Sensor, optional
            Photons, noise, bits; None keeps units of energy.
        progress : callable, optional
            Called as ``progress(done, total)`` after each batch of points.

        Returns
        -------
        Image
            float32, shape of ``grid``; ``power`` of a point is the energy in the pupil.

        Raises
        ------
        SamplingError
            If the window that holds the light would be too large.
        ValueError
            If there is a spatial model of coherence; or if a place is more than 0.1 m away.
        TypeError
            If the scene is no points.
        DeviceError
            If the fields do not fit the device.
        """
        parts = fluorescent_points(scene, "clplen.microscopy.FourierProjector")
        total = np.zeros(self.grid.shape)
        for wavelength, share in fluorescent_lines(coherence, self.wavelength):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                total += share * camera._exposed(points, progress)
        data = self.device.upload(total.astype(np.float32))
        if sensor is not None:
            lenslets = LensletGrid((1, 1), self.grid.shape, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
            raw = RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets)
            data = sensor.record(raw).data
        return Image(data, self.device)

    def _exposed(self, points: PointSources, progress: Progress | None) -> Vector:
        """Energy on the sensor's pixels."""
        check_positions(points.positions)
        window, parts = self.window(points)
        total = self.energies(points, window, progress).astype(np.float64)
        return _pixels(total, self.grid.shape, parts)

    def window(self, points: PointSources) -> tuple[Grid, int]:
        """A grid that holds and samples the light of points, and the parts of a pixel on it.

        Its samples are so many parts of a pixel along an axis.
        """
        reach = self.magnification * np.abs(points.positions[:, :2]).max(axis=1)
        reach += self.objective.blur(points.positions[:, 2])
        wanted = (
            FINENESS
            * self.pixel_pitch
            * max(
                2 * self.slope / self.wavelength,
                (float(reach.max()) + self.field_stop / 2)
                / (self.wavelength * self.relay)
                / FINENESS,
            )
        )
        parts = max(1, math.ceil(wanted))
        pitch = self.pixel_pitch / parts
        sides = 2 * (np.abs(self.lenslets.positions).max(axis=0) + self.lenslets.reach)
        across = GUARD * np.maximum(np.array(self.grid.extent), sides)
        shape = [
            parts * quick_length(int(n), side / self.pixel_pitch)
            for n, side in zip(self.grid.shape, across, strict=True)
        ]
        if max(shape) > LONGEST or parts > MOST_PARTS:
            raise SamplingError(
                f"The light of these points needs {shape[0]} x {shape[1]} samples of {pitch:.3g} "
                f"m, at most {LONGEST} along an axis: take points nearer to the focal plane, a "
                "smaller field stop, or fewer lenslets."
            )
        origin = [pitch / 2 if n % 2 == 0 else 0.0 for n in shape]
        return Grid((shape[0], shape[1]), pitch, origin=(origin[0], origin[1])), parts

    @property
    def slope(self) -> float:
        """Sine of the steepest light on the sensor: field stop over f_FL and a lenslet over f."""
        focal = float(self.lenslets.focal_lengths.min())
        return self.field_stop / (2 * self.relay) + self.lenslets.reach / focal

    def pupil_fields(self, points: PointSources, window: Grid) -> Field:
        """Fields of points on the conjugate pupil, within the field stop.

        Shape (n, ny, nx); before the stop each has the energy 1.
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
        out = moved_pupils(pupils, plane, (ty, tx), self.device)
        return self._stopped(Field(out, window, self.wavelength, self.device))

    def pupil(self, y: Vector, x: Vector, z: float, *, diameter: float = 0.0) -> Vector:
        """P at places of the conjugate pupil, 1 in its middle; samples on the rim are shared.

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
        """Share of samples within the conjugate pupil, shape (ny, nx)."""
        return covered(self.pupil_diameter / 2 - np.hypot(y[:, None], x), float(x[1] - x[0]))

    def _stopped(self, field: Field) -> Field:
        """The field behind the stop: transforms of one window, so that no phase is needed."""
        device, grid = self.device, field.grid
        places = [f * self.wavelength * self.relay for f in (grid.fy, grid.fx)]
        step = float(places[1][1] - places[1][0])
        inside = covered(self.field_stop / 2 - np.hypot(places[0][:, None], places[1]), step)
        device.fft.inverse(field.data, device)
        stopped = multiply(field, device.upload(inside.astype(device.complex)))
        device.fft.forward(stopped.data, device)
        return stopped

    def sensor_fields(self, points: PointSources, window: Grid) -> Field:
        """Fields of points on the sensor.

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
    """A Fourier light-field microscope (FLFM, XLFM): lenslets on the conjugate pupil.

    Objective, tube lens, field stop on the native image, relay lens, lenslets one focal length
    behind it, sensor. Each lenslet shows the specimen from its own angle (Llavador et al. 2016;
    Guo et al. 2019; with two focal lengths Cong et al. 2017).

    Parameters
    ----------
    magnification : float
        M of objective and tube lens, at least 1.
    na : float
        Numerical aperture, below ``medium_index``.
    mla : MicrolensArray or LensletLayout
        Lenslets on a lattice, or anywhere; of one or several focal lengths.
    wavelength : float
        Of the fluorescence in vacuum, in metres.
    relay : float
        f_FL in metres, of the relay (Fourier) lens.
    pixel_pitch : float
        Of the sensor in metres; pixels integrate over their area.
    shape : tuple of int, optional
        (ny, nx) pixels of the sensor, its middle on the axis; default as many as the
        sub-images with light take.
    field_stop : float, optional
        Diameter in metres, on the native image; default d f_FL/s, which makes sub-images as
        wide as lenslets.
    sensor_distance : float, optional
        s in metres, from lenslets to sensor; default their focal length.
    device, medium_index, tube_lens, cover, apodisation
        As for `PlenopticCamera.microscope`.

    Returns
    -------
    FourierMicroscope
        A camera of its own: its frames are pictures, and no raw images of a light field.

    Raises
    ------
    ValueError
        For a length or number outside its range, NA at or above the index, no lenslet in the
        pupil, or several focal lengths without ``sensor_distance``.
    TypeError
        If array or cover glass are none.
    SamplingError
        If a sub-image has less than 8 pixels.
    ShapeError
        If ``shape`` is not two positive integers.
    """
    device = as_device(device)
    if not isinstance(mla, MicrolensArray | LensletLayout):
        raise TypeError(
            "mla is a MicrolensArray or a LensletLayout, as LensletLayout([(0, 0)], 30e-3, "
            f"diameter=1e-3), not of type {type(mla).__name__}."
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
            f"Lenslets of {len(focal)} focal lengths share one sensor: give sensor_distance, from "
            f"the array to it, such as {focal.mean():g}."
        )
    s = float(focal[0]) if sensor_distance is None else float(sensor_distance)
    stop = layout.diameter * relay / s if field_stop is None else float(field_stop)
    pixels = stop * s / relay / pixel_pitch
    if pixels < LEAST:
        raise SamplingError(
            f"A sub-image has {pixels:.3g} pixels (field_stop s/(f_FL pixel_pitch)), at least "
            f"{LEAST} are needed: give smaller pixels, or a wider field stop."
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
    if not (camera.lit >= LIT).any():
        raise ValueError(
            f"No lenslet lies in the pupil, which is {camera.pupil_diameter:g} m wide about the "
            "axis (2 NA f_FL/M): lengths are in metres."
        )
    return replace(camera, grid=_sensor(camera, shape))


def _sensor(camera: FourierMicroscope, shape: tuple[int, int] | None) -> Grid:
    """The sensor about the axis: as given, or as large as the sub-images with light."""
    pitch = camera.pixel_pitch
    if shape is None:
        farthest = np.abs(camera.lenslets.positions[camera.lit >= LIT]).max(axis=0)
        sides = 2 * farthest + max(camera.sub_image, camera.lenslets.diameter)
        shape = (math.ceil(sides[0] / pitch - 1e-6), math.ceil(sides[1] / pitch - 1e-6))
    elif np.shape(shape) != (2,) or any(not is_integer(n) or n < 1 for n in shape):
        raise ShapeError(f"shape is (ny, nx) pixels of the sensor, not {shape!r}.")
    ny, nx = int(shape[0]), int(shape[1])
    if ny * nx > MOST:
        raise ValueError(f"The sensor has {ny} x {nx} pixels, at most {MOST:,}: are lengths right?")
    return Grid(
        (ny, nx),
        pitch,
        origin=(pitch / 2 if ny % 2 == 0 else 0.0, pitch / 2 if nx % 2 == 0 else 0.0),
    )


def _pixels(fine: Vector, shape: tuple[int, int], parts: int) -> Vector:
    """Integrals over the pixels in the middle of a window, by its transform: exact below Nyquist.

    Of an even number of parts a pixel's middle lies half a sample before the one that is taken.
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
