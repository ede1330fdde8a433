"""Volumes to frames of a light-field microscope and back, as exact adjoints.

The point images of v x v voxels and n x n pixels a lenslet are n^2 v^2 small convolutions on the
lattice of lenslets: at each of its frequencies a matrix of n^2 by v^2 for each plane. Transforms
are those of the lattice, not of the frame; in the basis of lattice_spectra.cl the matrices are real
and those of y and -y are the same, so that a quarter of the numbers is kept and every one that is
read serves four columns. Where the pupil has aberrations without mirrors, images are sums of parts
with a sign under each mirror, which are projected one after another in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import finite_batch, is_finite, is_integer, require
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.compute.fft.lines import smooth_length
from clplen.compute.memory import free_memory
from clplen.errors import ShapeError
from clplen.microscopy.images import PointImages

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

Vector = np.ndarray[Any, Any]

WIDTH = 16  # frequencies of a block: see lattice_spectra.cl
HEIGHT = 5  # rows of a matrix in registers
GROUP_BYTES = 2**28  # of matrices of some planes together
SHARE = 2  # matrices are kept where they take less than this part of the memory


@dataclass(frozen=True)
class _Group:
    """Some neighbouring planes whose matrices lie in one array."""

    first: int
    count: int


FRAME = _Group(0, 1)


class Projector:
    """Forward and backward projection with the point images of a microscope.

    A volume has shape (..., planes, rows v, columns v): voxel (z, i v + sy, k v + sx) is voxel
    (sy, sx) of lenslet (i, k) in the plane ``images.planes[z]``; its frame has shape (..., rows n,
    columns n). Nothing lies outside the volume. Leading axes are frames, projected together.

    Parameters
    ----------
    images : PointImages
        Of the microscope, as `point_images` simulates them.
    shape : tuple of int
        (rows, columns) of lenslets.
    device : Device or str, optional
        None is ``Device.open()``.
    memory : int, optional
        Bytes for matrices; where they need more they are made anew for some planes at a time,
        which is slower. Default: half of the device's memory, of a CPU half of what is free.

    Attributes
    ----------
    images, shape, device
        As given.
    volume_shape : tuple of int
        (planes, rows v, columns v).
    frame_shape : tuple of int
        (rows n, columns n).
    resident : bool
        Whether the matrices of all planes are kept.

    Raises
    ------
    ShapeError
        If the shape is not two positive integers.
    ValueError
        If the memory is negative or not finite.
    TypeError
        If the images are none, or the device.
    DeviceError
        If the projection of one frame does not fit the device.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.microscope(
    ...     magnification=10, na=0.2, wavelength=525e-9, pixels_per_lenslet=11,
    ...     mla=clplen.MicrolensArray(60e-6, 1.5e-3, count=5, fill="full"))
    >>> images = clplen.point_images(camera, [0.0, 50e-6], voxels_per_lenslet=3, cut=0.05)
    >>> projector = clplen.Projector(images, (5, 5))
    >>> projector.volume_shape, projector.frame_shape
    ((2, 15, 15), (55, 55))
    >>> frame = projector.forward(np.ones(projector.volume_shape))
    >>> projector.backward(frame).shape
    (2, 15, 15)
    """

    def __init__(
        self,
        images: PointImages,
        shape: tuple[int, int],
        *,
        device: DeviceLike | None = None,
        memory: int | None = None,
    ) -> None:
        device = as_device(device)
        require(PointImages, images, "images", "point_images")
        if np.shape(shape) != (2,) or any(not is_integer(n) or n < 1 for n in shape):
            raise ShapeError(f"shape is (rows, columns) of lenslets, not {shape!r}.")
        if memory is not None and not (is_finite(memory) and memory >= 0):
            raise ValueError(f"memory is a number of bytes from 0 on or None, not {memory!r}.")
        self.images = images
        self.shape = (int(shape[0]), int(shape[1]))
        self.device = device
        v, n = images.voxels, images.pixels
        self.volume_shape = (len(images.planes), self.shape[0] * v, self.shape[1] * v)
        self.frame_shape = (self.shape[0] * n, self.shape[1] * n)
        farthest = max(images.radii)
        self._window = tuple(smooth_length(max(k + farthest, 2 * farthest + 1)) for k in self.shape)
        self._blocks = -(-(self._window[0] // 2 + 1) * (self._window[1] // 2 + 1) // WIDTH)
        planes = self.volume_shape[0]
        plane = self.nbytes // planes
        allowed = _room(device) if memory is None else memory
        self.resident = self.nbytes <= allowed
        together = max(1, min(GROUP_BYTES, allowed) // plane)
        self._groups = [
            _Group(first, min(together, planes - first)) for first in range(0, planes, together)
        ]
        self._kept: dict[tuple[_Group, tuple[int, int]], cla.Array] = {}
        self.require_memory(1)

    def __getstate__(self) -> dict[str, Any]:
        """Without the matrices on the device, which are made again when needed."""
        return self.__dict__ | {"_kept": {}}

    def __repr__(self) -> str:
        return f"<Projector of {self.volume_shape} to {self.frame_shape}, {self.device.name}>"

    @property
    def nbytes(self) -> int:
        """Bytes of the matrices of all planes."""
        v, n = self.images.voxels, self.images.pixels
        parts = len(self.images.parts)
        return 4 * self._blocks * WIDTH * (v * n) ** 2 * self.volume_shape[0] * parts

    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        """Refuse frames that cannot be projected together, before anything is allocated.

        Parameters
        ----------
        frames : int
        volumes, pictures : int
            That are kept on the device for each frame.

        Raises
        ------
        DeviceError
            With the bytes needed and the bytes there are.
        """
        v, n, together = self.images.voxels, self.images.pixels, self._groups[0].count
        group = together * (self.nbytes // self.volume_shape[0])
        matrices = self.nbytes if self.resident else 2 * group  # the next one is made beside it
        rows = n * n + together * v * v
        spectra = 4 * WIDTH * 4 * self._blocks * rows
        fields = 4 * math.prod(self._window) * max(frames * rows, n * n * (v * v + 1) // 2)
        kept = volumes * math.prod(self.volume_shape) + pictures * math.prod(self.frame_shape)
        self.device.require_memory(
            matrices + fields + frames * (spectra + 4 * kept),
            f"The projection of {'one frame' if frames == 1 else f'{frames} frames together'}",
        )

    def forward(self, volume: Any, *, clamp: bool = True) -> Vector:
        """The frames of volumes.

        Parameters
        ----------
        volume : array_like
            Energy of every voxel, shape (..., planes, rows v, columns v).
        clamp : bool
            Whether pixels that rounding leaves below 0 are 0, as Poisson statistics need it.
            A volume with negative voxels needs False.

        Returns
        -------
        numpy.ndarray
            float32, shape (..., rows n, columns n).

        Raises
        ------
        ShapeError
            If the volume has another shape, or there is none.
        ValueError
            If a voxel is not finite.
        TypeError
            If the volume is no array of real numbers.
        DeviceError
            If so many frames do not fit the device.
        """
        values = finite_batch(volume, self.volume_shape, "A volume")
        self.require_memory(len(values))
        frames = self.project(self.device.upload(values), clamp=clamp)
        lead = np.shape(volume)[:-3]
        return self.device.download(frames).reshape(*lead, *self.frame_shape)

    def backward(self, frame: Any) -> Vector:
        """The adjoint: what every voxel sees of frames through its image.

        Parameters
        ----------
        frame : array_like
            Shape (..., rows n, columns n).

        Returns
        -------
        numpy.ndarray
            float32, shape (..., planes, rows v, columns v).

        Raises
        ------
        ShapeError
            If the frame has another shape, or there is none.
        ValueError
            If a pixel is not finite.
        TypeError
            If the frame is no array of real numbers.
        DeviceError
            If so many frames do not fit the device.
        """
        values = finite_batch(frame, self.frame_shape, "A frame")
        self.require_memory(len(values))
        volumes = self.back_project(self.device.upload(values))
        lead = np.shape(frame)[:-2]
        return self.device.download(volumes).reshape(*lead, *self.volume_shape)

    adjoint = backward  # the name of every linear map

    @property
    def in_shape(self) -> tuple[int, int, int]:
        """Shape of what `forward_data` takes, that of a volume."""
        return self.volume_shape

    @property
    def out_shape(self) -> tuple[int, int]:
        """Shape of what it gives, that of a frame."""
        return self.frame_shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of volumes and frames, float32."""
        return np.dtype(np.float32)

    def forward_data(self, data: cla.Array) -> cla.Array:
        """H x of volumes on the device with any leading axes, without clamping: a linear map."""
        lead = data.shape[:-3]
        frames = self.project(data.reshape(-1, *self.volume_shape), clamp=False)
        return frames.reshape(*lead, *self.frame_shape)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """H' y of frames on the device with any leading axes."""
        lead = data.shape[:-2]
        volumes = self.back_project(data.reshape(-1, *self.frame_shape))
        return volumes.reshape(*lead, *self.volume_shape)

    def as_linear_operator(self) -> LinearOperator:
        """H for solvers of SciPy: vectors are raveled volumes and frames, float32, no clamping."""
        from scipy.sparse.linalg import LinearOperator

        return LinearOperator(
            (math.prod(self.frame_shape), math.prod(self.volume_shape)),
            matvec=lambda x: self.forward(np.reshape(x, self.volume_shape), clamp=False).ravel(),
            rmatvec=lambda y: self.backward(np.reshape(y, self.frame_shape)).ravel(),
            dtype=np.float32,
        )

    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        """`forward` on the device.

        Parameters
        ----------
        volumes : pyopencl.array.Array
            float32, shape (frames, planes, rows v, columns v).
        clamp : bool

        Returns
        -------
        pyopencl.array.Array
            float32, shape (frames, rows n, columns n).
        """
        v, n, frames = self.images.voxels, self.images.pixels, int(volumes.shape[0])
        device = self.device
        total = self._rows(frames, n * n)
        spectra = None
        for number, (group, part, matrix) in enumerate(self._matrices()):
            if spectra is None or part == self.images.parts[0]:
                spectra = self._packed(volumes, v, group)
            columns = group.count * v * v
            kernel = device.kernel("projector.cl", "forward", **self._form(part, number > 0))
            sizes = (n * n, columns, self._blocks, frames)
            device.launch(
                kernel, self._size(-(-n * n // HEIGHT)), total, matrix, spectra,
                *(np.int32(k) for k in sizes), operations=8.0 * frames * matrix.size,
            )  # fmt: skip
        out = device.empty((frames, *self.frame_shape), np.float32)
        self._unpacked(out, total, n, FRAME, 1, 0.0 if clamp else -math.inf)
        return out

    def back_project(self, frames: cla.Array) -> cla.Array:
        """`backward` on the device.

        Parameters
        ----------
        frames : pyopencl.array.Array
            float32, shape (frames, rows n, columns n).

        Returns
        -------
        pyopencl.array.Array
            float32, shape (frames, planes, rows v, columns v).
        """
        v, n, count = self.images.voxels, self.images.pixels, int(frames.shape[0])
        device = self.device
        spectra = self._packed(frames, n, FRAME)
        out = device.empty((count, *self.volume_shape), np.float32)
        parts = self.images.parts
        for group, part, matrix in self._matrices():
            columns = group.count * v * v
            if part == parts[0]:
                found = self._rows(count, columns)
            kernel = device.kernel("projector.cl", "backward", **self._form(part, part != parts[0]))
            sizes = (n * n, columns, v * v, self._blocks, count)
            device.launch(
                kernel, self._size(group.count), found, matrix, spectra,
                *(np.int32(k) for k in sizes), operations=8.0 * count * matrix.size,
            )  # fmt: skip
            if part == parts[-1]:
                self._unpacked(out, found, v, group, self.volume_shape[0], -math.inf)
        return out

    def _form(self, part: tuple[int, int], add: bool) -> dict[str, Any]:
        """Definitions of the kernels of projector.cl."""
        form: dict[str, Any] = {"LANES": WIDTH if self.device.rows else 1, "HEIGHT": HEIGHT}
        flags = {"ADD": add, "MIRRORED": part[0] < 0, "TURNED": part[0] * part[1] < 0}
        return form | {name: True for name, wanted in flags.items() if wanted}

    def _size(self, stretches: int) -> tuple[int, int]:
        """Work-items of the kernels of projector.cl."""
        if self.device.rows:
            return (stretches, self._blocks)
        return (self._blocks * WIDTH, stretches)

    def _rows(self, frames: int, rows: int) -> cla.Array:
        """Room for packed spectra."""
        return self.device.empty((frames, self._blocks, rows, 4, WIDTH), np.float32)

    def _packed(self, pictures: cla.Array, w: int, group: _Group) -> cla.Array:
        """Spectra of pictures with w x w samples a lenslet, as lattice_spectra.cl packs them."""
        frames, planes = int(pictures.shape[0]), group.count
        total = pictures.shape[1] if pictures.ndim == 4 else 1
        stack = (planes, group.first, int(total))
        fields = self._fields(pictures, w, frames * planes, stack, self.shape, 0)
        out = self._rows(frames, planes * w * w)
        pairs, frequencies = (w * w + 1) // 2, self._blocks * WIDTH
        device = self.device
        size = (1 if device.rows else frequencies, pairs, frames * planes)
        kernel = device.kernel("lattice_spectra.cl", "pack")
        sizes = (w, planes, *self._window)
        device.launch(kernel, size, out, fields, *(np.int32(k) for k in sizes))
        return out

    def _fields(
        self,
        pictures: cla.Array,
        w: int,
        count: int,
        stack: tuple[int, int, int],
        shape: tuple[int, ...],
        first: int,
    ) -> cla.Array:
        """Spectra of the pairs of samples; ``first`` > 0: of pictures about that lenslet."""
        device, pairs = self.device, (w * w + 1) // 2
        fields = device.empty((count * pairs, *self._window), np.complex64)
        kernel = device.kernel("lattice.cl", "decimate", **({"CENTRED": True} if first else {}))
        sizes = (w, first, *stack, *shape, *self._window)
        device.launch_rows(kernel, fields.shape, fields, pictures, *(np.int32(k) for k in sizes))
        device.fft.forward(fields, device)
        return fields

    def _unpacked(
        self, out: cla.Array, spectra: cla.Array, w: int, group: _Group, total: int, least: float
    ) -> None:
        """Pictures from packed spectra into some planes of stacks of ``total``."""
        device, pairs, frames = self.device, (w * w + 1) // 2, int(spectra.shape[0])
        planes = group.count
        fields = device.empty((frames * planes * pairs, *self._window), np.complex64)
        sizes = (w, planes, *self._window)
        device.launch_rows(
            device.kernel("lattice_spectra.cl", "unpack"),
            fields.shape, fields, spectra, *(np.int32(k) for k in sizes),
        )  # fmt: skip
        device.fft.inverse(fields, device)
        rows, columns = self.shape
        sizes = (planes, group.first, total, rows, columns, *self._window)
        device.launch_rows(
            device.kernel("lattice.cl", "interleave"),
            (frames * planes, rows * w, columns * w),
            out, fields, np.int32(w), np.float32(least), *(np.int32(k) for k in sizes),
        )  # fmt: skip

    def _matrices(self) -> Iterator[tuple[_Group, tuple[int, int], cla.Array]]:
        """The matrices of all planes, group by group and part by part; kept where there is room."""
        for group in self._groups:
            for part in self.images.parts:
                matrix = self._kept.get((group, part))
                if matrix is None:
                    matrix = self._assembled(group, part)
                    if self.resident:
                        self._kept[group, part] = matrix
                yield group, part, matrix

    def _assembled(self, group: _Group, part: tuple[int, int]) -> cla.Array:
        """The matrices of some planes from a part of their point images."""
        v, n, device = self.images.voxels, self.images.pixels, self.device
        columns, pairs = group.count * v * v, (n * n + 1) // 2
        matrix = device.empty((self._blocks, n * n, columns, WIDTH), np.float32)
        defines = {"TURNED": True} if part[0] * part[1] < 0 else {}
        kernel = device.kernel("lattice_spectra.cl", "assemble", **defines)
        phases = [divmod(t, v) for t in range((v * v + 1) // 2)]
        for place in range(group.count):
            plane = group.first + place
            r = self.images.radii[plane]
            pictures = np.stack([self.images.part(plane, phase, part) for phase in phases])
            across = (2 * r + 1, 2 * r + 1)
            stack = (len(phases), 0, len(phases))
            fields = self._fields(device.upload(pictures), n, len(phases), stack, across, r)
            sizes = (n, v, place * v * v, columns, *self._window)
            size = (1 if device.rows else self._blocks * WIDTH, pairs, len(phases))
            device.launch(kernel, size, matrix, fields, *(np.int32(k) for k in sizes))
        return matrix


def _room(device: Device) -> int:
    """Bytes that matrices may take."""
    there = min(device.memory_bytes, free_memory()) if device.is_cpu else device.memory_bytes
    return int(there) // SHARE
