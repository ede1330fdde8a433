"""The thesis' 2f system as a pupil and as a whole: gratings and edges of figures 2.28 and 2.29."""

from collections.abc import Sequence

import numpy as np
from closed import LAM
from target import LAMP, on
from two_f import D, F, Z

from clplen import Coherence, Device, Grid, OpticalSystem
from clplen.wave import Pupil, imaging_system

FC = D / (2 * LAM * Z)
PUPIL = OpticalSystem([Pupil(D, Z)])  # as a filter of frequencies
LENS = imaging_system(F, diameter=D, koehler=True)  # space, lens, space
PLANE = Grid((1024, 1024), 6.6e-6)  # of the lens
SOFT = np.exp(-(np.hypot(PLANE.y[:, None], PLANE.x) / 1.5e-3) ** 8)  # where the object ends
MIDDLE = 512


def filtered(t: np.ndarray, grid: Grid, light: Coherence, device: Device) -> np.ndarray:
    """Image of an object through the pupil."""
    return PUPIL(on(device, t, grid), coherence=light).to_numpy().astype(float)


def through_the_lens(t: np.ndarray, device: Device) -> np.ndarray:
    """Intensity behind the whole system, coherent."""
    return np.abs(LENS(on(device, t, PLANE)).to_numpy().astype(complex)) ** 2


def point_image(device: Device) -> np.ndarray:
    """Image of one sample, over the image of a clear field in incoherent light."""
    point = np.zeros(PLANE.shape)
    point[MIDDLE, MIDDLE] = 1
    return through_the_lens(point, device) / (np.pi * (FC * PLANE.pitch[1]) ** 2)


def transfer_of_grating(f: float, device: Device) -> float:
    """Amplitude of the image of a grating cos(2 pi f x) over that of the grating."""
    t = SOFT * np.cos(2 * np.pi * f * PLANE.x)
    return float(np.sqrt(through_the_lens(t, device).sum() / np.sum(t**2)))


def edge_through_the_pupil(
    shape: Sequence[int], pitch: Sequence[float], light: Coherence, device: Device
) -> tuple[np.ndarray, np.ndarray]:
    """fc x from the edge, and the image of the bright half of a periodic window."""
    grid = Grid((shape[0], shape[1]), (pitch[0], pitch[1]))
    quarter = grid.shape[1] // 4 * grid.pitch[1]
    strip = np.clip(0.5 + (quarter - np.abs(grid.x)) / grid.pitch[1], 0, 1) * np.ones(grid.shape)
    if light is LAMP:
        strip = np.sqrt(strip)  # the sample on the edge is half as bright
    seen, clear = (filtered(t, grid, light, device) for t in (strip, np.ones(grid.shape)))
    return (grid.x + quarter) * FC, seen[0] / clear.mean()


def edge_through_the_lens(device: Device) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """fc x from the edge; coherent, and incoherent as the sum of the images of all points."""
    step = np.clip(0.5 + PLANE.x / PLANE.pitch[1], 0, 1)
    coherent = through_the_lens(SOFT * step, device)[MIDDLE]
    line = point_image(device).sum(axis=0)[::-1]  # the image is upside down
    return -PLANE.x * FC, coherent, (np.cumsum(line) - line / 2)[::-1]
