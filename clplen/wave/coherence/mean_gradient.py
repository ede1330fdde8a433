"""Gradients through the mean intensity of partially coherent light."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from clplen.checks import real_array
from clplen.compute.arrays import Image
from clplen.compute.device import Device
from clplen.compute.fft.blocks import add
from clplen.errors import ShapeError
from clplen.types import Array
from clplen.wave.coherence.abbe import Points
from clplen.wave.coherence.spatial_models import SpatialModel
from clplen.wave.elements.beams import plane_wave
from clplen.wave.field.adjoints import intensity_gradient
from clplen.wave.field.field import Field, require_field
from clplen.wave.field.intensity import MeanIntensity
from clplen.wave.field.transmission import multiply, multiply_separable
from clplen.wave.systems.optical_system import OpticalSystem
from clplen.wave.systems.pupil_filter import transfer_of
from clplen.wave.systems.system_operator import SystemGradient

STORED_FRACTION = 4  # stored fields take at most 1/4 of the device's memory


class Light(Protocol):
    """Methods of a `Coherence` that gradients need."""

    @property
    def spatial(self) -> SpatialModel | None: ...

    def lines(self, wavelength: float) -> list[tuple[float, float]]: ...

    def light(self, grid: Any, *, wavelength: float, device: Device, index: int) -> Field: ...

    def average(
        self, system: Any, field: Any, *, snapshots: int | None, method: Any
    ) -> MeanIntensity: ...


class _Recorded(OpticalSystem):
    """System that stores its returned fields in order, up to a number of bytes."""

    def __init__(self, parts: Iterable[Any], limit_bytes: int) -> None:
        super().__init__(parts)
        object.__setattr__(self, "outputs", [])
        object.__setattr__(self, "limit_bytes", limit_bytes)

    def __call__(self, field: Any, **options: Any) -> Any:
        out = super().__call__(field, **options)
        outputs: list[Field] = self.__dict__["outputs"]
        if (len(outputs) + 1) * int(out.data.nbytes) <= self.__dict__["limit_bytes"]:
            outputs.append(out)
        return out


@dataclass(frozen=True, eq=False, repr=False)
class MeanPullback:
    """Map from the gradient of a loss to those by the object and the system.

    `Coherence.vjp` returns it.

    Attributes
    ----------
    light : Coherence
    system : OpticalSystem
    object : Field
        Transmission of the illuminated object.
    method : str
        Method of the mean: "monte-carlo", "abbe", "incoherent" or "coherent".
    snapshots : int
    parameters : tuple of int
        Indices of the parts whose parameters have gradients.
    fields : tuple of Field
        Fields behind the system for the first snapshots; the others are computed again.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> hole = clplen.aperture(clplen.wave.plane_wave(grid, wavelength=500e-9), 150e-6)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(40e-6))
    >>> image, pullback = light.vjp(clplen.OpticalSystem([5e-3]), hole, snapshots=5)
    >>> gradient = pullback(image.to_numpy() - 1)  # of sum (I - 1)^2/2
    >>> gradient.field.shape, len(pullback.fields)
    ((32, 32), 5)
    """

    light: Light
    system: OpticalSystem
    object: Field
    method: str
    snapshots: int
    parameters: tuple[int, ...]
    fields: tuple[Field, ...]

    def __repr__(self) -> str:
        return (
            f"<MeanPullback {self.method}, {self.snapshots} snapshots, {len(self.fields)} stored "
            f"in {self.nbytes} bytes>"
        )

    @property
    def nbytes(self) -> int:
        """Bytes of the stored fields on the device."""
        return sum(int(field.data.nbytes) for field in self.fields)

    def __call__(self, cotangent: Image | Array) -> SystemGradient:
        """Return the gradients by the object's transmission and by the system's parameters.

        Parameters
        ----------
        cotangent : Image or array_like
            Gradient dL/dI of the mean intensity, real, shape (my, mx).
        """
        weights = real_array(cotangent, "A cotangent", np.float64)
        if self.method == "incoherent":
            return SystemGradient(self._incoherent(weights), {})
        device, scaled = self.object.device, dict[float, Image]()
        total: Field | None = None
        parameters: dict[int, dict[str, Any]] = {}
        for number, (lit, weight) in enumerate(self._lights()):
            if weight not in scaled:
                values = np.ascontiguousarray(weight * weights, device.real)
                scaled[weight] = Image(device.upload(values), device)
            gradient = self._coherent(lit, scaled[weight], number)
            back = multiply(gradient.field, lit.data, conjugate=True)
            if total is None:
                total = back
            else:
                add(total.data, back.data, device)
            for part, named in gradient.parameters.items():
                parameters[part] = _added(parameters.get(part), named)
        assert total is not None
        return SystemGradient(replace(total, wavelength=self.object.wavelength), parameters)

    def _coherent(self, lit: Field, weights: Image, number: int) -> SystemGradient:
        """Return the gradient by the illuminated object, through a coherent image."""
        if number < len(self.fields) and not self.parameters:
            cotangent = intensity_gradient(self.fields[number], weights)
            return SystemGradient(self.system.adjoint(cotangent, grid=lit.grid), {})
        transmission = replace(self.object, wavelength=lit.wavelength)
        behind, pullback = self.system.vjp(
            multiply(transmission, lit.data), parameters=self.parameters
        )
        return pullback(intensity_gradient(behind, weights))

    def _lights(self) -> Iterator[tuple[Field, float]]:
        """Yield the illumination and the weight of each coherent image.

        Of the points of a source the light has their weight.
        """
        lines = self.light.lines(self.object.wavelength)
        grid, device = self.object.grid, self.object.device
        if self.method == "abbe":
            for wavelength, share in lines:
                for wave in self._source(wavelength):
                    yield wave, share
            return
        for index in range(self.snapshots if self.method == "monte-carlo" else 1):
            for line, (wavelength, share) in enumerate(lines):
                number = index * len(lines) + line if self.method == "monte-carlo" else 0
                lit = self.light.light(grid, wavelength=wavelength, device=device, index=number)
                yield lit, share / self.snapshots if self.method == "monte-carlo" else share

    def _source(self, wavelength: float) -> Iterator[Field]:
        """Yield weighted plane waves of the source's points whose light passes the system."""
        grid, device = self.object.grid, self.object.device
        assert self.light.spatial is not None
        source = self.light.spatial.power_spectrum(grid, wavelength=wavelength)
        H = self._transfer(wavelength)
        spectrum = np.fft.fft2(self.object.to_numpy())
        points = Points.of(source, 0.0).lit(spectrum, H)
        clear = plane_wave(grid, wavelength=wavelength, device=device)
        for (row, column), weight in zip(points.indices, points.weights, strict=True):
            ty, tx = (
                np.exp(2j * np.pi * (k * np.arange(n) % n) / n).astype(device.complex)
                for k, n in zip((row, column), grid.shape, strict=True)
            )
            yield multiply_separable(clear, ty, tx * device.real.type(math.sqrt(weight)))

    def _incoherent(self, weights: Array) -> Field:
        """Return 2 t times the weights, filtered by the mirrored point image."""
        device, t = self.object.device, self.object.to_numpy().astype(np.complex128)
        total = np.zeros_like(t)
        for wavelength, share in self.light.lines(self.object.wavelength):
            image = np.abs(np.fft.ifft2(self._transfer(wavelength))) ** 2
            spectrum = np.conj(np.fft.fft2(image)) * np.fft.fft2(weights)
            total += share * 2 * t * np.fft.ifft2(spectrum).real
        return self.object.with_data(device.upload(total.astype(device.complex)))

    def _transfer(self, wavelength: float) -> Array:
        H = transfer_of(self.system, self.object.grid, wavelength)
        assert H is not None
        return H


def mean_vjp(
    light: Light,
    system: Any,
    field: Field,
    *,
    snapshots: int,
    parameters: Iterable[int] = (),
    method: str = "auto",
) -> tuple[MeanIntensity, MeanPullback]:
    """Return the mean intensity and the pullback of gradients; see `Coherence.vjp`."""
    require_field(field)
    if len(field.shape) != 2:
        raise ShapeError(f"field must be a single field of shape (ny, nx), got {field.shape}.")
    optics = system if isinstance(system, OpticalSystem) else OpticalSystem([system])
    parts = tuple(parameters)
    limit_bytes = 0 if parts else field.device.memory_bytes // STORED_FRACTION
    recorded = _Recorded(optics.parts, limit_bytes)
    mean = light.average(recorded, field, snapshots=snapshots, method=method)
    fields: list[Field] = recorded.__dict__["outputs"]
    if mean.method == "monte-carlo" and len(light.lines(field.wavelength)) > 1:
        fields = fields[1:]  # the first field is only a test of the system
    if mean.method in ("abbe", "incoherent"):
        fields = []
    pullback = MeanPullback(light, optics, field, mean.method, mean.snapshots, parts, tuple(fields))
    return mean, pullback


def _added(total: dict[str, Any] | None, more: dict[str, Any]) -> dict[str, Any]:
    """Add the gradients of a part, name by name."""
    if total is None:
        return more
    return {
        name: _added(total[name], value) if isinstance(value, dict) else total[name] + value
        for name, value in more.items()
    }
