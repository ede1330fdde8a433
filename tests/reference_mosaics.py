"""Mosaics of coloured scenes behind lenslets, whose views are known, float64.

A scene is a stack of layers, far to near; a ray at the place p from the centre c of its lenslet
meets a layer of disparity d at c + d (unit/step) p, all in pixels of the sensor. Textures are
blurred by the disc of a lenslet, as its opening does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from reference_lattice import Drawn, lattice
from scipy.ndimage import convolve, map_coordinates

from clplen.lightfield import Lattice, LensletGrid

Array = np.ndarray

FINE = 2  # pixels of the sensor between samples of a texture
MARGIN = 160  # pixels about the sensor that rays reach
FULL_WELL = 5000.0  # electrons of a pixel that is just not saturated
READ_NOISE = 3.0  # electrons
BLACK, TOP = 64, 1023  # digital numbers of no light and of the full well
SENSITIVITY = np.array([0.55, 1.0, 0.7])  # of red, green and blue pixels to white light
GAP = 0.02  # of the light falls between the lenslets
BORDER = 2  # pixels of a view that are not compared
KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4  # bilinear


@dataclass(frozen=True)
class Array2D:
    """A lenslet array before a sensor with colour filters."""

    kind: str
    pitch: float
    degrees: float
    bayer: str
    shape: tuple[int, int]

    @property
    def true(self) -> Drawn:
        origin = (self.shape[0] / 2 + 0.37, self.shape[1] / 2 - 0.21)
        return lattice(self.kind, self.pitch, degrees=self.degrees, origin=origin)

    @property
    def unit(self) -> float:
        """Distance of the pixels of a view, in pixels of the sensor."""
        return self.pitch * (1.0 if self.kind == "square" else np.sqrt(0.75))

    @property
    def step(self) -> float:
        """Distance of two views, in pixels of the sensor."""
        return self.pitch / round(self.pitch)


ARRAYS = {
    "hexagonal": Array2D("hexagonal", 14.29, 0.6, "GRBG", (553, 611)),
    "square": Array2D("square", 13.37, -1.1, "RGGB", (563, 597)),
}


@dataclass(frozen=True)
class Layer:
    """A texture (ny, nx, 4), colours times opacity and opacity, of a disparity."""

    texture: Array
    disparity: float


def places(array: Array2D) -> tuple[Array, Array]:
    """(y, x) of the samples of a texture, in lenslets from the middle of the sensor."""
    axes = [np.arange(-MARGIN, n + MARGIN, FINE) for n in array.shape]
    y, x = ((at - n / 2) / array.pitch for at, n in zip(axes, array.shape, strict=True))
    return np.meshgrid(y, x, indexing="ij")


def layer(array: Array2D, colours: Array, opacity: Array | float, disparity: float) -> Layer:
    """Colours (ny, nx, 3) and opacity, seen through a lenslet."""
    opacity = np.broadcast_to(np.asarray(opacity, np.float64), colours.shape[:2])[..., None]
    values = np.concatenate([colours * opacity, opacity], axis=-1)
    fy, fx = (np.fft.fftfreq(n)[:, None] for n in values.shape[:2])
    radius = array.pitch / 2 / FINE
    n = int(radius) + 1
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    disc = np.clip(radius + 0.5 - np.hypot(y, x), 0, 1)
    moved = np.exp(-2j * np.pi * fy * y[:, 0]) @ disc @ np.exp(-2j * np.pi * fx * x[0]).T
    spectrum = np.fft.fft2(values, axes=(0, 1)) * (moved / disc.sum())[..., None]
    return Layer(np.fft.ifft2(spectrum, axes=(0, 1)).real, disparity)


def edges(array: Array2D) -> list[Layer]:
    """Patches of saturated colours with sharp borders before a grey ground, at three depths."""
    y, x = places(array)
    palette = np.array(
        [[0.9, 0.05, 0.05], [0.05, 0.7, 0.1], [0.06, 0.08, 0.85], [0.9, 0.8, 0.05],
         [0.02, 0.7, 0.75], [0.8, 0.1, 0.7], [0.9, 0.9, 0.9], [0.04, 0.04, 0.04]]
    )  # fmt: skip
    patch = np.floor((x + 0.3 * y) / 4.3) + 3 * np.floor((y - 0.2 * x) / 5.1)
    far = palette[patch.astype(int) % 8]
    middle = palette[(np.floor((0.8 * x - 0.6 * y) / 3.7)).astype(int) % 3]
    near = palette[3 + (np.floor((0.6 * x + 0.8 * y) / 2.9)).astype(int) % 4]
    return [
        layer(array, far, 1.0, -0.35),
        layer(array, middle, np.hypot(y + 6, x + 5) < 7.3, 0.1),
        layer(array, near, np.hypot(y - 7, (x - 8) / 1.4) < 6.1, 0.55),
    ]


def texture(array: Array2D) -> list[Layer]:
    """Fine threads of many colours, from a third of the lenslets' resolution on, at two depths."""
    random = np.random.default_rng(3)
    y, x = places(array)

    def cloth(turned: float) -> Array:
        out = np.zeros((*y.shape, 3))
        for n in range(24):
            period, angle = 3.2 + 0.35 * n, random.uniform(0, np.pi) + turned
            wave = np.sin(2 * np.pi / period * (y * np.sin(angle) + x * np.cos(angle)) + 7 * n)
            out += wave[..., None] * random.normal(0, 0.055, 3)
        return np.clip(0.42 + out, 0.02, 0.98)

    left = 1 / (1 + np.exp(-6 * (x - 0.25 * y)))
    return [layer(array, cloth(0.0), 1.0, 0.4), layer(array, cloth(0.4), left, -0.6)]


def gradients(array: Array2D) -> list[Layer]:
    """A sky of slow colours, balls with small bright highlights, at three depths."""
    y, x = places(array)
    t = (y / 40 + 0.5)[..., None]
    sky = np.array([0.1, 0.22, 0.5]) * (1 - t) + np.array([0.75, 0.5, 0.3]) * t
    layers = [layer(array, np.clip(sky, 0.02, 1), 1.0, -0.5)]
    for (a, b), radius, colour, disparity in (
        ((-4.0, -7.0), 8.0, (0.55, 0.12, 0.1), 0.0),
        ((6.0, 8.0), 7.0, (0.08, 0.3, 0.14), 0.45),
        ((9.0, -9.0), 5.0, (0.5, 0.45, 0.1), 0.8),
    ):
        r = np.hypot(y - a, x - b) / radius
        round_ = np.sqrt(np.clip(1 - r**2, 0, 1))
        shine = np.exp(-(((y - a + 0.35 * radius) ** 2 + (x - b + 0.3 * radius) ** 2) / 1.1))
        body = np.array(colour) * (0.25 + 0.9 * round_)[..., None] + 0.75 * shine[..., None]
        layers.append(layer(array, np.clip(body, 0, 1), r < 1, disparity))
    return layers


SCENES = {"edges": edges, "texture": texture, "gradients": gradients}


def seen(array: Array2D, scene: list[Layer], centre: Array, offset: Array) -> Array:
    """Colours (..., 3) of rays at ``offset`` (..., 2) pixels from centres (..., 2) of lenslets."""
    out = np.zeros((*np.broadcast_shapes(centre.shape, offset.shape)[:-1], 3))
    for part in scene:
        at = centre + part.disparity * array.unit / array.step * offset
        where = np.moveaxis((at + MARGIN) / FINE, -1, 0)
        values = [
            map_coordinates(part.texture[..., c], where, order=3, mode="nearest") for c in range(4)
        ]
        out = out * (1 - values[3])[..., None] + np.stack(values[:3], axis=-1)
    return out


def vignetting(array: Array2D) -> Array:
    """Light of every pixel in even light, float64: dark rims of sub-images, corners at .7."""
    ny, nx = array.shape
    out = np.zeros(array.shape)
    for a in (-1 / 3, 0, 1 / 3):
        for b in (-1 / 3, 0, 1 / 3):
            y, x = np.mgrid[:ny, :nx].astype(np.float64)
            _, _, dy, dx = array.true.nearest(y + a, x + b)
            r = np.hypot(dy, dx) / array.pitch
            dome = 1 - 1.6 * r**2
            out += GAP + (dome - GAP) * np.clip((0.485 - r) / 0.09 + 0.5, 0, 1)
    r2 = ((y / (ny - 1) - 0.5) ** 2 + (x / (nx - 1) - 0.5) ** 2) / 0.5
    return np.asarray(out / 9 * (1 - 0.3 * r2))


def mosaic(picture: Array, bayer: str) -> Array:
    """What a sensor behind Bayer filters has of a picture of three colours."""
    out = np.zeros(picture.shape[:2])
    for n, colour in enumerate(bayer):
        place = (slice(n // 2, None, 2), slice(n % 2, None, 2))
        out[place] = picture[(*place, "RGB".index(colour))]
    return out


def recorded(light: Array, seed: int, frames: int = 1) -> Array:
    """Digital numbers of a sensor in light of at most 1, uint16, or the mean of several."""
    random = np.random.default_rng(seed)
    total = np.zeros(light.shape)
    for _ in range(frames):
        electrons = random.poisson(np.maximum(light, 0) * FULL_WELL)
        electrons = electrons + random.normal(0, READ_NOISE, light.shape)
        numbers = BLACK + electrons / FULL_WELL * (TOP - BLACK)
        total += np.clip(np.rint(numbers), 0, TOP)
    return total.astype(np.uint16) if frames == 1 else total / frames


def captured(array: Array2D, scene: list[Layer], *, noise: bool = True) -> tuple[Array, Array]:
    """The mosaic of a scene and its white image, digital numbers."""
    y, x = np.mgrid[: array.shape[0], : array.shape[1]].astype(np.float64)
    _, _, dy, dx = array.true.nearest(y, x)
    offset = np.stack([dy, dx], -1)
    even = vignetting(array)[..., None] * SENSITIVITY
    light = mosaic(seen(array, scene, np.stack([y, x], -1) - offset, offset) * even, array.bayer)
    white = mosaic(even, array.bayer)
    if not noise:
        return BLACK + light * (TOP - BLACK), BLACK + 0.9 * white * (TOP - BLACK)
    return recorded(light, 1), recorded(0.9 * white, 2, frames=4)


# Views of the mosaic, true and by hand ------------------------------------------------------------


def lattice_of(array: Array2D) -> Lattice:
    """The lenslets as the package describes them."""
    true = array.true
    row = true.second - (true.first / 2 if array.kind == "hexagonal" else 0)
    (y, x), (down, right), (a, b) = (map(float, pair) for pair in (true.origin, row, true.first))
    return Lattice(array.kind, (y, x), (down, right), (a, b), array.shape)


def offsets(grid: LensletGrid) -> Array:
    """Where views lie from the middle of a lenslet, (V, U, 1, 1, 2)."""
    (V, U) = grid.views
    v = (np.arange(V) - (V - 1) / 2)[:, None, None, None, None]
    u = (np.arange(U) - (U - 1) / 2)[:, None, None, None]
    return np.asarray(v * np.array(grid.row_view_step) + u * np.array(grid.column_view_step))


def truth(array: Array2D, scene: list[Layer], grid: LensletGrid) -> Array:
    """The views of a scene, without noise."""
    lattice = lattice_of(array)
    steps = [np.array(s) / np.hypot(*s) * array.unit for s in (lattice.row, lattice.column)]
    i, k = np.indices(grid.shape[2:])[..., None]
    return seen(array, scene, np.array(grid.first) + i * steps[0] + k * steps[1], offsets(grid))


def by_hand(raw: Array, white: Array, array: Array2D, grid: LensletGrid, order: int) -> Array:
    """Views by bilinear demosaicing of the raw picture over its white image."""
    light, level = raw - float(BLACK), white - float(BLACK)
    for n in range(4):
        place = (slice(n // 2, None, 2), slice(n % 2, None, 2))
        level[place] /= np.quantile(level[place], 0.995)
    light = light / np.maximum(level, 0.05)
    views = []
    for c in range(3):
        only = mosaic(np.broadcast_to(np.eye(3)[c], (*array.shape, 3)), array.bayer)
        plane = convolve(light * only, KERNEL) / convolve(only, KERNEL)
        views.append(_rectangular(_sliced(plane, grid, order), grid))
    return np.stack(views, axis=-1)


def _sliced(plane: Array, grid: LensletGrid, order: int) -> Array:
    """Every lenslet sampled about its own centre, (V, U, rows, lenslets)."""
    i, k = np.indices(grid.count)[..., None]
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    centres = np.array(grid.first) + i * np.array(grid.row_step) + k * np.array(grid.column_step)
    return map_coordinates(plane, np.moveaxis(centres + offsets(grid), -1, 0), order=order)


def _rectangular(views: Array, grid: LensletGrid) -> Array:
    """Rows of lenslets interpolated to the columns wanted (Keys 1981)."""
    if grid.columns is None:
        return views
    (n, step), last = grid.columns, grid.count[1] - 1
    out = np.zeros((*views.shape[:3], n))
    for row in range(views.shape[2]):
        x = np.arange(n) * step - (grid.odd_row_shift if row % 2 else 0)
        for a in range(-1, 3):
            p = np.floor(x).astype(int) + a
            t = np.abs(x - p)
            near, far = (1.5 * t - 2.5) * t * t + 1, ((-0.5 * t + 2.5) * t - 4) * t + 2
            out[:, :, row] += np.where(t < 1, near, far) * views[:, :, row, np.clip(p, 0, last)]
    return out


def encoded(linear: Array) -> Array:
    """sRGB (IEC 61966-2-1) of linear light."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def scores(views: Array, true: Array, array: Array2D, grid: LensletGrid) -> list[float]:
    """PSNR of linear light and of sRGB, and the mean CIEDE2000 difference."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    inside = np.hypot(*np.moveaxis(offsets(grid), -1, 0))[:, :, 0, 0] <= array.pitch / 2 - 1
    got, want = (
        part[inside][:, BORDER:-BORDER, BORDER:-BORDER].astype(np.float64) for part in (views, true)
    )
    got = got * ((got * want).sum((0, 1, 2)) / (got * got).sum((0, 1, 2)))
    pair = encoded(got), encoded(want)
    squares = ((got - want) ** 2).mean(), ((pair[0] - pair[1]) ** 2).mean()
    apart = deltaE_ciede2000(*(rgb2lab(picture) for picture in pair)).mean()
    return [*(-10 * float(np.log10(s)) for s in squares), float(apart)]
