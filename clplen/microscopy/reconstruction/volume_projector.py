"""Base class of the projectors of microscopes: checks, cache of matrices, linear map."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl.array as cla

from clplen.checks import finite_batch, is_finite, is_integer
from clplen.compute.device import Device
from clplen.errors import ShapeError
from clplen.microscopy.model.cells import Pair
from clplen.microscopy.model.point_image_files import AnyImages

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

Vector = np.ndarray[Any, Any]


class VolumeProjector(ABC):
    """Forward and backward projection between volumes and frames of a microscope."""

    images: AnyImages
    device: Device
    shape: Pair
    volume_shape: tuple[int, int, int]
    frame_shape: Pair
    resident: bool

    def __init__(
        self, images: AnyImages, shape: Any, name: str, device: Device, memory: Any
    ) -> None:
        """Check and store the arguments; ``what`` names the shape in messages."""
        self.images, self.device = images, device
        self.shape = checked_pair(shape, name)
        if memory is not None and not (is_finite(memory) and memory >= 0):
            raise ValueError(f"memory must be a number of bytes or None, got {memory!r}.")
        self._cache: dict[Hashable, Any] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without matrices, which are computed again when needed."""
        return self.__dict__ | {"_cache": {}}

    def _cached(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the matrices of some planes, from the cache if the matrices of all planes fit."""
        matrices = self._cache.get(key)
        if matrices is None:
            matrices = make()
            if self.resident:
                self._cache[key] = matrices
        return matrices

    def __repr__(self) -> str:
        size = f"{self.volume_shape} to {self.frame_shape}"
        return f"<{type(self).__name__} of {size}, {self.device.name}>"

    @property
    @abstractmethod
    def degenerate(self) -> tuple[float, ...]:
        """Depths z in metres of the planes in which lenslets resolve no detail."""

    @abstractmethod
    def require_memory(self, frames: int, *, volumes: int = 1, pictures: int = 1) -> None:
        """Raise `DeviceError` if the arrays of ``frames`` frames do not fit the device.

        Each frame needs ``volumes`` volumes and ``pictures`` pictures on the device.
        """

    @abstractmethod
    def project(self, volumes: cla.Array, *, clamp: bool = True) -> cla.Array:
        """Project volumes (frames, planes, rows, columns) on the device, like `forward`."""

    @abstractmethod
    def back_project(self, frames: cla.Array) -> cla.Array:
        """Project frames (frames, ny, nx) on the device back, like `backward`."""

    def forward(self, volume: Any, *, clamp: bool = True) -> Vector:
        """Project volumes to frames.

        Parameters
        ----------
        volume : array_like
            Energy of every voxel, shape (..., planes, rows, columns).
        clamp : bool
            True to set negative pixels, caused by rounding, to 0 for Poisson statistics. A volume
            with negative voxels needs False.

        Returns
        -------
        numpy.ndarray
            Frames, float32, shape (..., ny, nx).

        Raises
        ------
        ShapeError
            If the volume has another shape, or is empty.
        ValueError
            If a voxel is not finite.
        TypeError
            If the volume is not an array of real numbers.
        DeviceError
            If the frames do not fit the device.
        """
        values = finite_batch(volume, self.volume_shape, "A volume")
        self.require_memory(len(values))
        frames = self.project(self.device.upload(values), clamp=clamp)
        return self.device.download(frames).reshape(*np.shape(volume)[:-3], *self.frame_shape)

    def backward(self, frame: Any) -> Vector:
        """Apply the adjoint: sum each frame weighted by the image of every voxel.

        Parameters
        ----------
        frame : array_like
            Frames, shape (..., ny, nx).

        Returns
        -------
        numpy.ndarray
            Volumes, float32, shape (..., planes, rows, columns).

        Raises
        ------
        ShapeError
            If the frame has another shape, or is empty.
        ValueError
            If a pixel is not finite.
        TypeError
            If the frame is not an array of real numbers.
        DeviceError
            If the frames do not fit the device.
        """
        values = finite_batch(frame, self.frame_shape, "A frame")
        self.require_memory(len(values))
        volumes = self.back_project(self.device.upload(values))
        return self.device.download(volumes).reshape(*np.shape(frame)[:-2], *self.volume_shape)

    adjoint = backward  # common name of all linear maps

    @property
    def in_shape(self) -> tuple[int, int, int]:
        """Shape of the argument of `forward_data`, that of a volume."""
        return self.volume_shape

    @property
    def out_shape(self) -> Pair:
        """Shape of the result of `forward_data`, that of a frame."""
        return self.frame_shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of volumes and frames, float32."""
        return np.dtype(np.float32)

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Return H x of volumes on the device with any leading axes, without clamping."""
        frames = self.project(data.reshape(-1, *self.volume_shape), clamp=False)
        return frames.reshape(*data.shape[:-3], *self.frame_shape)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Return H' y of frames on the device with any leading axes."""
        volumes = self.back_project(data.reshape(-1, *self.frame_shape))
        return volumes.reshape(*data.shape[:-2], *self.volume_shape)

    def as_linear_operator(self) -> LinearOperator:
        """Return H for solvers of SciPy: raveled volumes and frames, float32, no clamping."""
        from scipy.sparse.linalg import LinearOperator

        return LinearOperator(
            (math.prod(self.frame_shape), math.prod(self.volume_shape)),
            matvec=lambda x: self.forward(np.reshape(x, self.volume_shape), clamp=False).ravel(),
            rmatvec=lambda y: self.backward(np.reshape(y, self.frame_shape)).ravel(),
            dtype=np.float32,
        )


def checked_pair(shape: Any, name: str) -> Pair:
    """Return two positive whole numbers."""
    if np.shape(shape) != (2,) or any(not is_integer(n) or n < 1 for n in shape):
        raise ShapeError(f"shape must be {name}, got {shape!r}.")
    return int(shape[0]), int(shape[1])


def frames_together(frames: int) -> str:
    """Return the name of a projection in messages about memory."""
    return f"The projection of {'one frame' if frames == 1 else f'{frames} frames together'}"
