"""A camera's map from the energies of a scene to the raw image, and its exact adjoint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyopencl.array as cla

from clplen.cameras.camera_base import Plenoptic
from clplen.cameras.exposure.pixel_signals import PixelSignals
from clplen.cameras.exposure.point_gradients import (
    ExposureGradient,
    array_fields,
    point_gradients,
)
from clplen.cameras.exposure.scene_parts import (
    SceneLine,
    ScenePart,
    microscope_parts,
    ray_parts,
    wave_parts,
)
from clplen.cameras.exposure.source_images import SourceImages
from clplen.cameras.exposure.wave_exposure import Method
from clplen.cameras.light_field_microscope import Microscope
from clplen.cameras.optics.pixel_array import PixelArray
from clplen.cameras.scenes.occluders import Occluder
from clplen.cameras.scenes.scene_sources import Source, as_occluders, as_sources
from clplen.checks import is_finite, require
from clplen.compute.device import Device
from clplen.compute.linear_map import linear_operator, mapped
from clplen.errors import ShapeError
from clplen.wave.coherence.coherence import Coherence
from clplen.wave.field.field import Field

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

Values = np.ndarray[Any, Any]

MEMORY = 2**28  # bytes of images that are kept


class ExposureOperator:
    """The map from energies of points and pictures to the raw image, linear, with its adjoint.

    Points and the samples of self-luminous pictures are incoherent, so that their images add up.
    The forward map is what ``camera.expose`` computes, without noise. It is a `LinearMap` of its
    device: float32, or float64 on a device of double precision.

    Parameters
    ----------
    camera : Plenoptic1, Plenoptic2 or Microscope
        As `PlenopticCamera` makes them. A microscope exposes points only.
    scene : PointSources, PicturePlane, or list of them and of Occluder
        Where the light comes from; its own energies do not count, but samples of a picture that
        are 0 stay dark.
    model : {"waves", "rays"}
        Wave optics or geometrical rays, as in ``expose``.
    method : {"auto", "points", "local"}
        As in ``expose``; "auto" is never "isoplanatic", which is not exact.
    coherence : Coherence, optional
        Its spectrum is that of sources without one.
    memory : int
        Bytes of images that may be kept. Where the images of all points take less, they are
        computed once, by the first call; else by each call anew.

    Attributes
    ----------
    camera, memory
        As given.
    sources : tuple of PointSources and PicturePlane
        The members of the scene that send light.
    method : str
        "points", "local", "rays" or "microscope": how the image of a point is computed.
    device : Device
        That of the camera.
    in_shape : tuple of int
        (n,) of points, that of the image of a picture; of a list all their values one after the
        other.
    out_shape : tuple of int
        (ny, nx) of the sensor.
    dtype : numpy.dtype
        Of both sides.

    Raises
    ------
    SamplingError, ValueError, DeviceError
        As ``expose``; for slides, which are not linear.
    TypeError
        If the camera or the scene is none.

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
            raise ValueError(f"memory is a number of bytes from 0 on, not {memory!r}.")
        if model not in ("waves", "rays"):
            raise ValueError(f"model is 'waves' or 'rays', not {model!r}.")
        self.camera, self.memory = camera, memory
        self.sources, occluders = as_sources(scene), as_occluders(scene)
        if isinstance(camera, Microscope):
            if occluders or (model, method) != ("waves", "auto"):
                raise ValueError(
                    "Occluders, model and method are for plenoptic cameras; a microscope has one "
                    "way: leave them out."
                )
            self._parts = microscope_parts(self.sources, camera.lines(coherence), camera)
        else:
            optics = replace(camera.optics, occluders=occluders)
            parts = ray_parts if model == "rays" else wave_parts
            self._parts = parts(optics, self.sources, coherence, method)
        self.method = self._parts[0].route
        self.device: Device = camera.device
        one = self._parts[0].shape if len(self._parts) == 1 else None
        self.in_shape: tuple[int, ...] = one or (sum(part.size for part in self._parts),)
        self.out_shape: tuple[int, ...] = camera.grid.shape
        pixels = camera.pixels if model == "waves" else None  # rays know none
        filters = int(self._parts[0].lines[0].weights.shape[1])
        self._signals = PixelSignals(pixels or PixelArray(), filters, camera.grid.shape)
        self._kept: list[tuple[int, SceneLine, SourceImages]] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Without the images on the device, which are made again when needed."""
        return self.__dict__ | {"_kept": None}

    def __repr__(self) -> str:
        return (
            f"<ExposureOperator of {self.in_shape} to {self.out_shape}, {self.method}, "
            f"{self.device.name}>"
        )

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of both sides."""
        return np.dtype(self.device.real)

    @property
    def nbytes(self) -> int:
        """Bytes of the images that are kept now."""
        return sum(images.nbytes for _, _, images in self._kept or [])

    @property
    def positions(self) -> Values:
        """(x, y, dz) in metres of all points that send light, shape (n, 3)."""
        return np.concatenate([part.points.positions for part in self._parts])

    def forward(self, values: Any) -> Values:
        """The raw images of scenes.

        Parameters
        ----------
        values : array_like
            Energies, shape (..., *in_shape).

        Returns
        -------
        numpy.ndarray
            Shape (..., ny, nx).

        Raises
        ------
        ShapeError
            If the values have another shape.
        DeviceError
            If the fields do not fit the device.
        """
        return mapped(self, values)

    def adjoint(self, raw: Any) -> Values:
        """The transpose: what of raw images the images of each point have in common with them.

        Parameters
        ----------
        raw : RawImage or array_like
            Shape (..., ny, nx).

        Returns
        -------
        numpy.ndarray
            Shape (..., *in_shape).

        Raises
        ------
        ShapeError
            If the images have another shape.
        DeviceError
            If the fields do not fit the device.
        """
        return mapped(self, raw, adjoint=True)

    def as_linear_operator(self) -> LinearOperator:
        """This map for the solvers of SciPy.

        Returns
        -------
        scipy.sparse.linalg.LinearOperator
            Of raveled energies and images.
        """
        return linear_operator(self)

    def forward_data(self, data: cla.Array) -> cla.Array:
        """`forward` of arrays of the device.

        Parameters
        ----------
        data : pyopencl.array.Array
            Shape (..., *in_shape), of ``dtype``.

        Returns
        -------
        pyopencl.array.Array
            Shape (..., ny, nx).
        """
        leading = data.shape[: data.ndim - len(self.in_shape)]
        count, device = int(np.prod(leading, dtype=np.int64)), self.device
        if count == 0:
            return device.empty((*leading, *self.out_shape), self.dtype)
        values = device.download(data).astype(np.float64).reshape(count, -1)
        totals = device.zeros((self._signals.filters * count, *self.out_shape), device.real)
        for part, line, images in self._images():
            energies = self._part_of(values, part)[:, images.which]
            signal = np.einsum("bnc,cf->fbn", energies, line.weights)
            images.add(totals, signal.reshape(-1, len(images.which)))
        device.finish()
        return self._signals.read(totals, device).reshape(*leading, *self.out_shape)

    def adjoint_data(self, data: cla.Array) -> cla.Array:
        """`adjoint` of arrays of the device.

        Parameters
        ----------
        data : pyopencl.array.Array
            Shape (..., ny, nx), of ``dtype``.

        Returns
        -------
        pyopencl.array.Array
            Shape (..., *in_shape).
        """
        leading = data.shape[:-2]
        count = int(np.prod(leading, dtype=np.int64))
        found = [np.zeros((count, part.size)) for part in self._parts]
        if count == 0:
            return self.device.empty((*leading, *self.in_shape), self.dtype)
        pictures = self._signals.read_adjoint(data.reshape(count, *self.out_shape), self.device)
        for part, line, images in self._images():
            inner = images.inner(pictures).reshape(self._signals.filters, count, -1)
            own = found[part].reshape(count, -1, self._parts[part].channels)
            places = self._parts[part].places[images.which]
            own[:, places] += np.einsum("fbn,cf->bnc", inner, line.weights)
        values = np.concatenate(found, axis=1).reshape(*leading, *self.in_shape)
        return self.device.upload(np.ascontiguousarray(values, self.dtype))

    def gradient(self, values: Any, cotangent: Any) -> ExposureGradient:
        """Derivatives of a loss by the energies and the places of the points.

        Light runs back through the camera once for each point, for all three coordinates.

        Parameters
        ----------
        values : array_like
            Energies, of ``in_shape``.
        cotangent : array_like
            Derivatives of the loss by the pixels of the raw image, shape (ny, nx).

        Returns
        -------
        ExposureGradient

        Raises
        ------
        ValueError
            If the images of points are computed by rays or in windows of their own, whose places
            move in steps, or aberrations have no derivative in closed form.
        ShapeError
            If the arrays have another shape.
        """
        energies, pictures = self._at(values, cotangent, "Gradients by places")
        by_value = [np.zeros((part.places.size, part.channels)) for part in self._parts]
        by_place = [np.zeros((len(part.points), 3)) for part in self._parts]
        for index, line in self._lines():
            part, signal = self._parts[index], (energies[index] @ line.weights).T
            found = point_gradients(line.optics, part.points, signal, pictures)
            by_value[index] += found.energies.T @ line.weights.T
            by_place[index] += found.positions
        flat = [self._spread(part, v) for part, v in zip(self._parts, by_value, strict=True)]
        gradient = np.concatenate(flat).reshape(self.in_shape).astype(self.dtype)
        return ExposureGradient(gradient, np.concatenate(by_place))

    def lenslet_fields(self, values: Any, cotangent: Any) -> Iterator[tuple[Field, Field]]:
        """Fields before the lenslets, and the gradients of a loss by those right behind them.

        What a gradient by a parameter of the array needs: with the transmission t of the array,
        dL/dp is the sum over all fields of Re(conj(g) u dt/dp).

        Parameters
        ----------
        values : array_like
            Energies, of ``in_shape``.
        cotangent : array_like
            Derivatives of the loss by the pixels of the raw image, shape (ny, nx).

        Yields
        ------
        tuple of Field
            u and g = dL/dRe + i dL/dIm of some of the points, shape (n, ny, nx) on the camera's
            grid, at one of their wavelengths. Every point of the scene comes once a wavelength.

        Raises
        ------
        ValueError
            If the images of points are computed by rays or in windows of their own.
        ShapeError
            If the arrays have another shape.
        """
        energies, pictures = self._at(values, cotangent, "Fields at the lenslets")
        for index, line in self._lines():
            signal = (energies[index] @ line.weights).T
            yield from array_fields(line.optics, self._parts[index].points, signal, pictures)

    def lenslet_gradient(self, values: Any, cotangent: Any) -> dict[str, Any]:
        """Derivatives of a loss by the array of lenslets.

        All lengths behind the array stay, also where the focal length changes.

        Parameters
        ----------
        values : array_like
            Energies, of ``in_shape``.
        cotangent : array_like
            Derivatives of the loss by the pixels of the raw image, shape (ny, nx).

        Returns
        -------
        dict of str to float or numpy.ndarray
            As of `MicrolensArray.gradient`: "pitch", "diameter", "offset", "rotation",
            "focal_length" and so on.

        Raises
        ------
        ValueError
            If the images of points are computed by rays or in windows of their own, or the
            lenslets depart from thin lenses.
        ShapeError
            If the arrays have another shape.
        """
        camera = self.camera
        if isinstance(camera, Plenoptic) and camera.aberrations.bends_lenslets:
            raise ValueError(
                "Gradients by the array are those of thin lenslets, and the aberrations of this "
                "camera bend them: use lenslet_fields, or a camera without lenslets= and scatter=."
            )
        found: dict[str, Any] = {}
        for before, behind in self.lenslet_fields(values, cotangent):
            gradient = camera.mla.gradient(before, behind)
            found = {name: found.get(name, 0.0) + part for name, part in gradient.items()}
        return found

    def _at(self, values: Any, cotangent: Any, what: str) -> tuple[list[Values], Values]:
        """Energies (n, channels) of each part, and the cotangent behind each filter."""
        if self.method != "points":
            raise ValueError(
                f"{what} are known of plenoptic cameras with method='points', not of "
                f"{self.method!r}: give that, with a camera whose pixels sample the light."
            )
        energies, raw = np.asarray(values, np.float64), np.asarray(cotangent, np.float64)
        if energies.shape != self.in_shape or raw.shape != self.out_shape:
            raise ShapeError(
                f"Gradients take energies of shape {self.in_shape} and a cotangent of shape "
                f"{self.out_shape}, not {energies.shape} and {raw.shape}."
            )
        parts = range(len(self._parts))
        flat = [self._part_of(energies.reshape(1, -1), part)[0] for part in parts]
        return flat, self._signals.adjoint(raw[None])[:, 0]

    def _lines(self) -> Iterator[tuple[int, SceneLine]]:
        for index, part in enumerate(self._parts):
            for line in part.lines:
                yield index, line

    def _images(self) -> Iterator[tuple[int, SceneLine, SourceImages]]:
        """Images of all points at all wavelengths: those that are kept, or made anew."""
        if self._kept is not None:
            yield from self._kept
            return
        kept: list[tuple[int, SceneLine, SourceImages]] | None = []
        count, nbytes = sum(len(part.points) for part in self._parts), 0
        for index, line in self._lines():
            for images in self._parts[index].images(line, count):
                nbytes += images.nbytes
                if kept is not None:
                    kept = None if nbytes > self.memory else [*kept, (index, line, images)]
                yield index, line, images
        self._kept = kept

    def _part_of(self, values: Values, index: int) -> Values:
        """Energies (batch, n, channels) of the points of a part, of all values (batch, size)."""
        first = sum(part.size for part in self._parts[:index])
        part = self._parts[index]
        return part.energies(values[:, first : first + part.size])

    @staticmethod
    def _spread(part: ScenePart, values: Values) -> Values:
        """Values (n, channels) of the points of a part among all of its values, raveled."""
        whole = np.zeros((part.size // part.channels, part.channels))
        whole[part.places] = values
        return whole.ravel()
