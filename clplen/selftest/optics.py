"""Checks of apertures, lenslets, sources, partial coherence, and scenes before a camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from clplen.cameras.exposure import isoplanatic
from clplen.cameras.exposure.local_exposure import refined
from clplen.cameras.exposure.point_gradients import point_rows, put_cotangents
from clplen.cameras.exposure.source_images import DeviceImages
from clplen.cameras.exposure.surface_rays import SAMPLES, sample_rays
from clplen.cameras.optics.local_window import LocalWindows, window_shape
from clplen.cameras.optics.objective import Objective
from clplen.cameras.optics.pixel_array import PixelSums, pixel_weights
from clplen.cameras.optics.wave_optics import pupil_fields
from clplen.cameras.plenoptic_camera import PlenopticCamera
from clplen.cameras.scenes.scene_sources import PointSources
from clplen.cameras.scenes.surface_scene import SurfaceScene
from clplen.cameras.scenes.surfaces import Plane, Sphere
from clplen.cameras.scenes.textures import Texture
from clplen.compute.device import Device
from clplen.selftest import twins
from clplen.selftest.check import EPS, Check, Pairs
from clplen.wave.coherence.abbe import abbe_image
from clplen.wave.coherence.extended_source import plane_waves
from clplen.wave.coherence.phase_masks import RandomPhaseMask
from clplen.wave.coherence.spatial_models import IncoherentLight, key_of, philox
from clplen.wave.elements.hard_apertures import disc
from clplen.wave.elements.lenslet_errors import LensletErrors
from clplen.wave.elements.lenslet_surface import LensletMap, LensletSurface
from clplen.wave.elements.lenslets import MicrolensArray
from clplen.wave.field.field import Field, Grid

LAM = 532e-9
DX = 5e-6
PITCH = 9.37 * DX  # of lenslets
STRIPS = 2.6e-4  # 32 strips of exact chord: an error of 2 (1/32)^2/8 of a cell at the rim
SEED, INDEX = 0x123456789ABCDEF0, 7


def _aperture(device: Device) -> Pairs:
    grid, centre = Grid((23, 37), (1e-6, 1.3e-6), origin=(0.5e-6, 0)), (0.4e-6, -1.3e-6)
    field = Field.from_array(np.full(grid.shape, 2 - 1j), grid, wavelength=LAM, device=device)
    y, x = np.meshgrid(grid.y - centre[0], grid.x - centre[1], indexing="ij")
    expected = (2 - 1j) * twins.disc_share(y, x, 8.7e-6, grid.pitch)
    yield expected, disc(field, 8.7e-6, centre).to_numpy()


def _places(mla: MicrolensArray, grid: Grid) -> tuple[Any, Any, Any]:
    """(y, x) of every sample from its nearest lenslet, and the number of that."""
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    centres = mla.centres().reshape(-1, 2)
    index = np.argmin([(y - a) ** 2 + (x - b) ** 2 for a, b in centres], axis=0)
    return y - centres[index, 0], x - centres[index, 1], index


def _lenslets(device: Device) -> Pairs:
    grid = Grid((40, 39), (0.9 * DX, DX), origin=(DX / 2, 0))
    lengths = (2.5e-3, 3.5e-3, -2.8e-3)
    mla = MicrolensArray(
        PITCH, lengths, count=(4, 3), lattice="hexagonal", rotation=0.2, offset=(2e-6, -6e-6)
    )
    dy, dx, index = _places(mla, grid)
    f = np.array(lengths)[mla.types().ravel()[index]]
    phase = np.exp(-1j * np.pi * (dy**2 + dx**2) / (LAM * f))
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    share = sum(
        twins.disc_share(y - a, x - b, PITCH / 2, grid.pitch)
        for a, b in mla.centres().reshape(-1, 2)
    )
    yield np.minimum(share, 1) * phase, device.download(mla.transmission(grid, LAM, device))


def _square_lenslets(device: Device) -> Pairs:
    """Square apertures with gaps; samples astride two lenslets have the nearer one's phase."""
    grid = Grid((31, 41), (0.9 * DX, DX), origin=(1e-6, 0))
    mla = MicrolensArray(PITCH, 2.5e-3, count=(2, 3), fill="full", diameter=0.8 * PITCH)
    dy, dx, _ = _places(mla, grid)
    rows, columns = mla.centres()[:, 0, 0], mla.centres()[0, :, 1]
    down, right = (
        sum(twins.interval_share(axis - c, 0.4 * PITCH, d) for c in middles)
        for axis, middles, d in ((grid.y, rows, 0.9 * DX), (grid.x, columns, DX))
    )
    expected = np.outer(down, right) * np.exp(-1j * np.pi * (dy**2 + dx**2) / (LAM * 2.5e-3))
    yield expected, device.download(mla.transmission(grid, LAM, device))


def _made_lenslets(device: Device) -> Pairs:
    """Round lenslets of an aspheric surface with a tilt as a map, between clear gaps."""
    grid = Grid((33, 38), (DX, 1.1 * DX), origin=(0, DX / 2))
    radius, conic, fourth, tilt = 2e-4, -0.6, 2e11, 0.01
    ramp = tilt * 0.1 * PITCH * np.broadcast_to(np.arange(-6, 6), (11, 12))
    mla = MicrolensArray(
        PITCH,
        count=(3, 4),
        diameter=0.8 * PITCH,
        offset=(2e-6, -6e-6),
        rotation=0.12,
        surface=LensletSurface(radius, 1.5, conic=conic, aspheric=(fourth,)),
        gap="clear",
        map=LensletMap(ramp, pitch=0.1 * PITCH, glass=1.5),
    )
    dy, dx, _ = _places(mla, grid)
    across = dx * np.cos(mla.rotation) + dy * np.sin(mla.rotation)
    half = 0.4 * PITCH
    sags = []
    for r2 in (dy**2 + dx**2, half**2):
        root = np.sqrt(np.maximum(1 - (1 + conic) * r2 / radius**2, 0))
        sags.append(r2 / (radius * (1 + root)) + fourth * r2**2)
    path = 0.5 * (sags[1] - sags[0] - tilt * across)
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    share = sum(
        twins.disc_share(y - a, x - b, half, grid.pitch) for a, b in mla.centres().reshape(-1, 2)
    )
    inside = np.maximum(abs(across), abs(dy * np.cos(mla.rotation) - dx * np.sin(mla.rotation)))
    whole = inside < PITCH / 2 - DX  # cells of samples that lie within the array's
    expected = share * np.exp(2j * np.pi * path / LAM) + 1 - share
    got = device.download(mla.transmission(grid, LAM, device))
    yield expected[whole], got[whole]


def _lenslet_errors(device: Device) -> Pairs:
    grid = Grid((33, 38), (DX, 1.1 * DX), origin=(0, DX / 2))
    mla = MicrolensArray(PITCH, 2.5e-3, count=(3, 4), offset=(2e-6, -6e-6), rotation=0.12)
    random = np.random.default_rng(3)
    f = 2.5e-3 * random.uniform(0.8, 1.2, mla.count)
    tilt, place = (random.uniform(-k, k, (*mla.count, 2)) for k in (2e-3, 4e-6))
    terms = {(2, -2): 0.3 * LAM, (3, 1): -0.2 * LAM}
    circle = 1.2 * PITCH
    errors = LensletErrors(terms, circle, f, tilt, place)
    dy, dx, index = _places(mla, grid)
    cos, sin = np.cos(mla.rotation), np.sin(mla.rotation)
    y, x = dy * cos - dx * sin, dx * cos + dy * sin
    own, (ty, tx), (sy, sx) = (
        f.ravel()[index],
        *(np.moveaxis(a.reshape(-1, 2)[index], -1, 0) for a in (tilt, place)),
    )
    path = -((y - sy) ** 2 + (x - sx) ** 2) / (2 * own) + (y**2 + x**2) / 5e-3 + ty * y + tx * x
    v, u = 2 * y / circle, 2 * x / circle  # astigmatism and coma (Noll 1976, table I)
    path += LAM * (0.3 * 6**0.5 * 2 * u * v - 0.2 * 8**0.5 * (3 * (u**2 + v**2) - 2) * u)
    inside = np.hypot(y, x) < 0.6 * PITCH
    got = device.download(errors.phase(mla, grid, LAM, device))
    yield np.exp(2j * np.pi * path / LAM)[inside], got[inside]


def _point_sources(device: Device) -> Pairs:
    from scipy.special import j1

    grid, size = Grid((24, 37), (40e-6, 30e-6), origin=(20e-6, 0)), 400e-6
    points = np.array([(-3e-3, -2e-3, -0.05), (2.5e-3, 1e-3, 0.05)])
    got = pupil_fields(
        points, size, grid=grid, object_distance=0.24,
        focal_length=0.12, aperture_diameter=0.5e-3, wavelength=LAM, device=device,
    ).to_numpy()  # fmt: skip
    y, x = np.meshgrid(grid.y, grid.x, indexing="ij")
    share = twins.disc_share(y, x, 0.25e-3, grid.pitch)
    for field, (x0, y0, dz) in zip(got, points, strict=True):
        z, rho2 = 0.24 + dz, (x - x0) ** 2 + (y - y0) ** 2
        v = np.pi * size * np.sqrt(rho2) / (LAM * z)
        turns = (np.sqrt(rho2 + z**2) - z) / LAM - (x**2 + y**2) / (2 * LAM * 0.12)
        yield share * 2 * j1(v) / v * np.exp(2j * np.pi * turns), field


def _objective(device: Device) -> Pairs:
    grid = Grid((20, 33), 1e-6, origin=(0.5e-6, 0.0))
    objective = Objective(3.0, 0.4, 1.33, 600e-9)
    points = np.array([(1.1e-6, -2.3e-6, 4e-6), (-0.7e-6, 0.4e-6, -3e-6)])
    got = objective.fields(PointSources(points), grid, device).to_numpy()
    for field, (x0, y0, z) in zip(got, points, strict=True):
        ky = np.exp(2j * np.pi * np.outer(grid.y - 3 * y0, grid.fy))
        kx = np.exp(2j * np.pi * np.outer(grid.x - 3 * x0, grid.fx))
        yield ky @ objective.pupil(grid, z) @ kx.T / field.size, field


def _patterns(device: Device) -> Pairs:
    """Waves of some frequencies on a finer grid, their intensity, and sums of products."""
    (ny, nx), waves = (5, 8), [(-2, 3), (1, -3)]

    def sampled(my: int, mx: int) -> Any:
        y, x = np.arange(my)[:, None] / my, np.arange(mx) / mx
        return np.array([(k + 1j) * np.exp(2j * np.pi * (a * y + b * x))
                         for k, (a, b) in enumerate(waves)])  # fmt: skip

    u = sampled(ny, nx).astype(device.complex)
    field = Field.from_array(u, Grid((ny, nx), 1e-6), wavelength=LAM, device=device)
    spectra = device.upload(u)
    device.fft.forward(spectra, device)
    fine = field.with_data(refined(spectra, 3, device))
    expected = sampled(3 * ny, 3 * nx)
    yield expected / 9, fine.to_numpy()  # the larger window's factor is left to the pattern
    z = device.empty((16, 27), device.complex)
    isoplanatic._put_pattern(z, fine, 1, 2.5)
    device.fft.inverse(z, device)
    power = np.zeros((16, 27))
    power[: 3 * ny, : 3 * nx] = 2.5 * np.abs(expected[1]) ** 2
    yield power, device.download(z)
    a, b, total = (twins.waves(k, 5, 13) for k in (1, 2, 3))
    sums = device.upload(total)
    isoplanatic._add_product(sums, device.upload(a), device.upload(b), device)
    yield total + a.astype(complex) * b, device.download(sums)


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
    """exp(2 pi i r) of the random words of a counter (x//4, y, index, 0)."""
    y, x = np.indices(shape)
    counters = np.stack([x // 4, y, np.full(shape, INDEX), np.zeros(shape)], axis=-1)
    words = philox(counters.astype(np.uint32), key_of(SEED))
    return np.exp(2j * np.pi * np.take_along_axis(words, x[..., None] % 4, -1)[..., 0] / 2.0**32)


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


def _plane_waves(device: Device) -> Pairs:
    grid = Grid((7, 38), (5e-6, 4e-6), origin=(3e-3, -7e-3))
    random = np.random.default_rng(3)
    f = random.uniform(-4e4, 7e4, (13, 2))
    a = random.normal(size=13) + 1j * random.normal(size=13)
    ey, ex = (np.exp(2j * np.pi * np.outer(f[:, k], (grid.y, grid.x)[k])) for k in (0, 1))
    got = plane_waves(f, a, grid=grid, wavelength=LAM, device=device)
    yield np.einsum("p,py,px->yx", a, ey, ex), got.to_numpy()


def _local_window(device: Device) -> Pairs:
    """Light about a chief ray on the array, beside sums over the pupil of spheres to the image."""
    mla = MicrolensArray(10e-6, 40e-6, count=15)
    camera = PlenopticCamera.type1(
        focal_length=0.01, object_distance=1.0, aperture_diameter=2.5e-3, mla=mla, wavelength=LAM,
        pixels_per_lenslet=8, lens_model="corrected", device=device,
    )  # fmt: skip
    place = np.array([(1e-3, -2e-3, -0.2)])
    optics = camera.optics
    windows = LocalWindows.of(optics, window_shape(optics, place[0]), place, 6e-5)
    fields = device.download(windows.array_fields())[0]
    n, pitch = windows.shape.samples, windows.shape.pitch
    index = n // 2 + np.array([(0, 0), (3, -5), (-11, 2), (7, 13)])
    got = np.abs(fields[tuple(index.T)]) / np.sqrt(windows.energy[0]) / pitch
    y, x = (np.asarray(camera.grid.origin) + (windows.centres[0] + index - n // 2) * pitch).T
    v, u, areas = twins.disc_nodes(1.25e-3)
    (x0, y0, dz), z2 = place[0], camera.array_distance
    q = 1 / 0.01 - 1 / (1 + dz)
    slope = np.sqrt(1 + (y0 / (1 + dz) + q * v) ** 2 + (x0 / (1 + dz) + q * u) ** 2)
    foot = np.pi * 6e-5 * np.hypot(v - y0, u - x0) / (LAM * (1 + dz))
    amplitude = slope**-1.5 * twins.disc_pattern(foot)
    beside = (y[:, None] - v) ** 2 + (x[:, None] - u) ** 2
    r = np.sqrt(z2**2 + beside)
    phase = (beside / (r + z2) - (slope - slope[0]) / q) / LAM
    sums = (np.exp(2j * np.pi * phase) / r**2 * amplitude) @ areas
    expected = np.abs(sums) * z2 / LAM / np.sqrt((amplitude**2) @ areas)
    yield expected, got


def _pixels(device: Device) -> Pairs:
    """Integrals of an intensity over the squares of pixels, behind a tile of filters."""
    field = twins.waves(8, 47, 53)
    total = device.zeros((6, 7), device.real)
    sums = PixelSums(first=(14, 15), step=4, width=3.2, place=(1, 2), shape=(5, 4))
    tile = np.array([[0.7, 0.2, 0.4], [0.1, 0.9, 0.3]])
    sums.put(total, device.upload(field[None].astype(device.complex)), 0, tile, device)
    weights = pixel_weights(3.2)
    reach = len(weights) // 2
    expected = np.zeros((6, 7))
    for row, column in np.ndindex(5, 4):
        down, right = 14 + 4 * row - reach, 15 + 4 * column - reach
        part = np.abs(field[down:, right:][: len(weights), : len(weights)]) ** 2
        gain = tile[(1 + row) % 2, (2 + column) % 3]
        expected[1 + row, 2 + column] = gain * (weights @ part @ weights)
    yield expected, device.download(total)


def _source_images(device: Device) -> Pairs:
    """Sums of images on patches, the transpose of these, and how a point's field changes."""
    images, seen = twins.reals(1, 3, 5, 7), twins.reals(2, 2, 11, 13)
    energies, gains = twins.reals(3, 2, 3).astype(float), np.array([0.5, 2.0, 1.5])
    places, shapes = np.array([(1, 2), (1, 2), (6, 6)]), np.array([(5, 7), (5, 7), (4, 6)])
    source = DeviceImages(np.arange(3), device.upload(images), gains, places, shapes, device)
    whole = np.zeros((3, 11, 13))
    for image, gain, out, (y, x), (down, across) in zip(
        images, gains, whole, places, shapes, strict=True
    ):
        out[y : y + down, x : x + across] = gain * image[:down, :across]
    totals = device.upload(seen)
    source.add(totals, energies)
    yield seen + np.einsum("bn,nyx->byx", energies, whole), device.download(totals)
    yield np.einsum("byx,nyx->bn", seen, whole), source.inner(device.upload(seen))
    optics = PlenopticCamera.type1(
        focal_length=0.12, mla=MicrolensArray(150e-6, 10e-3, count=5), wavelength=LAM,
        pixels_per_lenslet=8, aperture_diameter=0.5e-3, device=device,
    ).optics  # fmt: skip
    point = np.array([(3e-3, -2e-3, -0.05)])
    e0 = optics.spherical_waves(point, full_grid=False)
    h = twins.waves(4, *e0.shape)
    got = point_rows(optics, e0, device.upload(h), point, 0.0, np.zeros(1))[0, :3]
    dy, dx, z = e0.grid.y[:, None] + 2e-3, e0.grid.x - 3e-3, optics.object_distance - 0.05
    r, q = np.sqrt(dy**2 + dx**2 + z**2), (h.astype(complex) * e0.to_numpy())[0].imag
    by_z = (dy**2 + dx**2) / (r * (r + z))
    k = 2 * np.pi / LAM
    yield k * np.array([(q * dx / r).sum(), (q * dy / r).sum()]), got[:2]
    yield k * np.array([(q * by_z).sum()]), got[2:]
    conjugates = twins.waves(5, 1, 6, 9)
    back = device.empty(conjugates.shape, device.complex)
    own = np.ascontiguousarray(seen[:1, :6, :9])
    put_cotangents(back, device.upload(conjugates), device.upload(own), np.ones((1, 1)), device)
    yield 2 * conjugates.conj() * own, device.download(back)


CHECKS = (
    Check("aperture", "covered share of each cell by a disc", _aperture, STRIPS,
          ("aperture.cl", "coverage.cl")),
    Check("lenslets", "hexagonal array of three kinds, turned", _lenslets, STRIPS,
          ("lenslets.cl", "nearest_lenslet.cl", "lens_types.cl")),
    Check("lenslets, square", "square apertures with gaps", _square_lenslets, 1e-5,
          ("lenslets.cl", "coverage.cl", "lenslet_coverage.cl")),
    Check("lenslets, as made", "aspheres, clear gaps and a map", _made_lenslets, 2 * STRIPS,
          ("made_lenslets.cl",)),
    Check("lenslet_errors", "tilted, moved, bent lenslets", _lenslet_errors, 1e-5,
          ("lenslet_errors.cl",)),
    Check("local window", "a point's light about its chief ray", _local_window, 1e-3,
          ("local_window.cl", "rim_weights.cl", "disc_pattern.cl")),
    Check("pixels", "intensities integrated over pixels", _pixels, 1e-5, ("pixels.cl",)),
    Check("source images", "sums of images, their transpose, slopes", _source_images, 3e-5,
          ("source_images.cl",)),
    Check("source", "point sources in a lens", _point_sources, STRIPS, ("source.cl",)),
    Check("objective", "points behind a microscope's objective", _objective, 1e-5,
          ("objective.cl",)),
    Check("patterns", "fields on a finer grid, their intensity", _patterns, 1e-5,
          ("patterns.cl",)),
    Check("abbe, lags", "image in partially coherent light, both ways", _abbe, 1e-5,
          ("abbe.cl", "lags.cl")),
    Check("masks", "random phase masks, bits of the generator", _masks, 5e-6,
          ("masks.cl", "philox.cl")),
    Check("plane_waves", "a sum of 13 plane waves", _plane_waves, 16 * EPS, ("plane_waves.cl",)),
)  # fmt: skip


GREY = Texture(twins.reals(1, 5, 7), 2.3, centre=(1.7, -0.6))
GROUND = Plane(-0.9, (0.031, -0.043), texture=GREY, shade=(0.02, -0.013))
BALL = Sphere((0.8, -1.3), 4.6, disparity=-0.4, height=1.7, texture=GREY)


def _hits(ball: Any, ground: Any, y: Any, x: Any, a: Any, b: Any) -> tuple[Any, Any]:
    """d of the ball (or -inf) and of the ground on the rays (y + d a, x + d b)."""
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
    """Of a cubic B-spline at -1, 0, 1, 2, on a new last axis."""
    away = np.abs(np.asarray(t)[..., None] - np.arange(-1, 3))
    near, far = (4 - 6 * away**2 + 3 * away**3) / 6, (2 - away) ** 3 / 6
    return np.where(away <= 1, near, np.where(away < 2, far, 0.0))


def _light(surface: Any, y: Any, x: Any, d: Any, a: Any, b: Any) -> Any:
    """Brightness of a surface at d: its texture, a periodic spline through samples, and shade."""
    from scipy.ndimage import spline_filter

    Y, X = y + d * a, x + d * b
    values = np.asarray(surface.texture.samples, float)[..., 0]
    knots = spline_filter(values, 3, mode="grid-wrap")
    (ny, nx), scale, centre = values.shape, surface.texture.scale, surface.texture.centre
    ty, tx = (Y - centre[0]) / scale + ny // 2, (X - centre[1]) / scale + nx // 2
    rows, columns = (np.floor(t).astype(int)[..., None] + np.arange(-1, 3) for t in (ty, tx))
    wy, wx = (_spline_weights(t - np.floor(t)) for t in (ty, tx))
    found = knots[rows[..., :, None] % ny, columns[..., None, :] % nx]
    shade = np.maximum(0, 1 + surface.shade[0] * Y + surface.shade[1] * X)
    return shade * np.einsum("...i,...j,...ij->...", wy, wx, found)


def _scene(device: Device) -> Pairs:
    """Pixels of which all rays see one surface: brightness by the pixel's centre ray."""
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
        mine, other = (_light(s, y, x, np.where(np.isfinite(d), d, 0), a, b)
                       for s, d in ((BALL, ball), (GROUND, ground)))  # fmt: skip
        plain = (share == 0) | (share == 1)
        rim += np.count_nonzero(~plain)
        yield np.where(share == 1, mine, other)[plain], pictures[v, u][plain]
    assert rim > 0


def _camera(device: Device) -> Pairs:
    """The sensor of a small camera: rays from each pixel through each lenslet, backwards."""
    ground = Plane(-0.15, (0.03, -0.02), texture=Texture(twins.reals(2, 5, 4), 1.3))
    colour = Texture(twins.reals(3, 3, 3))
    ball = Sphere((-0.3, 0.6), 0.7, disparity=0.1, height=0.2, texture=colour)
    mla = MicrolensArray(150e-6, 10e-3, count=(3, 2), fill="full")
    camera = PlenopticCamera.type1(
        focal_length=0.01, mla=mla, wavelength=700e-9, pixels_per_lenslet=6.3, device=device,
        aperture_diameter=0.26e-3,
    )  # fmt: skip
    raw = camera.expose(SurfaceScene([ground, ball], background=0.2), model="rays").to_numpy()
    samples = sample_rays(mla, count=SAMPLES).astype(float)
    z2, z3, pixel = camera.array_distance, camera.sensor_distance, camera.pixel_pitch
    places = np.stack(np.meshgrid(camera.grid.y, camera.grid.x, indexing="ij"), -1)
    sensor = places[:, :, None] + samples[:, 2:] * pixel
    step, expected = pixel * z2 / z3, np.zeros(raw.shape)
    for centre in mla.centres().reshape(-1, 2):
        at = centre + samples[:, :2] * mla.pitch
        u = at - z2 * ((sensor - at) / z3 + samples[:, :2] * mla.pitch / 10e-3)
        passes = (u**2).sum(axis=-1) <= (camera.aperture_diameter / 2) ** 2
        a, b = np.moveaxis(-u / step, -1, 0)
        y, x = (np.broadcast_to(p, a.shape) for p in (at / mla.pitch).T)
        near, far = _hits(ball, ground, y, x, a, b)
        sees = near > far
        light = _light(ground, y, x, far, a, b)
        light[sees] = _light(ball, y, x, np.where(sees, near, 0), a, b)[sees]
        expected += np.where(passes, light, 0).mean(axis=-1)
    # Of 1e5 rays a few meet a rim, and fall on its other side in float32: up to 8 pixels.
    agreed = np.argsort(np.abs(raw - expected), axis=None)[:-8]
    yield expected.ravel()[agreed], raw.ravel()[agreed]


SCENE_CHECKS = (
    Check("scene", "views and disparity of a ground and a ball", _scene, 2e-5,
          ("scene.cl", "surfaces.cl")),
    Check("rays", "the same kind of scene behind a camera", _camera, 1e-4, ("rays.cl",)),
)  # fmt: skip
