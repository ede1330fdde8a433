"""The light-field microscope: lenslets on the native image plane of an objective with tube lens.

Levoy, Ng, Adams, Footer and Horowitz 2006, "Light field microscopy"; wave optics after Broxton et
al. 2013, "Wave optics theory and 3-D deconvolution for the light field microscope". The image side
is telecentric: sub-images are centred under their lenslets, and a ray from z meets the array at

    x = M x0 + (M^2 z/n) theta,

so that there is no F and no alpha: a plane has the disparity d = -M^2 z dx/(n f_mu p).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla

from clplen.cameras.exposure.local_exposure import add_windows, batches, window_samples
from clplen.cameras.exposure.source_images import (
    DeviceImages,
    images_on_patches,
    window_images,
)
from clplen.cameras.optics.lenslet_camera import Kind, lenslet_grid
from clplen.cameras.optics.microscope_optics import (
    MicroscopeOptics,
    check_positions,
    check_sampling,
)
from clplen.cameras.optics.microscope_windows import (
    MicroscopeWindows,
    microscope_window_shape,
)
from clplen.cameras.optics.pixel_array import PixelSums
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.compute.fft.lines import smooth_length
from clplen.errors import SamplingError
from clplen.lightfield.raw.raw_image import Exposure, RawImage, Sensor
from clplen.wave.coherence.averaging import Checkpoint, Progress
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.field import Field, Grid
from clplen.wave.field.intensity import accumulate, average_of
from clplen.wave.propagation.free_space import plan

Vector = np.ndarray[Any, Any]

BATCH_BYTES = 2**27  # of fields that travel through the microscope together
GUARD = 2  # lenslets of light around the geometrical blur


@dataclass(frozen=True, repr=False)
class Microscope(MicroscopeOptics):
    """A light-field microscope. Made by `PlenopticCamera.microscope`.

    Attributes
    ----------
    kind : str
        "microscope".
    magnification, na, medium_index, tube_lens : float
        M, NA and n of the objective; focal length of the tube lens in metres.
    mla : MicrolensArray
        The lenslets: pitch, focal length, count, lattice, fill, offset and rotation.
    wavelength : float
        In vacuum, in metres.
    pixels_per_lenslet : float
        Lenslet pitch over pixel pitch; may be fractional.
    pixel_pitch : float
        In metres.
    grid : Grid
        Of the sensor, and of the native plane.
    device : Device
        Where the simulation runs.
    cover : CoverGlass or None
        Where it is not the one that the objective is made for.
    apodisation : float
        e, of the amplitude cos(theta)^e over the pupil.
    pixels : PixelArray or None
        None: each pixel takes the intensity in its middle.
    pupil : PupilAberration or None
        Aberrations of objective and sample; None: there are none.

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
            (M x, M y). A whole volume is quicker by `clplen.microscopy.reconstruction.projector`.
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
            If there is a spatial model of coherence, or anything that only slides have; or if a
            place is more than 0.1 m away.
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
                "or project a volume (clplen.microscopy.reconstruction.projector)."
            )
        if {snapshots, rtol, checkpoint} != {None}:
            raise ValueError(
                "snapshots, rtol and checkpoint are for slides; fluorescent points have none."
            )
        total = np.zeros(self.grid.shape)
        transforms: list[tuple[int, tuple[int, int]]] = []
        for wavelength, share in self.lines(coherence):
            camera = replace(self, wavelength=wavelength)
            for points in parts:
                window = camera.window(points)  # refuses points beyond the array
                if self.pixels is not None:
                    total += share * camera._exposed_in_windows(points, transforms, progress)
                    continue
                total += share * camera._exposed(points, window, progress)
                transforms.append((3 * len(points), window.shape))
        if self.pixels is not None:
            total = self.pixels.read(total)
        data = self.device.upload(total.astype(np.float32))
        route = "points" if self.pixels is None else "local"
        raw = replace(self.raw_image(data), exposure=Exposure(route, tuple(transforms), 0.0))
        return raw if sensor is None else sensor.record(raw)

    def lines(self, coherence: Coherence | None) -> Sequence[tuple[float, float]]:
        """Wavelengths and their shares of the energy.

        Raises
        ------
        ValueError
            If there is a spatial model of coherence.
        SamplingError
            If the pixels cannot sample the light of a wavelength.
        """
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
            if self.pixels is None:
                check_sampling(replace(self, wavelength=wavelength))
        return lines

    def _exposed(self, points: PointSources, window: Grid, progress: Progress | None) -> Vector:
        """Energy on the sensor's pixels, in the device's precision."""
        step = self.batch(window)
        total = self.device.zeros(window.shape, self.device.real)
        for start in range(0, len(points), step):
            stop = min(start + step, len(points))
            fields = self.sensor_fields(points.chosen(slice(start, stop)), window)
            accumulate(total, fields.data, points.power[start:stop], self.device)
            if progress is not None:
                progress(stop, len(points))
        rows, columns = (
            slice((big - n) // 2, (big - n) // 2 + n)
            for big, n in zip(window.shape, self.grid.shape, strict=True)
        )
        return np.asarray(self.device.download(total)[rows, columns])

    def _exposed_in_windows(
        self,
        points: PointSources,
        transforms: list[tuple[int, tuple[int, int]]],
        progress: Progress | None,
    ) -> Vector:
        """Energy on pixels that integrate, from a window of its own for each point."""
        total = self.device.zeros(self.grid.shape, self.device.real)
        done = 0
        for same, windows in self._windows(points):
            add_windows(windows, points.power[same], total)
            samples = windows.shape.samples
            transforms.append((3 * len(same), (samples, samples)))
            done += len(same)
            if progress is not None:
                progress(done, len(points))
        return self.device.download(total).astype(np.float64)

    def _windows(self, points: PointSources) -> Iterator[tuple[list[int], MicroscopeWindows]]:
        """Windows of points in batches that travel together, with their indices."""
        shapes = [
            microscope_window_shape(self, place, points.diameter) for place in points.positions
        ]
        for same in batches(shapes, self.device):
            yield same, MicroscopeWindows.of(self, shapes[same[0]], points.chosen(same))

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
            window,
            self.mla.focal_length,
            wavelength=self.wavelength,
            method="as",
            pad=1,
            device=self.device,
        )
        return way(behind)

    def window(self, points: PointSources) -> Grid:
        """The smallest grid about the sensor's that holds the blur of points on the array.

        Raises
        ------
        ValueError
            If a place is more than 0.1 m away: one that was meant in micrometres.
        SamplingError
            If a point is imaged beyond the array.
        """
        check_positions(points.positions)
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
        blur += self.magnification * points.diameter / 2
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
        step = self.pixel_pitch * self.tube_lens / self.mla.focal_length  # du on the pupil
        lenslets = lenslet_grid(self, 1.0)
        spacing = (-step, -step, self.mla.row_pitch, self.mla.pitch)
        return RawImage(data, self.device, self.pixel_pitch, lenslets, lenslets, spacing, self)


def wider(n: int, least: float) -> int:
    """The next quick length of a transform from ``least`` samples on, even or odd as ``n`` is."""
    length = max(n, math.ceil(least))
    if n % 2 == 0:
        return 2 * smooth_length(-(-length // 2))
    length += 1 - length % 2
    while smooth_length(length) != length:
        length += 2
    return length


def microscope_images(camera: Microscope, points: PointSources) -> Iterator[DeviceImages]:
    """Images of single points on the pixels, without crosstalk, some at a time."""
    if camera.pixels is not None:
        for same, windows in camera._windows(points):
            yield window_images(same, windows, *window_samples(windows))
        return
    window = camera.window(points)
    first = [(big - n) // 2 for big, n in zip(window.shape, camera.grid.shape, strict=True)]
    middle = PixelSums((first[0], first[1]), 1, 0.0, (0, 0), camera.grid.shape)
    step = camera.batch(window)
    for start in range(0, len(points), step):
        which = list(range(start, min(start + step, len(points))))
        fields = camera.sensor_fields(points.chosen(which), window).data
        sums, gains = [middle] * len(which), np.ones(len(which))
        yield images_on_patches(which, fields, sums, gains, camera.device)
