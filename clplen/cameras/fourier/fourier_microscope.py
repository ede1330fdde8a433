"""The Fourier light-field microscope by waves: objective, field stop, relay, lenslets, sensor.

A point at (x0, y0, z) has on the conjugate pupil, at u, the field

    E(u) = P(u/(lam f_FL)) exp(2 pi i M x0 u/(lam f_FL)),   abs(u) <= NA f_FL/M,

P of `Objective`; the specimen is upright in the sub-images, so that u points against the frequency
of the native image. The field stop multiplies its Fourier transform. Behind the lenslets follows
the angular spectrum over s, for all of them together: sub-images interfere where they meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import fft

from clplen.cameras.fourier.fourier_optics import FourierOptics
from clplen.cameras.fourier.lenslet_layout import covered
from clplen.cameras.optics.microscope_optics import check_positions
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.arrays import Image
from clplen.compute.fft.lines import smooth_length
from clplen.errors import SamplingError
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage, Sensor
from clplen.wave.coherence.averaging import Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import accumulate, average_of
from clplen.wave.field.transmission import multiply, phasor
from clplen.wave.propagation.free_space import plan

Vector = np.ndarray[Any, Any]

FINENESS = 4.0  # times the samples that the steepest light needs, because rims are sharp
GUARD = 1.15  # times what sensor and array take
BATCH_BYTES = 2**27  # of fields that travel together
LONGEST = 16384  # samples of a window along an axis
MOST_PARTS = 64  # of a pixel along an axis


@dataclass(frozen=True, repr=False)
class FourierMicroscope(FourierOptics):
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
        parts = [scene] if isinstance(scene, PointSources) else list(scene)
        if not parts or not all(isinstance(one, PointSources) for one in parts):
            found = ", ".join(sorted({type(one).__name__ for one in parts})) or "nothing"
            raise TypeError(
                f"A microscope exposes PointSources or a list of them, not {found}: give points, "
                "or project a volume (clplen.microscopy.FourierProjector)."
            )
        total = np.zeros(self.grid.shape)
        for wavelength, share in self._lines(coherence):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                total += share * camera._exposed(points, progress)
        data = self.device.upload(total.astype(np.float32))
        if sensor is not None:
            lenslets = LensletGrid((1, 1), self.grid.shape, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
            raw = RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets)
            data = sensor.record(raw).data
        return Image(data, self.device)

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
        return coherence.lines(self.wavelength)

    def _exposed(self, points: PointSources, progress: Progress | None) -> Vector:
        """Energy on the sensor's pixels."""
        check_positions(points.positions)
        window, parts = self.window(points)
        nbytes = math.prod(window.shape) * self.device.complex.itemsize
        step = max(1, BATCH_BYTES // nbytes)
        self.device.require_memory(4 * step * nbytes, "This exposure")
        total = self.device.zeros(window.shape, self.device.real)
        for start in range(0, len(points), step):
            some = slice(start, min(start + step, len(points)))
            fields = self.sensor_fields(points.chosen(some), window)
            accumulate(total, fields.data, points.power[some], self.device)
            if progress is not None:
                progress(some.stop, len(points))
        return _pixels(self.device.download(total).astype(np.float64), self.grid.shape, parts)

    def window(self, points: PointSources) -> tuple[Grid, int]:
        """A grid that holds and samples the light of points, and the parts of a pixel on it.

        Parameters
        ----------
        points : PointSources

        Returns
        -------
        (Grid, int)
            Its samples are so many parts of a pixel along an axis.

        Raises
        ------
        SamplingError
            If it would have too many samples.
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
            parts * _length(int(n), math.ceil(side / self.pixel_pitch))
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

        Parameters
        ----------
        points : PointSources
        window : Grid
            Periodic.

        Returns
        -------
        Field
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
        device = self.device
        out = device.empty((len(points), *window.shape), device.complex)
        device.launch_rows(
            device.kernel("objective.cl", "point_spectra", **device.wave_defines()),
            out.shape,
            out,
            device.upload(pupils.astype(device.complex)),
            device.upload(plane.ravel().astype(np.int32)),
            device.upload(ty.astype(device.complex)),
            device.upload(tx.astype(device.complex)),
            *(np.int32(n) for n in window.shape),
        )
        return self._stopped(Field(out, window, self.wavelength, device))

    def pupil(self, y: Vector, x: Vector, z: float, *, diameter: float = 0.0) -> Vector:
        """P at places of the conjugate pupil, 1 in its middle; samples on the rim are shared.

        Parameters
        ----------
        y, x : numpy.ndarray
            In metres, evenly spaced, shapes (ny,) and (nx,).
        z : float
            In metres, farther positive.
        diameter : float
            Of the source in metres.

        Returns
        -------
        numpy.ndarray
            complex128, shape (ny, nx).
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

        Parameters
        ----------
        points : PointSources
        window : Grid
            As `window` gives it.

        Returns
        -------
        Field
            Shape (n, ny, nx).
        """
        device = self.device
        lenses = self.lenslets.transmission(window.y, window.x, self.wavelength)
        before = self.pupil_fields(points, window)
        behind = multiply(before, device.upload(lenses.astype(device.complex)))
        way = plan(
            window,
            self.sensor_distance,
            wavelength=self.wavelength,
            method="as",
            pad=1,
            device=device,
        )
        return way(behind)


def _length(pixels: int, least: int) -> int:
    """The next quick length from ``least`` on, even or odd as ``pixels`` is."""
    length = max(pixels, least)
    length += (length - pixels) % 2
    while smooth_length(length) != length:
        length += 2
    return length


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
