"""How finely the phase of a lens must be sampled, by itself and in light that already converges.

A phase of slope theta (the sine of a ray) differs by 2 pi theta dx/lam from sample to sample: it is
sampled up to theta = lam/(2 dx). Slopes of phases that are multiplied add.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clplen.wave.field.field import Grid

ROUNDING = 1e-9  # of a limit, which is still sampled


@dataclass(frozen=True)
class LensSampling:
    """The sampling of a thin paraxial lens.

    Attributes
    ----------
    radius, largest_radius : float
        That is used, and R_max = lam abs(f)/(2 dx), in metres.
    shortest_focal_length : float
        f_min = 2 R dx/lam in metres.
    f_number, fastest : float
        abs(f)/(2 R), and dx/lam, the least that is sampled.
    arriving, alone, behind : float
        Largest slopes of the light before the lens, of the lens, and of the light behind it.
    limit : float
        The slope lam/(2 dx).
    """

    radius: float
    largest_radius: float
    shortest_focal_length: float
    f_number: float
    fastest: float
    arriving: float
    alone: float
    behind: float
    limit: float

    def is_sampled(self, slope: float) -> bool:
        """Whether a slope is at most the limit."""
        return slope <= self.limit * (1 + ROUNDING)


def lens_sampling(
    grid: Grid,
    f: float,
    *,
    wavelength: float,
    diameter: float | None = None,
    arriving: float = math.inf,
) -> LensSampling:
    """How finely a grid samples a thin lens on the axis.

    Parameters
    ----------
    grid : Grid
    f : float
        Focal length in metres, not 0.
    wavelength : float
        In metres.
    diameter : float, optional
        Of its aperture in metres, at most the window counts; None: the half window.
    arriving : float
        Radius of curvature of the light at the lens in metres, not 0: positive from a point that
        far before it, negative to a point behind it.

    Returns
    -------
    LensSampling
        Along the axis that is sampled worse.
    """
    used = []
    for axis, places in enumerate((grid.y, grid.x)):
        reach = float(np.abs(places).max())
        if grid.shape[axis] > 1:
            radius = reach if diameter is None else min(diameter / 2, reach)
            used.append((radius * grid.pitch[axis], radius, grid.pitch[axis]))
    _, radius, pitch = max(used, default=(0.0, 0.0, max(grid.pitch)))
    return LensSampling(
        radius=radius,
        largest_radius=wavelength * abs(f) / (2 * pitch),
        shortest_focal_length=2 * radius * pitch / wavelength,
        f_number=abs(f) / (2 * radius) if radius else math.inf,
        fastest=pitch / wavelength,
        arriving=radius / abs(arriving),
        alone=radius / abs(f),
        behind=radius * abs(1 / arriving - 1 / f),
        limit=wavelength / (2 * pitch),
    )


@dataclass(frozen=True)
class LensletSampling:
    """The sampling of lenslets in the light of a lens.

    Attributes
    ----------
    lenslet, lens : float
        Slopes d/(2 f_mu) of a lenslet and D/(2 z) of the light that arrives.
    limit : float
        The slope lam/(2 dx).
    shortest_focal_length : float
        Smallest f_mu in metres with which the sum is sampled; infinite where there is none.
    """

    lenslet: float
    lens: float
    limit: float
    shortest_focal_length: float

    @property
    def is_sampled(self) -> bool:
        """d/(2 f_mu) + D/(2 z) <= lam/(2 dx)."""
        return self.lenslet + self.lens <= self.limit * (1 + ROUNDING)


def lenslet_sampling(
    pitch: float,
    f: float,
    *,
    samples: float,
    wavelength: float,
    diameter: float = 0.0,
    z: float = math.inf,
) -> LensletSampling:
    """How finely lenslets are sampled, alone or behind a lens.

    Parameters
    ----------
    pitch, f : float
        d and f_mu of a lenslet in metres, positive and not 0.
    samples : float
        dx, the larger pitch of the grid, in metres.
    wavelength : float
        In metres.
    diameter, z : float
        D of a lens and its distance in metres, z not 0; by default a plane wave arrives.
    """
    limit, lens = wavelength / (2 * samples), diameter / (2 * abs(z))
    left = limit - lens
    shortest = pitch / (2 * left) if left > 0 else math.inf
    return LensletSampling(pitch / (2 * abs(f)), lens, limit, shortest)
