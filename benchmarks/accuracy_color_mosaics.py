"""Colours of decoded mosaics beside bilinear demosaicing, on simulated pictures with truth.

    python benchmarks/accuracy_color_mosaics.py [--device pocl] [--scene edges] [--array square]

Three scenes (saturated patches with sharp borders; fine threads of many colours; slow gradients
with highlights), each at several disparities and with what hides what, behind a hexagonal array
of 14.29 pixels (GRBG, turned by .6 degrees) and a square one of 13.37 (RGGB, -1.1 degrees): full
colour at every pixel of the sensor, vignetted, mosaicked, with photon and read noise of a full
well of 5000 electrons, 10 bits, and a white image of four such frames. Compared are the views
that lie a pixel inside a lenslet, two pixels off their borders, each colour scaled by one number
to fit the truth: PSNR of linear light and of sRGB (peak 1), and the mean CIEDE2000 difference.
"bilinear" divides the mosaic by the white image, interpolates the colours on the sensor, and
slices them by the same lattice, linearly or by cubic splines (whichever is better, in each
number); rows of hexagonal lattices are interpolated by the same cubic as clplen's.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.ndimage import convolve, map_coordinates
from skimage.color import deltaE_ciede2000, rgb2lab

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from reference_mosaics import ARRAYS, BLACK, SCENES, Array2D, Layer, captured, mosaic, seen

from clplen import Device, decode_raw
from clplen.lightfield import Lattice, LensletGrid

Values = np.ndarray[Any, Any]

BORDER = 2  # pixels of a view
KERNEL = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4


def lattice_of(array: Array2D) -> Lattice:
    """The lenslets as the package describes them."""
    true = array.true
    row = true.second - (true.first / 2 if array.kind == "hexagonal" else 0)
    (y, x), (down, right), (a, b) = (map(float, pair) for pair in (true.origin, row, true.first))
    return Lattice(array.kind, (y, x), (down, right), (a, b), array.shape)


def offsets(grid: LensletGrid) -> Values:
    """Where views lie from the middle of a lenslet, (V, U, 1, 1, 2)."""
    (V, U) = grid.views
    v = (np.arange(V) - (V - 1) / 2)[:, None, None, None, None]
    u = (np.arange(U) - (U - 1) / 2)[:, None, None, None]
    return np.asarray(v * np.array(grid.row_view_step) + u * np.array(grid.column_view_step))


def truth(array: Array2D, scene: list[Layer], grid: LensletGrid) -> Values:
    """The views of a scene, without noise."""
    lattice = lattice_of(array)
    steps = [np.array(s) / np.hypot(*s) * array.unit for s in (lattice.row, lattice.column)]
    i, k = np.indices(grid.shape[2:])[..., None]
    return seen(array, scene, np.array(grid.first) + i * steps[0] + k * steps[1], offsets(grid))


def by_hand(raw: Values, white: Values, array: Array2D, grid: LensletGrid, order: int) -> Values:
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


def _sliced(plane: Values, grid: LensletGrid, order: int) -> Values:
    """Every lenslet sampled about its own centre, (V, U, rows, lenslets)."""
    i, k = np.indices(grid.count)[..., None]
    k = k + np.where(i % 2, grid.odd_row_shift, 0)
    centres = np.array(grid.first) + i * np.array(grid.row_step) + k * np.array(grid.column_step)
    return map_coordinates(plane, np.moveaxis(centres + offsets(grid), -1, 0), order=order)


def _rectangular(views: Values, grid: LensletGrid) -> Values:
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


def encoded(linear: Values) -> Values:
    """sRGB (IEC 61966-2-1) of linear light."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def scores(views: Values, true: Values, array: Array2D, grid: LensletGrid) -> list[float]:
    """PSNR of linear light and of sRGB, and the mean CIEDE2000 difference."""
    inside = np.hypot(*np.moveaxis(offsets(grid), -1, 0))[:, :, 0, 0] <= array.pitch / 2 - 1
    got, want = (
        part[inside][:, BORDER:-BORDER, BORDER:-BORDER].astype(np.float64)
        for part in (views, true)
    )
    got = got * ((got * want).sum((0, 1, 2)) / (got * got).sum((0, 1, 2)))
    pair = encoded(got), encoded(want)
    squares = ((got - want) ** 2).mean(), ((pair[0] - pair[1]) ** 2).mean()
    apart = deltaE_ciede2000(*(rgb2lab(picture) for picture in pair)).mean()
    return [*(-10 * float(np.log10(s)) for s in squares), float(apart)]


def compare(array: Array2D, scene: list[Layer], device: Device) -> dict[str, list[float]]:
    """The scores of every way."""
    raw, white = captured(array, scene)
    lattice = lattice_of(array)
    found: dict[str, list[float]] = {}
    views: dict[str, Values] = {}
    for word in ("within", "after", "before"):
        more = {} if word == "within" else {"demosaic": word}  # the default is meant
        lf = decode_raw(
            raw.astype(np.float32) - BLACK, lattice, device=device, white=white - BLACK,
            bayer=array.bayer, **more,
        )  # fmt: skip
        views[word] = lf.to_numpy()
    assert lf.raw is not None
    grid = lf.raw.sub_images
    assert isinstance(grid, LensletGrid)
    true = truth(array, scene, grid)
    found = {word: scores(picture, true, array, grid) for word, picture in views.items()}
    both = [scores(by_hand(raw, white, array, grid, n), true, array, grid) for n in (1, 3)]
    found["bilinear"] = [max(pair) for pair in zip(*both, strict=True)]
    found["bilinear"][2] = min(pair[2] for pair in both)
    return found


@click.command(help=__doc__)
@click.option("--device", "selector", help="As Device.open takes it.")
@click.option("--scene", "scenes", multiple=True, type=click.Choice(list(SCENES)))
@click.option("--array", "arrays", multiple=True, type=click.Choice(list(ARRAYS)))
def main(selector: str | None, scenes: tuple[str, ...], arrays: tuple[str, ...]) -> None:
    """Every scene behind every array."""
    warnings.simplefilter("ignore")
    device = Device.open(selector)
    click.echo(f"{device!r}\nPSNR linear, dB / PSNR sRGB, dB / CIEDE2000")
    worse = 0
    for name in arrays or ARRAYS:
        for scene in scenes or SCENES:
            found = compare(ARRAYS[name], SCENES[scene](ARRAYS[name]), device)
            click.echo(f"{name}, {scene}")
            for way, (linear, srgb, apart) in found.items():
                click.echo(f"  {way:<10} {linear:6.2f} / {srgb:6.2f} / {apart:5.2f}")
            mine, other = found["within"], found["bilinear"]
            worse += (mine[0] <= other[0]) + (mine[1] <= other[1]) + (mine[2] >= other[2])
    click.echo(f"clplen's default is worse than bilinear in {worse} numbers")


if __name__ == "__main__":
    main()
