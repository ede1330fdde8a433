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
        As in `propagate`.
    pad : float
        As in `propagate`: the window over that of the field.
    out_grid : Grid, optional
        Of the field at the end, as in `propagate`; None: that of the field, of fresnel-1fft that of
        its pitch.

    Raises
    ------
    ValueError
        For a distance that is not one finite number.

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
            raise ValueError(f"A distance is one finite number of metres, not {self.z!r}.")

    @property
    def length(self) -> float:
        """The distance in metres."""
        return float(self.z)

    def apply(self, field: Field) -> Field:
        """The field at the end of the distance."""
        return propagate(field, self.z, method=self.method, pad=self.pad, out_grid=self.out_grid)

    def plan(self, grid: Grid, wavelength: float, device: DeviceLike | None = None) -> Propagator:
        """The plan for fields on a grid, which the device keeps."""
        return plan(
            grid, self.z, wavelength=wavelength, method=self.method, pad=self.pad,
            device=device, out_grid=self.out_grid,
        )  # fmt: skip

    def adjoint(self, field: Field, grid: Grid | None = None) -> Field:
        """The adjoint of `apply`: see `Propagator.adjoint`.

        Parameters
        ----------
        field : Field
            On the grid at the end.
        grid : Grid, optional
            At the start; by default that of the field.
        """
        made = self.plan(field.grid if grid is None else grid, field.wavelength, field.device)
        return made.adjoint(field)

    def gradient(self, field: Field, cotangent: Field) -> dict[str, float]:
        """The gradient of a loss by the distance, key "z", per metre.

        Parameters
        ----------
        field : Field
            At the start.
        cotangent : Field
            Gradient of the loss by the field at the end.

        Raises
        ------
        SamplingError
            For methods without `Propagator.distance_slope`.
        """
        slope = self.plan(field.grid, field.wavelength, field.device).distance_slope(field)
        return {"z": inner_product(cotangent, slope).real}

    def describe(self) -> str:
        """Distance, method and, where it counts, padding; the new grid, if any."""
        text = f"{metres(self.z)}, method {self.method}"
        if self.method not in SELF_PADDED:
            text += f", pad {self.pad:g}"
        if self.out_grid is None:
            return text
        (ny, nx), (dy, dx) = self.out_grid.shape, self.out_grid.pitch
        return f"{text}, to {ny} x {nx} samples of {metres(dy)} x {metres(dx)}"
