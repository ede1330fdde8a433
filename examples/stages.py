"""The stages of a propagation by its spectrum, as arrays: figures 2.3, 2.4 and 2.6."""

from dataclasses import dataclass

import numpy as np
from closed import LAM
from drawing import LIGHT, bar, new_figure
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from clplen import Device, Field, Grid, Propagator
from clplen.wave import polygonal_aperture


@dataclass(frozen=True)
class Stages:
    """U(0), A, H, A H and U(z) in the padded window, zero frequency in the middle."""

    plan: Propagator
    window: Grid
    arrays: dict[str, np.ndarray]


def phase(f: np.ndarray, z: float) -> np.ndarray:
    """Phase of H in rad, -k z s/(1 + sqrt(1 - s)), s = (lam f)^2; Goodman (2005), eq. 3-66."""
    s = (LAM * f) ** 2
    return -2 * np.pi * z / LAM * s / (1 + np.sqrt(1 - s))


def transfer(plan: Propagator) -> np.ndarray:
    """H of a plan, zero frequency in the middle; the plan holds the quadrant up to the middle."""
    H, (ny, nx) = plan.spectrum, plan.spectrum.shape
    y, x = (np.minimum(i, n - i) for i, n in ((np.arange(ny), ny), (np.arange(nx), nx)))
    return np.fft.fftshift(H.values.get()[np.ix_(y, x)])


def star(device: Device) -> Field:
    """A five-pointed star lit by a unit plane wave."""
    grid = Grid((96, 96), 4e-6)
    plane = Field.from_array(np.ones(grid.shape), grid, wavelength=LAM, device=device)
    turn = np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2, 0.06e-3, 0.15e-3)
    return polygonal_aperture(plane, np.stack([radius * np.cos(turn), radius * np.sin(turn)], 1))


def stages(field: Field, z: float, method: str) -> Stages:
    """Every stage, the transforms by NumPy and H from the plan."""
    plan = Propagator(field.grid, z, wavelength=LAM, method=method, device=field.device)
    H = transfer(plan)
    window = Grid(H.shape, field.grid.pitch)
    start = np.zeros(H.shape, complex)
    start[inner(window, field.grid)] = field.to_numpy()
    A = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(start))) * np.prod(window.pitch)
    end = np.fft.fftshift(np.fft.ifft2(np.fft.ifftshift(A * H))) / np.prod(window.pitch)
    return Stages(plan, window, {"U(0)": start, "A": A, "H": H, "A H": A * H, "U(z)": end})


def inner(window: Grid, grid: Grid) -> tuple[slice, slice]:
    """Where a grid lies in a padded window: centre upon centre."""
    y, x = (slice(L // 2 - n // 2, L // 2 - n // 2 + n)
            for L, n in zip(window.shape, grid.shape, strict=True))
    return y, x


def draw(found: Stages, names: dict[str, str], frame: float) -> Figure:
    """Amplitude above phase of each stage; a dotted frame of a width about the spectra's middle."""
    figure = new_figure(13, 4.7)
    panels = figure.subplots(2, len(names))
    for (above, below), (key, name) in zip(panels.T, names.items(), strict=True):
        u, field = found.arrays[key], key.startswith("U")
        step = found.window.pitch[1] * 1e3 if field else 1e-3 / found.window.extent[1]
        ends = (np.array([0, u.shape[1]]) - u.shape[1] // 2 - 0.5) * step
        how = {"origin": "lower", "extent": (*ends, *ends), "interpolation": "nearest"}
        size = np.maximum(np.abs(u) / np.abs(u).max(), 1e-9)
        light = above.imshow(size, cmap=LIGHT, norm=LogNorm(1e-4, 1), **how)
        angle = np.where(size > 1e-3, np.angle(u), np.nan)
        turned = below.imshow(angle, cmap="twilight", vmin=-np.pi, vmax=np.pi, **how)
        side = found.plan.grid.extent[1] * 1e3 if field else frame
        for axes, colour in ((above, "w"), (below, "0.3")):
            axes.add_patch(Rectangle((-side / 2,) * 2, side, side, fill=False, ec=colour, ls=":"))
        above.set(title=name, xticklabels=[], ylabel="y / mm" if field else "$f_y$ / (1/mm)")
        below.set(xlabel="x / mm" if field else "$f_x$ / (1/mm)", ylabel=above.get_ylabel())
    bar(figure, light, list(panels[0]), "amplitude / largest (logarithmic)", extend="min")
    bar(figure, turned, list(panels[1]), "phase / rad")
    return figure
