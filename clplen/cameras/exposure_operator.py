"""Linear map from the energies of a scene to a camera's raw image, with its exact adjoint."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.exposure.exposure_jacobian import (
    ExposureJacobian,
    check_groups,
    exposure_jacobian,
)
from clplen.cameras.exposure.pixel_signals import PixelSignals
from clplen.cameras.exposure.point_gradients import ExposureGradient, array_fields, point_gradients
from clplen.cameras.exposure.scene_parts import (
    SceneImages,
    microscope_parts,
    ray_parts,
    wave_parts,
)
from clplen.cameras.exposure.source_images import PointFields, images_of, point_fields
from clplen.cameras.exposure.wave_exposure import Method
from clplen.cameras.light_field_microscope import Microscope, microscope_images
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.scenes.occluders import Occluder
from clplen.cameras.scenes.scene_sources import Source, as_occluders, as_sources
from clplen.checks import is_finite, real_array, require
from clplen.compute.device import Device
from clplen.compute.linear_map import ArrayMap
from clplen.errors import ShapeError
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.field import Field

Values = np.ndarray[Any, Any]

MEMORY = 2**28  # default bytes of images that are kept: 256 MiB


class ExposureOperator(ArrayMap):
    """Linear map from energies of points and pictures to the raw image, with its adjoint.

    Points and the samples of self-luminous pictures are incoherent, so that their images add up.
    The forward map is ``camera.expose`` without noise. The operator is a `LinearMap` of its
    device: float32, or float64 on a device of double precision.

    Parameters
    ----------
    camera : Plenoptic1, Plenoptic2 or Microscope
        Camera built by `PlenopticCamera`. A microscope exposes points only.
    scene : PointSources, PicturePlane, or list of them and of Occluder
        Sources of the light. Their energies are ignored, but samples of a picture that are 0 stay
        dark.
    model : {"waves", "rays"}
        Wave optics or geometrical rays, as in ``expose``.
    method : {"auto", "points", "local"}
        Method of ``expose``; "auto" never selects "isoplanatic", an approximation.
    coherence : Coherence, optional
        Spectrum for sources without their own.
    memory : int
        Maximum bytes of images that are kept. Images of all points that fit are computed once, by
        the first call; otherwise each call computes them again.

    Attributes
    ----------
    camera, memory
        Arguments of the constructor.
    sources : tuple of PointSources and PicturePlane
        The members of the scene that send light.
    method : str
        "points", "local", "rays" or "microscope": method that computes the image of a point.
    device : Device
        Device of the camera.
    in_shape : tuple of int
        (n,) for n points, or the shape of a picture. For a list: the number of all values,
        concatenated.
    out_shape : tuple of int
        (ny, nx) of the sensor.
    dtype : numpy.dtype
        Data type of input and output.

    Raises
    ------
    SamplingError, ValueError, DeviceError
        If ``expose`` raises, or the scene has slides, whose images are not linear.
    TypeError
        If the camera or the scene has another type.

    Examples
    --------
    >>> camera = clplen.PlenopticCamera.type1(
    ...     focal_length=0.12, mla=clplen.MicrolensArray(150e-6, 10e-3, count=5),
    ...     wavelength=532e-9, pixels_per_lenslet=15, aperture_diameter=0.5e-3)
    >>> points = clplen.PointSources([(0, 0, 0), (2e-4, 0, -5e-3)])
    >>> operator = clplen.cameras.ExposureOperator(camera, points)
    >>> operator
    <ExposureOperator of (2,) to (75, 75), points, ...>
    >>> image = operator.forward([1.0, 0.5])
    >>> from scipy.sparse.linalg import lsqr
    >>> np.round(lsqr(operator.as_linear_operator(), image.ravel())[0], 3).tolist()
    [1.0, 0.5]
    """

    def __init__(
        self,
        camera: Plenoptic | Microscope,
        scene: Source | Sequence[Source | Occluder],
        *,
        model: Literal["waves", "rays"] = "waves",
        method: Method = "auto",
        coherence: Coherence | None = None,
        memory: int = MEMORY,
    ) -> None:
        if not isinstance(camera, Microscope):
            require(Plenoptic, camera, "camera", "PlenopticCamera.type1")
        if not (is_finite(memory) and memory >= 0):
            raise ValueError(f"memory must be a number of bytes >= 0, got {memory!r}.")
        if model not in ("waves", "rays"):
            raise ValueError(f"model must be 'waves' or 'rays', got {model!r}.")
        self.camera, self.memory = camera, memory
        self.sources, occluders = as_sources(scene), as_occluders(scene)
        if isinstance(camera, Microscope):
            if occluders or (model, method) != ("waves", "auto"):
                raise ValueError(
                    "Occluders, model and method apply to plenoptic cameras only: leave them out "
                    "for a microscope."
                )
            lines = camera.lines(coherence)
            parts = microscope_parts(self.sources, lines, camera, microscope_images)
        else:
            optics = replace(camera.optics, occluders=occluders)
            make_parts = ray_parts if model == "rays" else wave_parts
            parts = make_parts(optics, self.sources, coherence, method)
        self._parts = tuple(parts)
        self._images = SceneImages(self._parts, memory)
        self.method = self._parts[0].route
        self.device: Device = camera.device
        single_shape = self._parts[0].shape if len(self._parts) == 1 else None
        self.in_shape: tuple[int, ...] = single_shape or (sum(part.size for part in self._parts),)
        self.out_shape: tuple[int, ...] = camera.grid.shape
        pixels = camera.pixels if model == "waves" else None  # the ray model has no pixel response
        filters = int(self._parts[0].lines[0].weights.shape[1])
        self._signals = PixelSignals(pixels or PixelArray(), filters, camera.grid.shape)

    def __repr__(self) -> str:
        return (
            f"<ExposureOperator of {self.in_shape} to {self.out_shape}, {self.method}, "
            f"{self.device.name}>"
        )

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of input and output."""
        return np.dtype(self.device.real)

    @property
    def nbytes(self) -> int:
        """Bytes of images that are kept at present."""
        return self._images.nbytes

    @property
    def positions(self) -> Values:
        """Positions (x, y, dz) of all points that send light, in metres, shape (n, 3)."""
        return np.concatenate([part.points.positions for part in self._parts])

    def forward_data(self, data: cla.Array) -> cla.Array:
        """Apply `forward` to arrays of the device."""
        leading = data.shape[: data.ndim - len(self.in_shape)]
        count, device = int(np.prod(leading, dtype=np.int64)), self.device
        if count == 0:
            return device.empty((*leading, *self.out_shape), self.dtype)
        values = device.download(data).astype(np.float64).reshape(count, -1)
        totals = device.zeros((self._signals.filters * count, *self.out_shape), device.real)
        for part, line, images in self._images:
            energies = self._images.energies(values, part)[:, images.indices]
            signal = np.einsum("bnc,cf->fbn", energies, line.weights)
            images.add(totals, signal.reshape(-1, len(images.indices)))
        device.finish()
        return self._signals.read(totals, device).reshape(*leading, *self.out_shape)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """Apply `adjoint` to arrays of the device."""
        leading = data.shape[:-2]
        count = int(np.prod(leading, dtype=np.int64))
        gradients = [np.zeros((count, part.size)) for part in self._parts]
        if count == 0:
            return self.device.empty((*leading, *self.in_shape), self.dtype)
        pictures = self._signals.read_adjoint(data.reshape(count, *self.out_shape), self.device)
        for part, line, images in self._images:
            inner = images.inner(pictures).reshape(self._signals.filters, count, -1)
            part_gradients = gradients[part].reshape(count, -1, self._parts[part].channels)
            indices = self._parts[part].indices[images.indices]
            part_gradients[:, indices] += np.einsum("fbn,cf->bnc", inner, line.weights)
        values = np.concatenate(gradients, axis=1).reshape(*leading, *self.in_shape)
        return self.device.upload(np.ascontiguousarray(values, self.dtype))

    def gradient(self, values: Any, cotangent: Any) -> ExposureGradient:
        """Compute derivatives of a loss with respect to energies and positions of the points.

        Light propagates back through the camera once for each point, for all three coordinates.

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.
        cotangent : array_like
            Derivatives of the loss with respect to the pixels, shape (ny, nx).

        Returns
        -------
        ExposureGradient

        Raises
        ------
        ValueError
            If images of points are computed by rays or in windows, whose positions move in steps,
            or aberrations have no derivative in closed form.
        ShapeError
            If the arrays have another shape.
        """
        return self._gradient(self._energies(values), cotangent, {})

    def vjp(self, values: Any) -> tuple[Values, Callable[[Any], ExposureGradient]]:
        """Return the raw image and a function that computes the `gradient` from a cotangent.

        Fields of all points stay on the device, so that image and gradient together take the time
        of two images.

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.

        Returns
        -------
        numpy.ndarray, callable
            Raw image of these energies, and a function that maps derivatives of a loss with respect
            to its pixels, shape (ny, nx), to an `ExposureGradient`.

        Raises
        ------
        ValueError, ShapeError
            If `gradient` would raise.
        DeviceError
            If the fields do not fit the device.
        """
        energies, device = self._energies(values), self.device
        count = sum(len(part.points) * len(part.lines) for part in self._parts)
        nbytes = math.prod(self.out_shape) * np.dtype(device.complex).itemsize * count
        device.require_memory(nbytes, "The fields of all points of this exposure")
        totals = device.zeros((self._signals.filters, *self.out_shape), device.real)
        stored_fields: dict[int, list[PointFields]] = {}
        for number, (index, line) in enumerate(self._images.lines()):
            stored_fields[number] = []
            for fields in point_fields(line.optics, self._parts[index].points):
                signal = (energies[index][fields.indices] @ line.weights).T
                images_of(line.optics, fields).add(totals, signal)
                stored_fields[number].append(replace(fields, at_array=None))
        image = device.download(self._signals.read(totals, device))[0]
        return image, lambda cotangent: self._gradient(energies, cotangent, stored_fields)

    def _gradient(
        self, energies: list[Values], cotangent: Any, stored_fields: dict[int, list[PointFields]]
    ) -> ExposureGradient:
        """Return the gradient from energies (n, channels) of each part and stored fields."""
        pictures = self._pictures(cotangent)
        by_value = [np.zeros((part.indices.size, part.channels)) for part in self._parts]
        by_position = [np.zeros((len(part.points), 3)) for part in self._parts]
        for number, (index, line) in enumerate(self._images.lines()):
            points, signal = self._parts[index].points, (energies[index] @ line.weights).T
            point_gradient = point_gradients(
                line.optics, points, signal, pictures, stored_fields.get(number)
            )
            by_value[index] += point_gradient.energies.T @ line.weights.T
            by_position[index] += point_gradient.positions
        flat = [part.spread(value) for part, value in zip(self._parts, by_value, strict=True)]
        gradient = np.concatenate(flat).reshape(self.in_shape).astype(self.dtype)
        return ExposureGradient(gradient, np.concatenate(by_position))

    def lenslet_fields(self, values: Any, cotangent: Any) -> Iterator[tuple[Field, Field]]:
        """Yield fields before the lenslets, and gradients of a loss with respect to fields behind.

        A gradient by any parameter p of the array follows from them: with the transmission t of
        the array, dL/dp is the sum over all fields of Re(conj(g) u dt/dp).

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.
        cotangent : array_like
            Derivatives of the loss with respect to the pixels, shape (ny, nx).

        Yields
        ------
        tuple of Field
            u and g = dL/dRe + i dL/dIm of a batch of points at one wavelength, shape (n, ny, nx) on
            the camera's grid. Every point of the scene occurs once for each wavelength.

        Raises
        ------
        ValueError
            If images of points are computed by rays or in windows.
        ShapeError
            If the arrays have another shape.
        """
        energies, pictures = self._energies(values), self._pictures(cotangent)
        for index, line in self._images.lines():
            signal = (energies[index] @ line.weights).T
            yield from array_fields(line.optics, self._parts[index].points, signal, pictures)

    def lenslet_gradient(self, values: Any, cotangent: Any) -> dict[str, Any]:
        """Compute derivatives of a loss with respect to the array of lenslets.

        All distances behind the array are constant, even if the focal length changes.

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.
        cotangent : array_like
            Derivatives of the loss with respect to the pixels, shape (ny, nx).

        Returns
        -------
        dict of str to float or numpy.ndarray
            Keys of `MicrolensArray.gradient`: "pitch", "diameter", "offset", "rotation",
            "focal_length" and others.

        Raises
        ------
        ValueError
            If images of points are computed by rays or in windows, or the lenslets depart from
            thin lenses.
        ShapeError
            If the arrays have another shape.
        """
        self._require_thin_lenslets()
        totals: dict[str, Any] = {}
        for before, behind in self.lenslet_fields(values, cotangent):
            gradient = self.camera.mla.gradient(before, behind)
            totals = {name: totals.get(name, 0.0) + part for name, part in gradient.items()}
        return totals

    def jacobian(
        self, values: Any, *, by: str | Sequence[str] = ("values", "positions")
    ) -> ExposureJacobian:
        """Compute derivatives of every pixel, for Gauss-Newton and for Cramer-Rao bounds.

        This is the forward mode of `gradient`, `lenslet_gradient` and `sensor_gradient`: J' times
        a cotangent equals their results. Each coordinate of a position takes one pass of light
        through the camera; each parameter of the array and the sensor take a pass from the lenslets
        on. All distances behind the array are constant.

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.
        by : str or sequence of str
            Parameter groups: "values" (energies), "positions", "lenslets" and "sensor". The host
            stores 8 bytes a pixel for each energy, 24 for each position, at least 56 for the
            lenslets and 24 for the sensor, and as much again while a batch of points passes. The
            device needs the memory of a `gradient`, and at least 6 more fields for the lenslets.

        Returns
        -------
        ExposureJacobian

        Raises
        ------
        ValueError
            If images of points are computed by rays or in windows, aberrations have no derivative
            in closed form, or the lenslets depart from thin lenses.
        ShapeError
            If the energies have another shape.
        MemoryError
            If the derivatives do not fit the host.
        DeviceError
            If the fields do not fit the device.
        """
        energies, names = self._energies(values), check_groups(by)
        if "lenslets" in names:
            self._require_thin_lenslets()
        jacobian = exposure_jacobian(self._images, self._signals, energies, names)
        if jacobian.values is None:
            return jacobian
        return replace(jacobian, values=jacobian.values.reshape(*self.in_shape, *self.out_shape))

    def sensor_gradient(self, values: Any, cotangent: Any) -> dict[str, Any]:
        """Compute derivatives of a loss with respect to the position of the sensor.

        Parameters
        ----------
        values : array_like
            Energies of shape ``in_shape``.
        cotangent : array_like
            Derivatives of the loss with respect to the pixels, shape (ny, nx).

        Returns
        -------
        dict of str to float or numpy.ndarray
            "shift" (per metre) and "tilt" (y, x): derivatives with respect to sensor_shift and
            sensor_tilt of `Aberrations`.

        Raises
        ------
        ValueError, ShapeError
            If `gradient` would raise.
        """
        energies, raw = self._energies(values), self._raw(cotangent)
        derivatives = exposure_jacobian(self._images, self._signals, energies, ("sensor",)).sensor
        shift, tilt = ((derivatives[name] * raw).sum(axis=(-2, -1)) for name in ("shift", "tilt"))
        return {"shift": float(shift), "tilt": tilt}

    def _require_thin_lenslets(self) -> None:
        camera = self.camera
        if isinstance(camera, Plenoptic) and camera.aberrations.bends_lenslets:
            raise ValueError(
                "Gradients by the array require thin lenslets, but this camera's lenslets are "
                "aberrated: use lenslet_fields, or a camera without lenslets= and scatter=."
            )

    def _energies(self, values: Any) -> list[Values]:
        """Return energies (n, channels) of each part, checked for gradients by fields."""
        if self.method != "points":
            raise ValueError(
                "Gradients by positions and lenslets require a plenoptic camera with "
                f"method='points', got {self.method!r}: use method='points' and a camera whose "
                "pixels sample the light."
            )
        energies = real_array(values, "values", np.float64)
        if energies.shape != self.in_shape:
            raise ShapeError(
                f"Energies of a gradient must have shape {self.in_shape}, got {energies.shape}."
            )
        flat = energies.reshape(1, -1)
        return [self._images.energies(flat, index)[0] for index in range(len(self._parts))]

    def _pictures(self, cotangent: Any) -> Values:
        """Return derivatives by the light behind each filter, shape (filters, ny, nx)."""
        return self._signals.adjoint(self._raw(cotangent)[None])[:, 0]

    def _raw(self, cotangent: Any) -> Values:
        """Return a checked cotangent of the raw image."""
        raw = real_array(cotangent, "A cotangent", np.float64)
        if raw.shape != self.out_shape:
            raise ShapeError(
                f"A cotangent must have the raw image's shape {self.out_shape}, got {raw.shape}."
            )
        return raw
