"""Free space as a part of an optical system."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from clplen.checks import is_finite
from clplen.compute.device import DeviceLike
from clplen.reprs import OneLine
from clplen.units import metres
from clplen.wave.field.adjoints import inner_product
from clplen.wave.field.field import Field, Grid
from clplen.wave.propagation.description import SELF_PADDED
from clplen.wave.propagation.free_space import plan, propagate
from clplen.wave.propagation.propagator import Propagator


@dataclass(frozen=True, repr=False)
class Space(OneLine):
    """Free space, by `propagate`.

    Parameters
    ----------
    z : float
        Distance in metres; negative propagates back.
    method : str
        Method of `propagate`.
    pad : float
        Padding of `propagate`: the window relative to that of the field.
    out_grid : Grid, optional
        Grid of the field at the end, as in `propagate`; None: the field's grid, or for fresnel-1fft
        the grid of its pitch.

    Raises
    ------
    ValueError
        If the distance is not a finite number.

    Examples
    --------
    >>> grid = clplen.Grid((64, 64), 10e-6)
    >>> wave = clplen.wave.gaussian_beam(grid, 100e-6, wavelength=500e-9)
    >>> space = clplen.wave.Space(0.05)
    >>> space.describe(), space.length
    ('50 mm, method auto', 0.05)
    >>> space.apply(wave).shape
    (64, 64)
    """

    z: float
    _: KW_ONLY
    method: str = "auto"
    pad: float = 2
    out_grid: Grid | None = None
    label = "space"

    def __post_init__(self) -> None:
        if not (is_finite(self.z)):
            raise ValueError(f"z must be a finite number of metres, got {self.z!r}.")

    @property
    def length(self) -> float:
        """Distance in metres."""
        return float(self.z)

    def apply(self, field: Field) -> Field:
        """Return the field at the end of the distance."""
        return propagate(field, self.z, method=self.method, pad=self.pad, out_grid=self.out_grid)

    def plan(self, grid: Grid, wavelength: float, device: DeviceLike | None = None) -> Propagator:
        """Return the plan for fields on a grid, from the device's cache."""
        return plan(
            grid, self.z, wavelength=wavelength, method=self.method, pad=self.pad,
            device=device, out_grid=self.out_grid,
        )  # fmt: skip

    def adjoint(self, field: Field, grid: Grid | None = None) -> Field:
        """Return the adjoint of `apply`; see `Propagator.adjoint`.

        Parameters
        ----------
        field : Field
            Field on the grid at the end.
        grid : Grid, optional
            Grid at the start; by default that of the field.
        """
        propagator = self.plan(field.grid if grid is None else grid, field.wavelength, field.device)
        return propagator.adjoint(field)

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """Return the gradient of a loss by the distance, key "z", per metre.

        Parameters
        ----------
        field : Field
            Field at the start.
        cotangent : Field
            Gradient of the loss by the field at the end.

        Raises
        ------
        SamplingError
            If the method has no `Propagator.distance_slope`.
        """
        slope = self.plan(field.grid, field.wavelength, field.device).distance_slope(field)
        return {"z": inner_product(cotangent, slope).real}

    def describe(self) -> str:
        """Return distance, method, padding where it applies, and the output grid if set."""
        text = f"{metres(self.z)}, method {self.method}"
        if self.method not in SELF_PADDED:
            text += f", pad {self.pad:g}"
        if self.out_grid is None:
            return text
        (ny, nx), (dy, dx) = self.out_grid.shape, self.out_grid.pitch
        return f"{text}, to {ny} x {nx} samples of {metres(dy)} x {metres(dx)}"
