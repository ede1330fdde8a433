"""Resolution targets imaged by the thesis' lens in partially coherent light: figures 2.24 to 2.27.

f = 120 mm and D = 3.6 mm in 2f and 2f: fc = D/(2 lam z2), an Airy radius of 0.61/fc = 44.73 um.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from closed import LAM, snr_db
from drawing import LIGHT
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from clplen import Coherence, Device, Field, Grid, OpticalSystem
from clplen.wave import (
    IncoherentLight,
    MeanIntensity,
    Pupil,
    RandomPhaseMask,
    TargetElement,
    abbe_image,
    usaf1951,
    usaf1951_elements,
)

FC = 13636.0  # cycles a metre
AIRY = 0.61 / FC
PUPIL = OpticalSystem([Pupil.of_cutoff(FC, LAM)])
GROUPS, WINDOW = (2, 3, 4), 3.584e-3  # 4 to 28.5 line pairs/mm; metres
COHERENT, LAMP = Coherence(), Coherence(IncoherentLight())
CLOSE_UP = {"xlim": (-0.13, 0.71), "ylim": (0.11, -0.73)}  # of group 4, mm


def usaf(samples: int, device: Device) -> Field:
    """Clear bars on a dark ground."""
    grid = Grid((samples, samples), WINDOW / samples)
    return on(device, usaf1951(grid, groups=GROUPS), grid)


def three_bars(device: Device) -> Field:
    """Five elements, bars of 8, 5, 3, 2 and 1 samples of 10 um, horizontal ones above vertical."""
    grid, column = Grid((256, 256), 10e-6), 15
    t = np.zeros(grid.shape)
    for b in (8, 5, 3, 2, 1):
        for k in (0, 2 * b, 4 * b):
            t[26 + k : 26 + k + b, column : column + 5 * b] = 1
            t[26 + 7 * b : 26 + 12 * b, column + k : column + k + b] = 1
        column += 7 * b
    return on(device, t, grid)


def on(device: Device, t: np.ndarray, grid: Grid) -> Field:
    """A transmission as an object."""
    return Field.from_array(t, grid, wavelength=LAM, device=device)


def clear(thing: Field) -> Field:
    """An object of the same size that is clear all over."""
    return on(thing.device, np.ones(thing.shape), thing.grid)


def masked(thing: Field, cells: int, kind: str = "field") -> Coherence:
    """Light from so many by so many cells of random phase across the window."""
    return Coherence(RandomPhaseMask(thing.grid.extent[1] / cells, kind=kind), seed=1)


def iota_of(thing: Field, cells: int) -> float:
    """Airy radius over cell."""
    return AIRY * cells / thing.grid.extent[1]


def image(thing: Field, light: Coherence) -> np.ndarray:
    """Exact mean intensity, float64."""
    if light in (COHERENT, LAMP):
        return PUPIL(thing, coherence=light).to_numpy().astype(float)
    source = light.spatial.power_spectrum(thing.grid, wavelength=LAM)
    H = PUPIL.parts[0].transfer(thing.grid, LAM)
    return abbe_image(thing, H, source, tolerance=1e-2).intensity.to_numpy().astype(float)


def snr(thing: Field, intensity: np.ndarray) -> float:
    """Signal-to-noise ratio of an image in dB, against that in incoherent light."""
    return snr_db(image(thing, LAMP), intensity)


def averages(thing: Field, light: Coherence, counts: Sequence[int]) -> dict[int, MeanIntensity]:
    """The average after each of the numbers of snapshots; each run goes on from the last."""
    with TemporaryDirectory() as folder:
        how = {"method": "monte-carlo", "checkpoint": Path(folder, "run")}
        return {n: PUPIL(thing, coherence=light, snapshots=n, **how) for n in counts}


def passed(thing: Field, light: Coherence) -> float:
    """Intensity of the image of a clear field."""
    H = PUPIL.parts[0].transfer(thing.grid, LAM)
    if light.spatial is None:
        return float(np.abs(H[0, 0]) ** 2)
    source = light.spatial.power_spectrum(thing.grid, wavelength=LAM)
    return float(np.sum(source * np.abs(H) ** 2))


def show(axes: Axes, intensity: np.ndarray, grid: Grid, largest: float = 1.0) -> AxesImage:
    """Draw an image, its axes in mm."""
    side = grid.extent[1] * 5e2
    axes.set(xlabel="x / mm", ylabel="y / mm" if axes.get_subplotspec().is_first_col() else "")
    return axes.imshow(intensity, cmap=LIGHT, vmin=0, vmax=largest, interpolation="antialiased",
                       extent=(-side, side, side, -side))


def elements() -> tuple[TargetElement, ...]:
    """Where the bars of `usaf` are."""
    return usaf1951_elements(GROUPS)


def contrast(intensity: np.ndarray, grid: Grid, element: TargetElement) -> float:
    """(bars - gaps)/(bars + gaps) of the vertical bars, at their middles, half their length."""
    y, x = element.upright
    rows = np.abs(grid.y - y) < 1.25 * element.width
    cut = np.mean(intensity[rows], axis=0)
    bars, gaps = (np.interp(x + np.array(at) * element.width, grid.x, cut).mean()
                  for at in ((-2, 0, 2), (-1, 1)))
    return float((bars - gaps) / (bars + gaps))
