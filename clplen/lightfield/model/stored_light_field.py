"""Light fields in files or arrays, read part by part, and conversion to light fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pyopencl.array as cla
from numpy.typing import ArrayLike

from clplen.checks import host_array, is_array, masked_array
from clplen.compute.arrays import HostArray
from clplen.compute.device import DeviceLike, as_device, require_same_device
from clplen.errors import ShapeError
from clplen.lightfield.model.alpha_law import AlphaLaw
from clplen.lightfield.model.light_field import LightField
from clplen.lightfield.model.sample_checks import (
    check_shape,
    checked_positions,
    checked_spacing,
    checked_weights,
    fill_masked,
    storage_dtype,
    weights_where,
)
from clplen.lightfield.raw.raw_image import CameraModel, RawImage, Spacing

Array = np.ndarray[Any, Any]
Block = tuple[slice, slice, slice, slice]

_BAND = 1 << 20  # bytes of a view that are read together in search of light


@dataclass(frozen=True, eq=False, repr=False)
class StoredLightField(AlphaLaw, HostArray):
    """A light field L[v, u, y, x(, c)] in a file or an array.

    Created by `from_array` or ``clplen.open_lightfield``. `focal_stack`, `stack_tiles`, `depth_map`
    and `all_in_focus` read it whole or in tiles.

    Attributes
    ----------
    shape : tuple of int
        Shape (v, u, y, x[, c]).
    dtype : numpy.dtype
        Storage type on a device: uint8, uint16, float16 or float32.
    fill : callable
        Function of (block, out) that writes the samples of a block, slices over (v, u, y, x), into
        an array of its shape and this dtype. It is called by one thread at a time.
    weights : numpy.ndarray
        Weights of the views, float32, shape (V, U), as in `LightField`.
    chunks : tuple of int
        (rows, columns) of a view that are read at once: (1, x) in plain memory, (y, x) for pictures
        that are decoded as a whole.
    views_at_once : tuple of int
        Rows and columns of views that are read at once.
    overhead : int
        Bytes that reading needs in addition to its result.
    spacing : tuple of float or None
        Signed (dv, du, dy, dx) in metres, as in `LightField`.
    camera : CameraModel or None
        Camera of the light field, if known.
    decode : {"calibrated", "naive"}
        Decoding, as in `LightField`.
    positions : numpy.ndarray or None
        View positions, float64, shape (V, U, 2), in view steps, as in `LightField`.
    parametrisation : {"two-plane", "point-angle"}
        Meaning of a view, as in `LightField`.

    Examples
    --------
    >>> np.save("views.npy", np.ones((5, 5, 32, 48), np.uint8))
    >>> stored = clplen.StoredLightField.from_array(np.load("views.npy", mmap_mode="r"))
    >>> stored
    <StoredLightField (5, 5, 32, 48) uint8, 0 MiB>
    >>> stored.read(np.s_[2:3, 0:5, 0:16, 0:48]).shape  # of the middle row of views
    (1, 5, 16, 48)
    """

    _downloads: ClassVar[bool] = True

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fill: Callable[[Block, Array], None]
    weights: np.ndarray[Any, np.dtype[np.float32]]
    chunks: tuple[int, int]
    views_at_once: tuple[int, int] = (1, 1)
    overhead: int = 0
    spacing: Spacing | None = None
    camera: CameraModel | None = None
    decode: str = "calibrated"
    positions: np.ndarray[Any, np.dtype[np.float64]] | None = None
    parametrisation: str = "two-plane"

    @classmethod
    def from_array(
        cls,
        a: Any,
        *,
        spacing: Spacing | None = None,
        weights: ArrayLike | None = None,
        camera: CameraModel | None = None,
        positions: ArrayLike | None = None,
    ) -> StoredLightField:
        """Wrap an object with ``shape``, ``dtype`` and slices, without reading all of it.

        Parameters
        ----------
        a : array
            Array of shape (v, u, y, x) or (v, u, y, x, c), real: NumPy, a memory map, h5py or Zarr.
        spacing, weights, camera, positions
            Arguments of `LightField.from_array`; for the default weights, views are read until
            light appears in each.

        Returns
        -------
        StoredLightField

        Raises
        ------
        ShapeError, ValueError, TypeError
            Errors of `LightField.from_array`; NaN and infinity are detected on reading.
        """
        shape = tuple(int(n) for n in a.shape)
        check_shape(shape)
        valid = None
        if isinstance(a, np.ma.MaskedArray):
            a, mask = masked_array(a, "A light field")
            if mask is not None:
                a, valid = fill_masked(a, mask)
        chunks = tuple(getattr(a, "chunks", None) or (1, 1, 1, shape[3]))
        bytes_of_chunk = math.prod(chunks) * math.prod(shape[len(chunks) :]) * a.dtype.itemsize
        views_at_once = (int(chunks[0]), int(chunks[1]))
        light_field = cls(
            shape,
            storage_dtype(np.dtype(a.dtype)),
            partial(_copy, a, views_at_once),
            np.ones(shape[:2], np.float32),
            (int(chunks[2]), int(chunks[3])),
            views_at_once,
            2 * bytes_of_chunk,
            checked_spacing(spacing),
            camera,
        )
        view_weights = (
            light_field.lit_weights() if weights is None else checked_weights(weights, light_field)
        )
        if valid is not None:
            view_weights = checked_weights(view_weights * valid, light_field)
        return replace(
            light_field, weights=view_weights, positions=checked_positions(positions, light_field)
        )

    @classmethod
    def from_light_field(cls, lf: LightField | ArrayLike) -> StoredLightField:
        """Wrap a light field on a device, read back part by part."""
        lf = as_lightfield(lf)
        return cls(
            lf.shape,
            lf.dtype,
            partial(_download, lf),
            lf.weights,
            (1, lf.shape[3]),
            spacing=lf.spacing,
            camera=lf.camera,
            decode=lf.decode,
            positions=lf.positions,
            parametrisation=lf.parametrisation,
        )

    def __repr__(self) -> str:
        return f"<StoredLightField {self.shape} {self.dtype}, {self.nbytes / 2**20:,.0f} MiB>"

    def __copy__(self) -> StoredLightField:
        return self  # immutable

    def __deepcopy__(self, memo: dict[int, Any]) -> StoredLightField:
        return self

    def __getstate__(self) -> dict[str, Any]:
        if not isinstance(self.fill, partial):
            raise TypeError(
                "A light field read from a file cannot be pickled; open it in the other "
                "process (clplen.open_lightfield), or pickle the result of load(device)."
            )
        return dict(self.__dict__)

    def to_numpy(self) -> Array:
        """Return all samples."""
        return self.read((slice(None), slice(None), slice(None), slice(None)))

    @property
    def nbytes(self) -> int:
        """Size of all samples in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes of the samples of all views at one pixel."""
        return self.nbytes // (self.shape[2] * self.shape[3])

    def read(self, block: Block, *, out: Array | None = None) -> Array:
        """Read the samples of a block.

        Parameters
        ----------
        block : tuple of slice
            Slices over (v, u, y, x) of step 1; all channels are read.
        out : numpy.ndarray, optional
            Output array, C-contiguous, of the block's shape and this dtype.

        Returns
        -------
        numpy.ndarray
            Samples of shape (v, u, y, x[, c]).

        Raises
        ------
        ShapeError
            If the block is invalid, or ``out`` does not match it.
        FormatError
            If the file is damaged there.
        """
        ends = [part.indices(n) for part, n in zip(block, self.shape, strict=False)]
        if len(ends) != 4 or any(stop <= start or step != 1 for start, stop, step in ends):
            raise ShapeError(
                f"block must be four non-empty slices of step 1 over (v, u, y, x), got {block!r}."
            )
        shape = (*(stop - start for start, stop, _ in ends), *self.shape[4:])
        if out is None:
            out = np.empty(shape, self.dtype)
        if out.shape != shape or out.dtype != self.dtype or not out.flags.c_contiguous:
            raise ShapeError(
                f"out must be a C-contiguous array of shape {shape} ({self.dtype}), got "
                f"{out.shape} ({out.dtype})."
            )
        v, u, y, x = (slice(start, stop) for start, stop, _ in ends)
        self.fill((v, u, y, x), out)
        return out

    def load(self, device: DeviceLike | None = None) -> LightField:
        """Load the light field to a device.

        Parameters
        ----------
        device : Device or str, optional
            Device; default ``Device.open()``.

        Returns
        -------
        LightField

        Raises
        ------
        DeviceError
            If the light field exceeds the device's memory.
        ValueError
            If a sample is NaN or infinite.
        """
        device = as_device(device)
        device.require_memory(self.nbytes, "This light field")
        data = device.empty(self.shape, self.dtype)
        with device.on_host(data) as host:
            v, u, y, x = (slice(0, n) for n in self.shape[:4])
            self.fill((v, u, y, x), host)
        return self.part(data, device)

    def part(self, samples: Any, device: DeviceLike | None = None) -> LightField:
        """Wrap some rows and columns of all views as a light field."""
        lf = LightField.from_array(
            samples,
            device=device,
            spacing=self.spacing,
            weights=self.weights,
            camera=self.camera,
            positions=self.positions,
        )
        return replace(lf, decode=self.decode, parametrisation=self.parametrisation)

    def groups(self) -> Iterator[tuple[slice, slice]]:
        """Yield slices (v, u) of views that are best read together."""
        V, U = self.shape[:2]
        down, across = self.views_at_once
        for v in range(0, V, down):
            for u in range(0, U, across):
                yield slice(v, min(v + down, V)), slice(u, min(u + across, U))

    def lit_weights(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Return 0 for black views, 1 for others or if all are black; read until lit."""
        lit = np.zeros(self.shape[:2], np.bool_)
        ny, nx = self.shape[2:4]
        row = self.dtype.itemsize * math.prod(self.shape[3:])
        rows = self.chunks[0] * max(1, _BAND // (row * self.chunks[0]))
        for v, u in self.groups():
            for start in range(0, ny, rows):
                samples = self.read((v, u, slice(start, min(start + rows, ny)), slice(0, nx)))
                lit[v, u] |= samples.any(axis=tuple(range(2, samples.ndim)))
                if lit[v, u].all():
                    break
        return weights_where(lit)


def _download(lf: LightField, block: Block, out: Array) -> None:
    """Copy a block of a light field on a device."""
    v0, u0, rows, columns = block[0].start, block[1].start, *block[2:]
    for v, u in np.ndindex(*out.shape[:2]):
        out[v, u] = lf.device.download(lf.data[v0 + v, u0 + u, rows])[:, columns]


def _copy(a: Any, views_at_once: tuple[int, int], block: Block, out: Array) -> None:
    """Copy a block of an array, a few views at a time."""
    v0, u0, rows, columns = block[0].start, block[1].start, *block[2:]
    down, across = views_at_once
    with np.errstate(all="ignore"):
        for v in range(0, out.shape[0], down):
            for u in range(0, out.shape[1], across):
                part = out[v : v + down, u : u + across]
                views = slice(v0 + v, v0 + v + part.shape[0]), slice(u0 + u, u0 + u + part.shape[1])
                part[...] = host_array(a[views[0], views[1], rows, columns], "A light field")


def as_lightfield(
    source: Any, streams: str = "", *, device: DeviceLike | None = None
) -> LightField:
    """Return a light field unchanged; upload an array as a light field."""
    if isinstance(source, LightField):
        if device is not None:
            require_same_device(source.device, as_device(device))
        return source
    if isinstance(source, RawImage):
        raise TypeError(
            "This is a raw image, not a light field; decode it with LightField.from_raw, or call "
            "render_focused if its camera is a focused one."
        )
    if isinstance(source, StoredLightField):
        option = f"use {streams}, or .load(device)" if streams else "call .load(device)"
        raise TypeError(f"This light field is stored, not on a device; {option} if it fits.")
    if isinstance(source, cla.Array) or (is_array(source) and not isinstance(source, HostArray)):
        return LightField.from_array(source, device=as_device(device))
    raise TypeError(
        "The light field must be a LightField (LightField.from_array, read_lightfield) or an "
        f"array L[v, u, y, x(, c)], got {type(source).__name__}."
    )
