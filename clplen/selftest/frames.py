"""Checks of raw images: decoding, devignetting, focused cameras, and volumes of microscopes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clplen.compute.device import Device
from clplen.lightfield.calibration import raw_decoding
from clplen.lightfield.focused import focused_spots
from clplen.lightfield.focused.focused_geometry import FocusedGeometry
from clplen.lightfield.focused.focused_matching import Matcher
from clplen.lightfield.focused.focused_rendering import render_focused
from clplen.lightfield.raw.colour_fit import fit_colours
from clplen.lightfield.raw.decode import resample
from clplen.lightfield.raw.demosaicing import views_of_colours
from clplen.lightfield.raw.lenslet_grid import LensletGrid
from clplen.lightfield.raw.raw_image import RawImage
from clplen.microscopy.model.images import PointImages
from clplen.microscopy.reconstruction.deconvolution import LEAST, deconvolve
from clplen.microscopy.reconstruction.priors import (
    EVEN,
    SMOOTH,
    Sieve,
    TimeVariation,
    TotalVariation,
)
from clplen.microscopy.reconstruction.projector import Projector
from clplen.selftest import twins
from clplen.selftest.check import Check, Pairs

TURNED = LensletGrid((5, 7), (4, 6), (13.2, 9.7), (9.3, -1.1), (1.2, 9.4), 0.5)
UPRIGHT = LensletGrid((5, 8), (6, 4), (9.3, 7.1), (9.41, 0.0), (0.0, 9.87))


def _raw(values: Any, device: Device, grid: LensletGrid) -> RawImage:
    return RawImage(device.upload(values), device, math.nan, grid, grid)


def _sampled(raw: Any, y: Any, x: Any, kernel: Any = twins.keys, *, clamp: bool = False) -> Any:
    """A picture (ny, nx) at places of any shape; 0 off the sensor, or with its edges repeated."""
    shape = np.broadcast(y, x).shape
    my, mx = (
        twins.interpolation(np.broadcast_to(p, shape).ravel(), n, kernel=kernel, clamp=clamp)
        for p, n in ((y, raw.shape[0]), (x, raw.shape[1]))
    )
    return np.einsum("pi,ij,pj->p", my, raw.astype(float), mx, optimize=True).reshape(shape)


def lenslet_centres(grid: LensletGrid) -> Any:
    """(y, x) of the lenslets' centres, shape (2, rows, columns)."""
    i, k = np.indices(grid.count)
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    first, row, column = (
        np.array(p)[:, None, None] for p in (grid.first, grid.row_step, grid.column_step)
    )
    return first + i * row + k * column


def _views_of(raw: Any, grid: LensletGrid, kernel: Any = twins.keys) -> Any:
    """L[v, u, i, k] at the true centres."""
    V, U = grid.views
    y, x = lenslet_centres(grid)
    down, right = np.arange(V) - (V - 1) / 2, np.arange(U) - (U - 1) / 2
    return _sampled(raw, y + down[:, None, None, None], x + right[:, None, None], kernel)


def _decode(device: Device) -> Pairs:
    """Rows of a hexagonal array that are moved by half a lenslet are interpolated to the others."""
    raw = twins.reals(1, 61, 83)
    expected = _views_of(raw, TURNED)
    columns = TURNED.count[1]
    back = twins.interpolation(np.arange(columns) - 0.5, columns, kernel=twins.keys, clamp=True)
    expected[:, :, 1::2] = expected[:, :, 1::2] @ back.T
    yield expected, device.download(resample(_raw(raw, device, TURNED), TURNED))


def _upright(device: Device) -> Pairs:
    raw = twins.reals(2, 57, 91)
    yield _views_of(raw, UPRIGHT), device.download(resample(_raw(raw, device, UPRIGHT), UPRIGHT))


def _divided(device: Device) -> Pairs:
    """Over the white level, and the colours of a Bayer mosaic from neighbouring lenslets."""
    raw, white = twins.reals(3, 2, 3, 5, 7), twins.reals(4, 2, 3, 5, 7, low=0.2)
    out = device.zeros((2, 3, 5, 7, 3), np.float32)
    raw_decoding.divide_views(out, device.upload(raw), device.upload(white), 3, 1, device)
    expected = np.zeros(out.shape)
    expected[..., 1] = raw / np.maximum(white.astype(float), raw_decoding._FLOOR)
    yield expected, device.download(out)
    frame, flat = twins.reals(5, 50, 60), twins.reals(6, 50, 60, low=0.5)
    grid = LensletGrid((4, 5), (3, 3), (6.3, 7.4), (10.3, 0.2), (-0.1, 10.7))
    got = views_of_colours(frame, flat, grid, "RGGB", device=device)
    yield _colours_of(frame, flat, grid), device.download(got)


def _fitted(device: Device) -> Pairs:
    """Quadratics through the pixels of each colour of a Bayer mosaic under one lenslet."""
    frame, flat = twins.reals(7, 39, 47, low=0.5), twins.reals(8, 39, 47, low=0.5)
    grid = LensletGrid((3, 3), (2, 3), (10.3, 11.4), (9.6, 0.2), (-0.1, 10.7))
    matrix = np.array([[1, 0.25, 0], [0, 1, -0.5], [0.5, 0, 1]], np.float32)
    data, white = device.upload(frame), device.upload(flat)
    got = fit_colours(
        data, white, grid, "RGGB", noise=0.01, floor=0.05, device=device, matrix=matrix
    )
    expected = np.zeros(got.shape)
    names = np.array(["RG", "GB"], "S2").view("S1").reshape(2, 2)
    colours = np.tile(names, (20, 24))[:39, :47]
    centres = np.moveaxis(lenslet_centres(grid), 0, -1)
    for v, u, i, k, c in np.ndindex(*got.shape):
        offset = np.array([v - 0.5, u - 1.0])
        own = colours == b"RGB"[c : c + 1]
        expected[v, u, i, k, c] = _fit(frame / flat.astype(float), flat * own, grid,
                                       centres[i, k], offset)  # fmt: skip
    yield expected @ matrix.astype(float).T, device.download(got)


def _fit(n: Any, w: Any, grid: LensletGrid, centre: Any, offset: Any) -> float:
    """The constant of the quadratic that is nearest to values n of weights w (`colour_fit.cl`)."""
    away = np.moveaxis(np.indices(n.shape), 0, -1) - centre
    t = (away - offset) / 4
    k = np.maximum(1 - (t**2).sum(-1), 0) ** 4 * (w > 0)
    for edge in (np.array(grid.row_step), np.array(grid.column_step)):
        k *= np.abs(away @ edge) <= edge @ edge / 2
    own = k > 0
    (y, x), k, n, w = t[own].T, k[own], n[own], (k * w)[own]
    terms = np.stack([0 * y + 1, y, x, y * y, x * x, y * x])
    mean = (w * n).sum() / w.sum()
    random = 0.01 * mean * k.sum() / w.sum()
    detail = (w * n * n).sum() / w.sum() - mean**2 - 1.5 * random
    doubt = random / (k.sum() * max(detail, random / 1000))
    pull = np.repeat([0, 0.0016 + 0.39 * doubt, 0.0003 + 0.046 * doubt], (1, 2, 3))
    matrix = (terms * w) @ terms.T + np.diag(pull) * w.sum()
    return float(np.linalg.solve(matrix, terms @ (w * n))[0])


def _colours_of(frame: Any, flat: Any, grid: LensletGrid) -> Any:
    """Normalised convolution over neighbouring lenslets, and a little of a colour's own pixels."""
    found = np.zeros((*grid.views, *grid.count, 3))
    places = (((0, 0),), ((0, 1), (1, 0)), ((1, 1),))
    y, x = lenslet_centres(grid)
    at_y = y + (np.arange(3) - 1)[:, None, None, None]
    at_x = x + (np.arange(3) - 1)[:, None, None]
    for channel, colour in enumerate(places):
        sums = []
        for values in (frame, flat):
            alone = np.zeros_like(values)
            for a, b in colour:
                alone[a::2, b::2] = values[a::2, b::2]
            views = np.pad(_sampled(alone, at_y, at_x, twins.triangle), [(0, 0)] * 2 + [(1, 1)] * 2)
            w = (1 / 32, 1, 1 / 32)
            total = sum(
                w[i] * w[j] * views[:, :, i : i + grid.count[0], j : j + grid.count[1]]
                for i, j in np.ndindex(3, 3)
            )
            for a, b in (colour[0], colour[-1]):
                own = _sampled(values[a::2, b::2], (at_y - a) / 2, (at_x - b) / 2, twins.triangle)
                total = total + own / 512
            sums.append(total)
        found[..., channel] = sums[0] / sums[1]
    return found


FIRST, SECOND, ORIGIN = (12.4, -0.5), (0.6, 12.1), (7.0, 6.4)
SENSOR = (40, 39)


def _focused_raw(device: Device) -> tuple[Any, Any, RawImage, FocusedGeometry]:
    """A smooth random picture under 3 x 3 lenslets: values, places (3, 3, 2), raw, geometry."""
    y, x = np.indices(SENSOR)
    noise = 0.1 * twins.reals(7, *SENSOR)
    values = (1.5 + noise + np.sin(0.5 * y - 0.3 * x + 1)).astype(np.float32)
    i, j = np.indices((3, 3))[..., None]
    places = np.array(ORIGIN) + i * np.array(FIRST) + j * np.array(SECOND)
    raw = _raw(values, device, LensletGrid((3, 3), (3, 3), ORIGIN, FIRST, SECOND))
    return values, places, raw, FocusedGeometry.of(raw)


def _focused(device: Device) -> Pairs:
    """Patches of the nearest sub-image, and the mean of all that show a point."""
    values, places, raw, geometry = _focused_raw(device)
    for method, ratio in (("basic", 0.31), ("blended", -0.3)):
        picture = render_focused(raw, method=method, m=ratio, step=2.37)
        got = picture.to_numpy()
        y, x = (axis[:, None, None] if k == 0 else axis[None, :, None]
                for k, axis in enumerate(picture.grid.axes()))  # fmt: skip
        centres = places.reshape(-1, 2)
        dy, dx = ratio * (centres[:, 0] - y), ratio * (centres[:, 1] - x)
        at_y, at_x = np.broadcast_arrays(centres[:, 0] + dy, centres[:, 1] + dx)
        shown = _sampled(values, at_y, at_x, clamp=True)
        ny, nx = SENSOR
        recorded = (at_y >= 0) & (at_y <= ny - 1) & (at_x >= 0) & (at_x <= nx - 1)
        near = np.hypot(dy, dx)
        w = np.clip(geometry.pitch / 2 - near + 0.5, 0, 1) ** 2 * recorded
        if method == "basic":
            w = (near == near.min(axis=-1, keepdims=True)) & recorded
        lit = w.sum(axis=-1) > 0
        expected = (w * shown).sum(axis=-1) / np.maximum(w.sum(axis=-1), 1e-30)
        # Beyond the lenslets nothing is recorded, and the nearest lattice point is no lenslet.
        inner = lit & (near.min(axis=-1) < 0.45 * geometry.pitch * abs(ratio))
        yield expected[inner], got[inner]


def _scatter(w: Any, values: Any) -> float:
    return float((w * (values - (w * values).sum() / w.sum()) ** 2).sum())


class _Pairs:
    """Windows of two sub-images about what both show of a point at a ratio."""

    def __init__(self, values: Any, places: Any, matcher: Matcher) -> None:
        self.values, self.places, self.matcher = values, places, matcher

    def of(self, lens: tuple[int, int], pairs: Any) -> Any:
        """Centres of both sub-images of each pair of a lenslet that is there."""
        for pair in pairs:
            ends = [tuple(np.add(lens, pair[k : k + 2])) for k in (0, 2)]
            if all(0 <= n < 3 for end in ends for n in end):
                yield self.places[ends[0]], self.places[ends[1]]

    def windows(self, a: Any, b: Any, ratio: float, kernel: Any) -> Any:
        """(weights, A, B) of a pair; None where a window leaves the sensor or the light."""
        radius, (rim, shrink, least) = self.matcher.window, self.matcher.lit
        half, off = int(radius), ratio * (b - a) / 2
        for place in (a - off, b + off):
            low = np.floor(place)
            if (low - half < 1).any() or (low + half >= np.array(SENSOR) - 2).any():
                return None
        d = np.moveaxis(np.mgrid[-half : half + 1, -half : half + 1], 0, -1).reshape(-1, 2)
        far = np.maximum(((d - off) ** 2).sum(1), ((d + off) ** 2).sum(1))
        lit = rim - shrink * max(abs(ratio), least)
        w = np.where(far < max(lit, 0) ** 2, np.maximum(1 - (d**2).sum(1) / radius**2, 0), 0)
        A, B = (
            _sampled(self.values, (place + d)[:, 0], (place + d)[:, 1], kernel)
            for place in (a - off, b + off)
        )
        return (w, A, B) if w.sum() > 0 else None


def _focused_depth(device: Device) -> Pairs:
    """How far sub-images differ on three planes; one step by their slopes; bright spots."""
    values, places, raw, geometry = _focused_raw(device)
    matcher = Matcher(raw, geometry, 2.7)
    twin = _Pairs(values, places, matcher)
    planes = np.array([-0.21, 0.13, 0.34])
    costs = np.full((3, 3, 3), 2.0)
    for n in np.ndindex(3, 3, 3):
        apart = both = 0.0
        for a, b in twin.of(n[1:], matcher.near):
            found = twin.windows(a, b, planes[n[0]], twins.triangle)
            if found is not None:
                w, A, B = found
                apart += _scatter(w, A - B) + 2 * matcher.noise * w.sum()
                both += _scatter(w, A) + _scatter(w, B) + 2 * matcher.noise * w.sum()
        if both > 0:
            costs[n] = apart / both
    yield costs, matcher.costs(planes)
    start = 0.17 + 0.01 * np.arange(9.0).reshape(3, 3)
    yield _stepped(twin, start), matcher.refined(start, rounds=1).ratio
    yield from _spotted(device)


def _stepped(twin: _Pairs, start: Any) -> Any:
    """ratio - sum w e e'/sum w e'^2, means taken out, e' by a central difference."""
    out, h = start.copy(), 1e-5
    for n in np.ndindex(3, 3):
        first = second = 0.0
        for a, b in twin.of(n, twin.matcher.pairs):
            rim, shrink, least = twin.matcher.lit
            reach = np.hypot(*(start[n] * (b - a) / 2)) + twin.matcher.window / 2
            if reach >= rim - shrink * max(abs(start[n]), least):
                continue
            found = twin.windows(a, b, start[n], twins.keys)
            if found is None:
                continue
            w, A, B = found
            high, low = (twin.windows(a, b, start[n] + s, twins.keys) for s in (h, -h))
            slope = ((high[1] - high[2]) - (low[1] - low[2])) / (2 * h)
            e, mean = A - B, (w * slope).sum() / w.sum()
            first += (w * e * (slope - mean)).sum()
            second += _scatter(w, slope)
        if second > 0:
            out[n] -= np.clip(first / second, -twin.matcher.step, twin.matcher.step)
    return out


def _spotted(device: Device) -> Pairs:
    """Centroids of squares in each sub-image, about those of the round before."""
    _, places, _, geometry = _focused_raw(device)
    y, x = np.indices(SENSOR)
    values = 0.05 * twins.reals(8, *SENSOR)
    for centre in places.reshape(-1, 2) + twins.reals(9, 9, 2, low=-1.5, high=1.5):
        values += np.exp(-((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / 1.2)
    expected = np.zeros((9, 2))
    for radius in (1.0, *(focused_spots._WINDOW,) * focused_spots._ROUNDS):
        for k, (middle, about) in enumerate(
            zip(places.reshape(-1, 2), expected.copy(), strict=True)
        ):
            dy, dx = y - middle[0], x - middle[1]
            near = np.hypot(dy, dx) < geometry.pitch / 2
            near &= np.hypot(dy - about[0], dx - about[1]) < radius * geometry.pitch
            power = near * values.astype(float) ** 2
            expected[k] = (power * dy).sum() / power.sum(), (power * dx).sum() / power.sum()
    grid = LensletGrid((3, 3), (3, 3), ORIGIN, FIRST, SECOND)
    yield expected, focused_spots._spots(_raw(values, device, grid), geometry)[1]


CHECKS = (
    Check("decode", "hexagonal array, turned, to views", _decode, 1e-5, ("decode.cl",)),
    Check("upright", "square array along the sensor, to views", _upright, 1e-5, ("upright.cl",)),
    Check("devignette", "over the white image, colours of a mosaic", _divided, 1e-5,
          ("devignette.cl",)),
    Check("colour_fit", "colours of a mosaic, fitted within lenslets", _fitted, 1e-4,
          ("colour_fit.cl",)),
    Check("focused_render", "focused camera: patches, blended", _focused, 2e-5,
          ("focused_render.cl", "focused.cl")),
    Check("focused_depth", "focused camera: costs, a step, spots", _focused_depth, 1e-4,
          ("focused_depth.cl",)),
)  # fmt: skip


SHAPE, V, N = (5, 6), 2, 3  # lenslets; voxels and pixels of one along an axis
OPTICS = {"na": 0.5, "medium_index": 1.0, "magnification": 20.0, "lenslet_pitch": 125e-6}


def _projector(device: Device) -> Projector:
    """Random point images of two planes, with the mirror symmetries of a square lattice."""
    planes = []
    for r in (1, 2):
        side = (2 * r + 1) * N
        h = twins.reals(r, side, side, low=0.1)
        planes.append((h + h.T)[None])
    z = np.array([1e-6, -4e-6])
    images = PointImages(OPTICS, z, V, N, tuple(planes), np.ones(2))
    return Projector(images, SHAPE, device=device)


def _matrix(projector: Projector) -> Any:
    """H[pixel, voxel]: the image of every voxel where it lies on the frame."""
    (planes, ny, nx), (height, width) = projector.volume_shape, projector.frame_shape
    H = np.zeros((height * width, planes, ny, nx))
    for z, y, x in np.ndindex(planes, ny, nx):
        image, r = projector.images.image(z, (y % V, x % V)), projector.images.radii[z]
        frame = np.zeros((height + 2 * r * N, width + 2 * r * N))
        top, left = y // V * N, x // V * N
        frame[top : top + len(image), left : left + len(image)] = image
        H[:, z, y, x] = frame[r * N : r * N + height, r * N : r * N + width].ravel()
    return H.reshape(height * width, -1)


def _projected(device: Device) -> Pairs:
    projector = _projector(device)
    H = _matrix(projector)
    volume, frame = twins.reals(3, *projector.volume_shape), twins.reals(4, *projector.frame_shape)
    yield (H @ volume.ravel()).reshape(frame.shape), projector.forward(volume)
    yield (H.T @ frame.ravel()).reshape(volume.shape), projector.backward(frame)


def _deconvolved(device: Device) -> Pairs:
    """V <- V H'(w I/(w H V + b)) / H'w, from points ahead (Biggs and Andrews 1997)."""
    projector = _projector(device)
    H = _matrix(projector)
    I, w = (twins.reals(k, *projector.frame_shape, low=0.5).astype(float) for k in (5, 6))  # noqa: E741
    b, (I, w) = 0.2, (I.ravel() * 50, w.ravel())  # noqa: E741
    seen, x = H.T @ w, np.full(H.shape[1], I.sum() / H.shape[1] / w.mean())
    begun = before = x
    last = None
    for k in range(4):
        if k:
            step = x - begun
            a = 0.0 if last is None else np.clip(step @ last / (last @ last), 0, 0.999)
            x, before, last = np.maximum(x + a * (x - before), 0), x, step
            begun = x
        back = H.T @ (w * I / (w * (H @ x) + b))
        x = np.where(seen > LEAST * seen.max(), x * back / seen, 0)
    shape = projector.frame_shape
    found = deconvolve(
        I.reshape(shape), projector, iterations=4, background=b, white=w.reshape(shape),
        accelerate=True,
    )  # fmt: skip
    yield x.reshape(projector.volume_shape), found.volume


def _restrained(device: Device) -> Pairs:
    """B/(1 - a div(g/|g|)), g the gradient of the density."""
    projector = _projector(device)
    volume, back = (twins.reals(k, 1, *projector.volume_shape) for k in (7, 8))
    counts = twins.reals(9, 1, *projector.frame_shape, high=100)
    prior = TotalVariation(projector, counts, 1.0)
    z = projector.images.planes / projector.images.side
    order = np.argsort(z)
    thick = np.full(2, np.diff(z[order])[0])
    e = SMOOTH * counts.sum(dtype=float) / (volume.size * thick.mean())
    rho = volume[0, order].astype(float) / thick[:, None, None]
    g = [np.diff(rho, axis=axis, append=rho.take([-1], axis)) for axis in range(3)]
    g[0] /= thick[0]
    p = [one / np.sqrt(sum(np.square(g)) + e**2) for one in g]
    dz, dy, dx = (np.diff(one, axis=axis, prepend=0) for axis, one in enumerate(p))
    expected = back[0].astype(float)
    expected[order] /= 1 - prior.weights[0] * (dz / thick[:, None, None] + dy + dx)
    target = device.upload(back)
    prior.restrain(target, device.upload(volume))
    yield expected, device.download(target)[0]


def _restrained_in_time(device: Device) -> Pairs:
    """B/(1 - a (p[t] - p[t - 1])), p of the change to the next frame."""
    projector = _projector(device)
    volumes, back = (twins.reals(k, 3, *projector.volume_shape) for k in (11, 12))
    before = twins.reals(13, *projector.volume_shape)
    counts = twins.reals(14, 3, *projector.frame_shape, high=100)
    prior = TimeVariation(projector, counts, 1.0, before)
    e = SMOOTH * counts.sum(axis=(1, 2), dtype=float) / before.size
    change = np.diff(np.concatenate([before[None], volumes, volumes[-1:]]).astype(float), axis=0)
    p = change / np.sqrt(change**2 + np.concatenate([e[:1], e])[:, None, None, None] ** 2)
    expected = back / (1 - prior.weights[:, None, None, None] * np.diff(p, axis=0))
    target = device.upload(back)
    prior.restrain(target, device.upload(volumes))
    yield expected, device.download(target)


def _sieved(device: Device) -> Pairs:
    """Each plane smoothed by its own Gaussian, of so many voxels, reflected at the edges."""
    projector = _projector(device)
    volume = twins.reals(10, 1, *projector.volume_shape)
    sigma = 3.0 * EVEN * V * np.maximum(1 - projector.images.blurs, 0)
    expected = np.zeros(volume.shape)
    for z, width in enumerate(sigma):
        radius = int(min(np.ceil(4 * width), *projector.volume_shape[1:]))
        taps = np.exp(-0.5 * (np.arange(radius + 1) / width) ** 2)
        taps /= 2 * taps.sum() - 1
        plane = twins.reflected(volume[0, z].astype(float), taps, 0)
        expected[0, z] = twins.reflected(plane, taps, 1)
    yield expected, device.download(Sieve(projector, 3.0).volumes(device.upload(volume)))


VOLUME_CHECKS = (
    Check("projector", "volumes to frames of a microscope and back", _projected, 1e-5,
          ("projector.cl", "lattice.cl", "lattice_spectra.cl", "lattice_transform.cl")),
    Check("richardson_lucy", "4 iterations of a deconvolution, accelerated", _deconvolved, 1e-4,
          ("richardson_lucy.cl",)),
    Check("total_variation", "what little variation asks of a step", _restrained, 2e-5,
          ("total_variation.cl",)),
    Check("time_variation", "what little variation in time asks of a step", _restrained_in_time,
          2e-5, ("time_variation.cl",)),
    Check("sieve", "planes smoothed by windows of their own", _sieved, 1e-6, ("sieve.cl",)),
)  # fmt: skip
