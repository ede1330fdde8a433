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

KEPT_SHARE = 4  # fields behind the system may take a quarter of the device's memory


class Light(Protocol):
    """What is needed of a `Coherence`."""

    @property
    def spatial(self) -> SpatialModel | None: ...

    def lines(self, wavelength: float) -> list[tuple[float, float]]: ...

    def light(self, grid: Any, *, wavelength: float, device: Device, index: int) -> Field: ...

    def average(
        self, system: Any, field: Any, *, snapshots: int | None, method: Any
    ) -> MeanIntensity: ...


class _Recorded(OpticalSystem):
    """A system that keeps what it returned, in order, up to a number of bytes."""

    def __init__(self, parts: Iterable[Any], most: int) -> None:
        super().__init__(parts)
        object.__setattr__(self, "made", [])
        object.__setattr__(self, "most", most)

    def __call__(self, field: Any, **options: Any) -> Any:
        out = super().__call__(field, **options)
        made: list[Field] = self.__dict__["made"]
        if (len(made) + 1) * int(out.data.nbytes) <= self.__dict__["most"]:
            made.append(out)
        return out


@dataclass(frozen=True, eq=False, repr=False)
class MeanPullback:
    """Takes the gradient of a loss back to the object and the system.

    Made by `Coherence.vjp`.

    Attributes
    ----------
    light : Coherence
    system : OpticalSystem
    object : Field
        The transmission that was illuminated.
    method : str
        That of the mean: "monte-carlo", "abbe", "incoherent" or "coherent".
    snapshots : int
    parameters : tuple of int
        Parts whose parameters have gradients.
    kept : tuple of Field
        Fields behind the system of the first snapshots; those of the others are computed again.

    Examples
    --------
    >>> grid = clplen.Grid((32, 32), 10e-6)
    >>> hole = clplen.aperture(clplen.wave.plane_wave(grid, wavelength=500e-9), 150e-6)
    >>> light = clplen.Coherence(clplen.wave.RandomPhaseMask(40e-6))
    >>> image, pullback = light.vjp(clplen.OpticalSystem([5e-3]), hole, snapshots=5)
    >>> gradient = pullback(image.to_numpy() - 1)  # of sum (I - 1)^2/2
    >>> gradient.field.shape, len(pullback.kept)
    ((32, 32), 5)
    """

    light: Light
    system: OpticalSystem
    object: Field
    method: str
    snapshots: int
    parameters: tuple[int, ...]
    kept: tuple[Field, ...]

    def __repr__(self) -> str:
        return (
            f"<MeanPullback {self.method}, {self.snapshots} snapshots, {len(self.kept)} kept in "
            f"{self.nbytes} bytes>"
        )

    @property
    def nbytes(self) -> int:
        """Bytes of the fields that it holds on the device."""
        return sum(int(field.data.nbytes) for field in self.kept)

    def __call__(self, cotangent: Image | Array) -> SystemGradient:
        """The gradients by the object's transmission and by the system's parameters.

        Parameters
        ----------
        cotangent : Image or array_like
            dL/dI of the mean intensity, real, shape (my, mx).
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
            found = self._one(lit, scaled[weight], number)
            back = multiply(found.field, lit.data, conjugate=True)
            if total is None:
                total = back
            else:
                add(total.data, back.data, device)
            for part, named in found.parameters.items():
                parameters[part] = _added(parameters.get(part), named)
        assert total is not None
        return SystemGradient(replace(total, wavelength=self.object.wavelength), parameters)

    def _one(self, lit: Field, weights: Image, number: int) -> SystemGradient:
        """The gradient by the lit object, through one coherent image."""
        if number < len(self.kept) and not self.parameters:
            cotangent = intensity_gradient(self.kept[number], weights)
            return SystemGradient(self.system.adjoint(cotangent, grid=lit.grid), {})
        own = replace(self.object, wavelength=lit.wavelength)
        behind, pullback = self.system.vjp(multiply(own, lit.data), parameters=self.parameters)
        return pullback(intensity_gradient(behind, weights))

    def _lights(self) -> Iterator[tuple[Field, float]]:
        """What illuminates the object in each coherent image, and the image's weight.

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
        """Plane waves, by their weight, of the source's points whose light passes the system."""
        grid, device = self.object.grid, self.object.device
        assert self.light.spatial is not None
        source = self.light.spatial.power_spectrum(grid, wavelength=wavelength)
        H = self._transfer(wavelength)
        spectrum = np.fft.fft2(self.object.to_numpy())
        points = Points.of(source, 0.0).lit(spectrum, H)
        clear = plane_wave(grid, wavelength=wavelength, device=device)
        for (row, column), weight in zip(points.places, points.weights, strict=True):
            ty, tx = (
                np.exp(2j * np.pi * (k * np.arange(n) % n) / n).astype(device.complex)
                for k, n in zip((row, column), grid.shape, strict=True)
            )
            yield multiply_separable(clear, ty, tx * device.real.type(math.sqrt(weight)))

    def _incoherent(self, weights: Array) -> Field:
        """2 t times the weights filtered by the mirrored point image."""
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
    """The mean intensity and what takes gradients back: see `Coherence.vjp`."""
    require_field(field)
    if len(field.shape) != 2:
        raise ShapeError(f"The object is one field of shape (ny, nx), not a batch {field.shape}.")
    made = system if isinstance(system, OpticalSystem) else OpticalSystem([system])
    wanted = tuple(parameters)
    most = 0 if wanted else field.device.memory_bytes // KEPT_SHARE
    recorded = _Recorded(made.parts, most)
    mean = light.average(recorded, field, snapshots=snapshots, method=method)
    kept: list[Field] = recorded.__dict__["made"]
    if mean.method == "monte-carlo" and len(light.lines(field.wavelength)) > 1:
        kept = kept[1:]  # the first is looked at before
    if mean.method in ("abbe", "incoherent"):
        kept = []
    pullback = MeanPullback(light, made, field, mean.method, mean.snapshots, wanted, tuple(kept))
    return mean, pullback


def _added(total: dict[str, Any] | None, more: dict[str, Any]) -> dict[str, Any]:
    """Gradients of one part added up, name by name."""
    if total is None:
        return more
    return {
        name: _added(total[name], value) if isinstance(value, dict) else total[name] + value
        for name, value in more.items()
    }
