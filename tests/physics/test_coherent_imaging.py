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
from clplen.wave.elements.transparency import usaf1951
from clplen.wave.systems.pupil_filter import coherent_edge, incoherent_edge, otf

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
COUNTS = (25, 100, 300)
TABLE = {  # section 9.2 of the reference: dB after so many snapshots, by cells across the window
    "field": {
        4: (7.7, 8.7, 8.9),
        8: (8.1, 9.1, 9.1),
        32: (9.7, 10.6, 10.8),
        128: (14.1, 18.6, 20.6),
    },
    "phase": {
        4: (8.9, 8.9, 8.9),
        8: (9.2, 9.3, 9.3),
        32: (10.7, 11.2, 11.3),
        128: (14.4, 19.1, 20.8),
    },
}
COHERENT = 8.7


@pytest.fixture(scope="module")
def target(device: Device) -> Field:
    return on(device, abbe.three_bar_target(N), Grid((N, N), PITCH))


@pytest.fixture(scope="module")
def incoherent(target: Field) -> np.ndarray:
    return seen(PUPIL, target, Coherence(IncoherentLight()))


@pytest.fixture(scope="module")
def table(target: Field, incoherent: np.ndarray, tmp_path_factory) -> dict:
    """The ratios of all masks: 300 snapshots each, read at 25 and 100 from their checkpoint."""
    found: dict[str, dict[int, list[float]]] = {}
    for kind, rows in TABLE.items():
        found[kind] = {}
        for cells in rows:
            light = Coherence(RandomPhaseMask(N * PITCH / cells, kind=kind), seed=1)
            kept = tmp_path_factory.mktemp("table") / "run"
            run = {"method": "monte-carlo", "checkpoint": kept}
            images = [seen(PUPIL, target, light, snapshots=m, **run) for m in COUNTS]
            found[kind][cells] = [snr_db(incoherent, image) for image in images]
    return found


def test_the_limits_of_the_target(target, incoherent):
    # against the hard edged float64 pupil: the package's rim is weighted by area
    assert snr_db(abbe.incoherent_image(abbe.three_bar_target(N), FC * PITCH), incoherent) > 45
    coherent = seen(PUPIL, target, Coherence())
    assert snr_db(incoherent, coherent) == pytest.approx(COHERENT, abs=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("cells", [4, 8, 32, 128])
@pytest.mark.parametrize("kind", ["field", "phase"])
def test_table_of_masks(table, kind, cells):
    # single runs scatter by .5, .2, .2 dB about their mean, and so do those of the table
    for found, expected, within in zip(
        table[kind][cells], TABLE[kind][cells], (1.5, 1, 1), strict=True
    ):
        assert found == pytest.approx(expected, abs=within)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["field", "phase"])
def test_trend_of_masks(table, kind):
    rows = table[kind]
    last = [rows[cells][-1] for cells in (4, 8, 32, 128)]
    assert last == sorted(last)
    assert last[0] == pytest.approx(COHERENT, abs=1)  # iota = .07
    assert last[-1] >= 19  # iota = 2.24
    assert rows[128][0] + 3 < rows[128][1] < rows[128][2] - 1  # rises with M


@pytest.mark.parametrize(("cells", "expected"), [(4, 8.0), (8, 7.6), (32, 5.5)])
def test_one_phase_mask(target, incoherent, cells, expected):
    # mean of six float64 runs, which scatter by .1 to .3 dB; a field mask has 2.3, 2.3, 2.8
    light = Coherence(RandomPhaseMask(N * PITCH / cells, kind="phase"), seed=3)
    image = seen(PUPIL, target, light, snapshots=1, method="monte-carlo")
    assert snr_db(incoherent, image) == pytest.approx(expected, abs=1)


@pytest.mark.nightly
def test_trend_on_the_usaf_target(device):
    # another target, cut-off and window, dy != dx, cells longer than wide
    grid = Grid((144, 128), (9e-6, 10e-6))
    thing = on(device, usaf1951(grid, groups=(4, 5), centre=(30e-6, -50e-6)), grid)
    system = OpticalSystem([Pupil.of_cutoff(2e4, LAM)])
    lamp = seen(system, thing, Coherence(IncoherentLight()))
    ratios = []
    for cells in ((4, 8), (8, 64), (32, 64)):  # iota = .09, .19, .75 along y; .19, 1.5, 1.5
        sides = tuple(side / n for side, n in zip(grid.extent, cells, strict=True))
        light = Coherence(RandomPhaseMask(sides), seed=2)
        counts = (20, 100)
        images = [seen(system, thing, light, snapshots=m, method="monte-carlo") for m in counts]
        exact = seen(system, thing, light, method="abbe")
        error = np.linalg.norm(images[-1] - exact) / np.linalg.norm(exact)
        assert error <= 1.7 / np.sqrt(counts[-1])  # 1.6 for 4 by 8 cells, else 1; x for y: 1.8, 3
        few, many, most = (snr_db(lamp, image) for image in (*images, exact))
        assert few < many < most + 0.5
        ratios.append((many, most))
    assert all(np.diff(ratios, axis=0).ravel() > 0)  # finer cells, nearer to incoherent light
    coherent = snr_db(lamp, seen(system, thing, Coherence()))
    assert coherent < ratios[0][1] < coherent + 1.5
    assert ratios[2][0] > coherent + 4


# Edges -------------------------------------------------------------------------------------------


def strip(coordinates: np.ndarray, first: float, last: float, pitch: float) -> np.ndarray:
    """1 from first to last, the two samples on an edge 1/2."""
    inside = (coordinates > first) & (coordinates < last)
    on_edge = np.minimum(np.abs(coordinates - first), np.abs(coordinates - last)) < 1e-3 * pitch
    return np.where(on_edge, 0.5, inside)


@pytest.mark.parametrize(("shape", "rim"), [((512, 512), "circular"), ((512, 1), "slit")])
def test_edges_through_a_pupil(device, shape, rim):
    pitch = 1 / (16 * FC)
    grid = Grid(shape, (pitch, 1.1 * pitch))
    half = 128 * pitch
    edge = strip(grid.y, -half, half, pitch)[:, None] * np.ones(shape)
    system = OpticalSystem([Pupil(D, 2 * F)])
    y_fc = (grid.y + half) * FC
    near = np.abs(y_fc) < 6
    coherent = seen(system, on(device, edge, grid), Coherence())[:, shape[1] // 2]
    assert coherent[y_fc == 0] == pytest.approx(0.25, abs=0.005)
    assert coherent[near].max() == pytest.approx(1.187, abs=0.02)
    assert np.abs(coherent - coherent_edge(y_fc))[near].max() <= 0.006
    lamp = Coherence(IncoherentLight())
    clear = seen(system, on(device, np.ones(shape), grid), lamp).mean()
    image = seen(system, on(device, np.sqrt(edge), grid), lamp)[:, shape[1] // 2] / clear
    assert image[y_fc == 0] == pytest.approx(0.5, abs=0.005)
    # the rim of the sampled pupil bends it by .004, the far edge adds .003
    assert np.abs(image[near] - incoherent_edge(y_fc[near], shape=rim)).max() <= 0.006


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


@pytest.mark.parametrize(
    ("iota", "edge", "maximum", "samples", "cells"),
    [  # samples (y, x) a cell of p = .61/(iota fc), about 16 to 1/fc along x; cells (y, x)
        (0.1, 0.254, 1.167, (32, 98), (2, 5)),
        (0.25, 0.262, 1.143, (13, 39), (3, 14)),
        (0.5, 0.270, 1.104, (6, 20), (4, 26)),
        (1, 0.334, 0.997, (3, 10), (8, 52)),
        (2, 0.411, 0.994, (2, 5), (16, 104)),
        (4, 0.451, 0.993, (2, 3), (30, 210)),
    ],
)
def test_edges_in_the_light_of_a_mask(device, iota, edge, maximum, samples, cells):
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

GRATINGS = {0.91: 0.444, 1.09: 0.340, 1.5: 0.143, 1.91: 0.010, 2.09: 0.0}  # f/fc: incoherent


def contrast(image: np.ndarray) -> float:
    return float((image.max() - image.min()) / (image.max() + image.min()))


@pytest.mark.parametrize(("ratio", "expected"), GRATINGS.items())
def test_contrast_of_gratings(device, ratio, expected):
    cycles, rim = round(56 * ratio), 56  # across the window: 51, 61, 84, 107, 117
    grid = Grid((224, 280), (1.2 * rim / (224 * FC), rim / (280 * FC)))
    wave = np.cos(2 * np.pi * cycles * np.arange(280) / 280) * np.ones((224, 1))
    system = OpticalSystem([Pupil(D, 2 * F)])
    coherent = seen(system, on(device, (1 + wave) / 2, grid), Coherence())
    assert contrast(coherent) == pytest.approx(1 if ratio < 1 else 0, abs=1e-3)
    lamp = Coherence(IncoherentLight())
    image = seen(system, on(device, np.sqrt((1 + wave) / 2), grid), lamp)
    share = np.abs(np.fft.fft(image.mean(axis=0)))
    found = 2 * share[cycles] / share[0]
    assert found == pytest.approx(expected, abs=0.005)
    assert found == pytest.approx(float(otf(cycles / 112)), abs=0.004)  # 56 samples of a radius


@pytest.mark.parametrize(("ratio", "passes"), [(0.91, True), (1.09, False)])
def test_coherent_cut_off_of_the_lens(device, lens, ratio, passes):
    # soft ends: what they spread, 1/(2 mm) or .04 fc, keeps clear of fc but for 1 %
    wave = np.exp(-((LINE.x / 2e-3) ** 8)) * np.cos(2 * np.pi * ratio * FC * LINE.x)
    u = lens(on(device, wave[None], LINE)).to_numpy()[0].astype(complex)
    found = np.linalg.norm(u) / np.linalg.norm(wave)
    assert found == pytest.approx(1 if passes else 0, abs=0.02)


@pytest.mark.parametrize("ratio", [0.91, 1.5, 2.09])
def test_incoherent_cut_off_of_the_lens(points, ratio):
    # the transfer function is that of one point image, summed: a slit's, 1 - f/(2 fc)
    x = LINE.x[None, :] + LINE.pitch[1] * np.arange(200)[:, None]  # from each image point
    near = np.abs(x) < 1.5e-3
    waves = np.where(near, np.cos(2 * np.pi * ratio * FC * x), 0)
    found = (points * waves).sum(axis=1)
    expected = float(otf(ratio / 2, shape="slit"))
    # what lies beyond 1.5 mm = 20/fc of sinc^2: 1/(pi^2 2 fc 1.5 mm) = .0025
    np.testing.assert_allclose(found, expected, atol=0.01)
