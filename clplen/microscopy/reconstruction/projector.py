"""Volumes to frames of a light-field microscope and back, as exact adjoints.

The point images of v x v voxels and n x n pixels a lenslet are n^2 v^2 small convolutions on the
lattice of lenslets: at each of its frequencies a matrix of n^2 by v^2 for each plane. Transforms
are those of the lattice, not of the frame; in the basis of lattice_spectra.cl the matrices are real
and those of y and -y are the same, so that a quarter of the numbers is kept and every one that is
read serves four columns. Other arrays have cells of several lenslets (cells.py) in place of one; an
array that a mirror changes has two or four such matrices.
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

WHOLE = (0,)  # the parts of a picture that is not taken apart
WIDTH = 16  # frequencies of a block: see lattice_spectra.cl
HEIGHT = 5  # rows of a result in registers
DEPTH = 40  # terms of them, whose part of a matrix stays in the first-level cache
PANEL = 150  # rows of a result in the second
GROUP_BYTES = 2**28  # of matrices of some planes together, where they are made anew
KEPT_BYTES = 2**30  # and where they are kept: frames are read and written once for each group
PIECE_BYTES = 2**24  # of the matrix of some voxels of a plane, where a plane's has no room
FIELD_BYTES = 2**23  # of spectra of point images together
SHARE = 2  # matrices are kept where they take less than this part of the memory


@dataclass(frozen=True)
class _Group:
    """Some neighbouring planes that are projected together."""

    first: int
    count: int


FRAME = _Group(0, 1)


class Projector(VolumeProjector):
    """Forward and backward projection with the point images of a microscope.

    A volume has shape (..., planes, rows v, columns v): voxel (z, i v + sy, k v + sx) is voxel
    (sy, sx) of lenslet (i, k) in the plane ``images.planes[z]``; its frame has shape (..., rows n,
    columns n). Nothing lies outside the volume. Leading axes are frames, projected together.

    Of an array that is not square, or of several kinds of lenslets, lenslets are those cells that
    ``images.cell`` describes, with (vy, vx) voxels and (ny, nx) pixels.

    Parameters
    ----------
    images : PointImages
        Of the microscope, as `point_images` simulates them.
    shape : tuple of int
        (rows, columns) of lenslets, or of cells.
    device : Device or str, optional
        None is ``Device.open()``.
    memory : int, optional
        Bytes for matrices; where they need more they are made anew for some planes, or some voxels
        of a plane, at a time, which is slower. Default: half of the device's memory, of a CPU half
        of what is free.

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

    images: PointImages
    _between = 0  # pixels on the device beside those of a frame

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
        allowed = _room(device) if memory is None else memory
        self.resident = self.nbytes <= allowed
        largest = min(KEPT_BYTES, int(device.cl_device.max_mem_alloc_size))
        together = max(1, min(largest if self.resident else GROUP_BYTES, allowed) // plane)
        self._groups = [
            _Group(first, min(together, planes - first)) for first in range(0, planes, together)
        ]
        voxels, pairs = math.prod(cell.voxels), self._pictures
        if plane > allowed:
            one = 2 * plane // self._rows_of_plane
            pairs = min(pairs, max(1, max(allowed, PIECE_BYTES) // one))
        self._piece = voxels if pairs == self._pictures else 2 * pairs
        self._spare: dict[tuple[int, ...], list[cla.Array]] = {}
        self.require_memory(1)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is on the device, which is made again when needed."""
        return super().__getstate__() | {"_spare": {}}

    @property
    def lenslets(self) -> tuple[int, int]:
        """(rows, columns) of lenslets that the volume lies under."""
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
        """Rows of the spectra of a plane: voxels of a cell, in every part."""
        return math.prod(self._cell.voxels) * len(self._cell.parts)

    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        together, n = self._groups[0].count, math.prod(self._cell.pixels)
        whole = together * self._rows_of_plane
        start, stop = self._pieces(self._groups[0])[0]
        matrices = self.nbytes if self.resident else self._bytes_of(stop - start)
        rows = n + whole + (stop - start if stop < whole else 0)
        spectra = 4 * WIDTH * 4 * self._blocks * rows
        window = 4 * math.prod(self._window)
        if self._lanes is None:
            fields = window * max(frames * rows, 2 * n * self._together)
        else:
            fields = max(self._lanes.nbytes(frames * rows), window * 2 * n * self._together)
        kept = volumes * math.prod(self.volume_shape) + pictures * math.prod(self.frame_shape)
        self.device.require_memory(
            matrices + fields + frames * (spectra + 4 * (kept + self._between)),
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
                part, sizes = self._taken(spectra, start, stop), (rows, stop - start)
                device.launch(
                    kernel, self._size(rows), total, matrix, part,
                    *(np.int32(k) for k in (*sizes, self._blocks, frames)),
                    operations=8.0 * frames * matrix.size,
                )  # fmt: skip
                if part is not spectra:
                    self._lay_by(part)
                added = {"ADD": True}
                del matrix  # where it is not kept its memory is that of the next one
            self._lay_by(spectra)
        out = device.empty((frames, *self._model_shape), np.float32)
        self._unpacked(out, total, cell.pixels, FRAME, WHOLE, 1, 0.0 if clamp else -math.inf)
        self._lay_by(total)
        return out

    def back_project(self, frames: cla.Array) -> cla.Array:
        cell, device, count = self._cell, self.device, int(frames.shape[0])
        spectra = self._packed(frames, cell.pixels, FRAME, WHOLE)
        out = device.empty((count, *self.volume_shape), np.float32)
        planes, n = self.volume_shape[0], math.prod(cell.pixels)
        kernel = device.kernel("projector.cl", "backward", **self._form)
        for group in self._groups:
            columns = group.count * self._rows_of_plane
            found = self._rows(count, columns)
            for (start, stop), matrix in self._matrices(group):
                part = found if stop - start == columns else self._rows(count, stop - start)
                sizes = (n, stop - start, self._blocks, count)
                device.launch(
                    kernel, self._size(stop - start), part, matrix, spectra,
                    *(np.int32(k) for k in sizes), operations=8.0 * count * matrix.size,
                )  # fmt: skip
                del matrix
                if part is not found:
                    self._move_rows(found, part, to=start)
                    self._lay_by(part)
            self._unpacked(out, found, cell.voxels, group, cell.parts, planes, -math.inf)
            self._lay_by(found)
        self._lay_by(spectra)
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
        """Room for packed spectra, that of earlier ones where it fits.

        Pages of new memory are cleared by the system, which takes as long as a transform. What is
        laid by belongs to nobody, and the queue runs in order: it is never written too early.
        """
        shape = (frames, self._blocks, rows, 4, WIDTH)
        try:
            return self._spare[shape].pop()
        except (KeyError, IndexError):
            pass
        for other in list(self._spare):
            if other[0] != frames:
                self._spare.pop(other, None)
        return self.device.empty(shape, np.float32)

    def _lay_by(self, rows: cla.Array) -> None:
        """Keep the room of spectra that are no longer needed, on a CPU."""
        if self.device.rows:
            self._spare.setdefault(rows.shape, []).append(rows)

    def _taken(self, spectra: cla.Array, start: int, stop: int) -> cla.Array:
        """Some rows of packed spectra."""
        frames, _, rows = spectra.shape[:3]
        if stop - start == rows:
            return spectra
        taken = self._rows(int(frames), stop - start)
        self._move_rows(taken, spectra, start=start)
        return taken

    def _move_rows(self, into: cla.Array, of: cla.Array, *, start: int = 0, to: int = 0) -> None:
        """Copy as many rows of packed spectra as both have, from and to some row on."""
        row, count = 4 * WIDTH * 4, math.prod(of.shape[:2])  # bytes; frames and blocks
        there, here = int(of.shape[2]), int(into.shape[2])
        self.device.copy_lines(
            into, of, (row * min(there, here), count),
            (row * start, row * there), (row * to, row * here),
        )  # fmt: skip

    def _packed(
        self, pictures: cla.Array, w: Pair, group: _Group, parts: tuple[int, ...]
    ) -> cla.Array:
        """Spectra of pictures with wy x wx samples a cell, as lattice_spectra.cl packs them."""
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
        """Spectra of the pairs of samples; with ``first`` of pictures about that cell."""
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
        least: float,
    ) -> None:
        """Pictures from packed spectra into some planes of stacks of ``total``."""
        device, pairs, frames = self.device, (math.prod(w) + 1) // 2, int(spectra.shape[0])
        planes = group.count
        if self._lanes is not None:
            stack = (planes, group.first, total)
            self._lanes.run("pictures", out, spectra, w, frames, stack, self.shape, parts, least)
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
            out, fields, *(np.int32(k) for k in w), np.float32(least),
            *(np.int32(k) for k in sizes),
        )  # fmt: skip

    def _matrices(self, group: _Group) -> Iterator[tuple[tuple[int, int], cla.Array]]:
        """The matrix of some planes, kept where there is room; else piece by piece, with its rows.

        Rows (start, stop) are those of the packed spectra of the planes.
        """
        for piece in self._pieces(group):
            matrix = self._made_once(group, partial(self._assembled, group, *piece))
            yield piece, matrix
            del matrix

    def _pieces(self, group: _Group) -> list[tuple[int, int]]:
        """Rows of spectra whose matrix is made at once."""
        rows, voxels = group.count * self._rows_of_plane, math.prod(self._cell.voxels)
        if self._piece >= voxels:
            return [(0, rows)]
        return [
            (start, min(start + self._piece, part + voxels))
            for part in range(0, rows, voxels)
            for start in range(part, part + voxels, self._piece)
        ]

    def _bytes_of(self, rows: int) -> int:
        """Bytes of the matrix of some rows of spectra."""
        return 4 * self._blocks * WIDTH * math.prod(self._cell.pixels) * rows

    @property
    def _pictures(self) -> int:
        """Point images of a plane and a part from which a matrix is assembled."""
        return (math.prod(self._cell.voxels) + 1) // 2

    def _assembled(self, group: _Group, start: int, stop: int) -> cla.Array:
        """The matrix of some rows of the spectra of planes from their point images."""
        cell, device = self._cell, self.device
        rows, voxels, columns = math.prod(cell.pixels), math.prod(cell.voxels), stop - start
        matrix = device.empty((self._blocks, rows, columns, WIDTH), np.float32)
        kernel = device.kernel("lattice_spectra.cl", "assemble")
        for number, (place, part) in enumerate(product(range(group.count), cell.parts)):
            plane, first = group.first + place, number * voxels - start  # below 0: of a piece
            reach = self.images.reaches[plane]
            across = (2 * reach[0] + 1, 2 * reach[1] + 1)
            pairs = range(max(0, (1 - first) // 2), min(self._pictures, (columns - first + 1) // 2))
            for some in (
                pairs[k : k + self._together] for k in range(0, len(pairs), self._together)
            ):
                pictures = device.upload(self._of_part(plane, part, some.start, len(some)))
                stack = (len(some), 0, len(some))
                fields = self._fields(pictures, cell.pixels, len(some), stack, across, reach)
                sizes = (some.start, rows, voxels, first, columns, part & 1, *self._window)
                size = (1 if device.rows else self._blocks * WIDTH, (rows + 1) // 2, len(some))
                device.launch(kernel, size, matrix, fields, *(np.int32(k) for k in sizes))
        return matrix

    def _of_part(self, plane: int, part: int, start: int, count: int) -> Vector:
        """Some point images of a plane, numbered up to the voxel in the middle of the cell."""
        shape = self.images.stored[plane].shape[1:]
        pictures = np.empty((count, *shape), np.float32)
        for picture, t in zip(pictures, range(start, start + count), strict=True):
            picture[:] = self.images.part(plane, divmod(t, self._cell.voxels[1]), part)
        return pictures

    @property
    def _together(self) -> int:
        """Voxels of a cell whose images are transformed together."""
        one = 8 * math.prod(self._window) * ((math.prod(self._cell.pixels) + 1) // 2)
        return max(1, min(self._pictures, FIELD_BYTES // one))


def _room(device: Device) -> int:
    """Bytes that matrices may take."""
    there = min(device.memory_bytes, free_memory()) if device.is_cpu else device.memory_bytes
    return int(there) // SHARE
