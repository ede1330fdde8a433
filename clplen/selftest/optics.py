"""Checks of apertures, lenslets, sources, partial coherence and scenes."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.cameras.optics.wave_optics import pupil_fields
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import Plane, Sphere
from clplen.cameras.scenes.textures import Texture
from clplen.compute.device import Device
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs
from clplen.wave.coherence.abbe import abbe_image
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.coherence.spatial_models import IncoherentLight, key_of, philox
from clplen.wave.elements.hard_apertures import disc
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid

LAM = 532e-9
DX = 5e-6
PITCH = 9.37 * DX  # pitch of the lenslets
STRIPS = 2.6e-4  # 32 strips of exact chord: an error of 2 (1/32)^2/8 of a cell at the rim
SEED, INDEX = 0x123456789ABCDEF0, 7


def _aperture(device: Device) -> Pairs:
    grid, centre = Grid((23, 37), (1e-6, 1.3e-6), origin=(0.5e-6, 0)), (0.4e-6, -1.3e-6)
    field = Field.from_array(np.full(grid.shape, 2 - 1j), grid, wavelength=LAM, device=device)
    y, x = np.meshgrid(grid.y - centre[0], grid.x - centre[1], indexing="ij")
    expected = (2 - 1j) * twins.disc_share(y, x, 8.7e-6, grid.pitch)
    yield expected, disc(field, 8.7e-6, centre).to_numpy()


def _lenslets(device: Device) -> Pairs:
    grid = Grid((40, 39), (0.9 * DX, DX), origin=(DX / 2, 0))
    lengths = (2.5e-3, 3.5e-3, -2.8e-3)
    mla = MicrolensArray(
        PITCH, lengths, count=(4, 3), lattice="hexagonal", rotation=0.2, offset=(2e-6, -6e-6)
    )
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    squares = np.array([(y - a) ** 2 + (x - b) ** 2 for a, b in centres])
    f = np.array(lengths)[mla.types().ravel()[squares.argmin(axis=0)]]
    phase = np.exp(-1j * np.pi * squares.min(axis=0) / (LAM * f))
    share = sum(twins.disc_share(y - a, x - b, PITCH / 2, grid.pitch) for a, b in centres)
    yield np.minimum(share, 1) * phase, device.download(mla.transmission(grid, LAM, device))


def _point_sources(device: Device) -> Pairs:
    from scipy.special import j1

    grid, size = Grid((24, 37), (40e-6, 30e-6), origin=(20e-6, 0)), 400e-6
    points = np.array([(-3e-3, -2e-3, -0.05), (2.5e-3, 1e-3, 0.05)])
    fields = pupil_fields(
        points, size, grid=grid, object_distance=0.24,
        focal_length=0.12, aperture_diameter=0.5e-3, wavelength=LAM, device=device,
    ).to_numpy()  # fmt: skip
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    share = twins.disc_share(y, x, 0.25e-3, grid.pitch)
    for field, (x0, y0, dz) in zip(fields, points, strict=True):
        z, rho2 = 0.24 + dz, (x - x0) ** 2 + (y - y0) ** 2
        v = np.pi * size * np.sqrt(rho2) / (LAM * z)
        turns = (np.sqrt(rho2 + z**2) - z) / LAM - (x**2 + y**2) / (2 * LAM * 0.12)
        yield share * 2 * j1(v) / v * np.exp(2j * np.pi * turns), field


def _abbe(device: Device) -> Pairs:
    grid = Grid((12, 15), 2e-6)
    u = twins.waves(4, *grid.shape)
    field = Field.from_array(u, grid, wavelength=LAM, device=device)
    fy, fx = (np.fft.fftfreq(n) * n for n in grid.shape)
    H = np.where(fy[:, None] ** 2 + (fx - 1) ** 2 < 8, np.exp(0.3j * fy[:, None] + 0.1j * fx), 0)
    S = np.zeros(grid.shape)
    S[0, 0], S[1, 2], S[-2, 3], S[3, -1] = 0.1, 0.4, 0.2, 0.3
    expected = np.zeros(grid.shape)
    y, x = np.arange(12)[:, None] / 12, np.arange(15) / 15
    for ky, kx in np.argwhere(S):
        lit = np.fft.fft2(u * np.exp(2j * np.pi * (ky * y + kx * x)))
        expected += S[ky, kx] * np.abs(np.fft.ifft2(lit * H)) ** 2
    for route in ("points", "lags"):
        yield expected, abbe_image(field, H, S, route=route).intensity.to_numpy()


def _phasors(shape: tuple[int, int]) -> Any:
    """Return exp(2 pi i r) of the random numbers of a counter (x//4, y, index, 0)."""
    y, x = np.indices(shape)
    counters = np.stack([x // 4, y, np.full(shape, INDEX), np.zeros(shape)], axis=-1)
    numbers = philox(counters.astype(np.uint32), key_of(SEED))
    return np.exp(2j * np.pi * np.take_along_axis(numbers, x[..., None] % 4, -1)[..., 0] / 2.0**32)


def _masks(device: Device) -> Pairs:
    grid, cells, taps = Grid((11, 19), 2e-6), (4, 7), 3
    light = IncoherentLight().field(grid, wavelength=LAM, device=device, seed=SEED, index=INDEX)
    yield _phasors(grid.shape), light.to_numpy()
    rng = np.random.default_rng(3)
    tables = [
        (rng.integers(0, m, (n, taps)).astype(np.int32), rng.random((n, taps)))
        for n, m in zip(grid.shape, cells, strict=True)
    ]
    mask = RandomPhaseMask(5e-6)
    spread = mask._blocks(grid, cells, tables, device, key_of(SEED), INDEX)
    (rows, wy), (columns, wx) = tables
    expected = np.einsum("ya,xb,yaxb->yx", wy, wx, _phasors(cells)[rows][:, :, columns])
    yield expected, device.download(spread)
    alone = mask._phase_of(Field(spread, grid, LAM, device))
    yield expected / np.abs(expected), alone.to_numpy()


GREY = Texture(twins.reals(1, 5, 7), 2.3, centre=(1.7, -0.6))
GROUND = Plane(-0.9, (0.031, -0.043), texture=GREY, shade=(0.02, -0.013))
BALL = Sphere((0.8, -1.3), 4.6, disparity=-0.4, height=1.7, texture=GREY)


def _hits(ball: Any, ground: Any, y: Any, x: Any, a: Any, b: Any) -> tuple[Any, Any]:
    """Return d of the ball (or -inf) and of the ground on the rays (y + d a, x + d b)."""
    d = (ground.disparity + ground.slope[0] * y + ground.slope[1] * x) / (
        1 - ground.slope[0] * a - ground.slope[1] * b
    )
    h, r = ball.height, ball.radius
    py, px = y - ball.centre[0], x - ball.centre[1]
    A = 1 / h**2 + (a**2 + b**2) / r**2  # A d^2 - 2 B d + C = 0
    B = ball.disparity / h**2 - (py * a + px * b) / r**2
    C = (ball.disparity / h) ** 2 + (py**2 + px**2) / r**2 - 1
    root = B**2 - A * C
    return np.where(root >= 0, (B + np.sqrt(np.maximum(root, 0))) / A, -np.inf), d


def _spline_weights(t: Any) -> Any:
    """Return weights of a cubic B-spline at -1, 0, 1, 2, on a new last axis."""
    distances = np.abs(np.asarray(t)[..., None] - np.arange(-1, 3))
    near, far = (4 - 6 * distances**2 + 3 * distances**3) / 6, (2 - distances) ** 3 / 6
    return np.where(distances <= 1, near, np.where(distances < 2, far, 0.0))


def _light(surface: Any, y: Any, x: Any, d: Any, a: Any, b: Any) -> Any:
    """Compute the brightness of a surface at d: periodic spline texture times shade."""
    from scipy.ndimage import spline_filter

    Y, X = y + d * a, x + d * b
    values = np.asarray(surface.texture.samples, float)[..., 0]
    knots = spline_filter(values, 3, mode="grid-wrap")
    (ny, nx), scale, centre = values.shape, surface.texture.scale, surface.texture.centre
    ty, tx = (Y - centre[0]) / scale + ny // 2, (X - centre[1]) / scale + nx // 2
    rows, columns = (np.floor(t).astype(int)[..., None] + np.arange(-1, 3) for t in (ty, tx))
    wy, wx = (_spline_weights(t - np.floor(t)) for t in (ty, tx))
    coefficients = knots[rows[..., :, None] % ny, columns[..., None, :] % nx]
    shade = np.maximum(0, 1 + surface.shade[0] * Y + surface.shade[1] * X)
    return shade * np.einsum("...i,...j,...ij->...", wy, wx, coefficients)


def _scene(device: Device) -> Pairs:
    """Check pixels whose rays all hit one surface, by the brightness of the centre ray."""
    views, (ny, nx) = (2, 3), (11, 14)
    lf, truth = SurfaceScene([GROUND, BALL]).light_field(views, (ny, nx), device=device)
    y, x = np.arange(ny)[:, None] - (ny - 1) / 2, np.arange(nx) - (nx - 1) / 2
    y, x = np.broadcast_arrays(y, x)
    yield np.maximum(*_hits(BALL, GROUND, y, x, 0, 0)), truth.disparity
    parts = np.linspace(-0.5, 0.5, 11)
    pictures, rim = lf.to_numpy(), 0
    for v, u in np.ndindex(views):
        a, b = v - 0.5, u - 1.0
        ball, ground = _hits(BALL, GROUND, y, x, a, b)
        fine = _hits(
            BALL, GROUND, y[..., None, None] + parts[:, None], x[..., None, None] + parts, a, b
        )
        share = (fine[0] > fine[1]).mean(axis=(2, 3))
        ball_light, ground_light = (
            _light(s, y, x, np.where(np.isfinite(d), d, 0), a, b)
            for s, d in ((BALL, ball), (GROUND, ground))
        )
        plain = (share == 0) | (share == 1)
        rim += np.count_nonzero(~plain)
        yield np.where(share == 1, ball_light, ground_light)[plain], pictures[v, u][plain]
    assert rim > 0


CHECKS = (
    Check("aperture", "covered share of each cell by a disc", _aperture, STRIPS,
          ("aperture.cl", "coverage.cl")),
    Check("lenslets", "hexagonal array of three kinds, turned", _lenslets, STRIPS,
          ("lenslets.cl", "lenslet_coverage.cl", "nearest_lenslet.cl", "lens_types.cl")),
    Check("source", "point sources in a lens", _point_sources, STRIPS,
          ("source.cl", "disc_pattern.cl")),
    Check("abbe, lags", "image in partially coherent light, both ways", _abbe, 1e-5,
          ("abbe.cl", "lags.cl")),
    Check("masks", "random phase masks, bits of the generator", _masks, 5e-6, ("masks.cl",)),
    Check("scene", "views and disparity of a ground and a ball", _scene, 2e-5,
          ("scene.cl", "surfaces.cl")),
)  # fmt: skip
