"""What the scripts of partially coherent light share: Young's experiment, masks, their phase."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from closed import LAM
from matplotlib.axes import Axes

from clplen import Coherence, Device, Field, Grid, propagate
from clplen.wave import RandomPhaseMask, measured_degree

WINDOW, SEED = 20e-3, 0  # of the thesis, in metres; of masks
PHASES = "twilight"  # colours that close, for -pi to pi


@dataclass(frozen=True)
class Young:
    """Pairs of pinholes of one sample, one pair a row, each on its own way to a screen.

    The distance from row to row is such that the light of rows is independent, or nearly so.
    """

    separations: np.ndarray  # in samples
    pitch: float = 40e-6
    distance: float = 0.5
    columns: int = 132
    repeats: int = 25  # rows of each separation

    @property
    def lengths(self) -> np.ndarray:
        """Separations in metres."""
        return self.separations * self.pitch

    @property
    def width(self) -> float:
        """Of the screen in metres: as one FFT has it, lam z/dx, that is d/dx fringes."""
        return LAM * self.distance / self.pitch

    def fringes(self, light: Coherence, row: float, device: Device, snapshots: int) -> np.ndarray:
        """Intensity on the screen for each separation, shape (number, columns)."""
        rows, number = self.repeats * len(self.separations), len(self.separations)
        left, u = self.columns // 2 - self.separations // 2, np.zeros((rows, self.columns))
        for columns in (left, left + self.separations):
            u[np.arange(rows), np.tile(columns, self.repeats)] = 1
        grid = Grid(u.shape, (row, self.pitch))
        pinholes = Field.from_array(u, grid, wavelength=LAM, device=device)
        lit = light.average(self._screens, pinholes, snapshots=snapshots).to_numpy()
        return lit.astype(float).reshape(self.repeats, number, self.columns).mean(0)

    def visibility(self, fringes: np.ndarray) -> np.ndarray:
        """Of each row of fringes, negative where the middle is dark."""
        terms = np.fft.fft(np.fft.ifftshift(fringes, axes=1), axis=1)
        at = 2 * terms[np.arange(len(fringes)), self.separations] / terms[:, 0]
        middle = self.separations / 2 - self.separations // 2  # of a pair, in samples
        turns = middle * self.separations * self.pitch**2 / (LAM * self.distance)
        return (at * np.exp(2j * np.pi * turns)).real

    def between(self, samples: int, mu: float, places: np.ndarray, device: Device) -> np.ndarray:
        """Intensity behind soft pinholes, over the brightest of each plane; (places, x).

        |h1|^2 + |h2|^2 + 2 mu Re(h1* h2), h1 and h2 the fields of either pinhole.
        """
        fine = Grid((1, self.columns * 8), self.pitch / 8)
        u = [np.exp(-(((fine.x + side * samples * self.pitch / 2) / self.pitch) ** 2) * 4)
             for side in (1, -1)]
        pair = Field.from_array(np.array(u)[:, None], fine, wavelength=LAM, device=device)
        screen, light = Grid((1, self.columns * 8), self.width / self.columns / 8), []
        for z in places:
            one, other = propagate(pair, z, out_grid=screen).to_numpy()[:, 0]
            lit = np.abs(one) ** 2 + np.abs(other) ** 2 + 2 * mu * (one.conj() * other).real
            light.append(lit / lit.max())
        return np.array(light)

    def _screens(self, field: Field) -> Field:
        """Every row propagated by itself, as between walls."""
        rows = field.data.reshape(-1, 1, self.columns)
        lit = propagate(Field(rows, Grid((1, self.columns), self.pitch), LAM, field.device),
                        self.distance, method="fresnel-1fft", pad=1)
        grid = Grid(field.shape, (field.grid.pitch[0], lit.grid.pitch[1]))
        return Field(lit.data.reshape(field.shape), grid, LAM, field.device)


def fields(mask: RandomPhaseMask, grid: Grid, device: Device, count: int) -> Iterator[Field]:
    """Snapshots of a mask, also of one too close to be speckle."""
    for index in range(count):
        yield mask.field(grid, wavelength=LAM, device=device, seed=SEED, index=index)


def snapshot(mask: RandomPhaseMask, grid: Grid, device: Device) -> np.ndarray:
    """Snapshot 0 of a mask on the host, complex128."""
    return next(fields(mask, grid, device, 1)).to_numpy().astype(complex)


def intensity(times: float, device: Device, count: int) -> np.ndarray:
    """Intensity over its mean at so many p^2/lam behind cells of p = 16 um, in several masks."""
    mask, grid = RandomPhaseMask(16e-6, distance=times * 16e-6**2 / LAM), Grid((256, 256), 2e-6)
    lit = np.abs([u.to_numpy() for u in fields(mask, grid, device, count)]) ** 2
    return lit / lit.mean()


def degree_of(
    mask: RandomPhaseMask, grid: Grid, device: Device, count: int, lags: np.ndarray
) -> tuple[np.ndarray, float]:
    """Degree of coherence along x, lags in samples, and its rms difference from the law."""
    mu = measured_degree(fields(mask, grid, device, count), lags, axis="x", periodic=True).real
    return mu, float(np.sqrt(np.mean((mu - mask.degree(0, lags * grid.pitch[1])) ** 2)))


def sources(cells: int, device: Device) -> np.ndarray:
    """The points behind snapshot 0 of every mask of so many cells a side: exp(i phase)."""
    grid = Grid((2 * cells, 2 * cells), 1e-3)
    return snapshot(RandomPhaseMask(2e-3, distance=0, jitter=False), grid, device)[::2, ::2]


def show(axes: Axes, values: np.ndarray, grid: Grid, **options: Any) -> Any:
    """An image over (x, y) in millimetres."""
    (ny, nx), (dy, dx) = grid.shape, grid.pitch
    x, y = (grid.x[0] - dx / 2) * 1e3, (grid.y[0] - dy / 2) * 1e3
    return axes.imshow(values, extent=(x, x + nx * dx * 1e3, y, y + ny * dy * 1e3), origin="lower",
                       interpolation="nearest", **options)


def show_phase(axes: Axes, u: np.ndarray, grid: Grid) -> Any:
    """The phase of a field over (x, y) in millimetres."""
    return show(axes, np.angle(u), grid, cmap=PHASES, vmin=-np.pi, vmax=np.pi)


def show_points(axes: Axes, points: np.ndarray, window: float, size: float) -> Any:
    """Points at the centres of the cells of a window, coloured by their phase."""
    middles = ((np.arange(len(points)) + 0.5) / len(points) - 0.5) * window * 1e3
    x, y = np.meshgrid(middles, middles)
    axes.set(xlim=(-window * 500, window * 500), ylim=(-window * 500, window * 500), aspect="equal")
    return axes.scatter(x, y, size, np.angle(points), cmap=PHASES, vmin=-np.pi, vmax=np.pi,
                        edgecolors="0.5", linewidths=0.4)


def phase_bar(figure: Any, drawn: Any, axes: Any, **options: Any) -> None:
    """The colour bar of phases."""
    bar = figure.colorbar(drawn, ax=axes, label="phase / rad", ticks=(-np.pi, 0, np.pi), **options)
    bar.set_ticklabels(["-π", "0", "π"])
