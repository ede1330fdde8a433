"""Projection of volumes to frames of a light-field microscope, and its exact adjoint.

With v x v voxels and n x n pixels per lenslet, the point images are n^2 v^2 small convolutions on
the lattice of lenslets: an n^2 by v^2 matrix for each plane and frequency of the lattice. Only the
lattice is transformed, not the frame. In the basis of lattice_spectra.cl the matrices are real, and
equal for y and -y: a quarter of the numbers is stored, and each number serves four columns. For
other arrays, cells of several lenslets (cells.py) replace lenslets; an array without a mirror
symmetry has two or four such matrices.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import require
from clplen.compute.device import Device, DeviceLike, as_device
from clplen.compute.fft.lines import smooth_length
from clplen.compute.memory import free_memory
from clplen.microscopy.model.cells import Pair
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.lattice_transform import LatticeTransform, bits_of
from clplen.microscopy.reconstruction.volume_projector import (
    VolumeProjector,
    frames_together,
)

Vector = np.ndarray[Any, Any]

SINGLE_PART = (0,)  # parts of a picture without decomposition
WIDTH = 16  # frequencies of a block: see lattice_spectra.cl
HEIGHT = 5  # rows of a result in registers
DEPTH = 40  # terms of a sum whose part of a matrix fits the first-level cache
PANEL = 150  # rows of a result in the second-level cache
GROUP_BYTES = 2**28  # of matrices of a group of planes that are computed anew
RESIDENT_GROUP_BYTES = 2**30  # of resident matrices: frames are read and written once per group
PIECE_BYTES = 2**24  # of the matrix of some voxels, if the matrix of a plane does not fit
FIELD_BYTES = 2**23  # of spectra of point images transformed together
MEMORY_DIVISOR = 2  # matrices may take this part of the memory: a half


@dataclass(frozen=True)
class _Group:
    """Neighbouring planes that are projected together."""

    first: int
    count: int


FRAME = _Group(0, 1)


class Projector(VolumeProjector):
    """Forward and backward projection with the point images of a microscope.

    A volume has shape (..., planes, rows v, columns v): voxel (z, i v + sy, k v + sx) is voxel
    (sy, sx) of lenslet (i, k) in the plane ``images.planes[z]``. Its frame has shape (..., rows n,
    columns n). Space outside the volume is dark. Leading axes are frames, projected together.

    For an array that is not square or has several kinds of lenslets, read cells for lenslets:
    ``images.cell`` with (vy, vx) voxels and (ny, nx) pixels.

    Parameters
    ----------
    images : PointImages
        Point images of the microscope from `point_images`.
    shape : tuple of int
        Number (rows, columns) of lenslets, or of cells.
    device : Device or str, optional
        OpenCL device; None is ``Device.open()``.
    memory : int, optional
        Memory for matrices in bytes. If they need more, they are computed anew for some planes, or
        some voxels of a plane, at a time, which is slower. Default: half of the device's memory, or
        half of the free memory on a CPU.

    Attributes
    ----------
    images, shape, device
        Point images, shape and device of the projector.
    volume_shape : tuple of int
        Shape (planes, rows v, columns v) of a volume.
    frame_shape : tuple of int
        Shape (rows n, columns n) of a frame.
    resident : bool
        True if the matrices of all planes stay in memory.

    Raises
    ------
    ShapeError
        If the shape is not two positive integers.
    ValueError
        If the memory is negative or not finite.
    TypeError
        If the images or the device have another type.
    DeviceError
        If the projection of a frame does not fit the device.

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

    images: PointImages
    _between = 0  # further pixels per frame on the device

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
        super().__init__(images, shape, "(rows, columns) of lenslets", device, memory)
        cell = self._cell = images.cell
        rows, columns = self.shape
        self.volume_shape = (len(images.planes), rows * cell.voxels[0], columns * cell.voxels[1])
        self.frame_shape = self._model_shape = (rows * cell.pixels[0], columns * cell.pixels[1])
        farthest = np.max(images.reaches, axis=0)
        ny, nx = (
            smooth_length(max(k + int(r), 2 * int(r) + 1))
            for k, r in zip(self.shape, farthest, strict=True)
        )
        self._window = (ny, nx)
        self._lanes = LatticeTransform(device, self._window) if device.rows else None
        self._blocks = -(-(self._window[0] // 2 + 1) * (self._window[1] // 2 + 1) // WIDTH)
        planes = self.volume_shape[0]
        plane = self.nbytes // planes
        allowed = _available_bytes(device) if memory is None else memory
        self.resident = self.nbytes <= allowed
        largest = min(RESIDENT_GROUP_BYTES, int(device.cl_device.max_mem_alloc_size))
        count = max(1, min(largest if self.resident else GROUP_BYTES, allowed) // plane)
        self._groups = [
            _Group(first, min(count, planes - first)) for first in range(0, planes, count)
        ]
        voxels, pairs = math.prod(cell.voxels), self._pictures
        if plane > allowed:
            pair = 2 * plane // self._rows_of_plane
            pairs = min(pairs, max(1, max(allowed, PIECE_BYTES) // pair))
        self._piece = voxels if pairs == self._pictures else 2 * pairs
        self._spare: dict[tuple[int, ...], list[cla.Array]] = {}
        self.require_memory(1)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without arrays on the device, which are made again when needed."""
        return super().__getstate__() | {"_spare": {}}

    @property
    def lenslets(self) -> tuple[int, int]:
        """Number (rows, columns) of lenslets above the volume."""
        rows, columns = self._cell.lenslets
        return self.shape[0] * rows, self.shape[1] * columns

    @property
    def degenerate(self) -> tuple[float, ...]:
        return tuple(float(z) for z in self.images.planes[self.images.blurs < 0.5])

    @property
    def nbytes(self) -> int:
        """Bytes of the matrices of all planes."""
        values = math.prod(self._cell.pixels) * self._rows_of_plane
        return 4 * self._blocks * WIDTH * values * self.volume_shape[0]

    @property
    def _rows_of_plane(self) -> int:
        """Rows of the spectra of a plane: voxels of a cell times parts."""
        return math.prod(self._cell.voxels) * len(self._cell.parts)

    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        planes, n = self._groups[0].count, math.prod(self._cell.pixels)
        group_rows = planes * self._rows_of_plane
        start, stop = self._pieces(self._groups[0])[0]
        matrices = self.nbytes if self.resident else self._bytes_of(stop - start)
        rows = n + group_rows + (stop - start if stop < group_rows else 0)
        spectra = 4 * WIDTH * 4 * self._blocks * rows
        window = 4 * math.prod(self._window)
        if self._lanes is None:
            fields = window * max(frames * rows, 2 * n * self._image_batch)
        else:
            fields = max(self._lanes.nbytes(frames * rows), window * 2 * n * self._image_batch)
        values = volumes * math.prod(self.volume_shape) + pictures * math.prod(self.frame_shape)
        self.device.require_memory(
            matrices + fields + frames * (spectra + 4 * (values + self._between)),
            frames_together(frames),
        )

    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        cell, device, frames = self._cell, self.device, int(volumes.shape[0])
        rows = math.prod(cell.pixels)
        total = self._rows(frames, rows)
        added: dict[str, Any] = {}
        for group in self._groups:
            spectra = self._packed(volumes, cell.voxels, group, cell.parts)
            for (start, stop), matrix in self._matrices(group):
                kernel = device.kernel("projector.cl", "forward", **self._form, **added)
                part, sizes = self._row_slice(spectra, start, stop), (rows, stop - start)
                device.launch(
                    kernel, self._size(rows), total, matrix, part,
                    *(np.int32(k) for k in (*sizes, self._blocks, frames)),
                    operations=8.0 * frames * matrix.size,
                )  # fmt: skip
                if part is not spectra:
                    self._recycle(part)
                added = {"ADD": True}
                del matrix  # frees the memory for the next matrix unless it is resident
            self._recycle(spectra)
        out = device.empty((frames, *self._model_shape), np.float32)
        self._unpacked(out, total, cell.pixels, FRAME, SINGLE_PART, 1, 0.0 if clamp else -math.inf)
        self._recycle(total)
        return out

    def back_project(self, frames: cla.Array) -> cla.Array:
        cell, device, count = self._cell, self.device, int(frames.shape[0])
        spectra = self._packed(frames, cell.pixels, FRAME, SINGLE_PART)
        out = device.empty((count, *self.volume_shape), np.float32)
        planes, n = self.volume_shape[0], math.prod(cell.pixels)
        kernel = device.kernel("projector.cl", "backward", **self._form)
        for group in self._groups:
            columns = group.count * self._rows_of_plane
            total = self._rows(count, columns)
            for (start, stop), matrix in self._matrices(group):
                part = total if stop - start == columns else self._rows(count, stop - start)
                sizes = (n, stop - start, self._blocks, count)
                device.launch(
                    kernel, self._size(stop - start), part, matrix, spectra,
                    *(np.int32(k) for k in sizes), operations=8.0 * count * matrix.size,
                )  # fmt: skip
                del matrix
                if part is not total:
                    self._move_rows(total, part, to=start)
                    self._recycle(part)
            self._unpacked(out, total, cell.voxels, group, cell.parts, planes, -math.inf)
            self._recycle(total)
        self._recycle(spectra)
        return out

    @property
    def _form(self) -> dict[str, Any]:
        """Definitions of the kernels of projector.cl."""
        lanes = WIDTH if self.device.rows else 1
        return {"LANES": lanes, "HEIGHT": HEIGHT, "DEPTH": DEPTH, "PANEL": PANEL}

    def _size(self, rows: int) -> tuple[int, int]:
        """Work-items of the kernels of projector.cl."""
        if self.device.rows:
            return (self._blocks, 1)
        return (self._blocks * WIDTH, -(-rows // HEIGHT))

    def _rows(self, frames: int, rows: int) -> cla.Array:
        """Return an array for packed spectra, recycled if possible, because new memory is slow."""
        # Recycled arrays have no users, and the queue runs in order: none is overwritten too early.
        shape = (frames, self._blocks, rows, 4, WIDTH)
        try:
            return self._spare[shape].pop()
        except (KeyError, IndexError):
            pass
        for other in list(self._spare):
            if other[0] != frames:
                self._spare.pop(other, None)
        return self.device.empty(shape, np.float32)

    def _recycle(self, rows: cla.Array) -> None:
        """Store the array of spectra that are no longer needed for reuse, on a CPU."""
        if self.device.rows:
            self._spare.setdefault(rows.shape, []).append(rows)

    def _row_slice(self, spectra: cla.Array, start: int, stop: int) -> cla.Array:
        """Return rows of packed spectra."""
        frames, _, rows = spectra.shape[:3]
        if stop - start == rows:
            return spectra
        part = self._rows(int(frames), stop - start)
        self._move_rows(part, spectra, start=start)
        return part

    def _move_rows(
        self, target: cla.Array, source: cla.Array, *, start: int = 0, to: int = 0
    ) -> None:
        """Copy the rows of packed spectra from row ``start`` of a source to row ``to``."""
        row, count = 4 * WIDTH * 4, math.prod(source.shape[:2])  # bytes; frames and blocks
        source_rows, target_rows = int(source.shape[2]), int(target.shape[2])
        self.device.copy_lines(
            target, source, (row * min(source_rows, target_rows), count),
            (row * start, row * source_rows), (row * to, row * target_rows),
        )  # fmt: skip

    def _packed(
        self, pictures: cla.Array, w: Pair, group: _Group, parts: tuple[int, ...]
    ) -> cla.Array:
        """Return packed spectra (lattice_spectra.cl) of pictures with wy x wx samples per cell."""
        frames, planes = int(pictures.shape[0]), group.count
        total = int(pictures.shape[1]) if pictures.ndim == 4 else 1
        stack = (planes, group.first, total)
        if self._lanes is not None:
            out = self._rows(frames, planes * len(parts) * math.prod(w))
            self._lanes.run("spectra", out, pictures, w, frames, stack, self.shape, parts)
            return out
        fields = self._fields(pictures, w, frames * planes, stack, self.shape, (0, 0))
        samples = math.prod(w)
        out = self._rows(frames, planes * len(parts) * samples)
        pairs, frequencies = (samples + 1) // 2, self._blocks * WIDTH
        device = self.device
        size = (1 if device.rows else frequencies, pairs, frames * planes)
        kernel = device.kernel("lattice_spectra.cl", "pack")
        sizes = (*w, planes, len(parts), bits_of(parts), *self._window)
        device.launch(kernel, size, out, fields, *(np.int32(k) for k in sizes))
        return out

    def _fields(
        self,
        pictures: cla.Array,
        w: Pair,
        count: int,
        stack: tuple[int, int, int],
        shape: tuple[int, ...],
        first: Pair,
    ) -> cla.Array:
        """Return the spectra of the pairs of samples, of pictures about the cell ``first``."""
        device, pairs = self.device, (math.prod(w) + 1) // 2
        fields = device.empty((count * pairs, *self._window), np.complex64)
        centred = {"CENTRED": True} if any(first) else {}
        kernel = device.kernel("lattice.cl", "decimate", **centred)
        sizes = (*w, *first, *stack, *shape, *self._window)
        device.launch_rows(kernel, fields.shape, fields, pictures, *(np.int32(k) for k in sizes))
        device.fft.forward(fields, device)
        return fields

    def _unpacked(
        self,
        out: cla.Array,
        spectra: cla.Array,
        w: Pair,
        group: _Group,
        parts: tuple[int, ...],
        total: int,
        minimum: float,
    ) -> None:
        """Write pictures of packed spectra to some planes of stacks of ``total``."""
        device, pairs, frames = self.device, (math.prod(w) + 1) // 2, int(spectra.shape[0])
        planes = group.count
        if self._lanes is not None:
            stack = (planes, group.first, total)
            self._lanes.run("pictures", out, spectra, w, frames, stack, self.shape, parts, minimum)
            return
        fields = device.empty((frames * planes * pairs, *self._window), np.complex64)
        sizes = (*w, planes, len(parts), bits_of(parts), *self._window)
        device.launch_rows(
            device.kernel("lattice_spectra.cl", "unpack"),
            fields.shape, fields, spectra, *(np.int32(k) for k in sizes),
        )  # fmt: skip
        device.fft.inverse(fields, device)
        rows, columns = self.shape
        sizes = (planes, group.first, total, rows, columns, *self._window)
        device.launch_rows(
            device.kernel("lattice.cl", "interleave"),
            (frames * planes, rows * w[0], columns * w[1]),
            out, fields, *(np.int32(k) for k in w), np.float32(minimum),
            *(np.int32(k) for k in sizes),
        )  # fmt: skip

    def _matrices(self, group: _Group) -> Iterator[tuple[tuple[int, int], cla.Array]]:
        """Yield the matrix of some planes, in pieces if it does not fit.

        Each piece comes with its rows (start, stop) of the packed spectra of the planes.
        """
        for piece in self._pieces(group):
            matrix = self._cached(group, partial(self._assembled, group, *piece))
            yield piece, matrix
            del matrix

    def _pieces(self, group: _Group) -> list[tuple[int, int]]:
        """Return the rows (start, stop) of spectra of each piece of a matrix."""
        rows, voxels = group.count * self._rows_of_plane, math.prod(self._cell.voxels)
        if self._piece >= voxels:
            return [(0, rows)]
        return [
            (start, min(start + self._piece, part + voxels))
            for part in range(0, rows, voxels)
            for start in range(part, part + voxels, self._piece)
        ]

    def _bytes_of(self, rows: int) -> int:
        """Return the bytes of the matrix of some rows of spectra."""
        return 4 * self._blocks * WIDTH * math.prod(self._cell.pixels) * rows

    @property
    def _pictures(self) -> int:
        """Number of point images of a plane and a part from which a matrix is assembled."""
        return (math.prod(self._cell.voxels) + 1) // 2

    def _assembled(self, group: _Group, start: int, stop: int) -> cla.Array:
        """Assemble the matrix of some rows of the spectra of planes from their point images."""
        cell, device = self._cell, self.device
        rows, voxels, columns = math.prod(cell.pixels), math.prod(cell.voxels), stop - start
        matrix = device.empty((self._blocks, rows, columns, WIDTH), np.float32)
        kernel = device.kernel("lattice_spectra.cl", "assemble")
        for number, (index, part) in enumerate(product(range(group.count), cell.parts)):
            plane, first = group.first + index, number * voxels - start  # below 0 in a later piece
            reach = self.images.reaches[plane]
            across = (2 * reach[0] + 1, 2 * reach[1] + 1)
            pairs = range(max(0, (1 - first) // 2), min(self._pictures, (columns - first + 1) // 2))
            step = self._image_batch
            for batch in (pairs[k : k + step] for k in range(0, len(pairs), step)):
                pictures = device.upload(self._part_images(plane, part, batch.start, len(batch)))
                stack = (len(batch), 0, len(batch))
                fields = self._fields(pictures, cell.pixels, len(batch), stack, across, reach)
                sizes = (batch.start, rows, voxels, first, columns, part & 1, *self._window)
                size = (1 if device.rows else self._blocks * WIDTH, (rows + 1) // 2, len(batch))
                device.launch(kernel, size, matrix, fields, *(np.int32(k) for k in sizes))
        return matrix

    def _part_images(self, plane: int, part: int, start: int, count: int) -> Vector:
        """Return ``count`` point images of a plane, numbered up to the central voxel of a cell."""
        shape = self.images.stored[plane].shape[1:]
        pictures = np.empty((count, *shape), np.float32)
        for picture, t in zip(pictures, range(start, start + count), strict=True):
            picture[:] = self.images.part(plane, divmod(t, self._cell.voxels[1]), part)
        return pictures

    @property
    def _image_batch(self) -> int:
        """Number of point images that are transformed together."""
        nbytes = 8 * math.prod(self._window) * ((math.prod(self._cell.pixels) + 1) // 2)
        return max(1, min(self._pictures, FIELD_BYTES // nbytes))


def _available_bytes(device: Device) -> int:
    """Return the memory that matrices may take, in bytes."""
    memory = min(device.memory_bytes, free_memory()) if device.is_cpu else device.memory_bytes
    return int(memory) // MEMORY_DIVISOR
