"""Projection of volumes to frames of a Fourier light-field microscope, and its exact adjoint.

Every sub-image is a sum over planes of convolutions, cropped to the field stop S_j:

    I = sum_j S_j F^-1 sum_z F V_z F h_zj.

Each plane is transformed once for all sub-images, each sub-image once for all planes. Transforms
are real-to-complex, of windows around a sub-image, on the host. Overlapping sub-images add up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pyopencl.array as cla
from scipy import fft

from clplen.checks import require
from clplen.compute.device import DeviceLike, as_device
from clplen.compute.fft.lines import smooth_length
from clplen.compute.memory import free_memory
from clplen.errors import DeviceError
from clplen.microscopy.model.fourier_images import FourierPointImages
from clplen.microscopy.reconstruction.volume_projector import (
    VolumeProjector,
    frames_together,
)
from clplen.units import amount

Vector = np.ndarray[Any, Any]

MEMORY_DIVISOR = 2  # transfer functions may take this part of the free memory: a half
WORKING_WINDOWS = 4  # windows of all sub-images in memory during a projection
THREADS = -1  # of the transforms: all CPU cores


class FourierProjector(VolumeProjector):
    """Forward and backward projection with the point images of a Fourier microscope.

    A volume has shape (..., planes, rows b, columns b), with the pixel (rows//2, columns//2) on the
    axis. A frame has the shape of the sensor. Leading axes are frames.

    Parameters
    ----------
    images : FourierPointImages
        Point images from `fourier_point_images` or `measure_point_images`.
    shape : tuple of int, optional
        Shape (rows, columns) of the volume in sub-image pixels; default a whole sub-image.
    device : Device or str, optional
        Device of volumes and frames; None is ``Device.open()``.
    memory : int, optional
        Memory for transfer functions in bytes. If they need more, they are computed anew for each
        plane. Default: half of the free memory.

    Attributes
    ----------
    images, shape, device
        Point images, shape and device of the projector.
    volume_shape : tuple of int
        Shape (planes, rows b, columns b) of a volume.
    frame_shape : tuple of int
        Shape (ny, nx) of a frame.
    resident : bool
        True if the transfer functions of all planes stay in memory.

    Raises
    ------
    ShapeError
        If the shape is not two positive integers.
    ValueError
        If the memory is negative or not finite.
    TypeError
        If the images or the device have another type.
    DeviceError
        If the projection of a frame does not fit the memory.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.fourier_microscope(
    ...     magnification=20, na=0.3, wavelength=525e-9, relay=0.05, pixel_pitch=8e-6,
    ...     mla=clplen.MicrolensArray(500e-6, 12e-3, count=3))
    >>> images = clplen.microscopy.fourier_point_images(camera, [0.0, 20e-6])
    >>> projector = clplen.microscopy.FourierProjector(images, (31, 31))
    >>> projector.volume_shape, projector.frame_shape
    ((2, 31, 31), (188, 188))
    >>> frame = projector.forward(np.ones(projector.volume_shape))
    >>> projector.backward(frame).shape
    (2, 31, 31)
    """

    images: FourierPointImages

    def __init__(
        self,
        images: FourierPointImages,
        shape: tuple[int, int] | None = None,
        *,
        device: DeviceLike | None = None,
        memory: int | None = None,
    ) -> None:
        device = as_device(device)
        require(FourierPointImages, images, "images", "fourier_point_images")
        shape = images.field if shape is None else shape
        super().__init__(images, shape, "(rows, columns) in pixels", device, memory)
        b = images.voxels
        self.volume_shape = (len(images.planes), self.shape[0] * b, self.shape[1] * b)
        self.frame_shape = images.shape
        widths = np.array([plane.shape[-1] for plane in images.stored])
        self._first = images.corners.min(axis=0)  # first pixel (y, x) of each lenslet's window
        ends = (images.corners + widths[:, None, None]).max(axis=0) - self._first
        self._window = tuple(
            smooth_length(n + int(end) - 1)
            for n, end in zip(self.shape, ends.max(axis=0), strict=True)
        )
        allowed = free_memory() // MEMORY_DIVISOR if memory is None else memory
        self.resident = self.nbytes <= allowed
        self.require_memory(1)

    @property
    def _spectrum(self) -> tuple[int, int]:
        """Shape of the transform of a window."""
        return (self._window[0], self._window[1] // 2 + 1)

    @property
    def nbytes(self) -> int:
        """Bytes of the transfer functions of all planes."""
        images = self.images
        count = len(images.planes) * images.voxels**2 * len(images.centres)
        return 8 * count * math.prod(self._spectrum)

    @property
    def degenerate(self) -> tuple[float, ...]:
        return ()  # every sub-image resolves every plane

    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        name = frames_together(frames)
        values = volumes * math.prod(self.volume_shape) + pictures * math.prod(self.frame_shape)
        self.device.require_memory(4 * frames * values, name)
        plane = self.nbytes // len(self.images.planes)
        windows = 8 * len(self.images.centres) * math.prod(self._spectrum)
        transfers = self.nbytes if self.resident else 2 * plane
        nbytes = transfers + WORKING_WINDOWS * windows
        free = free_memory() + sum(transfer.nbytes for transfer in self._cache.values())
        if nbytes > free:
            raise DeviceError(
                f"{name} needs {amount(nbytes, 'B')} of host memory, {amount(free, 'B')} are free: "
                "take fewer planes or lenslets, or give memory=."
            )

    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        with self.device.on_host(volumes, write=False) as values:
            frames = np.stack([self._frame(volume) for volume in values])
        return self.device.upload(np.maximum(frames, 0) if clamp else frames)

    def back_project(self, frames: cla.Array) -> cla.Array:
        with self.device.on_host(frames, write=False) as values:
            volumes = np.stack([self._volume(frame) for frame in values])
        return self.device.upload(volumes)

    def _frame(self, volume: Vector) -> Vector:
        """Return H V of a volume, on the host."""
        total = np.zeros((len(self.images.centres), *self._spectrum), np.complex64)
        for plane, transfer in enumerate(self._transfers()):
            spectra = fft.rfft2(self._phases(volume[plane]), s=self._window, workers=THREADS)
            for spectrum, lenslets in zip(spectra, transfer, strict=True):
                total += spectrum * lenslets
        windows = fft.irfft2(total, s=self._window, workers=THREADS)
        frame = np.zeros(self.frame_shape, np.float32)
        for lenslet, (on_frame, in_window, inside) in enumerate(self._overlaps()):
            frame[on_frame] += windows[lenslet][in_window] * inside
        return frame

    def _volume(self, frame: Vector) -> Vector:
        """Return H' I of a frame, on the host."""
        windows = np.zeros((len(self.images.centres), *self._window), np.float32)
        for lenslet, (on_frame, in_window, inside) in enumerate(self._overlaps()):
            windows[lenslet][in_window] = frame[on_frame] * inside
        spectra = fft.rfft2(windows, workers=THREADS)
        np.conjugate(spectra, out=spectra)
        rows, columns = self.shape
        b = self.images.voxels
        out = np.empty(self.volume_shape, np.float32)
        for plane, transfer in enumerate(self._transfers()):
            sums = np.stack([np.einsum("jyx,jyx->yx", phase, spectra) for phase in transfer])
            phases = fft.irfft2(np.conjugate(sums), s=self._window, workers=THREADS)
            phases = phases[:, :rows, :columns].reshape(b, b, rows, columns)
            out[plane] = phases.transpose(2, 0, 3, 1).reshape(rows * b, columns * b)
        return out

    def _phases(self, plane: Vector) -> Vector:
        """Split a plane into pictures of voxels with equal phase in a pixel, shape (b b, ...)."""
        (rows, columns), b = self.shape, self.images.voxels
        phases = plane.reshape(rows, b, columns, b).transpose(1, 3, 0, 2)
        return np.ascontiguousarray(phases.reshape(b * b, rows, columns), np.float32)

    def _transfers(self) -> Iterator[Vector]:
        """Yield the transfer functions of each plane, shape (b b, lenslets, ...)."""
        for plane, stack in enumerate(self.images.stored):
            yield self._cached(plane, partial(self._transfer, plane, stack))

    def _transfer(self, plane: int, stack: Vector) -> Vector:
        phases, lenslets, k, _ = stack.shape
        windows = np.zeros((phases, lenslets, *self._window), np.float32)
        for lenslet in range(lenslets):
            y, x = self.images.corners[plane, lenslet] - self._first[lenslet]
            windows[:, lenslet, y : y + k, x : x + k] = stack[:, lenslet]
        return np.asarray(fft.rfft2(windows, workers=THREADS))

    def _overlaps(self) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice], Vector]]:
        """Yield the overlap of each window with the frame, in both, and the sub-image's share."""
        images = self.images
        for lenslet, first in enumerate(self._first):
            on_frame, in_window = [], []
            for axis in (0, 1):
                start = int(first[axis]) - self.shape[axis] // 2
                low = min(max(start, 0), images.shape[axis])
                high = max(min(start + self._window[axis], images.shape[axis]), low)
                on_frame.append(slice(low, high))
                in_window.append(slice(low - start, high - start))
            corner = (on_frame[0].start, on_frame[1].start)
            size = tuple(pixels.stop - pixels.start for pixels in on_frame)
            yield (
                (on_frame[0], on_frame[1]),
                (in_window[0], in_window[1]),
                images.inside(lenslet, corner, (size[0], size[1])),
            )
