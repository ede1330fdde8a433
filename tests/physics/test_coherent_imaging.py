"""Images in light of any coherence: a target's signal-to-noise ratio, edges, gratings, cut-offs.

The lens is that of the thesis, f = 120 mm and D = 3.6 mm in 2f and 2f at 550 nm: fc = 13636 /m.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference_abbe as abbe
from tolerance import snr_db

from clplen import Coherence, Device, Field, Grid, OpticalSystem
from clplen.wave import IncoherentLight, Pupil, RandomPhaseMask, imaging_system
from clplen.wave.systems.pupil_filter import coherent_edge, incoherent_edge

pytestmark = pytest.mark.thorough

LAM = 550e-9
F, D = 0.12, 3.6e-3
FC = D / (2 * LAM * 2 * F)
AIRY = 0.61 / FC


def on(device: Device, t: np.ndarray, grid: Grid) -> Field:
    return Field.from_array(t, grid, wavelength=LAM, device=device)


def seen(system: OpticalSystem, thing: Field, light: Coherence, **averaging) -> np.ndarray:
    return system(thing, coherence=light, **averaging).to_numpy().astype(float)


# Signal-to-noise ratio against the incoherent image ----------------------------------------------

N, PITCH = 256, 10e-6
PUPIL = OpticalSystem([Pupil.of_cutoff(13636.0, LAM)])
COHERENT = 8.7


@pytest.fixture(scope="module")
def target(device: Device) -> Field:
    return on(device, abbe.three_bar_target(N), Grid((N, N), PITCH))


@pytest.fixture(scope="module")
def incoherent(target: Field) -> np.ndarray:
    return seen(PUPIL, target, Coherence(IncoherentLight()))


def test_the_limits_of_the_target(target, incoherent):
    # against the hard edged float64 pupil: the package's rim is weighted by area
    assert snr_db(abbe.incoherent_image(abbe.three_bar_target(N), FC * PITCH), incoherent) > 45
    coherent = seen(PUPIL, target, Coherence())
    assert snr_db(incoherent, coherent) == pytest.approx(COHERENT, abs=0.1)


def test_one_phase_mask(target, incoherent):
    for cells, expected in [(4, 8.0), (8, 7.6), (32, 5.5)]:
        # mean of six float64 runs, which scatter by .1 to .3 dB; a field mask has 2.3, 2.3, 2.8
        light = Coherence(RandomPhaseMask(N * PITCH / cells, kind="phase"), seed=3)
        image = seen(PUPIL, target, light, snapshots=1, method="monte-carlo")
        assert snr_db(incoherent, image) == pytest.approx(expected, abs=1)


# Edges -------------------------------------------------------------------------------------------


def strip(coordinates: np.ndarray, first: float, last: float, pitch: float) -> np.ndarray:
    """1 from first to last, the two samples on an edge 1/2."""
    inside = (coordinates > first) & (coordinates < last)
    on_edge = np.minimum(np.abs(coordinates - first), np.abs(coordinates - last)) < 1e-3 * pitch
    return np.where(on_edge, 0.5, inside)


def rms(difference: np.ndarray, where: np.ndarray) -> float:
    return float(np.sqrt(np.mean(difference[where] ** 2)))


LINE = Grid((1, 2048), 5e-6)  # of the whole 2f system: its lens is a slit here


@pytest.fixture(scope="module")
def lens() -> OpticalSystem:
    return imaging_system(F, diameter=D, koehler=True)


@pytest.fixture(scope="module")
def points(device: Device, lens: OpticalSystem) -> np.ndarray:
    """Images of 200 points at x = 0, 5 um ...; each row over the image of a clear field."""
    u = np.zeros((200, *LINE.shape))
    u[np.arange(200), 0, np.arange(200) + 1024] = 1
    images = np.abs(lens(on(device, u, LINE)).to_numpy()[:, 0].astype(complex)) ** 2
    # a point of one sample: dx 2 fc sinc(2 fc x) in amplitude; all of them: dx 2 fc
    return images / (2 * FC * LINE.pitch[1])


def test_coherent_edge_through_the_lens(device, lens):
    t = strip(LINE.x, 0.0, 2.5e-3, LINE.pitch[1])[None]
    image = (np.abs(lens(on(device, t, LINE)).to_numpy().astype(complex)) ** 2)[0]
    x_fc = -LINE.x * FC  # the image is upside down
    near = np.abs(x_fc) < 6
    assert image[x_fc == 0] == pytest.approx(0.25, abs=0.01)
    assert image[near].max() == pytest.approx(1.187, abs=0.02)
    assert rms(image - coherent_edge(x_fc), near) <= 0.0041  # worst of the reference's runs


def test_incoherent_edge_through_the_lens(points):
    weights = np.ones(200)
    weights[0] = 0.5  # on the edge
    image = weights @ points
    x_fc = -LINE.x * FC
    near = np.abs(x_fc) < 6  # the far edge is 13 resolution cells away
    assert image[x_fc == 0] == pytest.approx(0.5, abs=0.01)
    assert image[near].max() < 1
    assert rms(image - incoherent_edge(x_fc, shape="slit"), near) <= 0.0032


def test_edges_in_the_light_of_a_mask(device):
    for iota, edge, maximum, samples, cells in [
        (0.1, 0.254, 1.167, (32, 98), (2, 5)),
        (0.25, 0.262, 1.143, (13, 39), (3, 14)),
        (0.5, 0.270, 1.104, (6, 20), (4, 26)),
        (1, 0.334, 0.997, (3, 10), (8, 52)),
        (2, 0.411, 0.994, (2, 5), (16, 104)),
        (4, 0.451, 0.993, (2, 3), (30, 210)),
    ]:
        p = AIRY / iota
        shape = tuple(m * n for m, n in zip(samples, cells, strict=True))
        grid = Grid(shape, tuple(p / m for m in samples))
        half = shape[1] // 4
        lit = strip(grid.x, -half * grid.pitch[1], half * grid.pitch[1], grid.pitch[1])
        light, system = Coherence(RandomPhaseMask(p)), OpticalSystem([Pupil(D, 2 * F)])
        image, clear = (
            seen(system, on(device, np.broadcast_to(t, shape), grid), light, method="abbe")[0]
            for t in (lit, np.ones(shape))
        )
        image = image[shape[1] // 2 - half :][: 2 * half] / clear.mean()
        assert image[0] == pytest.approx(edge, abs=0.01)
        assert image.max() == pytest.approx(maximum, abs=0.01)


# Gratings ----------------------------------------------------------------------------------------
