"""Volumes to frames of a Fourier light-field microscope and back, as exact adjoints.

Every sub-image is a sum over planes of convolutions, cut to the field stop:

    I = sum_j S_j F^-1 sum_z F V_z F h_zj.

A plane is transformed once for all sub-images, a sub-image once for all planes; windows are those
of one sub-image, real to complex, on the host. What several sub-images put on a pixel adds up.
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

SHARE = 2  # transfer functions are kept where they take less than this part of the free memory
WORKING = 4  # windows of all sub-images that a projection works on
THREADS = -1  # of the transforms: all that there are


class FourierProjector(VolumeProjector):
    """Forward and backward projection with the point images of a Fourier microscope.

    A volume has shape (..., planes, rows b, columns b): its middle pixel, rows//2 and columns//2,
    lies on the axis. A frame has the shape of the sensor. Leading axes are frames.

    Parameters
    ----------
    images : FourierPointImages
        As `fourier_point_images` or `measure_point_images` give them.
    shape : tuple of int, optional
        (rows, columns) of the volume in pixels of a sub-image; default as wide as a sub-image.
    device : Device or str, optional
        That holds volumes and frames; None is ``Device.open()``.
    memory : int, optional
        Bytes for transfer functions; where they need more they are made anew for each plane.
        Default: half of what is free.

    Attributes
    ----------
    images, shape, device
        As given.
    volume_shape : tuple of int
        (planes, rows b, columns b).
    frame_shape : tuple of int
        (ny, nx) of the sensor.
    resident : bool
        Whether the transfer functions of all planes are kept.

    Raises
    ------
    ShapeError
        If the shape is not two positive integers.
    ValueError
        If the memory is negative or not finite.
    TypeError
        If the images are none, or the device.
    DeviceError
        If the projection of one frame does not fit the memory.

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
        widths = np.array([one.shape[-1] for one in images.stored])
        self._first = images.corners.min(axis=0)  # (y, x) of each lenslet's window, axis pixel
        ends = (images.corners + widths[:, None, None]).max(axis=0) - self._first
        self._window = tuple(
            smooth_length(n + int(most) - 1)
            for n, most in zip(self.shape, ends.max(axis=0), strict=True)
        )
        allowed = free_memory() // SHARE if memory is None else memory
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
        return ()  # every sub-image shows every plane

    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        what = frames_together(frames)
        kept = volumes * math.prod(self.volume_shape) + pictures * math.prod(self.frame_shape)
        self.device.require_memory(4 * frames * kept, what)
        plane = self.nbytes // len(self.images.planes)
        windows = 8 * len(self.images.centres) * math.prod(self._spectrum)
        of_host = (self.nbytes if self.resident else 2 * plane) + WORKING * windows
        free = free_memory() + sum(one.nbytes for one in self._kept.values())
        if of_host > free:
            raise DeviceError(
                f"{what} needs {amount(of_host, 'B')} on the host, of which {amount(free, 'B')} "
                "are free: take fewer planes or lenslets, or give memory=."
            )

    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        with self.device.on_host(volumes, write=False) as values:
            frames = np.stack([self._frame(one) for one in values])
        return self.device.upload(np.maximum(frames, 0) if clamp else frames)

    def back_project(self, frames: cla.Array) -> cla.Array:
        with self.device.on_host(frames, write=False) as values:
            volumes = np.stack([self._volume(one) for one in values])
        return self.device.upload(volumes)

    def _frame(self, volume: Vector) -> Vector:
        """H V of one volume on the host."""
        total = np.zeros((len(self.images.centres), *self._spectrum), np.complex64)
        for plane, transfer in enumerate(self._transfers()):
            spectra = fft.rfft2(self._phases(volume[plane]), s=self._window, workers=THREADS)
            for one, of_lenslets in zip(spectra, transfer, strict=True):
                total += one * of_lenslets
        windows = fft.irfft2(total, s=self._window, workers=THREADS)
        frame = np.zeros(self.frame_shape, np.float32)
        for lenslet, (on_frame, in_window, inside) in enumerate(self._places()):
            frame[on_frame] += windows[lenslet][in_window] * inside
        return frame

    def _volume(self, frame: Vector) -> Vector:
        """H' I of one frame on the host."""
        windows = np.zeros((len(self.images.centres), *self._window), np.float32)
        for lenslet, (on_frame, in_window, inside) in enumerate(self._places()):
            windows[lenslet][in_window] = frame[on_frame] * inside
        spectra = fft.rfft2(windows, workers=THREADS)
        np.conjugate(spectra, out=spectra)
        rows, columns = self.shape
        b = self.images.voxels
        out = np.empty(self.volume_shape, np.float32)
        for plane, transfer in enumerate(self._transfers()):
            seen = np.stack([np.einsum("jyx,jyx->yx", one, spectra) for one in transfer])
            phases = fft.irfft2(np.conjugate(seen), s=self._window, workers=THREADS)
            phases = phases[:, :rows, :columns].reshape(b, b, rows, columns)
            out[plane] = phases.transpose(2, 0, 3, 1).reshape(rows * b, columns * b)
        return out

    def _phases(self, plane: Vector) -> Vector:
        """A plane as pictures of the voxels of the same place in a pixel, shape (b b, ...)."""
        (rows, columns), b = self.shape, self.images.voxels
        apart = plane.reshape(rows, b, columns, b).transpose(1, 3, 0, 2)
        return np.ascontiguousarray(apart.reshape(b * b, rows, columns), np.float32)

    def _transfers(self) -> Iterator[Vector]:
        """Transforms of the images of each plane, shape (b b, lenslets, ...)."""
        for plane, stack in enumerate(self.images.stored):
            yield self._made_once(plane, partial(self._transfer, plane, stack))

    def _transfer(self, plane: int, stack: Vector) -> Vector:
        phases, lenslets, k, _ = stack.shape
        windows = np.zeros((phases, lenslets, *self._window), np.float32)
        for lenslet in range(lenslets):
            y, x = self.images.corners[plane, lenslet] - self._first[lenslet]
            windows[:, lenslet, y : y + k, x : x + k] = stack[:, lenslet]
        return np.asarray(fft.rfft2(windows, workers=THREADS))

    def _places(self) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice], Vector]]:
        """Where each window lies on the frame, its part there, and the share in the sub-image."""
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
            size = tuple(one.stop - one.start for one in on_frame)
            yield (
                (on_frame[0], on_frame[1]),
                (in_window[0], in_window[1]),
                images.inside(lenslet, corner, (size[0], size[1])),
            )
