"""A plan of a propagation on a device."""

from __future__ import annotations

import warnings
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from clplen.compute.blocks import Spectrum
from clplen.compute.device import Device, DeviceLike, as_device, require_same_device
from clplen.compute.forked import Guard
from clplen.errors import SamplingError, SamplingWarning, ShapeError
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.batching import together
from clplen.wave.propagation.choice import describe
from clplen.wave.propagation.cost import least_samples, table_samples
from clplen.wave.propagation.description import Description
from clplen.wave.propagation.energy import Energy, energy
from clplen.wave.propagation.exact_methods import corrected
from clplen.wave.propagation.plan_report import Report, report
from clplen.wave.propagation.request import BORDER, Request
from clplen.wave.propagation.transfer_function import made_for

PHASES = ("tables", "fp64", "twofloat")


class Propagator:
    """A plan for one grid and distance: transforms along the axes, transfer function, windows.

    Parameters
    ----------
    grid : Grid
    z : float
        Distance in metres; negative propagates back (evanescent waves are then dropped).
    wavelength : float
        In metres.
    method : str
        - "auto": whichever of as, cblas and rs is exact at this distance and cheapest.
        - "as": angular spectrum, H = exp(i k z (sqrt(1 - s) - 1)) (Goodman 2005, eq. 3-66).
        - "blas": the same within the band that the window samples (Matsushima and Shimobaba 2009,
          eq. 13).
        - "cblas": within the band that reaches the output, widened by a smooth guard, in a window
          that keeps aliases clear of it; any output grid.
        - "rs": convolution with the sampled Rayleigh-Sommerfeld I kernel (Goodman 2005, eq. 3-43).
        - "fresnel-tf", "fresnel-ir": paraxial, by the sampled transfer function (near) or impulse
          response (far) (Goodman 2005, eqs. 4-20 and 4-16).
        - "fresnel-1fft": paraxial, one transform; the output pitch is lam abs(z)/(L dx).
        - "fresnel-multistep": paraxial, steps of one transform that keep the pitch.
    pad : float
        For as, blas and the Fresnel methods the window is exactly round(pad N) samples (1:
        periodic, no padding); of fresnel-multistep an even length without prime factors above 7.
        Lengths with large prime factors take up to three times as long. The others size their own
        windows.
    device : Device
    out_grid : Grid, optional
        Of the result, for auto and cblas; by default the field's.
    guard : float, optional
        Of auto and cblas, in Fresnel widths sqrt(cos^3 theta/(lam z)); by default 6, and 8 so far
        away that the window is narrower than 2 sqrt(lam z). 8 is for reference results.
        0 ends the band sharply where geometry says, in the window of ``pad``.
    border : float
        Of fresnel-multistep, the fraction of half the window over which each step is absorbed; 0
        lets light wrap around.
    support : float or tuple of float, optional
        (y, x) widths about the grid's centre that carry light, in metres; by default the window.
        Less means fewer frequencies to compute.
    lens : float, optional
        Focal length in metres of a paraxial thin lens on the axis right before a fresnel-1fft,
        joined to its chirp before that is sampled: nothing aliases at z = lens.
    phase : {"tables", "fp64", "twofloat"}, optional
        How the phase of H is formed; by default whatever is exact to 1e-5 rad on the device
        (less next to the grazing frequency 1/lam).

    Attributes
    ----------
    method, why : str
        The method taken and the inequality that decided.
    report : Report
    out_grid : Grid
        Of the result.

    Raises
    ------
    ValueError
        For an unknown method or phase, or a number outside its range.
    SamplingError
        For an output grid that the method cannot give, or fresnel-1fft at z = 0.

    Warns
    -----
    SamplingWarning
        When what the method samples is aliased, or no light reaches the output.
    """

    def __init__(
        self,
        grid: Grid,
        z: float,
        *,
        wavelength: float,
        method: str = "auto",
        pad: float = 2,
        device: DeviceLike,
        out_grid: Grid | None = None,
        guard: float | None = None,
        border: float = BORDER,
        support: float | tuple[float, float] | None = None,
        lens: float | None = None,
        phase: str | None = None,
    ) -> None:
        wanted = request(
            grid, z, wavelength, method, pad, out_grid, guard, border, support=support, lens=lens
        )
        self._prepare(wanted, device, phase, stacklevel=3)

    @classmethod
    def of(cls, wanted: Request, device: DeviceLike, *, stacklevel: int = 3) -> Propagator:
        """The plan of a checked request."""
        made = cls.__new__(cls)
        made._prepare(wanted, device, None, stacklevel=stacklevel + 1)
        return made

    def _prepare(
        self, wanted: Request, device: DeviceLike, phase: str | None, *, stacklevel: int
    ) -> None:
        device = as_device(device)
        if phase is not None and phase not in PHASES:
            raise ValueError(f"There is no phase route {phase!r}; use one of {', '.join(PHASES)}.")
        if phase not in (None, "tables") and device.precision == "double":
            raise ValueError(f"In double precision the phase is by 'tables', not {phase!r}.")
        if phase == "fp64" and not device.has_fp64:
            raise ValueError(f"{device.name} has no double precision: use phase='twofloat'.")
        self.request, self.device = wanted, device
        self.grid, self.z, self.wavelength = wanted.grid, wanted.z, wanted.wavelength
        device.require_memory(least_samples(wanted) * device.complex.itemsize, "This propagation")
        made = describe(wanted)
        self.description = _in_precision(made, device)
        self.method, self.why, self.out_grid = made.method, made.why, made.out_grid
        self.phase = "tables"
        if made.factor is not None:
            self.phase = phase or made.factor.phase_route(device)
        self.report: Report = report(made, self.phase)
        if made.warning:
            warnings.warn(made.warning, SamplingWarning, stacklevel=stacklevel)
        self._spectrum: Spectrum | None = None
        self._lock = Guard()

    def __getstate__(self) -> dict[str, Any]:
        """Without what is on the device, which is made again at first use."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_spectrum", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"_spectrum": None, "_lock": Guard()})

    def __repr__(self) -> str:
        return f"<Propagator {self.method}, {self.z:g} m, {self.grid} to {self.out_grid}>"

    @property
    def nbytes(self) -> int:
        """Bytes that the plan holds."""
        made, samples = self.description, table_samples(self.description)
        if made.factor is not None:
            rows, columns = made.factor.stored
            samples += rows * columns
        return samples * self.device.complex.itemsize

    @property
    def spectrum(self) -> Spectrum | None:
        """The factor on the device, made at first use; None where the method has none."""
        with self._lock:
            if self._spectrum is None and self.description.factor is not None:
                self._spectrum = made_for(self.description.factor, self.device, self.phase)
            return self._spectrum

    def __call__(self, field: Field) -> Field:
        """Propagate a field (or a batch of fields) on the plan's grid.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx).

        Returns
        -------
        Field
            On `out_grid`, without the carrier exp(ikz).

        Raises
        ------
        DeviceError
            If field and plan live on two devices, or the window does not fit the device.
        ShapeError
            If the field's grid or wavelength is not the plan's.
        """
        self._check(field)
        return together(field, [self])[0]

    def energy(self, field: Field) -> Energy:
        """Where the energy of a field goes, each part computed by itself.

        Parameters
        ----------
        field : Field
            Shape (..., ny, nx); a batch is added up.

        Returns
        -------
        Energy
            In the unit of `Field.power`; ``into = window + outside + cut`` but for rounding.

        Raises
        ------
        SamplingError
            For a method without a transfer function in a window of the field's samples: rs and
            the Fresnel methods, or another output pitch or centre.
        """
        self._check(field)
        return energy(field, self._by_fft(), self.phase)

    def _by_fft(self) -> Description:
        """The description whose sum is done by FFTs of a window of the field's own samples."""
        made = self.description
        if made.kind == "nothing" or self.method in ("as", "blas"):
            return made
        if self.method != "cblas" or not self.request.is_aligned:
            raise SamplingError(
                "energy() is for as, blas and cblas on the field's own pitch and centre, whose "
                f"window holds all the light; this plan is {self.method!r} onto {self.out_grid}: "
                "make one with method='cblas' and without out_grid."
            )
        return corrected(made.request, self.why, "fft")

    def _check(self, field: Field) -> None:
        if not isinstance(field, Field):
            raise TypeError(
                f"A plan takes a Field, as Field.from_array makes it, not a {type(field).__name__}."
            )
        require_same_device(field.device, self.device)
        if field.grid != self.grid or field.wavelength != self.wavelength:
            raise ShapeError(
                f"The plan is for {self.grid} at {self.wavelength:g} m, the field has {field.grid} "
                f"at {field.wavelength:g} m."
            )


def request(
    grid: Grid,
    z: Any,
    wavelength: float,
    method: str = "auto",
    pad: float = 2,
    out_grid: Grid | None = None,
    guard: float | None = None,
    border: float = BORDER,
    *,
    support: float | tuple[float, float] | None = None,
    lens: float | None = None,
) -> Request:
    """A checked request, a ``support`` of one number being that of both axes."""
    if support is not None:
        if np.shape(support) not in ((), (2,)):
            raise ValueError(f"support is one width or (y, x), in metres, not {support!r}.")
        both = np.broadcast_to(np.asarray(support, np.float64), (2,))
        support = (float(both[0]), float(both[1]))
    distance = z.item() if isinstance(z, np.ndarray) and z.ndim == 0 else z
    distance = float(distance) if isinstance(distance, Real) else distance
    return Request(grid, distance, wavelength, method, pad, out_grid, guard, border, support, lens)


def _in_precision(made: Description, device: Device) -> Description:
    return replace(
        made, into=made.into.astype(device.complex), back=made.back.astype(device.complex)
    )
